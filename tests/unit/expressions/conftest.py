"""A small head and its performance, cheap enough for every test of the room."""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from headcap.geometry.transforms import from_vector


@dataclass(frozen=True)
class SmallTake:
    """An egg of a head whose lower front swings in turn with another patch, while it moves as a whole."""

    neutral: NDArray[np.float64]
    triangles: NDArray[np.int32]
    displacements: NDArray[np.float64]
    """(f, n, 3) in the head's frame."""
    meshes: NDArray[np.float64]
    """(f, n, 3) metres as recorded."""
    world_from_head: NDArray[np.float64]
    """(f, 4, 4)"""


def egg(rings: int, sectors: int) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """A closed surface of a head's size, 0.24 m high."""
    polar = np.linspace(0, np.pi, rings + 2)[1:-1]
    around = np.arange(sectors) * 2 * np.pi / sectors
    ring = np.stack(
        [
            np.outer(np.sin(polar), np.sin(around)) * 0.08,
            np.repeat(np.cos(polar)[:, None], sectors, 1) * 0.12,
            np.outer(np.sin(polar), np.cos(around)) * 0.1,
        ],
        axis=2,
    )
    vertices = np.concatenate([[[0, 0.12, 0]], ring.reshape(-1, 3), [[0, -0.12, 0]]])
    index = 1 + np.arange(rings * sectors).reshape(rings, sectors)
    right, last = np.roll(index, -1, axis=1), len(vertices) - 1
    quads = [np.stack([index[:-1], index[1:], right[1:]], 2), np.stack([index[:-1], right[1:], right[:-1]], 2)]
    caps = [
        np.stack([np.zeros_like(index[0]), index[0], right[0]], 1),
        np.stack([np.full(sectors, last), right[-1], index[-1]], 1),
    ]
    return vertices, np.concatenate([part.reshape(-1, 3) for part in [*quads, *caps]]).astype(np.int32)


@pytest.fixture(scope="session")
def small_take() -> SmallTake:
    random = np.random.default_rng(5)
    neutral, triangles = egg(14, 20)
    chin = np.clip(-neutral[:, 1] / 0.12, 0, 1) * (neutral[:, 2] > 0.03)
    cheek = np.exp(-((neutral - [0.05, 0, 0.07]) ** 2).sum(1) / 0.02**2)
    times = np.linspace(0, 3, 12)
    swing = np.stack([np.sin(times) ** 2, 1 - np.cos(2 * times)], axis=1)
    swing[0] = 0
    shapes = np.stack([chin[:, None] * [0, -0.02, 0.002], cheek[:, None] * [0.006, 0.003, 0.004]])
    displacements = np.einsum("fb,bnk->fnk", swing, shapes)
    motion = from_vector(np.hstack([0.25 * random.normal(size=(12, 3)), 0.1 * random.normal(size=(12, 3))]))
    motion[0] = np.eye(4)
    meshes = np.einsum("fij,fnj->fni", motion[:, :3, :3], neutral + displacements) + motion[:, None, :3, 3]
    return SmallTake(neutral, triangles, displacements, meshes, motion)
