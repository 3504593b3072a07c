"""The page of a study's neck: offline and whole, the paper's rows beside ours, pictures that show what they say."""

import re
from dataclasses import replace

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.evaluation.neck import LarynxCurve
from headcap.evaluation.neck_study import NeckStudy, RegressorRow, StudySubject
from headcap.evaluation.settings import EvaluateSettings
from headcap.geometry.transforms import from_vector
from headcap.heads import procedural_model
from headcap.neck import NeckModel, NeckPerson, SpeechFit, build_chart, larynx_map
from headcap.neck.animation.curves import CoefficientCurves
from headcap.neck.animation.swallowing import swallow
from headcap.neck.fits import NeckFits, TakeFit
from headcap.report.study import write_study_report
from headcap.report.study_figures import near_neutral, weights_when_neutral
from headcap.report.study_inputs import Animation, StudyInputs
from headcap.report.study_pictures import animation_columns, key_frames, swallow_columns, throat_camera
from headcap.speech import SpeechCoefficients
from headcap.synthetic.mesh_takes import mesh_subject

FRAMES = 60
CLOCK = np.arange(FRAMES) / 30


@pytest.fixture(scope="module")
def model() -> NeckModel:
    """One person and one speech blendshape, a bulge of the throat."""
    head = procedural_model(0, 3)
    empty = larynx_map(head, build_chart(head), np.array([0.0, 0.0, 1.0]))
    person = NeckPerson.of("anna", mesh_subject(1).neutral_m, head.triangles, empty)
    away = head.vertices - head.vertices[head.regions["larynx"]].mean(axis=0)
    bulge = np.exp(-0.5 * (away**2).sum(axis=1) / 0.04**2)[:, None] * np.array([0.0, 0.0, 1.0])
    return NeckModel(replace(head, speech_basis=bulge[None].astype(np.float32)), (person,))


def take(name: str, kind: str, **errors_mm: float) -> TakeFit:
    """Face and larynx move but for the first half second; the head stands in a room."""
    moving = (CLOCK > 0.5) * np.sin(7 * CLOCK) ** 2
    speech = SpeechFit(0.005 * np.sin(5 * CLOCK), 1 - 0.1 * np.sin(5 * CLOCK), (1e-3 + 4e-3 * moving)[:, None])
    theta = np.zeros((FRAMES, 2, 3))
    theta[:, 1, 0] = 0.2 * moving
    placed = np.array([from_vector(np.array([0.1, 0.2, 0.0, 0.01 * k, 1.2, -0.4])) for k in range(FRAMES)])
    psi = np.outer(moving, [1.0, -0.5, 0.2])
    errors = {stage: error * (1 + 0.1 * np.sin(CLOCK)) for stage, error in errors_mm.items()}
    return TakeFit(name, kind, CLOCK, speech, theta, psi, placed, errors)


@pytest.fixture(scope="module")
def people() -> tuple[NeckFits, ...]:
    spoken = {"base": 0.5, "expression": 0.25, "full": 0.1, "without_larynx": 0.13, "without_speech": 0.2}
    turn, talk = take("turn", "pose", base=2.0, pose=0.5), take("talk", "speech", **spoken)
    poor = take("talk", "speech", **(spoken | {"without_larynx": 0.09}))
    return NeckFits("anna", (turn, talk), False), NeckFits("ben", (turn, poor), True)


@pytest.fixture(scope="module")
def inputs(model, people) -> StudyInputs:
    truth = {"talk": LarynxCurve(CLOCK, np.sin(5 * CLOCK))}
    rows = [
        RegressorRow("anna", "user", feature_set, 240, 60, 2.0, 1.5, 0.01, 2.5, 1.25, 0.02) for feature_set in ("pooled", "paper")
    ]
    study = NeckStudy.of("demo", [StudySubject(people[0], True, truth), StudySubject(people[1], False)], rows)
    figures = tuple(study.figures(EvaluateSettings()))
    return StudyInputs(study, model, people, figures, (animation(model, people[0].takes[1]),), groups={"ben": "male"})


def animation(model: NeckModel, fit: TakeFit) -> Animation:
    """Of a voice that hears everything but the larynx."""
    person = model.people[0]
    truth = CoefficientCurves.of_take(fit, model.version, person.name)
    still = Animation("talk", "user", person, truth)
    return Animation.of_voice(
        "talk", "user", model, person, fit, SpeechCoefficients(fit.speech.phi), still.meshes(model, np.arange(FRAMES))
    )


@pytest.fixture(scope="module")
def page(inputs, tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("study") / "study.html"
    write_study_report(inputs, path)
    return path.read_text()


def test_the_page_is_offline_and_whole(page):
    assert not re.search(r"https?:|<script|<link|@import|url\(", page)
    assert "default-src 'none'" in page
    for section in ("subjects", "drops", "ablation", "larynx", "voices", "curves", "animation", "made"):
        assert f'id="{section}"' in page
        assert f'href="#{section}"' in page
    for number in (7, 8, 9, 11, 14):
        assert f"Figure {number}:" in page
    assert len(page) < 4e6


def test_who_took_part_and_how_is_told(page):
    rows = re.findall(
        r'<tr><td class="name">(\w+)</td><td class="tight">([\w ]+)</td><td class="tight">(\w+)</td><td>(\w*)', page
    )
    assert rows == [("anna", "trained on", "recordings", ""), ("ben", "held out", "meshes", "male")]
    assert "1 pose, 1 speech" in page


def test_our_rows_stand_before_the_papers(page):
    drops = page[page.index('id="drops"') : page.index('id="ablation"')]
    assert drops.index("ben") < drops.index("anna") < drops.index("paper #1")
    assert "1.570" in drops
    voices = page[page.index('id="voices"') : page.index('id="curves"')]
    # the paper's feature set first, then ours; what is worse than the mean is marked
    assert voices.index("<td>paper</td>") < voices.index("<td>pooled</td>") < voices.index("paper, user #1")
    assert voices.count('class="mean worse"') == 2


def test_what_a_part_does_not_lower_is_shown_in_red(page):
    assert "does not rise" in page
    assert page.count('class="gate bad"') == 1
    assert "neck.larynx_part_mm" in page


def test_equal_inputs_give_equal_pages(inputs, page, tmp_path):
    write_study_report(inputs, tmp_path / "again.html")
    assert (tmp_path / "again.html").read_text() == page


def test_parts_that_were_not_made_are_left_out(inputs, people, tmp_path):
    silent = NeckFits("cleo", people[0].takes[:1], True)
    bare = StudyInputs(NeckStudy.of("bare", [StudySubject(silent, False)]), replace(inputs.model, people=()), (silent,))
    write_study_report(bare, tmp_path / "bare.html")
    told = (tmp_path / "bare.html").read_text()
    for section in ("ablation", "larynx", "voices", "animation"):
        assert f'id="{section}"' not in told
    assert "Figure 9" in told
    assert "Figure 7" not in told


def test_fits_of_other_people_are_refused(inputs, tmp_path):
    with pytest.raises(InputError, match="fits of ben, anna"):
        write_study_report(replace(inputs, fits=inputs.fits[::-1]), tmp_path / "wrong.html")
    assert not (tmp_path / "wrong.html").exists()


def test_an_animation_equal_to_the_truth_shows_no_difference(model, inputs):
    """Both are drawn with the trunk at rest, wherever the room had it."""
    shown = inputs.animations[0]
    same = replace(shown, curves=shown.fitted)
    height = throat_camera(model.head, shown.person.base, 80).height
    for column, other in zip(
        animation_columns(model, same, count=3, height=80), animation_columns(model, shown, count=3, height=80), strict=True
    ):
        truth, made = column.image[:height].astype(int), column.image[height + 4 : 2 * height + 4].astype(int)
        assert np.abs(truth - made).max() <= 1
        # without its larynx the animation differs, its truth does not
        assert np.array_equal(column.image[:height], other.image[:height])
    assert "fitted: " in other.told[-1]
    with pytest.raises(InputError, match="59 true meshes"):
        replace(shown, truth=shown.truth[:-1])


def test_key_frames_hold_the_extremes(inputs):
    curves = inputs.animations[0].fitted
    chosen = key_frames(curves, 6)
    assert (np.diff(chosen) > 0).all()
    tau = curves.curve("tau")
    assert np.ptp(tau[chosen]) > 0.9 * np.ptp(tau)
    still = CoefficientCurves(CLOCK, {"tau": np.zeros(FRAMES), "alpha": np.ones(FRAMES)})
    assert len(key_frames(still, 6)) == 1


def test_a_swallow_is_shown_at_its_top(model):
    columns = swallow_columns(model, model.people[0], swallow(30.0), count=5, height=60)
    heights = [float(re.search(r"tau ([+-][\d.]+)", column.told[1])[1]) for column in columns]
    assert max(heights) == pytest.approx(22, abs=0.2)
    assert heights[0] == heights[-1] == pytest.approx(0, abs=0.2)


def test_near_neutral_stretches_are_those_at_rest(people):
    talk = people[0].takes[1]
    stretches = near_neutral(talk)
    assert stretches[0][0] == 0
    inside = np.zeros(FRAMES, bool)
    for first, end in stretches:
        inside[first:end] = True
    assert inside[CLOCK <= 0.5].all()
    assert not inside[talk.theta[:, 1, 0] > 0.1].any()
    calm, elsewhere = weights_when_neutral(talk)
    assert calm < 0.6 * elsewhere
    lost = talk.placement.copy()
    lost[8] = np.nan
    assert all(not first <= 8 < end for first, end in near_neutral(replace(talk, placement=lost)))
