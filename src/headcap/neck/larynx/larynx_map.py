"""The larynx of the neck paper, section 3.1: a weight map that slides in the flat layout of the throat (eq. 1, 2).

T = T_0 + W(tau) alpha t_s. W is an image over the chart in metres of offset; sliding by tau moves its content up the throat:
the value at a vertex with chart position (u, v) is W(u, v - tau), for a larynx does not slide sideways. tau is in metres here and
grows upwards (the paper counts pixels downwards); alpha is free of units, 1 at rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy import sparse
from scipy.spatial import cKDTree

from headcap.artifacts import load_arrays, save_arrays
from headcap.errors import InputError
from headcap.heads import HeadModel, RestOffset
from headcap.meshes.laplacian import Factor
from headcap.neck.larynx.chart import NeckChart

KIND, SCHEMA = "larynx_map", 1
_ARRAYS = ("vertices", "uv_m", "window", "weights_m", "origin_m", "direction")


class LarynxSettings(BaseModel):
    """How the weight map is laid out."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    pitch_mm: float = Field(1.0, gt=0.1, le=4.0, description="Size of the weight map's pixels, on the skin")
    fade_mm: float = Field(6.0, gt=0.0, le=20.0, description="Width of the band inside the larynx region's border where it fades")
    margin_mm: float = Field(4.0, ge=0.0, description="Pixels of the map beyond the larynx region")


@dataclass(frozen=True, eq=False)
class LarynxMap:
    """W, t_s and where the head model's vertices lie on the map; k vertices of the larynx region L."""

    vertices: NDArray[np.int64]
    """(k,) vertices of L in the head model: no other vertex moves."""
    uv_m: NDArray[np.float64]
    """(k, 2) their chart positions, metres, v up."""
    window: NDArray[np.float64]
    """(k,) 0 on L's border B, rising to 1 inside: what makes the border stay, whatever tau and W are."""
    weights_m: NDArray[np.float64]
    """W, (rows, columns) metres; rows along v, upwards."""
    origin_m: NDArray[np.float64]
    """(2,) chart position u, v of the middle of pixel (0, 0)."""
    pitch_m: float
    direction: NDArray[np.float64]
    """t_s, (3,) of unit length, in the head's frame at rest."""
    topology_digest: str
    """Of the head model it belongs to."""

    def __post_init__(self) -> None:
        if not np.isclose(np.linalg.norm(self.direction), 1.0, atol=1e-6) or not np.isfinite(self.weights_m).all():
            raise InputError(
                f"larynx direction {self.direction}, {int((~np.isfinite(self.weights_m)).sum())} weights not finite",
                expected="a unit direction and finite weights",
                remedy="Normalise t_s and leave frames out that are not numbers.",
            )
        for name in _ARRAYS:
            view = getattr(self, name).view()
            view.flags.writeable = False  # what is kept of W for speed must stay true
            object.__setattr__(self, name, view)

    def with_weights(self, weights_m: NDArray, direction: NDArray | None = None) -> LarynxMap:
        """The map with another W (rows, columns) and t_s, as an update of training gives them (eq. 14, 19); t_s is normalised."""
        direction = self.direction if direction is None else np.asarray(direction, float) / np.linalg.norm(direction)
        return replace(self, weights_m=np.ascontiguousarray(weights_m, np.float64), direction=direction)

    def weights_at(self, tau_m: NDArray | float) -> tuple[NDArray, NDArray]:
        """W_l(tau) at the vertices (..., k), metres, and its derivative by tau (..., k), free of units, for slides (...)."""
        tau, batch = _flat(tau_m, "tau")
        values, slopes = np.empty((2, len(tau), len(self.vertices)))
        _sample(*self._profiles, tau / self.pitch_m, self.pitch_m, values, slopes)
        return values.reshape(*batch, -1), slopes.reshape(*batch, -1)

    def offset(self, tau_m: NDArray | float, alpha: NDArray | float = 1.0) -> RestOffset:
        """W_l(tau) alpha t_s of eq. 2 for slides and scales (...), to give to `HeadModel.evaluate`."""
        return self.offset_with_derivatives(tau_m, alpha)[0]

    def offset_with_derivatives(
        self, tau_m: NDArray | float, alpha: NDArray | float = 1.0
    ) -> tuple[RestOffset, NDArray[np.float64], NDArray[np.float64]]:
        """The offset of eq. 2 and its derivatives (..., k, 3) by tau (free of units) and by alpha (metres)."""
        batch = np.broadcast_shapes(np.shape(tau_m), np.shape(alpha))
        tau, alpha = (_flat(np.broadcast_to(given, batch), name)[0] for given, name in ((tau_m, "tau"), (alpha, "alpha")))
        value, by_tau, by_alpha = np.empty((3, len(tau), len(self.vertices), 3))
        _offset(*self._profiles, tau / self.pitch_m, self.pitch_m, alpha, self.direction, value, by_tau, by_alpha)
        shape = (*batch, len(self.vertices), 3)
        return RestOffset(self.vertices, value.reshape(shape)), by_tau.reshape(shape), by_alpha.reshape(shape)

    def sampling_matrix(self, tau_m: float) -> sparse.csr_array:
        """A (k, pixels) with W_l(tau) = A W.ravel(): what makes eq. 15 linear in W."""
        tau, _ = _flat(tau_m, "tau")
        column, fraction, row = self._places()
        rows, columns = self.weights_m.shape
        at = row - tau[0] / self.pitch_m
        first = np.floor(at)
        taps = _cubic(at - first)
        parts = []
        for k, tap in enumerate(taps):
            for side, share in enumerate((1.0 - fraction, fraction)):
                i, j = first.astype(int) + k - 1, column + side
                inside = (i >= 0) & (i < rows) & (j >= 0) & (j < columns)
                parts.append((np.flatnonzero(inside), (i * columns + j)[inside], (self.window * tap * share)[inside]))
        vertex, pixel, value = (np.concatenate(part) for part in zip(*parts, strict=True))
        return sparse.csr_array((value, (vertex, pixel)), shape=(len(self.vertices), rows * columns))

    def fitted(self, values_m: NDArray, smoothness: float = 0.01) -> LarynxMap:
        """The map whose W gives these values (k,) metres at the vertices at rest (eq. 10), smooth in between, 0 away from L.

        Least squares with a thin plate's bending, sum of squares + smoothness * integral of |W''|^2 (mm): the default rounds W
        off over half a millimetre. Where the window fades, W is what values and plate leave it.
        """
        sample = self.sampling_matrix(0.0)
        bending = smoothness * (1e-3 / self.pitch_m) ** 2 * self.bending()
        hold = sparse.diags_array(np.where(self.pixels_of_region(), 1e-9, 1.0))
        weights = Factor(sample.T @ sample + bending + hold).solve(sample.T @ np.asarray(values_m, float))
        return self.with_weights(weights.reshape(self.weights_m.shape))

    def pixels_of_region(self) -> NDArray[np.bool_]:
        """(pixels,) true within twice the vertices' spacing of the larynx region: where W can show at rest."""
        tree = cKDTree(self.uv_m)
        spacing = np.median(tree.query(self.uv_m, k=2)[0][:, 1])
        rows, columns = self.weights_m.shape
        across, along = np.meshgrid(np.arange(columns), np.arange(rows))
        places = self.origin_m + self.pitch_m * np.stack([across.ravel(), along.ravel()], axis=1)
        return tree.query(places)[0] < 2.0 * spacing

    def bending(self) -> sparse.csr_array:
        """(pixels, pixels) thin plate of W: W^T B W is the sum over pixels of its squared second differences."""
        return _second_differences(self.weights_m.shape)

    def check(self, model: HeadModel) -> None:
        """Raise `InputError` where the map belongs to a head model of another topology."""
        if model.topology_digest != self.topology_digest:
            raise InputError(
                f"a larynx map of topology {self.topology_digest[:12]} on head model {model.name} ({model.topology_digest[:12]})",
                expected="the head model the map was made for",
                remedy="Train the larynx again on this head model, or load the one it came with.",
            )

    def to_arrays(self) -> tuple[dict[str, NDArray], dict]:
        """Arrays and plain record that tell the map; `from_arrays` is the inverse."""
        return {name: getattr(self, name) for name in _ARRAYS}, {"pitch_m": self.pitch_m, "topology_digest": self.topology_digest}

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray], meta: dict) -> LarynxMap:
        """The map that `to_arrays` told."""
        return cls(**arrays, **meta)

    def save(self, path: Path | str) -> None:
        """Write as npz artifact `headcap.larynx_map/1`."""
        save_arrays(path, KIND, SCHEMA, *self.to_arrays())

    @classmethod
    def load(cls, path: Path | str) -> LarynxMap:
        """Read what `save` wrote; raises `ArtifactError`."""
        return cls.from_arrays(*load_arrays(path, KIND, SCHEMA))

    def _places(self) -> tuple[NDArray, NDArray, NDArray]:
        """Each vertex's column, share of the next column, and row (fractional), in pixels."""
        across, along = ((self.uv_m - self.origin_m) / self.pitch_m).T
        column = np.floor(across).astype(np.int64)
        return column, across - column, along

    @cached_property
    def _profiles(self) -> tuple[NDArray, NDArray]:
        """(k, rows + 2 pads) what W shows each vertex along its slide, window included, zero at both ends; (k,) rows in there.

        A vertex only ever sees the image along v, so interpolation across and the window are done once for all slides.
        """
        column, fraction, row = self._places()
        image = np.pad(self.weights_m, ((_PAD, _PAD), (1, 2)))
        column = np.clip(column + 1, 0, image.shape[1] - 2)
        across = image[:, column] * (1.0 - fraction) + image[:, column + 1] * fraction
        return np.ascontiguousarray((across * self.window).T), row + _PAD


_PAD = 4
"""Zero rows at each end of a profile: four taps beyond the image find nothing there."""


def _flat(values: NDArray | float, name: str) -> tuple[NDArray, tuple[int, ...]]:
    """Coefficients of any shape as (frames,), and their shape."""
    values = np.array(values, float)
    if not np.isfinite(values).all():
        raise InputError(
            f"{int((~np.isfinite(values)).sum())} of {values.size} larynx coefficients {name} are not finite",
            expected="numbers",
            remedy="Leave those frames out.",
        )
    return values.ravel(), values.shape


FORWARD = np.array([0.0, 0.0, 1.0])
"""Direction of an empty larynx map, until eq. 9 gives it another."""


def larynx_map(
    model: HeadModel, chart: NeckChart, direction: NDArray = FORWARD, settings: LarynxSettings | None = None
) -> LarynxMap:
    """An empty map (W = 0) over a head model's larynx region, with direction t_s (3,), normalised.

    Fill it with `fitted` (values at vertices, eq. 10) or `with_weights`. Raises `InputError` where the chart is of another model
    or does not hold the region.
    """
    settings = settings or LarynxSettings()
    region = np.asarray(model.regions["larynx"])
    inside = region[chart.vertices]
    if chart.topology_digest != model.topology_digest or inside.sum() < region.sum():
        raise InputError(
            f"the chart holds {int(inside.sum())} of {int(region.sum())} vertices of the larynx region of {model.name}",
            expected="a chart of this model's front neck that covers its larynx region",
            remedy="Build the chart from this model.",
        )
    pitch, margin = 1e-3 * settings.pitch_mm, 1e-3 * settings.margin_mm
    places = chart.uv_m[inside]
    low, high = places.min(axis=0) - margin, places.max(axis=0) + margin
    columns, rows = np.ceil((high - low) / pitch).astype(int) + 1
    direction = np.asarray(direction, np.float64)
    length = np.linalg.norm(direction)
    return LarynxMap(
        vertices=chart.vertices[inside],
        uv_m=places,
        window=_window(chart, inside, model.regions["larynx_boundary"][chart.vertices], 1e-3 * settings.fade_mm),
        weights_m=np.zeros((rows, columns)),
        origin_m=low,
        pitch_m=pitch,
        direction=direction / length if length > 0 else direction,
        topology_digest=model.topology_digest,
    )


def _window(chart: NeckChart, inside: NDArray[np.bool_], border: NDArray[np.bool_], fade_m: float) -> NDArray[np.float64]:
    """(k,) smoothstep of the chart distance to L's border, exactly 0 on it."""
    distance, _ = cKDTree(chart.uv_m[border]).query(chart.uv_m[inside])
    t = np.clip(distance / fade_m, 0.0, 1.0)
    window = t * t * (3.0 - 2.0 * t)
    window[border[inside]] = 0.0
    return window


def _second_differences(shape: tuple[int, int]) -> sparse.csr_array:
    """(pixels, pixels) thin-plate bending of an image: squares of its second differences along, across and mixed."""

    def chain(n: int, order: int) -> sparse.csr_array:
        """Differences of an order along a chain of n pixels."""
        stencil = {0: [1.0], 1: [-1.0, 1.0], 2: [1.0, -2.0, 1.0]}[order]
        return sparse.diags_array(stencil, offsets=range(order + 1), shape=(n - order, n)).tocsr()

    rows, columns = shape
    parts = ((2, 0, 1.0), (0, 2, 1.0), (1, 1, 2.0))
    terms = ((sparse.kron(chain(rows, i), chain(columns, j)), weight) for i, j, weight in parts)
    return sparse.csr_array(sum(weight * (term.T @ term) for term, weight in terms))


def _cubic(t: NDArray) -> tuple[NDArray, ...]:
    """Weights of four neighbouring rows at fraction t behind the second (Catmull-Rom: interpolating, smooth slope)."""
    return (
        -0.5 * t + t * t - 0.5 * t**3,
        1.0 - 2.5 * t * t + 1.5 * t**3,
        0.5 * t + 2.0 * t * t - 1.5 * t**3,
        -0.5 * t * t + 0.5 * t**3,
    )


@njit(cache=True, inline="always")
def _at(profile, x):
    """A profile at the fractional row x and its derivative by x: cubic (Catmull-Rom), so that the derivative is smooth."""
    # beyond the image all is zero; the clamp keeps the four taps inside the pad
    x = min(max(x, 1.0), len(profile) - 2.000001)
    first = int(x)
    t = x - first
    a, b, c, d = profile[first - 1], profile[first], profile[first + 1], profile[first + 2]
    one, two, three = 0.5 * (c - a), a - 2.5 * b + 2.0 * c - 0.5 * d, 0.5 * (d - a) + 1.5 * (b - c)
    return b + t * (one + t * (two + t * three)), one + t * (2.0 * two + 3.0 * t * three)


@njit(cache=True)
def _sample(profiles, row, shift, pitch, values, slopes):
    for f in range(len(shift)):
        for i in range(len(row)):
            value, slope = _at(profiles[i], row[i] - shift[f])
            values[f, i] = value
            slopes[f, i] = -slope / pitch


@njit(cache=True)
def _offset(profiles, row, shift, pitch, alpha, direction, value, by_tau, by_alpha):
    tx, ty, tz = direction[0], direction[1], direction[2]
    for f in range(len(shift)):
        scale, steep = alpha[f], -alpha[f] / pitch
        for i in range(len(row)):
            w, slope = _at(profiles[i], row[i] - shift[f])
            slope *= steep
            by_alpha[f, i, 0], by_alpha[f, i, 1], by_alpha[f, i, 2] = w * tx, w * ty, w * tz
            by_tau[f, i, 0], by_tau[f, i, 1], by_tau[f, i, 2] = slope * tx, slope * ty, slope * tz
            w *= scale
            value[f, i, 0], value[f, i, 1], value[f, i, 2] = w * tx, w * ty, w * tz
