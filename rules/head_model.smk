"""
The generic head model of a study: identities, expressions, pose and skinning.

INPUTS:   none
OUTPUTS:  model = results/{study}/head_model/base.npz
"""


rule head_model:
    """The head model before anything is learnt from the study's people."""
    output:
        model="results/{study}/head_model/base.npz",
    log:
        "results/{study}/logs/head_model.log",
    benchmark:
        "results/{study}/benchmarks/head_model.tsv"
    resources:
        mem_mb=1500,
    params:
        source=source("head_model"),
    script:
        "../pipeline/head_model.py"
