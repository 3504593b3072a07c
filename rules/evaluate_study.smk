"""
One file of figures for a study of several people.

INPUTS:   parts   = results/{session}/metrics.json of each session, results/{study}/evaluate_neck/figures.json
OUTPUTS:  metrics = results/{study}/metrics.json
"""


rule evaluate_study:
    """Figures of all people and voices."""
    input:
        parts=study_parts,
    output:
        metrics=f"results/{PLAN.name}/metrics.json",
    log:
        f"results/{PLAN.name}/logs/evaluate_study.log",
    benchmark:
        f"results/{PLAN.name}/benchmarks/evaluate_study.tsv"
    resources:
        mem_mb=500,
    params:
        source=source("evaluate_study"),
    script:
        "../pipeline/evaluate_study.py"
