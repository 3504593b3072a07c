"""
Finds lenses and places of the cameras from the waved board.

INPUTS:   detections = results/{session}/calibrate/detections/{camera}.npz of each camera
          offsets    = results/{session}/sync/board/sound.json
OUTPUTS:  rig     = results/{session}/calibrate/rig.json
          colmap_cameras, opencv = the rig for other programs, in results/{session}/calibrate/
"""


rule calibrate:
    """The rig, each camera's time offset by the board's motion, and held-out errors."""
    input:
        detections=detections,
        offsets="results/{session}/sync/board/sound.json",
    output:
        rig="results/{session}/calibrate/rig.json",
        colmap_cameras="results/{session}/calibrate/colmap/cameras.txt",
        opencv="results/{session}/calibrate/opencv.yaml",
    log:
        "results/{session}/logs/calibrate.log",
    benchmark:
        "results/{session}/benchmarks/calibrate.tsv"
    resources:
        mem_mb=1500,
    params:
        board=board,
        intrinsics=intrinsics,
        allow=setting("allow"),
        settings=calibrate_setting,
        source=source("calibrate"),
    script:
        "../pipeline/calibrate.py"


rule find_bumped:
    """Cameras that moved between the board's recording and a take."""
    input:
        rig="results/{session}/calibrate/rig.json",
        ingested="results/{session}/ingest/{take}.json",
        offsets="results/{session}/sync/{take}.json",
        timeline="results/{session}/sync/{take}.timeline.json",
    output:
        checked="results/{session}/calibrate/bumped/{take}.json",
    log:
        "results/{session}/logs/find_bumped/{take}.log",
    benchmark:
        "results/{session}/benchmarks/find_bumped/{take}.tsv"
    resources:
        mem_mb=1500,
    params:
        allow=setting("allow"),
        settings=setting("calibrate", "bump"),
        source=source("find_bumped"),
    script:
        "../pipeline/find_bumped.py"
