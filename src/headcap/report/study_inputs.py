"""What the page of a study's neck model is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import Manifest
from headcap.errors import InputError
from headcap.evaluation.metrics import Figure
from headcap.evaluation.neck_study import NeckStudy
from headcap.neck.animation.animation import meshes_of_curves
from headcap.neck.animation.curves import CoefficientCurves
from headcap.neck.fits import NeckFits, TakeFit
from headcap.neck.model import NeckModel, NeckPerson
from headcap.registration.sequence import JoinedMeshes
from headcap.speech import SpeechCoefficients

Drive = Literal["user", "generic", "face"]
"""What drives an animation: the voice by the person's own regressor or by a group's, or pose and expression of a face."""


@dataclass(frozen=True, eq=False)
class Animation:
    """A person moved by curves, beside what the person really did where that is known."""

    title: str
    drive: Drive
    person: NeckPerson
    curves: CoefficientCurves
    """f frames of all channels that the animation is made of."""
    truth: NDArray | JoinedMeshes | None = None
    """(f, n, 3) metres in the frame of the curves' placement; read frame by frame."""
    fitted: CoefficientCurves | None = None
    """What the neck model says of the truth, at the same moments."""

    def __post_init__(self) -> None:
        for name, given in (("true meshes", self.truth), ("fitted curves", self.fitted)):
            if given is not None and len(given) != len(self.curves):
                raise InputError(
                    f"{self.title}: {len(given)} {name} beside {len(self.curves)} frames of curves",
                    expected="one for each frame",
                    remedy="Take them from the same take.",
                )

    @classmethod
    def of_voice(
        cls,
        title: str,
        drive: Drive,
        model: NeckModel,
        person: NeckPerson,
        take: TakeFit,
        heard: SpeechCoefficients,
        truth: NDArray | JoinedMeshes | None = None,
    ) -> Animation:
        """A take whose pose and expression are fitted and whose phi, tau and alpha are those heard (section 7.3).

        `heard` holds a row for each of the take's frames; a regressor of phi alone leaves the larynx at rest.
        """
        fitted = CoefficientCurves.of_take(take, model.version, person.name)
        curves = fitted.with_curve("phi", heard.phi)
        still = (np.zeros(len(curves)), np.ones(len(curves)))
        for name, values, rest in zip(("tau", "alpha"), (heard.tau, heard.alpha), still, strict=True):
            curves = curves.with_curve(name, rest if values is None else values)
        return cls(title, drive, person, curves, truth, fitted)

    def meshes(self, model: NeckModel, frames: NDArray) -> NDArray[np.floating]:
        """Animated meshes (k, n, 3) of some frames."""
        return np.concatenate(
            list(meshes_of_curves(model.with_person(self.person), self.person.name, frames_of(self.curves, frames)))
        )


def frames_of(curves: CoefficientCurves, frames: NDArray) -> CoefficientCurves:
    """Some frames of curves, by number, rising."""
    placement = None if curves.placement is None else curves.placement[frames]
    channels = {name: values[frames] for name, values in curves.channels.items()}
    return replace(curves, time_s=curves.time_s[frames], channels=channels, placement=placement)


@dataclass(frozen=True, eq=False)
class StudyInputs:
    """Everything the page shows; parts that a run has not made are left out."""

    study: NeckStudy
    model: NeckModel
    fits: tuple[NeckFits, ...]
    """Of every subject, in the order of the study's rows."""
    figures: tuple[Figure, ...] = ()
    animations: tuple[Animation, ...] = ()
    """Figures 11 and 12 by voice, figure 13 by face."""
    swallower: NeckPerson | None = None
    """Who swallows in figure 14; the first person of the model by default."""
    swallow: CoefficientCurves | None = None
    """A swallow as fitted from a take; the ready curve by default."""
    groups: Mapping[str, str] = field(default_factory=dict)
    """Group of each subject that has one."""
    manifests: tuple[tuple[str, Manifest], ...] = ()
    versions: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping = field(default_factory=dict)
