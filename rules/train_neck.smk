"""
The person's neck model, from tracked takes in which the person speaks.

INPUTS:   template  = results/{session}/register/template.npz
          rig       = results/{session}/calibrate/rig.json, which tells what cameras saw
          sequences = results/{session}/track/{take}/sequence.json of the takes of kind speech
OUTPUTS:  model  = results/{session}/train_neck/model.npz, speech blendshapes and the person's larynx
          fits   = results/{session}/train_neck/fits.npz, coefficients of every frame
          figure = results/{session}/train_neck/training.png
"""


rule train_neck:
    """Larynx and speech blendshapes of the session's person."""
    input:
        template="results/{session}/register/template.npz",
        rig="results/{session}/calibrate/rig.json",
        sequences=speech_sequences,
    output:
        model="results/{session}/train_neck/model.npz",
        fits="results/{session}/train_neck/fits.npz",
        figure="results/{session}/train_neck/training.png",
    log:
        "results/{session}/logs/train_neck.log",
    benchmark:
        "results/{session}/benchmarks/train_neck.tsv"
    resources:
        mem_mb=3000,
    params:
        person=setting("session"),
        settings=setting("train_neck"),
        source=source("train_neck"),
    script:
        "../pipeline/train_neck.py"
