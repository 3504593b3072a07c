"""Names of the 52, as studios write them, lead to the 52 and nothing else does."""

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.expressions import ExpressionBasis
from headcap.expressions.arkit import ARKIT_NAMES, as_arkit, recognise


def styles(name):
    """Ways to write an ARKit name with its side."""
    stem = name.removesuffix("Left").removesuffix("Right")
    side = name[len(stem) :]
    yield from (name, name.lower(), name.upper(), name[0].upper() + name[1:], f"head:{name}", f"BS_{name}", f"{name}_Mesh")
    if side:
        letter = side[0]
        yield from (
            f"{stem}_{letter}",
            f"{stem}.{letter.lower()}",
            f"{stem}{letter}",
            f"{letter}_{stem}",
            f"{stem}_{side.lower()}",
        )


def basis_of(names, rng):
    """Each shape moves vertices of its own."""
    shapes = np.zeros((len(names), 2 * len(names), 3))
    for i, shape in enumerate(shapes):
        shape[2 * i : 2 * i + 2] = rng.normal(size=(2, 3)) * 0.01
    triangles = np.array([[0, 1, 2]])
    return ExpressionBasis(names, rng.normal(size=shapes.shape[1:]), shapes, triangles)


def test_there_are_52():
    assert len(set(ARKIT_NAMES)) == 52


@pytest.mark.parametrize("name", ARKIT_NAMES)
def test_every_style_of_a_name_is_recognised(name):
    assert set(recognise(styles(name)).names.values()) == {name}


@pytest.mark.parametrize(
    "name",
    ["smile", "mouth", "left", "mouthSmile", "jawOpen_mouthClose", "left_mouthLeft", "eyeBlinkLeftRight", "notJawOpen", "", "12"],
)
def test_what_is_none_of_them_stays_foreign(name):
    assert recognise([name]).foreign == (name,)


def test_what_is_absent_is_told_in_arkits_order():
    found = recognise([name for name in ARKIT_NAMES if name not in ("tongueOut", "browDownLeft")])
    assert found.absent == ("browDownLeft", "tongueOut")
    assert found.foreign == ()


def test_aliases_name_what_no_rule_could():
    found = recognise(["AU26", "jawOpen2"], {"AU26": "jawOpen"})
    assert found.names["AU26"] == "jawOpen"
    with pytest.raises(InputError, match="mouthOpen as ARKit's"):
        recognise(["AU26"], {"AU26": "mouthOpen"})


@pytest.mark.real
def test_all_53_names_of_ict_facekit_are_recognised(test_data):
    with np.load(test_data / "ict_head" / "ict_head.npz") as archive:
        names = archive["expression_names"].tolist()
    found = recognise(names)
    assert len(found.names) == 53
    assert found.foreign == ()
    # two of ARKit's come in halves, and this head has no tongue
    assert len(set(found.names.values())) == 51
    assert found.absent == ("tongueOut",)


def test_halves_at_one_weight_are_the_whole(rng):
    basis = basis_of(("puff", "browInnerUp_R", "jawOpen", "browInnerUp_L"), rng)
    arkit, matrix = as_arkit(basis)
    assert arkit.names == ("browInnerUp", "jawOpen")
    weights = np.array([0.0, 0.3, 0.8, 0.3])
    np.testing.assert_allclose(weights @ matrix, [0.3, 0.8])
    # single precision of positions of about three
    np.testing.assert_allclose(arkit.blend(weights @ matrix), basis.blend(weights), atol=1e-6)


def test_weights_of_halves_come_over_by_least_squares(rng):
    basis = basis_of(("browInnerUp_R", "browInnerUp_L"), rng)
    arkit, matrix = as_arkit(basis)
    weights = rng.uniform(size=2)
    free = np.linalg.lstsq(arkit.rows.T.astype(float), basis.rows.T.astype(float) @ weights, rcond=None)[0]
    # single precision of the shapes
    np.testing.assert_allclose(weights @ matrix, free, rtol=1e-6)


@pytest.mark.parametrize("names", [("cheekPuff_L", "jawOpen"), ("jawOpen", "jaw_open"), ("cheekPuff_L", "cheekPuff", "jawOpen")])
def test_half_a_shape_or_a_shape_twice_is_refused(names, rng):
    with pytest.raises(InputError, match="as ARKit's"):
        as_arkit(basis_of(names, rng))


def test_a_basis_without_such_names_is_refused(rng):
    with pytest.raises(InputError, match="none of the 2 shapes"):
        as_arkit(basis_of(("smile", "frown"), rng))
