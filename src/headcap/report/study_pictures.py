"""Key frames of animated necks: what a person did, what the model makes of it, and what they differ by (figures 11 to 14)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.geometry.transforms import invert, transform
from headcap.heads import HeadModel
from headcap.meshes.rasteriser import rasterise
from headcap.neck.animation.animation import meshes_of_curves
from headcap.neck.animation.curves import CoefficientCurves
from headcap.neck.animation.editing import scaled
from headcap.neck.model import NeckModel, NeckPerson
from headcap.report.overlays import draw_values, shade, virtual_camera
from headcap.report.study_inputs import Animation, frames_of

Image = NDArray[np.uint8]
DIFFERENCE_TOP_MM = 1.0
"""Upper end of the colours of differences."""
EXAGGERATED_TAU, EXAGGERATED_ALPHA = 1.2, 1.8
"""What figure 14's edit multiplies the larynx's range and its prominence by."""
_AZIMUTH_DEG = 38.0
_CLAY = (226.0, 222.0, 216.0)


@dataclass(frozen=True)
class KeyFrame:
    """One column of a figure: pictures from top to bottom and what is said below."""

    image: Image
    told: tuple[str, ...]


def key_frames(curves: CoefficientCurves, count: int) -> NDArray[np.int64]:
    """Frames (<= count,), rising, that differ most in tau, alpha and the first weights, each scaled by its spread over the take.

    The first is the one nearest to the mean; each other is farthest from those before it.
    """
    parts = [curves.channels[name] for name in ("tau", "alpha") if name in curves.channels]
    parts += [curves.channels[name][:, :3].T for name in ("phi", "psi") if name in curves.channels]
    values = np.vstack(parts).T
    spread = values.std(axis=0)
    values = (values - values.mean(axis=0)) / np.where(spread > 1e-12, spread, 1.0)
    chosen = [int((values**2).sum(axis=1).argmin())]
    nearest = ((values - values[chosen[0]]) ** 2).sum(axis=1)
    while len(chosen) < min(count, len(values)) and nearest.max() > 1e-9:
        chosen.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, ((values - values[chosen[-1]]) ** 2).sum(axis=1))
    return np.sort(np.array(chosen))


def animation_columns(model: NeckModel, animation: Animation, *, count: int = 5, height: int = 230) -> list[KeyFrame]:
    """Figures 11 to 13: per key frame the truth, the animation and their difference over the neck; without truth the animation.

    Heads are shown with their trunk at rest: what placed them in the room is taken off.
    """
    frames = key_frames(animation.fitted or animation.curves, count)
    shown = animation.meshes(model, frames)
    truth = None if animation.truth is None else np.asarray(animation.truth[frames], float)
    camera = throat_camera(model.head, animation.person.base, height)
    columns = []
    for k, frame in enumerate(frames):
        home = np.eye(4) if animation.curves.placement is None else invert(animation.curves.placement[frame])
        made = transform(home, np.asarray(shown[k], float))
        if truth is None or not np.isfinite(truth[k]).all():
            image = plain(camera, made, model.head.triangles)
        else:
            image = _against(camera, model.head, transform(home, truth[k]), made)
        columns.append(KeyFrame(image, _told(animation, int(frame))))
    return columns


def _against(camera: Camera, head: HeadModel, truth: NDArray, made: NDArray) -> Image:
    """Truth, animation and their distance where the neck is."""
    away = np.where(head.regions["neck"], 1e3 * np.linalg.norm(made - truth, axis=1), np.nan)
    rows = [plain(camera, truth, head.triangles), plain(camera, made, head.triangles)]
    rows.append(draw_values(camera, made, head.triangles, away, top=DIFFERENCE_TOP_MM))
    return stacked(rows)


def _told(animation: Animation, frame: int) -> tuple[str, ...]:
    """Moment, tau and alpha of a frame, of the animation and of the fit."""
    lines = [f"{animation.curves.time_s[frame]:.2f} s", f"tau {_at(animation.curves, frame)}"]
    if animation.fitted is not None:
        lines.append(f"fitted: {_at(animation.fitted, frame)}")
    return tuple(lines)


def _at(curves: CoefficientCurves, frame: int) -> str:
    tau = curves.channels["tau"][frame] if "tau" in curves.channels else 0.0
    alpha = curves.channels["alpha"][frame] if "alpha" in curves.channels else 1.0
    return f"{1e3 * tau:+.1f} mm, alpha {alpha:.2f}"


def swallow_columns(
    model: NeckModel, person: NeckPerson, curves: CoefficientCurves, *, count: int = 7, height: int = 230
) -> list[KeyFrame]:
    """Figure 14: key frames of a swallow, from two sides, and below them the same with the larynx exaggerated.

    Frames are spread evenly over the way that the larynx goes. The edit multiplies slide and scale by `EXAGGERATED_TAU` and
    `EXAGGERATED_ALPHA`.
    """
    own = replace(curves, placement=None, channels={name: curves.channels[name] for name in ("tau", "alpha")}, model_version="")
    edited = scaled(scaled(own, "tau", EXAGGERATED_TAU), "alpha", EXAGGERATED_ALPHA)
    frames = _along(own.curve("tau"), count)
    known = model.with_person(person)
    modelled, made = (
        np.concatenate(list(meshes_of_curves(known, person.name, frames_of(each, frames)))) for each in (own, edited)
    )
    cameras = [throat_camera(model.head, person.base, height, azimuth) for azimuth in (_AZIMUTH_DEG, 90.0)]
    columns = []
    for k, frame in enumerate(frames):
        rows = [plain(camera, meshes[k], model.head.triangles) for meshes in (modelled, made) for camera in cameras]
        told = (f"{own.time_s[frame]:.2f} s", f"tau {_at(own, frame)}", f"edited: {_at(edited, frame)}")
        columns.append(KeyFrame(stacked(rows), told))
    return columns


def _along(tau: NDArray, count: int) -> NDArray[np.int64]:
    """Frames (<= count,), rising, between which a curve (f,) goes equally far up and down; evenly spread where it is still."""
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(tau)))])
    way = way / way[-1] if way[-1] > 0 else np.linspace(0, 1, len(tau))
    return np.unique(np.abs(way[:, None] - np.linspace(0, 1, count)).argmin(axis=0))


def throat_camera(head: HeadModel, rest: NDArray, height: int, azimuth_deg: float = _AZIMUTH_DEG) -> Camera:
    """A camera before the throat and mouth of a head at rest (n, 3)."""
    shown = head.regions["front_neck"] | head.regions["larynx"] | head.regions["lips_outer"]
    return virtual_camera(np.asarray(rest, float)[shown], azimuth_deg, height=height)


def plain(camera: Camera, mesh: NDArray, triangles: NDArray) -> Image:
    """A shaded mesh on white, without lines: a bump of a few millimetres shows by its shading alone."""
    mesh = np.asarray(mesh, float)
    raster = rasterise(camera, mesh, triangles)
    out = np.full((camera.height, camera.width, 3), 255, np.uint8)
    out[raster.hit] = (shade(camera, mesh, triangles, raster)[..., None] * np.array(_CLAY))[raster.hit]
    return out


def stacked(images: list[Image], *, gap: int = 4) -> Image:
    """Pictures below each other on white."""
    width = max(image.shape[1] for image in images)
    out = np.full((sum(image.shape[0] + gap for image in images) - gap, width, 3), 255, np.uint8)
    top = 0
    for image in images:
        out[top : top + image.shape[0], : image.shape[1]] = image
        top += image.shape[0] + gap
    return out
