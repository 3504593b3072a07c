"""
The sound of each speech take: of a session's from the camera that heard the voice best, of mesh subjects from their file.

INPUTS:   ingested, offsets, timeline, clapper = recordings of the take, their start times, moments of its frames, and each
                                                 camera's lag of sound behind picture
OUTPUTS:  sound = results/{session}/hear/{take}.npz or results/{person}/hear_meshes/{take}.npz
"""


rule hear:
    """The clearest sound of a take."""
    input:
        ingested="results/{session}/ingest/{take}.json",
        offsets="results/{session}/sync/{take}.json",
        timeline="results/{session}/sync/{take}.timeline.json",
        clapper="results/{session}/sync/board/clapper.json",
    output:
        sound="results/{session}/hear/{take}.npz",
    log:
        "results/{session}/logs/hear/{take}.log",
    benchmark:
        "results/{session}/benchmarks/hear/{take}.tsv"
    resources:
        mem_mb=1500,
    params:
        person=setting("session"),
        source=source("hear"),
    script:
        "../pipeline/hear.py"


rule hear_meshes:
    """The sound that came with a mesh subject's take."""
    input:
        files=mesh_sound_input,
    output:
        sound="results/{person}/hear_meshes/{take}.npz",
    log:
        "results/{person}/logs/hear_meshes/{take}.log",
    benchmark:
        "results/{person}/benchmarks/hear_meshes/{take}.tsv"
    resources:
        mem_mb=1000,
    params:
        person=person_name,
        take=take_name,
        recording=mesh_sound,
        source=source("hear_meshes"),
    script:
        "../pipeline/hear_meshes.py"
