"""`headcap fit`: files in, files out, around `headcap.neck.fitting` and `headcap.neck.landmarks`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import digest_settings, write_manifest
from headcap.calibration.result import load_camera
from headcap.errors import InputError
from headcap.neck.animation.curves import CoefficientCurves
from headcap.neck.fitting.compensation import check_topology
from headcap.neck.fitting.sequence import COEFFICIENTS, ORDER, SequenceFitSettings, fit_sequence
from headcap.neck.fitting.temporal import TemporalPrior
from headcap.neck.landmarks.files import load_landmarks
from headcap.neck.landmarks.fitting import LandmarkSettings, fit_landmarks
from headcap.neck.model import NeckModel, NeckPerson
from headcap.registration.sequence import MeshSequence, joined

_CHANNELS = {"expression": ("psi",), "larynx": ("tau", "alpha"), "speech": ("phi",)}


@dataclass(frozen=True)
class FitRequest:
    """What `headcap fit` was asked for."""

    model: Path
    person: str
    meshes: Path | None = None
    landmarks: Path | None = None
    camera: Path | None = None
    """rig.json, for landmarks in pixels."""
    camera_name: str | None = None
    order: Sequence[str] = ORDER
    """Stages, for meshes."""
    hold: Path | None = None
    """Curves that are given and not solved for, with meshes; the others of the order are."""
    smooth_hz: float | None = None
    """Cutoff of the temporal prior, with meshes."""
    still_trunk: bool = False
    """With landmarks: the trunk stays, the neck does all that is seen."""


def fit(request: FitRequest, target: Path) -> list[str]:
    """Curves of meshes or of landmarks, written to `target` with a manifest; returns lines of what was found and what was held.

    Raises `InputError` for neither or both of meshes and landmarks, options of the one with the other, a person that the model
    does not know, a camera the rig has not, a file to read and to write, and as `fit_sequence`,
    `load_landmarks` and `fit_landmarks`.
    """
    _check(request, target)
    model = NeckModel.load(request.model)
    person = model.person(request.person)
    curves, told, figures = (_of_meshes if request.meshes else _of_landmarks)(request, model, person)
    target.absolute().parent.mkdir(parents=True, exist_ok=True)
    curves.save(target)
    given = (request.model, request.meshes, request.landmarks, request.camera, request.hold)
    digest = digest_settings(
        person=request.person, order=list(request.order), smooth_hz=request.smooth_hz, still_trunk=request.still_trunk
    )
    inputs = [path for path in given if path is not None]
    write_manifest(target, kind="coefficient_curves", stage="fit", settings_digest=digest, inputs=inputs, figures=figures)
    return told


def _of_meshes(request: FitRequest, model: NeckModel, person: NeckPerson) -> tuple[CoefficientCurves, list[str], dict]:
    sequence = MeshSequence.load(request.meshes)
    for chunk in sequence.chunks:
        check_topology(model.head, np.load(chunk, mmap_mode="r"))
    meshes = joined(sequence, len(model.head.vertices))
    held = _held(request, model, sequence.time_s)
    stages = tuple(stage for stage in request.order if not set(COEFFICIENTS[stage]) & set(held)) if held else tuple(request.order)
    temporal = None if request.smooth_hz is None else TemporalPrior(cutoff_hz=request.smooth_hz)
    settings = SequenceFitSettings(temporal=temporal)
    found = fit_sequence(model, person, meshes, stages, held, settings, time_s=sequence.time_s)
    resting = [stage for stage in ORDER if stage not in stages and not set(COEFFICIENTS[stage]) & set(held)]
    error = float(np.nanmean(found.error_mm))
    told = [
        f"{len(sequence)} frames fitted in the order {', '.join(stages)}; the neck is off by {error:.3f} mm on average",
        f"held: {', '.join(['identity', *held]) if held else 'identity'}; at rest: {', '.join(resting) or 'nothing'}",
    ]
    if found.skipped:
        told.append(f"{found.skipped} frames have no finite mesh and were filled from their neighbours")
    return found.curves(model.version), told, {"neck.error_mm": error}


def _of_landmarks(request: FitRequest, model: NeckModel, person: NeckPerson) -> tuple[CoefficientCurves, list[str], dict]:
    head = model.head.personal(person.neutral)
    camera = load_camera(request.camera, request.camera_name) if request.camera else None
    landmarks = load_landmarks(request.landmarks, head, camera)
    settings = LandmarkSettings(trunk="still" if request.still_trunk else "moving")
    found = fit_landmarks(head, landmarks, settings)
    unit, scale = ("px", 1.0) if landmarks.flat else ("mm", 1e3)
    error = scale * float(np.nanmean(found.distance))
    solved = min(settings.expressions, len(head.expression_basis))
    trunk = "is still" if request.still_trunk else "moves"
    told = [
        f"{len(landmarks)} frames fitted to {len(landmarks.points)} landmarks; they are off by {error:.3f} {unit} on average",
        f"solved for: pose, placement and {solved} of {len(head.expression_basis)} expression coefficients",
        f"held: identity; at rest: larynx, speech, the other expressions; the trunk {trunk}",
    ]
    if not found.told.all():
        told.append(f"{int((~found.told).sum())} frames show too few landmarks and were bridged")
    return found.curves(model.version, request.person), told, {f"landmarks.distance_{unit}": error}


def _held(request: FitRequest, model: NeckModel, time_s: NDArray) -> dict[str, NDArray]:
    """What the curves to hold say at the sequence's moments, counted from its first frame, as `fit_sequence` takes it."""
    if request.hold is None:
        return {}
    curves = CoefficientCurves.load(request.hold)
    curves.check_model(model.version)
    curves = curves.at(time_s - time_s[0])
    given, held, f = curves.channels, {}, len(time_s)
    if curves.placement is not None or {"neck", "jaw"} & set(given):
        held["theta"] = np.stack([given.get(joint, np.zeros((f, 3))) for joint in ("neck", "jaw")], axis=1)
        held["placement"] = np.tile(np.eye(4), (f, 1, 1)) if curves.placement is None else curves.placement
    for names in _CHANNELS.values():
        if set(names) & set(given):
            rest = {"alpha": np.ones(f), "tau": np.zeros(f)}
            held |= {name: given[name] if name in given else rest[name] for name in names}
    return held


def _check(request: FitRequest, target: Path) -> None:
    given = [name for name in ("meshes", "landmarks") if getattr(request, name) is not None]
    if len(given) != 1:
        found = "neither meshes nor landmarks" if not given else "meshes and landmarks"
        raise InputError(found, expected="one of both", remedy="Give --meshes or --landmarks.")
    wrong = {
        "meshes": {"--camera": request.camera, "--camera-name": request.camera_name, "--still-trunk": request.still_trunk},
        "landmarks": {
            "--hold": request.hold,
            "--smooth": request.smooth_hz,
            "--order": None if tuple(request.order) == ORDER else request.order,
        },
    }[given[0]]
    for option, value in wrong.items():
        if value:
            raise InputError(f"{option} with {given[0]}", expected=f"options of {given[0]}", remedy=f"Leave {option} out.")
    if request.camera_name and not request.camera:
        raise InputError("--camera-name without --camera", expected="the rig that has it", remedy="Give --camera rig.json.")
    unknown = [stage for stage in request.order if stage not in ORDER]
    if unknown or not request.order:
        raise InputError(
            f"stage {unknown[0]!r}" if unknown else "no stage", expected=f"some of {', '.join(ORDER)}", remedy="Correct --order."
        )
    if target.suffix != ".json":
        raise InputError(f"{target} for curves", expected="a file that ends in .json", remedy="Name it so.")
    for path in (request.model, request.meshes, request.landmarks, request.camera, request.hold):
        if path is not None and path.absolute() == target.absolute():
            raise InputError(f"{target} to read and to write", expected="another file to write", remedy="Give another --out.")
