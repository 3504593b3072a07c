"""Refining a model's face and front neck to a wanted number of vertices (paper, section 3: 13,232)."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from headcap.heads.model import HeadModel
from headcap.heads.regions import with_neck_regions
from headcap.meshes.subdivision import subdivide_butterfly
from headcap.meshes.topology import mesh_edges

WANTED_VERTICES = 13_232


def refine_front(model: HeadModel, wanted_vertices: int = WANTED_VERTICES) -> HeadModel:
    """The model with its front neck, then its face, then the rest from front to back, split by modified butterfly subdivision.

    Triangles are taken in that order as long as the vertices stay within the wanted number: any base comes out with about as
    many. (The paper's 13,232 are 3.4 times FLAME's skin: its "face and front neck" is most of the head.) A model that is large
    enough already is returned as it is; the front neck is split in any other.
    """
    if len(model.vertices) >= 0.95 * wanted_vertices:
        return model
    order = _priority(model)
    needed = _split_edges(model.triangles, order)
    neck = order == 0
    room = wanted_vertices - len(model.vertices)
    last = np.searchsorted(np.sort(needed[~neck]), room, side="right") if (~neck).any() else 0
    threshold = np.sort(order[~neck])[last - 1] if last else 0.0
    finer = model.subdivided(subdivide_butterfly(model.triangles, len(model.vertices), order <= threshold))
    # on smaller triangles the larynx region follows its outline better, and its border is one of their rings
    larynx, neck_joint = finer.vertices[finer.landmarks["larynx"]], finer.joints()[0]
    regions = with_neck_regions(finer.vertices, finer.triangles, finer.regions, larynx, neck_joint)
    return replace(finer, regions=regions)


def _priority(model: HeadModel) -> NDArray[np.float64]:
    """(m,) 0 for the front neck, up to 2 outwards over the face, 3 and more elsewhere."""
    corners = model.triangles
    centre = model.joints()[1] * [0.0, 1.0, 1.0]
    away = model.vertices[corners].mean(axis=1) - centre
    # forward and slightly down: the mouth and the eyes come before the forehead
    forward = np.array([0.0, -0.2, 1.0]) / np.hypot(0.2, 1.0)
    facing = 1.0 - away @ forward / np.maximum(np.linalg.norm(away, axis=1), 1e-9)
    moving = model.regions["face"] | model.regions["lips_inner"] | model.regions.get("mouth_interior", False)
    face = moving[corners].all(axis=1)
    neck = model.regions["front_neck"][corners].all(axis=1)
    return np.where(neck, 0.0, np.where(face, 1e-3 + facing, 3.0 + facing))


def _split_edges(triangles: NDArray, order: NDArray) -> NDArray[np.int64]:
    """(m,) how many edges are split once all triangles up to this one in order are taken."""
    edges = mesh_edges(triangles)
    sides = np.where(edges.triangles >= 0, order[edges.triangles], np.inf).min(axis=1)
    return np.searchsorted(np.sort(sides), order, side="right")
