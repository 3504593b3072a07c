"""A sculptor: hand-made shapes as somebody makes them who knows what a face does, but never measured it.

Each way to miss has a strength and random numbers of its own, so that they can be studied one by one: strength 0 leaves a
basis as it is, and no strength changes what another one draws. Amplitude and a wrong neighbour keep the span of a basis; what
the span loses is lost to misplacement, smoothing, direction and asymmetry.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy import sparse
from scipy.spatial import cKDTree

from headcap.errors import InputError
from headcap.expressions import ExpressionBasis
from headcap.geometry.rotations import rotation_matrices
from headcap.meshes.laplacian import Factor, cotangent_laplacian, vertex_areas
from headcap.meshes.topology import boundary_mask

_STREAM = 2006
"""Keeps these random numbers apart from those of other generators with the same seed."""
_MISPLACEMENT, _DIRECTION, _NEIGHBOUR, _ASYMMETRY, _AMPLITUDE = range(5)
_WAVE_M = 0.1
"""Wavelength at which directions of motion go wrong: about the breadth of a mouth and a cheek."""
_MIDDLE_M = 0.01
"""From the middle of the face slips turn from one side's way to the other's within this."""
_STEP = 0.5
"""Length of a step of a slip in median edges, so that few steps leave their triangle."""


class SculptorSettings(BaseModel):
    """How far a sculptor misses, each way by itself; 0 is exact.

    The quasi-eigen paper's sculptors missed by more than the default strengths do: covering 99.5 % of the variance left their
    eigenfaces sqrt(0.005) = 7 % of the motion, which is the paper's 0.62 %; its 5.2 % of the hand-made basis are then 59 %.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    misplacement_mm: float = Field(
        default=6.0, ge=0, description="Shapes sit up to so far from their place on the face; half at least."
    )
    smoothing_mm: float = Field(
        default=8.0, ge=0, description="Detail finer than this is lost: standard deviation of a Gaussian along the surface."
    )
    direction_deg: float = Field(
        default=40.0,
        ge=0,
        le=180,
        description="Skin moves up to so far off its direction, by angles that vary smoothly over the face.",
    )
    neighbour: float = Field(
        default=0.3,
        ge=0,
        le=1,
        description="Up to so much, by norm, of the most similar other shape is mixed into each; half at least.",
    )
    asymmetry: float = Field(
        default=0.3,
        ge=0,
        lt=1,
        description="Left and right of a shape are up to so much too strong or weak, against each other; half at least.",
    )
    amplitude: float = Field(default=0.3, ge=0, lt=1, description="Shapes are up to so much too large or too small.")


def sculpt(basis: ExpressionBasis, settings: SculptorSettings, seed: int) -> ExpressionBasis:
    """The shapes of a basis as a sculptor would hand them in; equal seeds give equal shapes.

    In this order: shapes slip along the surface, lose detail, move in wrong directions, take in some of their nearest
    neighbour, get uneven sides and a wrong size. Neutral face, names and triangles stay. Raises `InputError` for a slip or
    smoothing of points without triangles.
    """
    if (settings.misplacement_mm or settings.smoothing_mm) and not len(basis.triangles):
        raise InputError(
            "points without triangles",
            expected="a mesh, for shapes to slip and blur along",
            remedy="Set misplacement_mm and smoothing_mm to 0, or give the triangles.",
        )
    shapes = basis.displacements.astype(np.float64)
    if settings.misplacement_mm:
        shapes = _misplaced(basis, shapes, settings.misplacement_mm / 1e3, _random(seed, _MISPLACEMENT))
    if settings.smoothing_mm:
        shapes = smoothed(basis.neutral, basis.triangles, shapes, settings.smoothing_mm / 1e3)
    if settings.direction_deg:
        shapes = _turned(basis.neutral, shapes, np.radians(settings.direction_deg), _random(seed, _DIRECTION))
    if settings.neighbour:
        shapes = _mixed(shapes, nearest_shapes(basis), settings.neighbour, _random(seed, _NEIGHBOUR))
    if settings.asymmetry:
        shapes = _uneven(basis.neutral, shapes, settings.asymmetry, _random(seed, _ASYMMETRY))
    if settings.amplitude:
        gains = 1 + settings.amplitude * _random(seed, _AMPLITUDE).uniform(-1, 1, len(shapes))
        shapes = shapes * gains[:, None, None]
    return replace(basis, displacements=shapes)


def nearest_shapes(basis: ExpressionBasis) -> NDArray[np.int64]:
    """(k,) for each shape the other one that it resembles most: largest absolute cosine of their displacements."""
    rows = basis.rows.astype(np.float64)
    alike = np.abs(_unit(rows) @ _unit(rows).T)
    np.fill_diagonal(alike, -1)
    return alike.argmax(axis=1)


def smoothed(vertices: NDArray, triangles: NDArray, shapes: NDArray, length_m: float) -> NDArray[np.float64]:
    """Displacements (k, n, 3) after heat has flowed along the surface of vertices (n, 3), metres, for length^2 / 2.

    One implicit step, (M + t L) x = M d, which keeps the integral of a displacement over each piece of the surface. Points
    that no triangle uses keep theirs.
    """
    areas = vertex_areas(np.asarray(vertices, np.float64), triangles)
    areas[areas <= 0] = max(areas.mean(), 1e-12)
    laplacian = cotangent_laplacian(np.asarray(vertices, np.float64), triangles, least_weight=0.0)
    factor = Factor(sparse.diags_array(areas) + 0.5 * length_m**2 * laplacian)
    columns = np.moveaxis(shapes, 0, 1).reshape(len(vertices), -1)
    flat = factor.solve(areas[:, None] * columns)
    return np.ascontiguousarray(np.moveaxis(flat.reshape(len(vertices), len(shapes), 3), 1, 0))


def slip(vertices: NDArray, triangles: NDArray, shift_m: NDArray) -> sparse.csr_array:
    """(n, n) operator that reads a function at x + shift in place of x, along the surface; shift (n, 3) metres within a triangle.

    Each vertex takes the point of its own fan of triangles that lies that way: rows are weights that are not negative and sum
    to one, so nothing grows, linear functions on flat ground are exact, and nothing crosses an open seam as that between the
    lips. A vertex whose fan is open that way stays; one whose shift leaves the fan goes to its rim.
    """
    vertices, corner = np.asarray(vertices, np.float64), np.arange(3)
    at, first, second = (triangles[:, np.roll(corner, -turn)].ravel() for turn in range(3))
    to_first, to_second, way = vertices[first] - vertices[at], vertices[second] - vertices[at], np.asarray(shift_m)[at]
    aa, ab, bb = (np.einsum("nk,nk->n", u, v) for u, v in ((to_first, to_first), (to_first, to_second), (to_second, to_second)))
    a, b = np.einsum("nk,nk->n", to_first, way), np.einsum("nk,nk->n", to_second, way)
    twice = np.maximum(aa * bb - ab**2, 1e-30)
    weights = np.stack([bb * a - ab * b, aa * b - ab * a], axis=1) / twice[:, None]
    inside = np.flatnonzero(weights.min(axis=1) >= -1e-9)
    # of several triangles on curved ground the one that has the way most inside: the last one written wins
    inside = inside[np.argsort(weights[inside].min(axis=1), kind="stable")]
    chosen = np.full(len(vertices), -1)
    chosen[at[inside]] = inside
    moved = np.flatnonzero(chosen >= 0)
    chosen = chosen[moved]
    weights = np.maximum(weights[chosen], 0)
    weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1)
    change = np.concatenate([-weights.sum(axis=1), weights[:, 0], weights[:, 1]])
    columns = np.concatenate([moved, first[chosen], second[chosen]])
    shape = (len(vertices), len(vertices))
    return sparse.csr_array(
        sparse.eye_array(len(vertices)) + sparse.csr_array((change, (np.tile(moved, 3), columns)), shape=shape)
    )


def _random(seed: int, which: int) -> np.random.Generator:
    return np.random.default_rng((seed, _STREAM, which))


def _misplaced(basis: ExpressionBasis, shapes: NDArray, most_m: float, random: np.random.Generator) -> NDArray:
    """d(x + s) in place of d(x), s of its own for each shape, by flowing along the surface; both sides mirror each other.

    Open edges stay where they are, for a sculptor sees where lips and lids end; the slip has its whole length `most_m` from them.
    """
    edges = basis.neutral[basis.triangles[:, 1]] - basis.neutral[basis.triangles[:, 0]]
    steps = max(1, int(np.ceil(most_m / (_STEP * np.median(np.linalg.norm(edges, axis=1))))))
    free = np.minimum(_edge_distances(basis.neutral, basis.triangles) / most_m, 1)[:, None] / steps
    out = shapes.copy()
    mirrored = np.column_stack([np.tanh(_across(basis.neutral) / _MIDDLE_M), np.ones((len(free), 2))])
    for index, shift in enumerate(most_m * _directions(random, len(shapes))):
        operator = slip(basis.neutral, basis.triangles, shift * mirrored * free)
        for _ in range(steps):
            out[index] = operator @ out[index]
    return out


def _edge_distances(vertices: NDArray, triangles: NDArray) -> NDArray:
    """(n,) metres to the nearest vertex of an open edge; infinite on a closed surface."""
    open_vertices = vertices[boundary_mask(triangles, len(vertices))]
    return cKDTree(open_vertices).query(vertices)[0] if len(open_vertices) else np.full(len(vertices), np.inf)


def _turned(neutral: NDArray, shapes: NDArray, most: float, random: np.random.Generator) -> NDArray:
    """Displacements turned by a rotation vector whose parts are slow waves over the face, other ones for each shape.

    The two sides mirror each other, as sculptors work: what turns about an axis across the face is even, the rest is odd.
    """
    out = np.empty_like(shapes)
    across = _across(neutral)
    points = neutral.astype(np.float64) - neutral.mean(axis=0)
    for index, shape in enumerate(shapes):
        waves = 2 * np.pi / _WAVE_M * _unit(random.normal(size=(3, 3)))
        phases = points[:, 1:] @ waves[:, 1:].T + random.uniform(0, 2 * np.pi, 3)
        sides = across[:, None] * waves[:, 0]
        # three parts of one at most are sqrt(3) long at most
        angles = most / np.sqrt(3) * np.sin(phases) * np.column_stack([np.cos(sides[:, 0]), np.sin(sides[:, 1:])])
        out[index] = np.einsum("nij,nj->ni", rotation_matrices(angles), shape)
    return out


def _directions(random: np.random.Generator, count: int) -> NDArray:
    """(count, 3) of length 1/2 to 1, any way."""
    return random.uniform(0.5, 1, (count, 1)) * _unit(random.normal(size=(count, 3)))


def _across(neutral: NDArray) -> NDArray[np.float64]:
    """(n,) metres from the middle of the face, along x."""
    x = neutral[:, 0].astype(np.float64)
    return x - 0.5 * (x.min() + x.max())


def _unit(vectors: NDArray) -> NDArray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)


def _mixed(shapes: NDArray, nearest: NDArray, most: float, random: np.random.Generator) -> NDArray:
    norms = np.linalg.norm(shapes.reshape(len(shapes), -1), axis=1)
    amounts = most * random.uniform(0.5, 1, len(shapes)) * norms / np.maximum(norms[nearest], 1e-30)
    return shapes + amounts[:, None, None] * shapes[nearest]


def _uneven(neutral: NDArray, shapes: NDArray, most: float, random: np.random.Generator) -> NDArray:
    """Gain 1 + a tanh(2 x / half width), x from the middle of the face."""
    x = _across(neutral)
    sides = np.tanh(2 * x / max(np.abs(x).max(), 1e-12))
    amounts = random.uniform(0.5, 1, (len(shapes), 1)) * random.choice([-1, 1], (len(shapes), 1))
    gains = 1 + most * amounts * sides
    return shapes * gains[:, :, None]
