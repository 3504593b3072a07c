"""
How skin follows head and jaw, and what faces do: pose correctives and expressions, learnt from the people who train.

INPUTS:   base  = results/{study}/head_model/base.npz
          files = neutral heads and tracked takes of kinds pose and expression
OUTPUTS:  head  = results/{study}/train_expressions/head.npz
"""


rule train_expressions:
    """Pose correctives and expression basis of the study's head model."""
    input:
        base="results/{study}/head_model/base.npz",
        files=training_inputs("pose", "expression"),
    output:
        head="results/{study}/train_expressions/head.npz",
    log:
        "results/{study}/logs/train_expressions.log",
    benchmark:
        "results/{study}/benchmarks/train_expressions.tsv"
    resources:
        mem_mb=3000,
    params:
        people=training_people("pose", "expression"),
        settings=training_setting("train_expressions"),
        source=source("train_expressions"),
    script:
        "../pipeline/train_expressions.py"
