"""Performances of a head whose true shapes are known: the ICT rig's takes, and an animator's speech on its mouth, jaw and cheeks.

All are on the rig's own neutral face (another identity than ICT-FaceKit's), of which the neck is left out: it follows the head's
turns and the larynx, which no expression spans. Expressions are the same displacements on every identity.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.evaluation.truth import Truth
from headcap.expressions import ExpressionBasis, Performance
from headcap.expressions.performance import BLOCK, in_memory
from headcap.geometry.transforms import fit_rigid, transform
from headcap.heads.ict import load_ict

RIG_TAKES = ("expression_01", "speech_01", "pose_01")
FACE = 9409
"""The first vertices of ICT-FaceKit's skin are the face; the back of the head and the neck follow them."""
STILL_ABOVE_M = 0.02
"""Over the height of the eyes, what no expression moves is skull."""

SIGNALS: dict[str, tuple[int, int]] = {
    "jawOpen": (63, 0), "jawForward": (63, 2), "jawLeft": (64, 1), "jawRight": (64, 3),
    "mouthClose": (74, 3), "mouthFunnel": (64, 0), "mouthPucker": (74, 0), "mouthLeft": (64, 2), "mouthRight": (64, 4),
    "mouthRollLower": (63, 4), "mouthRollUpper": (74, 2), "mouthShrugLower": (63, 3), "mouthShrugUpper": (74, 4),
    "mouthSmile_L": (42, 0), "mouthSmile_R": (43, 1), "mouthDimple_L": (44, 2), "mouthDimple_R": (45, 3),
    "mouthUpperUp_L": (59, 0), "mouthUpperUp_R": (60, 1), "mouthLowerDown_L": (59, 2), "mouthLowerDown_R": (60, 3),
    "mouthFrown_L": (79, 2), "mouthFrown_R": (80, 0), "mouthPress_L": (75, 0), "mouthPress_R": (76, 1),
    "mouthStretch_L": (77, 2), "mouthStretch_R": (78, 3),
    "cheekPuff_L": (63, 1), "cheekPuff_R": (74, 1), "cheekSquint_L": (79, 3), "cheekSquint_R": (80, 4),
}  # fmt: skip
"""Mouth, jaw and cheek shapes: a channel of the animator's weights, and by how many takes it is ahead of the others.

The animator gave left and right, and whole groups of channels, the same weights at all times. A performance like that cannot
tell such shapes apart, so each has a moment of its own: the timing is real, who does what at once is not.
"""
MIRRORED: dict[str, tuple[int, int]] = {
    "jawOpen": (63, 0), "mouthFunnel": (64, 0), "mouthPucker": (74, 0),
    "mouthSmile_L": (42, 0), "mouthSmile_R": (43, 0), "mouthDimple_L": (44, 0), "mouthDimple_R": (45, 0),
    "mouthUpperUp_L": (59, 0), "mouthUpperUp_R": (60, 0), "mouthPress_L": (75, 0), "mouthPress_R": (76, 0),
    "mouthStretch_L": (77, 0), "mouthStretch_R": (78, 0), "cheekSquint_L": (79, 0), "cheekSquint_R": (80, 0),
}  # fmt: skip
"""The same as the animator did it: both sides alike, all at their own moment."""


@dataclass(frozen=True, eq=False)
class KnownFace:
    """The rig's subject: true shapes on its neutral face."""

    basis: ExpressionBasis
    regions: dict[str, NDArray[np.bool_]]
    skull: NDArray[np.int64]
    """(s,) vertices that no expression moves."""
    neutral_skull: NDArray[np.float64]
    """(s, 3) metres."""
    truth: Truth


def known_face(data: Path) -> KnownFace:
    """The face of the test data's rig, 9,409 vertices, and ICT-FaceKit's 53 true shapes."""
    head, truth = load_ict(data / "ict_head", wanted_vertices=0), Truth(data / "ict_rig" / "truth")
    triangles = head.triangles[(head.triangles < FACE).all(axis=1)]
    neutral = truth.take(RIG_TAKES[0]).frame(0)
    still = (np.abs(head.expression_basis).max(axis=(0, 2)) < 1e-5) & (head.vertices[:, 1] > STILL_ABOVE_M)
    skull = np.flatnonzero(still)
    regions = {name: head.regions[name][:FACE] for name in ("face", "eyes", "lips_upper", "lips_lower")}
    basis = ExpressionBasis(head.expression_names, neutral[:FACE], head.expression_basis[:, :FACE], triangles)
    return KnownFace(basis, regions, skull, neutral[skull], truth)


def rig_take(face: KnownFace, name: str) -> Performance:
    """A take of the rig, its head's motion removed by the skull."""
    take = face.truth.take(name)
    out = np.empty((len(take), FACE, 3), np.float32)
    for frame in range(len(take)):
        mesh = take.frame(frame)
        rest_from_head = fit_rigid(mesh[face.skull], face.neutral_skull)
        out[frame] = transform(rest_from_head, mesh[:FACE]) - face.basis.neutral
    return _performance(face, in_memory(out), take.time_s, name)


def animated(face: KnownFace, weights: NDArray, time_s: NDArray, source: str) -> Performance:
    """Frames (l, 53) of weights of the true shapes: inside their span exactly."""
    rows = face.basis.rows

    def blocks():
        for first in range(0, len(weights), BLOCK):
            part = weights[first : first + BLOCK].astype(np.float32)
            yield (part @ rows).reshape(len(part), -1, 3)

    return _performance(face, blocks, time_s, source)


def animator_weights(
    data: Path, names: tuple[str, ...], signals: dict[str, tuple[int, int]], step: int = 1
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Weights (l, 53) of the shapes, and moments (l,): five takes at 30 fps one after the other, every `step`-th frame."""
    takes = [np.load(path) for path in sorted((data / "speech" / "facegood").glob("*.npz"))]
    length = min(len(take["weights"]) for take in takes)
    out = np.zeros((len(takes) * length, len(names)))
    for name, (channel, ahead) in signals.items():
        turned = takes[ahead:] + takes[:ahead]
        out[:, names.index(name)] = np.concatenate([_signal(take, channel)[:length] for take in turned])
    return out[::step], np.arange(len(out))[::step] / float(takes[0]["fps"])


def thinned(performance: Performance, basis: ExpressionBasis, every: int) -> tuple[Performance, ExpressionBasis]:
    """The same of every so manieth vertex, as points without triangles."""
    points = slice(None, None, every)
    nothing = np.zeros((0, 3), np.int32)

    def blocks():
        for block in performance.blocks():
            yield np.ascontiguousarray(block[:, points])

    return (
        Performance(performance.neutral[points], nothing, blocks, performance.time_s, performance.source),
        ExpressionBasis(basis.names, basis.neutral[points], basis.displacements[:, points], nothing),
    )


def _signal(take: np.lib.npyio.NpzFile, channel: int) -> NDArray:
    at = np.flatnonzero(take["channel"] == channel)
    return take["weights"][:, at[0]] if len(at) else np.zeros(len(take["weights"]))


def _performance(face: KnownFace, blocks, time_s: NDArray, source: str) -> Performance:
    return Performance(face.basis.neutral, face.basis.triangles, blocks, time_s, source, regions=face.regions)
