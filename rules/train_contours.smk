"""
What lip contours look like: boosted edge detectors, learnt from pictures of the people who train and what their true meshes show.

INPUTS:   base  = results/{study}/head_model/base.npz
          files = base tracks, true meshes and pictures of filmed takes
          labels = contours drawn by hand, of takes that have some (train_lips.labels)
OUTPUTS:  detector = results/{study}/train_contours/detector.npz
"""


rule train_contours:
    """Detector of outer and inner lip contours."""
    input:
        base="results/{study}/head_model/base.npz",
        files=[
            path
            for person in lip_training_people()
            for path in lip_person_inputs(person, contours=False)
        ],
        labels=lip_label_files(),
    output:
        detector="results/{study}/train_contours/detector.npz",
    log:
        "results/{study}/logs/train_contours.log",
    benchmark:
        "results/{study}/benchmarks/train_contours.tsv"
    resources:
        mem_mb=3000,
    params:
        people=[lip_person(person) for person in lip_training_people()],
        settings=training_setting("train_lips"),
        source=source("train_contours"),
    script:
        "../pipeline/train_contours.py"
