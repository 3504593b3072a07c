"""From a session's results folder to what its report shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from headcap.artifacts import Manifest
from headcap.calibration.board import BoardSettings
from headcap.calibration.detection import CameraDetections
from headcap.calibration.result import CalibrationResult, SolvedPose
from headcap.cameras import Rig
from headcap.evaluation.metrics import load_metrics
from headcap.evaluation.registration import compare_registration
from headcap.evaluation.session import SessionFolder, cloud_distance_mm, spread
from headcap.evaluation.tracking import TrackingErrors
from headcap.evaluation.truth import Truth
from headcap.reconstruction.points import PointCloud
from headcap.recordings.frames import TakeFrames
from headcap.recordings.takes import IngestedTake
from headcap.recordings.video import VideoFrames
from headcap.registration.residuals import TrackResiduals
from headcap.registration.sequence import MeshSequence
from headcap.registration.template import Template
from headcap.report.inputs import (
    BoardPicture,
    CalibrationReport,
    CloudGaps,
    FrameView,
    RegisterReport,
    ReportInputs,
    TakeReport,
)
from headcap.report.provenance import versions
from headcap.sync.offsets import TimeOffsets
from headcap.sync.timeline import open_take


@dataclass(frozen=True)
class SessionDescription:
    """What the session file says that a report shows."""

    session: str
    subject: str
    rate_hz: float
    takes: tuple[str, ...]
    board: BoardSettings | None = None
    allowed: tuple[str, ...] = ()
    rehearsed: bool = False
    settings: dict | None = None
    truth: Path | None = None
    """The truth folder; only start times are read from it, all errors come from what `evaluate` wrote."""


def collect_report(
    folder: Path,
    described: SessionDescription,
    *,
    scan: tuple[NDArray, NDArray] | None = None,
    neck_pictures: Sequence[Path] = (),
    frames_per_take: int = 3,
    cameras_per_frame: int = 2,
    board_pictures: int = 4,
) -> ReportInputs:
    """Read the results of a session (`results/<session>`); what a run has not made is left out.

    `scan` is the session's scan, vertices (v, 3) in metres and triangles (m, 3), in the frame of the registered template.
    `neck_pictures` are what fitting the neck model and training the person's voice drew.
    """
    session = SessionFolder(folder)
    rig_path = folder / "calibrate" / "rig.json"
    result = CalibrationResult.load(rig_path) if rig_path.is_file() else None
    truth = Truth(described.truth) if described.truth else None
    takes = ()
    if result is not None and session.template.is_file():
        takes = tuple(
            _take(session, take, result.rig, truth, frames_per_take, cameras_per_frame)
            for take in described.takes
            if session.sequence(take).is_file()
        )
    return ReportInputs(
        session=described.session,
        subject=described.subject,
        rate_hz=described.rate_hz,
        figures=load_metrics(session.metrics) if session.metrics.is_file() else (),
        calibration=_calibration(folder, result, described.board, board_pictures) if result else None,
        register=_register(session, described.takes, scan) if session.template.is_file() else None,
        takes=takes,
        neck_pictures=tuple(_picture(path) for path in neck_pictures),
        allowed=described.allowed,
        rehearsed=described.rehearsed,
        manifests=_manifests(folder),
        versions=versions(),
        settings=described.settings or {},
    )


def _manifests(folder: Path) -> tuple[tuple[str, Manifest], ...]:
    """Manifests below the folder; of artifacts that come in many pieces the first of each folder and kind."""
    found: dict[tuple, tuple[str, Manifest]] = {}
    for path in sorted(folder.rglob("*.manifest.json")):
        manifest = Manifest.load(path)
        name = str(path.relative_to(folder)).removesuffix(".manifest.json")
        found.setdefault((path.parent, manifest.kind), (name, manifest))
    return tuple(found.values())


def _register(session: SessionFolder, takes: tuple[str, ...], scan: tuple[NDArray, NDArray] | None) -> RegisterReport:
    template = Template.load(session.template)
    errors = compare_registration(template, *scan).surface_mm if scan else None
    starts = [session.folder / "track" / take / "start.npz" for take in takes]
    textured = next((Template.load(path) for path in starts if path.is_file()), None)
    if textured is not None and textured.texture is not None:
        template = template.with_texture(textured.texture, textured.texture_known)
    return RegisterReport(template, *(scan or (None, None)), errors)


def _take(
    session: SessionFolder, take: str, rig: Rig, truth: Truth | None, frames_per_take: int, cameras_per_frame: int
) -> TakeReport:
    sequence, triangles = MeshSequence.load(session.sequence(take)), Template.load(session.template).triangles
    offsets, ingested = TimeOffsets.load(session.offsets(take)), IngestedTake.load(session.folder / "ingest" / f"{take}.json")
    errors_path = session.tracking_errors(take)
    errors = TrackingErrors.load(errors_path) if errors_path.is_file() else None
    positions = sequence.positions()
    with open_take(ingested, offsets) as frames:
        views = _views(session, sequence, positions, errors, frames, rig, frames_per_take, cameras_per_frame)
    return TakeReport(
        take=take,
        kind=ingested.kind,
        frames=len(sequence),
        offsets=offsets,
        true_start_s=truth.start_s(take) if truth and take in truth.takes else None,
        views=tuple(views),
        gaps=_gaps(session, take, sequence, positions, triangles),
        errors=errors,
        neutral=positions[0],
        residuals=TrackResiduals.load(left) if (left := session.residuals(take)).is_file() else None,
        sync_figure=_picture(session.sync_figure(take)),
    )


def _picture(path: Path) -> NDArray[np.uint8] | None:
    """An image file as RGB, where it is there."""
    if not path.is_file():
        return None
    return np.asarray(PillowImage.open(path).convert("RGB"))


def _views(
    session: SessionFolder,
    sequence: MeshSequence,
    positions: NDArray,
    errors: TrackingErrors | None,
    frames: TakeFrames,
    rig: Rig,
    frames_per_take: int,
    cameras_per_frame: int,
) -> list[FrameView]:
    clouds, views = session.clouds(sequence.take), []
    cameras = [name for name in telling_cameras(rig, positions[0]) if name in frames.cameras]
    for number in sampled_frames(positions, frames_per_take):
        time_s = float(sequence.time_s[number])
        cloud = _cloud_at(clouds, time_s, sequence)
        for name in [name for name in cameras if frames.covers(name, time_s)][:cameras_per_frame]:
            photograph = frames.at(name, time_s)[..., ::-1]
            error = None if errors is None else _error_of(errors, number)
            views.append(FrameView(number, time_s, rig[name], photograph, positions[number], cloud, error))
    return views


def sampled_frames(positions: NDArray, count: int) -> list[int]:
    """Frames worth showing: of each of `count` equal spans of the sequence (t, n, 3) the one furthest from the first mesh."""
    moved = np.abs(positions - positions[0]).mean(axis=(1, 2))
    spans = [span for span in np.array_split(np.arange(len(positions)), count) if len(span)]
    return [int(span[np.argmax(moved[span])]) for span in spans]


def telling_cameras(rig: Rig, vertices: NDArray) -> list[str]:
    """Camera names: first the one most in front of the face, then the one nearest to 50 degrees beside it, then the others.

    Cameras that see less than half of the mesh in their image (those that frame the lips alone) come last.
    """
    angles = {}
    middle = np.asarray(vertices, float).mean(axis=0)
    for camera in rig:
        x, _, z = camera.centre - middle
        pixels = camera.project(np.asarray(vertices[::20], float))[0]
        inside = ((pixels > 0) & (pixels < camera.size)).all(axis=1).mean() >= 0.5
        angles[camera.name] = (not inside, abs(float(np.degrees(np.arctan2(x, z)))))
    front = min(angles, key=lambda name: angles[name])
    others = sorted(set(angles) - {front}, key=lambda name: (angles[name][0], abs(angles[name][1] - 50)))
    return [front, *others]


def _cloud_at(clouds: list[Path], time_s: float, sequence: MeshSequence) -> PointCloud | None:
    """The cloud of this very moment, found by its place in the take."""
    if len(clouds) == len(sequence):
        return PointCloud.load(clouds[int(np.abs(sequence.time_s - time_s).argmin())])
    near = (PointCloud.load(path) for path in clouds)
    return next((cloud for cloud in near if abs(cloud.time_s - time_s) < 1e-6), None)


def _error_of(errors: TrackingErrors, number: int) -> NDArray | None:
    row = np.flatnonzero(errors.frames == number)
    return errors.surface_mm[row[0]] if len(row) else None


def _gaps(
    session: SessionFolder, take: str, sequence: MeshSequence, positions: NDArray, triangles: NDArray, samples: int = 16
) -> CloudGaps | None:
    clouds = [PointCloud.load(path) for path in spread(session.clouds(take), samples)]
    if not clouds:
        return None
    frames = [int(np.abs(sequence.time_s - cloud.time_s).argmin()) for cloud in clouds]
    gaps = [cloud_distance_mm(cloud, sequence, positions, triangles) for cloud in clouds]
    quantile = lambda q: np.array([np.percentile(gap, q) for gap in gaps])  # noqa: E731
    return CloudGaps(np.array(frames), quantile(50), quantile(95))


def _calibration(folder: Path, result: CalibrationResult, board: BoardSettings | None, count: int) -> CalibrationReport:
    paths = [folder / "calibrate" / "detections" / f"{name}.npz" for name in result.rig.names]
    detections = tuple(CameraDetections.load(path) for path in paths if path.is_file())
    recordings = folder / "ingest" / "calibration.json"
    pictures = ()
    if board is not None and detections and recordings.is_file():
        pictures = _board_pictures(result, detections, board, IngestedTake.load(recordings), count)
    return CalibrationReport(result, detections, pictures)


def _board_pictures(
    result: CalibrationResult, detections: tuple[CameraDetections, ...], board: BoardSettings, recorded: IngestedTake, count: int
) -> tuple[BoardPicture, ...]:
    pictures = []
    for index in np.unique(np.linspace(0, len(detections) - 1, count).round().astype(int)):
        seen = detections[index]
        found = [(pose, *_sighting(pose, seen)) for pose in result.poses if seen.camera in pose.frames]
        found = [entry for entry in found if entry[1] is not None]
        if not found:
            continue
        pose, sighting, _ = max(found, key=lambda entry: entry[2])
        view, frame = seen.view(sighting), int(seen.frame[sighting])
        world = board.corners[view.corner] @ pose.world_from_board[:3, :3].T + pose.world_from_board[:3, 3]
        with VideoFrames(recorded[seen.camera].path) as video:
            photograph = video[frame][..., ::-1]
        predicted = result.rig[seen.camera].project(world)[0]
        pictures.append(BoardPicture(seen.camera, frame, photograph, view.pixels, predicted))
    return tuple(pictures)


def _sighting(pose: SolvedPose, seen: CameraDetections) -> tuple[int | None, int]:
    """Index of the camera's sighting of a pose and its number of corners."""
    rows = np.flatnonzero(seen.frame == pose.frames[seen.camera])
    if len(rows) == 0:
        return None, 0
    return int(rows[0]), int(seen.first[rows[0] + 1] - seen.first[rows[0]])
