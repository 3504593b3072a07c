"""Contours of the lips in a video's frames, from where a base tracker has the mouth."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_arrays, save_arrays
from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.lips.contours.detector import ContourDetector, LikelihoodMaps
from headcap.lips.contours.frames import paired
from headcap.lips.contours.search import outward_normals, resample_ring, search_rims, search_ring, settle_ring
from headcap.lips.contours.settings import SearchSettings
from headcap.lips.contours.window import MouthLocator, MouthView
from headcap.lips.features import LipContours

KIND, SCHEMA = "lip_contours", 1
_COARSE_STEP_PX, _FINE_STEP_PX = 1.0, 0.5
_NORMALS_OVER = 3
"""Places before and after between which a chord tells a normal: about a sixteenth of the ring each way."""
_REFINED_STEPS = 3
"""Fine steps about the rims found in whole pixels."""
_WIDER, _LEAST_WIDTH = 0.2, 0.7
"""How far beyond the settled mouth's corners, in its widths, the line between the lips is followed; how much of it must show."""
_BEYOND_PX = 1.5
"""How far over the outer contour a rim may seem to lie: rolled-in lips have both contours in one."""


@dataclass(frozen=True, eq=False)
class FoundContours:
    """What was found in one picture."""

    contours: LipContours | None
    """None where either contour looks too little like one."""
    confidence: tuple[float, float]
    """Share of places that are likelier on a contour than not: of the outer contour's along the lip that shows it less, of the
    inner one's those where both rims are; 0 where none was looked for."""


@dataclass(frozen=True, eq=False)
class ContourSequence:
    """Contours of f frames."""

    outer: NDArray[np.float32]
    """(f, k, 2) pixels; NaN in frames without an answer."""
    inner: NDArray[np.float32]
    """(f, j, 2), as many points in every frame."""
    confidence: NDArray[np.float32]
    """(f, 2) see `FoundContours`."""

    def __len__(self) -> int:
        return len(self.confidence)

    @property
    def found(self) -> NDArray[np.bool_]:
        """(f,) frames with an answer."""
        return np.isfinite(self.outer).all(axis=(1, 2))

    def contours(self) -> list[LipContours | None]:
        """One per frame, as features want them."""
        rings = zip(self.outer, self.inner, self.found, strict=True)
        return [LipContours(outer, inner) if found else None for outer, inner, found in rings]

    def save(self, path: Path | str) -> None:
        """Write as npz artifact `headcap.lip_contours/1`."""
        save_arrays(path, KIND, SCHEMA, {name: getattr(self, name) for name in ("outer", "inner", "confidence")})

    @classmethod
    def load(cls, path: Path | str) -> ContourSequence:
        """Read what `save` wrote; raises `ArtifactError` for another kind of file or schema."""
        return cls(**load_arrays(path, KIND, SCHEMA)[0])


@dataclass(frozen=True, eq=False)
class Rims:
    """The mouth's opening in a map: heights over stations of the line between the lips' corners."""

    right: NDArray[np.float64]
    across: NDArray[np.float64]
    """(2,) unit."""
    stations: NDArray[np.float64]
    """(s,) along it, from `right`."""
    upper: NDArray[np.float64]
    """(s,) downwards; NaN where the mouth does not reach."""
    lower: NDArray[np.float64]
    odds: NDArray[np.float64]
    """(s,) log-odds of the less likely rim."""

    def ring(self) -> NDArray[np.float64]:
        """(2 s, 2) over the upper rim and back over the lower one, evenly between the ends that were found."""
        down, known = np.array([-self.across[1], self.across[0]]), np.isfinite(self.upper)
        even = np.linspace(self.stations[known][0], self.stations[known][-1], len(self.stations))
        rims = [np.interp(even, self.stations[known], rim[known]) for rim in (self.upper, self.lower)]
        rows = [self.right + even[:, None] * self.across + rim[:, None] * down for rim in rims]
        return np.concatenate([rows[0], rows[1][::-1]])


@dataclass(frozen=True, eq=False)
class ContourFinder:
    """Finds both contours near where a base tracker has the mouth."""

    detector: ContourDetector
    locator: MouthLocator
    settings: SearchSettings = field(default_factory=SearchSettings)

    def __call__(self, picture: NDArray[np.uint8], mesh: NDArray, camera: Camera) -> FoundContours:
        """Of a picture (height, width, 3) uint8, sRGB, BGR, and the base tracker's mesh (n, 3), metres, in the camera's world.

        Frames that were not tracked (NaN), or whose mouth leaves the picture, have none. Raises `InputError` for a picture of
        another size than the camera's.
        """
        if picture.ndim != 3 or picture.shape[1::-1] != camera.size or picture.dtype != np.uint8:
            raise InputError(
                f"a picture {picture.shape} of {picture.dtype}",
                expected=f"{camera.height} x {camera.width} x 3 of uint8, as camera {camera.name}",
                remedy="Give the video that the base tracker followed.",
            )
        view = self.locator(mesh, camera)
        if view is None:
            return FoundContours(None, (0.0, 0.0))
        maps = self.detector.maps(self.detector.window(picture, view), self.settings)
        return self.contours_in(maps, view)

    def contours_in(self, maps: LikelihoodMaps, view: MouthView) -> FoundContours:
        """Of one frame's likelihood maps and the base tracker's mouth in it."""
        own, window = self.settings, maps.window
        start = resample_ring(window.from_picture(view.border), own.places, view.left)
        ring, outer_odds = self._outer(maps, start)
        # a lip that is right does not vouch for one that was missed
        sure_outer = float((outer_odds.reshape(2, -1) > 0).mean(axis=1).min())
        rims = self._inner(maps, ring)
        sure = sure_outer, 0.0 if rims is None else float((rims.odds[np.isfinite(rims.upper)] > 0).mean())
        if rims is None or min(sure) < own.least_share:
            return FoundContours(None, sure)
        return FoundContours(LipContours(window.to_picture(ring), window.to_picture(rims.ring())), sure)

    def _outer(self, maps: LikelihoodMaps, start: NDArray) -> tuple[NDArray, NDArray]:
        """The outer ring (k, 2) in the window, and its log-odds (k,)."""
        own, per_mm = self.settings, maps.window.pixels_per_mm
        half = settle_ring(maps.coarse["outer"], (start + 0.5) / 2 - 0.5, own.reach_mm * per_mm / 2)
        half = self._widened(maps, half)
        normals = outward_normals(half, _NORMALS_OVER)
        ring, _ = search_ring(
            maps.coarse["outer"], half, normals, own.coarse_reach_mm * per_mm / 2, _COARSE_STEP_PX, own.stiffness
        )
        ring = evened(2 * (ring + 0.5) - 0.5)
        for _ in range(2):
            normals = outward_normals(ring, _NORMALS_OVER)
            ring, odds = search_ring(maps.fine["outer"], ring, normals, own.fine_reach_mm * per_mm, _FINE_STEP_PX, own.stiffness)
        return ring, odds

    def _widened(self, maps: LikelihoodMaps, ring: NDArray) -> NDArray[np.float64]:
        """A ring (k, 2) in the coarse map, stretched so that its corners are where the line between the lips ends.

        Towards the corners lips are thin and their border hardly shows, but the line between them does.
        """
        right, left = ring[0], ring[len(ring) // 2]
        middle, wider = 0.5 * (right + left), 1 + 2 * _WIDER
        rims = self._rims(maps.coarse["inner"], middle + wider * (ring - middle), _COARSE_STEP_PX)
        if rims is None:
            return ring
        ends = rims.ring()[[0, len(rims.stations) - 1]]
        width = np.linalg.norm(left - right)
        if np.linalg.norm(ends[1] - ends[0]) < _LEAST_WIDTH * width:
            return ring
        share = ((ring - right) @ (left - right) / width**2)[:, None]
        return ring + (1 - share) * (ends[0] - right) + share * (ends[1] - left)

    def _inner(self, maps: LikelihoodMaps, outer: NDArray) -> Rims | None:
        """The rims of the mouth within the outer ring (k, 2)."""
        rims = self._rims(maps.fine["inner"], outer, 2 * _FINE_STEP_PX)
        if rims is None:
            return None
        near = np.arange(-_REFINED_STEPS, _REFINED_STEPS + 1) * _FINE_STEP_PX
        upper, lower = (_continued(rim) for rim in (rims.upper, rims.lower))
        return self._rims(maps.fine["inner"], outer, _FINE_STEP_PX, (upper, lower, near)) or rims

    def _rims(
        self, likelihood: NDArray, outer: NDArray, step: float, near: tuple[NDArray, NDArray, NDArray] | None = None
    ) -> Rims | None:
        """Rims within an outer ring (k, 2) of a map: anywhere between its lips in steps, or near known ones."""
        own, right, left = self.settings, outer[0], outer[len(outer) // 2]
        width = np.linalg.norm(left - right)
        across = (left - right) / max(width, 1e-9)
        stations = np.linspace(0, width, own.stations + 2)[1:-1]
        bounds = _bounds(outer, right, across, stations)
        if near is None:
            middle = np.rint(bounds.mean(axis=1) / step) * step
            reach = np.ceil(0.5 * np.ptp(bounds, axis=1).max() / step) + 1
            near = middle, middle, np.arange(-reach, reach + 1) * step
        found = search_rims(likelihood, right, across, stations, *near, bounds, own.rim_stiffness)
        if found is None or np.isfinite(found[0]).sum() < 3:
            return None
        return Rims(right, across, stations, *found)


def find_contours(
    finder: ContourFinder, pictures: Iterable[NDArray[np.uint8]], meshes: Iterable[NDArray], camera: Camera
) -> ContourSequence:
    """Contours of a video's frames: its pictures with the base tracker's meshes (n, 3), NaN where it lost the face.

    Raises `InputError` where pictures and meshes differ in number or there are none.
    """
    found = [finder(picture, mesh, camera) for picture, mesh in paired(pictures, meshes)]
    places, stations = finder.settings.places, finder.settings.stations
    outer = np.full((len(found), places, 2), np.nan, np.float32)
    inner = np.full((len(found), 2 * stations, 2), np.nan, np.float32)
    for k, one in enumerate(found):
        if one.contours is not None:
            outer[k], inner[k] = one.contours.outer, one.contours.inner
    return ContourSequence(outer, inner, np.array([one.confidence for one in found], np.float32))


def evened(ring: NDArray) -> NDArray[np.float64]:
    """A ring (k, 2) with its places even again between its outermost points right and left, a little smoothed."""
    smooth = 0.25 * np.roll(ring, 1, axis=0) + 0.5 * ring + 0.25 * np.roll(ring, -1, axis=0)
    half = len(ring) // 2
    # corners may have wandered along the ring, but by no more than an eighth of it
    reach = len(ring) // 8
    first = int(np.argmin(np.roll(smooth[:, 0], reach)[: 2 * reach + 1])) - reach
    last = half - reach + int(np.argmax(smooth[half - reach : half + reach + 1, 0]))
    return resample_ring(np.roll(smooth, -first, axis=0), len(ring), last - first)


def _bounds(outer: NDArray, right: NDArray, across: NDArray, stations: NDArray) -> NDArray[np.float64]:
    """Heights (s, 2) of the outer ring's upper and lower lip over stations, a little beyond, from the line between corners."""
    down = np.array([-across[1], across[0]])
    half = len(outer) // 2
    closed = np.concatenate([outer, outer[:1]]) - right
    heights = []
    for part in (closed[: half + 1], closed[half:][::-1]):
        along, order = part @ across, np.argsort(part @ across)
        heights.append(np.interp(stations, along[order], (part @ down)[order]))
    upper, lower = np.minimum(*heights), np.maximum(*heights)
    return np.stack([upper - _BEYOND_PX, lower + _BEYOND_PX], axis=1)


def _continued(heights: NDArray) -> NDArray[np.float64]:
    """Heights (s,) whose unknown ends go on as the last known."""
    known = np.flatnonzero(np.isfinite(heights))
    return np.interp(np.arange(len(heights)), known, heights[known])
