"""
Follows the template through a take: one mesh per frame, in the model's topology.

INPUTS:   template = results/{session}/register/template.npz
          clouds   = results/{session}/reconstruct/{take}/chunk_{chunk}.json
          ingested, offsets, timeline, rig of the take
OUTPUTS:  start    = results/{session}/track/{take}/start.npz, the template on the first frame, textured by all cameras
          anchors  = results/{session}/track/{take}/anchors.npz, the coarse trajectory from which chunks start
          chunk    = results/{session}/track/{take}/chunk_{chunk}.npy
          sequence = results/{session}/track/{take}/sequence.json
          residuals = results/{session}/track/{take}/residuals.json, what the tracker was left with in each frame; per chunk
                      beside it
"""


rule track_start:
    """The template placed on a take's first frame, with a texture from all cameras."""
    input:
        template="results/{session}/register/template.npz",
        clouds="results/{session}/reconstruct/{take}/chunk_000.json",
        ingested="results/{session}/ingest/{take}.json",
        offsets="results/{session}/sync/{take}.json",
        timeline="results/{session}/sync/{take}.timeline.json",
        rig="results/{session}/calibrate/rig.json",
    output:
        start="results/{session}/track/{take}/start.npz",
    log:
        "results/{session}/logs/track/{take}_start.log",
    benchmark:
        "results/{session}/benchmarks/track/{take}_start.tsv"
    resources:
        mem_mb=3000,
    params:
        place=setting("place"),
        settings=setting("track"),
        source=source("track_start"),
    script:
        "../pipeline/track_start.py"


rule track_anchors:
    """The coarse trajectory of a whole take, from which its chunks start."""
    input:
        start="results/{session}/track/{take}/start.npz",
        clouds=clouds,
        ingested="results/{session}/ingest/{take}.json",
        offsets="results/{session}/sync/{take}.json",
        timeline="results/{session}/sync/{take}.timeline.json",
        rig="results/{session}/calibrate/rig.json",
    output:
        anchors="results/{session}/track/{take}/anchors.npz",
    log:
        "results/{session}/logs/track/{take}_anchors.log",
    benchmark:
        "results/{session}/benchmarks/track/{take}_anchors.tsv"
    resources:
        mem_mb=3000,
    params:
        settings=setting("track"),
        source=source("track_anchors"),
    script:
        "../pipeline/track_anchors.py"


rule track:
    """Meshes of a chunk of frames."""
    input:
        start="results/{session}/track/{take}/start.npz",
        anchors="results/{session}/track/{take}/anchors.npz",
        clouds=chunk_clouds,
        ingested="results/{session}/ingest/{take}.json",
        offsets="results/{session}/sync/{take}.json",
        timeline="results/{session}/sync/{take}.timeline.json",
        rig="results/{session}/calibrate/rig.json",
    output:
        meshes="results/{session}/track/{take}/chunk_{chunk}.npy",
        residuals="results/{session}/track/{take}/chunk_{chunk}.residuals.json",
    log:
        "results/{session}/logs/track/{take}_{chunk}.log",
    benchmark:
        "results/{session}/benchmarks/track/{take}_{chunk}.tsv"
    resources:
        mem_mb=3000,
    params:
        chunk=chunk_frames("track"),
        settings=setting("track"),
        source=source("track"),
    script:
        "../pipeline/track.py"


rule collect:
    """The chunks of a take as one mesh sequence."""
    input:
        meshes=meshes,
        chunk_residuals=chunk_residuals,
        timeline="results/{session}/sync/{take}.timeline.json",
    output:
        sequence="results/{session}/track/{take}/sequence.json",
        residuals="results/{session}/track/{take}/residuals.json",
    log:
        "results/{session}/logs/track/{take}_collect.log",
    benchmark:
        "results/{session}/benchmarks/track/{take}_collect.tsv"
    resources:
        mem_mb=1000,
    params:
        source=source("collect"),
    script:
        "../pipeline/collect.py"
