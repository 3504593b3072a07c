"""Who speaks, as the training of a voice needs it: coefficients of speech takes beside the features of their sound."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.neck.fits import NeckFits, TakeFit
from headcap.neck.model import NeckModel
from headcap.speech import RATE_HZ, FeatureSettings, SpeechCoefficients, SpeechTake
from headcap.speech.framing import CONTEXT_SAMPLES
from headcap.speech.silence import Silence
from headcap.speech.take_sound import TakeSound

WINDOW_S = CONTEXT_SAMPLES / RATE_HZ
"""Sound that one visual frame hears."""


@dataclass(frozen=True, eq=False)
class HeardTake:
    """A fitted take and its sound."""

    name: str
    camera: str
    time_s: NDArray[np.float64]
    """(f,) on the take's common clock."""
    spoken: SpeechTake
    """NaN where a frame was not fitted, or at which no sound was recorded."""


@dataclass(frozen=True, eq=False)
class Speaker:
    """A person's speech takes of which some frame was fitted and heard."""

    name: str
    takes: tuple[HeardTake, ...]
    held_out: bool
    """True where others' voices are tested on this person, and none is trained."""
    unusable: Mapping[str, int]
    """Takes without such a frame, and how many frames they have."""

    @classmethod
    def of(cls, model: NeckModel, fits: NeckFits, sounds: Mapping[str, TakeSound], settings: FeatureSettings) -> Speaker:
        """From fits with a model and sounds by take; other kinds of takes are left aside.

        Raises `InputError` where nothing was said, a take has no sound, or phi is of another model.
        """
        spoken = [take for take in fits.takes if take.kind == "speech"]
        if not spoken:
            raise InputError(
                f"{fits.person}: none of {len(fits.takes)} fitted takes is of kind speech",
                expected="one at least",
                remedy="Fit a take in which the person speaks, or train no voice of this person",
            )
        missing = [take.take for take in spoken if take.take not in sounds]
        if missing:
            raise InputError(
                f"{fits.person}: no sound of {', '.join(missing)}", expected="one for each speech take", remedy="Hear the takes"
            )
        heard = [_heard(model, fits.person, take, sounds[take.take], settings) for take in spoken]
        usable = tuple(take for take in heard if take.spoken.known.any())
        unusable = {take.name: len(take.time_s) for take in heard if not take.spoken.known.any()}
        if not usable:
            raise InputError(
                f"{fits.person}: no frame of {', '.join(unusable)} was both fitted and heard",
                expected="frames to learn from",
                remedy="Look at the takes' fits, and at the clock of their sounds",
            )
        return cls(fits.person, usable, fits.held_out, unusable)

    @property
    def spoken(self) -> tuple[SpeechTake, ...]:
        """The takes, to train on."""
        return tuple(take.spoken for take in self.takes)

    def without_larynx(self) -> Speaker:
        """With phi alone."""
        takes = [replace(take, coefficients=SpeechCoefficients(take.coefficients.phi)) for take in self.spoken]
        return self._with(takes)

    def silence(self) -> Silence | None:
        """The person's coefficients in silence; None where too few pauses were heard."""
        return Silence.of(self.spoken)

    def without_silence(self) -> Speaker:
        """As if the neutral head stood for the person's silence; unchanged where silence is not known."""
        silence = self.silence()
        return self if silence is None else self._with([silence.removed_from(take) for take in self.spoken])

    def _with(self, spoken: Sequence[SpeechTake]) -> Speaker:
        return replace(self, takes=tuple(replace(take, spoken=own) for take, own in zip(self.takes, spoken, strict=True)))


def _heard(model: NeckModel, person: str, fit: TakeFit, sound: TakeSound, settings: FeatureSettings) -> HeardTake:
    phi = fit.speech.phi
    if phi.shape[1] != len(model.head.speech_basis):
        raise InputError(
            f"{person} {fit.take}: {phi.shape[1]} blendshape weights, and a model of {len(model.head.speech_basis)}",
            expected="fits of the same model",
            remedy="Fit the takes with this model",
        )
    unheard = ~sound.covers(fit.time_s)
    parts = (
        np.where(unheard.reshape(-1, *[1] * (part.ndim - 1)), np.nan, part) for part in (phi, fit.speech.tau_m, fit.speech.alpha)
    )
    spoken = SpeechTake(f"{person} {fit.take}", sound.features(fit.time_s, settings), SpeechCoefficients(*parts))
    return HeardTake(fit.take, sound.camera, fit.time_s, spoken)


def shared_sound_share(time_s: NDArray, lengths: Sequence[int]) -> float:
    """Share of a take's frames, at moments (f,), whose window overlaps that of a frame of another stretch.

    `lengths` are the numbers of frames of the stretches that the take was cut into, in order.
    """
    shared, ends = 0, np.cumsum(lengths)
    for start, end in zip(ends - lengths, ends, strict=True):
        own = time_s[start:end]
        near = np.zeros(len(own), bool)
        if start > 0:
            near |= own - time_s[start - 1] < WINDOW_S
        if end < len(time_s):
            near |= time_s[end] - own < WINDOW_S
        shared += int(near.sum())
    return shared / len(time_s)
