"""A person's takes stage by stage: errors are distances of posed meshes, each part lowers them, bad frames are counted."""

from dataclasses import replace

import numpy as np
import pytest

from headcap.artifacts import ArtifactError, save_arrays
from headcap.errors import InputError
from headcap.geometry.transforms import from_vector
from headcap.heads import HeadCoefficients
from headcap.neck import FitSettings, NeckModel
from headcap.neck.fits import NeckFits
from headcap.neck.fitting.subject import fit_subject
from headcap.neck.subjects import JoinedMeshes, NeckSubject, NeckTake

FRAMES = 24
LOST = (3, 17)


@pytest.fixture(scope="module")
def trained(neck) -> NeckModel:
    """With pose correctives that swell the throat by 3 mm per unit of the head's rotation matrix, and speech that stays small."""
    head, rng = neck.head, np.random.default_rng(0)
    away = head.vertices - head.vertices[head.regions["larynx"]].mean(axis=0)
    bulge = np.exp(-0.5 * (away**2).sum(axis=1) / 0.05**2)[:, None]
    swelling = (bulge * rng.normal(0, 0.003, (len(head.pose_basis), 1, 3))).astype(np.float32)
    swelling[9:] = 0.0
    return replace(neck, head=replace(head, pose_basis=swelling))


@pytest.fixture(scope="module")
def base(trained):
    """The same head without pose correctives."""
    return replace(trained.head, pose_basis=np.zeros_like(trained.head.pose_basis), speech_basis=trained.head.speech_basis[:0])


@pytest.fixture(scope="module")
def subject(trained) -> NeckSubject:
    """Somebody, whose meshes are the model's own in float32: what is left of them is rounding."""
    person, clock = trained.people[0], np.arange(FRAMES) / 30
    neutral = trained.evaluate(person, HeadCoefficients(), 0.0, 1.0).astype(float)
    turn = np.zeros((FRAMES, 2, 3))
    turn[:, 0] = np.array([0.2, 0.4, 0.1]) * np.sin(np.outer(2.1 * clock + 0.3, [1.0, 1.7, 0.6]))
    placed = np.array([from_vector(np.array([0.1, 0.02 * k, 0.0, 0.3, 1.2, -0.4])) for k in range(FRAMES)])
    tau = 0.006 * np.sin(9 * clock)
    phi = 1e-3 * np.array([2.0, 1.0, 1.5]) * np.sin(np.outer(clock, [5.0, 8.0, 11.0]))
    psi = 0.6 * np.sin(np.outer(clock, [4.0, 7.0, 9.0]))
    told = {
        "turn": ("pose", HeadCoefficients(pose=turn, placement=placed), 0.0, 1.0),
        "face": ("expression", HeadCoefficients(expression=psi, placement=placed), 0.0, 1.0),
        "talk": ("speech", HeadCoefficients(pose=0.3 * turn, speech=phi, placement=placed), tau, 1 - 10 * tau),
    }
    takes = []
    for name, (kind, coefficients, slide, scale) in told.items():
        meshes = trained.evaluate(person, coefficients, slide, scale)
        takes.append(NeckTake(name, kind, clock, meshes))
    return NeckSubject("somebody", neutral, tuple(takes))


@pytest.fixture(scope="module")
def fits(trained, base, subject) -> NeckFits:
    return fit_subject(trained, base, subject, held_out=True)


def test_each_kind_of_take_shows_its_stages(fits):
    stages = {take.kind: set(take.errors_mm) for take in fits.takes}
    assert stages["pose"] == {"base", "pose"}
    assert stages["expression"] == {"base", "expression"}
    assert stages["speech"] == {"base", "expression", "full", "without_larynx", "without_speech"}
    assert fits.held_out
    # a pose take has no expression, and the larynx is fitted to it all the same
    assert not fits.takes[0].psi.any()
    assert fits.takes[0].speech.known.all()


@pytest.mark.parametrize(("name", "stage"), [("turn", "pose"), ("face", "expression"), ("talk", "full"), ("talk", "expression")])
def test_errors_are_distances_between_posed_meshes(trained, subject, fits, name, stage):
    """Evaluating eq. 4 and 5 with the coefficients of the fit gives the distances that were taken at rest and turned."""
    fit = next(take for take in fits.takes if take.take == name)
    take = next(take for take in subject.takes if take.name == name)
    posed = HeadCoefficients(expression=fit.psi, pose=fit.theta, placement=fit.placement)
    if stage == "full":
        speech = replace(posed, speech=fit.speech.phi)
        meshes = trained.evaluate(trained.people[0], speech, fit.speech.tau_m, fit.speech.alpha)
    else:
        meshes = subject.personal(trained.head).evaluate(posed)
    judged = trained.head.regions["neck"]
    expected = 1e3 * np.linalg.norm((meshes - take.meshes)[:, judged], axis=2).mean(axis=1)
    # float32 metres round to 1e-4 mm at a metre and a half from the origin
    assert fit.errors_mm[stage] == pytest.approx(expected, abs=1e-3)


def test_the_models_own_meshes_are_fitted_whole(fits):
    """Poses come from vertices that speech stirs a little, with 1 mm assumed of noise: a tenth of a millimetre is left."""
    for take in fits.takes:
        assert np.median(take.error_mm) < 0.1
    figures = fits.figures()
    assert figures["neck.pose_error_drop_mm"] > 0.1
    assert figures["neck.speech_error_drop_mm"] > 0.3


def test_each_part_switched_off_raises_the_error(fits):
    figures = fits.figures()
    assert figures["neck.larynx_part_mm"] > 0.01
    assert figures["neck.speech_part_mm"] > 0.1
    talk = fits.takes[2].errors_mm
    assert talk["full"].mean() < min(talk["without_larynx"].mean(), talk["without_speech"].mean())


def test_figures_are_means_over_the_frames_of_their_kind_of_take(fits):
    figures, talk, turn = fits.figures(), fits.takes[2], fits.takes[0]
    assert figures["neck.error_mm"] == pytest.approx(talk.errors_mm["full"].mean())
    assert figures["neck.pose_error_drop_mm"] == pytest.approx((turn.errors_mm["base"] - turn.errors_mm["pose"]).mean())
    silent = NeckFits("somebody", fits.takes[:2], True).figures()
    assert {"neck.pose_error_drop_mm", "neck.expression_error_drop_mm"} < set(silent)
    assert not {"neck.speech_error_drop_mm", "neck.error_mm", "neck.slide_range_mm"} & set(silent)


def test_frames_that_are_not_finite_are_left_out_and_counted(trained, base, subject, fits):
    talk = subject.takes[2]
    meshes = talk.meshes.copy()
    meshes[list(LOST), 5] = np.nan
    found = fit_subject(trained, base, replace(subject, takes=(replace(talk, meshes=meshes),)), held_out=True)
    (take,) = found.takes
    assert found.figures()["neck.skipped_frames"] == len(LOST)
    for values in (*take.errors_mm.values(), take.speech.tau_m, take.speech.phi[:, 0], take.theta[:, 0, 0], take.psi[:, 0]):
        assert np.flatnonzero(np.isnan(values)).tolist() == list(LOST)
    kept = np.isfinite(take.error_mm)
    # each frame's search begins at the last one's pose and ends near, not at, the same minimum
    assert take.error_mm[kept] == pytest.approx(fits.takes[2].error_mm[kept], abs=0.01)


def test_meshes_in_several_files_are_fitted_as_one(trained, base, subject, fits):
    talk = subject.takes[2]
    parts = JoinedMeshes([talk.meshes[:9], talk.meshes[9:]], len(subject.neutral))
    found = fit_subject(trained, base, replace(subject, takes=(replace(talk, meshes=parts),)), held_out=True)
    assert np.array_equal(found.takes[0].error_mm, fits.takes[2].error_mm)


@pytest.mark.parametrize("number", [0, 2], ids=["pose", "speech"])
def test_only_what_was_seen_is_judged(trained, base, subject, number):
    """Whatever a tracker makes up elsewhere, the errors stay the same."""
    turn = subject.takes[number]
    nape = trained.head.regions["neck"] & (subject.neutral[:, 2] < np.median(subject.neutral[trained.head.regions["neck"], 2]))
    meshes = turn.meshes.copy()
    meshes[:, nape] += 0.004
    settings = FitSettings()
    tracked = [replace(turn, meshes=found) for found in (turn.meshes, meshes)]
    told = [fit_subject(trained, base, replace(subject, takes=(take,), seen=~nape), settings, held_out=True) for take in tracked]
    assert np.array_equal(told[0].takes[0].error_mm, told[1].takes[0].error_mm)


def test_what_cannot_be_fitted_is_refused_by_name(trained, base, subject):
    talk = subject.takes[2]
    with pytest.raises(InputError, match="somebody, take talk: meshes"):
        fit_subject(trained, base, replace(subject, takes=(replace(talk, meshes=talk.meshes[:, :-1]),)), held_out=True)
    lost = replace(talk, meshes=np.full_like(talk.meshes, np.nan))
    with pytest.raises(InputError, match="somebody, take talk: none of"):
        fit_subject(trained, base, replace(subject, takes=(lost,)), held_out=True)
    with pytest.raises(InputError, match="nothing was seen of the region"):
        fit_subject(trained, base, replace(subject, seen=~trained.head.regions["neck"]), held_out=True)
    with pytest.raises(InputError, match="region knee"):
        fit_subject(trained, base, subject, held_out=True, region="knee")
    with pytest.raises(InputError, match="person stranger"):
        fit_subject(trained, base, replace(subject, name="stranger"), held_out=True)


def test_fits_travel_in_a_file_with_kinds_and_errors(fits, tmp_path):
    fits.save(tmp_path / "fits.npz")
    read = NeckFits.load(tmp_path / "fits.npz")
    assert (read.person, read.held_out, read.figures()) == (fits.person, True, fits.figures())
    for before, after in zip(fits.takes, read.takes, strict=True):
        assert (before.take, before.kind, set(before.errors_mm)) == (after.take, after.kind, set(after.errors_mm))
        assert np.array_equal(before.psi, after.psi)
    save_arrays(tmp_path / "old.npz", "neck_fits", 1, {}, {})
    with pytest.raises(ArtifactError, match="neck_fits"):
        NeckFits.load(tmp_path / "old.npz")
    with pytest.raises(InputError, match="errors of bogus"):
        replace(fits.takes[0], errors_mm={"bogus": fits.takes[0].error_mm})
