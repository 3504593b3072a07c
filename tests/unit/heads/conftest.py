"""A file shaped like FLAME's: a coarse head with eyeballs, five joints, and the numbers in chumpy objects."""

import pickle
import sys
import types
from pathlib import Path

import igl
import numpy as np
import pytest
import trimesh
from scipy import sparse

from headcap.heads import base_head, procedural_model
from headcap.meshes.closest_point import Surface
from headcap.meshes.topology import submesh

SKIN_TRIANGLES = 7_800
EYE_CENTRES_M = np.array([[0.0315, 0.0, 0.07], [-0.0315, 0.0, 0.07]])


@pytest.fixture(scope="session")
def flame_arrays() -> dict[str, np.ndarray]:
    """FLAME's keys: 300 + 100 directions (most of them zero), posedirs of 36, joints root, neck, jaw and both eyes."""
    head, random = base_head(), np.random.default_rng(2023)
    vertices, triangles = _coarse(head)
    weights = _weights(vertices)
    eyeball = trimesh.creation.icosphere(2, radius=0.012)
    first = len(vertices)
    for side, centre in enumerate(EYE_CENTRES_M):
        triangles = np.concatenate([triangles, eyeball.faces + len(vertices)])
        vertices = np.concatenate([vertices, eyeball.vertices + centre])
        weights = np.concatenate([weights, np.tile(np.eye(5)[3 + side], (len(eyeball.vertices), 1))])
    n = len(vertices)
    shapedirs, posedirs = np.zeros((n, 3, 400), np.float32), np.zeros((n, 3, 36))
    shapedirs[:, :, :4] = random.normal(0, 1e-3, (n, 3, 4))
    shapedirs[:, :, 300:303] = random.normal(0, 1e-3, (n, 3, 3))
    posedirs[:] = random.normal(0, 1e-4, (n, 3, 36))
    regressor = np.zeros((5, n))
    for row, place in enumerate([[0, -0.19, -0.03], [0, -0.115, -0.03], [0, -0.022, 0.006], *EYE_CENTRES_M]):
        near = np.argsort(np.linalg.norm(vertices[:first] - place, axis=1))[:60] if row < 3 else first + np.arange(3)
        regressor[row, near] = 1 / len(near)
    # the neck's joint draws a little on an eyeball: what goes must be made up for
    regressor[1] *= 0.99
    regressor[1, first] = 0.01
    return {
        "v_template": vertices, "f": triangles.astype(np.uint32), "shapedirs": shapedirs, "posedirs": posedirs,
        "J_regressor": regressor, "weights": weights, "kintree_table": np.array([[2**32 - 1, 0, 1, 1, 1], range(5)], np.int64),
    }  # fmt: skip


def _coarse(head) -> tuple[np.ndarray, np.ndarray]:
    found = igl.decimate(head.vertices, head.triangles.astype(np.int64), SKIN_TRIANGLES)
    arrays = [np.asarray(part) for part in found if hasattr(part, "shape")]
    vertices, triangles = arrays[0], arrays[1].astype(np.int32)
    triangles, used = submesh(triangles, np.ones(len(triangles), bool))
    return vertices[used], triangles


def _weights(vertices: np.ndarray) -> np.ndarray:
    model = procedural_model(3, 3, np.float64)
    near = Surface(model.vertices, model.triangles).closest(vertices)
    ours = near.interpolate(model.triangles, model.skinning_weights)
    # a little of the lids follows the eyes
    lids = 0.3 * np.exp(-0.5 * (np.linalg.norm(vertices - EYE_CENTRES_M[0], axis=1) / 0.008) ** 2)
    return np.stack([ours[:, 0], ours[:, 1] * (1 - lids), ours[:, 2], ours[:, 1] * lids, np.zeros(len(ours))], axis=1)


@pytest.fixture(scope="session")
def flame_pickle(flame_arrays, tmp_path_factory) -> Path:
    """As distributed: Python 2's protocol, chumpy nodes, one of them a selection, a scipy matrix, and text."""
    path = tmp_path_factory.mktemp("flame") / "generic_model.pkl"
    content = dict(flame_arrays)
    with fake_chumpy() as (node, selection):
        content["J_regressor"] = sparse.csc_matrix(flame_arrays["J_regressor"])
        for key in ("v_template", "shapedirs"):
            content[key] = node(flame_arrays[key])
        whole = np.concatenate([flame_arrays["posedirs"].ravel(), [7.0]])
        content["posedirs"] = selection(node(whole), np.arange(whole.size - 1), flame_arrays["posedirs"].shape)
        content |= {"bs_style": "lbs", "bs_type": "lrotmin", "note": None}
        path.write_bytes(pickle.dumps(content, protocol=2))
    return path


class fake_chumpy:  # noqa: N801
    """Modules `chumpy.ch` and `chumpy.reordering` while it lasts, with classes that pickle as chumpy's do."""

    def __enter__(self):
        ch, reordering = types.ModuleType("chumpy.ch"), types.ModuleType("chumpy.reordering")
        self.names = {"chumpy": types.ModuleType("chumpy"), "chumpy.ch": ch, "chumpy.reordering": reordering}

        def make(self, x):
            self.x, self._dirty_vars = x, {"a note"}

        def select(self, a, idxs, shape):
            self.a, self.idxs, self.preferred_shape = a, idxs, shape

        ch.Ch = type("Ch", (), {"__init__": make, "__module__": "chumpy.ch"})
        reordering.Select = type("Select", (), {"__init__": select, "__module__": "chumpy.reordering"})
        sys.modules.update(self.names)
        return ch.Ch, reordering.Select

    def __exit__(self, *_):
        for name in self.names:
            del sys.modules[name]
