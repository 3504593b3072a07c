"""`headcap animate`: files in, files out, around `headcap.neck.animation`."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import atomic_path, digest_settings, write_manifest
from headcap.errors import InputError
from headcap.neck.animation.animation import curves_of_sound, meshes_of_curves, template_of
from headcap.neck.animation.curves import CoefficientCurves
from headcap.neck.model import NeckModel
from headcap.registration.sequence import MeshSequence
from headcap.speech import SpeechRegressor, read_speech
from headcap.workflow.convert import SEQUENCE_FORMATS, TEMPLATE_SUFFIX, convert

SEQUENCE = "sequence"


@dataclass(frozen=True)
class AnimationRequest:
    """What `headcap animate` was asked for."""

    model: Path
    person: str
    regressor: Path | None = None
    sound: Path | None = None
    fps: float = 60.0
    curves: Path | None = None
    """Channels that go before what the sound says; all there is where there is no sound."""
    form: str = SEQUENCE
    """sequence, or a format of `headcap export`."""


def animate(request: AnimationRequest, target: Path) -> list[Path]:
    """Meshes and coefficient curves of a sound, of curves, or of both; returns the files written, meshes first.

    A sequence is `target` (.json), positions in .npy and its topology in .template.npz beside it; another format is written as
    `headcap export` does. Curves go beside `target` as .curves.json. Raises `InputError` for neither sound nor curves, a sound
    without a regressor, an unknown format, and as `curves_of_sound` and `meshes_of_curves`.
    """
    _check(request, target)
    model = NeckModel.load(request.model)
    curves = _curves(request, model)
    meshes = meshes_of_curves(model, request.person, curves)
    told = _curves_file(target)
    if request.form == SEQUENCE:
        written = _write_sequence(target, model, request.person, curves, meshes)
    else:
        with tempfile.TemporaryDirectory(dir=target.absolute().parent) as folder:
            sequence = Path(folder) / f"{target.stem}.json"
            _write_sequence(sequence, model, request.person, curves, meshes)
            written = [convert(sequence, target, request.form)]
    curves.save(told)
    artifacts = [told, target] if request.form == SEQUENCE else [told]
    for artifact, kind in zip(artifacts, ("coefficient_curves", "mesh_sequence"), strict=False):
        _write_manifest(artifact, kind, request)
    return [*written, told]


def _check(request: AnimationRequest, target: Path) -> None:
    if request.form not in (SEQUENCE, *SEQUENCE_FORMATS):
        known = ", ".join((SEQUENCE, *SEQUENCE_FORMATS))
        raise InputError(f"format {request.form!r}", expected=f"one of {known}", remedy="Name one of them.")
    if request.form == SEQUENCE and target.suffix != ".json":
        raise InputError(f"{target} for a sequence", expected="a file that ends in .json", remedy="Name it so, or give --format.")
    if (request.sound is None) != (request.regressor is None):
        found = "a regressor without a sound" if request.sound is None else "a sound without a regressor"
        raise InputError(found, expected="both, or curves alone", remedy="Name the regressor, then the sound.")
    if request.sound is None and request.curves is None:
        raise InputError("neither sound nor curves", expected="a regressor and a sound, or --curves", remedy="Give one of them.")
    if request.curves is not None and request.curves.absolute() == _curves_file(target).absolute():
        raise InputError(
            f"{request.curves} to read and to write", expected="another name for what comes out", remedy="Give another --out."
        )
    target.absolute().parent.mkdir(parents=True, exist_ok=True)


def _curves_file(target: Path) -> Path:
    return target.with_name(f"{target.stem}.curves.json")


def _curves(request: AnimationRequest, model: NeckModel) -> CoefficientCurves:
    given = None if request.curves is None else CoefficientCurves.load(request.curves)
    if given is not None:
        given.check_model(model.version)
    if request.sound is None:
        return given
    regressor = SpeechRegressor.load(request.regressor, model.version)
    heard = curves_of_sound(model, request.person, regressor, read_speech(request.sound)[0], request.fps)
    return heard if given is None else heard.overlaid(given)


def _write_sequence(
    target: Path, model: NeckModel, person: str, curves: CoefficientCurves, meshes: Iterable[NDArray]
) -> list[Path]:
    positions, topology = target.with_suffix(".npy"), target.with_suffix(TEMPLATE_SUFFIX)
    shape = (len(curves), *model.head.vertices.shape)
    with atomic_path(positions) as temporary:
        out = np.lib.format.open_memmap(temporary, "w+", np.float32, shape)
        first = 0
        for block in meshes:
            out[first : first + len(block)] = block
            first += len(block)
        out.flush()
        del out
    MeshSequence(target.stem, curves.time_s, (positions,)).save(target)
    if model.head.uv is None:  # a head model of another source: its sequence is exported with a template of the user's
        return [target, positions]
    template_of(model, person).save(topology)
    return [target, positions, topology]


def _write_manifest(artifact: Path, kind: str, request: AnimationRequest) -> None:
    given = (request.model, request.regressor, request.sound, request.curves)
    digest = digest_settings(person=request.person, fps=request.fps, form=request.form)
    inputs = [path for path in given if path is not None]
    write_manifest(artifact, kind=kind, stage="animate", settings_digest=digest, inputs=inputs, figures={})
