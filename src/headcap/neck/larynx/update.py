"""The larynx model from all frames: T_0 and W together (eq. 14 to 18), then t_s (eq. 19).

All frames enter through sums over bins of tau, so that the least-squares problem costs the same for a hundred frames as for a
hundred thousand. Between bins W_l(tau) is taken as linear: with bins of a quarter millimetre that is off by less than a
micrometre for a bump 5 mm high.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy import sparse

from headcap.meshes.laplacian import Factor
from headcap.neck.larynx.base_shape import Throat
from headcap.neck.larynx.larynx_map import LarynxMap


class LarynxUpdateSettings(BaseModel):
    """Weights of eq. 14 and 17, per frame: they mean the same for short and long takes."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    laplacian: float = Field(0.1, ge=0, description="lambda_1, of the base's Laplacian")
    regularisation: float = Field(0.05, gt=0, description="lambda_2, of staying near the iteration before")
    base_stay: float = Field(1.0, gt=0, description="lambda_T, of the base in lambda_2's term")
    weights_stay: float = Field(0.2, gt=0, description="lambda_W, of the weight map in lambda_2's term")
    boundary: float = Field(10.0, ge=0, description="lambda_3, of the base's border")
    bin_mm: float = Field(0.25, gt=0, description="Width of the bins of tau")


@dataclass
class SlideSums:
    """Sums over frames by bins of tau: all that eq. 14 and 19 need to know of them."""

    larynx: LarynxMap
    bin_m: float
    first: int = 0
    frames: int = 0
    total: NDArray | None = None
    """(k, 3) sum of T_j."""
    squared: float = 0.0
    """Sum of |T_j|^2."""
    linear: NDArray | None = None
    """(bins,) sum of alpha."""
    own: NDArray | None = None
    """(bins,) sum of alpha^2 within bins."""
    mixed: NDArray | None = None
    """(bins,) sum of alpha^2 between a bin and the next."""
    moment: NDArray | None = None
    """(bins, k, 3) sum of alpha T_j."""

    @classmethod
    def over(cls, larynx: LarynxMap, low_m: float, high_m: float, bin_m: float) -> SlideSums:
        """Empty sums for slides between two bounds."""
        first = int(np.floor(low_m / bin_m))
        bins = int(np.floor(high_m / bin_m)) - first + 2
        k = len(larynx.vertices)
        zeros = [np.zeros(bins) for _ in range(3)]
        return cls(larynx, bin_m, first, 0, np.zeros((k, 3)), 0.0, *zeros, np.zeros((bins, k, 3)))

    def add(self, throats: NDArray, tau: NDArray, alpha: NDArray) -> None:
        """Frames T_j (f, k, 3) of eq. 11 with their coefficients (f,)."""
        place = tau / self.bin_m - self.first
        low = np.clip(np.floor(place).astype(int), 0, len(self.linear) - 2)
        share = place - low
        self.frames += len(throats)
        self.total += throats.sum(axis=0)
        self.squared += float((np.asarray(throats, float) ** 2).sum())
        bins = len(self.linear)
        self.mixed += np.bincount(low, alpha**2 * share * (1 - share), bins)
        for step, part in ((0, 1 - share), (1, share)):
            self.linear += np.bincount(low + step, alpha * part, bins)
            self.own += np.bincount(low + step, (alpha * part) ** 2, bins)
            gather = sparse.csr_array((alpha * part, (low + step, np.arange(len(low)))), shape=(bins, len(low)))
            self.moment += (gather @ throats.reshape(len(throats), -1)).reshape(self.moment.shape)

    def matrices(self) -> list[sparse.csr_array]:
        """A (k, pixels) of each bin: W at the vertices is A W."""
        return [self.larynx.sampling_matrix((self.first + b) * self.bin_m) for b in range(len(self.linear))]


def update_larynx(
    sums: SlideSums, throat: Throat, base: NDArray, settings: LarynxUpdateSettings
) -> tuple[NDArray[np.float64], LarynxMap]:
    """T_0 on L (k, 3) and the larynx map with W by eq. 14, then t_s by eq. 19, from the ones before.

    Along t_s base and weights are one sparse least-squares problem; across it the base stands alone.
    """
    larynx, k, scale = sums.larynx, len(base), float(sums.frames)
    stay, hold = settings.regularisation * settings.base_stay, settings.regularisation * settings.weights_stay
    border = settings.boundary * throat.border.astype(float)
    matrix = scale * (settings.laplacian * throat.stiffness + sparse.diags_array(1.0 + stay + border))
    right = sums.total + scale * (stay * base + border[:, None] * throat.neutral - settings.laplacian * throat.pull)
    samples = sums.matrices()
    cross = sparse.csr_array(sum(s * a for s, a in zip(sums.linear, samples, strict=True)))
    weights = sum(s * (a.T @ a) for s, a in zip(sums.own, samples, strict=True) if s > 0)
    for s, a, b in zip(sums.mixed, samples, samples[1:] + samples[-1:], strict=True):
        if s > 0:
            weights = weights + s * (a.T @ b + b.T @ a)
    direction = larynx.direction
    moment = sum(a.T @ (m @ direction) for a, m in zip(samples, sums.moment, strict=True))
    pixels = larynx.weights_m.size
    whole = sparse.block_array([[matrix, cross], [cross.T, weights + scale * hold * sparse.eye_array(pixels)]])
    along = Factor(sparse.csr_array(whole)).solve(
        np.concatenate([right @ direction, moment + scale * hold * larynx.weights_m.ravel()])
    )
    across = right - np.outer(right @ direction, direction)
    moved = Factor(matrix).solve(across) + np.outer(along[:k], direction)
    found = larynx.with_weights(along[k:].reshape(larynx.weights_m.shape))
    return moved, _redirected(sums, samples, moved, found)


def _redirected(sums: SlideSums, samples: list[sparse.csr_array], base: NDArray, larynx: LarynxMap) -> LarynxMap:
    """The map with t_s of eq. 19; its length goes into W, so that the offsets are those of the least-squares solution."""
    shown = np.array([a @ larynx.weights_m.ravel() for a in samples])
    moved = np.einsum("bk,bki->i", shown, sums.moment) - np.einsum("b,bk,ki->i", sums.linear, shown, base)
    strength = float(sums.own @ (shown**2).sum(axis=1) + 2 * (sums.mixed[:-1] @ (shown[:-1] * shown[1:]).sum(axis=1)))
    vector = moved / max(strength, 1e-18)
    length = np.linalg.norm(vector)
    return larynx if length < 1e-9 else larynx.with_weights(length * larynx.weights_m, vector)
