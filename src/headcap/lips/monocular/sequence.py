"""A video through the monocular tracker: one row of coefficients per frame, in a file of its own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_arrays, save_arrays
from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.geometry.transforms import invert
from headcap.heads import HeadCoefficients, HeadModel
from headcap.heads.model import RestOffset
from headcap.lips.monocular.detections import SCHEMES
from headcap.lips.monocular.person import MonocularPerson
from headcap.lips.monocular.settings import MonocularSettings
from headcap.lips.monocular.surface import Estimate
from headcap.lips.monocular.tracker import FrameResult, FrameState, MonocularTracker

KIND, SCHEMA = "monocular_track", 2
_BLOCK = 64
_STATES = tuple(FrameState)


@dataclass(frozen=True, eq=False)
class MonocularTrack:
    """f frames of one face; NaN in frames without an answer."""

    model: str
    """Digest of the head model."""
    time_s: NDArray[np.float64]
    """(f,) rising."""
    states: tuple[FrameState, ...]
    shape: NDArray[np.float64]
    """beta (s,) of the person."""
    expression: NDArray[np.float64]
    """psi (f, e)."""
    jaw: NDArray[np.float64]
    """(f, 3) rotation vectors, radians."""
    placement: NDArray[np.float64]
    """world_from_head (f, 4, 4), metres; the world is the camera's."""
    focal_ratio: float
    """Focal length over the given camera's."""
    light: NDArray[np.float64]
    """(f, 3, 9) radiance in the camera's axes, see `harmonics`."""
    residual: NDArray[np.float64]
    """(f,) root mean square residual per channel of what agrees, linear intensity 0 to 1."""
    inliers: NDArray[np.float64]
    """(f,) share of the skin in view that looks as rendered."""
    correlation: NDArray[np.float64]
    """(f,) of rendering and picture."""
    layer: NDArray[np.float32]
    """(n, 3) metres: the person's medium-scale layer on the model's neutral head, zero away from the face."""
    others: int = 0
    """Smaller faces in the picture that began the track, which follows the largest."""

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def answered(self) -> NDArray[np.bool_]:
        """(f,) frames in which the face was followed."""
        return np.array([state is not FrameState.LOST for state in self.states], bool)

    def coefficients(self, frames: slice | NDArray = slice(None)) -> HeadCoefficients:
        """What poses and shapes the head in some frames, the layer aside; NaN where lost."""
        pose = np.stack([np.zeros_like(self.jaw[frames]), self.jaw[frames]], axis=-2)
        return HeadCoefficients(self.shape, self.expression[frames], pose, placement=self.placement[frames])

    @property
    def person(self) -> MonocularPerson:
        """Who the track shows."""
        return MonocularPerson(self.model, self.shape, self.layer)

    def neutral(self, model: HeadModel) -> NDArray[np.float64]:
        """(n, 3) the person at rest, metres, in the head's frame. Raises `InputError` for another head model."""
        return self.person.neutral(model)

    def camera(self, given: Camera) -> Camera:
        """The camera that was given to the tracker, with the focal length that was found."""
        matrix = given.matrix.copy()
        matrix[[0, 1], [0, 1]] *= self.focal_ratio
        return replace(given, matrix=matrix)

    def meshes(self, model: HeadModel) -> Iterator[NDArray[np.float32]]:
        """Vertices (n, 3) of each frame in the world, metres; NaN where lost. Raises `InputError` for another head model."""
        self.check(model)
        offset = RestOffset(np.arange(len(self.layer)), self.layer.astype(model.vertices.dtype))
        for start in range(0, len(self), _BLOCK):
            yield from model.evaluate(self.coefficients(slice(start, start + _BLOCK)), offset)

    def check(self, model: HeadModel) -> None:
        """Raise `InputError` where the track belongs to another head model."""
        if model.digest != self.model:
            raise InputError(
                f"a track of head model {self.model}",
                expected=f"one of {model.name}, {model.digest}",
                remedy="Give the model that was tracked with, or track again.",
            )

    def save(self, path: Path | str) -> None:
        """Write as npz artifact `headcap.monocular_track/2`."""
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        arrays["states"] = np.array([_STATES.index(state) for state in self.states], np.uint8)
        meta = {"model": self.model, "focal_ratio": self.focal_ratio, "others": self.others, "states": list(_STATES)}
        save_arrays(path, KIND, SCHEMA, arrays, meta)

    @classmethod
    def load(cls, path: Path | str) -> MonocularTrack:
        """Read what `save` wrote; raises `ArtifactError`."""
        arrays, meta = load_arrays(path, KIND, SCHEMA)
        states = tuple(FrameState(meta["states"][k]) for k in arrays.pop("states"))
        return cls(**{name: meta[name] for name in ("model", "focal_ratio", "others")}, states=states, **arrays)


_ARRAYS = ("time_s", "shape", "layer", "expression", "jaw", "placement", "light", "residual", "inliers", "correlation")


def track_video(
    model: HeadModel,
    camera: Camera,
    pictures: Iterable[NDArray[np.uint8]],
    time_s: NDArray,
    detections: Mapping[int, NDArray] | None = None,
    settings: MonocularSettings | None = None,
    *,
    focal_known: bool = True,
    person: MonocularPerson | None = None,
) -> MonocularTrack:
    """Follow the face through pictures (height, width, 3) uint8, sRGB-encoded, BGR, taken at `time_s` (f,) by a camera.

    `detections` are points (68, 468 or 478, 2) by frame number. The first frame that has any starts the tracker and should show
    a neutral face; later ones help where they are given. Without any, the first frame in which a frontal face is found starts
    it: the largest, and none where two are about as large. Frames before, those in which the face is hidden, turned away or gone,
    are marked `LOST` and NaN. A `person` who is known is placed and not estimated. Raises `InputError` where nothing starts,
    where times do not rise, and where pictures and times differ in number.
    """
    time_s = np.asarray(time_s, float)
    given = {k: points for k, points in (detections or {}).items() if 0 <= k < len(time_s) and len(points) in SCHEMES}
    if detections and not given:
        raise InputError(
            f"{len(detections)} frames with detected points, none of them among the video's {len(time_s)}",
            expected="one frame at least, of a neutral face seen from the front",
            remedy="Give a detector's file for this video.",
        )
    tracker = MonocularTracker(model, camera, settings, focal_known=focal_known, person=person)
    steps = _steps(time_s)
    results: list[FrameResult | None] = []
    refusal: InputError | None = None
    for k, picture in enumerate(pictures):
        if any(results):
            results.append(tracker.follow(picture, given.get(k), steps[k] if k < len(steps) else 1.0))
        elif given:
            results.append(tracker.start(picture, given[k]) if k == min(given) else None)
        else:
            result, refusal = _tried(tracker, picture)
            results.append(result)
    if not any(results):
        raise refusal or InputError("a video without pictures", expected="one at least", remedy="Look at the file.")
    if len(results) != len(time_s):
        raise InputError(f"{len(results)} pictures", expected=f"{len(time_s)}, one per moment", remedy="Read the video whole.")
    return _joined(model, camera, tracker, time_s, results)


def place_frames(
    model: HeadModel,
    camera: Camera,
    pictures: Iterable[NDArray[np.uint8]],
    time_s: NDArray,
    estimates: Iterable[Estimate],
    settings: MonocularSettings,
    person: MonocularPerson,
) -> MonocularTrack:
    """A track of frames at `time_s` (f,) in which a known person's pose, jaw and expression are known too, and not estimated.

    Frames that do not look so are `LOST`. Raises `InputError` where none does.
    """
    tracker = MonocularTracker(model, camera, settings, person=person)
    results = [tracker.take_up(picture, estimate) for picture, estimate in zip(pictures, estimates, strict=True)]
    if all(result.estimate is None for result in results):
        raise InputError(f"{len(results)} frames like none of which the face looks", expected="one", remedy="Track the video.")
    return _joined(model, camera, tracker, np.asarray(time_s, float), results)


def _steps(time_s: NDArray) -> NDArray[np.float64]:
    """(f,) intervals before frames at rising times (f,), over the usual one: frames drop out, and telephones vary their rate."""
    if len(time_s) < 2:
        return np.ones(len(time_s))
    intervals = np.diff(time_s)
    if not (intervals > 0).all():
        at = int(np.flatnonzero(~(intervals > 0))[0])
        raise InputError(
            f"frame {at + 1} at {time_s[at + 1]:.3f} s behind one at {time_s[at]:.3f} s",
            expected="times that rise from frame to frame",
            remedy="Give each frame's own presentation time.",
        )
    return np.r_[1.0, intervals / np.median(intervals)]


def _tried(tracker: MonocularTracker, picture: NDArray[np.uint8]) -> tuple[FrameResult | None, InputError | None]:
    """A start from nothing, or why there is none."""
    try:
        return tracker.start(picture), None
    except InputError as error:
        return None, error


def _joined(
    model: HeadModel, camera: Camera, tracker: MonocularTracker, time_s: NDArray, results: list[FrameResult | None]
) -> MonocularTrack:
    f, surface = len(results), tracker.surface
    arrays = {
        "expression": np.full((f, surface.expressions), np.nan),
        "jaw": np.full((f, 3), np.nan),
        "placement": np.full((f, 4, 4), np.nan),
        "light": np.full((f, 3, 9), np.nan),
    }
    figures = {name: np.full(f, np.nan) for name in ("residual", "inliers", "correlation")}
    world_from_camera = invert(camera.camera_from_world)
    begun = next(result for result in results if result and result.estimate)
    for k, result in enumerate(results):
        if result is None or result.estimate is None:
            continue
        arrays["expression"][k], arrays["jaw"][k] = result.estimate.expression, result.estimate.jaw
        arrays["placement"][k] = world_from_camera @ result.estimate.camera_from_head
        arrays["light"][k] = result.light
        for name, values in figures.items():
            values[k] = getattr(result, name)
    states = tuple(FrameState.LOST if result is None else result.state for result in results)
    ratio, shape = float(np.exp(begun.estimate.log_focal)), surface.shape(begun.estimate)
    arrays["layer"] = surface.layer(begun.estimate)
    return MonocularTrack(model.digest, time_s, states, shape, focal_ratio=ratio, others=begun.others, **arrays, **figures)
