"""Lips of a head that no regressor has seen: the ICT rig's takes from one frontal camera, against their true meshes.

Needs what others made: a kit of other people (`make demo`, or HEADCAP_LIPS_KIT), the test data, and for contours of that light
the rig's own tracked meshes (`headcap run config/sessions/ict_rig.yaml`, or HEADCAP_ICT_RESULTS), which label as many frames of
each take as a study's; without them the kit's detector is used as it is. Landmarks of the first frame stand for a detector's:
the true ones, two pixels off. Who it is comes from the same camera's view of a take in which the head turns. Truth judges, and
tells in turn what each step loses.
"""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from run import measure, write

from headcap.calibration.result import load_camera, save_cameras
from headcap.cameras import Rig
from headcap.evaluation.lip_errors import LipErrors
from headcap.evaluation.lip_truth import TrueMeshes, carried_meshes, correspondence_of, judge_against, placed_neutral
from headcap.evaluation.truth import Truth
from headcap.lips.clips import Clip, ClipFiles, video_clip
from headcap.lips.contours import adapt_detector, mesh_examples
from headcap.lips.contours.settings import BoostingSettings
from headcap.lips.kit import CorrectedClip, LipKit
from headcap.lips.mesh_contours import MeshContours
from headcap.lips.monocular import MonocularTrack, track_video
from headcap.lips.monocular.person import MonocularPerson
from headcap.lips.monocular.stage import followed_clip
from headcap.lips.takes import MouthSpace, SeenTake
from headcap.lips.training import LipTrainingSettings, regressed, spread_frames
from headcap.registration.sequence import MeshSequence

TAKES, TURNING, CAMERA = ("speech_01", "expression_01"), "pose_01", "cam07"
LANDMARK_NOISE_PX, LABELLED = 2.0, LipTrainingSettings().pictures_per_take
"""Of the first frame's landmarks; frames of each take whose contours the rig's tracked meshes tell."""
DATA = Path(os.environ.get("HEADCAP_TEST_DATA", "../shared/data")) / "ict_rig"
KIT = Path(os.environ.get("HEADCAP_LIPS_KIT", "results/demo/train_lips/lips.npz"))
TRACKED = Path(os.environ.get("HEADCAP_ICT_RESULTS", "results/ict_rig"))


def run(out_path: Path) -> None:
    """Measure and write; where kit or data are missing, say so and measure nothing."""
    missing = [str(path) for path in (DATA, KIT) if not path.exists()]
    if missing:
        write(out_path, ours={"name": f"not measured, for want of {' and '.join(missing)}", "seconds": 0.0, "cpu_seconds": 0.0})
        return
    kit, truth, figures = LipKit.load(KIT), Truth(DATA / "truth"), {}
    adapted = _adapted(kit, out_path.parent)
    took, frames, person = [], 0, _person(kit, truth)
    for take in TAKES:
        clip = video_clip(DATA / "takes" / take / f"{CAMERA}.mp4", truth.rig[CAMERA])
        true, kept = TrueMeshes.of_rig(truth, take, CAMERA, clip.time_s), {}
        took.append(measure(lambda kept=kept, clip=clip, true=true: kept.update(_made(adapted, clip, true, person))))
        frames += len(clip)
        figures |= _figures(take, _judged(kit, clip, kept["track"], kept["done"], true, take))
    total = {key: sum(one[key] for one in took) / frames for key in took[0]}
    write(out_path, ours={"name": "a frame tracked, its contours found and corrected", **total}, figures=figures)


def _person(kit: LipKit, truth: Truth) -> MonocularPerson:
    """Who it is, from the same camera's view of the take in which the head turns: no truth, but the first frame's landmarks."""
    clip = video_clip(DATA / "takes" / TURNING / f"{CAMERA}.mp4", truth.rig[CAMERA])
    true = TrueMeshes.of_rig(truth, TURNING, CAMERA, clip.time_s)
    return followed_clip(kit.head, clip, kit.monocular, _landmarks(clip, true)).person


def _landmarks(clip: Clip, true: TrueMeshes) -> dict[int, np.ndarray]:
    """Of the first frame, as a detector finds them."""
    known = next(frame for frame in range(len(clip)) if true.at(frame) is not None)
    landmarks = clip.camera.project(true.at(known)[Truth(DATA / "truth").landmark_points])[0]
    landmarks += np.random.default_rng(0).normal(0.0, LANDMARK_NOISE_PX, landmarks.shape)
    return {0: landmarks}


def _made(kit: LipKit, clip: Clip, true: TrueMeshes, person: MonocularPerson) -> dict[str, MonocularTrack | CorrectedClip]:
    """As `headcap lips --person` goes about it."""
    given = (clip.time_s, _landmarks(clip, true), kit.monocular)
    track = track_video(kit.head, clip.camera, clip.pictures(), *given, person=person)
    return {"track": track, "done": kit.correct(clip, track)}


def _adapted(kit: LipKit, folder: Path) -> LipKit:
    """The kit with its detector adapted to a few frames of each take, labelled by the rig's own tracked meshes."""
    if not all((TRACKED / "track" / take / "sequence.json").exists() for take in TAKES):
        return kit
    camera, alone = load_camera(TRACKED / "calibrate" / "rig.json", CAMERA), folder / "lips_unseen.camera.json"
    folder.mkdir(parents=True, exist_ok=True)
    save_cameras(alone, Rig((camera,)))
    see, locate = _contours(kit.space), kit.finder.locator
    examples = []
    for take in TAKES:
        sync, ingested = TRACKED / "sync", TRACKED / "ingest" / f"{take}.json"
        files = ClipFiles(alone, ingested=ingested, offsets=sync / f"{take}.json", timeline=sync / f"{take}.timeline.json")
        clip, sequence = files.open(), MeshSequence.load(TRACKED / "track" / take / "sequence.json")
        meshes, chosen = sequence.positions(), spread_frames(len(clip), LABELLED)
        nearest = [int(np.abs(sequence.time_s - moment).argmin()) for moment in clip.time_s]
        labelled = [meshes[at].astype(float) if frame in chosen else None for frame, at in enumerate(nearest)]
        examples += mesh_examples("unseen", clip.pictures(), labelled, camera, see, locate)
    alone.unlink()
    return replace(kit, detector=adapt_detector(kit.detector, examples, BoostingSettings().trees))


def _judged(kit: LipKit, clip: Clip, track: MonocularTrack, done: CorrectedClip, true: TrueMeshes, take: str) -> LipErrors:
    """Base, GR and GR with contours held; then with true contours, layer and head at rest in turn."""
    space, seen, identity = kit.space, done.take, kit.regressor.identity
    tie = correspondence_of(space.model, space.mouth, seen.neutral, true)
    meshes = np.stack(list(carried_meshes(tie, true, len(seen))))
    see = _contours(space)
    exact = [see(mesh, clip.camera) if np.isfinite(mesh).all() else None for mesh in meshes]
    told = SeenTake.of(space, track, clip.camera, exact)
    parameters, ideal = (regressed(kit.regressor, {"clip": one})["clip"] for one in (seen, told))
    neutral = placed_neutral(space.model, seen.neutral, true, tie)
    layer, known = seen.parameters(neutral, meshes), seen.known(neutral)
    sequences = {
        "GR": seen.corrected(parameters, identity=identity),
        "GR reprojected": done.meshes,
        "GR true contours": told.corrected(ideal, identity=identity),
        "true layer": seen.corrected(layer),
        "base on the true head": known.base.world(known.base.meshes),
        "GR on the true head": known.corrected(regressed(kit.regressor, {"clip": known})["clip"], identity=identity),
    }
    knowing = [name for name in sequences if "true head" in name]
    return judge_against(space, seen, sequences, true, clip.time_s, person="unseen", take=take, knowing=knowing)


def _contours(space: MouthSpace) -> MeshContours:
    return MeshContours.of(np.asarray(space.model.vertices, float), space.mouth, space.model.regions)


def _figures(take: str, errors: LipErrors) -> dict[str, float]:
    """Means over the frames that all methods answered, mm and degrees."""
    common, out = errors.common, {f"{take}.frames": int(errors.truth_known.sum()), f"{take}.compared": int(errors.common.sum())}
    for row, method in enumerate(errors.methods):
        name = f"{take}.{method.replace(' ', '_')}"
        gap = (errors.gap_mm[row] - errors.gap_mm[-1])[common]
        out[f"{name}.error_mm"] = float(errors.error_mm[row][common].mean())
        out[f"{name}.shape_error_mm"] = float(errors.shape_error_mm[row][common].mean())
        out[f"{name}.gap_error_mm"] = float(np.sqrt(np.mean(gap**2)))
        out[f"{name}.roll_error_deg"] = float(errors.roll_error_deg[row][common].mean())
    return out
