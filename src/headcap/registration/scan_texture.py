"""The template's texture from a coloured scan."""

import numpy as np
from numpy.typing import NDArray

from headcap.meshes.closest_point import Surface
from headcap.meshes.normals import vertex_normals
from headcap.meshes.rasteriser import rasterise_pixels
from headcap.registration.scan import Scan
from headcap.registration.template import Template

FARTHEST_MM = 3.0


def texel_points(template: Template, size_px: int) -> tuple[NDArray[np.bool_], NDArray[np.int32], NDArray[np.float64]]:
    """Which texels of a square texture the surface covers: mask (h, w), their triangles (k,) and barycentrics (k, 3)."""
    pixels = template.uv * size_px - 0.5
    raster = rasterise_pixels(pixels, np.ones(len(pixels)), template.uv_triangles, (size_px, size_px))
    hit = raster.hit
    return hit, raster.triangle[hit], raster.barycentric[hit].astype(float)


def bake_texture_from_scan(
    template: Template, scan: Scan, size_px: int = 2048, base_from_scan: NDArray | None = None
) -> Template:
    """The template with each texel coloured by the nearest point of the scan's surface.

    `base_from_scan` (4, 4) takes the scan into the template's frame (identity by default). Texels farther than 3 mm from the
    scan, or whose nearest point faces away, are filled from their neighbours and not marked known. A scan without colours
    gives the template back unchanged.
    """
    if scan.colours is None:
        return template
    pose = np.eye(4) if base_from_scan is None else base_from_scan
    places = scan.vertices @ pose[:3, :3].T + pose[:3, 3]
    hit, triangle, weights = texel_points(template, size_px)
    corners = template.triangles[triangle]
    points = np.einsum("tc,tck->tk", weights, template.vertices[corners])
    normals = np.einsum("tc,tck->tk", weights, vertex_normals(template.vertices, template.triangles)[corners])
    found = Surface(places, scan.triangles).closest(points)
    colours = found.interpolate(scan.triangles, scan.colours.astype(float))
    facing = np.einsum("tk,tk->t", normals, found.interpolate(scan.triangles, vertex_normals(places, scan.triangles))) > 0.2
    sure = facing & (found.distance < 1e-3 * FARTHEST_MM)
    texture = np.zeros((size_px, size_px, 3), np.uint8)
    known = np.zeros((size_px, size_px), bool)
    texture[hit] = np.clip(np.round(colours), 0, 255)
    known[hit] = sure
    return template.with_texture(spread(texture, known), known)


def spread(texture: NDArray[np.uint8], known: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Unknown texels filled with the nearest known one, so that sampling at seams bleeds no background."""
    from scipy.ndimage import distance_transform_edt

    if not known.any() or known.all():
        return texture
    rows, columns = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return texture[rows, columns]
