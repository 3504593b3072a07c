"""Training on takes out of the model's own class: the truth comes back; on what it cannot know it keeps what it had."""

from dataclasses import replace

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.heads import HeadCoefficients, HeadModel, procedural_model
from headcap.heads.skinning import pose_features
from headcap.neck import NeckModel
from headcap.neck.fits import NeckFits
from headcap.neck.fitting.compensation import FitSettings
from headcap.neck.fitting.person import fit_person
from headcap.neck.fitting.subject import fit_subject
from headcap.neck.subjects import NeckSubject, NeckTake
from headcap.neck.training.expression import ExpressionTrainingSettings, train_expressions
from headcap.neck.training.pose import PoseSolver, PoseSums, PoseTrainingSettings, train_pose
from headcap.neck.training.pose_expression import PoseExpressionSettings, train_pose_expression
from headcap.neck.training_subject import TrainingSubject

ROUGH = {"smooth_mm": 0.0}
NO_FRAMES = np.zeros((0, 12813, 3), np.float32)
EXPRESSIONS = 4


@pytest.fixture(scope="module")
def base() -> HeadModel:
    return procedural_model(8, 12)


@pytest.fixture(scope="module")
def truth(base) -> HeadModel:
    """Pose correctives and expressions of the neck, away from what tells the pose: nothing passes for another."""
    random = np.random.default_rng(8)
    bump = np.exp(-0.5 * ((base.vertices - base.vertices[base.landmarks["larynx"]]) ** 2).sum(axis=1) / 0.03**2)
    bump *= base.regions["neck"]
    bump *= base.skinning_weights.max(axis=1) < 0.85
    correctives = 0.02 * np.einsum("fi,v->fvi", random.normal(size=(18, 3)), bump)
    expressions = 0.006 * np.einsum("ei,v->evi", np.linalg.qr(random.normal(size=(3, 3)))[0], bump)
    mouth = base.expression_basis[:1]
    return replace(
        base, pose_basis=correctives.astype(np.float32), expression_basis=np.concatenate([expressions, mouth]).astype(np.float32)
    )


def subject(truth: HeadModel, seed: int, frames: int = 60) -> TrainingSubject:
    """A person's pose and expression take by the true model."""
    random = np.random.default_rng(seed)
    person = truth.personal(truth.identity(random.normal(size=8)))
    t = np.linspace(0, 1, frames)
    neck = 0.5 * np.sin(2 * np.pi * (t[:, None] * [2, 3, 1] + random.random(3)))
    jaw = np.stack([0.15 * (1 - np.cos(12 * t)), 0.05 * np.sin(15 * t), 0.03 * np.sin(9 * t)], axis=1)
    pose = person.evaluate(HeadCoefficients(pose=np.stack([neck, jaw], axis=1)))
    psi = random.normal(size=(frames, EXPRESSIONS))
    expression = person.evaluate(HeadCoefficients(expression=psi, pose=0.1 * np.stack([neck, jaw], axis=1)))
    return TrainingSubject(f"person {seed}", person.vertices, pose, expression)


@pytest.fixture(scope="module")
def subjects(truth) -> list[TrainingSubject]:
    return [subject(truth, seed) for seed in (1, 2)]


@pytest.fixture(scope="module")
def held_out(truth) -> TrainingSubject:
    return subject(truth, 7)


@pytest.fixture(scope="module")
def trained(base, subjects) -> HeadModel:
    settings = PoseExpressionSettings(
        pose=PoseTrainingSettings(**ROUGH), expression=ExpressionTrainingSettings(expressions=10, identities=2, transferred=10)
    )
    return train_pose_expression(base, subjects, settings)


def test_pose_correctives_are_recovered(base, truth, subjects):
    found = train_pose(base, subjects, PoseTrainingSettings(shrink=1e-7, **ROUGH))
    # what P makes of the poses that occurred; P itself is not unique where features go together
    region = truth.regions["neck"]
    pose = np.random.default_rng(0).uniform(-0.3, 0.3, (20, 2, 3)) * [[[1], [0.3]]]
    made, wanted = (
        replace(base, pose_basis=basis).rest(HeadCoefficients(pose=pose))[:, region] - base.vertices[region]
        for basis in (found.basis, truth.pose_basis)
    )
    assert np.sqrt(((made - wanted) ** 2).mean()) < 0.05 * np.sqrt((wanted**2).mean())
    assert found.residual_mm[-1] < 0.02
    assert found.frames == 120


def test_rounds_lower_the_objective_where_the_joint_is_misplaced(base, subjects):
    """A neck joint 15 mm too high misfits poses at first; correctives make up for it, poses follow."""
    regressor = base.joint_regressor.copy()
    regressor[0] += 0.015 / 0.3 * (base.regions["scalp"] / base.regions["scalp"].sum() - regressor[0])
    found = train_pose(replace(base, joint_regressor=regressor), subjects, PoseTrainingSettings(rounds=4, **ROUGH))
    assert len(found.objective) > 1
    assert (np.diff(found.objective) < 0).all()


def test_the_correctives_are_the_minimum_of_what_they_minimise(base, truth):
    """The decoupled, smoothed solve against the stationarity of the whole objective."""
    random = np.random.default_rng(4)
    settings = PoseTrainingSettings(shrink=1e-3, smooth_mm=8.0)
    theta = random.uniform(-0.4, 0.4, (30, 2, 3)) * [[[1], [0]]]
    displacement = np.tensordot(pose_features(theta), truth.pose_basis.astype(float), 1) + random.normal(0, 1e-4, (30, 1, 3))
    sums = PoseSums.of(len(base.vertices))
    sums.add(theta, displacement)
    before = replace(base, pose_basis=(0.1 * truth.pose_basis[::-1]).astype(np.float32))
    solver = PoseSolver(before, settings)
    change, left, penalty = solver(sums)

    def objective(p: np.ndarray) -> float:
        away = displacement - np.tensordot(pose_features(theta), before.pose_basis.astype(float) + p, 1)
        flat = p.reshape(18, -1, 3)
        return (away**2).sum() + 1e-3 * 30 * sum(float((field * (solver.prior @ field)).sum()) for field in flat)

    least = objective(change)
    assert least == pytest.approx(left + penalty, rel=1e-9)
    for _ in range(3):
        way = random.normal(size=change.shape) * np.abs(change).max()
        # stationary: up both ways by the same second-order amount
        up, down = objective(change + 1e-2 * way) - least, objective(change - 1e-2 * way) - least
        assert up == pytest.approx(down, rel=1e-6)
        assert up > 0


def test_a_joint_that_stays_still_keeps_its_correctives(truth, base):
    still = subject(truth, 3)
    person = still.personal(truth)
    neck = np.random.default_rng(2).uniform(-0.4, 0.4, (30, 3))
    take = person.evaluate(HeadCoefficients(pose=np.stack([neck, 0 * neck], axis=1)))
    known = replace(base, pose_basis=truth.pose_basis * np.repeat([0.0, 1.0], 9)[:, None, None].astype(np.float32))
    found = train_pose(known, [replace(still, pose=take)], PoseTrainingSettings(**ROUGH))
    assert (found.basis[9:] == truth.pose_basis[9:]).all()
    assert np.abs(found.basis[:9] - known.pose_basis[:9]).max() > 0.005


def test_more_shrinkage_means_smaller_correctives(base, subjects):
    sizes = [
        np.abs(train_pose(base, subjects[:1], PoseTrainingSettings(rounds=1, shrink=shrink, **ROUGH)).basis).sum()
        for shrink in (1e-6, 1e-3, 1.0)
    ]
    assert sizes[0] > sizes[1] > sizes[2]
    assert sizes[2] < 0.1 * sizes[0]


def test_expressions_are_orthogonal_ordered_and_span_the_truth(truth, subjects):
    settings = ExpressionTrainingSettings(expressions=30, identities=0, generic_share=0.0)
    start = replace(truth, expression_basis=procedural_model(8, 12).expression_basis)
    found = train_expressions(start, subjects, settings)
    flat = found.basis.reshape(len(found.basis), -1).astype(np.float64)
    gram = flat @ flat.T
    assert gram == pytest.approx(np.diag(np.diagonal(gram)), abs=1e-6 * gram[0, 0])
    assert (np.diff(np.diagonal(gram)) <= 0).all()
    # the truth has four directions; what else there is comes from poses found in single precision
    assert found.explained[EXPRESSIONS - 1] > 0.995
    wanted = truth.expression_basis.reshape(EXPRESSIONS, -1).astype(np.float64)
    directions = flat[:EXPRESSIONS] / np.linalg.norm(flat[:EXPRESSIONS], axis=1, keepdims=True)
    missed = wanted - wanted @ directions.T @ directions
    assert np.linalg.norm(missed) < 0.1 * np.linalg.norm(wanted)
    # unit coefficients: a basis vector is as large as its expression is spread
    assert np.trace(gram) == pytest.approx((wanted**2).sum(), rel=0.3)


def test_random_identities_are_seeded_and_add_no_foreign_expressions(truth, subjects):
    start = replace(truth, expression_basis=procedural_model(8, 12).expression_basis)
    settings = ExpressionTrainingSettings(expressions=20, rounds=1, identities=2, transferred=8, generic_share=0.0)
    first, again = (train_expressions(start, subjects[:1], settings) for _ in range(2))
    other = train_expressions(start, subjects[:1], settings.model_copy(update={"seed": 1}))
    assert np.array_equal(first.basis, again.basis)
    assert not np.array_equal(first.basis, other.basis)
    assert first.identities == 2
    # transferred expressions turn with each head's own skin: near the subject's directions, no longer the same
    assert first.explained[EXPRESSIONS - 1] > 0.9


def test_without_a_shape_space_nothing_is_transferred(base, subjects):
    bare = replace(base, shape_basis=base.shape_basis[:0])
    found = train_expressions(bare, subjects[:1], ExpressionTrainingSettings(expressions=5, rounds=1))
    assert found.identities == 0
    assert len(found.basis) == 5


@pytest.fixture(scope="module")
def fits(base, trained, neck, held_out) -> NeckFits:
    return fitted(base, trained, neck, held_out)


def fitted(base: HeadModel, trained: HeadModel, neck: NeckModel, person: TrainingSubject) -> NeckFits:
    """Pose and expression takes of somebody held out, with the layout of `neck` for a larynx."""
    takes = tuple(
        NeckTake(kind, kind, np.arange(len(meshes)) / 30, meshes)
        for kind, meshes in (("pose", person.pose), ("expression", person.expression))
        if len(meshes)
    )
    subject, model = NeckSubject(person.name, person.neutral, takes), replace(neck, head=trained)
    return fit_subject(model.with_person(fit_person(model, subject)), base, subject, held_out=True)


def test_a_held_out_person_gains(fits):
    drops = fits.figures()
    assert drops["neck.pose_error_drop_mm"] > 0.8 * fits.mean_error_mm("base", "pose") > 0.1
    assert drops["neck.expression_error_drop_mm"] > 0.5 * fits.mean_error_mm("base", "expression") > 0.1
    assert drops["neck.skipped_frames"] == 0


def test_frames_that_are_not_finite_are_left_out_of_training_and_counted(base, trained, neck, subjects, held_out, fits):
    holed = held_out.pose.copy()
    holed[[3, 30]] = np.nan
    less = fitted(base, trained, neck, replace(held_out, pose=holed, expression=NO_FRAMES))
    assert less.figures()["neck.skipped_frames"] == 2
    assert less.mean_error_mm("pose", "pose") == pytest.approx(fits.mean_error_mm("pose", "pose"), rel=0.2)
    longer = replace(subjects[0], pose=np.concatenate([subjects[0].pose, np.full_like(holed[:5], np.nan)]))
    found = train_pose(base, [longer], PoseTrainingSettings(rounds=1, **ROUGH))
    assert found.frames == len(subjects[0].pose)
    assert np.isfinite(found.basis).all()


def test_a_subject_may_serve_one_part_alone(base, subjects):
    settings = PoseExpressionSettings(
        pose=PoseTrainingSettings(**ROUGH), expression=ExpressionTrainingSettings(expressions=6, rounds=1, identities=0)
    )
    posed = train_pose_expression(base, [replace(subjects[0], expression=NO_FRAMES)], settings)
    assert (posed.expression_basis == base.expression_basis).all()
    assert posed.pose_basis.any()
    messages: list[str] = []
    expressive = train_pose_expression(base, [replace(subjects[0], pose=NO_FRAMES)], settings, progress=messages.append)
    assert not expressive.pose_basis.any()
    assert len(expressive.expression_basis) == 6
    assert len(messages) == 1


def test_refuses_one_frame_other_topologies_turned_heads_and_nothing(base, subjects):
    one = subjects[0]
    with pytest.raises(InputError, match="1 frames of pose"):
        train_pose(base, [replace(one, pose=one.pose[:1])])
    with pytest.raises(InputError, match="1 frames of expression"):
        train_expressions(base, [replace(one, expression=one.expression[:1])])
    with pytest.raises(InputError, match="neutral head of"):
        train_pose(base, [replace(one, neutral=one.neutral[:-1])])
    with pytest.raises(InputError, match="meshes"):
        train_pose(base, [replace(one, pose=one.pose[:, :-1])])
    with pytest.raises(InputError, match="turned by 90 degrees"):
        train_pose(base, [replace(one, neutral=one.neutral[:, [1, 0, 2]] * [1, -1, 1])])
    with pytest.raises(InputError, match="none of 60 meshes is finite"):
        train_pose(base, [replace(one, pose=np.full_like(one.pose, np.nan))])
    with pytest.raises(InputError, match="without pose and expression takes"):
        train_pose_expression(base, [replace(one, pose=NO_FRAMES, expression=NO_FRAMES)])
    with pytest.raises(InputError, match="no region tail"):
        train_expressions(base, [one], ExpressionTrainingSettings(fit=FitSettings(expression_region="tail")))


def test_what_was_not_seen_is_not_learnt_from(base, subjects):
    """A nape made up by a tracker, going with the head, spoils neither poses nor bases."""
    one = subjects[0]
    nape = base.regions["neck"] & (one.neutral[:, 2] < -0.02)
    pose, expression = one.pose.copy(), one.expression.copy()
    for meshes in (pose, expression):
        meshes[:, nape] = one.neutral[nape] + 0.3 * np.random.default_rng(9).normal(size=(len(meshes), 1, 3))
    spoilt = replace(one, pose=pose, expression=expression, seen=~nape)
    masked = replace(one, seen=~nape)
    settings = PoseTrainingSettings(rounds=1, **ROUGH)
    learnt, wanted = (train_pose(base, [who], settings).basis for who in (spoilt, masked))
    assert np.abs(learnt - wanted).max() < 1e-6
    settings = ExpressionTrainingSettings(expressions=5, rounds=1, identities=1, transferred=5)
    learnt, wanted = (train_expressions(base, [who], settings).basis for who in (spoilt, masked))
    assert np.abs(learnt - wanted).max() < 1e-6
    with pytest.raises(InputError, match="are seen"):
        train_pose(base, [replace(one, seen=base.regions["face"])])
    with pytest.raises(InputError, match="mask of seen vertices"):
        train_pose(base, [replace(one, seen=~nape[:-1])])
