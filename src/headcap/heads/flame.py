"""FLAME 2020, 2023 and 2023 Open (Li et al. 2017) from the user's own file, brought to the neck model's form.

The paper, section 3: the eyeballs and their joints go, face and front neck are subdivided, K = 2 joints stay.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from headcap.errors import InputError
from headcap.heads.anatomy import find_anatomy, profile_landmarks
from headcap.heads.archive import read_npz
from headcap.heads.model import POSE_FEATURES, HeadModel
from headcap.heads.refinement import WANTED_VERTICES, refine_front
from headcap.heads.rigging import joint_regressor
from headcap.heads.safe_pickle import load_pickled_arrays
from headcap.meshes.topology import vertex_components

_KEYS = ("v_template", "f", "shapedirs", "posedirs", "J_regressor", "weights")
_ROOT, _NECK, _JAW, _EYES = 0, 1, 2, (3, 4)
"""Columns of FLAME's joints."""
_MASK_NAMES = {"face": "face", "neck": "neck", "scalp": "scalp", "left_ear": "ears", "right_ear": "ears"}
"""FLAME's mask file to our regions; its face and scalp overlap others, `_known_regions` sorts that out."""


class FlameSettings(BaseModel):
    """What of FLAME the model keeps."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    shapes: int = Field(300, ge=0, description="Leading shape directions kept")
    expressions: int = Field(100, ge=0, description="Leading expression directions kept")
    first_expression: int = Field(300, ge=0, description="Where in shapedirs the expressions begin")
    wanted_vertices: int = Field(
        WANTED_VERTICES, ge=0, description="Subdivide face and front neck to about so many; 0: not at all"
    )


def load_flame(
    path: Path | str,
    *,
    masks: Path | str | None = None,
    texture: Path | str | None = None,
    settings: FlameSettings | None = None,
) -> HeadModel:
    """A FLAME file (.pkl as distributed, or .npz with the same keys) as a head model, float32, metres.

    `masks` is FLAME's file of vertex masks (FLAME_masks.pkl): with it face, neck, ears and scalp are the authors' own and the
    mouth is found by its lips, else they are carried over from the base head by its profile. `texture` is its file with texture
    coordinates (an npz with `vt` and `ft`), without which the model has none. Pickles are read by a whitelist. Raises
    `InputError` where a file is none of these.
    """
    settings = settings or FlameSettings()
    path = Path(path)
    arrays = _read(path)
    _check(arrays, path, settings)
    model = _assembled(arrays, path.stem, settings)
    kept = ~_eyeballs(arrays)
    lists = {name: _mask(listed, len(kept)) for name, listed in (_read(Path(masks)) if masks is not None else {}).items()}
    if texture is not None:
        model = _textured(model, Path(texture))
    model = model.part(kept)
    lists = {name: mask[kept] for name, mask in lists.items()}
    anchors = profile_landmarks(model.vertices) | _mouth_anchors(lists.get("lips"), model.vertices)
    anatomy = find_anatomy(model.vertices, model.triangles, anchors, _known_regions(lists))
    model = replace(model, regions=anatomy.regions, landmarks=anatomy.landmarks)
    if settings.wanted_vertices:
        model = refine_front(model, settings.wanted_vertices)
    return model.astype(np.float32)


def flame_root(path: Path | str, shape: NDArray, settings: FlameSettings | None = None) -> NDArray[np.float64]:
    """(3,) metres: the root joint J_0 of a FLAME file for beta (s,), about which FLAME's global rotation turns the whole head.

    `load_flame` leaves it out, since a placement takes its part: v = R (v - J_0) + J_0 + t (Li et al. 2017, eq. 2 and 3). Raises
    `InputError` where the file is no FLAME model.
    """
    path, settings = Path(path), settings or FlameSettings()
    arrays = _read(path)
    _check(arrays, path, settings)
    directions = np.asarray(arrays["shapedirs"], np.float64)[..., : min(len(shape), settings.first_expression)]
    neutral = np.asarray(arrays["v_template"], np.float64) + directions @ np.asarray(shape, np.float64)[: directions.shape[-1]]
    return np.asarray(arrays["J_regressor"], np.float64)[_ROOT] @ neutral


def _read(path: Path) -> dict[str, NDArray]:
    if not path.is_file():
        raise InputError(f"no file {path}", expected="a FLAME file", remedy="FLAME is licensed: download it from its site.")
    if path.suffix != ".npz":
        return load_pickled_arrays(path)
    return read_npz(path, expected="an npz of plain arrays", remedy="Export it without objects.")


def _check(arrays: dict[str, NDArray], path: Path, settings: FlameSettings) -> None:
    missing = [key for key in _KEYS if key not in arrays]
    if missing:
        raise InputError(
            f"{path.name} lacks {', '.join(missing)}",
            expected="a FLAME model file",
            remedy="Give the model, not its masks or texture.",
        )
    n = len(arrays["v_template"])
    directions = settings.first_expression + settings.expressions
    shapes = {
        "v_template": (n, 3),
        "f": (len(arrays["f"]), 3),
        "shapedirs": (n, 3, max(arrays["shapedirs"].shape[-1], directions)),
        "posedirs": (n, 3, max(arrays["posedirs"].shape[-1], POSE_FEATURES)),
        "J_regressor": (5, n),
        "weights": (n, 5),
    }
    for key, shape in shapes.items():
        if arrays[key].shape != shape or not np.isfinite(arrays[key]).all():
            raise InputError(
                f"{key} of {path.name} is {arrays[key].shape}",
                expected=f"{shape}, finite: FLAME with five joints and {directions} directions",
                remedy="Use FLAME 2020, 2023 or 2023 Open; for fewer directions set them in the settings.",
            )


def _assembled(arrays: dict[str, NDArray], name: str, settings: FlameSettings) -> HeadModel:
    """FLAME with the eyes' bones folded into the neck's, which they hang on, and their correctives left out."""
    vertices = np.ascontiguousarray(arrays["v_template"], np.float64)
    directions = np.asarray(arrays["shapedirs"], np.float64).transpose(2, 0, 1)
    first = settings.first_expression
    weights = np.asarray(arrays["weights"], np.float64)
    neck = weights[:, _NECK] + weights[:, _EYES].sum(axis=1)
    skinning = np.stack([weights[:, _ROOT], neck, weights[:, _JAW]], axis=1)
    joints = np.asarray(arrays["J_regressor"], np.float64)[[_NECK, _JAW]]
    return HeadModel(
        name=name,
        vertices=vertices,
        triangles=np.ascontiguousarray(arrays["f"], np.int32),
        shape_basis=np.ascontiguousarray(directions[: min(settings.shapes, first)]),
        expression_basis=np.ascontiguousarray(directions[first : first + settings.expressions]),
        pose_basis=np.ascontiguousarray(np.asarray(arrays["posedirs"], np.float64)[..., :POSE_FEATURES].transpose(2, 0, 1)),
        speech_basis=np.zeros((0, *vertices.shape)),
        joint_regressor=_without(joints, _eyeballs(arrays), vertices),
        skinning_weights=skinning / skinning.sum(axis=1, keepdims=True),
    )


def _eyeballs(arrays: dict[str, NDArray]) -> NDArray[np.bool_]:
    """(n,) pieces of the mesh that follow the eyes' joints altogether."""
    labels = vertex_components(np.asarray(arrays["f"], np.int32), len(arrays["v_template"]))
    follows = np.asarray(arrays["weights"])[:, _EYES].sum(axis=1)
    share = np.bincount(labels, follows) / np.bincount(labels)
    return share[labels] > 0.9


def _without(regressor: NDArray, gone: NDArray[np.bool_], vertices: NDArray) -> NDArray[np.float64]:
    """The regressor (K, n) on what stays: where it drew on the rest it is mended by least change, the joints stay put."""
    out = np.where(gone, 0.0, regressor)
    joints = regressor @ vertices
    for row, joint, old in zip(out, joints, regressor, strict=True):
        support = row != 0
        if not support.any() or np.abs(old[gone]).max(initial=0.0) == 0.0:
            continue
        conditions = np.concatenate([np.ones((1, support.sum())), (vertices[support] - joint).T])
        lacking = np.array([1.0, 0.0, 0.0, 0.0]) - conditions @ row[support]
        row[support] += np.linalg.lstsq(conditions, lacking, rcond=None)[0]
    empty = ~(out != 0).any(axis=1)
    if empty.any():
        near = np.stack([~gone & (np.linalg.norm(vertices - joint, axis=1) < 0.08) for joint in joints])
        out[empty] = joint_regressor(vertices, joints, near)[empty]
    return out


def _mask(listed: NDArray, n: int) -> NDArray[np.bool_]:
    mask = np.zeros(n, bool)
    mask[np.asarray(listed).astype(np.int64)] = True
    return mask


def _known_regions(masks: dict[str, NDArray]) -> dict[str, NDArray[np.bool_]]:
    """Our regions from FLAME's masks (n,); a vertex belongs to the first of neck, ears, scalp, face that has it."""
    found: dict[str, NDArray] = {}
    taken = np.zeros(len(next(iter(masks.values()))), bool) if masks else None
    for theirs in ("neck", "left_ear", "right_ear", "scalp", "face"):
        if theirs in masks:
            ours = _MASK_NAMES[theirs]
            found[ours] = found.get(ours, False) | (masks[theirs] & ~taken)
            taken = taken | masks[theirs]
    return found


def _mouth_anchors(lips: NDArray[np.bool_] | None, vertices: NDArray) -> dict[str, int]:
    """The mouth's corners and the lips' outer edges on the midline, from the mask of the lips (n,)."""
    if lips is None:
        return {}
    inside = np.flatnonzero(lips)
    x = vertices[inside, 0]
    middle = inside[np.abs(x) < 0.06 * np.ptp(x)]
    found = {"mouth_corner_left": inside[x.argmax()], "mouth_corner_right": inside[x.argmin()]}
    if len(middle):
        ends = vertices[middle, 1]
        found |= {"lip_upper_top": middle[ends.argmax()], "lip_lower_bottom": middle[ends.argmin()]}
    return {name: int(at) for name, at in found.items()}


def _textured(model: HeadModel, path: Path) -> HeadModel:
    arrays = _read(path)
    if "vt" not in arrays or "ft" not in arrays or arrays["ft"].shape != model.triangles.shape:
        raise InputError(
            f"{path.name} holds {', '.join(sorted(arrays))[:80]}",
            expected=f"vt (k, 2) and ft {model.triangles.shape}",
            remedy="Give FLAME's texture coordinates (FLAME_texture.npz).",
        )
    # FLAME's v points up, a Template's down
    uv = np.asarray(arrays["vt"], np.float64) * [1.0, -1.0] + [0.0, 1.0]
    return replace(model, uv=uv, uv_triangles=np.ascontiguousarray(arrays["ft"], np.int32))
