"""
Tables 1 to 3 of the lip paper over all tested takes, with intervals over takes.

INPUTS:   errors  = results/{study}/correct_lips/{person}/{take}.errors.npz
OUTPUTS:  tables  = results/{study}/evaluate_lips/tables.json
          figures = results/{study}/evaluate_lips/figures.json
"""


rule evaluate_lips:
    """Tables and figures of the study's lips."""
    input:
        errors=lip_files("correct_lips", ".errors.npz"),
    output:
        tables="results/{study}/evaluate_lips/tables.json",
        figures="results/{study}/evaluate_lips/figures.json",
    log:
        "results/{study}/logs/evaluate_lips.log",
    benchmark:
        "results/{study}/benchmarks/evaluate_lips.tsv"
    resources:
        mem_mb=500,
    params:
        name=study_name,
        limits=people_limits,
        source=source("evaluate_lips"),
    script:
        "../pipeline/evaluate_lips.py"
