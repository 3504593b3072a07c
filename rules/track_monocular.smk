"""
What the base tracker makes of one camera's view of each take: of a session's most frontal camera (or its `lip_camera`), of mesh
subjects' videos.

INPUTS:   base  = results/{study}/head_model/base.npz
          turned = results/{study}/track_monocular/{person}/{take}.npz of a filmed take of kind pose, where the person has one:
                   the head turns in it, and its track tells those of the other takes who that is
          rig, start, ingested, offsets, timeline = the session's cameras, the head on the take's first frame, its recordings
                                                    (where the lips are tattooed, the painted one of that camera), their
                                                    start times and the moments of its frames
OUTPUTS:  track   = results/{study}/track_monocular/{person}/{take}.npz; of a take in which the head turns those frames alone that
                    told who it is
          camera  = results/{study}/track_monocular/{person}/{take}.camera.json
          picture = results/{study}/track_monocular/{person}/{take}.png, frames with the face drawn over them
"""


rule track_monocular:
    """A session's take through the eyes of one camera."""
    input:
        base="results/{study}/head_model/base.npz",
        turned=take_turned_track,
        rig="results/{session}/calibrate/rig.json",
        start="results/{session}/track/{take}/start.npz",
        ingested=take_lip_recordings,
        offsets="results/{session}/sync/{take}.json",
        timeline="results/{session}/sync/{take}.timeline.json",
    output:
        track="results/{study}/track_monocular/{session}/{take}.npz",
        camera="results/{study}/track_monocular/{session}/{take}.camera.json",
        picture="results/{study}/track_monocular/{session}/{take}.png",
    log:
        "results/{study}/logs/track_monocular/{session}/{take}.log",
    benchmark:
        "results/{study}/benchmarks/track_monocular/{session}/{take}.tsv"
    resources:
        mem_mb=1500,
    params:
        name=setting("lip_camera"),
        who_alone=take_tells_who_alone,
        settings=training_setting("track_monocular"),
        source=source("track_monocular"),
    script:
        "../pipeline/track_monocular.py"


rule track_monocular_meshes:
    """A mesh subject's take through the eyes of the camera that filmed it."""
    input:
        base="results/{study}/head_model/base.npz",
        turned=mesh_turned_track,
        files=mesh_video_input,
    output:
        track="results/{study}/track_monocular/{mesh_person}/{take}.npz",
        camera="results/{study}/track_monocular/{mesh_person}/{take}.camera.json",
        picture="results/{study}/track_monocular/{mesh_person}/{take}.png",
    log:
        "results/{study}/logs/track_monocular/{mesh_person}/{take}.log",
    benchmark:
        "results/{study}/benchmarks/track_monocular/{mesh_person}/{take}.tsv"
    resources:
        mem_mb=1500,
    params:
        video=mesh_video,
        filmed_by=mesh_camera,
        who_alone=mesh_tells_who_alone,
        settings=training_setting("track_monocular"),
        source=source("track_monocular_meshes"),
    script:
        "../pipeline/track_monocular_meshes.py"
