"""The report's pictures of frames and meshes, composed of overlays."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.evaluation.tracking import TrackingErrors
from headcap.meshes.rasteriser import rasterise
from headcap.registration.template import Template
from headcap.report.inputs import BoardPicture, FrameView, RegisterReport
from headcap.report.overlays import (
    box_of,
    crop,
    draw_mesh,
    draw_points,
    draw_values,
    draw_wire,
    heat_colours,
    shade,
    side_by_side,
    viewport,
    virtual_camera,
)

Image = NDArray[np.uint8]
_PANEL_ASPECT = 0.8
_SHOWN_PX = 12.0
SURFACE_TOP_MM, DRIFT_TOP_MM, SCAN_TOP_MM = 0.5, 1.0, 0.5


@dataclass(frozen=True)
class Picture:
    """An image with what it shows."""

    image: Image
    caption: str


def frame_panels(view: FrameView, triangles: NDArray, *, height: int = 460) -> list[Picture]:
    """Photograph, points, mesh and error of one view, cut to the head, each `height` pixels high."""
    box = box_of(view.camera, view.vertices, aspect=_PANEL_ASPECT)
    camera = viewport(view.camera, box, height)
    photograph = crop(view.photograph, box, camera.size)
    panels = [Picture(photograph, "photograph")]
    if view.cloud is not None and len(view.cloud):
        points = draw_points(photograph, camera, view.cloud.positions, view.cloud.colours)
        panels.append(Picture(points, f"{len(view.cloud):,} points"))
    panels.append(Picture(draw_mesh(photograph, camera, view.vertices, triangles), "tracked mesh"))
    if view.error_mm is not None:
        errors = draw_values(camera, view.vertices, triangles, view.error_mm, top=SURFACE_TOP_MM, background=photograph)
        panels.append(Picture(errors, f"distance to the true surface, 0 to {SURFACE_TOP_MM:g} mm"))
    return panels


def mouth_close_up(view: FrameView, template: Template, *, height: int = 420) -> Picture | None:
    """The mesh's edges over the photograph's lips; None where the template names no lips or the view has none."""
    lips = np.zeros(len(template.vertices), bool)
    for name in ("lips_upper", "lips_lower"):
        lips |= template.regions.get(name, False)
    if not lips.any():
        return None
    box = box_of(view.camera, view.vertices[lips], margin=0.35, aspect=1.6)
    camera = viewport(view.camera, box, height)
    photograph = crop(view.photograph, box, camera.size)
    wire = draw_wire(photograph, camera, view.vertices, template.triangles)
    return Picture(side_by_side([photograph, wire]), "lips, and the mesh's edges on them")


def error_over_time(errors: TrackingErrors, mesh: NDArray, triangles: NDArray, *, height: int = 340) -> list[Picture]:
    """Mean error per vertex over the frames in which it is seen, on the first mesh from three sides."""
    panels = []
    for values, top, name in (
        (errors.surface_mm, SURFACE_TOP_MM, "distance to the true surface"),
        (errors.drift_mm, DRIFT_TOP_MM, "material drift"),
    ):
        mean = mean_seen(values, errors.seen)
        image = side_by_side([_view_of_values(mesh, triangles, mean, top, azimuth, height) for azimuth in (-55, 0, 55)])
        panels.append(Picture(image, f"{name}, mean over the frames, 0 to {top:g} mm; grey: not seen by enough cameras"))
    return panels


def mean_seen(values: NDArray, seen: NDArray) -> NDArray[np.float64]:
    """Mean (n,) over frames of values (t, n) where seen (t, n) and known; NaN where never."""
    used = seen & np.isfinite(values)
    count = used.sum(axis=0)
    total = np.where(used, values, 0.0).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _view_of_values(mesh: NDArray, triangles: NDArray, values: NDArray, top: float, azimuth: float, height: int) -> Image:
    mesh = np.asarray(mesh, float)
    return draw_values(virtual_camera(mesh, azimuth, height=height), mesh, triangles, values, top=top)


def register_pictures(register: RegisterReport, *, height: int = 360) -> list[Picture]:
    """Scan, template, texture and distance, from in front and from the side."""
    template, panels = register.template, []
    vertices = np.asarray(template.vertices, float)
    if register.scan_vertices is not None:
        scan = register.scan_vertices, register.scan_triangles
        panels.append(Picture(_plain_views(*scan, height, vertices), "scan"))
    panels.append(Picture(_plain_views(vertices, template.triangles, height, vertices), "template in the model's topology"))
    if template.texture is not None:
        panels.append(Picture(_textured(template, height), "with its texture"))
    if register.error_mm is not None:
        image = side_by_side(
            [
                _view_of_values(vertices, template.triangles, register.error_mm, SCAN_TOP_MM, azimuth, height)
                for azimuth in (0, 55)
            ]
        )
        panels.append(Picture(image, f"distance to the scan, 0 to {SCAN_TOP_MM:g} mm; grey: the scan has no surface there"))
    return panels


def _plain_views(vertices: NDArray, triangles: NDArray, height: int, framing: NDArray) -> Image:
    views = []
    for azimuth in (0, 55):
        camera = virtual_camera(framing, azimuth, height=height)
        blank = np.full((camera.height, camera.width, 3), 255, np.uint8)
        views.append(draw_mesh(blank, camera, np.asarray(vertices, float), triangles, opacity=0.9))
    return side_by_side(views)


def _textured(template: Template, height: int) -> Image:
    vertices = np.asarray(template.vertices, float)
    views = [_textured_view(template, virtual_camera(vertices, azimuth, height=height)) for azimuth in (0, 55)]
    return side_by_side(views)


def _textured_view(template: Template, camera: Camera) -> Image:
    vertices = np.asarray(template.vertices, float)
    raster = rasterise(camera, vertices, template.triangles)
    rows, columns = template.texture.shape[:2]
    uv = np.nan_to_num(raster.interpolate(template.uv_triangles, template.uv)) * (columns, rows) - 0.5
    colours = cv2.remap(template.texture, uv[..., 0].astype(np.float32), uv[..., 1].astype(np.float32), cv2.INTER_LINEAR)
    out = np.full((camera.height, camera.width, 3), 255, np.uint8)
    brightness = 0.75 + 0.25 * np.nan_to_num(shade(camera, vertices, template.triangles, raster))
    out[raster.hit] = np.clip(colours * brightness[..., None], 0, 255)[raster.hit]
    return out


def board_overlay(picture: BoardPicture, *, height: int = 420) -> Picture:
    """The board cut out: corners found (rings), and what the rig makes of them (lines, enlarged so that they show)."""
    box = _box_around(picture.detected_px, picture.photograph.shape, _PANEL_ASPECT)
    scale = height / (box[3] - box[1])
    image = crop(picture.photograph, box, (round((box[2] - box[0]) * scale), height))
    difference = picture.detected_px - picture.predicted_px
    rms = float(np.sqrt(np.mean(np.sum(difference**2, axis=1))))
    enlarged = _enlargement(rms * scale)
    # edges of the box are half a pixel before the centre of its first pixel
    place = lambda pixels: [tuple(map(int, row)) for row in np.rint(((pixels - box[:2]) * scale - 0.5) * 16)]  # noqa: E731
    ends = place(picture.predicted_px + enlarged * difference)
    for found, predicted, end in zip(place(picture.detected_px), place(picture.predicted_px), ends, strict=True):
        cv2.circle(image, found, 5 * 16, (0, 168, 150), 1, cv2.LINE_AA, shift=4)
        cv2.line(image, predicted, end, (255, 140, 0), 2, cv2.LINE_AA, shift=4)
    told = f"{picture.camera}, frame {picture.frame}: {rms:.3f} px rms, {len(difference)} corners; lines {enlarged} times as long"
    return Picture(image, told)


def _enlargement(shown_px: float) -> int:
    """Of 1, 2, 5, 10, ..., 500 the factor that brings a length nearest to what is easily seen, without passing it."""
    steps = [step * power for power in (1, 10, 100) for step in (1, 2, 5)]
    return max((step for step in steps if step * shown_px <= _SHOWN_PX), default=1)


def _box_around(pixels: NDArray, shape: tuple[int, ...], aspect: float, margin: float = 0.2) -> tuple[float, ...]:
    """Edges (left, top, right, bottom) of a box of an aspect about pixels (n, 2), pushed into the image where it fits."""
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    grown = (1 + 2 * margin) * np.maximum(high - low, 1.0)
    size = np.array([max(grown[0], aspect * grown[1]), max(grown[1], grown[0] / aspect)])
    room = np.array([shape[1], shape[0]], float)
    size *= min(1.0, float((room / size).min()))
    first = np.clip((low + high - size) / 2, -0.5, room - 0.5 - size)
    return (*first.tolist(), *(first + size).tolist())


def contact_sheet(views: list[FrameView], triangles: NDArray, *, height: int = 560) -> Image:
    """Photograph, points, mesh and error side by side, one row per view."""
    rows = [side_by_side([panel.image for panel in frame_panels(view, triangles, height=height)]) for view in views]
    width = max(row.shape[1] for row in rows)
    sheet = np.full((sum(row.shape[0] + 6 for row in rows) - 6, width, 3), 255, np.uint8)
    top = 0
    for row in rows:
        sheet[top : top + row.shape[0], : row.shape[1]] = row
        top += row.shape[0] + 6
    return sheet


def error_legend_colours(count: int = 5) -> list[str]:
    """Colours of the error scale from 0 to its top, for a legend."""
    return ["#{:02x}{:02x}{:02x}".format(*map(int, colour)) for colour in heat_colours(np.linspace(0, 1, count), 1.0)]
