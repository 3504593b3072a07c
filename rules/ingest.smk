"""
Probes the recordings of a take, or of the board, and refuses what cannot be used.

INPUTS:   files = one recording per camera
OUTPUTS:  ingested = results/{session}/ingest/{recording}.json
          checked  = results/{session}/ingest/session.check.json: all takes agree with the board's recordings and no camera froze
          detections = results/{session}/calibrate/detections/{camera}.npz, the board in one camera's recording
"""


rule ingest:
    """Frame times, size, rate and sound of each camera's recording."""
    input:
        files=recordings,
    output:
        ingested="results/{session}/ingest/{recording}.json",
    log:
        "results/{session}/logs/ingest/{recording}.log",
    benchmark:
        "results/{session}/benchmarks/ingest/{recording}.tsv"
    resources:
        mem_mb=1000,
    params:
        recording="{recording}",
        paths=recording_paths,
        recorded=recorded,
        rate_hz=setting("rate_hz"),
        settings=setting("ingest"),
        source=source("ingest"),
    script:
        "../pipeline/ingest.py"


rule check_takes:
    """All recordings of a session beside each other."""
    input:
        ingested=session_ingested,
    output:
        checked="results/{session}/ingest/session.check.json",
    log:
        "results/{session}/logs/ingest/check.log",
    benchmark:
        "results/{session}/benchmarks/ingest/check.tsv"
    resources:
        mem_mb=500,
    params:
        manual_s=all_manual_offsets,
        settings=setting("ingest"),
        sync=setting("sync"),
        source=source("check_takes"),
    script:
        "../pipeline/check_takes.py"


rule detect:
    """Corners of the board in one camera's recording."""
    input:
        ingested="results/{session}/ingest/calibration.json",
        offsets="results/{session}/sync/board/sound.json",
    output:
        detections="results/{session}/calibrate/detections/{camera}.npz",
    log:
        "results/{session}/logs/detect/{camera}.log",
    benchmark:
        "results/{session}/benchmarks/detect/{camera}.tsv"
    resources:
        mem_mb=1000,
    params:
        camera="{camera}",
        board=board,
        settings=setting("calibrate", "detect"),
        source=source("detect"),
    script:
        "../pipeline/detect.py"
