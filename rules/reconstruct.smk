"""
Points on the subject's surface, frame by frame; a job works on a chunk of frames.

INPUTS:   ingested = results/{session}/ingest/{take}.json
          offsets  = results/{session}/sync/{take}.json
          timeline = results/{session}/sync/{take}.timeline.json
          rig      = results/{session}/calibrate/rig.json
          checked  = results/{session}/calibrate/bumped/{take}.json
OUTPUTS:  clouds = results/{session}/reconstruct/{take}/chunk_{chunk}.json, and the files it lists beside it:
                   frame_{frame}.ply
"""


rule reconstruct:
    """Points with normals, confidence and colour of a chunk of frames."""
    input:
        ingested="results/{session}/ingest/{take}.json",
        offsets="results/{session}/sync/{take}.json",
        timeline="results/{session}/sync/{take}.timeline.json",
        rig="results/{session}/calibrate/rig.json",
        checked="results/{session}/calibrate/bumped/{take}.json",
    output:
        clouds="results/{session}/reconstruct/{take}/chunk_{chunk}.json",
    log:
        "results/{session}/logs/reconstruct/{take}_{chunk}.log",
    benchmark:
        "results/{session}/benchmarks/reconstruct/{take}_{chunk}.tsv"
    resources:
        mem_mb=3000,
    params:
        chunk=chunk_frames("reconstruct"),
        masks=masks,
        limits=limits("reconstruct"),
        allow=setting("allow"),
        settings=setting("reconstruct"),
        source=source("reconstruct"),
    script:
        "../pipeline/reconstruct.py"
