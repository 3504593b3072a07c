"""The region of skin that is painted over, laid out as a texture of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra

from headcap.errors import InputError
from headcap.lips.inpainting.settings import InpaintingSettings
from headcap.meshes.rasteriser import rasterise_pixels
from headcap.registration.graph import edge_graph
from headcap.registration.template import Template

_GUTTER_TEXELS = 6
_OUTER, _INNER = ("lips_upper", "lips_lower"), ("lips_inner_upper", "lips_inner_lower")


@dataclass(frozen=True, eq=False)
class LipRegion:
    """Triangles about the mouth with a texture atlas; a head of n vertices and m triangles, t texels.

    The atlas holds the charts of the head's own texture coordinates, cut to the region and set side by side, largest first.
    """

    triangles: NDArray[np.int32]
    """(m, 3) of the whole head: what may hide the mouth."""
    chosen: NDArray[np.int64]
    """(r,) triangles of the region."""
    weight: NDArray[np.float64]
    """(n,) how much of a pixel is painted over: 1 on the lips and about them, 0 at the region's rim and outside."""
    atlas: NDArray[np.float64]
    """(c, 2) texels, column and row; texel (0, 0)'s centre is 0."""
    atlas_triangles: NDArray[np.int32]
    """(r, 3) into `atlas`."""
    shape: NDArray[np.int64]
    """(2,) height and width of the atlas."""
    first_width: int
    """Columns of the first chart: skin and lips as they are seen from outside."""
    texel: NDArray[np.int64]
    """(t, 2) row and column of the texels that lie in a triangle."""
    texel_triangle: NDArray[np.int64]
    """(t,) which of `chosen`."""
    texel_barycentric: NDArray[np.float64]
    """(t, 3)."""

    @classmethod
    def of(cls, template: Template, settings: InpaintingSettings) -> LipRegion:
        """The region of a neutral head, metres; raises `InputError` without lips or texture coordinates."""
        weight = _weights(template, settings)
        chosen = np.flatnonzero((weight[template.triangles] > 0).any(axis=1))
        atlas, triangles, shape, first = _lay_out(template, chosen, settings.texel_mm)
        raster = rasterise_pixels(atlas, np.ones(len(atlas)), triangles, (shape[1], shape[0]))
        texel = np.argwhere(raster.hit)
        at = tuple(texel.T)
        inside = raster.barycentric[at].astype(float)
        return cls(
            np.ascontiguousarray(template.triangles, np.int32), chosen, weight, atlas, triangles, np.array(shape), first,
            texel, raster.triangle[at].astype(np.int64), inside,
        )  # fmt: skip

    @property
    def corners(self) -> NDArray[np.int32]:
        """(t, 3) vertices around each texel."""
        return self.triangles[self.chosen[self.texel_triangle]]

    @property
    def vertices(self) -> NDArray[np.int64]:
        """(k,) vertices of the region."""
        return np.unique(self.triangles[self.chosen]).astype(np.int64)

    def at_texels(self, values: NDArray) -> NDArray[np.float64]:
        """Values (n, k) at vertices, between them (t, k)."""
        return np.einsum("tc,tck->tk", self.texel_barycentric, values[self.corners])

    def spread(self, values: NDArray, fill: float = 0.0) -> NDArray[np.float64]:
        """Values (t, k) of texels as an atlas (height, width, k)."""
        out = np.full((*self.shape, values.shape[1]), fill)
        out[tuple(self.texel.T)] = values
        return out


def _weights(template: Template, settings: InpaintingSettings) -> NDArray[np.float64]:
    regions, n = template.regions, len(template.vertices)
    missing = [name for name in _OUTER if not regions.get(name, np.zeros(n, bool)).any()]
    if missing:
        raise InputError(
            f"a head without {' and '.join(missing)}",
            expected="lips among the regions of the template",
            remedy="Register the scan with a head model that has lips.",
        )
    lips = regions["lips_upper"] | regions["lips_lower"]
    away_mm = 1e3 * dijkstra(
        edge_graph(template.vertices, template.triangles), indices=np.flatnonzero(lips), min_only=True,
        limit=1e-3 * settings.reach_mm,
    )  # fmt: skip
    inside = np.any([regions[name] for name in (*_INNER, "mouth_interior") if name in regions] or [~lips & lips], axis=0)
    inside &= ~lips
    outer = _step((settings.reach_mm - away_mm) / settings.feather_mm)
    inner = _step((settings.inside_mm - away_mm) / (0.5 * settings.inside_mm))
    return np.where(inside, inner, outer)


def _step(part: NDArray) -> NDArray[np.float64]:
    part = np.clip(np.nan_to_num(part, neginf=0.0), 0, 1)
    return part * part * (3 - 2 * part)


def _lay_out(template: Template, chosen: NDArray, texel_mm: float) -> tuple[NDArray, NDArray, tuple[int, int], int]:
    """Corners (c, 2) in texels, triangles over them, (height, width), columns of the first chart."""
    used, inverse = np.unique(template.uv_triangles[chosen], return_inverse=True)
    triangles, uv = inverse.reshape(-1, 3).astype(np.int32), np.asarray(template.uv, float)[used]
    ends = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    corners = template.triangles[chosen]
    skin = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    length_mm = 1e3 * np.linalg.norm(template.vertices[skin[:, 0]] - template.vertices[skin[:, 1]], axis=1)
    drawn = np.linalg.norm(uv[ends[:, 0]] - uv[ends[:, 1]], axis=1)
    if not (drawn > 1e-9).all():
        raise InputError(
            f"texture coordinates that draw {(drawn <= 1e-9).sum()} edges about the mouth as points",
            expected="an unwrapped mouth",
            remedy="Use a template with texture coordinates.",
        )
    uv = uv * (np.median(length_mm / drawn) / texel_mm)
    graph = sparse.coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(uv), len(uv)))
    count, chart = connected_components(graph, directed=False)
    order = np.argsort(-np.bincount(chart, minlength=count), kind="stable")
    x, height, first = 0, 0, 0
    for number in order:
        here = chart == number
        low = uv[here].min(axis=0) - _GUTTER_TEXELS
        span = np.ceil(np.ptp(uv[here], axis=0) + 2 * _GUTTER_TEXELS).astype(int) + 1
        uv[here] += [x - low[0], -low[1]]
        x, height, first = x + int(span[0]), max(height, int(span[1])), first or int(span[0])
    return uv, triangles, (height, x), first
