"""From a results folder to the report's inputs: the right photographs, clouds and errors, and nothing that is not there."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from headcap.artifacts import write_manifest
from headcap.evaluation.metrics import save_metrics
from headcap.evaluation.session import SessionFolder
from headcap.recordings.probe import probe
from headcap.recordings.takes import IngestedTake
from headcap.registration import MeshSequence
from headcap.registration.sequence import save_chunk
from headcap.report.collect import SessionDescription, collect_report, sampled_frames, telling_cameras

FRAMES = 6
DESCRIBED = SessionDescription("study_one", "somebody", 10.0, ("smile", "absent"))


def write_movie(path: Path, shade: int) -> None:
    """A grey picture that gets 10 lighter with each frame, ten frames a second."""
    movie = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 10.0, (160, 200))
    for frame in range(FRAMES):
        movie.write(np.full((200, 160, 3), shade + 10 * frame, np.uint8))
    movie.release()


@pytest.fixture(scope="module")
def folder(inputs, rig, template, tmp_path_factory) -> Path:
    """The results of a session of four cameras and one take of six frames, of which two have a cloud."""
    root = tmp_path_factory.mktemp("results")
    session = SessionFolder(root / "study_one")
    take = inputs.takes[0]
    for index, name in enumerate(rig.names):
        write_movie(root / f"{name}.mp4", 40 + 30 * index)
    recordings = tuple(probe(root / f"{name}.mp4") for name in rig.names)
    (session.folder / "ingest").mkdir(parents=True)
    IngestedTake("smile", "expression", recordings).save(session.folder / "ingest" / "smile.json")
    offsets = replace(take.offsets, start_s=(0.0,) * len(rig))
    offsets.save(session.offsets("smile"))
    inputs.calibration.result.save(session.folder / "calibrate" / "rig.json")
    template.save(session.template)
    moved = np.array([0.0, 1, 3, 2, 1, 4])[:, None, None] * 1e-3
    session.sequence("smile").parent.mkdir(parents=True)
    save_chunk(session.sequence("smile").parent / "chunk_000.npy", template.vertices + moved)
    times = np.arange(FRAMES) / 10
    MeshSequence("smile", times, (session.sequence("smile").parent / "chunk_000.npy",)).save(session.sequence("smile"))
    for frame in (2, 5):
        points = (template.vertices + moved[frame]).astype(np.float32)
        cloud = replace(take.views[0].cloud, positions=points, time_s=float(times[frame]))
        cloud.save(session.folder / "reconstruct" / "smile" / f"frame_{frame:06d}.ply")
    take.residuals.save(session.residuals("smile"))
    cv2.imwrite(str(session.sync_figure("smile")), np.full((20, 30, 3), (10, 20, 200), np.uint8))
    save_metrics(session.metrics, inputs.figures)
    write_manifest(session.template, kind="template", stage="register", settings_digest="", inputs=[], figures={})
    return session.folder


def test_photographs_are_those_of_the_moment_and_the_camera(folder):
    take = collect_report(folder, DESCRIBED, frames_per_take=2, cameras_per_frame=2).takes[0]
    assert [(view.frame, view.camera.name) for view in take.views] == [(2, "cam01"), (2, "cam00"), (5, "cam01"), (5, "cam00")]
    for view in take.views:
        shade = 40 + 30 * int(view.camera.name[-1]) + 10 * view.frame
        # a flat grey survives the codec to within its quantiser, a few levels
        assert abs(float(view.photograph.mean()) - shade) < 5
        assert view.cloud is not None
        assert view.cloud.time_s == view.time_s


def test_points_are_measured_against_the_mesh_of_their_frame(folder):
    gaps = collect_report(folder, DESCRIBED).takes[0].gaps
    assert gaps.frames.tolist() == [2, 5]
    assert gaps.p95_mm.max() < 1e-3


def test_what_stages_drew_and_wrote_of_a_take_is_kept(folder, inputs):
    take = collect_report(folder, DESCRIBED).takes[0]
    assert take.sync_figure[0, 0].tolist() == [200, 20, 10]
    assert take.residuals.worst == inputs.takes[0].residuals.worst


def test_takes_and_truth_that_are_not_there_are_left_out(folder):
    collected = collect_report(folder, DESCRIBED)
    assert [take.take for take in collected.takes] == ["smile"]
    assert collected.takes[0].errors is None
    assert collected.takes[0].true_start_s is None
    assert len(collected.figures) == 3
    assert [path for path, _ in collected.manifests] == ["register/template.npz"]


def test_an_empty_folder_makes_an_empty_report(tmp_path):
    collected = collect_report(tmp_path, DESCRIBED)
    assert (collected.takes, collected.calibration, collected.register, collected.figures) == ((), None, None, ())


def test_frames_are_sampled_where_the_mesh_has_moved_most():
    positions = np.array([0.0, 1, 3, 2, 1, 4, 0])[:, None, None] * np.ones((1, 2, 3))
    assert sampled_frames(positions, 3) == [2, 3, 5]
    assert sampled_frames(positions[:1], 3) == [0]


def test_the_frontal_camera_tells_most_and_the_oblique_one_next(rig, template):
    # azimuths -50, -5, 30 and 70 degrees
    assert telling_cameras(rig, template.vertices)[:2] == ["cam01", "cam00"]
