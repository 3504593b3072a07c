"""
The page of a study's neck model: tables 1 and 2 of the neck paper, the ablation, and its figures on people held out.

INPUTS:   tables, figures = results/{study}/evaluate_neck/tables.json, figures.json
          model           = results/{study}/train_neck/model.npz
          fits, models    = results/{study}/fit_neck/{person}/fits.npz, model.npz of everybody
          regressors      = results/{study}/train_speech/{voice}.npz
          sounds          = what was heard of everybody's speech takes
OUTPUTS:  page            = results/{study}/report_neck/neck.html
"""


rule report_neck:
    """The study's page."""
    input:
        tables="results/{study}/evaluate_neck/tables.json",
        figures="results/{study}/evaluate_neck/figures.json",
        model="results/{study}/train_neck/model.npz",
        fits=neck_fits,
        models=neck_models,
        regressors=voice_regressors,
        sounds=all_sounds,
    output:
        page="results/{study}/report_neck/neck.html",
    log:
        "results/{study}/logs/report_neck.log",
    benchmark:
        "results/{study}/benchmarks/report_neck.tsv"
    resources:
        mem_mb=2500,
    params:
        people=all_people,
        voices=voice_names,
        groups=voice_groups,
        settings=described_study,
        source=source("report_neck"),
    script:
        "../pipeline/report_neck.py"
