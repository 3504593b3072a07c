"""Meshes of corrected lips: error maps (the lip paper's figure 15), methods side by side (figures 14 and 16), and a video.

Images are (height, width, 3) uint8 RGB.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import cv2
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.evaluation.lip_errors import LipErrors
from headcap.lips.clips import Clip
from headcap.recordings.writer import write_video
from headcap.report.figures import Image, sheet
from headcap.report.lips_figures import TOLD
from headcap.report.overlays import PAPER, box_of, crop, draw_mesh, draw_values, side_by_side, viewport, virtual_camera
from headcap.report.study_pictures import plain

ERROR_TOP_MM = 8.0
"""Upper end of the colours of errors: twice the paper's mean."""
_AZIMUTHS = (0.0, 60.0)
_LABEL_PX = 22
_SPREAD_FRAMES = 8
"""As many frames tell what part of the picture the mouth ever fills."""
_STILL_HZ = 25.0
"""Of a clip of one frame."""
_CRF = 22.0
"""H.264 quality at which a page's video is small and its meshes show no blocks."""


def error_maps(
    errors: LipErrors, neutral: NDArray, triangles: NDArray, methods: Iterable[str], top: float = ERROR_TOP_MM
) -> Image:
    """Figure 15: mean error of each vertex of the mouth by method, from in front and from the side, with its colour bar.

    Drawn on a neutral head (n, 3), metres; grey: outside the mask.
    """
    methods, neutral = list(methods), np.asarray(neutral, float)
    cameras = [virtual_camera(neutral[errors.vertices], azimuth, height=300) for azimuth in _AZIMUTHS]
    with sheet(1.0 + 2.0 * len(methods), 2.0 * len(cameras) + 0.6) as (figure, out):
        panels = figure.subplots(len(cameras), len(methods), squeeze=False)
        for column, method in zip(panels.T, methods, strict=True):
            values = np.full(len(neutral), np.nan)
            values[errors.vertices] = errors.vertex_error_mm[errors.row(method)]
            for axes, camera in zip(column, cameras, strict=True):
                _show(axes, draw_values(camera, neutral, triangles, values, top=top))
            mean = np.nanmean(values) if np.isfinite(values).any() else np.nan
            column[0].set_title(f"{TOLD.get(method, method)}: {mean:.2f} mm")
        figure.colorbar(ScalarMappable(Normalize(0, top), "viridis"), ax=panels, label="mm", shrink=0.7)
    return out[0]


def comparison(
    frames: list[tuple[str, Mapping[str, NDArray]]], triangles: NDArray, shown: NDArray, *, azimuth_deg: float = 35.0
) -> Image:
    """Figures 14 and 16: rows of meshes (n, 3) of one moment by what they are, base, corrected, truth, all seen alike.

    `frames` are pairs of what is said of a moment and its canonical meshes; `shown` are the vertices that fill the picture. What
    is not finite, a frame without an answer, stays empty.
    """
    names = list(frames[0][1])
    whole = [np.asarray(mesh, float) for _, meshes in frames for mesh in meshes.values() if np.isfinite(mesh).all()]
    camera = virtual_camera(np.concatenate([mesh[shown] for mesh in whole]), azimuth_deg, height=280)
    with sheet(0.4 + 1.9 * len(names), 0.3 + 1.75 * len(frames)) as (figure, out):
        panels = figure.subplots(len(frames), len(names), squeeze=False)
        for place, (row, (told, meshes)) in enumerate(zip(panels, frames, strict=True)):
            for axes, name in zip(row, names, strict=True):
                seen = np.isfinite(meshes[name]).all()
                blank = np.full((camera.height, camera.width, 3), 255, np.uint8)
                _show(axes, plain(camera, meshes[name], triangles) if seen else blank)
                if place == 0:
                    axes.set_title(TOLD.get(name, name))
            row[0].set_ylabel(told)
    return out[0]


def telling_frames(errors: LipErrors, count: int) -> NDArray[np.int64]:
    """Frames (<= count,), rising, whose true lips differ most in opening and roll, each scaled by its spread over the take.

    Farthest-point sampling among frames that all methods answered; the first is the farthest from the mean.
    """
    known = np.flatnonzero(errors.common)
    values = np.column_stack([errors.gap_mm[-1], errors.roll_deg[-1]])[known]
    spread = values.std(axis=0)
    values = (values - values.mean(axis=0)) / np.where(spread > 1e-12, spread, 1.0)
    nearest, chosen = (values**2).sum(axis=1), []
    while len(chosen) < min(count, len(values)):
        chosen.append(int(nearest.argmax()))
        away = ((values - values[chosen[-1]]) ** 2).sum(axis=1)
        nearest = away if len(chosen) == 1 else np.minimum(nearest, away)
    return known[np.sort(np.array(chosen, np.int64))]


def side_by_side_frames(
    photographs: Iterable[Image],
    camera: Camera,
    triangles: NDArray,
    sequences: Mapping[str, Iterable[NDArray]],
    about: NDArray,
    *,
    height: int = 360,
) -> Iterator[Image]:
    """Pictures of a video: the photograph with the first sequence's mesh over it, then each other one's, seen by the camera.

    `sequences` are meshes (n, 3) in the camera's world by what they are, the base first; the picture is cut to the points `about`
    (p, 3) there. A panel whose mesh is not finite says that there is no answer.
    """
    box = box_of(camera, about, margin=0.3, aspect=1.0)
    view = viewport(camera, box, height)
    first, *others = sequences
    for photograph, base, *meshes in zip(photographs, *sequences.values(), strict=True):
        picture = crop(photograph, box, view.size)
        drawn = draw_mesh(picture, view, np.asarray(base, float), triangles) if np.isfinite(base).all() else None
        panels = [
            captioned(drawn if drawn is not None else picture, f"picture, {TOLD.get(first, first)}", known=drawn is not None)
        ]
        for name, mesh in zip(others, meshes, strict=True):
            known = bool(np.isfinite(mesh).all())
            image = plain(view, mesh, triangles) if known else np.full_like(picture, PAPER[0])
            panels.append(captioned(image, TOLD.get(name, name), known=known))
        yield side_by_side(panels)


def write_clip_side_by_side(
    path: Path | str, clip: Clip, triangles: NDArray, sequences: Mapping[str, NDArray], mouth: NDArray[np.int64]
) -> None:
    """Write a clip with meshes (f, n, 3) in its camera's world beside each other, cut to the vertices `mouth` (k,).

    `sequences` as in `side_by_side_frames`. Raises `InputError` where no frame of the first has an answer.
    """
    about = mouth_places(next(iter(sequences.values())), mouth)
    photographs = (np.ascontiguousarray(picture[..., ::-1]) for picture in clip.pictures())
    rate_hz = float(1 / np.median(np.diff(clip.time_s))) if len(clip) > 1 else _STILL_HZ
    write_side_by_side(path, side_by_side_frames(photographs, clip.camera, triangles, sequences, about), rate_hz)


def mouth_places(meshes: NDArray, mouth: NDArray[np.int64]) -> NDArray:
    """Points (p, 3) about which a clip's pictures are cut: vertices `mouth` of frames spread over meshes (f, n, 3).

    Raises `InputError` where no frame has an answer.
    """
    answered = np.flatnonzero(np.isfinite(meshes).all(axis=(1, 2)))
    if not len(answered):
        raise InputError("a clip without an answer", expected="one tracked frame at least", remedy="Look at the track.")
    return meshes[answered[:: max(1, len(answered) // _SPREAD_FRAMES)]][:, mouth].reshape(-1, 3)


def write_side_by_side(path: Path | str, frames: Iterable[Image], rate_hz: float) -> None:
    """Write what `side_by_side_frames` gives as mp4; raises `InputError` without any frame."""
    source = iter(frames)
    first = next(source, None)
    if first is None:
        raise InputError("a video without pictures", expected="one at least", remedy="Give frames to show.")
    height, width = even_sided(first).shape[:2]
    numbered = enumerate(even_sided(image) for image in itertools.chain([first], source))
    write_video(path, numbered, (width, height), rate_hz, crf=_CRF)


def even_sided(image: Image) -> Image:
    """With a white row or column more where a side is odd: the codec halves colours."""
    height, width = image.shape[:2]
    return np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), constant_values=PAPER[0])


def captioned(image: Image, told: str, *, known: bool) -> Image:
    """An image under a line that says what it is, and where it is not `known` that there is no answer."""
    line = np.full((_LABEL_PX, image.shape[1], 3), PAPER, np.uint8)
    text = told if known else f"{told}: no answer"
    cv2.putText(line, text, (4, _LABEL_PX - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (29, 42, 48), 1, cv2.LINE_AA)
    return np.concatenate([line, image])


def _show(axes, image: Image) -> None:
    axes.imshow(image, interpolation="antialiased")
    axes.set(xticks=[], yticks=[])
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(False)
