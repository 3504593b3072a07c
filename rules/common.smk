"""
Functions of the rules: inputs and parameters that depend on the session file.
There are no functions anywhere else in the workflow.
"""

import dataclasses
import math
import os
from pathlib import Path

from snakemake.exceptions import WorkflowError

from headcap.errors import InputError, InputErrors
from headcap.lips.contours.labels import label_files
from headcap.settings import CALIBRATION
from headcap.sync.timeline import TakeTimeline
from headcap.workflow.lock import hold_run_lock
from headcap.workflow.plan import EXPRESSION_KINDS, board_of, load_plan
from headcap.workflow.source import source_digest

# one thread per job: the workflow runs jobs side by side instead, and results do not hang on the machine's cores
for variable in (
    "NUMBA_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
):
    os.environ[variable] = "1"


def read_plan(document):
    """The checked session or study; all that is wrong with it is told before any job."""
    try:
        return load_plan(document)
    except (InputError, InputErrors) as error:
        raise WorkflowError(f"the session or study cannot be used:\n{error}") from None


def one_of(names):
    """What a wildcard may stand for."""
    return "|".join(names) or "nobody"


def repair_locks():
    """Remove the locks of a killed run; those of a run that is alive stay, and Snakemake refuses."""
    if workflow.is_main_process and hold_run_lock(Path(".snakemake")):
        logger.info("Removed the locks of a run that was killed.")


def source(stage):
    """Digest of the code that a stage's script runs."""
    return source_digest(Path(workflow.basedir) / "pipeline" / f"{stage}.py")


def session_of(wildcards):
    return PLAN.sessions[wildcards.session]


def setting(*keys):
    """An entry of the session, key by key, as plain values."""

    def entry(wildcards):
        value = session_of(wildcards).model_dump(mode="json", by_alias=True)
        for key in keys:
            value = value[key]
        return value

    return entry


def limits(stage):
    """Limits of a stage's gates, by figure."""

    def entry(wildcards):
        return session_of(wildcards).gate_limits(stage)

    return entry


def board(wildcards):
    return board_of(session_of(wildcards)).model_dump(mode="json")


def cameras(wildcards):
    """Cameras of a recording, in the rig's order."""
    return list(
        session_of(wildcards).recordings(getattr(wildcards, "recording", CALIBRATION))
    )


def takes(wildcards):
    return [take.name for take in session_of(wildcards).takes]


def all_timelines():
    return [
        f"results/{name}/sync/{take.name}.timeline.json"
        for name, session in PLAN.sessions.items()
        for take in session.takes
    ]


# ---- recordings


def recordings(wildcards):
    """Files of a recording; where the session is rehearsed, what says that they are rendered."""
    if session_of(wildcards).rehearse is not None:
        return [f"results/{wildcards.session}/rehearse/rehearsal.json"]
    return list(recording_paths(wildcards).values())


def recording_paths(wildcards):
    return session_of(wildcards).recordings(wildcards.recording)


def recorded(wildcards):
    """Kind, clap and frames of a recording, as the session says."""
    return session_of(wildcards).recorded(wildcards.recording).model_dump(mode="json")


def manual_offsets(wildcards):
    return session_of(wildcards).recorded(wildcards.take).offsets_s


def all_manual_offsets(wildcards):
    """Start times given by hand, by recording."""
    session = session_of(wildcards)
    return {
        name: session.recorded(name).offsets_s
        for name in (CALIBRATION, *takes(wildcards))
    }


def frames_asked(wildcards):
    frames = session_of(wildcards).recorded(wildcards.take).frames
    return list(frames) if frames else None


def scan(wildcards):
    session = session_of(wildcards)
    if session.rehearse is not None:
        return f"results/{wildcards.session}/rehearse/rehearsal.json"
    return session.path(session.scan.file)


def picks(wildcards):
    """Points picked on the scan, where there are some."""
    session = session_of(wildcards)
    return [session.path(session.scan.picks)] if session.scan.picks else []


def scan_paths(wildcards):
    """The scan's files, from the data root, and its unit."""
    session = session_of(wildcards)
    described = session.scan.model_dump(mode="json")
    for key in ("file", "texture", "picks"):
        described[key] = described[key] and session.path(described[key])
    return described


def truth(wildcards):
    session = session_of(wildcards)
    return session.path(session.evaluate.truth) if session.evaluate.truth else None


# ---- frames and chunks


def frame_count(session, take):
    """Frames of a take: as the session says, else known once its recordings are synchronised."""
    asked = PLAN.sessions[session].recorded(take).frames
    if asked:
        return asked[1] - asked[0] + 1
    timeline = checkpoints.sync.get(session=session, take=take).output.timeline
    return len(TakeTimeline.load(timeline))


def chunks(stage, session, take):
    """Numbers of a take's chunks in a stage."""
    frames = getattr(PLAN.sessions[session].frames_per_job, stage)
    return [
        f"{chunk:03d}"
        for chunk in range(math.ceil(frame_count(session, take) / frames))
    ]


def chunk_frames(stage):
    """First position in the take and number of frames of a chunk."""

    def entry(wildcards):
        frames = getattr(session_of(wildcards).frames_per_job, stage)
        return [int(wildcards.chunk) * frames, frames]

    return entry


def clouds(wildcards):
    """Point clouds of a whole take."""
    return [
        f"results/{wildcards.session}/reconstruct/{wildcards.take}/chunk_{chunk}.json"
        for chunk in chunks("reconstruct", wildcards.session, wildcards.take)
    ]


def chunk_clouds(wildcards):
    """Point clouds of the frames of a track chunk."""
    per_track = session_of(wildcards).frames_per_job.track
    per_cloud = session_of(wildcards).frames_per_job.reconstruct
    first = int(wildcards.chunk) * per_track
    last = min(first + per_track, frame_count(wildcards.session, wildcards.take)) - 1
    folder = f"results/{wildcards.session}/reconstruct/{wildcards.take}"
    return [
        f"{folder}/chunk_{chunk:03d}.json"
        for chunk in range(first // per_cloud, last // per_cloud + 1)
    ]


def meshes(wildcards):
    """Meshes of a whole take."""
    return [
        f"results/{wildcards.session}/track/{wildcards.take}/chunk_{chunk}.npy"
        for chunk in chunks("track", wildcards.session, wildcards.take)
    ]


def chunk_residuals(wildcards):
    """What the tracker was left with, chunk by chunk, of a whole take."""
    return [mesh.removesuffix(".npy") + ".residuals.json" for mesh in meshes(wildcards)]


def session_clouds(wildcards):
    """Point clouds of all takes."""
    return [
        f"results/{wildcards.session}/reconstruct/{take}/chunk_{chunk}.json"
        for take in takes(wildcards)
        for chunk in chunks("reconstruct", wildcards.session, take)
    ]


# ---- stages


def session_ingested(wildcards):
    return [
        f"results/{wildcards.session}/ingest/{name}.json"
        for name in (CALIBRATION, *takes(wildcards))
    ]


def detections(wildcards):
    return [
        f"results/{wildcards.session}/calibrate/detections/{camera}.npz"
        for camera in cameras(wildcards)
    ]


def intrinsics(wildcards):
    """Lenses that the session file gives, by camera."""
    described = session_of(wildcards).cameras
    return {
        camera.name: camera.intrinsics.model_dump(mode="json")
        for camera in described
        if camera.intrinsics
    }


def calibrate_setting(wildcards):
    """Settings of calibrate, with the session's own limits of its gates."""
    settings = setting("calibrate")(wildcards)
    own = {
        figure.removeprefix("calibrate."): limit
        for figure, limit in session_of(wildcards).limits.items()
    }
    return settings | {
        "limits": settings["limits"]
        | {name: own[name] for name in settings["limits"] if name in own}
    }


def masks(wildcards):
    session, take = session_of(wildcards), session_of(wildcards).recorded(
        wildcards.take
    )
    return session.path(take.masks) if take.masks else None


def session_results(wildcards):
    """What evaluate and report read: the results of every stage and take."""
    folder, names = f"results/{wildcards.session}", takes(wildcards)
    return {
        "rig": f"{folder}/calibrate/rig.json",
        "template": f"{folder}/register/template.npz",
        "ingested": [f"{folder}/ingest/{take}.json" for take in names],
        "offsets": [f"{folder}/sync/{take}.json" for take in names],
        "timelines": [f"{folder}/sync/{take}.timeline.json" for take in names],
        "clouds": session_clouds(wildcards),
        "starts": [f"{folder}/track/{take}/start.npz" for take in names],
        "sequences": [f"{folder}/track/{take}/sequence.json" for take in names],
    }


def neck_pictures(wildcards):
    """What fitting the neck model to the person, and training on the person's voice, drew."""
    folder, person = f"results/{PLAN.name}", wildcards.session
    if person not in PLAN.neck_people:
        return []
    voices = [f"{folder}/train_speech/{person}.png"] if person in PLAN.voices else []
    return [f"{folder}/fit_neck/{person}/fits.png", *voices]


def neck_figures(wildcards):
    """What the study's neck model says of the person, where one is trained."""
    if wildcards.session not in PLAN.neck_people:
        return []
    return [f"results/{PLAN.name}/evaluate_neck/figures.json"]


def sync_figures(wildcards):
    """What sync drew of each take."""
    return [f"results/{wildcards.session}/sync/{take}.png" for take in takes(wildcards)]


def take_residuals(wildcards):
    """What the tracker was left with in each take."""
    return [
        f"results/{wildcards.session}/track/{take}/residuals.json"
        for take in takes(wildcards)
    ]


def evaluate_setting(wildcards):
    """Sampling of the evaluation, with the session's own limits of figures."""
    session = session_of(wildcards)
    settings = session.evaluate.model_dump(mode="json", exclude={"truth"})
    return settings | {"limits": settings["limits"] | session.figure_limits()}


def described_session(wildcards):
    return session_of(wildcards).model_dump(mode="json")


# ---- people of the study


def mesh_rehearsal(wildcards):
    return PLAN.meshes[wildcards.person].rehearse_meshes.model_dump(mode="json")


def training_setting(stage):
    """Settings of a stage that the whole study shares."""
    return getattr(PLAN.study, stage).model_dump(mode="json")


def person_name(wildcards):
    return wildcards.person


def take_name(wildcards):
    return wildcards.take


def subject_files(person, *kinds):
    """Where a person's neutral head and takes of some kinds, or of all, lie."""
    kinds = PLAN.takes(person, *kinds)
    if person in PLAN.sessions:
        folder = f"results/{person}"
        rig, template = (
            f"{folder}/calibrate/rig.json",
            f"{folder}/register/template.npz",
        )
        sequences = {take: f"{folder}/track/{take}/sequence.json" for take in kinds}
    else:
        rig, template = None, PLAN.meshes[person].template
        sequences = {take: PLAN.meshes[person].take(take).sequence for take in kinds}
    return {
        "name": person,
        "template": template,
        "sequences": sequences,
        "kinds": kinds,
        "rig": rig,
    }


def subject_inputs(person, *kinds):
    """What makes these files."""
    files = subject_files(person, *kinds)
    if person in PLAN.sessions:
        return [files["template"], files["rig"], *files["sequences"].values()]
    return mesh_inputs(person, [files["template"], *files["sequences"].values()])


def mesh_inputs(person, paths):
    """Files of a person who comes as meshes; where they are rehearsed, what says that they are there."""
    if PLAN.meshes[person].rehearse_meshes is not None:
        return [f"results/{person}/rehearse_meshes/rehearsal.json"]
    return paths


def training_people(*kinds):
    """People that a stage is trained on, with their takes of the kinds it learns from."""
    return [
        subject_files(person, *kinds)
        for person in PLAN.training
        if PLAN.takes(person, *kinds)
    ]


def training_inputs(*kinds):
    return [
        path
        for person in PLAN.training
        if PLAN.takes(person, *kinds)
        for path in subject_inputs(person, *kinds)
    ]


def person_files(wildcards):
    return subject_files(wildcards.person)


def person_inputs(wildcards):
    return subject_inputs(wildcards.person)


def is_held_out(wildcards):
    return wildcards.person in PLAN.study.held_out


def mesh_sound(wildcards):
    return PLAN.meshes[wildcards.person].take(wildcards.take).sound


def mesh_sound_input(wildcards):
    return mesh_inputs(wildcards.person, [mesh_sound(wildcards)])


def take_sounds(people):
    """What was heard of the speech takes of some people."""
    return [
        f"results/{person}/{'hear' if person in PLAN.sessions else 'hear_meshes'}/{take}.npz"
        for person in people
        for take in PLAN.heard(person)
    ]


def voice_sounds(wildcards):
    return take_sounds(PLAN.voices[wildcards.voice].people)


def voice_fits(wildcards):
    return [
        f"results/{PLAN.name}/fit_neck/{person}/fits.npz"
        for person in PLAN.voices[wildcards.voice].people
    ]


def voice(wildcards):
    """Whose voices train a regressor, and what of the neck it drives."""
    return PLAN.voices[wildcards.voice].model_dump(mode="json")


def study_name(wildcards):
    return PLAN.name


def neck_fits(wildcards):
    """What the study's neck model says of everybody."""
    folder = f"results/{PLAN.name}/fit_neck"
    return [f"{folder}/{person}/fits.npz" for person in PLAN.neck_people]


def neck_models(wildcards):
    """The study's neck model with each person alone."""
    folder = f"results/{PLAN.name}/fit_neck"
    return [f"{folder}/{person}/model.npz" for person in PLAN.neck_people]


def voice_regressors(wildcards):
    folder = f"results/{PLAN.name}/train_speech"
    return [f"{folder}/{name}.npz" for name in PLAN.voices]


def voice_names(wildcards):
    return list(PLAN.voices)


def voice_groups(wildcards):
    return {group.name: list(group.people) for group in PLAN.study.groups}


def all_sounds(wildcards):
    return take_sounds(PLAN.neck_people)


def all_people(wildcards):
    return [subject_files(person) for person in PLAN.neck_people]


def described_study(wildcards):
    """The study file, sessions by name alone: their own pages tell the rest."""
    described = PLAN.study.model_dump(mode="json")
    return described | {"sessions": list(PLAN.sessions)}


def voice_errors(wildcards):
    """How well each voice's regressor does on what it did not hear."""
    folder = f"results/{PLAN.name}/train_speech"
    return [f"{folder}/{name}.errors.json" for name in PLAN.voices]


# ---- lips


def bare_take(stage, file):
    """What a stage made of the take that shows a session's lips without their tattoo."""

    def entry(wildcards):
        take = session_of(wildcards).bare_take
        return f"results/{wildcards.session}/{stage}/{file.format(take=take)}"

    return entry


def lip_recordings(session, take):
    """Recordings that the base tracker reads: where the lips are tattooed, what one camera saw with the tattoo painted over."""
    tattooed = take in PLAN.sessions[session].tattooed_takes
    return f"results/{session}/{'inpaint_lips' if tattooed else 'ingest'}/{take}.json"


def take_lip_recordings(wildcards):
    return lip_recordings(wildcards.session, wildcards.take)


def all_inpainted(wildcards):
    """The paper's figure 5 of each tattooed take."""
    return [
        f"results/{person}/inpaint_lips/{take}.png" for person, take in PLAN.inpainted
    ]


def mesh_video(wildcards):
    return PLAN.meshes[wildcards.mesh_person].take(wildcards.take).video


def mesh_camera(wildcards):
    return PLAN.meshes[wildcards.mesh_person].camera


def mesh_video_input(wildcards):
    return mesh_inputs(
        wildcards.mesh_person, [mesh_video(wildcards), mesh_camera(wildcards)]
    )


def turned_track(person, take):
    """The base track of the take in which the person turns the head, which tells those of the others who that is."""
    turning = PLAN.turning_take(person)
    if turning in (None, take):
        return []
    return [f"results/{PLAN.name}/track_monocular/{person}/{turning}.npz"]


def take_turned_track(wildcards):
    return turned_track(wildcards.session, wildcards.take)


def mesh_turned_track(wildcards):
    return turned_track(wildcards.mesh_person, wildcards.take)


def take_tells_who_alone(wildcards):
    """Whether a take's track tells who somebody is and nothing else: no lips are corrected in it."""
    return wildcards.take not in PLAN.filmed(wildcards.session)


def mesh_tells_who_alone(wildcards):
    return wildcards.take not in PLAN.filmed(wildcards.mesh_person)


def lip_clip(person, take):
    """Where what one camera saw of a take lies."""
    camera = f"results/{PLAN.name}/track_monocular/{person}/{take}.camera.json"
    if person in PLAN.sessions:
        folder = f"results/{person}"
        return {
            "camera": camera,
            "ingested": lip_recordings(person, take),
            "offsets": f"{folder}/sync/{take}.json",
            "timeline": f"{folder}/sync/{take}.timeline.json",
        }
    return {"camera": camera, "video": PLAN.meshes[person].take(take).video}


def lip_clip_inputs(person, take):
    files = [path for key, path in lip_clip(person, take).items() if key != "video"]
    if person in PLAN.sessions:
        return files
    return files + mesh_inputs(person, [PLAN.meshes[person].take(take).video])


def lip_person(person):
    """Where a person's filmed takes lie, and what is true of them."""
    known, folder = subject_files(person), f"results/{PLAN.name}"
    # a scan is in a frame of its own, which no comparison minds
    return {
        "name": person,
        "template": known["template"],
        "takes": [
            {
                "name": take,
                "kind": PLAN.takes(person)[take],
                "clip": lip_clip(person, take),
                "track": f"{folder}/track_monocular/{person}/{take}.npz",
                "contours": f"{folder}/find_contours/{person}/{take}.npz",
                "sequence": known["sequences"][take],
            }
            for take in PLAN.filmed(person)
        ],
    }


def lip_person_inputs(person, contours=True):
    """What makes these files."""
    described = lip_person(person)
    files = [*subject_inputs(person)]
    for take in described["takes"]:
        files += [take["track"], *lip_clip_inputs(person, take["name"])]
        files += [take["contours"]] if contours else []
    return files


def lip_training_people():
    return [name for name in PLAN.lip_people if name in PLAN.training]


def lip_label_files():
    """Files of contours that were drawn by hand."""
    labels = PLAN.study.train_lips.labels
    return [
        str(path)
        for takes in labels.values()
        for drawn in takes.values()
        for path in label_files(drawn)
    ]


def take_clip(wildcards):
    return lip_clip(wildcards.person, wildcards.take)


def take_clip_inputs(wildcards):
    return lip_clip_inputs(wildcards.person, wildcards.take)


def lip_regressors(names):
    return [f"results/{PLAN.name}/train_lips/{name}.npz" for name in names]


def tested_plans(person):
    """Regressors that a person's takes test, the one that a user gets first."""
    return [plan for plan in PLAN.lip_regressors if plan.tests(person)]


def lip_tested_files(person, suffix):
    return [
        f"results/{PLAN.name}/correct_lips/{person}/{take}{suffix}"
        for take in PLAN.lip_tests(person)
    ]


def lip_learnt_from(person):
    """Takes from which a person's own lip blendshapes are taken, where somebody trains."""
    tests = PLAN.lip_tests(person)
    if person not in PLAN.training:
        return []
    return [take for take in PLAN.filmed(person) if take not in tests]


def described_plans(plans):
    return [dataclasses.asdict(plan) for plan in plans]


def lip_files(kind, suffix):
    """Of every tested take."""
    return [
        f"results/{PLAN.name}/{kind}/{person}/{take}{suffix}"
        for person in PLAN.lip_tested
        for take in PLAN.lip_tests(person)
    ]


def lip_person_files(name):
    """Of everybody whose takes are tested."""
    return [
        f"results/{PLAN.name}/correct_lips/{person}/{name}"
        for person in PLAN.lip_tested
    ]


def all_lip_sheets(wildcards):
    return [
        f"results/{PLAN.name}/track_monocular/{person}/{take}.png"
        for person in PLAN.lip_people
        for take in PLAN.filmed(person)
    ]


def lip_roles(wildcards):
    """What everybody whose takes are tested is to the study."""
    return {
        person: ("trained on" if person in PLAN.training else "held out")
        + (
            ", from recordings"
            if person in PLAN.sessions
            else ", as meshes and a video"
        )
        + f": {', '.join(PLAN.lip_tests(person))}"
        for person in PLAN.lip_tested
    }


# ---- expressions


def expression_person(wildcards):
    """A person's neutral head, takes that tell what the face does, and hand-made expressions."""
    files = subject_files(wildcards.person, *EXPRESSION_KINDS)
    return {key: files[key] for key in ("name", "template", "sequences")} | {
        "basis": PLAN.expression_basis(wildcards.person)
    }


def expression_inputs(wildcards):
    """What makes these files."""
    person = wildcards.person
    files = subject_inputs(person, *EXPRESSION_KINDS)
    if person in PLAN.meshes:
        return sorted({*files, *mesh_inputs(person, [PLAN.expression_basis(person)])})
    if PLAN.sessions[person].rehearse is not None:
        return [*files, f"results/{person}/rehearse/rehearsal.json"]
    return [*files, PLAN.expression_basis(person)]


def expression_limits(wildcards):
    """Limits of figures of a person's expressions."""
    return {
        figure: limit
        for figure, limit in PLAN.limits(wildcards.person).items()
        if figure.startswith("quasi_eigen.")
    }


def expression_figures(wildcards):
    """What is said of the expressions of a session's person, where there are hand-made ones."""
    if wildcards.session not in PLAN.expression_people:
        return []
    return [f"results/{wildcards.session}/quasi_eigen/figures.json"]


def expression_pages():
    return [
        f"results/{person}/report_expressions/expressions.html"
        for person in PLAN.expression_people
    ]


# ---- the study


def study_parts(wildcards):
    """Files of figures that make up the study's."""
    necks = (
        [f"results/{PLAN.name}/evaluate_neck/figures.json"] if PLAN.neck_people else []
    )
    lips = (
        [f"results/{PLAN.name}/evaluate_lips/figures.json"] if PLAN.lip_tested else []
    )
    return [
        *(f"results/{name}/metrics.json" for name in PLAN.sessions),
        *necks,
        *lips,
        *(
            f"results/{name}/quasi_eigen/figures.json"
            for name in PLAN.expression_people
        ),
    ]


def larynx_truths(wildcards):
    """Where the true larynx of speech takes is known, and nothing of it before `evaluate_neck`."""
    found = []
    for person in PLAN.neck_people:
        for take in PLAN.takes(person, "speech"):
            entry = {"person": person, "take": take}
            if person in PLAN.meshes:
                entry["heights"] = PLAN.meshes[person].take(take).larynx
            elif PLAN.sessions[person].evaluate.truth:
                session = PLAN.sessions[person]
                entry["truth"] = session.path(session.evaluate.truth)
                entry["offsets"] = f"results/{person}/sync/{take}.json"
            if "offsets" in entry or entry.get("heights"):
                found.append(entry)
    return found


def people_limits(wildcards):
    """Limits of figures by person."""
    return {
        person: {
            figure: limit
            for figure, limit in PLAN.limits(person).items()
            if figure.startswith("neck.")
        }
        for person in PLAN.neck_people
    }


def recorded_people(wildcards):
    return list(PLAN.sessions)


def study_results():
    """What a study shows beside its sessions."""
    folder = f"results/{PLAN.name}"
    pages = [f"{folder}/report_neck/neck.html"] if PLAN.neck_people else []
    pages += [f"{folder}/report_lips/lips.html"] if PLAN.lip_tested else []
    pages += lip_regressors(["lips"]) if PLAN.lip_people else []
    pages += expression_pages()
    return pages if PLAN.is_session else [*pages, f"{folder}/metrics.json"]
