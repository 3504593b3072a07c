"""The page of quasi-eigen faces: every shape by name, what is missing, nothing from the network, markers as well as meshes."""

import re
from dataclasses import replace

import numpy as np
import pytest

from headcap.evaluation.expressions import compare_bases
from headcap.evaluation.metrics import Figure
from headcap.expressions import Eigenfaces, ExpressionBasis, Performance, QuasiEigenFaces
from headcap.expressions.performance import in_memory
from headcap.report.expressions import collect_expressions_page, telling_moments, write_expressions_report

FRAMES, SHAPES = 40, 5
NAMES = ("jaw_open", "smile", "<frown>", "brow_up", "cheek_puff")


def bumps(vertices, count):
    """Displacements (count, n, 3) outward about places spread over the ball's front, 1 cm high."""
    angles = np.linspace(0, 2 * np.pi, count, endpoint=False)
    places = 0.1 * np.column_stack([0.6 * np.cos(angles), 0.6 * np.sin(angles), np.full(count, 0.8)])
    near = np.exp(-0.5 * (np.linalg.norm(vertices[None] - places[:, None], axis=2) / 0.03) ** 2)
    return 0.01 * near[..., None] * vertices / 0.1


@pytest.fixture(scope="module")
def faces_and_performance(template):
    """A performance of four of five shapes, the last never; hand-made ones are twice too high on one side."""
    true = bumps(template.vertices, SHAPES)
    rng = np.random.default_rng(5)
    weights = rng.uniform(0, 1, (FRAMES, SHAPES))
    weights[:, -1] = 0
    weights[0] = 0
    displacements = np.einsum("lk,knc->lnc", weights, true).astype(np.float32)
    hand = true * np.where(template.vertices[:, :1] > 0, 1.5, 0.7)
    return quasi_eigen(template.vertices, template.triangles, hand, displacements, template.regions)


def quasi_eigen(vertices, triangles, hand, displacements, regions):
    """Eq. 2 to 4, written out."""
    rows = displacements.reshape(len(displacements), -1).astype(float)
    mean = rows.mean(axis=0)
    _, values, axes = np.linalg.svd(rows - mean, full_matrices=False)
    kept = values**2 > 1e-8 * values[0] ** 2
    variances, axes = values[kept] ** 2 / len(rows), axes[kept]
    eigen = Eigenfaces(mean.reshape(-1, 3), axes.reshape(len(axes), -1, 3), variances, float((values**2).sum() / len(rows)))
    coordinates = (hand.reshape(len(hand), -1) - mean) @ axes.T
    basis = ExpressionBasis(NAMES, vertices, hand, triangles)
    quasi = replace(basis, displacements=(mean + coordinates @ axes).reshape(hand.shape))
    performance = Performance(
        neutral=vertices,
        triangles=triangles,
        blocks=in_memory(displacements, block=16),
        time_s=np.arange(len(rows)) / 25,
        source="a & b",
        regions=regions,
        figures={"gaps_filled": 3.0},
    )
    return QuasiEigenFaces(basis, eigen, quasi, coordinates, ()), performance


def written(faces, performance, path, **more):
    page = collect_expressions_page(performance, faces, compare_bases(performance, faces), **more)
    write_expressions_report(page, path)
    return page, path.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def made(faces_and_performance, tmp_path_factory):
    figures = (
        Figure("quasi_eigen.qe_over_pca", 1.01, "", "s", None, 1.2, True),
        Figure("quasi_eigen.hand_over_qe", 2.0, "", "s", None, 4.0, False),
    )
    return written(
        *faces_and_performance, tmp_path_factory.mktemp("page") / "page.html", figures=figures, settings={"coverage": 0.9}
    )


def test_every_shape_is_named_and_pictured(made):
    _, text = made
    for name in NAMES:
        shown = name.replace("<", "&lt;").replace(">", "&gt;")
        assert len(re.findall(rf'<td class="name">{re.escape(shown)}</td>', text)) >= 1
        assert f"<b>{shown}</b>" in text
    assert "<frown>" not in text
    assert "a &amp; b" in text


def test_what_was_not_performed_stands_apart(made):
    page, text = made
    assert page.compared.not_exercised == ("cheek_puff",)
    apart = text[text.index('id="silent"') :]
    assert "<b>cheek_puff</b>" in apart
    assert "<b>smile</b>" not in apart
    assert "<b>cheek_puff</b>" not in text[: text.index('id="silent"')]


def test_the_page_needs_no_network_and_no_script(made):
    _, text = made
    assert "<script" not in text
    assert not re.findall(r"""(?:src|href)=["'](?!data:|#)""", text)
    assert "default-src 'none'" in text


def test_limits_are_told(made):
    _, text = made
    assert text.count("gate good") == 1
    assert text.count("gate bad") == 1
    assert "past it" in text
    assert "gaps filled" in text


def test_pictured_frames_are_reproduced_as_they_are_judged(made):
    page, _ = made
    for name in ("hand", "quasi", "pca"):
        error = np.linalg.norm(page.reproduced[name] - page.captured, axis=2)
        rms_mm = 1e3 * np.sqrt((error**2).mean(axis=1))
        judged = getattr(page.compared, name).frame_rms_mm[[moment.frame for moment in page.moments]]
        # float32 shapes of 10 mm
        assert np.allclose(rms_mm, judged, atol=1e-4)


def test_given_weights_are_drawn_and_faces_stay_as_they_were_judged(faces_and_performance, made):
    faces, performance = faces_and_performance
    given = {"quasi": np.full((FRAMES, SHAPES + 1), 0.3)}
    page = collect_expressions_page(performance, faces, made[0].compared, weights=given)
    assert page.weights["quasi"].shape == (FRAMES, SHAPES)
    assert (page.weights["quasi"] == 0.3).all()
    assert np.allclose(page.weights["hand"], made[0].weights["hand"])
    for name in ("hand", "quasi"):
        assert np.allclose(page.reproduced[name], made[0].reproduced[name], atol=1e-9)


def test_moments_are_the_worst_and_a_typical_one():
    hand, quasi = np.array([3.0, 9.0, 1.0, 5.0, 4.0]), np.array([0.1, 0.2, 0.1, 0.1, 0.5])
    assert [moment.frame for moment in telling_moments(hand, quasi)] == [1, 4]
    assert [moment.frame for moment in telling_moments(hand, quasi[::-1])] == [1, 4, 0]
    assert "typical" in telling_moments(hand, quasi)[1].told
    assert "quasi-eigen" in telling_moments(hand, quasi)[1].told


def test_moments_are_not_neighbours():
    hand, quasi = np.arange(100.0), np.ones(100)
    # six frames in a hundred, the least of which lies below the twentieth that errs most
    quasi[[3, 20, 96, 97, 98, 99]] = 2.0, 1.5, 1.9, 2.0, 2.1, 2.2
    assert [moment.frame for moment in telling_moments(hand, quasi)] == [99, 50, 3]


def test_a_frame_at_which_all_err_most_is_shown_once():
    hand = np.array([1.0])
    assert [moment.frame for moment in telling_moments(hand, hand)] == [0]


def test_the_same_page_is_made_of_markers(faces_and_performance, tmp_path):
    faces, performance = faces_and_performance
    few = np.arange(0, len(performance.neutral), 9)
    displacements = np.concatenate(list(performance.blocks()))[:, few]
    vertices, hand = performance.neutral[few].astype(float), faces.hand.displacements[:, few].astype(float)
    _, text = written(*quasi_eigen(vertices, np.empty((0, 3), np.int32), hand, displacements, {}), tmp_path / "markers.html")
    assert "Red: captured markers" in text
    # hand-made shapes of 1 cm that are half too high: errors of some millimetres, drawn larger and said so
    assert re.search(r"(2|3|5) times as far away as they are", text)
    assert "markers" in text
    for name in ("jaw_open", "cheek_puff"):
        assert f"<b>{name}</b>" in text


@pytest.fixture(scope="module")
def lacking(faces_and_performance, tmp_path_factory):
    """A basis with two shapes almost the same, which leaves out an axis; its page from there on."""
    faces, performance = faces_and_performance
    twice = faces.hand.displacements.copy()
    twice[3] = -0.5 * twice[0]
    wrong = replace(faces, hand=replace(faces.hand, displacements=twice), missing=(1,))
    return wrong, written(wrong, performance, tmp_path_factory.mktemp("page") / "page.html")[1]


def test_a_missing_axis_is_shown_with_the_shape_most_like_it(lacking):
    faces, text = lacking
    axis = faces.eigen.vectors[1].ravel()
    likeness = np.abs(faces.hand.rows @ axis) / np.linalg.norm(faces.hand.rows, axis=1)
    nearest = NAMES[int(likeness.argmax())].replace("<", "&lt;").replace(">", "&gt;")
    assert "<b>eigenface_02</b>" in text
    assert f"most like {nearest}, correlation {likeness.max():.2f}" in text


def test_shapes_almost_the_same_are_listed(lacking):
    _, text = lacking
    overlap = text[text.index('id="overlap"') : text.index('id="frames"')]
    row = next(line for line in overlap.splitlines() if "jaw_open" in line and "brow_up" in line)
    assert "-1.00" in row
