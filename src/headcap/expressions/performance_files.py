"""A performance out of mesh sequences: frames checked, head motion removed, displacements from the neutral face (section 5.2).

Shapes of a basis belong to the whole head's mesh, so its topology is kept whole; what is no face moves by pose and not by
expression (the neck bends, ears and scalp are tracked poorly), so displacements fade to none beyond the face's region. Inside
it they are untouched.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy.sparse.csgraph import dijkstra

from headcap.errors import InputError
from headcap.expressions.head_motion import displaced_frames, find_still, fit_rigid_frames, moved_frames
from headcap.expressions.mesh_frames import MeshFrames
from headcap.expressions.neutral_face import NeutralFace, Unit, check_size, metres_per, neutral_face
from headcap.expressions.performance import BLOCK, Performance
from headcap.expressions.sequence_files import read_mesh_frames
from headcap.registration.graph import edge_graph
from headcap.registration.template import Template

_FACE = ("face", "lips_upper", "lips_lower", "lips_inner_upper", "lips_inner_lower", "mouth_interior", "eyes", "lid_rims")
_NEVER_STILL = ("neck", "larynx", *_FACE[1:])


class PerformanceSettings(BaseModel):
    """How the head's motion is told from expression, and where expression ends."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    still_share: float = Field(
        0.2,
        gt=0,
        le=1,
        description="Share of the head's vertices (no neck, lips, eyes) that is taken for what holds still. With more of them "
        "more moving skin is among them: a head rotation errs by 0.012, 0.03, 0.05 and 0.08 degrees with 0.1, 0.2, 0.3 "
        "and 0.5",
    )
    sample_frames: int = Field(64, ge=2, description="Frames, evenly spread, in which what holds still is looked for")
    fade_mm: float = Field(
        40.0,
        ge=0,
        description="Displacements fade to none over so much skin beyond the face; within 20 mm an open jaw folds the skin below",
    )
    farthest_neutral_mm: float = Field(
        5.0,
        gt=0,
        description="The frame most like the neutral face may differ from it by so much, rms over the face; past it the mesh "
        "given is not this performer's neutral",
    )


def read_performance(
    source: Path | Sequence[Path],
    *,
    neutral: Path | NDArray | Template | None = None,
    triangles: NDArray | None = None,
    unit: Unit = "m",
    rate_hz: float = 30.0,
    region: str | NDArray[np.bool_] | None = None,
    still: NDArray[np.bool_] | None = None,
    prim: str | None = None,
    settings: PerformanceSettings | None = None,
) -> Performance:
    """Displacements from the neutral face of a mesh sequence, or of several one after another, without the head's motion.

    `source`: a mesh sequence of ours (JSON manifest), npy (f, n, 3), PC2, a folder of OBJ or PLY (or the files), USD. `unit` is
    that of npy, PC2, OBJ and PLY; our sequences are metres and USD tells its own. `rate_hz` times what holds no times.
    `neutral`: a template (or its npz) or positions (n, 3) in metres, or a mesh file in `unit`; without one the first frame is
    v^0, which `source` of the result says. `triangles` (m, 3) where neither the neutral nor the source holds them.
    `region` is a mask (n,) or a name among the template's; without one the face of a template that names it, else the whole mesh.
    `still` (n,) marks what holds still, where the search over the skull (a template's), or over the whole mesh, is not wanted.
    `prim` chooses among a USD file's animated meshes. The rigid motion of each frame is computed once and kept; `blocks` reads
    frames anew.

    Raises `InputError` for files that cannot be read or differ in topology, frames that are not finite, sizes that are no head's
    and a neutral that no frame comes near.
    """
    settings = settings or PerformanceSettings()
    frames = read_mesh_frames(source, rate_hz, prim)
    scale = 1.0 if frames.in_metres else metres_per(unit)
    check_size(frames.positions[0:1][0] * scale, f"the first frame of {frames.source}", None if frames.in_metres else unit)
    face = neutral_face(frames, scale, neutral, triangles, unit)
    held = _mask(still, face) if still is not None else None
    weights = face_weights(face, region, settings.fade_mm)
    weights = np.ones(len(face.vertices), np.float32) if weights is None else weights
    motion, found = _head_motion(frames, scale, face, held, settings)
    blocks = _Blocks(frames, scale, motion, face.vertices, weights)
    found |= _compare_with_neutral(blocks, face, frames.source, settings)
    told = f"{frames.source} (neutral: {face.source})"
    return Performance(
        face.vertices, face.triangles, blocks, np.asarray(frames.time_s, float), told, regions=face.regions, figures=found
    )


def _mask(mask: NDArray, face: NeutralFace) -> NDArray[np.bool_]:
    mask = np.asarray(mask)
    if mask.shape != (len(face.vertices),) or mask.dtype != bool or not mask.any():
        raise InputError(
            f"a mask of shape {mask.shape} and type {mask.dtype} with {int(np.count_nonzero(mask))} vertices",
            expected=f"true or false for each of the {len(face.vertices)} vertices, some true",
            remedy="Make the mask for the performance's own topology.",
        )
    return mask


def face_weights(face: NeutralFace, region: str | NDArray | None, fade_mm: float) -> NDArray[np.float32] | None:
    """(n,) share of the displacement that counts, for a mask (n,) or a region by name, the face's where none is named.

    None where all of it does: no region named and none known. Raises `InputError` for unknown names and masks that do not fit.
    """
    if isinstance(region, str):
        if region not in face.regions:
            raise InputError(
                f"no region {region}",
                expected=", ".join(sorted(face.regions)) or "a template with regions",
                remedy="Name another.",
            )
        region = face.regions[region]
    if region is None:
        if "face" not in face.regions:
            return None
        region = np.any([face.regions[name] for name in _FACE if name in face.regions], axis=0)
    return fade_beyond(face.vertices, face.triangles, _mask(region, face), fade_mm)


def fade_beyond(vertices: NDArray, triangles: NDArray, mask: NDArray[np.bool_], fade_mm: float) -> NDArray[np.float32]:
    """(n,) one inside a mask (n,), smoothly down to zero over `fade_mm` of skin beyond it (3 s^2 - 2 s^3)."""
    reach = max(1e-3 * fade_mm, 1e-9)
    away = dijkstra(edge_graph(vertices, triangles), indices=np.flatnonzero(mask), min_only=True, limit=reach)
    share = np.clip(1 - away / reach, 0, 1)
    return (share * share * (3 - 2 * share)).astype(np.float32)


def _head_motion(
    frames: MeshFrames, scale: float, face: NeutralFace, held: NDArray[np.bool_] | None, settings: PerformanceSettings
) -> tuple[NDArray[np.float64], dict[str, float]]:
    """neutral_from_frame (f, 4, 4), and the figures of it; all frames are read once and must be finite."""
    if held is None:
        candidates = _candidates(face)
        chosen = np.unique(np.linspace(0, len(frames) - 1, settings.sample_frames).astype(int))
        sample = np.asarray(frames.positions[chosen])[:, candidates] * scale
        good = np.isfinite(sample).all(axis=(1, 2))
        still = candidates
        if good.any():
            still = candidates[find_still(sample[good], face.vertices[candidates], settings.still_share)[0]]
    else:
        still = np.flatnonzero(held)
    target, motion, squared, broken = face.vertices[still], [], 0.0, []
    for first in range(0, len(frames), BLOCK):
        block = np.asarray(frames.positions[first : first + BLOCK])
        finite = np.isfinite(block).all(axis=(1, 2))
        broken.append(first + np.flatnonzero(~finite))
        points = np.where(finite[:, None, None], block[:, still], 0) * scale
        motion.append(fit_rigid_frames(points, target))
        squared += float(((moved_frames(motion[-1], points) - target) ** 2)[finite].sum())
    _refuse_broken(frames, np.concatenate(broken))
    rms_mm = 1e3 * np.sqrt(squared / (len(frames) * len(still)))
    return np.concatenate(motion), {"still_vertices": float(len(still)), "still_residual_mm": float(rms_mm)}


def _candidates(face: NeutralFace) -> NDArray[np.int64]:
    """Vertices among which what holds still is looked for: of a template the skull's skin, else all that triangles use."""
    allowed = np.zeros(len(face.vertices), bool)
    allowed[face.triangles.ravel()] = True
    for name in face.regions.keys() & set(_NEVER_STILL):
        allowed &= ~face.regions[name]
    return np.flatnonzero(allowed)


def _refuse_broken(frames: MeshFrames, broken: NDArray) -> None:
    if len(broken):
        raise InputError(
            f"{frames.source}: {len(broken)} of {len(frames)} frames have positions that are no numbers: {frames.called(broken)}",
            expected="finite positions in every frame",
            remedy="Leave these frames out or repair them; a performance is never shortened silently.",
        )


class _Blocks:
    """Displacements (f, n, 3) block by block, read anew at each call."""

    def __init__(self, frames: MeshFrames, scale: float, motion: NDArray, neutral: NDArray, weights: NDArray[np.float32]) -> None:
        self._frames, self._scale, self._motion, self._neutral, self.weights = frames, scale, motion, neutral, weights

    def __call__(self) -> Iterator[NDArray[np.float32]]:
        for first in range(0, len(self._frames), BLOCK):
            block = self._frames.positions[first : first + BLOCK]
            yield displaced_frames(block, self._scale, self._motion[first : first + BLOCK], self._neutral, self.weights)


def _compare_with_neutral(blocks: _Blocks, face: NeutralFace, source: str, settings: PerformanceSettings) -> dict[str, float]:
    """How near the performance comes to its neutral; refuses a neutral that no frame comes near, saying where it is off."""
    counted = float(blocks.weights.sum())
    per_frame, total = [], np.zeros(face.vertices.shape)
    for block in blocks():
        rows = block.reshape(len(block), -1)
        per_frame.append(np.sqrt(np.einsum("fx,fx->f", rows, rows) / counted))
        total += block.sum(axis=0, dtype=np.float64)
    rms_mm = 1e3 * np.concatenate(per_frame)
    nearest = int(rms_mm.argmin())
    if rms_mm[nearest] > settings.farthest_neutral_mm:
        offset = _where(1e3 * np.linalg.norm(total / len(rms_mm), axis=1), face)
        raise InputError(
            f"frame {nearest} of {source}, the one most like the neutral ({face.source}), is {rms_mm[nearest]:.1f} mm rms from "
            f"it; over all frames the offset is largest {offset}",
            expected=f"a frame within {settings.farthest_neutral_mm:g} mm of the face at rest",
            remedy="Give this performer's face at rest as neutral, or the take's calmest frame.",
        )
    return {
        "nearest_to_neutral_mm": float(rms_mm[nearest]),
        "nearest_frame": float(nearest),
        "displacement_rms_mm": float(np.sqrt((rms_mm**2).mean())),
    }


def _where(offset_mm: NDArray, face: NeutralFace) -> str:
    vertex = int(offset_mm.argmax())
    regions = [name for name, mask in face.regions.items() if mask[vertex]]
    place = f" ({', '.join(regions)})" if regions else ""
    return f"at vertex {vertex}{place}: {offset_mm[vertex]:.1f} mm"
