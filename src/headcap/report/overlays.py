"""Points, meshes and errors drawn over photographs. Images are (height, width, 3) uint8 RGB."""

from __future__ import annotations

import base64
import io
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray
from PIL import Image as PillowImage

from headcap.cameras import Camera
from headcap.geometry.transforms import rigid
from headcap.meshes.normals import vertex_normals
from headcap.meshes.rasteriser import Raster, rasterise
from headcap.meshes.topology import mesh_edges
from headcap.recordings.writer import write_picture

Image = NDArray[np.uint8]
ACCENT = (0, 168, 150)
PAPER = (255, 255, 255)
_UNKNOWN = (178, 178, 178)


def viewport(camera: Camera, box: tuple[float, float, float, float], height: int) -> Camera:
    """The camera that photographs a box (left, top, right, bottom: edges, in pixels) of another one at `height` pixels."""
    left, top, right, bottom = box
    factor = height / (bottom - top)
    matrix = camera.matrix.copy()
    matrix[:2] *= factor
    # integer coordinates are pixel centres: an image's edge lies half a pixel before its first pixel's centre
    matrix[:2, 2] = (camera.matrix[:2, 2] - (left, top)) * factor - 0.5
    return replace(camera, matrix=matrix, width=max(1, round((right - left) * factor)), height=height)


def crop(photograph: Image, box: tuple[float, float, float, float], size: tuple[int, int]) -> Image:
    """What `viewport` sees of the photograph, size (width, height); beyond its border the border's colour goes on."""
    left, top, right, bottom = box
    width, height = size
    factor = np.array([width / (right - left), height / (bottom - top)])
    shift = -np.array([left, top]) * factor - 0.5
    matrix = np.array([[factor[0], 0, shift[0]], [0, factor[1], shift[1]]])
    # area averaging where the picture shrinks: linear sampling alone would alias
    if factor.min() < 0.7:
        photograph = cv2.GaussianBlur(photograph, (0, 0), 0.35 / factor.min())
    sampling = cv2.INTER_CUBIC if factor.min() > 1 else cv2.INTER_LINEAR
    return cv2.warpAffine(photograph, matrix, (width, height), flags=sampling, borderMode=cv2.BORDER_REPLICATE)


def box_of(camera: Camera, points: NDArray, *, margin: float = 0.06, aspect: float | None = None) -> tuple:
    """Pixel box (left, top, right, bottom) around projected points (n, 3).

    Widened to an aspect of width over height as far as the image reaches.
    """
    pixels = camera.project(np.asarray(points, float))[0]
    pixels = pixels[np.isfinite(pixels).all(axis=1)]
    (left, top), (right, bottom) = pixels.min(axis=0), pixels.max(axis=0)
    left, right = max(left, -0.5), min(right, camera.width - 0.5)
    top, bottom = max(top, -0.5), min(bottom, camera.height - 0.5)
    grow = margin * max(right - left, bottom - top)
    left, top, right, bottom = left - grow, top - grow, right + grow, bottom + grow
    if aspect is not None:
        width, height = max(right - left, aspect * (bottom - top)), max(bottom - top, (right - left) / aspect)
        middle = (left + right) / 2, (top + bottom) / 2
        left, right = middle[0] - width / 2, middle[0] + width / 2
        top, bottom = middle[1] - height / 2, middle[1] + height / 2
    return max(left, -0.5), max(top, -0.5), min(right, camera.width - 0.5), min(bottom, camera.height - 0.5)


def draw_points(image: Image, camera: Camera, points: NDArray, colours: NDArray[np.uint8], *, radius: float = 0.8) -> Image:
    """Points (n, 3) in their colours (n, 3) over the dimmed image, the nearest in front."""
    out = (0.35 * image).astype(np.uint8)
    pixels, depth = camera.project(np.asarray(points, float))
    rounded = np.rint(np.nan_to_num(pixels, nan=-99)).astype(int)
    inside = (rounded >= 0).all(axis=1) & (rounded[:, 0] < camera.width) & (rounded[:, 1] < camera.height)
    order = np.flatnonzero(inside)[np.argsort(-depth[inside])]
    if radius < 1:
        out[rounded[order, 1], rounded[order, 0]] = colours[order]
        return out
    for i in order:
        cv2.circle(out, tuple(map(int, rounded[i])), int(radius), tuple(map(int, colours[i])), -1, cv2.LINE_AA)
    return out


def shade(camera: Camera, vertices: NDArray, triangles: NDArray, raster: Raster) -> NDArray[np.float64]:
    """Brightness (height, width) of a matt surface lit from a little above the camera; NaN outside."""
    values = raster.interpolate(triangles, facing_light(camera, vertices, triangles)[:, None])[..., 0]
    return np.clip(0.25 + 0.75 * values, 0.08, 1.0)


def facing_light(camera: Camera, vertices: NDArray, triangles: NDArray) -> NDArray[np.float64]:
    """Cosine (n,) between each vertex's normal and the light, a little above the camera."""
    light = camera.camera_from_world[:3, :3].T @ np.array([0.25, -0.45, -0.86])
    return vertex_normals(vertices, triangles) @ light


def draw_mesh(image: Image, camera: Camera, vertices: NDArray, triangles: NDArray, *, opacity: float = 0.72) -> Image:
    """The shaded mesh over the image, with its outlines."""
    raster = rasterise(camera, vertices, triangles)
    hit = raster.hit
    surface = shade(camera, vertices, triangles, raster)[..., None] * np.array([218.0, 224.0, 226.0])
    out = image.astype(float)
    out[hit] = (1 - opacity) * out[hit] + opacity * surface[hit]
    return draw_outline(np.clip(out, 0, 255).astype(np.uint8), raster)


def draw_outline(image: Image, raster: Raster, *, step_m: float = 0.006) -> Image:
    """Silhouettes and depth steps of a rasterised mesh as thin lines."""
    depth = np.where(raster.hit, raster.depth, 10.0).astype(np.float32)
    across = cv2.dilate(depth, np.ones((3, 3), np.uint8)) - depth
    out = image.copy()
    out[raster.hit & (across > step_m)] = ACCENT
    return out


def draw_wire(image: Image, camera: Camera, vertices: NDArray, triangles: NDArray) -> Image:
    """The visible edges of the mesh over the image."""
    raster = rasterise(camera, vertices, triangles)
    shown = np.unique(raster.triangle[raster.hit])
    edges = mesh_edges(triangles[shown]).vertices
    pixels = camera.project(np.asarray(vertices, float))[0]
    lines = np.rint(pixels[edges] * 16).astype(np.int32)
    layer = image.copy()
    cv2.polylines(layer, list(lines), False, ACCENT, 1, cv2.LINE_AA, shift=4)
    return cv2.addWeighted(layer, 0.35, image, 0.65, 0)


def draw_values(
    camera: Camera, vertices: NDArray, triangles: NDArray, values: NDArray, *, top: float, background: Image | None = None
) -> Image:
    """The mesh coloured by values (n,) from 0 to `top`; grey where the value is NaN."""
    raster = rasterise(camera, vertices, triangles)
    known = np.isfinite(values)
    colours = np.where(known[:, None], heat_colours(values, top), np.array(_UNKNOWN, float))
    shaded = 0.45 + 0.55 * shade(camera, vertices, triangles, raster)[..., None]
    out = np.full((camera.height, camera.width, 3), PAPER, float) if background is None else background.astype(float)
    out[raster.hit] = (raster.interpolate(triangles, colours) * shaded)[raster.hit]
    return np.clip(out, 0, 255).astype(np.uint8)


def heat_colours(values: NDArray, top: float) -> NDArray[np.float64]:
    """RGB (n, 3), 0 to 255, of values from 0 to `top`."""
    return 255 * colormaps["viridis"](np.clip(np.nan_to_num(values) / top, 0, 1))[:, :3]


def virtual_camera(points: NDArray, azimuth_deg: float, *, height: int, distance_m: float = 1.2) -> Camera:
    """A camera at the height of the middle of points (n, 3), turned about the world's y axis; 0 looks at the face."""
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    angle = np.radians(azimuth_deg)
    backwards = np.array([np.sin(angle), 0.0, np.cos(angle)])
    rotation = np.stack([np.array([backwards[2], 0.0, -backwards[0]]), [0.0, -1.0, 0.0], -backwards])
    centre = middle + distance_m * backwards
    focal = 2.5 * height
    matrix = np.array([[focal, 0, height / 2 - 0.5], [0, focal, height / 2 - 0.5], [0, 0, 1]])
    camera = Camera("virtual", height, height, matrix, np.zeros(5), rigid(rotation, -rotation @ centre))
    return viewport(camera, box_of(camera, points, margin=0.02), height)


def side_by_side(images: list[Image], *, gap: int = 6) -> Image:
    """Pictures of one height in a row on white."""
    height = max(image.shape[0] for image in images)
    columns = []
    for image in images:
        padded = np.full((height, image.shape[1] + gap, 3), PAPER, np.uint8)
        padded[: image.shape[0], : image.shape[1]] = image
        columns.append(padded)
    return np.concatenate(columns, axis=1)[:, :-gap]


def jpeg_uri(image: Image, quality: int = 84) -> str:
    """The picture as a data URI, JPEG."""
    data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()


def png_uri(image: Image, colours: int = 128) -> str:
    """The picture as a data URI, PNG with a palette: for drawings."""
    stream = io.BytesIO()
    PillowImage.fromarray(image).quantize(colours, dither=PillowImage.Dither.NONE).save(stream, "png", optimize=True)
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()


def save_png(path: Path | str, image: Image) -> None:
    """Write an RGB image as PNG, whole or not at all."""
    write_picture(path, image[..., ::-1])


def load_image(path: Path | str) -> Image:
    """Read a picture file."""
    with PillowImage.open(path) as opened:
        return np.asarray(opened.convert("RGB"))
