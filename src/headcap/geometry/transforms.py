"""Rigid transforms as (..., 4, 4) arrays named `target_from_source`."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


def rigid(rotation: Array, translation: Array) -> Array:
    """Stack rotation (..., 3, 3) and translation (..., 3) into (..., 4, 4)."""
    rotation, translation = np.asarray(rotation, float), np.asarray(translation, float)
    out = np.zeros((*np.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1]), 4, 4))
    out[..., :3, :3], out[..., :3, 3], out[..., 3, 3] = rotation, translation, 1.0
    return out


def invert(target_from_source: Array) -> Array:
    """Inverse of rigid transforms (..., 4, 4), without a general matrix inverse."""
    rotation = np.swapaxes(target_from_source[..., :3, :3], -1, -2)
    return rigid(rotation, -np.einsum("...ij,...j->...i", rotation, target_from_source[..., :3, 3]))


def transform(target_from_source: Array, points: Array) -> Array:
    """Apply one transform (4, 4) to points (..., 3)."""
    return points @ target_from_source[:3, :3].T + target_from_source[:3, 3]


def from_vector(vector: Array) -> Array:
    """Rotation vector and translation (..., 6), radians and metres, to (..., 4, 4)."""
    vector = np.asarray(vector, float)
    flat = vector.reshape(-1, 6)
    rotation = Rotation.from_rotvec(flat[:, :3]).as_matrix()
    return rigid(rotation, flat[:, 3:]).reshape((*vector.shape[:-1], 4, 4))


def to_vector(target_from_source: Array) -> Array:
    """Inverse of `from_vector`: (..., 4, 4) to (..., 6)."""
    flat = np.asarray(target_from_source, float).reshape(-1, 4, 4)
    vector = np.hstack([Rotation.from_matrix(flat[:, :3, :3]).as_rotvec(), flat[:, :3, 3]])
    return vector.reshape((*target_from_source.shape[:-2], 6))


def rotation_angle(rotation: Array) -> Array:
    """Geodesic angle in radians of rotations (..., 3, 3)."""
    flat = np.asarray(rotation, float).reshape(-1, 3, 3)
    return Rotation.from_matrix(flat).magnitude().reshape(rotation.shape[:-2])


def fit_rigid(source: Array, target: Array, weights: Array | None = None) -> Array:
    """Least-squares rigid transform target_from_source (4, 4) between points (n, 3) (Kabsch)."""
    return _fit(source, target, weights, with_scale=False)[0]


def fit_similarity(source: Array, target: Array, weights: Array | None = None) -> tuple[Array, float]:
    """Least-squares similarity: rigid (4, 4) and scale, target = R (scale * source) + t (Umeyama)."""
    return _fit(source, target, weights, with_scale=True)


def _fit(source: Array, target: Array, weights: Array | None, *, with_scale: bool) -> tuple[Array, float]:
    if source.shape != target.shape or source.ndim != 2 or len(source) < 3:
        raise ValueError(f"fit needs two (n >= 3, 3) arrays of one shape, got {source.shape} and {target.shape}")
    weights = np.ones(len(source)) if weights is None else np.asarray(weights, float)
    weights = weights / weights.sum()
    source_mean, target_mean = weights @ source, weights @ target
    s, t = source - source_mean, target - target_mean
    u, d, vt = np.linalg.svd((t * weights[:, None]).T @ s)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * sign) @ vt
    scale = float((d * sign).sum() / (weights @ (s**2).sum(1))) if with_scale else 1.0
    return rigid(rotation, target_mean - scale * rotation @ source_mean), scale
