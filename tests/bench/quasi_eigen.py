"""Quasi-eigen faces at the paper's size: 6,000 frames of 13,232 vertices, 53 hand-made shapes.

The frames lie in a file that is memory-mapped, as tracked sequences do. The peer is scikit-learn's exact decomposition of the
same matrix (`svd_solver="full"`), held in memory. The paper took 158 minutes for its 6,000 frames and 7 ms per weight solve.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from sklearn.decomposition import PCA

sys.path.insert(0, str(Path(__file__).parent))
from run import measure, peak_memory_gib, write

from headcap.expressions import Eigenfaces, ExpressionBasis, Performance
from headcap.expressions.hyperplane import spanning_axes
from headcap.expressions.performance import in_memory
from headcap.expressions.principal import eigenfaces
from headcap.expressions.projection import quasi_eigen_faces
from headcap.expressions.weights import ExpressionSolver

FRAMES, VERTICES, SHAPES = 6_000, 13_232, 53
MODES, DECAY, NOISE_M = 60, 0.9, 1e-4
"""Motion whose standard deviations fall by a tenth from mode to mode, and what a tracker adds to it."""
SOLVED, BLOCK = 600, 200
SOLVERS = {
    "free": {},
    "smooth": {"smoothing": 0.5},
    "non_negative": {"bounds": (0.0, np.inf)},
    "box": {"bounds": (0.0, 1.0)},
    "box_smooth": {"bounds": (0.0, 1.0), "smoothing": 0.5},
    "box_smooth_sparse": {"bounds": (0.0, 1.0), "smoothing": 0.5, "sparsity": 0.05},
}
NO_TRIANGLES = np.zeros((0, 3), np.int32)


def run(out_path: Path) -> None:
    """Measure and write."""
    with tempfile.TemporaryDirectory() as folder:
        path, kept = Path(folder) / "frames.npy", {}
        true = _perform(path)
        frames = np.load(path, mmap_mode="r").reshape(FRAMES, VERTICES, 3)
        performance = Performance(true.neutral, NO_TRIANGLES, in_memory(frames), np.arange(FRAMES) / 60, "bench")

        def decompose() -> None:
            kept["eigen"] = eigenfaces(performance)

        ours, memory = measure(decompose), peak_memory_gib()
        figures = _projection(true, kept["eigen"]) | _weights(true, frames[:SOLVED])
        matrix = np.load(path)
        peer = measure(lambda: kept.update(peer=PCA(n_components=len(kept["eigen"]), svd_solver="full").fit(matrix)))
    eigen, exact = kept["eigen"], kept["peer"]
    # scikit-learn divides by one frame less than eq. 2
    variances = exact.explained_variance_ * (FRAMES - 1) / FRAMES
    write(
        out_path,
        ours={"name": "streamed principal axes", **ours},
        peer={"name": "scikit-learn PCA, full", **peer, "peak_memory_gib": peak_memory_gib()},
        figures={
            "frames": FRAMES,
            "vertices": VERTICES,
            "eigenfaces": len(eigen),
            "coverage": float(eigen.coverage[-1]),
            "variance_difference": float(np.abs(eigen.variances / variances - 1).max()),
            "subspace_cosine": float(np.linalg.svd(eigen.rows @ exact.components_.T)[1].min()),
            **figures,
        },
        memory_gib=memory,
    )


def _perform(path: Path) -> ExpressionBasis:
    """Frames written block by block; the shapes that a person of this performance would be given."""
    random = np.random.default_rng(5)
    modes = random.normal(size=(MODES, 3 * VERTICES)).astype(np.float32)
    spread = 1e-3 * DECAY ** np.arange(MODES)
    rates, phases = random.uniform(1, 30, MODES), random.uniform(0, 6.3, MODES)
    out = np.lib.format.open_memmap(path, "w+", np.float32, (FRAMES, 3 * VERTICES))
    for first in range(0, FRAMES, BLOCK):
        time_s = np.arange(first, first + BLOCK) / 60
        weights = (0.5 + np.sin(np.outer(time_s, rates) + phases)) * spread
        noise = random.standard_normal((BLOCK, 3 * VERTICES), dtype=np.float32)
        out[first : first + BLOCK] = weights.astype(np.float32) @ modes + np.float32(NOISE_M) * noise
    out.flush()
    # shapes overlap as sculpted ones do, and miss the modes by a fifth
    mixing = (np.eye(SHAPES, MODES) + 0.5 * np.eye(SHAPES, MODES, 1)) * spread
    made = mixing.astype(np.float32) @ modes
    missed = made + 0.2 * made.std() * random.standard_normal(made.shape, dtype=np.float32)
    names = [f"shape {index}" for index in range(SHAPES)]
    return ExpressionBasis(names, random.normal(0, 0.1, (VERTICES, 3)), missed.reshape(SHAPES, VERTICES, 3), NO_TRIANGLES)


def _projection(hand: ExpressionBasis, eigen: Eigenfaces) -> dict[str, float]:
    took = measure(lambda: quasi_eigen_faces(hand, spanning_axes(hand, eigen)), repeats=3)
    local = measure(lambda: quasi_eigen_faces(hand, eigen, locality=1.0))
    return {"basis_s": took["seconds"], "basis_cpu_s": took["cpu_seconds"], "local_basis_cpu_s": local["cpu_seconds"]}


def _weights(hand: ExpressionBasis, frames: np.ndarray) -> dict[str, float]:
    """Milliseconds per frame from displacements to weights: products of frames with the shapes are counted."""
    figures, frames = {}, np.array(frames)
    for name, settings in SOLVERS.items():
        solver = ExpressionSolver(hand, **settings)
        # compiled and its memory touched before it is measured
        solver.solve(frames[:4])
        took = measure(lambda solver=solver: solver.solve(frames), repeats=3)
        figures[f"weights_{name}_ms_per_frame"] = 1e3 * took["seconds"] / len(frames)
        figures[f"weights_{name}_cpu_ms_per_frame"] = 1e3 * took["cpu_seconds"] / len(frames)
    return figures
