"""Tattooed frames with the bare lips painted in, shaded as the frame is (section 3.2.1)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.ndimage import distance_transform_edt

from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.lips.inpainting.region import LipRegion
from headcap.lips.inpainting.texture import LipTexture
from headcap.lips.inpainting.views import TexelView, cropped, view_texels, window
from headcap.meshes.laplacian import Factor, bilaplacian, cotangent_laplacian, vertex_areas
from headcap.meshes.rasteriser import rasterise

_LEAST_TEXELS = 200
_GUTTER_TEXELS = 3.0
"""So far from a chart texels are looked at between those on it."""
_ASKED_MM = 0.6
_UNSEEN_HOLD = 1e-6
"""Weight that keeps vertices nobody sees, and no neighbour reaches, from being undetermined."""


class LipPainter:
    """Paints into one camera's tattooed frames; make one per take or person."""

    def __init__(self, texture: LipTexture, camera: Camera, mesh: NDArray, picture: NDArray[np.uint8]) -> None:
        """`mesh` (n, 3) and `picture` (height, width, 3) of `camera` are the reference pose: the tattooed frame that is most like
        the untattooed one (`most_alike`). Raises `InputError` where it does not show the mouth."""
        self.texture, self.camera, self._settings = texture, camera, texture.settings
        self._smoother = _Smoother(texture.region, texture.mesh, self._settings.texel_mm, self._settings.smoothing_mm)
        self._gutter, self._beside = _gutter(texture.region)
        self._reference = self.view(mesh, picture)
        if (self._reference.weight > 0).sum() < _LEAST_TEXELS:
            raise InputError(
                f"camera {camera.name} does not see the mouth in the reference pose",
                expected="a frame of the tattooed takes that shows the lips",
                remedy="Choose a camera in front of the face.",
            )

    def view(self, mesh: NDArray, picture: NDArray[np.uint8]) -> TexelView:
        """The region's texels as a frame shows them: `mesh` (n, 3), metres, `picture` (height, width, 3)."""
        return view_texels(self.texture.region, self.camera, mesh, picture)

    def shaded(self, mesh: NDArray, picture: NDArray[np.uint8]) -> NDArray[np.float32]:
        """The untattooed atlas (h, w, 3) as bright as a tattooed frame shows the lips.

        Shading equalisation: per pixel of the lip region the intensities of the frame less those of the reference pose, which
        carry the same tattoo, are added to the untattooed texture. Ink scales what light does, so that the tattoo shows in the
        difference too; what is left of it is smoothed away on the surface, where the lips are apart however they touch.
        """
        if not self._settings.equalise:
            return self.texture.colours
        now, before = self.view(mesh, picture), self._reference
        weight = np.minimum(now.weight, before.weight)
        if (weight > 0).sum() < _LEAST_TEXELS:
            return self.texture.colours
        out = self.texture.colours.copy()
        shaded = self.texture.of_texels + self._smoother(now.colours - before.colours, weight)
        out[tuple(self.texture.region.texel.T)] = np.clip(shaded, 0, 255)
        out[self._gutter] = out[self._beside]
        return out

    def paint(self, mesh: NDArray, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The frame (height, width, 3) with the tattoo painted over, feathered towards the region's border; no pixel outside the
        region is touched."""
        return composite(
            self.texture.region, self.camera, mesh, picture, self.shaded(mesh, picture), self._settings.supersampling
        )


def composite(
    region: LipRegion, camera: Camera, mesh: NDArray, picture: NDArray[np.uint8], atlas: NDArray, supersampling: int
) -> NDArray[np.uint8]:
    """The picture (height, width, 3) with the region of a mesh (n, 3) painted over it in the colours of an atlas (h, w, 3)."""
    mesh = np.asarray(mesh, float)
    box = x0, y0, x1, y1 = window(camera, mesh[region.vertices])
    out = picture.copy()
    if x1 <= x0 or y1 <= y0:
        return out
    colours, share = _rendered(region, cropped(camera, box, supersampling), mesh, atlas)
    colour, opacity = _per_pixel(colours, share, supersampling)
    painted = opacity > 0
    here = out[y0:y1, x0:x1]
    mixed = here[painted] + opacity[painted][:, None] * (colour[painted] - here[painted])
    here[painted] = np.rint(np.clip(mixed, 0, 255)).astype(np.uint8)
    return out


def _rendered(region: LipRegion, part: Camera, mesh: NDArray, atlas: NDArray) -> tuple[NDArray, NDArray]:
    """Colours (h, w, 3) of the region as a camera sees it and how much of each sample it replaces (h, w)."""
    raster = rasterise(part, mesh, region.triangles)
    place = np.full(len(region.triangles), -1)
    place[region.chosen] = np.arange(len(region.chosen))
    number = np.where(raster.hit, place[raster.triangle], -1)
    here = number >= 0
    inside = raster.barycentric[here].astype(float)
    share = np.zeros(number.shape, np.float32)
    share[here] = np.einsum("pc,pc->p", inside, region.weight[region.triangles[raster.triangle[here]]])
    where = np.full((*number.shape, 2), -1.0, np.float32)
    where[here] = np.einsum("pc,pck->pk", inside, region.atlas[region.atlas_triangles[number[here]]])
    colours = cv2.remap(atlas.astype(np.float32), where[..., 0], where[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return colours, share


def _per_pixel(colours: NDArray, share: NDArray, samples: int) -> tuple[NDArray, NDArray]:
    """Colour (h, w, 3) and opacity (h, w) of pixels of `samples` by `samples`.

    The colour is that of the pixel's centre where the region covers it, as a lens would have given it, else the mean of what
    is covered.
    """
    middle = samples // 2
    size = share.shape[1] // samples, share.shape[0] // samples
    opacity = cv2.resize(share, size, interpolation=cv2.INTER_AREA)
    mean = cv2.resize(colours * share[..., None], size, interpolation=cv2.INTER_AREA) / np.maximum(opacity, 1e-6)[..., None]
    centre = share[middle::samples, middle::samples] > 0
    return np.where(centre[..., None], colours[middle::samples, middle::samples], mean), opacity


def _gutter(region: LipRegion) -> tuple[tuple[NDArray, NDArray], tuple[NDArray, NDArray]]:
    """Rows and columns of texels just off the charts, and of the texel on a chart that is nearest to each."""
    bare = region.spread(np.ones((len(region.texel), 1)))[..., 0] == 0
    away, (row, column) = distance_transform_edt(bare, return_indices=True)
    gutter = np.nonzero(bare & (away <= _GUTTER_TEXELS))
    return gutter, (row[gutter], column[gutter])


class _Smoother:
    """Smooths what texels tell into what changes slowly over the surface: min sum w |d - x|^2 + s^4 |Laplacian x|^2.

    Where all is seen, a wave of k per mm keeps 1 / (1 + (k s)^4) of its height. Where nothing is seen, x goes on smoothly.
    """

    def __init__(self, region: LipRegion, mesh: NDArray, texel_mm: float, smoothing_mm: float) -> None:
        vertices = region.vertices
        number = np.full(len(mesh), -1)
        number[vertices] = np.arange(len(vertices))
        triangles, points_mm = number[region.triangles[region.chosen]], 1e3 * mesh[vertices]
        rows = np.repeat(np.arange(len(region.texel)), 3)
        where = (rows, number[region.corners].ravel())
        self._between = sparse.csr_array((region.texel_barycentric.ravel(), where), shape=(len(region.texel), len(vertices)))
        # texels so far apart tell what changes over several
        self._asked = (region.texel % max(round(_ASKED_MM / texel_mm), 1) == 0).all(axis=1)
        self._asking = self._between[self._asked]
        areas = vertex_areas(points_mm, triangles)
        bend = bilaplacian(cotangent_laplacian(points_mm, triangles, least_weight=0.0), areas)
        self._stiffness = smoothing_mm**4 * bend + _UNSEEN_HOLD * sparse.diags_array(areas)
        self._asked_mm2 = areas.sum() / max(self._asked.sum(), 1)

    def __call__(self, values: NDArray, weight: NDArray) -> NDArray[np.float64]:
        """Smoothed values (t, k) of values (t, k) that count as `weight` (t,)."""
        # weights are relative, so that what is seen is smoothed alike from whichever side
        share = self._asked_mm2 * weight[self._asked] / max(weight.max(), 1e-12)
        weighted = self._asking.multiply(share[:, None]).tocsr()
        normal = sparse.csr_array(self._asking.T @ weighted + self._stiffness)
        return self._between @ Factor(normal).solve(weighted.T @ values[self._asked])
