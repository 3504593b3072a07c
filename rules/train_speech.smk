"""
From the person's voice to the coefficients of their neck model, from the takes that the model was fitted to.

INPUTS:   model, fits = results/{session}/train_neck/model.npz, fits.npz
          ingested, offsets of the takes of kind speech: their sound, and when it was heard
          clapper     = results/{session}/sync/board/clapper.json, each camera's lag of sound behind picture
OUTPUTS:  regressor   = results/{session}/train_speech/regressor.npz
          figure      = results/{session}/train_speech/prediction.png, coefficients fitted and predicted
"""


rule train_speech:
    """Speech regressors of the session's person."""
    input:
        model="results/{session}/train_neck/model.npz",
        fits="results/{session}/train_neck/fits.npz",
        ingested=speech_ingested,
        offsets=speech_offsets,
        clapper="results/{session}/sync/board/clapper.json",
    output:
        regressor="results/{session}/train_speech/regressor.npz",
        figure="results/{session}/train_speech/prediction.png",
    log:
        "results/{session}/logs/train_speech.log",
    benchmark:
        "results/{session}/benchmarks/train_speech.tsv"
    resources:
        mem_mb=2000,
    params:
        settings=setting("train_speech"),
        source=source("train_speech"),
    script:
        "../pipeline/train_speech.py"
