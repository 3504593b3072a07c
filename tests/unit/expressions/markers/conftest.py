"""A synthetic person with 66 markers on the face and 7 on the head (section 5.1), and what a capture system would see of them."""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra

from headcap.expressions.markers import MarkerTake
from headcap.geometry.transforms import from_vector
from headcap.heads import base_head
from headcap.meshes.normals import vertex_normals
from headcap.registration import Template
from headcap.registration.graph import edge_graph
from headcap.synthetic.mesh_takes import mesh_subject

RATE_HZ, FACE_MARKERS, STAND_OFF_M, NOISE_M = 60.0, 66, 0.003, 1e-4


@dataclass(frozen=True)
class MarkedPerson:
    head: Template
    face: NDArray[np.int64]
    """(66,) vertices under the face's markers."""
    displacements: NDArray[np.float32]
    """(f, n, 3) true, from the first frame."""
    head_positions: NDArray[np.float64]
    """(f, 73, 3) true markers in the head's frame, the head's 7 first."""
    capture_from_head: NDArray[np.float64]
    """(f, 4, 4)"""
    take: MarkerTake
    """As captured, with noise, without gaps."""
    noise_m: float = NOISE_M
    rate_hz: float = RATE_HZ

    @property
    def rigid(self) -> tuple[str, ...]:
        return self.take.names[:7]

    @property
    def lips(self) -> NDArray[np.bool_]:
        regions = self.head.regions
        return np.any([regions[f"lips_{side}"] for side in ("upper", "lower", "inner_upper", "inner_lower")], axis=0)


def face_markers(head: Template, count: int) -> NDArray[np.int64]:
    """Farthest points on the skin of the face from landmarks on, denser about mouth and eyes, none on the lips' seam."""
    graph, regions = edge_graph(head.vertices, head.triangles), head.regions

    def away(mask):
        return dijkstra(graph, indices=np.flatnonzero(mask), min_only=True)

    seam = away(regions["lips_inner_upper"] | regions["lips_inner_lower"])
    density = 1 + 1.5 * np.exp(-((away(regions["lips_upper"] | regions["lips_lower"]) / 0.02) ** 2))
    density += 0.8 * np.exp(-((away(regions["lid_rims"]) / 0.025) ** 2))
    skin = regions["face"] & ~regions["lid_rims"] & (seam > 0.004) & (head.vertices[:, 2] > -0.01) & (head.vertices[:, 1] > -0.12)
    marks = ("nose_tip", "mouth_corner_left", "mouth_corner_right", "lip_upper_top", "lip_lower_bottom", "chin", "glabella")
    chosen = [head.landmarks[name] for name in marks]
    nearest = dijkstra(graph, indices=chosen, min_only=True)
    while len(chosen) < count:
        chosen.append(int(np.argmax(np.where(skin, nearest * density, -1))))
        nearest = np.minimum(nearest, dijkstra(graph, indices=chosen[-1]))
    return np.array(chosen)


@pytest.fixture(scope="session")
def person() -> MarkedPerson:
    subject, frames = mesh_subject(3), 120
    spoken = subject.take("speech", frames, RATE_HZ).states
    calm = [{key: 0 if key.startswith(("turn", "larynx")) else value for key, value in state.items()} for state in spoken]
    meshes = np.array([subject.mesh(state) for state in calm])
    head = base_head().with_vertices(meshes[0])
    face = face_markers(head, FACE_MARKERS)
    band = np.flatnonzero(head.regions["scalp"])[::300][:7]
    marked = np.concatenate([band, face])
    normals = vertex_normals(head.vertices, head.triangles)
    positions = meshes[:, marked] + STAND_OFF_M * normals[marked]
    times = np.arange(frames) / RATE_HZ
    motion = from_vector(
        np.stack([0.3 * np.sin(2 * times), 0.2 * np.sin(times), 0.1 * times, 0.05 * np.sin(times), 0.03 * times, 0.02 * times], 1)
    )
    capture = from_vector(np.array([1.2, 0.7, -2.0, 3.0, 1.0, 0.5])) @ motion
    seen = np.einsum("fij,fkj->fki", capture[:, :3, :3], positions) + capture[:, None, :3, 3]
    seen += NOISE_M * np.random.default_rng(8).normal(size=seen.shape)
    names = tuple([f"head{k}" for k in range(7)] + [f"m{k}" for k in range(FACE_MARKERS)])
    return MarkedPerson(
        head, face, (meshes - meshes[0]).astype(np.float32), positions, capture, MarkerTake(names, seen, times, "synthetic")
    )
