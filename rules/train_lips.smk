"""
Regressors that correct the lips of a single video: for strangers, for the people who train together, and for each of them.

INPUTS:   base  = results/{study}/head_model/base.npz
          files = base tracks, contours and true meshes of filmed takes
          detector = results/{study}/train_contours/detector.npz
OUTPUTS:  regressors = results/{study}/train_lips/{regressor}.npz
          kit        = results/{study}/train_lips/lips.npz, all that `headcap lips` needs beside a video
"""


rule train_lips:
    """All lip regressors of a study."""
    input:
        base="results/{study}/head_model/base.npz",
        detector="results/{study}/train_contours/detector.npz",
        files=[
            path
            for person in lip_training_people()
            for path in lip_person_inputs(person)
        ],
    output:
        regressors=expand(
            "results/{{study}}/train_lips/{plan.name}.npz", plan=PLAN.lip_regressors
        ),
        kit="results/{study}/train_lips/lips.npz",
    log:
        "results/{study}/logs/train_lips.log",
    benchmark:
        "results/{study}/benchmarks/train_lips.tsv"
    resources:
        mem_mb=4000,
    params:
        people=[lip_person(person) for person in lip_training_people()],
        plans=described_plans(PLAN.lip_regressors),
        settings=training_setting("train_lips"),
        monocular=training_setting("track_monocular"),
        source=source("train_lips"),
    script:
        "../pipeline/train_lips.py"
