"""A video without truth: how well tracked and corrected lips agree with what its pictures show, and how they move.

Photometric residual of the base tracker, distance of contours in the picture, lip gap over time. The contours are those that the
correction was told by: their distance says whether it follows them, not whether they are right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_arrays, save_arrays
from headcap.cameras import Camera
from headcap.evaluation.lip_closures import ClosureTest, check_closures
from headcap.evaluation.lip_errors import BASE
from headcap.evaluation.lip_sections import LipSections
from headcap.heads import HeadModel
from headcap.lips.features import LipContours
from headcap.lips.kit import CorrectedClip
from headcap.lips.mesh_contours import MeshContours
from headcap.lips.monocular import FrameState, MonocularTrack
from headcap.speech.words import Closure, Word, lip_closures

KIND, SCHEMA = "lip_clip", 1
CORRECTED = "GR"
"""What a kit puts in: the regressor for people it has never seen."""
_PLACES = 96
"""On a contour: at the lips of a small picture less than a pixel apart."""
_ARRAYS = ("time_s", "residual", "correlation", "contours_found", "eyes_px", "gap_mm", "contour_px")


@dataclass(frozen=True, eq=False)
class LipClip:
    """One clip of f frames by m methods; NaN where a frame has no answer."""

    name: str
    methods: tuple[str, ...]
    """`BASE` and `CORRECTED`."""
    states: tuple[FrameState, ...]
    """(f,) of the base tracker."""
    time_s: NDArray[np.float64]
    """(f,)"""
    residual: NDArray[np.float64]
    """(f,) of the base tracker: rms difference per channel of picture and rendering where they agree, linear intensity 0 to 1."""
    correlation: NDArray[np.float64]
    """(f,) of rendering and picture."""
    contours_found: NDArray[np.bool_]
    """(f,)"""
    eyes_px: NDArray[np.float64]
    """(f,) distance between the middles of the eyes in the picture, by the base tracker: the unit of lengths there."""
    gap_mm: NDArray[np.float64]
    """(m, f) distance between the lips, mean over `LipSections`, at the tracked head's size."""
    contour_px: NDArray[np.float64]
    """(m, f, 2) `contour_distance` of what was found and what the mesh shows, outer and inner contour."""
    words: tuple[Word, ...] = ()
    """What was said, where that is known."""

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def lost(self) -> NDArray[np.int64]:
        """Frames in which the face was lost."""
        return self._frames(FrameState.LOST)

    @property
    def found_again(self) -> NDArray[np.int64]:
        """Frames in which the face was found again after a loss."""
        return self._frames(FrameState.RESTARTED)

    @property
    def uncorrected(self) -> NDArray[np.int64]:
        """Frames with a face that have no corrected lips."""
        answered = np.isfinite(self.gap_mm)
        return np.flatnonzero(answered[0] & ~answered[self.row(CORRECTED)])

    @property
    def closures(self) -> tuple[Closure, ...]:
        """When what was said shuts the lips."""
        return lip_closures(self.words)

    @property
    def spoken_s(self) -> tuple[float, float] | None:
        """From the first word to the last."""
        return (self.words[0].start_s, self.words[-1].end_s) if self.words else None

    def row(self, method: str) -> int:
        """Place of a method."""
        return self.methods.index(method)

    def gap(self, method: str) -> NDArray[np.float64]:
        """(f,) mm."""
        return self.gap_mm[self.row(method)]

    def mean_contour_px(self, method: str) -> tuple[float, float]:
        """Means over the frames that all methods answered, of outer and inner contour; NaN without any."""
        common = np.isfinite(self.contour_px).all(axis=(0, 2))
        if not common.any():
            return float("nan"), float("nan")
        outer, inner = self.contour_px[self.row(method)][common].mean(axis=0)
        return float(outer), float(inner)

    def closure_test(self, method: str) -> ClosureTest | None:
        """Whether a method's lips shut where what was said shuts them; None where no word is known that does."""
        if not self.closures:
            return None
        moments = [closure.time_s for closure in self.closures]
        return check_closures(self.time_s, self.gap(method), moments, self.spoken_s)

    def save(self, path: Path | str) -> None:
        """Write as npz artifact `headcap.lip_clip/1`."""
        meta = {"name": self.name, "methods": list(self.methods), "states": [str(state) for state in self.states]}
        meta["words"] = [asdict(word) for word in self.words]
        save_arrays(path, KIND, SCHEMA, {name: getattr(self, name) for name in _ARRAYS}, meta)

    @classmethod
    def load(cls, path: Path | str) -> LipClip:
        """Read what `save` wrote; raises `ArtifactError`."""
        arrays, meta = load_arrays(path, KIND, SCHEMA)
        states = tuple(FrameState(state) for state in meta["states"])
        words = tuple(Word(**word) for word in meta["words"])
        return cls(meta["name"], tuple(meta["methods"]), states, words=words, **arrays)

    def _frames(self, state: FrameState) -> NDArray[np.int64]:
        return np.flatnonzero([each is state for each in self.states])


def judge_clip(
    name: str, model: HeadModel, track: MonocularTrack, corrected: CorrectedClip, words: Sequence[Word] = ()
) -> LipClip:
    """A clip that was tracked with a head model and corrected, as its pictures judge it; `words` are what was said in it."""
    take = corrected.take
    sections = LipSections.of(take.neutral, take.space.mouth, model.regions)
    see = MeshContours.of(np.asarray(model.vertices, float), take.space.mouth, model.regions)
    found = corrected.contours.contours()
    base = take.base.world(take.base.meshes)
    judged = [_judged(see, sections, take.camera, meshes, found) for meshes in (base, corrected.meshes)]
    return LipClip(
        name,
        (BASE, CORRECTED),
        track.states,
        track.time_s,
        track.residual,
        track.correlation,
        corrected.contours.found,
        take.space.features.eye_distance(take.camera.project(base)[0]),
        1e3 * np.array([gap for gap, _ in judged]),
        np.array([distance for _, distance in judged]),
        tuple(words),
    )


def _judged(
    see: MeshContours, sections: LipSections, camera: Camera, meshes: NDArray, found: Sequence[LipContours | None]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gaps (f,), metres, and distances (f, 2), pixels, of meshes (f, n, 3) in the camera's world."""
    gap, distance = np.full(len(meshes), np.nan), np.full((len(meshes), 2), np.nan)
    for frame, (mesh, there) in enumerate(zip(meshes, found, strict=True)):
        if not np.isfinite(mesh).all():
            continue
        gap[frame] = sections.gap(mesh).mean()
        if there is not None:
            own = see(np.asarray(mesh, np.float64), camera)
            distance[frame] = contour_distance(own.outer, there.outer), contour_distance(own.inner, there.inner)
    return gap, distance


def contour_distance(one: NDArray, other: NDArray) -> float:
    """Mean distance of two rings (k, 2), (j, 2), pixels: from places spread evenly on either to the nearest of the other."""
    return float((_to_ring(_spread(one), other).mean() + _to_ring(_spread(other), one).mean()) / 2)


def _spread(ring: NDArray) -> NDArray[np.float64]:
    """Places (p, 2) at equal steps along a ring."""
    closed = np.concatenate([ring, ring[:1]]).astype(np.float64)
    run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    at = run[-1] * np.arange(_PLACES) / _PLACES
    return np.stack([np.interp(at, run, column) for column in closed.T], axis=1)


def _to_ring(points: NDArray, ring: NDArray) -> NDArray[np.float64]:
    """(p,) distance of points (p, 2) to the sides of a ring."""
    side = np.roll(ring, -1, axis=0) - ring
    away = points[:, None] - ring
    share = np.clip((away * side).sum(axis=2) / np.maximum((side**2).sum(axis=1), 1e-30), 0, 1)
    return np.linalg.norm(away - share[..., None] * side, axis=2).min(axis=1)
