"""
What the neck model and the voices show on everybody, against truth where it is known: tables 1 and 2 of the neck paper.

INPUTS:   fits, errors = results/{study}/fit_neck/{person}/fits.npz, results/{study}/train_speech/{voice}.errors.json
OUTPUTS:  tables       = results/{study}/evaluate_neck/tables.json
          figures      = results/{study}/evaluate_neck/figures.json
"""


rule evaluate_neck:
    """Tables and figures of the study's neck model."""
    input:
        fits=neck_fits,
        errors=voice_errors,
    output:
        tables="results/{study}/evaluate_neck/tables.json",
        figures="results/{study}/evaluate_neck/figures.json",
    log:
        "results/{study}/logs/evaluate_neck.log",
    benchmark:
        "results/{study}/benchmarks/evaluate_neck.tsv"
    resources:
        mem_mb=1500,
    params:
        name=study_name,
        recorded=recorded_people,
        larynxes=larynx_truths,
        limits=people_limits,
        source=source("evaluate_neck"),
    script:
        "../pipeline/evaluate_neck.py"
