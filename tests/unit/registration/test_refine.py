"""The fine refinement minimises data plus prior, and fills what is not seen smoothly."""

import numpy as np

from headcap.registration.conjugate_gradient import conjugate_gradient
from headcap.registration.photometric import Normal
from headcap.registration.refine import Refiner, RefineSettings


def _grid(n: int = 15, step: float = 0.004) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(np.arange(n) * step, np.arange(n) * step)
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    triangles = np.concatenate([np.stack([a, a + 1, a + n + 1], 1), np.stack([a, a + n + 1, a + n], 1)]).astype(np.int32)
    return np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3), triangles


def test_solution_solves_the_normal_equations(rng):
    vertices, triangles = _grid()
    n = len(vertices)
    factor = rng.normal(size=(n, 3, 3))
    full = 1e7 * np.einsum("nij,nkj->nik", factor, factor)
    blocks = full[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    normal = Normal(blocks, 1e4 * rng.normal(size=(n, 3)), 0.0)
    refiner = Refiner(vertices, triangles, RefineSettings(solver_tolerance=1e-8, solver_iterations=500))
    start = rng.normal(0, 1e-4, (n, 3))
    update = refiner.solve(normal, start)
    left = refiner.prior @ (start + update) + np.einsum("nij,nj->ni", full, update) - normal.right
    assert np.abs(left).max() < 1e-4 * np.abs(normal.right).max()


def test_unseen_middle_follows_its_surroundings():
    vertices, triangles = _grid()
    n = len(vertices)
    centre = vertices.mean(0)
    seen = np.linalg.norm(vertices - centre, axis=1) > 0.012
    target = 1e-3 * (1 + 5 * (vertices[:, :1] - centre[0])) * [0, 0, 1]
    blocks = np.zeros((n, 6))
    blocks[np.ix_(seen, [0, 3, 5])] = 1e9
    normal = Normal(blocks, np.where(seen[:, None], 1e9 * target, 0.0), 0.0)
    update = Refiner(vertices, triangles, RefineSettings()).solve(normal, np.zeros((n, 3)))
    # a plane bends nowhere: the prior on stretch and displacement alone keeps the hole from following it exactly
    assert np.abs(update - target).max() < 1e-4


def test_conjugate_gradient_says_when_it_gave_up(rng):
    a = rng.normal(size=(30, 30))
    matrix, right = a @ a.T + np.eye(30), rng.normal(size=30)
    solution, done = conjugate_gradient(matrix.__matmul__, np.copy, right, 1e-10, 200)
    assert done
    assert np.allclose(matrix @ solution, right, atol=1e-6)
    assert not conjugate_gradient(matrix.__matmul__, np.copy, right, 1e-10, 2)[1]
