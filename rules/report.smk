"""
One page per session: figures, gates, pictures of every stage.

INPUTS:   results of all stages and takes, metrics = results/{session}/metrics.json
OUTPUTS:  report = results/{session}/report/report.html
"""


rule report:
    """The session's report."""
    input:
        unpack(session_results),
        metrics="results/{session}/metrics.json",
    output:
        report="results/{session}/report/report.html",
    log:
        "results/{session}/logs/report.log",
    benchmark:
        "results/{session}/benchmarks/report.tsv"
    resources:
        mem_mb=2000,
    params:
        session="{session}",
        takes=takes,
        settings=described_session,
        source=source("report"),
    script:
        "../pipeline/report.py"
