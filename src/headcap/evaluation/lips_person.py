"""One person's test takes through all regressors that may be tested on them, and through the contour-based tracker."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.evaluation.lip_errors import BASE, CONTOUR, LipErrors, LipReference, compare_lips, layer_error
from headcap.evaluation.lip_sections import LipSections
from headcap.lips.artifact import LipRegressor
from headcap.lips.contour_tracking import expressive_shapes, lip_blendshapes, person_tracker
from headcap.lips.features import tracking_shapes
from headcap.lips.mesh_contours import MeshContours
from headcap.lips.people import LipPerson
from headcap.lips.takes import BORDER_WEIGHT, MouthSpace, SeenTake
from headcap.lips.training import RegressorPlan, as_seen_by, regressed

KNOWING = ("PS", "MS")
"""Regressors that put the person's true neutral head in (`SeenTake.known`)."""
_BASELINE_EXPRESSIONS = 40
"""Leading expressions of the head model, with the jaw's turns the base tracker's shapes of the contour-based baseline."""


@dataclass(frozen=True, eq=False)
class JudgedTake:
    """One take."""

    errors: LipErrors
    sequences: dict[str, NDArray[np.float32]]
    """(f, n, 3) in the camera's world by method, the base's and the truth's ("truth") among them."""


def judge_person(
    space: MouthSpace,
    person: LipPerson,
    regressors: Sequence[tuple[RegressorPlan, LipRegressor]],
    tested: Sequence[str],
    *,
    learnt_from: Sequence[str] = (),
) -> dict[str, JudgedTake]:
    """Errors of a person's tested takes by name: base tracker, each regressor, the contour-based tracker.

    The contour-based tracker has the person's own lip blendshapes, from the takes `learnt_from`; without any it is left out, for
    nobody has them of a stranger. GR comes with and without contours as constraints. Frames without an answer stay NaN.
    """
    sequences: dict[str, dict[str, NDArray]] = {name: {} for name in tested}
    layers: dict[str, dict[str, NDArray]] = {name: {} for name in tested}
    for plan, regressor in regressors:
        seen = as_seen_by(plan, person)
        for name, parameters in regressed(regressor, seen).items():
            if name not in sequences:
                continue
            take = person.takes[name]
            true = seen[name].parameters(take.neutral, take.true_meshes())
            sequences[name][plan.method] = seen[name].corrected(parameters, identity=regressor.identity).astype(np.float32)
            # of expression alone, which is what features tell: the constant part is in nobody's true layer
            layers[name][plan.method] = layer_error(parameters - regressor.constant, true)
            if plan.method == "GR":
                held = seen[name].corrected(parameters, BORDER_WEIGHT, regressor.identity)
                sequences[name]["GR reprojected"] = held.astype(np.float32)
    if learnt_from:
        for name in tested:
            sequences[name][CONTOUR] = _contour_tracked(space, person, name, learnt_from)
    return {name: _judged(space, person, name, sequences[name], layers[name]) for name in tested}


def _judged(
    space: MouthSpace, person: LipPerson, name: str, corrected: Mapping[str, NDArray], layers: Mapping[str, NDArray]
) -> JudgedTake:
    take = person.takes[name]
    seen, truth = take.seen, take.true_meshes()
    reference = LipReference(space.mouth, _sections(space), seen.neutral, take.neutral)
    sequences = {BASE: seen.base.world(seen.base.meshes).astype(np.float32)} | dict(corrected)
    errors = compare_lips(
        reference,
        truth,
        sequences,
        take.time_s,
        person=person.name,
        take=name,
        layer_errors=layers,
        knowing=[method for method in corrected if method.split()[0] in KNOWING],
    )
    return JudgedTake(errors, sequences | {"truth": truth})


def _sections(space: MouthSpace) -> LipSections:
    return LipSections.of(np.asarray(space.model.vertices, float), space.mouth, space.model.regions)


def _contour_tracked(space: MouthSpace, person: LipPerson, name: str, learnt_from: Sequence[str]) -> NDArray[np.float32]:
    """(f, n, 3) of the baseline, in the world; NaN without contours."""
    seen: SeenTake = person.takes[name].seen
    takes = [person.takes[other].true_meshes() for other in learnt_from]
    lips = lip_blendshapes(expressive_shapes(takes, person.neutral, space.mouth), person.neutral, seen.neutral, space.mouth)
    shapes = tracking_shapes(space.model)
    base = np.concatenate([shapes[:_BASELINE_EXPRESSIONS], shapes[-3:]])
    see = MeshContours.of(np.asarray(space.model.vertices, float), space.mouth, space.model.regions)
    tracker = person_tracker(base, lips, see, seen.camera)
    out = np.full(seen.base.meshes.shape, np.nan)
    for frame, fit in enumerate(tracker.track(seen.base, seen.contours)):
        if fit is not None:
            out[frame] = fit.mesh
    return seen.base.world(out).astype(np.float32)
