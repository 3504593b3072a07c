"""
Measures what came out, against truth where the session names some.

INPUTS:   results of all stages and takes
OUTPUTS:  metrics = results/{session}/metrics.json
"""


rule evaluate:
    """The session's figures."""
    input:
        unpack(session_results),
        placement="results/{session}/register/placement.json",
        necks=neck_figures,
        expressions=expression_figures,
    output:
        metrics="results/{session}/metrics.json",
    log:
        "results/{session}/logs/evaluate.log",
    benchmark:
        "results/{session}/benchmarks/evaluate.tsv"
    resources:
        mem_mb=2500,
    params:
        truth=truth,
        takes=takes,
        scan=scan_paths,
        settings=evaluate_setting,
        source=source("evaluate"),
    script:
        "../pipeline/evaluate.py"
