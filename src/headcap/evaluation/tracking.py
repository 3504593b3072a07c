"""A tracked take against the true surface: distance, sliding along the skin, and the lip gap."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_arrays, save_arrays
from headcap.cameras import Rig
from headcap.evaluation.settings import EvaluateSettings
from headcap.evaluation.ties import Ties, at_border, tie
from headcap.evaluation.truth import Truth
from headcap.geometry.transforms import transform
from headcap.meshes.closest_point import Surface
from headcap.meshes.normals import vertex_normals
from headcap.meshes.visibility import count_cameras
from headcap.registration.sequence import MeshSequence
from headcap.registration.template import Template

KIND, SCHEMA = "tracking_errors", 1

# Parts of a head model that a surface scan or a skin surface does not have.
NO_SKIN = ("eyes", "mouth_interior")
# Beyond this a vertex is not the same place of the skin, and its material point does not vouch for it being in view.
_SAME_PLACE_M = 2e-3


@dataclass(frozen=True)
class TrackingErrors:
    """Errors of one take, per frame and vertex; NaN where the true surface has no counterpart."""

    take: str
    frames: NDArray[np.int64]
    """(t,) frame numbers of the sequence that were compared."""
    time_s: NDArray[np.float64]
    """(t,) on the take's common clock."""
    surface_mm: NDArray[np.float32]
    """(t, n) vertex to the true surface."""
    drift_mm: NDArray[np.float32]
    """(t, n) vertex to where its material point has gone."""
    seen: NDArray[np.bool_]
    """(t, n) true where enough cameras see it."""
    lip_gap_mm: NDArray[np.float64]
    """(t,) tracked distance of the two inner-lip material points; NaN where the template names no lips."""
    true_lip_gap_mm: NDArray[np.float64]
    """(t,)"""

    def figures(self) -> dict[str, float]:
        """The `track` figures of this take."""
        surface, drift = self.surface_mm[self.seen], self.drift_mm[self.seen]
        gap_error = self.lip_gap_mm - self.true_lip_gap_mm
        return {
            "track.surface_error_median_mm": _percentile(surface, 50),
            "track.surface_error_p95_mm": _percentile(surface, 95),
            "track.drift_median_mm": _percentile(drift, 50),
            "track.drift_p95_mm": _percentile(drift, 95),
            "track.drift_all_median_mm": _percentile(self.drift_mm, 50),
            "track.drift_all_p95_mm": _percentile(self.drift_mm, 95),
            "track.lip_gap_error_mm": float(np.sqrt(np.mean(gap_error**2))),
        }

    def save(self, path: Path | str) -> None:
        """Write as npz artifact `headcap.tracking_errors/1`."""
        arrays = {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "take"}
        save_arrays(path, KIND, SCHEMA, arrays, {"take": self.take})

    @classmethod
    def load(cls, path: Path | str) -> TrackingErrors:
        """Read what `save` wrote; raises `ArtifactError`."""
        arrays, meta = load_arrays(path, KIND, SCHEMA)
        return cls(take=meta["take"], **arrays)


def _percentile(values: NDArray, percent: float) -> float:
    known = values[np.isfinite(values)]
    return float(np.percentile(known, percent)) if len(known) else float("nan")


def compare_sequence(
    sequence: MeshSequence,
    template: Template,
    truth: Truth,
    *,
    rig: Rig,
    truth_world_from_world: NDArray,
    clock_shift_s: float,
    settings: EvaluateSettings | None = None,
    every: int = 1,
) -> TrackingErrors:
    """Errors of a sequence in the topology of `template` against a truth folder.

    `rig` are the cameras that count who is seen, in the sequence's world; `truth_world_from_world` comes from
    `compare_rigs`, `clock_shift_s` from `evaluation.sync`. `every` thins the frames; the first is always the reference.

    A vertex counts as seen in a frame where enough cameras see it on the tracked mesh, or see its material point on
    the true one: a mesh folded over itself does not hide its errors. Eyes and mouth interior, and vertices beyond an
    open border of the true surface, have no counterpart there.
    """
    settings = settings or EvaluateSettings()
    true_take = truth.take(sequence.take)
    comparison = _Comparison(template, truth, rig.transformed(truth_world_from_world), settings)
    rows, frames = [], []
    for number, positions in enumerate(sequence):
        if number % every:
            continue
        tracked = transform(truth_world_from_world, np.asarray(positions, float))
        rows.append(comparison.frame(tracked, true_take.at(sequence.time_s[number] - clock_shift_s)))
        frames.append(number)
    surface, drift, seen, gap, true_gap = (np.array(column) for column in zip(*rows, strict=True))
    return TrackingErrors(
        take=sequence.take,
        frames=np.array(frames),
        time_s=sequence.time_s[frames],
        surface_mm=surface.astype(np.float32),
        drift_mm=drift.astype(np.float32),
        seen=seen,
        lip_gap_mm=gap,
        true_lip_gap_mm=true_gap,
    )


class _Comparison:
    """What is tied at the first frame, and the comparison of each later one."""

    def __init__(self, template: Template, truth: Truth, rig: Rig, settings: EvaluateSettings) -> None:
        self.template, self.truth, self.rig, self.settings = template, truth, rig, settings
        # half the resolution is enough to vouch that a material point is in view, at a third of the time
        self.true_rig = Rig(tuple(camera.scaled(0.5) for camera in truth.rig))
        self.ties: Ties | None = None
        self.lips: Ties | None = None

    def frame(self, tracked: NDArray, true_vertices: NDArray) -> tuple[NDArray, NDArray, NDArray, float, float]:
        """(surface mm, drift mm, seen, lip gap mm, true lip gap mm) of tracked vertices (n, 3) in the true world."""
        normals = vertex_normals(tracked, self.template.triangles)
        if self.ties is None:
            self._tie(tracked, normals, true_vertices)
        material = self.ties.positions(true_vertices, self.truth.triangles)
        surface = Surface(true_vertices, self.truth.triangles).closest(tracked).distance
        surface[~self.compared] = np.nan
        drift = np.linalg.norm(tracked - material, axis=1)
        drift[~self.compared] = np.nan
        seen = self._seen(tracked, normals, true_vertices, material)
        pair = list(self.truth.inner_lip_middle)
        true_gap = np.linalg.norm(np.subtract(*true_vertices[pair]))
        gap = np.linalg.norm(np.subtract(*self.lips.positions(tracked, self.template.triangles)))
        return 1e3 * surface, 1e3 * drift, seen, 1e3 * gap, 1e3 * true_gap

    def _tie(self, tracked: NDArray, normals: NDArray, true_vertices: NDArray) -> None:
        self.ties = tie(tracked, normals, true_vertices, self.truth.triangles)
        nearest = Surface(true_vertices, self.truth.triangles).closest(tracked)
        self.compared = self.ties.tied & ~at_border(nearest.triangle, nearest.barycentric, self.truth.triangles)
        for name in NO_SKIN:
            self.compared &= ~self.template.regions.get(name, np.zeros(len(tracked), bool))
        self.vouched = self.compared & (self.ties.distance_m <= _SAME_PLACE_M)
        self.lips = tie_lips(self.template, tracked, true_vertices, self.truth)

    def _seen(self, tracked: NDArray, normals: NDArray, true_vertices: NDArray, material: NDArray) -> NDArray[np.bool_]:
        angle, least = self.settings.max_angle_deg, self.settings.min_cameras
        seen = np.zeros(len(tracked), bool)
        chosen = self.compared
        seen[chosen] = (
            count_cameras(self.rig, tracked, self.template.triangles, tracked[chosen], normals[chosen], max_angle_deg=angle)
            >= least
        )
        chosen = self.vouched & ~seen
        material_normals = self.ties.normals(true_vertices, self.truth.triangles)[chosen]
        cameras = count_cameras(
            self.true_rig, true_vertices, self.truth.triangles, material[chosen], material_normals, max_angle_deg=angle
        )
        seen[chosen] = cameras >= least
        return seen


def tie_lips(template: Template, tracked: NDArray, true_vertices: NDArray, truth: Truth) -> Ties:
    """Tie the true middle vertices of upper and lower inner lip to the template's own lips, each to its side.

    Only triangles whose corners all belong to `lips_upper` or `lips_inner_upper` (or the lower ones) are admitted: where
    lips touch, the nearest surface may belong to the other lip. A template without lip regions leaves both untied.
    """
    true_normals = vertex_normals(true_vertices, truth.triangles)
    parts = []
    for side, vertex in zip(("upper", "lower"), truth.inner_lip_middle, strict=True):
        mask = np.zeros(len(tracked), bool)
        for name in (f"lips_{side}", f"lips_inner_{side}"):
            mask |= template.regions.get(name, False)
        own = np.flatnonzero(mask[template.triangles].all(axis=1))
        if len(own) == 0:
            parts.append(Ties(np.array([-1]), np.zeros((1, 3)), np.array([np.inf])))
            continue
        found = tie(true_vertices[[vertex]], true_normals[[vertex]], tracked, template.triangles[own])
        parts.append(Ties(np.where(found.tied, own[found.triangle], -1), found.barycentric, found.distance_m))
    return Ties(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("triangle", "barycentric", "distance_m")))
