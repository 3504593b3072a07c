"""Lips from a single video: tracking, contours, regression and integration per frame; training at the paper's size.

The peer solves eq. 4 as it stands, one N x N system per triangle, without cross-validation; ours tries all alpha and beta.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.linalg import solve

sys.path.insert(0, str(Path(__file__).parent))
from run import measure, write

from headcap.calibration.result import load_camera
from headcap.heads import procedural_model
from headcap.lips.clips import Clip, video_clip
from headcap.lips.contours import ContourFinder, ContourSettings, MouthLocator, mesh_examples, train_detector
from headcap.lips.contours.settings import BoostingSettings
from headcap.lips.features import DISTANCES, LipFeatures
from headcap.lips.mesh_contours import MeshContours
from headcap.lips.monocular import track_video
from headcap.lips.regression import LipTake, RegressionSettings, activations, train_regression
from headcap.lips.takes import MouthSpace, SeenTake
from headcap.registration.sequence import MeshSequence
from headcap.synthetic.mesh_files import rehearse_meshes
from headcap.synthetic.settings import MeshRehearsalSettings, TakeSettings

FRAMES, SHAPES, TAKES = 24, 3289, 12
PEER_TRIANGLES = 20
"""Systems that the peer solves; its time is scaled to all of them."""


def run(out_path: Path) -> None:
    """Measure and write."""
    space, random = MouthSpace.of(procedural_model()), np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        clip, truth = _filmed(Path(folder))
        start = time.process_time()
        track = track_video(space.model, clip.camera, clip.pictures(), clip.time_s)
        tracking_s = (time.process_time() - start) / FRAMES
        finder = _finder(space, clip, truth)
        meshes = list(track.meshes(space.model))
        found = [finder(picture, mesh, clip.camera) for picture, mesh in zip(clip.pictures(), meshes, strict=True)]
        start = time.process_time()
        found = [finder(picture, mesh, clip.camera) for picture, mesh in zip(clip.pictures(), meshes, strict=True)]
        contours_s = (time.process_time() - start) / FRAMES
    seen = SeenTake.of(space, track, clip.camera, [one.contours for one in found])
    takes = _paper_sized(space, seen.features.shape.shape[1], random)
    ours = measure(lambda: train_regression(takes, RegressionSettings()))
    trained = train_regression(takes[:2], RegressionSettings())
    told = LipFeatures(seen.features.shape, np.nan_to_num(seen.features.distances))
    seen.corrected(trained(told))
    start = time.process_time()
    seen.corrected(trained(told))
    correction_s = (time.process_time() - start) / FRAMES
    peer = _one_by_one(takes, len(space.mouth.layer))
    write(
        out_path,
        ours={"name": f"training on {SHAPES} shapes, one factor for all right-hand sides", **ours},
        peer={"name": "one system per triangle", **peer},
        figures={
            "tracking_cpu_s_per_frame_540x960": tracking_s,
            "contours_cpu_s_per_frame": contours_s,
            "regression_and_integration_cpu_s_per_frame": correction_s,
            "triangles": len(space.mouth.layer),
        },
    )


def _filmed(folder: Path) -> tuple[Clip, np.ndarray]:
    """A rehearsed person's lips at 540x960, and the true meshes."""
    takes = (TakeSettings(name="lips", kind="lips", duration_s=FRAMES / 12, lip_tattoo=False),)
    settings = MeshRehearsalSettings(seed=31, rate_hz=12, takes=takes, video={"width": 540, "height": 960})
    rehearse_meshes(settings, folder)
    return video_clip(folder / "lips.mp4", load_camera(folder / "camera.json")), MeshSequence.load(
        folder / "lips.json"
    ).positions()


def _finder(space: MouthSpace, clip: Clip, truth: np.ndarray) -> ContourFinder:
    """A detector as large as a study's, whatever it has learnt."""
    locate = MouthLocator.of(space.mouth, space.features)
    see = MeshContours.of(np.asarray(space.model.vertices, float), space.mouth, space.model.regions)
    examples = mesh_examples("bench", clip.pictures(), truth.astype(float), clip.camera, see, locate)
    detector = train_detector(examples[::3], ContourSettings(boosting=BoostingSettings()))
    return ContourFinder(detector, locate)


def _paper_sized(space: MouthSpace, shape: int, random: np.random.Generator) -> list[LipTake]:
    """As many frames as the paper's, in takes; corrections that depend on the features."""
    frames, numbers = SHAPES // TAKES, 9 * len(space.mouth.layer)
    mixing = random.normal(size=(shape + DISTANCES, 40)).astype(np.float32)
    spread = (0.02 * random.normal(size=(40, numbers))).astype(np.float32)
    out = []
    for take in range(TAKES):
        features = random.normal(size=(frames, shape + DISTANCES)).cumsum(axis=0) / 10
        layer = np.tanh(features.astype(np.float32) @ mixing / 20) @ spread
        told = LipFeatures(features[:, :shape], features[:, shape:])
        out.append(LipTake(f"person {take % 4}", f"take {take}", told, layer.reshape(frames, -1, 9)))
    return out


def _one_by_one(takes: list[LipTake], triangles: int) -> dict[str, float]:
    inputs = np.concatenate([np.concatenate([take.features.shape, take.features.distances], axis=1) for take in takes])
    neurons = activations(inputs, inputs[::10], 0.01)
    gram = neurons.T @ neurons + 0.1 * np.eye(neurons.shape[1])
    target = np.concatenate([take.parameters[:, :PEER_TRIANGLES] for take in takes])
    took = measure(lambda: [solve(gram, neurons.T @ target[:, triangle], assume_a="pos") for triangle in range(PEER_TRIANGLES)])
    return {key: value * triangles / PEER_TRIANGLES for key, value in took.items()}
