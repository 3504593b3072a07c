"""The front of the neck laid out flat without changing lengths: the UV space in which the larynx slides (paper, section 3.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.heads import HeadModel
from headcap.heads.regions import throat_direction
from headcap.heads.unwrapping import unwrap_disc
from headcap.meshes.topology import (
    boundary_loops,
    euler_characteristic,
    non_manifold_vertices,
    submesh,
    vertex_components,
)


@dataclass(frozen=True)
class Distortion:
    """How far a flat layout is from isometric, over its triangles weighted by area."""

    mean_stretch: float
    """Mean of max(s, 1/s) - 1 over both singular values s of flat from space: 0 for an isometry."""
    p99_stretch: float
    """The larger of a triangle's two, 99th percentile."""
    max_stretch: float
    area_ratio: float
    """Flat area over area in space."""
    flipped: int
    """Triangles that lie the wrong way round."""


@dataclass(frozen=True, eq=False)
class NeckChart:
    """The front-neck patch of a head model and its flat layout."""

    vertices: NDArray[np.int64]
    """(p,) the patch's vertices in the head model."""
    triangles: NDArray[np.int32]
    """(q, 3) over those."""
    uv_m: NDArray[np.float64]
    """(p, 2) metres, the larynx prominence at 0; u to the subject's left, v up along the throat."""
    topology_digest: str
    """Of the head model it was cut from."""
    distortion: Distortion

    def border(self) -> NDArray[np.int32]:
        """The patch's outer rim, indices into `vertices` in order."""
        return boundary_loops(self.triangles)[0]


def build_chart(model: HeadModel, neutral: NDArray | None = None, iterations: int = 40) -> NeckChart:
    """Cut the model's `front_neck` and lay it out by SLIM with symmetric Dirichlet energy (Rabinovich et al. 2017; section 3.1).

    `neutral` (n, 3), metres, is the head whose lengths are kept, the model's own by default. The paper does not say which; give a
    subject's T_0: for a body 6 mm high that slides 12 mm, a map made at rest is then 0.05 mm rms off, 0.07 on the throat with its
    bump. What of the region hangs on by a single vertex is left out. Raises `InputError` where the region is missing or no disc.
    """
    positions = np.asarray(model.vertices if neutral is None else neutral, np.float64)
    region = model.regions.get("front_neck")
    if region is None or "larynx" not in model.landmarks:
        raise InputError(
            f"head model {model.name} names no {'front_neck region' if region is None else 'larynx landmark'}",
            expected="a model with the neck's regions",
            remedy="Make it with a loader of `headcap.heads`, which names them.",
        )
    triangles, used = _largest_disc(model.triangles, region, model.name)
    flat = 1e-3 * unwrap_disc(1e3 * positions[used], triangles, iterations)
    larynx = positions[model.landmarks["larynx"]]
    uv = _aligned(flat, positions[used], larynx, throat_direction(positions, region, larynx))
    distortion = measure_distortion(positions[used], uv, triangles)
    return NeckChart(used.astype(np.int64), triangles, uv, model.topology_digest, distortion)


def measure_distortion(space: NDArray, flat: NDArray, triangles: NDArray) -> Distortion:
    """Distortion of a layout flat (p, 2) of points (p, 3), both in one unit."""
    a, b, c = space[triangles].transpose(1, 0, 2)
    along = np.linalg.norm(b - a, axis=1)
    x_axis = (b - a) / along[:, None]
    projected = np.einsum("qk,qk->q", c - a, x_axis)
    height = np.linalg.norm(c - a - projected[:, None] * x_axis, axis=1)
    rest = np.zeros((len(triangles), 2, 2))
    rest[:, 0, 0], rest[:, 0, 1], rest[:, 1, 1] = along, projected, height
    corners = flat[triangles]
    edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    jacobian = edges @ np.linalg.inv(rest)
    singular = np.linalg.svd(jacobian, compute_uv=False)
    area, determinant = 0.5 * along * height, np.linalg.det(jacobian)
    # a fold has a vanishing singular value; the floor keeps the figure finite
    stretch = np.maximum(singular, 1.0 / np.maximum(singular, 1e-9)) - 1.0
    worst = stretch.max(axis=1)
    return Distortion(
        mean_stretch=float(np.average(stretch.mean(axis=1), weights=area)),
        p99_stretch=float(np.quantile(worst, 0.99)),
        max_stretch=float(worst.max()),
        area_ratio=float((determinant * area).sum() / area.sum()),
        flipped=int((determinant <= 0).sum()),
    )


def _largest_disc(triangles: NDArray, region: NDArray[np.bool_], name: str) -> tuple[NDArray, NDArray]:
    """The largest connected piece of a region (n,) as triangles and old indices, one disc."""
    inside = region[triangles].all(axis=1)
    for _ in range(20):
        if not inside.any():
            break
        labels = vertex_components(triangles[inside], len(region))[triangles[:, 0]]
        inside &= labels == np.bincount(labels[inside]).argmax()
        pinched = non_manifold_vertices(triangles[inside], len(region))
        if len(pinched) == 0:
            break
        inside &= ~np.isin(triangles, pinched).any(axis=1)
    found = int(euler_characteristic(triangles[inside])) if inside.any() else 0
    if found != 1 or len(boundary_loops(triangles[inside])) != 1:
        raise InputError(
            f"the front_neck region of head model {name} is no disc (Euler characteristic {found})",
            expected="one patch of skin without holes",
            remedy="Mend the region: it must be connected, and no wider than the front of the neck.",
        )
    return submesh(triangles, inside)


def _aligned(flat: NDArray, space: NDArray, larynx: NDArray, throat: NDArray) -> NDArray[np.float64]:
    """The layout (p, 2) moved and turned so that the larynx lies at 0 and the throat points along +v."""
    wanted = np.stack([space[:, 0] - larynx[0], (space - larynx) @ throat], axis=1)
    near = np.linalg.norm(space - larynx, axis=1) < 0.04
    if near.sum() < 8:
        near[:] = True
    here, there = flat[near] - flat[near].mean(0), wanted[near] - wanted[near].mean(0)
    u, _, vt = np.linalg.svd(here.T @ there)
    # only a turn: SLIM keeps triangles right side up, so a mirrored layout cannot come from it
    turn = u @ np.diag([1.0, np.linalg.det(u @ vt)]) @ vt
    origin = np.linalg.norm(space - larynx, axis=1).argmin()
    return (flat - flat[origin]) @ turn
