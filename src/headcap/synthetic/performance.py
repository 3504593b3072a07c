"""What the subject does in a take: muscles, jaw, lips, head and larynx as functions of continuous time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import cycle, islice

import numpy as np
from numpy.typing import NDArray

from headcap.synthetic.articulation import GRID_HZ, ONSET_S, Tracks, speak
from headcap.synthetic.settings import LipShape, TakeKind

MUSCLES = (
    "brow_raise_left",
    "brow_raise_right",
    "brow_frown",
    "smile_left",
    "smile_right",
    "corner_down_left",
    "corner_down_right",
    "sneer",
    "cheek_puff",
    "blink",
    "upper_lip_raise",
    "lower_lip_drop",
)
"""Contraction 0 to 1."""
ARTICULATORS = (
    "jaw", "jaw_side", "rounding", "spreading", "closure", "tuck", "upper_roll", "lower_roll", "mouth_side"
)  # fmt: skip
"""Jaw opening, its sideways shift (-1 to 1), lips rounded, spread, pressed together, lower lip under the teeth, each lip rolled
(-1 out to 1 in over the teeth), mouth drawn sideways (-1 to 1, 1 to the left)."""
RIGID = ("turn_x", "turn_y", "turn_z", "gaze_x", "gaze_y", "larynx_mm", "larynx_size")
"""Head turn as a rotation vector (radians), gaze (radians, up and left), the larynx's height (mm, up) and size less one."""
_SIGNED = {"jaw_side", "upper_roll", "lower_roll", "mouth_side", *RIGID}
CHANNELS = MUSCLES + ARTICULATORS + RIGID

_EXPRESSIONS: tuple[dict[str, float], ...] = (
    {"smile_left": 1.0, "smile_right": 0.95, "spreading": 0.3, "jaw": 0.15},
    {"brow_raise_left": 1.0, "brow_raise_right": 0.9, "jaw": 0.8},
    {"brow_frown": 1.0, "sneer": 0.9, "upper_lip_raise": 0.5},
    {"corner_down_left": 0.9, "corner_down_right": 1.0, "brow_frown": 0.5, "closure": 0.4},
    {"cheek_puff": 1.0, "closure": 0.6},
    {"rounding": 1.0, "brow_raise_left": 0.8},
    {"smile_left": 0.9, "blink": 0.6, "brow_raise_right": 0.6},
    {"blink": 1.0, "sneer": 0.6, "spreading": 0.8, "lower_lip_drop": 0.7},
    {"jaw": 1.0, "lower_lip_drop": 0.5, "upper_lip_raise": 0.4, "jaw_side": 0.5},
)
LIP_SHAPES: dict[LipShape, dict[str, float]] = {
    "pucker": {"rounding": 1.0, "jaw": 0.3},
    "press": {"closure": 1.0},
    "spread": {"spreading": 1.0, "upper_lip_raise": 0.5, "lower_lip_drop": 0.6},
    "tuck": {"tuck": 1.0, "jaw": 0.15},
    "bare_upper": {"upper_lip_raise": 1.0, "jaw": 0.1},
    "bare_lower": {"lower_lip_drop": 1.0, "jaw": 0.3},
    "round_open": {"jaw": 0.9, "rounding": 0.6},
    "smile": {"smile_left": 1.0, "smile_right": 0.95, "spreading": 0.4},
    "smirk_left": {"smile_left": 1.0, "mouth_side": 0.4},
    "smirk_right": {"smile_right": 1.0, "mouth_side": -0.4},
    "frown": {"corner_down_left": 0.95, "corner_down_right": 1.0, "closure": 0.3},
    "kiss": {"rounding": 1.0, "upper_roll": -0.5, "lower_roll": -0.5},
    "roll_in": {"upper_roll": 1.0, "lower_roll": 1.0},
    "roll_out": {"upper_roll": -1.0, "lower_roll": -1.0},
    "puff": {"cheek_puff": 1.0, "closure": 0.6, "rounding": 0.2},
    "side_left": {"mouth_side": 1.0, "jaw_side": 0.8},
    "side_right": {"mouth_side": -1.0, "jaw_side": -0.8},
    "jaw_open": {"jaw": 1.0},
}
"""What lips do in a take of theirs: the shapes that the lips' paper names (section 3.1), and what the jaw and single lips add."""
_TURNS: dict[TakeKind, tuple[float, float, float, float]] = {
    "pose": (0.24, 0.5, 0.18, 0.32),
    "turn": (0.24, 0.5, 0.18, 0.32),
    "speech": (0.03, 0.04, 0.02, 0.4),
    "free": (0.07, 0.15, 0.05, 0.45),
}
"""How far a head turns about its axes, radians, and how long a move takes, seconds."""
_FIRST_SHAPES = 7
"""These come first, in any order, where a take does not name its shapes; then the others; then all of them."""


@dataclass(frozen=True)
class Performance:
    """One take's motion; at rest until `articulation.ONSET_S`."""

    tracks: Tracks
    """`CHANNELS` on a grid."""
    speech: Tracks | None
    """What is said, where something is."""

    def state(self, time_s: float) -> dict[str, float]:
        """Every channel at one moment."""
        state = dict(zip(CHANNELS, self.tracks.at(time_s).tolist(), strict=True))
        # a spline may pass its knots' zero by a rounding error, and powers are taken of these
        return {name: value if name in _SIGNED else max(value, 0.0) for name, value in state.items()}


def perform(
    random: np.random.Generator, kind: TakeKind, duration_s: float, intensity: float, shapes: tuple[LipShape, ...] = ()
) -> Performance:
    """A random performance of a kind of take; takes of lips go through `shapes` over and over, or through all in random order."""
    time = np.arange(0, duration_s + 0.3, 1 / GRID_HZ)
    channels = {name: np.zeros(len(time)) for name in CHANNELS}
    speech = None
    if kind in ("speech", "free"):
        speech = speak(random, duration_s, pitch_hz=random.uniform(100, 150))
        _follow_speech(channels, speech, time)
    if kind in _TURNS:
        *reach, move_s = _TURNS[kind]
        _turn_head(channels, random, time, np.array(reach) * intensity, move_s)
    if kind in ("expression", "free", "lips"):
        poses = _lip_shapes(random, shapes) if kind == "lips" else _shuffled(random, _EXPRESSIONS)
        strength = intensity * {"expression": 1.0, "free": 0.6, "lips": 1.0}[kind]
        _make_faces(channels, random, time, poses, strength)
    if kind in ("expression", "free", "pose", "turn"):
        _blink(channels, random, time)
    for name in MUSCLES + ARTICULATORS:
        low = -1.0 if name in _SIGNED else 0.0
        channels[name] = _soft_limit(channels[name], low, 1.0)
    return Performance(Tracks(time, CHANNELS, np.stack([channels[name] for name in CHANNELS], axis=1)), speech)


def _follow_speech(channels: dict[str, NDArray], speech: Tracks, time: NDArray) -> None:
    for name in ("jaw", "rounding", "spreading", "closure", "tuck"):
        channels[name] += speech.at(time, name)[:, 0] * (0.75 if name == "jaw" else 1.0)
    channels["larynx_mm"] += 1.5 * speech.at(time, "larynx_mm")[:, 0]
    # a high larynx is a tilted, narrower one
    channels["larynx_size"] += -0.012 * speech.at(time, "larynx_mm")[:, 0]
    channels["lower_lip_drop"] += 0.35 * channels["spreading"] ** 2 * (1 - channels["closure"]).clip(0)


def _turn_head(channels: dict[str, NDArray], random: np.random.Generator, time: NDArray, reach: NDArray, move_s: float) -> None:
    turn = _moves(random, time, reach, move_s=move_s, rest_s=0.03)
    for axis, name in enumerate(("turn_x", "turn_y", "turn_z")):
        channels[name] += turn[:, axis]
    # the eyes stay on their target for a part of the turn
    channels["gaze_x"] -= 0.5 * turn[:, 0]
    channels["gaze_y"] -= 0.5 * turn[:, 1]
    channels["larynx_mm"] += -6.0 * turn[:, 0]


def _shuffled(random: np.random.Generator, poses: Sequence[dict[str, float]]) -> Iterator[dict[str, float]]:
    order = random.permutation(len(poses))
    return cycle([poses[k] for k in order])


def _lip_shapes(random: np.random.Generator, names: tuple[LipShape, ...]) -> Iterator[dict[str, float]]:
    if names:
        yield from cycle([LIP_SHAPES[name] for name in names])
    shapes = list(LIP_SHAPES.values())
    for part in (shapes[:_FIRST_SHAPES], shapes[_FIRST_SHAPES:]):
        yield from islice(_shuffled(random, part), len(part))
    yield from _shuffled(random, shapes)


def _make_faces(
    channels: dict[str, NDArray], random: np.random.Generator, time: NDArray, poses: Iterator[dict[str, float]], strength: float
) -> None:
    start = ONSET_S + 0.02
    # the order is drawn before the first attack
    pose = next(poses)
    while start < time[-1]:
        attack, hold, release = random.uniform(0.16, 0.26), random.uniform(0.05, 0.2), random.uniform(0.2, 0.3)
        shape = _ease((time - start) / attack) * (1 - _ease((time - start - attack - hold) / release))
        for name, value in pose.items():
            channels[name] += strength * value * shape
        start += attack + hold + 0.7 * release
        pose = next(poses)


def _blink(channels: dict[str, NDArray], random: np.random.Generator, time: NDArray) -> None:
    start = ONSET_S + random.uniform(0.1, 0.6)
    while start < time[-1]:
        channels["blink"] += _ease((time - start) / 0.09) * (1 - _ease((time - start - 0.11) / 0.16))
        start += random.uniform(1.5, 4.0)


def _moves(random: np.random.Generator, time: NDArray, reach: NDArray, *, move_s: float, rest_s: float) -> NDArray[np.float64]:
    """Moves (times, axes) of least jerk between random targets, alternating in sign so that they span the reach."""
    out = np.zeros((len(time), len(reach)))
    before, start, k = np.zeros(len(reach)), ONSET_S, 0
    while start < time[-1]:
        signs = np.where(random.random(len(reach)) < 0.8, (-1.0) ** (k + np.arange(len(reach))), 0.3)
        target = reach * signs * random.uniform(0.5, 1.0, len(reach))
        length = move_s * random.uniform(0.8, 1.3)
        out += (target - before) * _ease((time - start) / length)[:, None]
        before, start, k = target, start + length + rest_s, k + 1
    return out


def _ease(part: NDArray) -> NDArray:
    part = np.clip(part, 0, 1)
    return part**3 * (10 - 15 * part + 6 * part**2)


def _soft_limit(value: NDArray, low: float, high: float) -> NDArray:
    """Close to the identity inside, never beyond the limits, without a corner where speech and faces add up."""
    knee = 0.8
    over = np.clip(np.abs(value) - knee, 0, None)
    limited = np.where(over > 0, knee + (high - knee) * np.tanh(over / (high - knee)), np.abs(value))
    return np.clip(np.sign(value) * limited, low, high)
