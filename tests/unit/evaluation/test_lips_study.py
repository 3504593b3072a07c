"""Lip errors: nothing but the mouth's own shape counts, and a study's intervals hold what they promise."""

import numpy as np
import pytest

from headcap.artifacts import ArtifactError, save_json
from headcap.errors import InputError
from headcap.evaluation.lip_errors import LipErrors, LipReference, compare_lips, layer_error
from headcap.evaluation.lip_sections import LipSections
from headcap.evaluation.lips_study import ALL, LipStudy, LipStudySettings, interval
from headcap.evaluation.settings import EvaluateSettings
from headcap.geometry.transforms import from_vector, transform
from headcap.heads import base_head
from headcap.lips.mouth import find_mouth

SIZE = 1.25
"""Of the true head beside the base's."""


@pytest.fixture(scope="module")
def reference():
    head = base_head()
    mouth = find_mouth(head.vertices, head.triangles, head.regions)
    sections = LipSections.of(head.vertices, mouth, head.regions)
    return LipReference(mouth, sections, head.vertices, SIZE * head.vertices)


def lip(side):
    regions = base_head().regions
    return regions[f"lips_{side}"] | regions[f"lips_inner_{side}"]


def moved(meshes, rng):
    """Each mesh somewhere else."""
    return np.stack([transform(from_vector(0.3 * rng.normal(size=6)), mesh) for mesh in meshes])


def shifted(reference, shift_m):
    """The base's neutral head with the mouth's mask elsewhere."""
    mesh = reference.base_neutral.copy()
    mesh[reference.mouth.vertices] += shift_m
    return mesh


def compared(reference, truth, **sequences):
    return compare_lips(reference, truth, sequences, np.arange(len(truth)) / 25, person="anna", take="smile")


def test_rigid_motion_and_size_are_no_error_and_a_shift_is_its_length_in_the_true_persons_millimetres(reference, rng):
    still, away = reference.base_neutral, shifted(reference, [1e-3, 2e-3, -2e-3])
    truth = moved(SIZE * np.stack([still, still, away]), rng)
    errors = compared(reference, truth, GR=moved(np.stack([still, away, away]), rng), base=moved(np.stack([still] * 3), rng))
    assert errors.methods == ("base", "GR")
    assert errors.scale == pytest.approx(1 / SIZE, rel=1e-9)
    # rounding of metres by some dozen operations, in millimetres
    np.testing.assert_allclose(errors.error_mm, [[0, 0, 3 * SIZE], [0, 3 * SIZE, 0]], atol=1e-9)
    np.testing.assert_allclose(errors.square_mm2, errors.error_mm**2, atol=1e-9)
    # the mouth as a whole is elsewhere, its shape is right
    np.testing.assert_allclose(errors.shape_error_mm, 0, atol=1e-9)
    np.testing.assert_allclose(errors.vertex_error_mm[0], SIZE, atol=1e-9)
    np.testing.assert_allclose(errors.gap_mm, errors.gap_mm[0, 0], atol=1e-9)
    np.testing.assert_allclose(errors.roll_error_deg, 0, atol=1e-7)


def test_frames_without_an_answer_are_counted_and_score_nothing(reference, rng):
    still = np.stack([reference.base_neutral] * 4)
    away = np.stack([shifted(reference, [0, 0, k * 1e-3]) for k in range(4)])
    truth, lost = SIZE * still, away.copy()
    truth[0], lost[1] = np.nan, np.nan
    errors = compared(reference, truth, base=away, GR=lost, PS=np.full_like(away, np.nan))
    assert errors.truth_known.tolist() == [False, True, True, True]
    assert errors.common.tolist() == [False, False, True, True]
    assert [errors.unanswered(method) for method in errors.methods] == [0, 1, 3]
    np.testing.assert_allclose(errors.vertex_error_mm[1], 2.5 * SIZE, atol=1e-9)
    assert np.isnan(errors.vertex_error_mm[2]).all()
    study = LipStudy.of("s", [errors])
    # over the same two frames, though the base answered a third
    assert study.row("base").error_mm.value == pytest.approx(2.5 * SIZE)
    assert (study.row("GR").frames, study.row("GR").unanswered) == (2, 1)
    assert study.row("PS") is None
    assert study.row("GR").error_mm.low is None  # one take tells of no other


def test_an_opening_is_the_gap(reference):
    open_mouth = reference.base_neutral.copy()
    open_mouth[lip("lower") & ~lip("upper")] -= [0, 6e-3, 0]
    sections = reference.sections
    before = sections.upper_rim.of(reference.base_neutral) - sections.lower_rim.of(reference.base_neutral)
    expected = np.linalg.norm(before + np.array([0, 6e-3, 0]), axis=1)
    np.testing.assert_allclose(sections.gap(open_mouth), expected, atol=1e-12)
    assert np.linalg.norm(before, axis=1).max() < 2e-3  # the base head's lips all but touch


@pytest.mark.parametrize(("side", "sign"), [("upper", 1.0), ("lower", -1.0)])
def test_a_lip_turned_about_the_mouths_axis_is_rolled_by_that_angle(reference, side, sign):
    still = reference.base_neutral
    rolled = still.copy()
    middle = still[lip(side)].mean(axis=0)
    # the rim of the upper lip, which points down, comes forward by a negative turn about x
    turn = from_vector(np.array([-sign * np.radians(25.0), 0, 0, 0, 0, 0]))
    rolled[lip(side)] = transform(turn, still[lip(side)] - middle) + middle
    change = np.degrees(reference.sections.roll(rolled) - reference.sections.roll(still))
    own, other = (0, 1) if side == "upper" else (1, 0)
    np.testing.assert_allclose(change[own], 25.0, atol=1e-9)
    np.testing.assert_allclose(change[other], 0.0, atol=1e-9)


def test_sections_lie_where_lips_are(reference):
    still, sections = reference.base_neutral, reference.sections
    parts = (sections.upper_border, sections.upper_rim, sections.lower_rim, sections.lower_border)
    heights = np.stack([part.of(still)[:, 1] for part in parts])
    # a lip is millimetres thick, and rims of a shut mouth may overlap by a little
    assert (heights[0] - heights[1] > 3e-3).all()
    assert (heights[2] - heights[3] > 3e-3).all()
    assert len({tuple(np.round(part.of(still)[:, 0], 12)) for part in parts}) == 1


def test_bad_input_is_told(reference):
    still = np.stack([reference.base_neutral] * 2)
    with pytest.raises(InputError, match="base"):
        compared(reference, still, GR=still)
    with pytest.raises(InputError, match="2 frames each"):
        compared(reference, still, base=still, GR=iter(still[:1]))
    with pytest.raises(InputError, match="2 frames each"):
        compared(reference, still, base=iter([*still, still[0]]))
    with pytest.raises(InputError, match="topology"):
        compared(reference, still, base=still[:, :100])
    with pytest.raises(InputError, match="layer errors"):
        compare_lips(reference, still, {"base": still}, np.arange(2), person="a", take="b", layer_errors={"base": np.zeros(3)})
    with pytest.raises(InputError, match="one at least"):
        LipStudy.of("s", [])
    head, nobody = base_head(), np.zeros(len(still[0]), bool)
    bare = head.regions | {"lips_lower": nobody, "lips_inner_lower": nobody}
    with pytest.raises(InputError, match="without a lip"):
        LipSections.of(head.vertices, reference.mouth, bare)


def errors_of(person, take, seed, base=4.0, frames=50, **drops):
    """A take whose frames' errors vary; of each method a share of the base's."""
    rng = np.random.default_rng(seed)
    own = base * rng.uniform(0.7, 1.3) * rng.uniform(0.8, 1.2, frames)
    methods = ("base", *(name.replace("_", " ") for name in drops))
    error = np.stack([own, *((1 - drop) * own for drop in drops.values())])
    curves, m = np.zeros((len(methods) + 1, frames)), len(methods)
    layer = np.full((m, frames), np.nan)
    layer[1:] = 0.1
    return LipErrors(
        person=person,
        take=take,
        methods=methods,
        time_s=np.arange(frames) / 25,
        truth_known=np.ones(frames, bool),
        vertices=np.arange(3),
        error_mm=error,
        square_mm2=error**2 + 0.25,
        shape_error_mm=0.5 * error,
        vertex_error_mm=np.ones((m, 3)),
        gap_mm=curves,
        roll_deg=np.zeros((m + 1, frames, 2)),
        roll_error_deg=curves[:-1],
        layer_error=layer,
        scale=1.0,
    )


@pytest.fixture
def study():
    takes = [errors_of(person, str(k), k, GR=0.25, GR_affine=0.2, PS=0.5) for k, person in enumerate("aabbbb")]
    return LipStudy.of("lips", takes)


def test_drops_are_shares_of_the_bases_error_whatever_takes_are_drawn(study):
    row = study.row("GR")
    assert (row.takes, row.frames, row.unanswered) == (6, 300, 0)
    for value in (row.drop_pct.value, row.drop_pct.low, row.drop_pct.high):
        assert value == pytest.approx(25.0)
    assert row.error_mm.value == pytest.approx(0.75 * row.base_error_mm)
    assert row.error_mm.low < row.error_mm.value < row.error_mm.high
    assert row.shape_error_mm.value == pytest.approx(0.5 * row.error_mm.value)
    assert row.shape_drop_pct.low == pytest.approx(25.0)
    assert row.error_cm[0] == pytest.approx(0.1 * row.error_mm.value)
    assert [row.method for row in study.table_1()] == ["base", "PS", "GR"]
    assert list(study.by_inputs("GR")) == ["combined", "affine"]
    assert study.by_inputs("GR")["affine"].layer_error.value == pytest.approx(0.1)
    gain = next(row for row in study.differences if (row.scope, row.other) == (ALL, "GR affine"))
    assert gain.gain_mm.value == pytest.approx(0.05 * row.base_error_mm)
    assert gain.certain


def test_the_deviation_is_over_vertices_and_frames():
    take = errors_of("a", "1", 3, GR=0.5)
    row = LipStudy.of("s", [take]).row("base")
    # 0.25 mm2 within frames, as `errors_of` makes it, and what frames differ by
    assert row.deviation_mm == pytest.approx(np.sqrt(take.error_mm[0].var() + 0.25))


def test_intervals_hold_the_truth_as_often_as_they_promise():
    """Of means over 40 takes; the share over 300 studies errs by sqrt(0.05 0.95 / 300) = 1.3 %, the bootstrap by 1 / takes."""
    rng, settings, held = np.random.default_rng(4), LipStudySettings(samples=400), 0
    for _ in range(300):
        values = rng.normal(3.0, 1.0, 40)
        low, high = interval(np.stack([np.ones(40), values], axis=1), lambda sums: sums[:, 1] / sums[:, 0], settings)
        held += low <= 3.0 <= high
    assert abs(held / 300 - 0.95) < 3 * 0.013 + 1 / 40


def test_figures_are_held_to_limits_by_scope(study):
    figures = {(figure.session, figure.name): figure for figure in study.figures(EvaluateSettings())}
    assert figures["lips", "lips.gr_error_drop_pct"].ok
    assert figures["b", "lips.ps_error_drop_pct"].value == pytest.approx(50.0)
    assert figures["lips", "lips.error_mm"].value == study.row("GR").error_mm.value
    strict = study.figures(EvaluateSettings(), {"a": {"lips.gr_error_drop_pct": 26.0}})
    assert [figure.session for figure in strict if figure.ok is False] == ["a"]


def test_files_come_back(study, tmp_path):
    take = errors_of("a", "1", 1, GR=0.5)
    take.save(tmp_path / "take.npz")
    again = LipErrors.load(tmp_path / "take.npz")
    assert (again.person, again.take, again.methods, again.scale) == ("a", "1", ("base", "GR"), 1.0)
    np.testing.assert_array_equal(again.error_mm, take.error_mm)
    study.save(tmp_path / "study.json")
    assert LipStudy.load(tmp_path / "study.json") == study
    save_json(tmp_path / "broken.json", "lip_study", 1, {"name": "x", "confidence": 0.9, "rows": [{}], "differences": []})
    with pytest.raises(ArtifactError, match="make it again"):
        LipStudy.load(tmp_path / "broken.json")


def test_layer_errors_are_rms_of_the_nine_numbers(rng):
    true = rng.normal(size=(3, 7, 9))
    found = layer_error(true + 0.2, true)
    np.testing.assert_allclose(found, 0.2)
    lost = true.copy()
    lost[1] = np.nan
    assert np.isnan(layer_error(lost, true)).tolist() == [False, True, False]
