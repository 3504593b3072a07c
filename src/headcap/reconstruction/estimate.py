"""The patchmatch engine: photographs to one depth map per view, coarse to fine, on one CPU core."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera, Rig
from headcap.errors import InputError
from headcap.meshes.rasteriser import rasterise
from headcap.reconstruction import patchmatch
from headcap.reconstruction.maps import DepthMap, cell_camera, normals_from_slopes
from headcap.reconstruction.refine import refine_sweep
from headcap.reconstruction.settings import ReconstructSettings
from headcap.reconstruction.views import (
    Level,
    View,
    build_level,
    choose_sources,
    depth_range,
    pair_geometry,
    pinhole_views,
    subject_centre,
)
from headcap.reconstruction.visibility import best_views
from headcap.reconstruction.windows import NO_MATCH

Mesh = tuple[NDArray, NDArray]
"""Vertices (n, 3) in the world, triangles (m, 3)."""


@dataclass
class _Planes:
    """One view's hypotheses at one level; the kernels fill the arrays in place."""

    plane: NDArray[np.float32]
    cost: NDArray[np.float32]
    spread: NDArray[np.float32]
    active: NDArray[np.bool_]
    settled: NDArray[np.uint8]

    @classmethod
    def empty(cls, active: NDArray[np.bool_]) -> _Planes:
        """No hypothesis yet in cells (rows, columns), of which those that are `active` will get one."""
        shape = active.shape
        cost = np.full(shape, NO_MATCH, np.float32)
        return cls(np.zeros((*shape, 3), np.float32), cost, np.zeros(shape, np.float32), active, np.zeros(shape, np.uint8))


def estimate_maps(
    rig: Rig,
    images_bgr: list[NDArray[np.uint8]],
    *,
    settings: ReconstructSettings,
    prior: Mesh | None = None,
    masks: list[NDArray] | None = None,
) -> list[DepthMap]:
    """Depth, normal and confidence of every view that has sources, by slanted PatchMatch and Gauss-Newton refinement.

    `images_bgr`: per camera (height, width, 3) uint8, distorted, of one moment. `prior`: a mesh near the surface, which
    replaces the search over depths where it is seen. `masks`: per camera (height, width), true on the subject.
    Raises `InputError` for fewer than three cameras, images of another size, or cameras that share no subject.
    """
    views = pinhole_views(rig, images_bgr, masks, settings)
    rig = Rig(tuple(view.camera for view in views))
    centre = subject_centre(rig) if prior is None else np.mean(prior[0], axis=0)
    sources = choose_sources(rig, centre, settings.matching)
    if not any(len(chosen) for chosen in sources):
        raise InputError(
            "no two cameras whose rays to the subject meet in the permitted range",
            expected=f"{settings.matching.min_angle_deg} to {settings.matching.max_angle_deg} degrees",
            remedy="Widen matching.max_angle_deg, or check the calibration.",
        )
    ranges = depth_range(rig, centre, settings)
    levels = [build_level(views, k, settings.matching.smoothing_px) for k in range(_level_count(views, settings) + 1)]
    matchers = [
        _Matcher(list(rig), levels, view, sources[view], ranges[view], settings) for view in range(len(rig)) if len(sources[view])
    ]
    for matcher in matchers:
        matcher.start(prior)
    for index in range(len(levels) - 2, -1, -1):
        chosen = [matcher.planes.active for matcher in matchers]
        if index == 0:
            chosen = best_views([matcher.map(views[matcher.view], 1) for matcher in matchers], settings)
        for matcher, best in zip(matchers, chosen, strict=True):
            matcher.descend(index, best)
    return [matcher.map(views[matcher.view], 0) for matcher in matchers]


def _level_count(views: tuple[View, ...], settings: ReconstructSettings) -> int:
    longest = max(max(view.camera.size) for view in views)
    return max(0, round(np.log2(longest / settings.matching.coarsest_px)))


class _Matcher:
    """One view's way from the coarsest level to the finest."""

    def __init__(
        self,
        cameras: list[Camera],
        levels: list[Level],
        view: int,
        sources: NDArray[np.int32],
        near_far: NDArray,
        settings: ReconstructSettings,
    ) -> None:
        self.cameras, self.levels, self.view, self.sources, self.settings = cameras, levels, view, sources, settings
        self.near, self.far = near_far
        self.w_limits = np.array([1 / self.far, 1 / self.near], np.float32)
        matching = settings.matching
        self.min_variance = np.float32(matching.min_contrast**2)

    def start(self, prior: Mesh | None) -> None:
        """Find the surface at the coarsest level."""
        self.planes = self._coarsest(prior)

    def descend(self, index: int, best: NDArray[np.bool_]) -> None:
        """One level finer, in the cells under `best` cells of the level above; the other cells keep its planes."""
        cells = self._cells(index)
        rows, columns = (np.minimum(np.arange(n) // 2, m - 1) for n, m in zip(cells.shape, best.shape, strict=True))
        below = np.ix_(rows, columns)
        self.planes = self._finer(index, self.planes, cells & best[below], below)

    def _geometry(self, index: int) -> tuple:
        """The arguments that every kernel begins with."""
        level, matching = self.levels[index], self.settings.matching
        m, t = pair_geometry(self.cameras, level.matrices, self.view, self.sources)
        return level.images, level.sizes, self.view, self.sources, m, t, matching.cell_px, matching.window_px

    def _cells(self, index: int) -> NDArray[np.bool_]:
        """Cells of a level whose centre is inside the photograph and the mask."""
        valid, cell = self.levels[index].valid[self.view], self.settings.matching.cell_px
        rows, columns = valid.shape[0] // cell, valid.shape[1] // cell
        middle = cell // 2
        return np.ascontiguousarray(valid[middle : rows * cell : cell, middle : columns * cell : cell])

    def _coarsest(self, prior: Mesh | None) -> _Planes:
        index, matching = len(self.levels) - 1, self.settings.matching
        planes = _Planes.empty(self._cells(index))
        geometry = self._geometry(index)
        searched = planes.active.copy()
        if prior is not None:
            seen = self._start_from_mesh(index, planes, prior)
            searched &= ~seen
        depths = 1 / np.linspace(self.w_limits[0], self.w_limits[1], matching.depth_planes + 2)[1:-1]
        patchmatch.sweep_depths(*geometry, depths, matching.best_sources, self.min_variance, searched, planes.plane, planes.cost)
        planes.active &= (planes.cost < NO_MATCH) | (planes.plane[..., 0] > 0)
        for sweep in range(matching.coarse_sweeps):
            self._propagate(index, planes, sweep, reach_px=2.0 * 0.7**sweep, slope_reach=1.5 * 0.7**sweep)
        self._refine(index, planes, self.settings.refinement.coarse_sweeps)
        return planes

    def _start_from_mesh(self, index: int, planes: _Planes, prior: Mesh) -> NDArray[np.bool_]:
        """Set the planes of cells that see the mesh; their cost is settled by the first propagation."""
        level, cell = self.levels[index], self.settings.matching.cell_px
        width, height = (int(side) for side in level.sizes[self.view])
        camera = Camera("level", width, height, level.matrices[self.view], np.zeros(5), self.cameras[self.view].camera_from_world)
        raster = rasterise(cell_camera(camera, cell), *prior)
        seen = raster.hit & planes.active
        inverse = np.where(seen, 1 / np.where(raster.hit, raster.depth, 1), np.nan)
        slopes = np.stack(np.gradient(inverse), -1)[..., ::-1] / cell
        slopes[~np.isfinite(slopes).all(-1)] = 0
        planes.plane[seen] = np.concatenate([inverse[..., None], slopes], -1)[seen]
        return seen

    def _propagate(self, index: int, planes: _Planes, sweep: int, *, reach_px: float, slope_reach: float) -> None:
        matching = self.settings.matching
        coarsest = index == len(self.levels) - 1
        focal = self.levels[index].matrices[self.view][0, 0]
        seed = np.uint64(1_000_003 * (self.view + 1) + 7919 * index + sweep)
        patchmatch.propagate(
            *self._geometry(index), self.w_limits, matching.best_sources, self.min_variance, 3 if coarsest else 0,
            matching.trials, reach_px, slope_reach / focal, seed, sweep % 2 == 1, planes.settled, planes.active,
            planes.plane, planes.cost,
        )  # fmt: skip

    def _finer(self, index: int, coarse: _Planes, chosen: NDArray, below: tuple) -> _Planes:
        matching, refinement = self.settings.matching, self.settings.refinement
        planes = _Planes.empty(chosen.copy())
        usable = coarse.active & (coarse.cost < matching.max_cost)
        patchmatch.descend(
            *self._geometry(index), matching.best_sources, self.min_variance, coarse.plane, usable, planes.active,
            planes.plane, planes.cost,
        )  # fmt: skip
        _inherit(planes, coarse, usable, chosen, below, matching.cell_px)
        if index > 0:
            for sweep in range(matching.level_sweeps + index - 1):
                self._propagate(index, planes, sweep, reach_px=1.0 * 0.7**sweep, slope_reach=0.7 * 0.7**sweep)
        self._refine(index, planes, refinement.sweeps if index == 0 else refinement.coarse_sweeps)
        return planes

    def _refine(self, index: int, planes: _Planes, sweeps: int) -> None:
        refinement = self.settings.refinement
        bend = 2.0**index  # a curved surface leaves its plane as the cell's size squared, in pixels as its size
        for sweep in range(sweeps):
            refine_sweep(
                *self._geometry(index), refinement.noise_grey, bend * refinement.smoothness_px,
                bend * refinement.smoothness_slope, refinement.discontinuity_px, refinement.converged_px, sweep % 2 == 1,
                planes.active, planes.settled, planes.plane, planes.cost, planes.spread,
            )  # fmt: skip

    def map(self, view: View, index: int) -> DepthMap:
        """The hypotheses as they stand, `index` being the level they were last refined at."""
        cell, planes = self.settings.matching.cell_px, self.planes
        matrix = self.levels[index].matrices[self.view]
        width, height = (int(side) for side in self.levels[index].sizes[self.view])
        camera = cell_camera(replace(view.camera, width=width, height=height, matrix=matrix), cell)
        w = planes.plane[..., 0]
        good = planes.active & (w > self.w_limits[0]) & (w < self.w_limits[1]) & (planes.spread > 0)
        depth = np.where(good, 1 / np.where(good, w, 1), 0).astype(np.float32)
        normal = normals_from_slopes(matrix, planes.plane, cell)
        normal[~good] = 0
        chosen = good & (planes.settled != patchmatch.FROZEN)
        chosen[::2, ::2] |= good[::2, ::2]  # one of the four cells that inherited one plane
        return DepthMap(
            camera=camera,
            depth=depth,
            normal=normal,
            confidence=np.where(good, np.clip(1 - planes.cost, 0, 1), 0).astype(np.float32),
            sigma=(planes.spread * depth**2).astype(np.float32),
            colour=cv2.resize(view.colour, camera.size, interpolation=cv2.INTER_AREA)[..., ::-1],
            chosen=chosen,
        )


def _inherit(planes: _Planes, coarse: _Planes, usable: NDArray, chosen: NDArray, below: tuple, cell_px: int) -> None:
    """Fill the cells that are not `chosen` with the planes of the level above, to stand still from now on."""
    keep = ~chosen & usable[below]
    rows, columns = below
    down, right = np.arange(keep.shape[0])[:, None] - 2 * rows - 0.5, np.arange(keep.shape[1]) - 2 * columns - 0.5
    slopes = 0.5 * coarse.plane[below][..., 1:]
    w = coarse.plane[below][..., 0] + cell_px * (right * slopes[..., 0] + down * slopes[..., 1])
    planes.plane[keep] = np.concatenate([w[..., None], slopes], -1)[keep]
    planes.cost[keep], planes.spread[keep] = coarse.cost[below][keep], coarse.spread[below][keep]
    planes.active |= keep
    planes.settled[keep] = patchmatch.FROZEN
