"""Start times of one take's recordings on a common clock, from the sound of a clap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from headcap.errors import InputError, InputErrors
from headcap.sync.clap import find_claps
from headcap.sync.events import Event, Sound, find_events
from headcap.sync.gcc import Delay, delay_of_spectra, spectrum
from headcap.sync.offsets import TimeOffsets
from headcap.sync.pairs import from_pair_medians, residuals, solve_pairs
from headcap.sync.settings import SyncSettings

Array = NDArray[np.float64]

NO_CLAP_REMEDY = (
    "Give this take's start times by hand (`offsets_s` in the session file);"
    " `headcap.sync.align_recordings` finds them from speech"
)
# an event this near to the best one in score may as well be the clap: the first of them is taken
AS_GOOD = 0.9


@dataclass(frozen=True)
class Arrivals:
    """When one event reached each camera."""

    own_time_s: Array
    """(cameras,) on each camera's own clock."""
    residual_s: Array
    """(cameras, cameras) measured pair delay minus the solution's, NaN where there is no measurement."""
    agreement: Array
    """(cameras,) share of the other cameras whose pair agrees, 0 to 1: the confidence."""


@dataclass(frozen=True)
class SyncResult:
    """Start times and how they were found."""

    offsets: TimeOffsets
    events: tuple[Arrivals, ...]
    """The clap, and a second one where drift was measured; empty where all offsets are manual."""
    flight_s: Array
    """(cameras,) time of flight that was taken off, seconds."""

    @property
    def figures(self) -> dict[str, float]:
        """Figures for the manifest: pair residual (robust, ms), least confidence, spread of the time of flight (ms)."""
        found = {"sync.confidence_min": min(self.offsets.confidence)}
        if self.events:
            residual = np.abs(self.events[0].residual_s[np.isfinite(self.events[0].residual_s)])
            found["sync.pair_residual_median_ms"] = 1e3 * float(np.median(residual)) if len(residual) else 0.0
            found["sync.pair_residual_p95_ms"] = 1e3 * float(np.percentile(residual, 95)) if len(residual) else 0.0
            found["sync.flight_spread_ms"] = 1e3 * float(np.ptp(self.flight_s))
            found["sync.drift_max_ppm"] = max(abs(drift) for drift in self.offsets.drift_ppm)
        return found


def synchronise(
    audio: Mapping[str, tuple[NDArray, int, float]],
    *,
    take: str,
    camera_centres: Mapping[str, Array] | None = None,
    clapper_m: Array | None = None,
    av_offset_s: Mapping[str, float] | None = None,
    manual_start_s: Mapping[str, float] | None = None,
    settings: SyncSettings | None = None,
) -> SyncResult:
    """Find the clap in every camera's sound and put all cameras on one clock.

    `audio` is per camera (mono samples, rate in Hz, own time of the first sample); an empty array for a camera without
    sound. With `camera_centres` and `clapper_m` (metres, one frame) the sound's time of flight is taken off. `av_offset_s`
    is by how much a camera's pictures are later on the common clock than its sound says (from `refine_clapper`).
    `manual_start_s` fixes cameras by hand and wins over the sound.

    The common clock reads zero when the camera that starts last reads zero on its own clock; the others' `start_s` are
    negative. Where all cameras are manual their values are kept as given. Start times are not rounded to frames: each
    camera's frame k is at `offsets.common_time(camera, frame_times_s)[k]`, and whoever compares cameras uses that.

    Raises `InputError` where no clap is heard and `InputErrors` for cameras whose sound does not agree with the others'.
    """
    settings, manual = settings or SyncSettings(), dict(manual_start_s or {})
    unknown = sorted(set(manual) - set(audio))
    if unknown:
        expected, remedy = f"among {', '.join(audio)}", "Correct the name in `offsets_s`"
        raise InputError(f"offsets are given for {', '.join(unknown)} of {take}", expected=expected, remedy=remedy)
    cameras = tuple(audio)
    if all(camera in manual for camera in cameras):
        return _manual_result(take, cameras, manual)
    flight_s = times_of_flight_s(cameras, camera_centres, clapper_m, settings)
    heard = [c for c, camera in enumerate(cameras) if len(audio[camera][0])]
    sounds = [Sound(np.asarray(audio[cameras[c]][0]), audio[cameras[c]][1], audio[cameras[c]][2]) for c in heard]
    events = find_events(sounds, settings) if len(sounds) > 1 else []
    if not events:
        found = f"{take}: no sudden sound is common to {settings.least_cameras_share:.0%} of its {len(cameras)} cameras"
        expected = f"a clap that jumps by {settings.onset_jump_db:g} dB above {settings.highpass_hz:g} Hz"
        raise InputError(found, expected=expected, remedy=NO_CLAP_REMEDY)
    arrivals = [_spread(arrive(sounds, event, settings), heard, len(cameras)) for event in _claps(events, settings)]
    start_s, drift_ppm, used = _clocks(arrivals, flight_s, settings)
    start_s = start_s + np.array([(av_offset_s or {}).get(camera, 0.0) for camera in cameras])
    _refuse_doubtful(take, cameras, used[0].agreement, manual, settings)
    return SyncResult(_offsets(take, cameras, start_s, drift_ppm, used[0].agreement, manual), tuple(used), flight_s)


def arrive(sounds: list[Sound], event: Event, settings: SyncSettings) -> Arrivals:
    """Own arrival times of one event to microseconds: GCC-PHAT of all pairs, robust least squares over them.

    A camera whose sound there is unlike the others' (it was aligned to a sound that only it heard) is tried at its other
    onsets first.
    """
    if len({sound.rate_hz for sound in sounds}) > 1:
        raise ValueError(f"sounds of one rate, got {sorted({sound.rate_hz for sound in sounds})} Hz")
    own_s = event.own_time_s.copy()
    cuts = [_cut(sound, time_s, settings) for sound, time_s in zip(sounds, own_s, strict=True)]
    differences, sharpness = _pair_delays(cuts, settings)
    if _retry_unlike(sounds, own_s, cuts, sharpness, settings):
        differences, sharpness = _pair_delays(cuts, settings)
    alike = sharpness >= settings.least_sharpness
    differences[~alike & ~np.eye(len(sounds), dtype=bool)] = np.nan
    values = solve_pairs(differences, np.where(alike, sharpness**2, 0.0), from_pair_medians(differences), settings.pair_scale_s)
    residual = residuals(differences, values)
    np.fill_diagonal(residual, np.nan)
    agreement = (np.abs(residual) < settings.pair_tolerance_s).sum(axis=1) / max(len(sounds) - 1, 1)
    # the values are free by a constant: set it by the onsets, which only names the moment
    return Arrivals(values + float(np.median(own_s - values)), residual, agreement)


def _pair_delays(cuts: list[Cut], settings: SyncSettings) -> tuple[Array, Array]:
    """Own time differences (n, n) of an event, second minus first, and the sharpness of each pair's correlation."""
    spectra, n = [_spectrum(cut) for cut in cuts], len(cuts)
    differences, sharpness = np.zeros((n, n)), np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1, n):
            delay = _delay(cuts[i], spectra[i], spectra[j], settings)
            differences[i, j] = cuts[j].start_s - cuts[i].start_s + delay.lag_s
            differences[j, i], sharpness[i, j] = -differences[i, j], delay.sharpness
    return differences, sharpness + sharpness.T


def _retry_unlike(sounds: list[Sound], own_s: Array, cuts: list[Cut], sharpness: Array, settings: SyncSettings) -> bool:
    """Move cameras unlike the others to their most alike onset, in place; whether any was moved."""
    n, moved = len(sounds), False
    typical = np.array([np.median(np.delete(sharpness[c], c)) for c in range(n)])
    like = np.flatnonzero(typical >= settings.least_sharpness)
    for c in np.flatnonzero(typical < settings.least_sharpness) if len(like) else ():
        onsets = find_claps(sounds[c].samples, sounds[c].rate_hz, sounds[c].start_s, settings)
        best = settings.least_sharpness
        for onset in onsets:
            cut = _cut(sounds[c], onset.time_s, settings)
            there = _spectrum(cut)
            found = float(np.median([_delay(cut, there, _spectrum(cuts[k]), settings).sharpness for k in like]))
            if found > best:
                best, own_s[c], cuts[c], moved = found, onset.time_s, cut, True
    return moved


def _spectrum(cut: Cut) -> NDArray[np.complex128]:
    return spectrum(cut.samples, scipy.fft.next_fast_len(2 * len(cut.samples), real=True))


def _delay(cut: Cut, first: NDArray, second: NDArray, settings: SyncSettings) -> Delay:
    size = scipy.fft.next_fast_len(2 * len(cut.samples), real=True)
    limits = {"max_lag_s": settings.max_lag_s, "band_hz": settings.band_hz, "upsampling": settings.upsampling}
    return delay_of_spectra(first, second, size, cut.rate_hz, expected_within_s=settings.onset_error_s, **limits)


@dataclass(frozen=True)
class Cut:
    """A short piece of one camera's sound."""

    samples: Array
    rate_hz: int
    start_s: float


def _cut(sound: Sound, time_s: float, settings: SyncSettings) -> Cut:
    """Sound around a time, faded at both ends, always of one length (silence beyond the file)."""
    rate = sound.rate_hz
    first = round((time_s - sound.start_s - settings.window_before_s) * rate)
    length = round((settings.window_before_s + settings.window_after_s) * rate)
    taken = np.zeros(length)
    low, high = max(first, 0), min(first + length, len(sound.samples))
    if high > low:
        taken[low - first : high - first] = sound.samples[low:high]
        taken[low - first : high - first] -= taken[low - first : high - first].mean()
    rise, fall = round(0.2 * settings.window_before_s * rate), round(0.4 * settings.window_after_s * rate)
    taken[:rise] *= np.sin(np.linspace(0, np.pi / 2, rise)) ** 2
    taken[length - fall :] *= np.cos(np.linspace(0, np.pi / 2, fall)) ** 2
    return Cut(taken, rate, sound.start_s + first / rate)


def _claps(events: list[Event], settings: SyncSettings) -> list[Event]:
    """The clap, then the farthest event that may be a second one for drift (events come best first)."""
    good = [event for event in events if event.score >= AS_GOOD * events[0].score]
    clap = min(good, key=lambda event: float(np.median(event.own_time_s)))
    span_s = [abs(float(np.median(event.own_time_s - clap.own_time_s))) for event in events]
    far = [i for i, s in enumerate(span_s) if s >= settings.drift_min_span_s and events[i].score >= 0.7 * events[0].score]
    return [clap] + ([events[max(far, key=lambda i: span_s[i])]] if far else [])


def _clocks(arrivals: list[Arrivals], flight_s: Array, settings: SyncSettings) -> tuple[Array, Array, list[Arrivals]]:
    """Sound start times (c,), drifts in ppm (c,) and the events they rest on.

    One clap: common arrival = flight = start + own, up to a constant. Two: own interval against the cameras' median
    interval gives the drift; the median clock is the common one.
    """
    own = arrivals[0].own_time_s
    none = np.zeros(len(own))
    if len(arrivals) > 1:
        interval = arrivals[1].own_time_s - own
        usable = (arrivals[0].agreement >= settings.min_confidence) & (arrivals[1].agreement >= settings.min_confidence)
        if usable.sum() >= 2:
            drift = np.where(usable, np.median(interval[usable]) / interval - 1, 0.0)
            if np.abs(drift).max() * 1e6 <= settings.max_drift_ppm:
                return flight_s - (1 + drift) * own, 1e6 * drift, arrivals
    return flight_s - own, none, arrivals[:1]


def times_of_flight_s(
    cameras: tuple[str, ...], centres: Mapping[str, Array] | None, clapper_m: Array | None, settings: SyncSettings
) -> Array:
    """(cameras,) time of flight of a sound to each camera, seconds; zeros where the places are not known."""
    if centres is None or clapper_m is None:
        return np.zeros(len(cameras))
    places = np.array([centres[camera] for camera in cameras], float)
    return np.linalg.norm(places - np.asarray(clapper_m, float), axis=1) / settings.speed_of_sound


def _spread(arrivals: Arrivals, heard: list[int], n: int) -> Arrivals:
    """Arrivals of the cameras with sound as arrivals of all; the others agree with nobody."""
    own, residual, agreement = np.zeros(n), np.full((n, n), np.nan), np.zeros(n)
    own[heard], agreement[heard] = arrivals.own_time_s, arrivals.agreement
    residual[np.ix_(heard, heard)] = arrivals.residual_s
    return Arrivals(own, residual, agreement)


def _refuse_doubtful(
    take: str, cameras: tuple[str, ...], agreement: Array, manual: Mapping[str, float], settings: SyncSettings
) -> None:
    doubtful = [c for c, name in enumerate(cameras) if agreement[c] < settings.min_confidence and name not in manual]
    expected = f"at least {settings.min_confidence:.0%}"
    remedy = "Check its microphone; give its start time by hand (`offsets_s`), or leave it out of the take"
    if doubtful:
        told = [f"{cameras[c]} of {take} agrees with {agreement[c]:.0%} of the other cameras about the clap" for c in doubtful]
        raise InputErrors([InputError(found, expected=expected, remedy=remedy) for found in told])


def _offsets(
    take: str, cameras: tuple[str, ...], start_s: Array, drift_ppm: Array, agreement: Array, manual: Mapping[str, float]
) -> TimeOffsets:
    """Common zero at the own zero of the camera that starts last; manual start times put in their place.

    Manual values may be on a clock of their own: it is shifted by the median of what sound and hand both give.
    """
    heard = np.array([agreement[c] > 0 for c in range(len(cameras))])
    start_s = start_s - start_s[heard].max()
    by_hand = [c for c, camera in enumerate(cameras) if camera in manual]
    both = [manual[cameras[c]] - start_s[c] for c in by_hand if heard[c]]
    shift_s = float(np.median(both)) if both else 0.0
    confidence, method = agreement.copy(), ["clap"] * len(cameras)
    for c in by_hand:
        start_s[c], drift_ppm[c], confidence[c], method[c] = manual[cameras[c]] - shift_s, 0.0, 1.0, "manual"
    start_s = start_s - start_s.max()
    columns = ((start_s, float), (drift_ppm, float), (confidence, float))
    return TimeOffsets(take, cameras, *(tuple(kind(v) for v in column) for column, kind in columns), tuple(method))


def _manual_result(take: str, cameras: tuple[str, ...], manual: Mapping[str, float]) -> SyncResult:
    n = len(cameras)
    start_s = tuple(float(manual[camera]) for camera in cameras)
    offsets = TimeOffsets(take, cameras, start_s, (0.0,) * n, (1.0,) * n, ("manual",) * n)
    return SyncResult(offsets, (), np.zeros(n))
