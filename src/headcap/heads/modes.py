"""Generic blendshapes for a head that brings none: smooth, scaled to spread as people do, ordered by variance; not learned."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import diags_array
from scipy.sparse.linalg import eigsh
from scipy.spatial.distance import cdist

from headcap.meshes.laplacian import cotangent_laplacian, vertex_areas

_SHAPE_SCALES = ((0.12, 0.0040), (0.06, 0.0022), (0.03, 0.0010))
"""Width of the Gaussian and standard deviation of skin it moves, metres: proportions, features, details."""
_SYMMETRY = 0.85
"""Correlation of a place with its mirror image: heads differ more from each other than their halves."""
_ANCHORS = 300
_EXPRESSION_REACH_M, _EXPRESSION_SPREAD_M = 0.03, 0.003


def shape_modes(vertices: NDArray, count: int) -> NDArray[np.float64]:
    """(count, n, 3) metres per standard deviation: leading modes of a Gaussian process on the head (n, 3), mirrored at x = 0.

    The covariance is a sum of Gaussians of `_SHAPE_SCALES` with a mirrored part (Luethi et al. 2018, "Gaussian process morphable
    models", 3.1 and 3.3), reduced by Nystroem's method on anchors spread evenly.
    """
    anchors = vertices[_spread(vertices, min(_ANCHORS, len(vertices)))]
    (near, mirrored), (near_all, mirrored_all) = _covariances(anchors, anchors), _covariances(vertices, anchors)
    modes = []
    for odd in (True, False):
        # across the midplane mirror images move against each other, along it together
        sign = -_SYMMETRY if odd else _SYMMETRY
        inside, across = near + sign * mirrored, near_all + sign * mirrored_all
        values, vectors = np.linalg.eigh(inside)
        lead = np.argsort(values)[::-1][:count]
        # an eigenfunction of the process at any place, times the root of its variance on the anchors
        fields = across @ (vectors[:, lead] / np.sqrt(values[lead]))
        for axis in (0,) if odd else (1, 2):
            modes += [(values[k], axis, fields[:, at]) for at, k in enumerate(lead)]
    modes.sort(key=lambda mode: -mode[0])
    out = np.zeros((count, len(vertices), 3))
    for row, (_, axis, values) in zip(out, modes, strict=False):
        row[:, axis] = values
    return out


def surface_modes(vertices: NDArray, triangles: NDArray, moving: NDArray[np.bool_], count: int) -> NDArray[np.float64]:
    """(count, n, 3) metres per standard deviation: smooth motion of a part (n,) of a surface, zero outside, along each axis.

    Lowest eigenfunctions of the Laplacian on the part with zero border values: distances count along the skin, so the lips move
    apart. The spectrum is Matern's, 1 / (1 + (reach)^2 lambda).
    """
    laplacian = cotangent_laplacian(vertices, triangles, least_weight=0.0)[moving][:, moving]
    areas = vertex_areas(vertices, triangles)[moving]
    wanted = -(-count // 3)
    values, fields = eigsh(laplacian, wanted, diags_array(areas), sigma=0.0, v0=np.ones(len(areas)))
    spread = _EXPRESSION_SPREAD_M / (1.0 + _EXPRESSION_REACH_M**2 * values)
    fields = fields / np.sqrt((fields**2).mean(axis=0)) * np.sign(fields.sum(axis=0) + 1e-300) * spread
    out = np.zeros((3 * wanted, len(vertices), 3))
    for axis in range(3):
        out[axis::3, moving, axis] = fields.T
    return out[:count]


def _covariances(a: NDArray, b: NDArray) -> tuple[NDArray, NDArray]:
    """Scalar covariances (i, j) of places a (i, 3) with places b (j, 3), and with their mirror images."""
    squared = (cdist(a, c, "sqeuclidean") for c in (b, b * [-1.0, 1.0, 1.0]))
    return tuple(sum(s**2 / (1.0 + _SYMMETRY) * np.exp(-0.5 / w**2 * d) for w, s in _SHAPE_SCALES) for d in squared)


def _spread(points: NDArray, count: int) -> NDArray[np.int64]:
    """Indices (count,) of points each farthest from those before it."""
    chosen = np.zeros(count, np.int64)
    distance = ((points - points[0]) ** 2).sum(1)
    for k in range(1, count):
        chosen[k] = distance.argmax()
        distance = np.minimum(distance, ((points - points[chosen[k]]) ** 2).sum(1))
    return chosen
