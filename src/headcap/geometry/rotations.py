"""Rotation vectors (axis times angle, radians): the exponential map and its derivative, accurate at every angle."""

import numpy as np
from numpy.typing import NDArray

_SERIES_BELOW = 0.25
"""Squared angle below which power series replace quotients that cancel there."""
_SERIES_TERMS = 9


def rotation_matrices(vectors: NDArray) -> NDArray:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3), radians: exp of the cross-product matrix (Rodrigues)."""
    vectors = np.asarray(vectors)
    sine, cosine, _, _ = _coefficients((vectors**2).sum(-1))
    cross = cross_matrices(vectors)
    return np.eye(3, dtype=vectors.dtype) + sine * cross + cosine * (cross @ cross)


def rotation_derivatives(vectors: NDArray) -> tuple[NDArray, NDArray]:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3) and their derivatives (..., 3, 3, 3).

    The derivative's third axis from the end is the component of the vector. With K the cross-product matrix,
    R = I + a K + b K^2, a = sin t / t, b = (1 - cos t) / t^2, and dR/dv_i = a E_i + a' v_i K + b (E_i K + K E_i) + b' v_i K^2,
    where a' = (cos t - a) / t^2 and b' = (a - 2 b) / t^2 stay finite at t = 0.
    """
    vectors = np.asarray(vectors)
    sine, cosine, sine_slope, cosine_slope = _coefficients((vectors**2).sum(-1))
    cross = cross_matrices(vectors)
    square = cross @ cross
    rotation = np.eye(3, dtype=vectors.dtype) + sine * cross + cosine * square
    units = cross_matrices(np.eye(3, dtype=vectors.dtype))
    mixed = units @ cross[..., None, :, :] + cross[..., None, :, :] @ units
    turn = (sine_slope * cross + cosine_slope * square)[..., None, :, :]
    derivative = sine[..., None] * units + cosine[..., None] * mixed + vectors[..., None, None] * turn
    return rotation, derivative


def cross_matrices(vectors: NDArray) -> NDArray:
    """Matrices (..., 3, 3) K with K x = v cross x, of vectors (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(vectors), -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape((*x.shape, 3, 3))


def _coefficients(squared: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """a, b, a', b' of `rotation_derivatives` as (..., 1, 1), for squared angles (...)."""
    small = squared < _SERIES_BELOW
    safe = np.where(small, 1.0, squared)
    angle = np.sqrt(safe)
    a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / safe
    quotients = (a, b, (np.cos(angle) - a) / safe, (a - 2.0 * b) / safe)
    near = np.where(small, squared, 0.0)
    both = (np.where(small, _series(near, which), far) for which, far in enumerate(quotients))
    return tuple(np.asarray(value, squared.dtype)[..., None, None] for value in both)


def _series(squared: NDArray, which: int) -> NDArray:
    total = np.zeros_like(squared)
    for term in reversed(_POWER_SERIES[which]):
        total = total * squared + term
    return total


def _power_series() -> tuple[list[float], ...]:
    """Taylor coefficients in x = t^2: a = sum (-x)^k / (2k+1)!, b = sum (-x)^k / (2k+2)!, a' = 2 da/dx, b' = 2 db/dx."""
    inverse = 1.0 / np.cumprod([1.0, *range(1, 2 * _SERIES_TERMS + 4)])
    a = [(-1.0) ** k * inverse[2 * k + 1] for k in range(_SERIES_TERMS + 1)]
    b = [(-1.0) ** k * inverse[2 * k + 2] for k in range(_SERIES_TERMS + 1)]
    return a, b, *([2.0 * k * c for k, c in enumerate(series)][1:] for series in (a, b))


_POWER_SERIES = _power_series()
