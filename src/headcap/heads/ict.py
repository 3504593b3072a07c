"""ICT-FaceKit (Li et al. 2020, MIT licence) as a head model: its skin, named expressions and identity directions."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.heads import rigging
from headcap.heads.anatomy import find_anatomy
from headcap.heads.archive import read_npz
from headcap.heads.model import POSE_FEATURES, HeadModel
from headcap.heads.refinement import WANTED_VERTICES, refine_front

FILE = "ict_head.npz"
_KEYS = ("vertices_m", "faces", "expression_names", "expressions_m", "identities_m", "landmarks68", "head_neck_vertices")
_ANCHORS = {
    "nose_bridge": 27, "nose_tip": 30, "nose_wing_right": 31, "subnasale": 33, "nose_wing_left": 35,
    "eye_outer_right": 36, "eye_inner_right": 39, "eye_inner_left": 42, "eye_outer_left": 45,
    "mouth_corner_right": 48, "lip_upper_top": 51, "mouth_corner_left": 54, "lip_lower_bottom": 57,
    "mouth_upper": 62, "mouth_lower": 66,
}  # fmt: skip
"""Our landmarks among the 68 of the iBUG scheme; right is the subject's."""


def load_ict(path: Path | str, wanted_vertices: int = WANTED_VERTICES) -> HeadModel:
    """An ICT-FaceKit head, float32, metres, from a folder with `ict_head.npz` or that file.

    The file holds vertices_m (v, 3), faces (f, 4) with -1 in a triangle's last place, expressions_m (53, v, 3) and their names,
    identities_m (80, v, 3), landmarks68, and head_neck_vertices (first, last + 1), where the skin ends. Eyes, teeth and the
    mouth's inside are left out; joints and blend weights are made (`rigging`), pose correctives are zero. Raises `InputError`.
    """
    path = Path(path)
    arrays = _read(path / FILE if path.is_dir() else path)
    skin = int(arrays["head_neck_vertices"][1])
    vertices = np.asarray(arrays["vertices_m"], np.float64)[:skin]
    triangles = _triangles(arrays["faces"], skin)
    anchors = {name: int(arrays["landmarks68"][at]) for name, at in _ANCHORS.items()}
    anatomy = find_anatomy(vertices, triangles, anchors)
    regions, joints = anatomy.regions, anatomy.joints
    model = HeadModel(
        name="ict",
        vertices=vertices,
        triangles=triangles,
        shape_basis=np.asarray(arrays["identities_m"], np.float64)[:, :skin],
        expression_basis=np.asarray(arrays["expressions_m"], np.float64)[:, :skin],
        pose_basis=np.zeros((POSE_FEATURES, *vertices.shape)),
        speech_basis=np.zeros((0, *vertices.shape)),
        joint_regressor=rigging.joint_regressor(vertices, joints, rigging.joint_supports(vertices, regions, joints)),
        skinning_weights=rigging.skinning_weights(vertices, triangles, regions, joints, anatomy.mouth),
        regions=regions,
        landmarks=anatomy.landmarks,
        expression_names=tuple(str(name) for name in arrays["expression_names"]),
    )
    return (refine_front(model, wanted_vertices) if wanted_vertices else model).astype(np.float32)


def _read(path: Path) -> dict[str, NDArray]:
    if not path.is_file():
        raise InputError(f"no file {path}", expected=f"an ICT-FaceKit head, {FILE}", remedy="Give its folder or the file.")
    arrays = read_npz(path, expected="a whole npz", remedy="Copy it again.")
    missing = [key for key in _KEYS if key not in arrays]
    if missing:
        raise InputError(f"{path.name} lacks {', '.join(missing)}", expected="an ICT-FaceKit head", remedy="Export it whole.")
    return arrays


def _triangles(faces: NDArray, skin: int) -> NDArray[np.int32]:
    """Quads and triangles (f, 4) of the skin as triangles."""
    inside = faces[(faces < skin).all(axis=1)]
    quads = inside[inside[:, 3] >= 0]
    return np.concatenate([inside[:, :3], quads[:, [0, 2, 3]]]).astype(np.int32)
