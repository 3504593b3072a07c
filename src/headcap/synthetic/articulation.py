"""What the speaker's articulators do over time: one random utterance as smooth tracks that drive voice, lips and larynx."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

GRID_HZ = 1000.0
ONSET_S = 0.40
"""The subject holds still until then."""


@dataclass(frozen=True)
class Phone:
    """Targets of one speech sound."""

    duration_s: float
    formants_hz: tuple[float, float, float]
    voicing: float
    friction: float = 0.0
    friction_hz: float = 4000.0
    jaw: float = 0.2
    rounding: float = 0.0
    spreading: float = 0.0
    closure: float = 0.0
    tuck: float = 0.0
    larynx_mm: float = 0.0


VOWELS = (
    Phone(0.13, (760, 1250, 2550), 1.0, jaw=0.95, spreading=0.1, larynx_mm=-1.0),
    Phone(0.12, (500, 1850, 2500), 1.0, jaw=0.5, spreading=0.5, larynx_mm=0.5),
    Phone(0.11, (300, 2250, 3000), 1.0, jaw=0.2, spreading=0.9, larynx_mm=2.5),
    Phone(0.13, (480, 850, 2450), 1.0, jaw=0.55, rounding=0.75, larynx_mm=-2.0),
    Phone(0.12, (320, 760, 2300), 1.0, jaw=0.25, rounding=1.0, larynx_mm=-4.0),
)
CONSONANTS = (
    Phone(0.08, (280, 1000, 2200), 0.35, jaw=0.1, closure=1.0),
    Phone(0.07, (300, 1100, 2300), 0.0, jaw=0.1, closure=1.0, larynx_mm=1.0),
    Phone(0.09, (400, 1700, 2600), 0.0, 0.5, 5600.0, jaw=0.08, spreading=0.5),
    Phone(0.09, (400, 1500, 2500), 0.0, 0.45, 3000.0, jaw=0.12, rounding=0.5),
    Phone(0.08, (400, 1300, 2300), 0.0, 0.2, 7000.0, jaw=0.15, tuck=1.0),
    Phone(0.06, (350, 1500, 2700), 0.7, jaw=0.3),
    Phone(0.06, (350, 1700, 2600), 0.5, jaw=0.25),
    Phone(0.06, (600, 1400, 2500), 0.0, 0.12, 1500.0, jaw=0.4),
)


@dataclass(frozen=True)
class Tracks:
    """Named tracks on a regular grid, read at any time; constant beyond the ends."""

    time_s: NDArray[np.float64]
    names: tuple[str, ...]
    values: NDArray[np.float64]
    """(times, names)."""

    def at(self, time_s: NDArray | float, *names: str) -> NDArray:
        """Values (..., len(names)) of the named tracks (all where none is named) at times (...)."""
        columns = [self.names.index(name) for name in names or self.names]
        clipped = np.clip(time_s, self.time_s[0], self.time_s[-1])
        return self._spline(clipped)[..., columns]

    @property
    def _spline(self) -> CubicSpline:
        cached = self.__dict__.get("_cached_spline")
        if cached is None:
            cached = CubicSpline(self.time_s, self.values)
            object.__setattr__(self, "_cached_spline", cached)
        return cached


# how long each articulator takes to follow its target (standard deviation of the smoothing, seconds)
_INERTIA_S = {
    "f1_hz": 0.016,
    "f2_hz": 0.016,
    "f3_hz": 0.016,
    "voicing": 0.005,
    "friction": 0.006,
    "friction_hz": 0.01,
    "jaw": 0.028,
    "rounding": 0.024,
    "spreading": 0.024,
    "closure": 0.011,
    "tuck": 0.014,
}


def speak(random: np.random.Generator, duration_s: float, *, pitch_hz: float) -> Tracks:
    """A random utterance from shortly after `ONSET_S` to the end: articulators 0 to 1, pitch and formants in hertz.

    `pitch_hz` is the speaker's mean; the larynx track (mm, up) follows pitch, vowel and jaw with the lag of a damped mass.
    """
    time = np.arange(0, duration_s + 0.3, 1 / GRID_HZ)
    starts, phones = _utterance(random, time[-1])
    index = np.clip(np.searchsorted(starts, time, side="right") - 1, 0, len(phones) - 1)
    targets = {
        name: np.array([getattr(phone, name) for phone in phones])[index]
        for name in _INERTIA_S
        if name[0] != "f" or name[1] == "r"
    }
    formants = np.array([phone.formants_hz for phone in phones])[index]
    targets |= {f"f{k + 1}_hz": formants[:, k] for k in range(3)}
    begun = np.clip((time - ONSET_S) / 0.05, 0, 1)
    begun = begun * begun * (3 - 2 * begun)
    tracks = {name: gaussian_filter1d(targets[name], sigma * GRID_HZ, mode="nearest") for name, sigma in _INERTIA_S.items()}
    for name in ("voicing", "friction", "jaw", "rounding", "spreading", "closure", "tuck"):
        tracks[name] *= begun
    tracks["pitch_hz"] = pitch_hz * 2 ** _intonation(random, time)
    vowel_pull = np.array([phone.larynx_mm for phone in phones])[index]
    drive = 11.0 * np.log2(tracks["pitch_hz"] / pitch_hz) * (1 - 0.35 * tracks["jaw"]) + vowel_pull - 2.0 * tracks["jaw"] ** 2
    tracks["larynx_mm"] = _damped_mass(drive * begun, natural_hz=6.0) * begun
    return Tracks(time, tuple(tracks), np.stack(list(tracks.values()), axis=1))


def _utterance(random: np.random.Generator, duration_s: float) -> tuple[NDArray, list[Phone]]:
    starts, phones, clock, consonant = [0.0], [Phone(0.4, (500, 1500, 2500), 0.0, jaw=0.0)], ONSET_S + 0.02, False
    while clock < duration_s:
        choice = CONSONANTS if consonant else VOWELS
        phone = choice[random.integers(len(choice))]
        starts.append(clock)
        phones.append(phone)
        clock += phone.duration_s * random.uniform(0.8, 1.25)
        consonant = not consonant
        if consonant and random.random() < 0.06:  # a breath
            starts.append(clock)
            phones.append(Phone(0.15, (500, 1500, 2500), 0.0, jaw=0.05))
            clock += 0.15
    return np.array(starts), phones


def _intonation(random: np.random.Generator, time: NDArray) -> NDArray:
    """Octaves about the mean pitch: accents of about 3 Hz over a falling line."""
    knots = np.arange(0, time[-1] + 0.4, 0.16)
    accents = CubicSpline(knots, random.normal(0, 0.16, len(knots)))(time)
    return accents + 0.12 * np.cos(np.pi * (time % 2.2) / 2.2)


def _damped_mass(drive: NDArray, *, natural_hz: float) -> NDArray:
    """A critically damped mass on a spring that is pulled to `drive`, by exact exponential steps."""
    decay = np.exp(-2 * np.pi * natural_hz / GRID_HZ)
    out = drive
    for _ in range(2):  # critical damping is the same first-order lag twice
        lagged, value = np.empty_like(out), 0.0
        for k, target in enumerate(out):
            value = decay * value + (1 - decay) * target
            lagged[k] = value
        out = lagged
    return out
