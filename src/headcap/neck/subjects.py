"""The people of a study: neutral head and takes of each, in the head model's topology and read as they are needed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.calibration.result import CalibrationResult
from headcap.cameras import Rig
from headcap.errors import InputError
from headcap.geometry.transforms import fit_rigid, transform
from headcap.heads import HeadModel
from headcap.meshes.normals import vertex_normals
from headcap.meshes.visibility import count_cameras
from headcap.neck.training_subject import TrainingSubject
from headcap.registration.sequence import JoinedMeshes, MeshSequence, joined
from headcap.registration.template import Template

LEAST_CAMERAS, MOST_ANGLE_DEG = 2, 75.0
"""What so many cameras see, no more obliquely than this, was tracked and not made up."""


@dataclass(frozen=True)
class SubjectFiles:
    """Where one person's neutral head and tracked takes lie."""

    name: str
    template: Path
    sequences: dict[str, Path]
    """Mesh sequences by take."""
    kinds: dict[str, str]
    """What the person does, by take."""
    rig: Path | None = None
    """Result of calibrate, which tells what cameras saw; None where the meshes come from elsewhere."""

    def load(self, model: HeadModel) -> NeckSubject:
        """The person in the frame of a head model; raises `InputError` as `NeckSubject.of`, and `ArtifactError`."""
        sequences = {take: MeshSequence.load(path) for take, path in self.sequences.items()}
        rig = CalibrationResult.load(self.rig).rig if self.rig else None
        return NeckSubject.of(model, self.name, Template.load(self.template), sequences, self.kinds, rig)


@dataclass(frozen=True, eq=False)
class NeckTake:
    """One take of f frames."""

    name: str
    kind: str
    """What the person does: pose, expression, speech, lips or free."""
    time_s: NDArray[np.float64]
    """(f,) on the take's common clock."""
    meshes: NDArray | JoinedMeshes
    """(f, n, 3) metres, in any frame of the room; frames that are not finite were not tracked."""


@dataclass(frozen=True, eq=False)
class NeckSubject:
    """One person of a study."""

    name: str
    neutral: NDArray[np.float64]
    """(n, 3) metres, in the head model's frame: neutral pose, neutral expression, silent."""
    takes: tuple[NeckTake, ...]
    seen: NDArray[np.bool_] | None = None
    """(n,) what cameras saw; None where all was, as in rehearsed meshes."""

    @classmethod
    def of(
        cls,
        model: HeadModel,
        name: str,
        template: Template,
        sequences: Mapping[str, MeshSequence],
        kinds: Mapping[str, str],
        rig: Rig | None = None,
    ) -> NeckSubject:
        """From a registered template and tracked takes by name; what the cameras of `rig` do not see tells nothing.

        Raises `InputError` where the template is not in the model's topology.
        """
        neutral = neutral_in_model_frame(model, template)
        seen = seen_vertices(rig, next(iter(sequences.values())), template.triangles) if rig and sequences else None
        takes = tuple(
            NeckTake(take, kinds[take], sequence.time_s, joined(sequence, len(neutral))) for take, sequence in sequences.items()
        )
        return cls(name, neutral, takes, seen)

    def of_kind(self, *kinds: str) -> tuple[NeckTake, ...]:
        """The takes of some kinds."""
        return tuple(take for take in self.takes if take.kind in kinds)

    def meshes(self, *kinds: str) -> JoinedMeshes:
        """All frames of takes of some kinds, in order."""
        return JoinedMeshes([take.meshes for take in self.of_kind(*kinds)], len(self.neutral))

    def training_subject(self) -> TrainingSubject:
        """Pose and expression takes, as section 5.1 trains on them."""
        return TrainingSubject(self.name, self.neutral, self.meshes("pose"), self.meshes("expression"), self.seen)

    def personal(self, model: HeadModel) -> HeadModel:
        """The model of this person."""
        return model.personal(self.neutral.astype(model.vertices.dtype), name=f"{model.name} of {self.name}")


def neutral_in_model_frame(model: HeadModel, template: Template) -> NDArray[np.float64]:
    """(n, 3) the template's vertices, moved rigidly so that scalp and ears lie on the model's.

    Raises `InputError` for another topology.
    """
    if not np.array_equal(model.triangles, template.triangles):
        raise InputError(
            f"a template of {len(template.vertices)} vertices",
            expected=f"the topology of {model.name}, {len(model.vertices)} vertices",
            remedy="Register the scan with this version's base head.",
        )
    steady = model.regions["scalp"] | model.regions["ears"]
    head_from_world = fit_rigid(template.vertices[steady], np.asarray(model.vertices, float)[steady])
    return transform(head_from_world, template.vertices)


def seen_vertices(rig: Rig, take: MeshSequence, triangles: NDArray) -> NDArray[np.bool_]:
    """(n,) vertices that two cameras at least see where a take begins."""
    mesh = next(iter(take)).astype(float)
    normals = vertex_normals(mesh, triangles)
    return count_cameras(rig, mesh, triangles, mesh, normals, max_angle_deg=MOST_ANGLE_DEG) >= LEAST_CAMERAS
