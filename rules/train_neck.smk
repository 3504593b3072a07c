"""
The neck model that the people who train share, from tracked takes in which they speak.

INPUTS:   head   = results/{study}/train_expressions/head.npz
          files  = neutral heads and tracked takes of kind speech
OUTPUTS:  model  = results/{study}/train_neck/model.npz, speech blendshapes and each person's larynx
          figure = results/{study}/train_neck/training.png
"""


rule train_neck:
    """Speech blendshapes and larynges of the study's people."""
    input:
        head="results/{study}/train_expressions/head.npz",
        files=training_inputs("speech"),
    output:
        model="results/{study}/train_neck/model.npz",
        figure="results/{study}/train_neck/training.png",
    log:
        "results/{study}/logs/train_neck.log",
    benchmark:
        "results/{study}/benchmarks/train_neck.tsv"
    resources:
        mem_mb=3000,
    params:
        people=training_people("speech"),
        settings=training_setting("train_neck"),
        source=source("train_neck"),
    script:
        "../pipeline/train_neck.py"
