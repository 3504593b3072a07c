"""Evaluating the whole head model, larynx included, against the same formulas in plain numpy, one frame after the other.

138 blendshapes (100 expressions, 18 pose correctives, 20 of speech) over the base head's 13 thousand vertices. Limits: 1 ms per
frame in batches; 50 us for the larynx kernel with derivatives over 3,000 vertices.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from run import measure, write

from headcap.geometry.rotations import rotation_matrices
from headcap.heads import HeadCoefficients, HeadModel, procedural_model
from headcap.neck import LarynxMap, build_chart, larynx_map
from headcap.neck import larynx as larynx_module

FRAMES, PEER_FRAMES, KERNEL_VERTICES, KERNEL_CALLS = 512, 32, 3000, 2000


def run(out_path: Path) -> None:
    """Measure batches, single frames, the pose derivative and the larynx kernel; check that both ways give one head."""
    random = np.random.default_rng(11)
    model = _model(random)
    chart = build_chart(model)
    larynx = larynx_map(model, chart, np.array([0.0, -0.2, 1.0]))
    larynx = larynx.with_weights(random.normal(0, 1e-3, larynx.weights_m.shape))
    frames = HeadCoefficients(
        expression=random.normal(size=(FRAMES, 100)),
        pose=random.normal(0, 0.2, (FRAMES, 2, 3)),
        speech=random.normal(size=(FRAMES, 20)),
    )
    tau = random.uniform(-0.02, 0.02, FRAMES)
    ours = lambda: model.evaluate(frames, larynx.offset(tau, 1.1))  # noqa: E731
    found = ours()  # compiles
    ours_took = _per_thousand(measure(ours, repeats=5), FRAMES)
    theirs = lambda: np.stack([_plain(model, frames, larynx, tau, f) for f in range(PEER_FRAMES)])  # noqa: E731
    difference_mm = 1e3 * np.abs(theirs() - found[:PEER_FRAMES]).max()
    if difference_mm > 1e-2:
        raise AssertionError(f"the two ways differ by {difference_mm:.3g} mm")
    one = HeadCoefficients(expression=frames.expression[0], pose=frames.pose[0], speech=frames.speech[0])
    write(
        out_path,
        ours=ours_took | {"name": "1,000 frames in batches", "vertices": len(model.vertices), "blendshapes": 138},
        peer=_per_thousand(measure(theirs, repeats=3), PEER_FRAMES) | {"name": "1,000 in numpy, frame by frame"},
        figures={
            "ms_per_frame": ours_took["cpu_seconds"],
            "ms_single_frame": 50 * measure(lambda: [model.evaluate(one) for _ in range(20)], repeats=3)["cpu_seconds"],
            "ms_pose_derivative_1000_vertices": _derivative_ms(model, one),
            "us_larynx_kernel_3000_vertices": _kernel_us(larynx, random),
            "difference_mm": float(difference_mm),
            "chart_mean_stretch": chart.distortion.mean_stretch,
            "chart_p99_stretch": chart.distortion.p99_stretch,
        },
    )


def _model(random: np.random.Generator) -> HeadModel:
    model = procedural_model()
    n = len(model.vertices)
    pose, speech = (random.normal(0, 1e-3, (count, n, 3)).astype(np.float32) for count in (18, 20))
    return replace(model, pose_basis=pose, speech_basis=speech)


def _plain(model: HeadModel, frames: HeadCoefficients, larynx: LarynxMap, tau: np.ndarray, f: int) -> np.ndarray:
    """Equations 4 and 5 as they stand."""
    turns = rotation_matrices(frames.pose[f])
    rest = model.vertices + np.tensordot(frames.expression[f].astype(np.float32), model.expression_basis, 1)
    rest += np.tensordot((turns - np.eye(3)).ravel().astype(np.float32), model.pose_basis, 1)
    rest += np.tensordot(frames.speech[f].astype(np.float32), model.speech_basis, 1)
    rest[larynx.vertices] += (larynx.sampling_matrix(tau[f]) @ larynx.weights_m.ravel())[:, None] * 1.1 * larynx.direction
    neck, jaw = model.joints()
    skull = (rest - neck) @ turns[0].T + neck
    chin = ((rest - jaw) @ turns[1].T + jaw - neck) @ turns[0].T + neck
    return np.einsum("nb,bnk->nk", model.skinning_weights, np.stack([rest, skull, chin]))


def _kernel_us(larynx: LarynxMap, random: np.random.Generator) -> float:
    uv = random.uniform(larynx.uv_m.min(0), larynx.uv_m.max(0), (KERNEL_VERTICES, 2))
    many = replace(larynx, vertices=np.arange(KERNEL_VERTICES), uv_m=uv, window=np.ones(KERNEL_VERTICES))
    out = np.empty((3, 1, KERNEL_VERTICES, 3))
    profiles, slide, scale = many._profiles, np.array([3.3]), np.ones(1)
    kernel = lambda: larynx_module._offset(*profiles, slide, many.pitch_m, scale, many.direction, *out)  # noqa: E731
    kernel()
    took = measure(lambda: [kernel() for _ in range(KERNEL_CALLS)], repeats=3)
    return 1e6 * took["cpu_seconds"] / KERNEL_CALLS


def _derivative_ms(model: HeadModel, one: HeadCoefficients) -> float:
    chosen = np.linspace(0, len(model.vertices) - 1, 1000).astype(int)
    model.pose_derivative(one, vertices=chosen)
    took = measure(lambda: [model.pose_derivative(one, vertices=chosen) for _ in range(10)], repeats=3)
    return 100 * took["cpu_seconds"]


def _per_thousand(took: dict[str, float], frames: int) -> dict[str, float]:
    return {key: 1000 * value / frames for key, value in took.items()}
