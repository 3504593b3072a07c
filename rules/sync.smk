"""
Brings the recordings of a take onto one clock. The board's recordings come first, by sound alone; calibrate then finds
where the cameras are and when they fired, which yields
the clapper's place and each camera's own lag of sound behind picture; with them the takes are synchronised.

INPUTS:   ingested = results/{session}/ingest/{take}.json
          rig      = results/{session}/calibrate/rig.json
          clapper  = results/{session}/sync/board/clapper.json
OUTPUTS:  offsets  = results/{session}/sync/{take}.json
          timeline = results/{session}/sync/{take}.timeline.json
          figure   = results/{session}/sync/{take}.png, the clap in every camera's sound and what the pairs disagree by
"""


rule sync_board:
    """Start times of the board's recordings by sound, before the cameras' places are known."""
    input:
        ingested="results/{session}/ingest/calibration.json",
        checked="results/{session}/ingest/session.check.json",
    output:
        offsets="results/{session}/sync/board/sound.json",
    log:
        "results/{session}/logs/sync/board.log",
    benchmark:
        "results/{session}/benchmarks/sync/board.tsv"
    resources:
        mem_mb=1000,
    params:
        manual_s=setting("calibration", "offsets_s"),
        settings=setting("sync"),
        source=source("sync_board"),
    script:
        "../pipeline/sync_board.py"


rule place_clapper:
    """The clapper's place, and each camera's lag of sound behind picture: the board's sound against its motion."""
    input:
        ingested="results/{session}/ingest/calibration.json",
        rig="results/{session}/calibrate/rig.json",
        offsets="results/{session}/sync/board/sound.json",
    output:
        clapper="results/{session}/sync/board/clapper.json",
    log:
        "results/{session}/logs/sync/clapper.log",
    benchmark:
        "results/{session}/benchmarks/sync/clapper.tsv"
    resources:
        mem_mb=1000,
    params:
        clap=setting("calibration", "clap"),
        clapper_m=setting("clapper_m"),
        settings=setting("sync"),
        source=source("place_clapper"),
    script:
        "../pipeline/place_clapper.py"


checkpoint sync:
    """Start times of a take's recordings on a common clock, and the moments at which the take is worked on."""
    input:
        ingested="results/{session}/ingest/{take}.json",
        rig="results/{session}/calibrate/rig.json",
        clapper="results/{session}/sync/board/clapper.json",
    output:
        offsets="results/{session}/sync/{take}.json",
        timeline="results/{session}/sync/{take}.timeline.json",
        figure="results/{session}/sync/{take}.png",
    log:
        "results/{session}/logs/sync/{take}.log",
    benchmark:
        "results/{session}/benchmarks/sync/{take}.tsv"
    resources:
        mem_mb=1000,
    params:
        manual_s=manual_offsets,
        frames=frames_asked,
        limits=limits("sync"),
        allow=setting("allow"),
        settings=setting("sync"),
        source=source("sync"),
    script:
        "../pipeline/sync.py"
