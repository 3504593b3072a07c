"""Quasi-eigen faces of sculpted shapes on performances whose true shapes are known (quasi-eigen paper, section 5.5).

ICT-FaceKit's 53 expressions as several sculptors would miss them, against the ICT rig's takes (true meshes; a turning head pulls
at the chin, which puts some of the motion outside the true shapes' span), an animator's speech on mouth, jaw and cheeks (inside
that span exactly, with a signal for each shape), both one after the other, and the speech as it was, left and right alike.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from _expression_takes import MIRRORED, RIG_TAKES, SIGNALS, KnownFace, animated, animator_weights, known_face, rig_take, thinned
from run import measure, write

from headcap.evaluation.expressions import compare_bases, reproduction
from headcap.expressions import ExpressionBasis, Performance
from headcap.expressions.performance import joined
from headcap.expressions.principal import eigenfaces
from headcap.expressions.projection import quasi_eigen_faces
from headcap.expressions.quasi_eigen import QuasiEigenSettings, convert_basis
from headcap.synthetic.sculptor import SculptorSettings, sculpt

DATA = Path(os.environ.get("HEADCAP_TEST_DATA", "../shared/data"))
SEEDS, STRENGTHS = 5, (0.5, 1.0, 1.5)
COVERAGES = (0.99, 0.995, 0.999, 0.9999)
AS_CHOSEN = QuasiEigenSettings(augment=False, rest_ratio=None)
"""Expression takes of a rig need not show the face at rest."""
STEP, THIN = 10, 3
"""Every tenth frame of the animator's nine minutes, every third vertex: shapes are smooth, and the figures do not move."""
RANGED = (
    "alpha_hand_pct", "alpha_pca_pct", "alpha_qe_pct", "qe_over_pca", "qe_chosen_over_pca", "hand_over_qe",
    "displacement_hand_pct", "displacement_pca_pct", "displacement_qe_pct", "median_correlation", "own_closest_share",
    "not_exercised", "not_told_apart", "missing_axes", "mean_outside",
)  # fmt: skip


def run(out_path: Path) -> None:
    """Measure and write; without the data say so and measure nothing."""
    missing = [str(DATA / part) for part in ("ict_head", "ict_rig", "speech") if not (DATA / part).exists()]
    if missing:
        write(out_path, ours={"name": f"not measured, for want of {' and '.join(missing)}", "seconds": 0.0, "cpu_seconds": 0.0})
        return
    figures: dict = {}
    took = measure(lambda: figures.update(measure_data()))
    write(out_path, ours={"name": "bases of 53 sculpted shapes made and judged", **took}, figures=figures)


def measure_data(data: Path = DATA) -> dict[str, object]:
    """By performance least and largest figures over sculptors, at several coverages and strengths; who was mistaken for whom."""
    face = known_face(data)
    hands = {strength: [sculpt(face.basis, _scaled(strength), seed) for seed in range(SEEDS)] for strength in STRENGTHS}
    cases, found = performances(face, data), {}
    for case, performance in cases.items():
        thin, shapes = thinned(performance, face.basis, THIN)
        found[f"{case}, motion outside the true shapes, %"] = reproduction(thin, shapes).displacement_pct
        found[f"{case}, as convert_basis chooses"] = _judged(performance, hands[1.0])
        for coverage in COVERAGES:
            found[f"{case}, coverage {coverage}"] = _judged(performance, hands[1.0], coverage)
        for strength in STRENGTHS:
            if strength != 1.0:
                found[f"{case}, strength {strength}"] = _judged(performance, hands[strength], COVERAGES[1])
    return found


def performances(face: KnownFace, data: Path, step: int = STEP) -> dict[str, Performance]:
    """By name: the rig's takes, the animator's speech, both, and the speech with both sides alike."""
    rig = joined([rig_take(face, name) for name in RIG_TAKES])
    names = face.basis.names
    speech = animated(face, *animator_weights(data, names, SIGNALS, step), "speech")
    mirrored = animated(face, *animator_weights(data, names, MIRRORED, step), "speech, both sides alike")
    return {"rig": rig, "speech": speech, "rig and speech": joined([rig, speech]), "mirrored speech": mirrored}


def _judged(performance: Performance, hands: list[ExpressionBasis], coverage: float | None = None) -> dict[str, object]:
    """With as many axes as cover so much and none to the neutral face, as the paper has it; else as the settings' defaults do."""
    thin, _ = thinned(performance, hands[0], THIN)
    shapes = [thinned(performance, hand, THIN)[1] for hand in hands]
    if coverage is None:
        faces = [convert_basis(thin, each, AS_CHOSEN) for each in shapes]
    else:
        axes = eigenfaces(thin, coverage=coverage)
        faces = [quasi_eigen_faces(each, axes, augment=False) for each in shapes]
    made = [compare_bases(thin, each) for each in faces]
    values = {name: [one.figures()[f"quasi_eigen.{name}"] for one in made] for name in RANGED}
    told_apart = {shape.name for one in made for shape in one.mistaken if shape.name not in one.not_told_apart}
    return {
        "frames": len(performance),
        "axes": sorted({len(each.hyperplane) for each in faces}),
        **{name: [float(np.min(value)), float(np.max(value))] for name, value in values.items()},
        "not_exercised_names": sorted(set.union(*(set(one.not_exercised) for one in made))),
        "not_told_apart_names": sorted(set.union(*(set(one.not_told_apart) for one in made))),
        "mistaken_though_told_apart": sorted(told_apart),
        "mistaken": sorted({f"{shape.name} for {shape.closest}" for one in made for shape in one.mistaken}),
    }


def _scaled(strength: float) -> SculptorSettings:
    return SculptorSettings(**{name: strength * value for name, value in SculptorSettings().model_dump().items()})
