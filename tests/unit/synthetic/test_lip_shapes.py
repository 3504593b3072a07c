"""What lips do in takes of theirs looks like its name, on the meshes that regressors learn from, and keeps the lips apart."""

from typing import get_args

import numpy as np
import pytest

from headcap.heads.procedural import base_head
from headcap.meshes.normals import triangle_normals
from headcap.synthetic.articulation import ONSET_S
from headcap.synthetic.mesh_takes import MeshSubject, mesh_subject
from headcap.synthetic.performance import LIP_SHAPES, perform
from headcap.synthetic.settings import LipShape
from headcap.synthetic.subject import AT_REST


@pytest.fixture(scope="module")
def person() -> MeshSubject:
    return mesh_subject(3)


def _shaped(person, name, share=1.0):
    return person.mesh(AT_REST | {channel: share * value for channel, value in LIP_SHAPES[name].items()})


def _red_mm2(mesh):
    """Area of the lips that a far camera in front sees: what faces it, hidden or not."""
    regions, triangles = base_head().regions, base_head().triangles
    lips = triangles[(regions["lips_upper"] | regions["lips_lower"])[triangles].all(axis=1)]
    return 0.5e6 * np.clip(triangle_normals(mesh, lips)[:, 2], 0, None).sum()


def _corners_mm(person, mesh):
    right, left = (1e3 * mesh[person.subject.contact.rims[0][k]] for k in (0, -1))
    return right, left


def _gap_mm(person, mesh):
    upper, lower = person.subject.contact.rims
    middle = len(upper) // 2
    return 1e3 * np.linalg.norm(mesh[upper[middle]] - mesh[lower[middle]])


def test_every_shape_has_a_name_that_settings_know():
    assert set(get_args(LipShape)) == set(LIP_SHAPES)


def test_rolled_lips_hide_or_show_their_red(person):
    rest = _red_mm2(person.neutral_m)
    assert _red_mm2(_shaped(person, "roll_in")) < 0.5 * rest
    # at rest all of the red faces the camera already: rolled out, the rims come forward and what lay behind them shows
    middle = len(person.subject.contact.rims[0]) // 2
    rims = [rim[middle] for rim in person.subject.contact.rims]
    ahead = {name: 1e3 * (_shaped(person, name) - person.neutral_m)[rims, 2] for name in ("roll_in", "roll_out")}
    assert (ahead["roll_out"] > 1.5).all()
    assert (ahead["roll_in"] < -2.0).all()
    assert _red_mm2(_shaped(person, "roll_out")) > rest
    # half way there is half way in between, nothing flips over
    assert _red_mm2(_shaped(person, "roll_in")) < _red_mm2(_shaped(person, "roll_in", 0.5)) < rest


def test_a_kiss_is_narrow_and_forward_and_shut(person):
    rest, kiss = person.neutral_m, _shaped(person, "kiss")
    (right, left), (kissing_right, kissing_left) = _corners_mm(person, rest), _corners_mm(person, kiss)
    assert kissing_left[0] - kissing_right[0] < 0.85 * (left[0] - right[0])
    lips = base_head().regions["lips_upper"] | base_head().regions["lips_lower"]
    assert 1e3 * (kiss[lips, 2].max() - rest[lips, 2].max()) > 4
    assert _gap_mm(person, kiss) < 2.5 < _gap_mm(person, _shaped(person, "pucker"))


def test_mouths_go_to_either_side_and_smirks_lift_one_corner(person):
    rest = _corners_mm(person, person.neutral_m)
    for name, sign in (("side_left", 1), ("side_right", -1)):
        moved = np.subtract(_corners_mm(person, _shaped(person, name)), rest)
        assert (sign * moved[:, 0] > 4).all()
    lifted = np.subtract(_corners_mm(person, _shaped(person, "smirk_left")), rest)[:, 1]
    assert lifted[1] > 5 > lifted[0] + 4


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_lips_of_no_shape_pass_through_each_other(person, share):
    import open3d

    triangles, sides = base_head().triangles, person.subject.contact.sides
    upper, lower = (np.isin(np.arange(len(person.neutral_m)), side) for side in sides)
    lips = [triangles[(upper & ~lower)[triangles].all(axis=1)], triangles[(lower & ~upper)[triangles].all(axis=1)]]

    def pierced(mesh, crossing, crossed):
        scene = open3d.t.geometry.RaycastingScene()
        corners = mesh[crossed].reshape(-1, 3).astype(np.float32)
        scene.add_triangles(corners, np.arange(len(corners), dtype=np.uint32).reshape(-1, 3))
        edges = np.concatenate([crossing[:, [0, 1]], crossing[:, [1, 2]], crossing[:, [2, 0]]])
        rays = np.concatenate([mesh[edges[:, 0]], mesh[edges[:, 1]] - mesh[edges[:, 0]]], axis=1).astype(np.float32)
        return int((scene.cast_rays(rays)["t_hit"].numpy() <= 1).sum())

    for name in LIP_SHAPES:
        mesh = _shaped(person, name, share)
        assert pierced(mesh, *lips) == pierced(mesh, *lips[::-1]) == 0, name


def _peaks(performance, channel, times):
    return np.array([abs(performance.state(t)[channel]) for t in times])


def test_named_shapes_come_in_their_order_and_again():
    performance = perform(np.random.default_rng(1), "lips", 3.0, 1.0, ("roll_in", "kiss", "side_left"))
    times = np.arange(ONSET_S, 3.0, 0.02)
    rolled, rounded, drawn = (_peaks(performance, name, times) for name in ("upper_roll", "rounding", "mouth_side"))
    first = [times[(values > 0.7 * values.max()).argmax()] for values in (rolled, rounded, drawn)]
    assert first == sorted(first)
    # about half a second each: after the third shape the first comes again
    again = times > first[2] + 0.5
    assert rolled[again].max() > 0.9


def test_without_names_every_shape_is_made_in_ten_seconds():
    performance = perform(np.random.default_rng(2), "lips", 11.0, 1.0)
    times = np.arange(0, 11.0, 0.02)
    states = [performance.state(t) for t in times]
    for name, channels in LIP_SHAPES.items():
        alike = [sum(abs(state[c] - channels.get(c, 0)) for c in ("jaw", *channels)) for state in states]
        # neighbours overlap by a little, and values near 1 are limited softly
        assert min(alike) < 0.25, name


def test_lips_move_smoothly_from_shape_to_shape(person):
    """Nowhere in a take of all shapes does a vertex change its speed within 1/60 s by more than least-jerk moves of 12 mm do."""
    take = person.take("lips", 180, 60.0, lip_shapes=("roll_in", "roll_out", "kiss", "side_right", "puff"))
    acceleration = np.diff(take.meshes.astype(float), 2, axis=0) * 60.0**2
    # d / T^2 * 10 / sqrt(3) for a least-jerk move d in T: 12 mm in 0.16 s make 2.7 m/s^2; two channels may add up
    assert np.linalg.norm(acceleration, axis=2).max() < 2 * 2.7
