"""Surface flow on the mouth alone moves the mouth to its photographs and nothing else."""

import numpy as np

from headcap.cameras import Camera, Rig
from headcap.registration.coarse import firmness
from headcap.registration.correspondence import CorrespondenceSettings
from headcap.registration.lips import LipTracker, at_rim, near_lips
from headcap.registration.photographs import Photograph
from headcap.registration.reference import Reference, build_reference
from headcap.registration.refine import RefineSettings
from headcap.registration.template import Template
from headcap.registration.track_settings import LipSettings

N, SIZE, SIDE = 41, 0.06, 160


def _camera(name: str, x: float) -> Camera:
    z = np.array([-x, 0.0, -0.3])
    z /= np.linalg.norm(z)
    right = np.cross(z, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(z, right), z])
    pose[:3, 3] = -pose[:3, :3] @ [x, 0.0, 0.3]
    middle = (SIDE - 1) / 2
    return Camera(name, SIDE, SIDE, np.array([[600.0, 0, middle], [0, 600, middle], [0, 0, 1]]), np.zeros(5), pose)


def _sheet() -> tuple[np.ndarray, np.ndarray]:
    axis = np.linspace(-SIZE / 2, SIZE / 2, N)
    x, y = np.meshgrid(axis, axis)
    a = (np.arange(N - 1)[:, None] * N + np.arange(N - 1)).ravel()
    triangles = np.concatenate([np.stack([a, a + 1, a + N + 1], 1), np.stack([a, a + N + 1, a + N], 1)]).astype(np.int32)
    return np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3), triangles


def _photograph(camera: Camera, shift_m: float) -> np.ndarray:
    """The plane z = 0 with a pattern on it that has slid upwards by `shift_m`."""
    v, u = np.mgrid[:SIDE, :SIDE].astype(float)
    rays = (
        np.stack([(u - (SIDE - 1) / 2) / 600, (v - (SIDE - 1) / 2) / 600, np.ones_like(u)], -1) @ camera.camera_from_world[:3, :3]
    )
    hit = camera.centre + rays * (-camera.centre[2] / rays[..., 2])[..., None]
    x, y = hit[..., 0], hit[..., 1] - shift_m
    return (128 + 40 * np.sin(900 * x) * np.cos(700 * y) + 25 * np.sin(500 * (x + y))).astype(np.float32)


class _Still:
    """No motion within the frame."""

    def offsets(self, delays_s):
        return [np.zeros((N * N, 3)) for _ in delays_s]

    def fields(self, delay_s):
        return np.zeros((1, N * N, 3))


def test_the_mouth_moves_and_the_rest_does_not():
    vertices, triangles = _sheet()
    lips = np.linalg.norm(vertices[:, :2], axis=1) < 0.008
    template = Template(vertices, triangles, vertices[:, :2], triangles, regions={"lips_upper": lips})
    rig = Rig((_camera("a", -0.08), _camera("b", 0.08)))
    reference = build_reference(template, rig, [_photograph(c, 0.0) for c in rig], own_photographs=True, edge_margin_px=1)
    tracker = LipTracker(reference, LipSettings(reach_mm=10), CorrespondenceSettings(), RefineSettings())
    shift_m = 0.4e-3
    photographs = [Photograph(k, _photograph(c, shift_m), 0.0) for k, c in enumerate(rig)]
    found = tracker.refine(vertices, _Still(), photographs, None)
    outside = np.setdiff1d(np.arange(len(vertices)), tracker.vertices)
    assert np.array_equal(found[outside], vertices[outside])
    # a pixel is 0.5 mm on the sheet: the lips go along to a fifth of it although the held rim pulls them back
    assert np.abs(found[lips] - vertices[lips] - [0, shift_m, 0]).max() < 0.1e-3
    rim = tracker.vertices[
        at_rim(triangles, reference.template.part(_chosen(tracker, len(vertices)))[0].triangles, tracker.vertices, len(vertices))
    ]
    # held to a micrometre
    assert np.abs(found[rim] - vertices[rim]).max() < 1e-5


def _chosen(tracker: LipTracker, count: int) -> np.ndarray:
    return np.isin(np.arange(count), tracker.vertices)


def test_nearness_follows_the_surface():
    vertices, triangles = _sheet()
    lips = np.zeros(len(vertices), bool)
    lips[N * (N // 2) + N // 2] = True
    near = near_lips(vertices, triangles, {"lips_upper": lips, "face": np.ones(len(vertices), bool)}, 0.01)
    distance = np.linalg.norm(vertices[:, :2], axis=1)
    # paths along edges and one kind of diagonal are up to sqrt(2) longer than the straight line
    assert near[distance < 0.01 / np.sqrt(2) - 1e-9].all()
    assert not near[distance > 0.01 + 1e-9].any()
    assert not near_lips(vertices, triangles, {"face": lips}, 0.01).any()


def test_a_part_is_the_same_surface():
    vertices, triangles = _sheet()
    template = Template(vertices, triangles, vertices[:, :2], triangles, {"face": vertices[:, 0] > 0}, {"nose": 5})
    chosen = vertices[:, 1] < 0
    part, kept, inside = template.part(chosen)
    assert np.array_equal(part.vertices[part.triangles], vertices[triangles[inside]])
    assert np.array_equal(part.regions["face"], template.regions["face"][kept])
    assert kept[part.landmarks["nose"]] == 5
    assert chosen[kept].all()


def test_hidden_inner_lips_are_half_as_firm_as_skin():
    vertices, triangles = _sheet()
    inner = np.abs(vertices[:, 1]) < 0.004
    template = Template(vertices, triangles, vertices[:, :2], triangles, regions={"lips_inner_upper": inner})
    shown = np.abs(vertices[:, 1]) > 0.002
    found = firmness(Reference(template, (), (), shown), 0.5)
    assert (found[shown] == 1.0).all()
    assert (found[~shown & inner] == 0.5).all()
    assert (found[~shown & ~inner] == 0.0).all()
    assert np.array_equal(firmness(Reference(template, (), (), shown), 0.0), shown.astype(float))
