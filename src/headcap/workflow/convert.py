"""`headcap export`: which writer serves an artifact and a format."""

from __future__ import annotations

from pathlib import Path

from headcap.artifacts import ArtifactError
from headcap.calibration.result import CalibrationResult
from headcap.cameras.formats import WRITERS, write_rig
from headcap.errors import InputError
from headcap.export import write_glb, write_npz, write_obj, write_pc2
from headcap.registration.sequence import MeshSequence
from headcap.registration.template import Template

SEQUENCE_FORMATS = ("npz", "pc2", "obj", "glb")
TEMPLATE_SUFFIX = ".template.npz"
"""Of the topology that an animation writes beside its sequence."""

RIG_FORMATS = tuple(WRITERS)


def convert(source: Path, target: Path, form: str, *, template: Path | None = None) -> Path:
    """Write a rig or a mesh sequence to `target` in a format by name; returns `target`.

    obj and glb are one file per frame in the folder `target`. `template` gives the topology of a sequence; by default
    the one written beside it (`<sequence>.template.npz`, `start.npz` of a tracked take). Raises `InputError` for an unknown
    format.
    """
    if form in RIG_FORMATS:
        write_rig(CalibrationResult.load(source).rig, target, form)
        return target
    if form not in SEQUENCE_FORMATS:
        known = ", ".join(RIG_FORMATS + SEQUENCE_FORMATS)
        raise InputError(f"format {form!r}", expected=f"one of {known}", remedy="Name one of them.")
    sequence = MeshSequence.load(source)
    if form == "pc2":
        write_pc2(target, sequence)
    elif form == "npz":
        write_npz(target, _template_of(source, template), sequence)
    else:
        writer = {"obj": write_obj, "glb": write_glb}[form]
        topology = _template_of(source, template)
        for number, positions in enumerate(sequence):
            writer(target / f"frame_{number:06d}.{form}", topology, positions)
    return target


def _template_of(sequence: Path, template: Path | None) -> Template:
    beside = sequence.with_suffix(TEMPLATE_SUFFIX)
    path = template or (beside if beside.is_file() else sequence.with_name("start.npz"))
    if not path.is_file():
        raise ArtifactError(f"{path} is not there; name the template of {sequence} with --template")
    return Template.load(path)
