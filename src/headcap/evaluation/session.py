"""The figures of a whole session, stage by stage, from what lies in its results folder."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import Manifest
from headcap.cameras import Rig
from headcap.evaluation.calibration import RigErrors, compare_rigs
from headcap.evaluation.catalogue import CATALOGUE
from headcap.evaluation.metrics import Figure, make_figure
from headcap.evaluation.pixel import pixel_on_skin_mm
from headcap.evaluation.reconstruction import CloudErrors, compare_cloud, summarise_clouds
from headcap.evaluation.registration import compare_registration, count_flipped
from headcap.evaluation.settings import EvaluateSettings
from headcap.evaluation.sync import clock_shift_s, offset_error_ms
from headcap.evaluation.tracking import TrackingErrors, compare_sequence
from headcap.evaluation.truth import Truth
from headcap.geometry.transforms import transform
from headcap.meshes.closest_point import Surface
from headcap.reconstruction.points import PointCloud
from headcap.recordings.takes import IngestedTake
from headcap.registration.sequence import MeshSequence
from headcap.registration.template import Template
from headcap.sync.offsets import TimeOffsets
from headcap.sync.timeline import TakeTimeline

REPEATING = ("evaluate", "evaluate_neck", "evaluate_study", "report", "report_neck")
"""Stages that repeat what others said."""


@dataclass(frozen=True)
class SessionFolder:
    """Where the artifacts of one session lie."""

    folder: Path

    @property
    def name(self) -> str:
        """The session's name."""
        return self.folder.name

    def offsets(self, take: str) -> Path:
        """Start times of a take."""
        return self.folder / "sync" / f"{take}.json"

    def sync_figure(self, take: str) -> Path:
        """What sync drew of the clap."""
        return self.folder / "sync" / f"{take}.png"

    def ingested(self, take: str) -> Path:
        """Recordings of a take."""
        return self.folder / "ingest" / f"{take}.json"

    def clouds(self, take: str) -> list[Path]:
        """Point clouds of a take in the order of frames; those of frames the take no longer has are left aside."""
        found = sorted((self.folder / "reconstruct" / take).glob("frame_*.ply"))
        timeline = self.folder / "sync" / f"{take}.timeline.json"
        if not timeline.is_file():
            return found
        frames = set(TakeTimeline.load(timeline).frames.tolist())
        return [path for path in found if int(path.stem.removeprefix("frame_")) in frames]

    def start(self, take: str) -> Path:
        """The template on the take's first frame."""
        return self.folder / "track" / take / "start.npz"

    def sequence(self, take: str) -> Path:
        """The tracked take."""
        return self.folder / "track" / take / "sequence.json"

    def residuals(self, take: str) -> Path:
        """What the tracker was left with in each frame."""
        return self.folder / "track" / take / "residuals.json"

    def tracking_errors(self, take: str) -> Path:
        """Errors of the tracked take, written by `evaluate`."""
        return self.folder / "evaluate" / f"{take}.npz"

    @property
    def template(self) -> Path:
        """The registered template."""
        return self.folder / "register" / "template.npz"

    @property
    def metrics(self) -> Path:
        """The session's figures."""
        return self.folder / "metrics.json"


@dataclass(frozen=True)
class TruthComparison:
    """A session beside its truth: the rigid alignment and the clock shift that all figures of a take share."""

    session: SessionFolder
    truth: Truth
    rig: Rig
    settings: EvaluateSettings

    @property
    def rig_errors(self) -> RigErrors:
        """The rig against the true one."""
        return compare_rigs(self.rig, self.truth.rig)

    def clock_shift_s(self, take: str) -> float:
        """How far the take's common clock runs ahead of the true one."""
        return clock_shift_s(TimeOffsets.load(self.session.offsets(take)), self.truth.start_s(take))

    def sync(self, take: str) -> dict[str, float]:
        """The `sync` figures of a take."""
        return {"sync.offset_error_ms": offset_error_ms(TimeOffsets.load(self.session.offsets(take)), self.truth.start_s(take))}

    def calibrate(self) -> dict[str, float]:
        """The `calibrate` figures that need truth."""
        errors = self.rig_errors
        return {"calibrate.centre_error_mm": errors.centre_error_mm, "calibrate.rotation_error_deg": errors.rotation_error_deg}

    def reconstruct(self, take: str) -> dict[str, float]:
        """The `reconstruct` figures over frames spread evenly over the take."""
        clouds = [self.cloud(take, path) for path in spread(self.session.clouds(take), self.settings.cloud_frames)]
        return summarise_clouds(clouds)

    def cloud(self, take: str, path: Path) -> CloudErrors:
        """One cloud against the true surface at its time."""
        cloud = PointCloud.load(path)
        true_vertices = self.truth.take(take).at(cloud.time_s - self.clock_shift_s(take))
        points = transform(self.truth_world_from_world, cloud.positions.astype(np.float64))
        recording = self.recording(take, cloud.time_s)
        return compare_cloud(points, true_vertices, self.truth.triangles, self.truth.rig, self.settings, recording=recording)

    def recording(self, take: str, time_s: float) -> tuple[str, ...] | None:
        """Cameras with a picture within one frame interval of a common time, the rule by which a take's frames are counted.

        None where the session no longer has its list of recordings.
        """
        if not self.session.ingested(take).is_file():
            return None
        ingested, offsets = IngestedTake.load(self.session.ingested(take)), TimeOffsets.load(self.session.offsets(take))
        near = {
            recording.camera: np.abs(offsets.common_time(recording.camera, np.array(recording.frame_times_s)) - time_s).min()
            for recording in ingested.recordings
        }
        return tuple(r.camera for r in ingested.recordings if near[r.camera] <= 1 / r.rate_hz)

    @property
    def truth_world_from_world(self) -> NDArray[np.float64]:
        """(4, 4) the session's world in the true one."""
        return self.rig_errors.truth_world_from_world

    def track(self, take: str, *, every: int = 1) -> TrackingErrors:
        """The tracked take against the true surface."""
        return compare_sequence(
            MeshSequence.load(self.session.sequence(take)),
            Template.load(self.session.template),
            self.truth,
            rig=self.rig,
            truth_world_from_world=self.truth_world_from_world,
            clock_shift_s=self.clock_shift_s(take),
            settings=self.settings,
            every=every,
        )


def compare_take(comparison: TruthComparison, take: str) -> list[Figure]:
    """All figures of one take that need truth, for the stages whose artifacts lie there; writes the tracking errors."""
    session, values = comparison.session, {}
    if take not in comparison.truth.takes:
        return []
    if session.offsets(take).is_file():
        values |= comparison.sync(take)
    if session.clouds(take):
        values |= comparison.reconstruct(take)
    if session.sequence(take).is_file():
        errors = comparison.track(take)
        errors.save(session.tracking_errors(take))
        values |= errors.figures()
    return _figures(values, session.name, take, comparison.settings)


def evaluate_session(
    session: SessionFolder,
    takes: Iterable[str],
    *,
    rig: Rig,
    truth: Truth | None,
    settings: EvaluateSettings,
    scan: tuple[NDArray, NDArray] | None = None,
) -> list[Figure]:
    """Every figure of a session: those its stages stated in their manifests, and those against truth where there is one.

    `scan`: vertices (v, 3) in metres, in the frame of the registered template, and triangles (m, 3). Lengths are held to
    limits by the pixel's size on the skin (`EvaluateSettings.at_pixel`), which is stated as `rig.pixel_mm`.
    """
    pixel_mm = measure_pixel_mm(session, takes, rig)
    settings = settings.at_pixel(pixel_mm)
    figures = [] if pixel_mm is None else _figures({"rig.pixel_mm": pixel_mm}, session.name, None, settings)
    figures += stated_figures(session, takes, settings)
    if scan is not None:
        values = compare_registration(Template.load(session.template), *scan).figures()
        figures += _figures(values, session.name, None, settings)
    for take in takes:
        figures += _figures(measure_take(session, take, settings), session.name, take, settings)
    if truth is not None:
        comparison = TruthComparison(session, truth, rig, settings)
        figures += _figures(comparison.calibrate(), session.name, None, settings)
        for take in takes:
            figures += compare_take(comparison, take)
    # what is measured here goes before what a stage said of itself
    return list({(figure.name, figure.take): figure for figure in figures}.values())


def measure_pixel_mm(session: SessionFolder, takes: Iterable[str], rig: Rig) -> float | None:
    """Edge of a pixel on the face, mm, where the first take that has begun starts; None where no template is placed yet."""
    placed = next((path for path in map(session.start, takes) if path.is_file()), None)
    return None if placed is None else pixel_on_skin_mm(rig, Template.load(placed))


def measure_take(session: SessionFolder, take: str, settings: EvaluateSettings) -> dict[str, float]:
    """Figures of a take that need no truth: points per frame, their distance to the tracked mesh, flipped triangles."""
    clouds = [PointCloud.load(path) for path in spread(session.clouds(take), settings.cloud_frames)]
    values = {"reconstruct.points": float(np.median([len(cloud) for cloud in clouds]))} if clouds else {}
    if not session.sequence(take).is_file():
        return values
    sequence, triangles = MeshSequence.load(session.sequence(take)), Template.load(session.template).triangles
    positions = sequence.positions()
    values["track.flipped_triangles"] = float(max(count_flipped(mesh, triangles) for mesh in positions))
    gaps = [cloud_distance_mm(cloud, sequence, positions, triangles) for cloud in clouds]
    if gaps:
        values["track.cloud_distance_median_mm"] = float(np.median(np.concatenate(gaps)))
    return values


def cloud_distance_mm(cloud: PointCloud, sequence: MeshSequence, positions: NDArray, triangles: NDArray) -> NDArray[np.float64]:
    """Distances (n,) of a cloud's points to the tracked mesh at its moment; positions (t, v, 3) are the sequence's."""
    nearest_frame = int(np.abs(sequence.time_s - cloud.time_s).argmin())
    return 1e3 * Surface(positions[nearest_frame], triangles).closest(cloud.positions).distance


def stated_figures(session: SessionFolder, takes: Iterable[str], settings: EvaluateSettings) -> list[Figure]:
    """Figures that stages wrote into their manifests; the take is known by the artifact's folder or file name.

    Where several artifacts of one take state the same figure (chunks of frames), the worst is kept.
    """
    found: dict[tuple[str, str | None], float] = {}
    for path in sorted(session.folder.rglob("*.manifest.json")):
        manifest = Manifest.load(path)
        if manifest.stage in REPEATING:
            continue
        parts = {part.split(".")[0] for part in path.relative_to(session.folder).parts}
        take = next((take for take in takes if take in parts), None)
        for name, value in manifest.figures.items():
            key = (name if "." in name else f"{manifest.stage}.{name}", take)
            worse = min if key[0] in CATALOGUE and CATALOGUE[key[0]].at_least else max
            found[key] = worse(found.get(key, value), value)
    return [make_figure(name, value, session=session.name, take=take, settings=settings) for (name, take), value in found.items()]


def spread(items: list[Path], count: int) -> list[Path]:
    """At most `count` items, evenly spread from the first to the last."""
    if len(items) <= count:
        return items
    return [items[i] for i in np.unique(np.rint(np.linspace(0, len(items) - 1, count)).astype(int))]


def _figures(values: dict[str, float], session: str, take: str | None, settings: EvaluateSettings) -> list[Figure]:
    return [make_figure(name, value, session=session, take=take, settings=settings) for name, value in values.items()]
