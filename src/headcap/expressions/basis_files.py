"""Hand-made shapes as studios keep them: a folder of meshes, glTF morph targets, USD blend shapes, head models, our own npz."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_json
from headcap.errors import InputError
from headcap.expressions.basis import KIND, QUASI_KIND, ExpressionBasis, QuasiEigenFaces
from headcap.expressions.basis_checks import BasisChecks, checked
from headcap.expressions.basis_gltf import read_gltf
from headcap.expressions.basis_usd import read_usd
from headcap.heads import HeadCoefficients, HeadModel, load_flame, load_ict
from headcap.heads.model import KIND as MODEL_KIND
from headcap.meshes.files import read_mesh
from headcap.meshes.topology import same_triangles
from headcap.registration.scan import METRES_PER

INDEX, INDEX_KIND, INDEX_SCHEMA = "shapes.json", "expression_folder", 1
MESH_SUFFIXES = (".obj", ".ply")
GLTF_SUFFIXES, USD_SUFFIXES = (".glb", ".gltf"), (".usd", ".usda", ".usdc", ".usdz")
_NEUTRAL_NAMES = ("neutral", "rest", "base", "basis", "default")
_SIZE_M = (0.02, 3.0)
"""From part of a face to a person; metres taken for millimetres, centimetres or inches are far outside."""
_MODEL_KEYS = {"v_template": load_flame, "vertices_m": load_ict}
"""What tells a head model of other makers, and its reader."""
_JAW_JOINT = 1


def read_basis(
    path: Path | str,
    *,
    neutral: Path | str | None = None,
    unit: str = "m",
    part: str | None = None,
    align: bool = False,
    checks: BasisChecks | None = None,
) -> ExpressionBasis:
    """Hand-made shapes E^H of section 3 out of whatever holds them, metres, y up.

    A folder of OBJ or PLY meshes, one per shape and named after it, whose numbers are in `unit` (m, cm, mm, in; the other
    formats tell theirs): `neutral` is the file of the neutral face or its name there, by default the one called neutral, rest,
    base, basis or default, or whose name has the word neutral in it. A glTF file with morph targets, a USD file with blend
    shapes: `part` is the name of the mesh where several have shapes. An npz of our own (basis, quasi-eigen faces), or a head
    model: ours, ICT-FaceKit's, FLAME's (see `model_basis`). Vertices keep the file's order. Shapes that are moved as a whole
    against the neutral face are brought back with `align`. Raises `InputError` or `InputErrors` for a path that is none of
    these, shapes of another topology than the neutral face (which file, which count), and as `basis_checks.checked`.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if not path.exists():
        raise InputError(f"no file or folder {path}", expected="hand-made shapes", remedy="Check the path.")
    if unit not in METRES_PER:
        raise InputError(f"unit {unit!r}", expected=f"one of {', '.join(METRES_PER)}", remedy="Name the meshes' unit.")
    if path.is_dir():
        basis, files = _read_folder(path, neutral, unit)
        return checked(_of_a_size(basis, path), label=lambda name: files[name].name, align=align, checks=checks)
    if suffix in GLTF_SUFFIXES:
        basis = read_gltf(path, part)
    elif suffix in USD_SUFFIXES:
        basis = read_usd(path, part)
    elif suffix in (".npz", ".pkl"):
        return _read_npz(path, align, checks)
    else:
        known = ", ".join((*GLTF_SUFFIXES, *USD_SUFFIXES, ".npz"))
        remedy = f"Put OBJ or PLY meshes into a folder, or export {known}."
        raise InputError(f"{path.name} as a basis", expected=f"a folder of meshes, or one of {known}", remedy=remedy)
    return checked(_of_a_size(basis, path), align=align, checks=checks)


def model_basis(model: HeadModel, identity: NDArray | None = None, *, jaw_deg: float | None = None) -> ExpressionBasis:
    """The expression basis of a head model (FLAME's components, ICT-FaceKit's shapes, learnt ones) on a person's face.

    `identity` (n, 3), metres, is the neutral face, the model's own by default: the basis is linear and the same on each. Shapes
    without a name become expression_000, expression_001... Models that open the jaw by a joint have no shape for it: `jaw_deg`
    adds jaw_open, the face with that joint turned so far. Raises `InputError` for an identity of another topology.
    """
    neutral = np.asarray(model.vertices if identity is None else identity)
    if neutral.shape != model.vertices.shape:
        raise InputError(
            f"an identity of {neutral.shape}", expected=f"{model.vertices.shape}, as {model.name}", remedy="Register it first."
        )
    names = model.expression_names or tuple(f"expression_{i:03}" for i in range(len(model.expression_basis)))
    shapes = np.asarray(model.expression_basis)
    if jaw_deg is not None:
        pose = np.zeros((2, 3))
        pose[_JAW_JOINT, 0] = np.deg2rad(jaw_deg)
        opened = model.personal(neutral).evaluate(HeadCoefficients(pose=pose)) - neutral
        names, shapes = (*names, "jaw_open"), np.concatenate([shapes, opened[None]])
    return ExpressionBasis(names, neutral, shapes, model.triangles)


def _of_a_size(basis: ExpressionBasis, path: Path) -> ExpressionBasis:
    extent = float(np.ptp(basis.neutral, axis=0).max())
    low, high = _SIZE_M
    if low <= extent <= high or not np.isfinite(extent):
        return basis
    raise InputError(
        f"the neutral face of {path.name} is {extent:.4g} m across",
        expected=f"a face, {low:g} to {high:g} m",
        remedy=f"Say which unit its numbers are in: {', '.join(METRES_PER)}.",
    )


def _read_folder(folder: Path, neutral: Path | str | None, unit: str) -> tuple[ExpressionBasis, dict[str, Path]]:
    """The basis, and the file of each shape."""
    if (folder / INDEX).is_file():
        files, rest, unit = _indexed(folder)
    else:
        files = _named_meshes(folder)
        rest = _neutral_file(folder, files, neutral)
        files = {name: file for name, file in files.items() if file.resolve() != rest.resolve()}
    vertices, triangles = read_mesh(rest)
    shapes = np.empty((len(files), *vertices.shape), np.float32)
    for shape, file in zip(shapes, files.values(), strict=True):
        found, its = read_mesh(file)
        _check_topology(file, rest, (len(found), len(its)), (len(vertices), len(triangles)), same_triangles(its, triangles))
        shape[:] = METRES_PER[unit] * (found - vertices)
    return ExpressionBasis(tuple(files), METRES_PER[unit] * vertices, shapes, triangles), files


def _check_topology(file: Path, rest: Path, found: tuple[int, int], wanted: tuple[int, int], same: bool) -> None:
    if found != wanted or not same:
        how = "" if found != wanted else ", joined in another way"
        raise InputError(
            f"{file.name} of {found[0]} vertices and {found[1]} triangles{how}",
            expected=f"{wanted[0]} and {wanted[1]}, as {rest.name}",
            remedy="Export all shapes from one mesh, without merging, splitting or reordering its vertices.",
        )


def _indexed(folder: Path) -> tuple[dict[str, Path], Path, str]:
    """Files by shape in the order told, the neutral face and the unit of a folder with an index."""
    told = load_json(folder / INDEX, INDEX_KIND, INDEX_SCHEMA)
    try:
        files = {str(entry["name"]): folder / entry["file"] for entry in told["shapes"]}
        rest, unit, count = folder / told["neutral"], told["unit"], len(told["shapes"])
    except (KeyError, TypeError) as error:
        raise InputError(
            f"{INDEX} without {error}", expected="neutral, unit and shapes (name, file)", remedy="Delete it, or write it anew."
        ) from error
    if unit not in METRES_PER or len(files) != count:
        raise InputError(
            f"{INDEX} in unit {unit!r} with {len(files)} names for {count} shapes",
            expected=f"one of {', '.join(METRES_PER)}, and each name once",
            remedy="Correct it.",
        )
    for file in (rest, *files.values()):
        if not file.is_file():
            raise InputError(f"no {file.name}, which {INDEX} names", expected="all its files", remedy=f"Correct {INDEX}.")
    return files, rest, unit


def _named_meshes(folder: Path) -> dict[str, Path]:
    found: dict[str, Path] = {}
    known: dict[str, Path] = {}
    for file in sorted(folder.iterdir()):
        if file.suffix.lower() not in MESH_SUFFIXES or file.name.startswith("."):
            continue
        other = known.setdefault(file.stem.casefold(), file)
        if other is not file:
            raise InputError(
                f"{other.name} and {file.name}", expected="one file per shape", remedy="Leave one of them out, or rename it."
            )
        found[file.stem] = file
    if not found:
        raise InputError(f"no mesh in {folder}", expected="OBJ or PLY files, one per shape", remedy="Export the shapes there.")
    return found


def _neutral_file(folder: Path, files: dict[str, Path], neutral: Path | str | None) -> Path:
    if neutral is not None:
        for file in (Path(neutral), folder / neutral, files.get(str(neutral), folder)):
            if file.is_file():
                return file
        raise InputError(f"no neutral face {neutral}", expected=f"a mesh file, or one in {folder}", remedy="Check its name.")
    called = [file for name, file in files.items() if name.casefold() in _NEUTRAL_NAMES]
    called = called or [file for name, file in files.items() if "neutral" in name.casefold()]
    if len(called) != 1:
        found = ", ".join(file.name for file in called) or f"no neutral face among the {len(files)} meshes of {folder}"
        raise InputError(
            found, expected=f"one called {' or '.join(_NEUTRAL_NAMES)}", remedy="Say which file is the neutral face."
        )
    return called[0]


def read_head_model(path: Path | str) -> HeadModel | None:
    """The head model (ours, FLAME's, ICT-FaceKit's) that a file holds, with its landmarks and regions; None where it holds none.

    Raises `InputError` for a file that cannot be read.
    """
    path = Path(path)
    if path.suffix.lower() == ".pkl":
        return load_flame(path)
    if path.suffix.lower() != ".npz":
        return None
    keys, kind = _contents(path)
    if kind == MODEL_KIND:
        return HeadModel.load(path)
    return next((load(path) for key, load in _MODEL_KEYS.items() if not kind and key in keys), None)


def _read_npz(path: Path, align: bool, checks: BasisChecks | None) -> ExpressionBasis:
    model = read_head_model(path)
    if model is not None:
        # how far a component moves at weight one is a matter of its unit
        return checked(model_basis(model), align=align, checks=checks or BasisChecks(flat_mm=0.0))
    keys, kind = _contents(path)
    if kind == QUASI_KIND:
        return checked(QuasiEigenFaces.load(path).quasi, align=align, checks=checks)
    if kind == KIND:
        return checked(ExpressionBasis.load(path), align=align, checks=checks)
    raise InputError(
        f"{path.name}, an npz of {kind or ', '.join(sorted(keys)[:6])}",
        expected="a basis, quasi-eigen faces, or a head model of ours, FLAME's or ICT-FaceKit's",
        remedy="Give the file that holds the shapes.",
    )


def _contents(path: Path) -> tuple[Iterable[str], str]:
    """Names of the arrays of an npz, and our kind where it has one."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            header = json.loads(str(archive["__header__"])) if "__header__" in archive.files else {}
            return tuple(archive.files), str(header.get("schema", "")).removeprefix("headcap.").partition("/")[0]
    except (OSError, ValueError, EOFError, TypeError, zipfile.BadZipFile) as error:
        raise InputError(f"{path.name} cannot be read ({error})", expected="a whole npz", remedy="Export it again.") from error
