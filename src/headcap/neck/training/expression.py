"""Expression bases E from several subjects' expression takes and from random identities (section 5.1; FLAME, section 4.3).

Measured on held-out persons of `headcap.synthetic` with a tracker's noise of 0.1 mm (0.16 mm of mean distance), two persons to
train on, mean error of two necks, 0.329 mm with generic expressions: 0.204 mm with 1 % of these kept, 0.212 with none, 0.204 with
5 %; random identities cost 0.015 mm of this, on persons who differ as little as these do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from headcap.geometry.leading_directions import RowSketch
from headcap.heads import HeadModel
from headcap.meshes.deformation_transfer import DeformationTransfer
from headcap.meshes.extension import SmoothExtension
from headcap.neck.fitting.compensation import FitSettings, SequenceFitter
from headcap.neck.training_subject import TrainingSubject, seen_by_all

_ANCHORED_SHARE = 0.9
"""Vertices that follow the trunk by this share hold a transferred head in its place."""
_MOST_SPREAD = 2.0
"""Random identities keep within so many standard deviations of each shape coefficient."""


class ExpressionTrainingSettings(BaseModel):
    """Training the expression basis."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    expressions: int = Field(100, ge=1, description="Expressions wanted; fewer where the takes show fewer")
    rounds: int = Field(2, ge=1, description="Times that poses and expressions are found in turn")
    identities: int = Field(10, ge=0, description="Random heads that the subjects' expressions are transferred to")
    transferred: int = Field(100, ge=1, description="Frames of each take transferred, spread evenly over it")
    identity_spread: float = Field(1.0, ge=0, description="Standard deviation of the random heads' shape coefficients")
    generic_share: float = Field(
        0.01,
        ge=0,
        description="Weight of the model's own expressions, as a share of the frames: what no take shows stays possible",
    )
    seed: int = Field(0, ge=0, description="Of the random identities")
    fit: FitSettings = Field(default_factory=FitSettings)


@dataclass(frozen=True, eq=False)
class ExpressionTraining:
    """Result of training the expression basis."""

    basis: NDArray
    """E (e, n, 3), orthogonal, falling in variance, metres per standard deviation of psi."""
    explained: NDArray[np.float64]
    """(e,) share of the displacements' energy that so many expressions explain."""
    frames: int
    """Frames used."""
    identities: int
    """Random heads used: none where the model has no shape basis to draw them from."""


def train_expressions(
    model: HeadModel, subjects: Sequence[TrainingSubject], settings: ExpressionTrainingSettings | None = None
) -> ExpressionTraining:
    """Expression basis shared by several subjects' expression takes.

    Each round finds poses with the expressions there are, takes them and the pose correctives off, and makes principal components
    (about the neutral head, which is psi = 0) of what is left. The last round adds `identities` heads drawn from the shape space
    of the model, deformed as the subjects were by deformation transfer: face and neck together, for a basis serves both. Each of
    them weighs as much as its subject. Where some subject was not seen displacements are continued smoothly. Raises `InputError`
    as `TrainingSubject.check`.
    """
    settings = settings or ExpressionTrainingSettings()
    for subject in subjects:
        subject.check(model, takes=("expression",))
    identities = _random_identities(model, settings)
    trained = model
    for k in range(settings.rounds):
        last = k == settings.rounds - 1
        found = _one_round(model, trained, subjects, settings, identities if last else identities[:0])
        trained = replace(model, expression_basis=found.basis, expression_names=())
    return found


def _one_round(
    model: HeadModel,
    trained: HeadModel,
    subjects: Sequence[TrainingSubject],
    settings: ExpressionTrainingSettings,
    identities: NDArray,
) -> ExpressionTraining:
    n, extension = len(model.vertices), SmoothExtension(model.vertices, model.triangles, seen_by_all(model, subjects))
    sketch = RowSketch(3 * n, 2 * settings.expressions)
    frames = 0
    for subject in subjects:
        transfers = [_transfer(model, subject, identity) for identity in identities]
        fitter = SequenceFitter(subject.personal(trained), settings.fit, subject.seen)
        wanted = _evenly(len(subject.expression), settings.transferred)
        # each transferred frame stands for all those between it and the next
        weight = np.sqrt(len(subject.expression) / len(wanted))
        for block in fitter.blocks(subject.expression):
            frames += len(block.frames)
            shown = extension(block.displacement)
            sketch.add(shown.reshape(len(block.frames), 3 * n))
            chosen = np.isin(block.frames, wanted)
            for transfer, identity in zip(transfers, identities, strict=True):
                moved = transfer(shown[chosen] + fitter.model.vertices) - identity
                sketch.add(weight * moved.reshape(len(moved), 3 * n))
    total = frames * (1 + len(identities))
    generic = model.expression_basis.reshape(len(model.expression_basis), 3 * n)
    sketch.add(np.sqrt(settings.generic_share * total) * generic)
    found = sketch.directions(settings.expressions)
    basis = found.vectors * (found.values / np.sqrt(total))[:, None]
    explained = np.cumsum(found.values**2) / max(found.energy, 1e-300)
    return ExpressionTraining(basis.reshape(-1, n, 3).astype(model.vertices.dtype), explained, frames, len(identities))


def _transfer(model: HeadModel, subject: TrainingSubject, identity: NDArray) -> DeformationTransfer:
    anchors = model.skinning_weights[:, 0] > _ANCHORED_SHARE
    return DeformationTransfer(subject.neutral, identity, model.triangles, anchors)


def _random_identities(model: HeadModel, settings: ExpressionTrainingSettings) -> NDArray:
    """(i, n, 3) heads drawn from the shape space; none where the model has no shape basis."""
    shapes = len(model.shape_basis)
    if not shapes or not settings.identities:
        return np.zeros((0, *model.vertices.shape), model.vertices.dtype)
    drawn = np.random.default_rng(settings.seed).normal(size=(settings.identities, shapes))
    return model.identity(settings.identity_spread * np.clip(drawn, -_MOST_SPREAD, _MOST_SPREAD))


def _evenly(count: int, wanted: int) -> NDArray[np.int64]:
    """At most so many of `count` frames, evenly spaced: they vary as all frames do."""
    return np.unique(np.linspace(0, count - 1, min(wanted, count)).round().astype(np.int64))
