"""
From voices to the coefficients of the neck model: one regressor for each person who trains, and one for each group.

INPUTS:   model     = results/{study}/train_neck/model.npz
          fits      = results/{study}/fit_neck/{person}/fits.npz of the people
          sounds    = what was heard of their speech takes
OUTPUTS:  regressor = results/{study}/train_speech/{voice}.npz
          errors    = results/{study}/train_speech/{voice}.errors.json, on takes and people left out
          figure    = results/{study}/train_speech/{voice}.png, coefficients fitted and predicted
"""


rule train_speech:
    """A speech regressor of one person or of a group."""
    input:
        model="results/{study}/train_neck/model.npz",
        fits=voice_fits,
        sounds=voice_sounds,
    output:
        regressor="results/{study}/train_speech/{voice}.npz",
        errors="results/{study}/train_speech/{voice}.errors.json",
        figure="results/{study}/train_speech/{voice}.png",
    log:
        "results/{study}/logs/train_speech/{voice}.log",
    benchmark:
        "results/{study}/benchmarks/train_speech/{voice}.tsv"
    resources:
        mem_mb=2000,
    params:
        voice=voice,
        settings=training_setting("train_speech"),
        source=source("train_speech"),
    script:
        "../pipeline/train_speech.py"
