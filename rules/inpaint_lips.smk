"""
Paints bare lips over the tattoos in what the lips' camera recorded of a tattooed take, before the base tracker looks at it.

INPUTS:   rig, start, ingested, offsets, sequence = the session's cameras; the head on the take's first frame, the take's
                                                    recordings, their start times, its meshes
          bare_...  = the same of the take without tattoo
OUTPUTS:  inpainted = results/{session}/inpaint_lips/{take}.json, the take as that camera alone recorded it, painted
          video     = results/{session}/inpaint_lips/{take}.mp4
          texture   = results/{session}/inpaint_lips/{take}.texture.npz, the bare lips
          picture   = results/{session}/inpaint_lips/{take}.png: frame, texture, painted texture, painted frame
"""


rule inpaint_lips:
    """A tattooed take with bare lips."""
    input:
        rig="results/{session}/calibrate/rig.json",
        start="results/{session}/track/{take}/start.npz",
        ingested="results/{session}/ingest/{take}.json",
        offsets="results/{session}/sync/{take}.json",
        sequence="results/{session}/track/{take}/sequence.json",
        bare_start=bare_take("track", "{take}/start.npz"),
        bare_ingested=bare_take("ingest", "{take}.json"),
        bare_offsets=bare_take("sync", "{take}.json"),
        bare_sequence=bare_take("track", "{take}/sequence.json"),
    output:
        inpainted="results/{session}/inpaint_lips/{take}.json",
        video="results/{session}/inpaint_lips/{take}.mp4",
        texture="results/{session}/inpaint_lips/{take}.texture.npz",
        picture="results/{session}/inpaint_lips/{take}.png",
    log:
        "results/{session}/logs/inpaint_lips/{take}.log",
    benchmark:
        "results/{session}/benchmarks/inpaint_lips/{take}.tsv"
    resources:
        mem_mb=1500,
    params:
        name=setting("lip_camera"),
        settings=setting("inpaint_lips"),
        source=source("inpaint_lips"),
    script:
        "../pipeline/inpaint_lips.py"
