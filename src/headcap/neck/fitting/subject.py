"""Every take of a person fitted stage by stage of a trained model: the errors of table 1, figure 7 and the ablation (section 7).

A stage's residual is taken at rest, where the parts of the model add up (eq. 4), and turned into the posed mesh's space by each
vertex's blended bones: skinning is affine in the rest shape, so these are exactly the distances between posed meshes (eq. 5).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.heads import HeadModel
from headcap.heads.skinning import bone_transforms, vertex_transforms
from headcap.neck.fits import NeckFits, TakeFit
from headcap.neck.fitting.compensation import FitSettings, FittedBlock, SequenceFitter, without_expressions
from headcap.neck.fitting.speech import SpeechFit, SpeechFitter
from headcap.neck.model import NeckModel, NeckPerson
from headcap.neck.subjects import NeckSubject, NeckTake

SPOKEN = ("speech", "lips", "free")
"""Kinds of takes in which a person may speak."""


def fit_subject(
    model: NeckModel,
    base: HeadModel,
    subject: NeckSubject,
    settings: FitSettings | None = None,
    *,
    held_out: bool,
    region: str = "neck",
) -> NeckFits:
    """Fit every take of a person with the base model and with each stage of the trained one.

    `base` is the head model before section 5.1's training, in the topology of `model`. Pose takes are fitted by pose alone,
    expression takes by pose and expression on the whole head (they are silent), all others by pose and expression on the
    settings' region, then by larynx and speech blendshapes; both models alike. Slide, scale and phi are fitted in every take
    (figure 9 shows them in a pose take), their errors stated of spoken ones. Errors are mean 3D distances over what was seen of
    `region`, millimetres. Raises `InputError` for a person that the model does not hold (`fit_person` finds them), another
    topology, a region that was not seen, or a take without a finite frame.
    """
    fitting = _Fitting(model, base, subject, settings or FitSettings(), _judged(model.head, subject, region))
    takes = tuple(_named(fitting, take) for take in subject.takes)
    return NeckFits(subject.name, takes, held_out)


def _judged(head: HeadModel, subject: NeckSubject, region: str) -> NDArray[np.int64]:
    """Vertices (k,) over which errors are taken."""
    inside = head.regions.get(region, np.zeros(len(head.vertices), bool))
    judged = np.flatnonzero(inside if subject.seen is None else inside & subject.seen)
    if not len(judged):
        raise InputError(
            f"{subject.name}: nothing was seen of the region {region}",
            expected=f"a region of {head.name} that cameras saw: {', '.join(sorted(head.regions))}",
            remedy="Name another region, or check the rig's view of this subject.",
        )
    return judged


def _named(fitting: _Fitting, take: NeckTake) -> TakeFit:
    try:
        return fitting.take(take)
    except InputError as error:
        found = f"{fitting.subject.name}, take {take.name}: {error.found}"
        raise InputError(found, expected=error.expected, remedy=error.remedy) from error


@dataclass(frozen=True, eq=False)
class _Fitting:
    """One person's models; fitters are made as kinds of takes ask for them."""

    model: NeckModel
    base: HeadModel
    subject: NeckSubject
    settings: FitSettings
    judged: NDArray[np.int64]

    @cached_property
    def trained_head(self) -> HeadModel:
        """This person's head model after section 5.1's training."""
        return self.subject.personal(self.model.head)

    @cached_property
    def speech(self) -> SpokenErrors:
        """What larynx and speech blendshapes explain of this person's meshes at rest."""
        return SpokenErrors(self.model, self.model.person(self.subject.name), self.judged, self.subject.seen)

    def fitter(self, head: HeadModel, kind: str) -> SequenceFitter:
        """Pose alone, or pose and expression on the whole head or the settings' region."""
        settings = self.settings.model_copy(update={"expression_region": None}) if kind == "expression" else self.settings
        return SequenceFitter(without_expressions(head) if kind == "pose" else head, settings, self.subject.seen)

    def take(self, take: NeckTake) -> TakeFit:
        """One take, block after block."""
        frames, trained = len(take.meshes), "pose" if take.kind == "pose" else "expression"
        stages = ["base", trained, *(("full", "without_larynx", "without_speech") if take.kind in SPOKEN else ())]
        errors = {stage: np.full(frames, np.nan) for stage in stages}
        base = self.fitter(self.subject.personal(self.base), take.kind)
        for block in base.blocks(take.meshes):
            errors["base"][block.frames] = posed_error_mm(base.model, block, self.judged)
        fitted = _Coefficients.empty(frames, self.model.head)
        own = self.fitter(self.trained_head, take.kind)
        for block in own.blocks(take.meshes):
            left = _without_expression(own.model, block)
            turns = _turns(own.model, block, self.judged)
            errors[trained][block.frames] = _error_mm(turns, left[:, self.judged])
            speech, spoken_left = self.speech.fit(own.model.vertices + left, take.kind in SPOKEN)
            for stage, rest in spoken_left.items():
                errors[stage][block.frames] = _error_mm(turns, rest)
            fitted.put(block, speech)
        return TakeFit(take.name, take.kind, np.asarray(take.time_s, float), *fitted.parts(), errors)


class SpokenErrors:
    """Larynx and speech blendshapes of one person, and what meshes free of pose and expression keep beyond them."""

    def __init__(
        self, model: NeckModel, person: NeckPerson, judged: NDArray[np.int64], seen: NDArray[np.bool_] | None = None
    ) -> None:
        """Of a person of a model; residuals are told of vertices `judged` (k,), and what was not `seen` (n,) tells nothing.

        Raises `InputError` for another map.
        """
        self.person, self.judged = person, judged
        self._whole = SpeechFitter(model.head, person, seen=seen)
        self._larynx_alone = SpeechFitter(replace(model.head, speech_basis=model.head.speech_basis[:0]), person, seen=seen)
        self._basis = np.asarray(model.head.speech_basis, float)
        resting = np.zeros_like(person.base)
        resting[person.larynx.vertices] = person.larynx.offset(0.0).values
        self._resting = resting

    def fit(self, meshes: NDArray, judge: bool) -> tuple[SpeechFit, dict[str, NDArray[np.float64]]]:
        """Coefficients of meshes (f, n, 3), at rest and free of pose and expression, and residuals (f, k, 3) metres by stage.

        full: mesh - T_0 - B_N(phi) - larynx(tau, alpha); without_larynx: the larynx stays at tau = 0, alpha = 1 and phi is solved
        for as if there were no other (eq. 20); without_speech: N = 0, tau and alpha by eq. 12 and 13 alone. No residuals where
        there is nothing to `judge`.
        """
        speech = self._whole.fit(meshes)
        if not judge:
            return speech, {}
        at_rest = np.zeros(len(meshes)), np.ones(len(meshes))
        still, alone = self._whole.fit_weights(meshes, *at_rest), self._larynx_alone.fit(meshes)
        offsets = np.asarray(meshes[:, self.judged], float) - self.person.base[self.judged]
        return speech, {
            "full": offsets - self._larynx(speech) - self._spoken(speech.phi),
            "without_larynx": offsets - self._resting[self.judged] - self._spoken(still),
            "without_speech": offsets - self._larynx(alone),
        }

    def _spoken(self, phi: NDArray) -> NDArray[np.float64]:
        """B_N (f, k, 3)."""
        return np.tensordot(phi, self._basis[:, self.judged], axes=1)

    def _larynx(self, speech: SpeechFit) -> NDArray[np.float64]:
        """(f, k, 3) of eq. 1."""
        moved = np.zeros((len(speech.tau_m), *self.person.base.shape))
        moved[:, self.person.larynx.vertices] = self.person.larynx.offset(speech.tau_m, speech.alpha).values
        return moved[:, self.judged]


def posed_error_mm(model: HeadModel, block: FittedBlock, judged: NDArray[np.int64]) -> NDArray[np.float64]:
    """(f,) mean distance of the posed model from the fitted meshes over chosen vertices (k,), millimetres (section 7.1)."""
    return _error_mm(_turns(model, block, judged), _without_expression(model, block)[:, judged])


def _without_expression(model: HeadModel, block: FittedBlock) -> NDArray:
    """(f, n, 3) what pose and expression leave at rest."""
    if not len(model.expression_basis):
        return block.displacement
    basis = model.expression_basis.reshape(len(model.expression_basis), model.vertices.size)
    return block.displacement - (block.psi.astype(basis.dtype) @ basis).reshape(block.displacement.shape)


def _turns(model: HeadModel, block: FittedBlock, judged: NDArray[np.int64]) -> NDArray[np.float64]:
    """(f, k, 3, 3) blended bones of chosen vertices, from rest to pose."""
    bones = bone_transforms(block.poses.theta, np.asarray(model.joints(), float), block.poses.placement)
    return vertex_transforms(bones, np.asarray(model.skinning_weights[judged], float))[..., :3]


def _error_mm(turns: NDArray, rest: NDArray) -> NDArray[np.float64]:
    """(f,) mean length of residuals at rest (f, k, 3), turned into the pose."""
    return 1e3 * np.linalg.norm(np.einsum("fkij,fkj->fki", turns, rest), axis=-1).mean(axis=-1)


@dataclass(frozen=True, eq=False)
class _Coefficients:
    """Of the frames of a take, NaN until they are put."""

    speech: SpeechFit
    theta: NDArray[np.float64]
    psi: NDArray[np.float64]
    placement: NDArray[np.float64]

    @classmethod
    def empty(cls, frames: int, head: HeadModel) -> _Coefficients:
        """So many frames, none of them fitted."""
        speech = SpeechFit(*(np.full(shape, np.nan) for shape in (frames, frames, (frames, len(head.speech_basis)))))
        shapes = ((frames, 2, 3), (frames, len(head.expression_basis)), (frames, 4, 4))
        return cls(speech, *(np.full(shape, np.nan) for shape in shapes))

    def put(self, block: FittedBlock, speech: SpeechFit) -> None:
        """Enter the frames of a block."""
        at = block.frames
        self.theta[at], self.placement[at] = block.poses.theta, block.poses.placement
        # a pose take shows no expression (section 5.1)
        self.psi[at] = block.psi if block.psi.shape[1] else 0.0
        self.speech.tau_m[at], self.speech.alpha[at], self.speech.phi[at] = speech.tau_m, speech.alpha, speech.phi

    def parts(self) -> tuple[SpeechFit, NDArray, NDArray, NDArray]:
        """speech, theta, psi and placement, as `TakeFit` takes them."""
        return self.speech, self.theta, self.psi, self.placement
