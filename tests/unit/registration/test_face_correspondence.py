"""Correspondence of topologies: a head and its twin of other triangles are found to be one, and eq. 1 sees no difference."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from headcap.artifacts import ArtifactError, save_arrays
from headcap.errors import InputError
from headcap.geometry.transforms import fit_similarity, from_vector, transform
from headcap.heads import base_head, load_ict, procedural_model
from headcap.lips.correction import CorrectionLayer, canonical_meshes
from headcap.lips.mouth import find_mouth
from headcap.meshes.subdivision import subdivide_butterfly
from headcap.registration.face_correspondence import (
    Correspondence,
    FaceCorrespondenceSettings,
    NeutralFace,
    correspond,
    face_skin,
    landmark_points,
    same_topology,
)
from headcap.report.overlays import virtual_camera
from headcap.synthetic.mesh_takes import mesh_subject

NAMES = tuple(base_head().landmarks)
SIZE = 1.1


class Twin:
    """Another head of the base's kind with four times the triangles, vertices in no order, elsewhere and larger."""

    def __init__(self, neutral):
        self.head = base_head()
        self.step = subdivide_butterfly(self.head.triangles, len(self.head.vertices))
        self.order = np.random.default_rng(0).permutation(self.step.carry(neutral).shape[0])
        self.number = np.argsort(self.order)
        self.triangles = self.number[self.step.triangles].astype(np.int32)
        self.place = from_vector(np.array([0.2, -0.1, 0.3, 0.5, 0.2, 1.0]))
        self.skin = self.step.carry_mask(face_skin(procedural_model().regions))[self.order]
        self.neutral = self.of(neutral)

    def of(self, mesh):
        """The twin's mesh of a mesh of the base's topology."""
        return transform(self.place, SIZE * self.step.carry(mesh))[self.order]

    def face(self, **changes):
        landmarks = {name: self.neutral[self.number[self.head.landmarks[name]]] for name in NAMES}
        return replace(NeutralFace(self.neutral, self.triangles, landmarks, self.skin), **changes)


@pytest.fixture(scope="module")
def base():
    head = procedural_model()
    return NeutralFace.of(head.vertices, head.triangles, head.landmarks, head.regions)


@pytest.fixture(scope="module")
def mouth():
    head = base_head()
    return find_mouth(head.vertices, head.triangles, head.regions)


@pytest.fixture(scope="module")
def subject():
    return mesh_subject(5)


@pytest.fixture(scope="module")
def smiles(subject):
    return subject.take("lips", 60, 30.0).meshes[12::16].astype(float)


@pytest.fixture(scope="module")
def twin(subject):
    return Twin(subject.neutral_m)


@pytest.fixture(scope="module")
def found(base, twin):
    return correspond(base, twin.face())


def test_the_twin_is_found_though_it_is_another_person(base, twin, found, inside):
    true = twin.neutral[twin.number[: len(base.vertices)]]
    away = 1e3 * np.linalg.norm(found.carry(twin.neutral) - true, axis=1) / SIZE
    placement, scale = fit_similarity(*(np.array([face.landmarks[name] for name in NAMES]) for face in (base, twin.face())))
    before = 1e3 * np.linalg.norm(transform(placement, scale * base.vertices) - true, axis=1) / SIZE
    # smooth skin does not tell where it slides to: half an edge of the base's triangles (1.2 mm) is what can be asked
    assert np.median(away[inside]) < 0.6
    assert np.median(away[inside]) < 0.3 * np.median(before[inside])
    assert found.figures["distance_median_mm"] < 0.05
    assert found.figures["matched_share"] > 0.95
    np.testing.assert_allclose(found.registered, found.carry(twin.neutral), atol=1e-12)


def test_a_twin_of_the_same_shape_is_found_exactly(base, inside, smiles, subject):
    """Everything pulls to where it lies already; the stiffness knows no reason to move."""
    twin = Twin(subject.neutral_m)
    own = replace(base, vertices=subject.neutral_m, landmarks={n: subject.neutral_m[base_head().landmarks[n]] for n in NAMES})
    found = correspond(own, twin.face())
    carried = found.carry(np.stack([twin.of(mesh) for mesh in smiles]))
    true = np.stack([twin.of(mesh)[twin.number[: len(base.vertices)]] for mesh in smiles])
    away = 1e3 * np.linalg.norm((carried - true)[:, inside], axis=2)
    # places of the finer surface that lie beside its coarse vertices pull back by a part of the sagitta of an edge
    assert np.median(away) < 0.03
    assert np.percentile(away, 99) < 0.5


def test_what_is_carried_moves_with_the_rig(twin, found):
    move = from_vector(np.array([0.5, 0.2, -0.4, 0.1, 0.3, 0.2]))
    np.testing.assert_allclose(found.carry(transform(move, twin.neutral)), transform(move, found.registered), atol=1e-12)
    some = np.array([5, 77, 2000])
    np.testing.assert_array_equal(found.carry(twin.neutral, some), found.carry(twin.neutral)[some])


@pytest.mark.parametrize("identity", ["corrected", "kept"])
def test_equation_one_through_the_identity_is_equation_one(mouth, subject, smiles, identity):
    layer = CorrectionLayer(mouth, base_head().vertices, identity)
    coarse = canonical_meshes(0.5 * (smiles + subject.neutral_m), base_head().vertices, mouth.steady).meshes
    same = same_topology(subject.neutral_m, mouth.triangles)
    np.testing.assert_array_equal(same.carry(smiles)[:, mouth.vertices], smiles[:, mouth.vertices])
    expected = layer.parameters(coarse, subject.neutral_m, smiles)
    np.testing.assert_allclose(layer.parameters(coarse, subject.neutral_m, smiles, same), expected, atol=1e-6)


@pytest.fixture(scope="module")
def inside(base, mouth):
    return mouth.vertices[base.skin[mouth.vertices]]


@pytest.mark.parametrize("identity", ["corrected", "kept"])
def test_equation_one_of_triangles_that_correspond_is_that_of_carried_vertices(
    base, mouth, subject, smiles, twin, found, inside, identity
):
    """The twin's triangles within one of the base's differ in their motion by the curvature of the motion alone."""
    layer = CorrectionLayer(mouth, base.vertices, identity)
    coarse = base.vertices + 0.5 * (smiles - subject.neutral_m)
    rig = np.stack([twin.of(mesh) for mesh in smiles])
    through = layer.corrected(coarse, layer.parameters(coarse, twin.neutral, rig, found))
    carried = layer.corrected(coarse, layer.parameters(coarse, found.registered, found.carry(rig)))
    assert 1e3 * np.linalg.norm((through - carried)[:, inside], axis=2).mean() < 0.02


def test_equation_one_of_another_topology_mends_expressions_as_its_own_does(mouth, subject, smiles, twin, found, inside):
    layer = CorrectionLayer(mouth, subject.neutral_m, "kept")
    coarse = 0.5 * (smiles + subject.neutral_m)
    rig = np.stack([twin.of(mesh) for mesh in smiles])
    own, other = (layer.parameters(coarse, *told) for told in ((subject.neutral_m, smiles), (twin.neutral, rig, found)))
    missing, direct, through = (
        1e3 * np.linalg.norm((mesh - smiles)[:, inside], axis=2).mean()
        for mesh in (coarse, layer.corrected(coarse, own), layer.corrected(coarse, other))
    )
    # half a millimetre beside, lips that move by millimetres over a centimetre move by a tenth of that otherwise
    assert through < direct + 0.05
    assert through < 0.5 * missing


def test_equation_one_of_another_topology_mends_the_neutral_mouth_as_far_as_it_is_told(base, mouth, subject, twin, found, inside):
    layer = CorrectionLayer(mouth, base.vertices, "corrected")
    rest = base.vertices[None]
    own = layer.corrected(rest, layer.parameters(rest, subject.neutral_m, subject.neutral_m[None]))
    other = layer.corrected(rest, layer.parameters(rest, twin.neutral, twin.neutral[None], found))
    slid = np.linalg.norm(found.carry(twin.neutral) - twin.neutral[twin.number[: len(base.vertices)]], axis=1) / SIZE
    # as far as the mouth was mistaken, and the skin above that says where the whole face is
    away = np.linalg.norm((other - own)[0, inside], axis=1).mean()
    assert away < slid[inside].mean() + slid[mouth.steady].mean()
    assert away < 0.6 * np.linalg.norm((own - rest)[0, inside], axis=1).mean()


def test_landmarks_are_cast_back_onto_the_mesh(base):
    camera = virtual_camera(base.vertices, 10.0, height=600)
    names = ["nose_tip", "mouth_corner_left", "chin"]
    points = np.array([base.landmarks[name] for name in names])
    pixels = camera.project(points)[0]
    found = landmark_points(camera, np.vstack([pixels, [[-40.0, 10.0]], [[np.nan, 1.0]]]), base.vertices, base.triangles)
    # the nearest pixel's triangle goes on for half a pixel, 0.3 mm here, at slopes of up to two
    np.testing.assert_allclose(found[:3], points, atol=6e-4)
    np.testing.assert_allclose(camera.project(found[:3])[0], pixels, atol=1e-6)
    assert np.isnan(found[3:]).all()


def test_files_come_back(found, twin, tmp_path):
    found.save(tmp_path / "found.npz")
    again = Correspondence.load(tmp_path / "found.npz")
    np.testing.assert_array_equal(again.carry(twin.neutral), found.carry(twin.neutral))
    np.testing.assert_array_equal(again.of_triangle, found.of_triangle)
    assert again.figures == found.figures
    save_arrays(tmp_path / "other.npz", "template", 1, {})
    with pytest.raises(ArtifactError):
        Correspondence.load(tmp_path / "other.npz")


def test_bad_input_is_told(base, twin, found, mouth, smiles):
    few = dict(list(twin.face().landmarks.items())[:3])
    with pytest.raises(InputError, match="3 landmarks"):
        correspond(base, twin.face(landmarks=few))
    with pytest.raises(InputError, match="rig's topology"):
        found.carry(twin.neutral[:100])
    layer = CorrectionLayer(mouth, base.vertices)
    with pytest.raises(InputError, match="topology"):
        layer.parameters(smiles[:1], twin.neutral, smiles[:1], found)


def test_a_rig_that_is_somewhere_else_is_refused(base, twin):
    away = np.array([0.0, 0.0, 1.0])
    far = {name: point + away * (k % 2) for k, (name, point) in enumerate(twin.face().landmarks.items())}
    with pytest.raises(InputError, match="of the base's skin within"):
        correspond(base, twin.face(landmarks=far), FaceCorrespondenceSettings(lengths_mm=(30.0,), rounds=1))


def test_skin_is_face_and_lips_without_what_is_behind_them():
    regions = procedural_model().regions
    skin = face_skin(regions)
    assert skin[regions["lips_outer"]].all()
    assert skin[regions["lips_inner"] & ~regions["mouth_interior"]].all()
    assert not (skin & (regions["eyes"] | regions["mouth_interior"])).any()
    assert not (skin & ~(regions["face"] | regions["lips_outer"] | regions["lips_inner"])).any()
    assert face_skin({name: regions[name] for name in ("face", "lips_outer")}) is None
    assert face_skin({name: regions[name] for name in ("face", "lips_outer", "lips_inner")}).sum() >= skin.sum()


@pytest.mark.real
def test_two_head_models_correspond(test_data):
    own, other = procedural_model(), load_ict(test_data / "ict_head")
    told = ("mouth_upper", "mouth_lower", "subnasale", "lip_lower_bottom")
    wings = ("nose_wing_left", "nose_wing_right", "lip_upper_top", "nose_bridge")  # other places in the 68-point scheme
    names = [name for name in own.landmarks if name in other.landmarks and name not in (*told, *wings)]

    def face(model):
        return NeutralFace.of(model.vertices, model.triangles, {name: model.landmarks[name] for name in names}, model.regions)

    rig = face(other)
    found = correspond(face(own), rig)
    assert found.figures["matched_share"] > 0.95
    for name in told:
        away = found.registered[own.landmarks[name]] - rig.vertices[other.landmarks[name]]
        assert np.linalg.norm(away) < 2e-3
    rings = [find_mouth(face(m).vertices, m.triangles, m.regions).outline for m in (own, other)]
    ring = rig.vertices[rings[1]]
    border = np.concatenate([ring + (np.roll(ring, -1, axis=0) - ring) * share for share in np.linspace(0, 1, 5)])
    # the lips' border, which no landmark but the corners tells: to within an edge of the meshes
    assert np.median(cKDTree(border).query(found.registered[rings[0]])[0]) < 1e-3
