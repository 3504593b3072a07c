"""Coefficients of a neck model over time, as animators edit them and files keep them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import ArtifactError, load_json, save_json
from headcap.errors import InputError
from headcap.neck.fits import TakeFit

KIND, SCHEMA = "coefficient_curves", 1

CHANNELS: dict[str, tuple[str, int | None]] = {
    "tau": ("tau_m", 0),
    "alpha": ("alpha", 0),
    "phi": ("phi", None),
    "psi": ("psi", None),
    "neck": ("neck_rad", 3),
    "jaw": ("jaw_rad", 3),
}
"""Name of each channel in a file, and its components: 0 for a single curve, None for as many as the model has blendshapes."""
REST = {"alpha": 1.0}
"""Where a channel stands that nothing drives; all others at 0."""
_AXES = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True, eq=False)
class CoefficientCurves:
    """Coefficients of f frames; channels that are absent rest."""

    time_s: NDArray[np.float64]
    """(f,) rising; 0 is the sound's first sample, or a take's first frame."""
    channels: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    """tau (f,) metres upwards, alpha (f,), phi (f, p), psi (f, e), neck and jaw (f, 3) rotation vectors in radians."""
    placement: NDArray[np.float64] | None = None
    """world_from_head (f, 4, 4); None where the head stays in its own frame."""
    model_version: str = ""
    """Of the neck model that phi and psi belong to; empty for curves of the larynx and pose alone, which fit any."""
    person: str = ""
    """Whose they were."""

    def __post_init__(self) -> None:
        time_s = np.asarray(self.time_s, float)
        if time_s.ndim != 1 or len(time_s) == 0 or not np.isfinite(time_s).all() or (np.diff(time_s) <= 0).any():
            raise InputError(
                f"moments of shape {time_s.shape}", expected="one rising, finite moment for each frame, at least one frame",
                remedy="Correct time_s.",
            )  # fmt: skip
        object.__setattr__(self, "time_s", time_s)
        object.__setattr__(self, "channels", {name: self._checked(name, values) for name, values in self.channels.items()})
        if not self.model_version and {"phi", "psi"} & set(self.channels):
            raise InputError(
                "weights of blendshapes without a model version", expected="the version of the neck model that they belong to",
                remedy="Take phi and psi out, or name their model.",
            )  # fmt: skip
        if self.placement is not None and (
            np.shape(self.placement) != (len(self), 4, 4) or not np.isfinite(self.placement).all()
        ):
            raise _wrong_shape("placement", np.shape(self.placement), f"({len(self)}, 4, 4), finite")

    def _checked(self, name: str, values: NDArray) -> NDArray[np.float64]:
        if name not in CHANNELS:
            raise _unknown(name, CHANNELS)
        values, components = np.array(values, float), CHANNELS[name][1]
        wanted = (len(self),) if components == 0 else (len(self), values.shape[-1] if components is None else components)
        if values.shape != wanted or not np.isfinite(values).all():
            raise _wrong_shape(name, values.shape, f"{wanted}, finite: one row for each of the {len(self)} moments")
        values.flags.writeable = False
        return values

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def duration_s(self) -> float:
        """From the first frame to the last."""
        return float(self.time_s[-1] - self.time_s[0])

    @classmethod
    def of_take(cls, take: TakeFit, model_version: str, person: str) -> CoefficientCurves:
        """A take's fitted coefficients, moments counted from its first frame.

        Frames that were not fitted are filled linearly between their neighbours, placements by the nearest. Raises `InputError`
        where no frame was fitted.
        """
        known = take.speech.known & np.isfinite(take.placement).all(axis=(1, 2))
        channels = {
            "tau": take.speech.tau_m,
            "alpha": take.speech.alpha,
            "phi": take.speech.phi,
            "psi": take.psi,
            "neck": take.theta[:, 0],
            "jaw": take.theta[:, 1],
        }
        if not known.any():
            raise InputError(f"{take.take}: no fitted frame", expected="one at least", remedy="Look at its tracking.")
        return cls.filled(take.time_s, channels, take.placement, known, model_version, person)

    @classmethod
    def filled(
        cls,
        time_s: NDArray,
        channels: Mapping[str, NDArray],
        placement: NDArray | None,
        known: NDArray[np.bool_],
        model_version: str,
        person: str,
    ) -> CoefficientCurves:
        """Fitted coefficients with gaps, moments counted from the first frame; one frame (f,) at least must be known.

        Between known frames channels are linear, placements those of the nearest.
        """
        time_s, frames = np.asarray(time_s, float) - time_s[0], np.flatnonzero(known)
        values = {name: _interpolated(time_s, time_s[frames], np.asarray(v)[frames]) for name, v in channels.items()}
        nearest = frames[np.abs(np.subtract.outer(np.arange(len(time_s)), frames)).argmin(axis=1)]
        return cls(time_s, values, None if placement is None else placement[nearest], model_version, person)

    def curve(self, name: str) -> NDArray[np.float64]:
        """One channel (f,) or (f, k), or one component of it: `phi.3`, `neck.x`. Raises `InputError` for what is not there."""
        channel, component = self._split(name)
        values = self.channels[channel]
        return values if component is None else values[:, component]

    def only(self, *names: str) -> CoefficientCurves:
        """Some of the channels; the others rest."""
        return replace(self, channels={name: values for name, values in self.channels.items() if name in names})

    def with_curve(self, name: str, values: NDArray) -> CoefficientCurves:
        """The curves with a channel, or a component of one, replaced."""
        channel, component = self._split(name)
        if component is not None:
            whole = np.array(self.channels[channel])
            whole[:, component] = values
            values = whole
        return replace(self, channels={**self.channels, channel: values})

    def overlaid(self, other: CoefficientCurves) -> CoefficientCurves:
        """These moments, with the channels that `other` has in place of these curves' own.

        Raises `InputError` where `other` is of another model, or ends before or begins after these by more than a frame.
        """
        if other.model_version and self.model_version:
            other.check_model(self.model_version)
        other = other.at(self.time_s)
        placement = self.placement if other.placement is None else other.placement
        version = self.model_version or other.model_version
        return replace(self, channels={**self.channels, **other.channels}, placement=placement, model_version=version)

    def at(self, time_s: NDArray) -> CoefficientCurves:
        """The curves at other moments (n,), linear in between (rotations of neighbouring frames are near each other).

        Raises `InputError` for moments that these curves do not reach, with a frame's grace.
        """
        time_s = np.asarray(time_s, float)
        grace_s = 1.001 * (float(np.median(np.diff(self.time_s))) if len(self) > 1 else 0.0) + 1e-9
        if time_s[0] < self.time_s[0] - grace_s or time_s[-1] > self.time_s[-1] + grace_s:
            raise InputError(
                f"curves from {self.time_s[0]:.3f} to {self.time_s[-1]:.3f} s"
                f" for moments from {time_s[0]:.3f} to {time_s[-1]:.3f} s",
                expected="curves as long as what they drive, with a frame's grace",
                remedy="Cut the longer one, or make curves of the whole sound.",
            )
        channels = {name: _interpolated(time_s, self.time_s, values) for name, values in self.channels.items()}
        placement = None if self.placement is None else _placed(time_s, self.time_s, self.placement)
        return replace(self, time_s=time_s, channels=channels, placement=placement)

    def cut(self, start_s: float, end_s: float) -> CoefficientCurves:
        """The frames from one moment to another; the first of them becomes moment 0. Raises `InputError` where there are none."""
        kept = (self.time_s >= start_s - 1e-9) & (self.time_s <= end_s + 1e-9)
        if not kept.any():
            raise InputError(
                f"a cut from {start_s:g} to {end_s:g} s",
                expected=f"moments within {self.time_s[0]:.3f} to {self.time_s[-1]:.3f} s, the earlier one first",
                remedy="Correct the moments.",
            )
        channels = {name: values[kept] for name, values in self.channels.items()}
        placement = None if self.placement is None else self.placement[kept]
        return replace(self, time_s=self.time_s[kept] - self.time_s[kept][0], channels=channels, placement=placement)

    def check_model(self, model_version: str) -> None:
        """Raises `InputError` where phi or psi belong to another neck model."""
        if self.model_version and self.model_version != model_version:
            raise InputError(
                f"coefficient curves of neck model {self.model_version[:12]} beside neck model {model_version[:12]}",
                expected="curves of the same model",
                remedy="Make the curves again with this model, or load the model that they belong to.",
            )

    def save(self, path: Path | str) -> None:
        """Write as JSON artifact `headcap.coefficient_curves/1`."""
        content = {"person": self.person, "model_version": self.model_version, "time_s": self.time_s.tolist()}
        content["channels"] = {CHANNELS[name][0]: values.tolist() for name, values in self.channels.items()}
        content["world_from_head"] = None if self.placement is None else self.placement.tolist()
        save_json(path, KIND, SCHEMA, content)

    @classmethod
    def load(cls, path: Path | str) -> CoefficientCurves:
        """Read what `save` wrote or a person edited; raises `ArtifactError`, or `InputError` for curves that do not fit."""
        content = load_json(path, KIND, SCHEMA)
        names = {key: name for name, (key, _) in CHANNELS.items()}
        try:
            given = dict(content["channels"])
            unknown = sorted(set(given) - set(names))
            if unknown:
                raise _unknown(unknown[0], names)
            time_s = np.array(content["time_s"], float)
            channels = {names[key]: _array(values, key, len(time_s)) for key, values in given.items()}
            placement = content.get("world_from_head")
            placement = None if placement is None else np.array(placement, float)
            return cls(time_s, channels, placement, content.get("model_version", ""), content.get("person", ""))
        except InputError as error:
            raise InputError(f"{path}: {error.found}", expected=error.expected, remedy=error.remedy) from error
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise ArtifactError(f"{path} holds no whole curves ({error}); make it again") from error

    def _split(self, name: str) -> tuple[str, int | None]:
        """Channel and component of a name."""
        channel, _, part = name.partition(".")
        if channel not in self.channels:
            raise _unknown(name, self.channels)
        if not part:
            return channel, None
        values = self.channels[channel]
        count = values.shape[1] if values.ndim == 2 else 0
        component = _AXES.get(part, -1) if channel in ("neck", "jaw") else int(part) if part.isdigit() else -1
        if not 0 <= component < count:
            parts = "x, y, z" if channel in ("neck", "jaw") else f"0 to {count - 1}" if count else "no components"
            raise InputError(f"curve {name!r}", expected=f"{channel} with {parts}", remedy="Name a curve that is there.")
        return channel, component


def _array(values: list, key: str, frames: int) -> NDArray[np.float64]:
    """Numbers of a file; an empty list of weights per frame keeps its two axes."""
    try:
        return np.array(values, float)
    except ValueError as error:
        raise _wrong_shape(key, "ragged", f"one row of equal length for each of {frames} moments") from error


def _interpolated(time_s: NDArray, known_s: NDArray, values: NDArray) -> NDArray[np.float64]:
    """Values (k, ...) at moments (n,), linear in between and held beyond."""
    flat = np.asarray(values, float).reshape(len(known_s), int(np.prod(values.shape[1:])))
    columns = [np.interp(time_s, known_s, column) for column in flat.T]
    return np.array(columns).T.reshape(len(time_s), *values.shape[1:])


def _placed(time_s: NDArray, known_s: NDArray, placement: NDArray) -> NDArray[np.float64]:
    """Rigid transforms (n, 4, 4) between known ones: rotations along the shortest turn."""
    out = np.tile(np.eye(4), (len(time_s), 1, 1))
    out[:, :3, 3] = _interpolated(time_s, known_s, placement[:, :3, 3])
    if len(known_s) == 1:
        out[:, :3, :3] = placement[0, :3, :3]
        return out
    from scipy.spatial.transform import Rotation, Slerp

    turns = Slerp(known_s, Rotation.from_matrix(placement[:, :3, :3]))
    out[:, :3, :3] = turns(np.clip(time_s, known_s[0], known_s[-1])).as_matrix()
    return out


def _unknown(name: str, known) -> InputError:
    return InputError(
        f"curve {name!r}",
        expected=f"one of {', '.join(known) or 'none: there are no curves'}",
        remedy="Name a curve that is there.",
    )


def _wrong_shape(name: str, shape, wanted: str) -> InputError:
    return InputError(f"curve {name} is {shape}", expected=wanted, remedy="Give each frame its coefficients.")
