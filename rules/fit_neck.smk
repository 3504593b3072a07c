"""
What the study's neck model says of each person's takes, whether it was trained on them or not.

INPUTS:   base, model  = results/{study}/head_model/base.npz, results/{study}/train_neck/model.npz
          files        = the person's neutral head and tracked takes
OUTPUTS:  fits         = results/{study}/fit_neck/{person}/fits.npz, coefficients and errors of every frame
          fitted_model = results/{study}/fit_neck/{person}/model.npz, the model with this person's larynx
          figure       = results/{study}/fit_neck/{person}/fits.png
"""


rule fit_neck:
    """A person's coefficients of the neck model."""
    input:
        base="results/{study}/head_model/base.npz",
        model="results/{study}/train_neck/model.npz",
        files=person_inputs,
    output:
        fits="results/{study}/fit_neck/{person}/fits.npz",
        fitted_model="results/{study}/fit_neck/{person}/model.npz",
        figure="results/{study}/fit_neck/{person}/fits.png",
    log:
        "results/{study}/logs/fit_neck/{person}.log",
    benchmark:
        "results/{study}/benchmarks/fit_neck/{person}.tsv"
    resources:
        mem_mb=2500,
    params:
        person=person_files,
        held_out=is_held_out,
        settings=training_setting("train_neck"),
        source=source("fit_neck"),
    script:
        "../pipeline/fit_neck.py"
