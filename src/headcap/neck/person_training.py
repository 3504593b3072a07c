"""One person's neck model from tracked speech takes: pose and expression off (eq. 7), then Algorithm 1 (section 5.2)."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from headcap.cameras import Rig
from headcap.errors import InputError
from headcap.geometry.transforms import fit_rigid, transform
from headcap.heads import HeadCoefficients, HeadModel, procedural_model
from headcap.meshes.normals import vertex_normals
from headcap.meshes.visibility import count_cameras
from headcap.neck.chart import build_chart
from headcap.neck.compensation import BLOCK, Compensation, FitSettings, compensate, without_expressions
from headcap.neck.fits import NeckFits, TakeFit
from headcap.neck.larynx import LarynxSettings, larynx_map
from headcap.neck.model import NeckPerson
from headcap.neck.speech_basis import in_blocks
from headcap.neck.speech_fitting import SpeechFit, spread
from headcap.neck.speech_training import SpeechSubject, SpeechTraining, SpeechTrainingSettings, train_speech
from headcap.registration.sequence import MeshSequence
from headcap.registration.template import Template

LEAST_CAMERAS, MOST_ANGLE_DEG = 2, 75.0
"""What so many cameras see, no more obliquely than this, was tracked and not made up."""
FORWARD = np.array([0.0, 0.0, 1.0])
"""Direction of an empty larynx map: eq. 9 replaces it."""


class NeckTrainingSettings(BaseModel):
    """A person's neck model from speech takes."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    expressions: int = Field(100, ge=0, description="Expression blendshapes that are taken off speech takes; 0: pose alone")
    fit: FitSettings = Field(default_factory=FitSettings)
    larynx: LarynxSettings = Field(default_factory=LarynxSettings)
    speech: SpeechTrainingSettings = Field(default_factory=SpeechTrainingSettings)


def train_person(
    name: str,
    template: Template,
    takes: Mapping[str, MeshSequence],
    settings: NeckTrainingSettings | None = None,
    *,
    rig: Rig | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> tuple[SpeechTraining, NeckFits]:
    """Neck model and fitted coefficients of one person from their speech takes, by name.

    `template` is the person's neutral head in the topology of the base head, metres, in any frame. What the cameras of `rig` do
    not see tells no pose: a tracker makes it up. Fewer frames than Algorithm 1 needs for all its blendshapes train fewer. Raises
    `InputError` for no takes, too few frames, or another topology.
    """
    settings = settings or NeckTrainingSettings()
    if not takes:
        raise InputError(
            "no speech take", expected="one at least", remedy="Record speech; its kind in the session file is speech."
        )
    model = person_model(template, settings.expressions)
    seen = None if rig is None else seen_vertices(rig, next(iter(takes.values())), template.triangles)
    rests = {take: compensate(model, sequence.positions(), settings.fit, seen=seen) for take, sequence in takes.items()}
    meshes = np.concatenate([rest.meshes for rest in rests.values()])
    empty = larynx_map(model, build_chart(model), FORWARD, settings.larynx)
    subject = SpeechSubject(name, np.asarray(model.vertices, float), meshes)
    training = train_speech(model, empty, [subject], _affordable(settings.speech, len(meshes)), progress=progress)
    return training, _fits(training, name, takes, rests)


def person_model(template: Template, expressions: int) -> HeadModel:
    """The procedural head model with a person's neutral head in place of its own; raises `InputError` for another topology."""
    model = procedural_model(0, max(expressions, 1))
    model = model if expressions else without_expressions(model)
    if not np.array_equal(model.triangles, template.triangles):
        raise InputError(
            f"a template of {len(template.vertices)} vertices",
            expected=f"the base head's topology of {len(model.vertices)} vertices",
            remedy="Register the scan with this version's base head.",
        )
    steady = model.regions["scalp"] | model.regions["ears"]
    head_from_world = fit_rigid(template.vertices[steady], np.asarray(model.vertices, float)[steady])
    return model.personal(transform(head_from_world, template.vertices).astype(model.vertices.dtype), name="person")


def seen_vertices(rig: Rig, take: MeshSequence, triangles: NDArray) -> NDArray[np.bool_]:
    """(n,) vertices that two cameras at least see where a take begins."""
    mesh = next(iter(take)).astype(float)
    normals = vertex_normals(mesh, triangles)
    return count_cameras(rig, mesh, triangles, mesh, normals, max_angle_deg=MOST_ANGLE_DEG) >= LEAST_CAMERAS


def _affordable(settings: SpeechTrainingSettings, frames: int) -> SpeechTrainingSettings:
    """As many iterations as twice the frames for each blendshape allow."""
    most = frames // (2 * settings.growth)
    return settings.model_copy(update={"iterations": max(1, min(settings.iterations, most))})


def _fits(training: SpeechTraining, name: str, takes: Mapping[str, MeshSequence], rests: Mapping[str, Compensation]) -> NeckFits:
    """Coefficients and errors of each take."""
    whole, first, found = training.fits[name], 0, []
    person, head = training.model.person(name), training.model.head
    neck = np.flatnonzero(head.regions["neck"])
    for take, rest in rests.items():
        speech = whole.frames(slice(first, first + len(rest.meshes)))
        first += len(rest.meshes)
        before = _error_mm(rest.meshes[:, neck] - np.asarray(head.vertices)[neck])
        after = _error_mm(rest.meshes[:, neck] - _spoken(head, person, speech, neck))
        found.append(TakeFit(take, takes[take].time_s, speech, rest.theta, rest.psi, rest.placement, before, after))
    return NeckFits(name, tuple(found))


def _spoken(head: HeadModel, person: NeckPerson, speech: SpeechFit, chosen: NDArray) -> NDArray[np.float64]:
    """(f, k, 3) of eq. 7 at chosen vertices; NaN where the frame was not fitted."""
    own, parts = head.personal(person.base.astype(head.vertices.dtype)), []
    known = SpeechFit(*(values[speech.known] for values in (speech.tau_m, speech.alpha, speech.phi)))
    for block in in_blocks(len(known.tau_m), BLOCK):
        part = known.frames(block)
        rest = own.rest(HeadCoefficients(speech=part.phi), person.larynx.offset(part.tau_m, part.alpha))
        parts.append(rest[:, chosen])
    return spread(np.concatenate(parts), speech.known)


def _error_mm(away: NDArray) -> NDArray[np.float64]:
    return 1e3 * np.linalg.norm(away, axis=2).mean(axis=1)
