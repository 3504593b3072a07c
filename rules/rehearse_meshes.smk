"""
Makes the takes of a study's rehearsed mesh subjects: what tracking would give, without a rig.

INPUTS:   none; the subject's `rehearse_meshes` settings
OUTPUTS:  rehearsal = results/{person}/rehearse_meshes/rehearsal.json, and beside it template.npz and per take
                      mesh sequence, sound and the larynx's true height; where `video` is set also camera.json
                      and per take <take>.mp4, frame by frame as the meshes
"""


rule rehearse_meshes:
    """Mesh sequences, voices and true larynx of one subject."""
    output:
        rehearsal="results/{person}/rehearse_meshes/rehearsal.json",
    log:
        "results/{person}/logs/rehearse_meshes.log",
    benchmark:
        "results/{person}/benchmarks/rehearse_meshes.tsv"
    resources:
        mem_mb=1500,
    params:
        settings=mesh_rehearsal,
        source=source("rehearse_meshes"),
    script:
        "../pipeline/rehearse_meshes.py"
