"""
Lip contours in one camera's pictures of a take, searched from where the base tracker has the mouth.

INPUTS:   base, detector, track = results/{study}/head_model/base.npz, train_contours/detector.npz,
                                  track_monocular/{person}/{take}.npz
          files                 = the pictures
OUTPUTS:  contours = results/{study}/find_contours/{person}/{take}.npz
"""


rule find_contours:
    """Outer and inner contours of a take."""
    input:
        base="results/{study}/head_model/base.npz",
        detector="results/{study}/train_contours/detector.npz",
        track="results/{study}/track_monocular/{person}/{take}.npz",
        files=take_clip_inputs,
    output:
        contours="results/{study}/find_contours/{person}/{take}.npz",
    log:
        "results/{study}/logs/find_contours/{person}/{take}.log",
    benchmark:
        "results/{study}/benchmarks/find_contours/{person}/{take}.tsv"
    resources:
        mem_mb=1500,
    params:
        clip=take_clip,
        settings=training_setting("train_lips"),
        source=source("find_contours"),
    script:
        "../pipeline/find_contours.py"
