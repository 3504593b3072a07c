"""Expression bases for other programs: a folder of OBJ files, glTF morph targets, USD blend shapes, npz."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.export.gltf_shapes import write_gltf_shapes
from headcap.export.usd_shapes import write_usd_shapes
from headcap.expressions.basis import ExpressionBasis
from headcap.expressions.basis_files import INDEX, INDEX_KIND, INDEX_SCHEMA
from headcap.expressions.weight_curves import WeightCurves

NEUTRAL = "neutral"


def write_basis(path: Path | str, basis: ExpressionBasis, curves: WeightCurves | None = None) -> None:
    """Write a basis in the form that the path's ending names; `basis_files.read_basis` reads each back.

    .glb (morph targets), .usd, .usda, .usdc (blend shapes), .npz (`headcap.expression_basis/1`), or no ending: a folder of OBJ
    files. `curves` become an animation of a .glb or USD file, and are refused otherwise. Metres, y up, vertices in the basis'
    order; nothing is there before all is written. Raises `InputError` for another ending.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".glb":
        return write_gltf_shapes(path, basis, curves)
    if suffix in (".usd", ".usda", ".usdc"):
        return write_usd_shapes(path, basis, curves)
    if curves is not None:
        raise InputError(f"weights in {path.name}", expected="a .glb or USD file", remedy="Write them as CSV or JSON.")
    if suffix == ".npz":
        return basis.save(path)
    if suffix:
        known = ".glb, .usd, .usda, .usdc, .npz, or no ending for a folder of OBJ files"
        raise InputError(f"{path.name} as a basis", expected=known, remedy="Name it so.")
    return write_obj_set(path, basis)


def write_obj_set(folder: Path | str, basis: ExpressionBasis) -> None:
    """Write a folder of `neutral.obj`, one OBJ per shape, and `shapes.json` that tells names, order and unit (metres).

    Positions have nine digits, which hold any float32. A shape's file bears its name, letters that file systems refuse replaced.
    A folder that this wrote before is replaced whole. Raises `InputError` where something else is in the way.
    """
    files = _file_names(basis.names)
    faces = "".join(f"f {a} {b} {c}\n" for a, b, c in (basis.triangles + 1).tolist())
    neutral = basis.neutral.astype(np.float64)
    with _atomic_folder(Path(folder)) as temporary:
        (temporary / f"{NEUTRAL}.obj").write_text(_vertex_lines(neutral) + faces)
        for file, displacement in zip(files, basis.displacements, strict=True):
            (temporary / file).write_text(_vertex_lines(neutral + displacement) + faces)
        shapes = [{"name": name, "file": file} for name, file in zip(basis.names, files, strict=True)]
        index = {"schema": f"headcap.{INDEX_KIND}/{INDEX_SCHEMA}", "neutral": f"{NEUTRAL}.obj", "unit": "m", "shapes": shapes}
        (temporary / INDEX).write_text(json.dumps(index, indent=1) + "\n")


def _vertex_lines(positions: NDArray) -> str:
    return "".join(f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in positions.tolist())


def _file_names(names: tuple[str, ...]) -> list[str]:
    """A file for each shape, none like another where case does not count."""
    taken, out = {NEUTRAL}, []
    for name in names:
        plain = re.sub(r"[^\w.()+-]+", "_", name).strip(". ") or "shape"
        file, number = plain, 1
        while file.casefold() in taken:
            number += 1
            file = f"{plain}_{number}"
        taken.add(file.casefold())
        out.append(f"{file}.obj")
    return out


@contextmanager
def _atomic_folder(folder: Path) -> Iterator[Path]:
    """A temporary folder beside, which takes the folder's place once all in it is on the disk."""
    if folder.exists() and not (folder / INDEX).is_file() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder} holds something else", expected="a new or an empty folder", remedy="Name another folder.")
    folder.parent.mkdir(parents=True, exist_ok=True)
    temporary, old = (folder.with_name(f".{folder.name}.{os.getpid()}.{kind}") for kind in ("tmp", "old"))
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir()
    try:
        yield temporary
        for file in temporary.iterdir():
            with file.open("rb+") as handle:
                os.fsync(handle.fileno())
        if folder.exists():
            folder.rename(old)
        temporary.rename(folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)
