"""A voice, or curves, to the meshes of a person (sections 6.2 and 7.3): nothing here needs a recording."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.heads import HeadCoefficients
from headcap.neck.animation.curves import CoefficientCurves
from headcap.neck.model import NeckModel
from headcap.registration.template import Template
from headcap.speech import RATE_HZ, SpeechRegressor, speech_features, visual_centres

BLOCK = 64
"""Frames that are evaluated at a time: memory does not grow with the animation."""


def curves_of_sound(model: NeckModel, person: str, regressor: SpeechRegressor, samples: NDArray, fps: float) -> CoefficientCurves:
    """phi, tau and alpha by eq. 21 to 24 at every n / fps within sound (m,) at 16 kHz; the face stays at rest.

    A regressor that drives blendshapes alone leaves the larynx at rest. Raises `InputError` for a regressor of another model, a
    person that the model does not know, a rate that is not positive, or sound shorter than 520 ms.
    """
    regressor.check_model(model.version)
    model.person(person)
    if not (np.isfinite(fps) and fps > 0):
        raise InputError(f"{fps} frames per second", expected="a positive rate", remedy="Give the animation's frame rate.")
    frames = int((max(len(samples), 1) - 1) / RATE_HZ * fps + 1e-9) + 1
    heard = speech_features(samples, visual_centres(frames, fps), regressor.features)
    found = regressor.coefficients(heard, model.version)
    channels = {"tau": found.tau, "alpha": found.alpha, "phi": found.phi}
    given = {name: values for name, values in channels.items() if values is not None}
    return CoefficientCurves(np.arange(frames) / fps, given, model_version=model.version, person=person)


def meshes_of_curves(model: NeckModel, person: str, curves: CoefficientCurves) -> Iterator[NDArray[np.floating]]:
    """Meshes (frames, n, 3) of eq. 4 and 5 in metres, block by block; what the curves do not hold rests.

    Raises `InputError` for curves of another model, an unknown person, or more weights than the model has blendshapes.
    """
    curves.check_model(model.version)
    who = model.person(person)
    channels = curves.channels
    pose = np.stack([channels.get(name, np.zeros((len(curves), 3))) for name in ("neck", "jaw")], axis=1)
    posed = HeadCoefficients(expression=channels.get("psi"), pose=pose, speech=channels.get("phi"), placement=curves.placement)
    tau = channels.get("tau", np.zeros(len(curves)))
    alpha = channels.get("alpha", np.ones(len(curves)))
    for start in range(0, len(curves), BLOCK):
        block = slice(start, start + BLOCK)
        yield model.evaluate(who, posed.frames(block), tau[block], alpha[block])


def template_of(model: NeckModel, person: str) -> Template:
    """The person's neutral head with the model's topology and texture coordinates; raises `InputError` where it has none."""
    rest = model.evaluate(model.person(person), HeadCoefficients(), 0.0, 1.0)
    return model.head.personal(rest).template()
