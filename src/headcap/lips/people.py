"""The people of a study as files: what one camera made of their takes, and what is true of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.calibration.result import load_camera
from headcap.errors import InputError
from headcap.heads import HeadModel
from headcap.lips.clips import ClipFiles
from headcap.lips.contours import ContourSequence
from headcap.lips.correction import TrueNeutral
from headcap.lips.monocular import MonocularTrack
from headcap.lips.takes import MouthSpace, SeenTake
from headcap.registration.face_correspondence import NeutralFace, correspond
from headcap.registration.sequence import MeshSequence, joined
from headcap.registration.template import Template

_SAME_MOMENT_S = 1e-6


@dataclass(frozen=True)
class LipTakeFiles:
    """One take."""

    name: str
    kind: str
    """What the person does: lips, speech, expression or free."""
    clip: ClipFiles
    track: Path
    """Of the base tracker."""
    contours: Path
    sequence: Path
    """True meshes."""


@dataclass(frozen=True)
class LipPersonFiles:
    """One person."""

    name: str
    template: Path
    """The true neutral head."""
    takes: tuple[LipTakeFiles, ...]

    def load(self, space: MouthSpace, contours: bool = True) -> LipPerson:
        """All takes; without `contours` as if none had been found.

        Raises `InputError` for heads of another topology and takes whose moments differ, and `ArtifactError`.
        """
        neutral = Template.load(self.template).vertices
        if neutral.shape != space.model.vertices.shape:
            raise InputError(
                f"{self.name}: a template of {len(neutral)} vertices",
                expected=f"the {len(space.model.vertices)} of {space.model.name}",
                remedy="Register the scan with this version's base head.",
            )
        placing = _Placing(space, np.asarray(neutral, np.float64))
        return LipPerson(self.name, neutral, {files.name: _load_take(files, space, placing, contours) for files in self.takes})


@dataclass(frozen=True, eq=False)
class LipPersonTake:
    """One take and its truth."""

    kind: str
    seen: SeenTake
    time_s: NDArray[np.float64]
    """(f,)"""
    neutral: TrueNeutral
    """H_0, registered with what the base tracker believes in this take (section 4.1)."""
    sequence: MeshSequence
    frames: NDArray[np.int64]
    """(f,) of the sequence that show the same moments."""

    def truth(self) -> Iterator[NDArray[np.float32]]:
        """True meshes (n, 3), metres, in the sequence's world, frame by frame from memory maps."""
        meshes = joined(self.sequence, len(self.seen.neutral))
        yield from (meshes[frame : frame + 1][0] for frame in self.frames)

    def true_meshes(self) -> NDArray[np.float32]:
        """All of them, (f, n, 3)."""
        return joined(self.sequence, len(self.seen.neutral))[self.frames]


@dataclass(frozen=True, eq=False)
class LipPerson:
    """One person's takes."""

    name: str
    neutral: NDArray[np.float64]
    """H_0 (n, 3) metres."""
    takes: dict[str, LipPersonTake]


def registered_neutral(model: HeadModel, base_neutral: NDArray, truth_neutral: NDArray) -> TrueNeutral:
    """H_0 (n, 3) and where the skin of C_0 (n, 3) lies on it, both in a head model's topology (section 4.1).

    All of the skin, not the part alone that holds still: neutral faces make no expression. The lips' inner sides belong to it:
    without them inner lips come to lie 0.7 to 0.9 mm from their true places (median), with them 0.2 to 0.5 mm, and outer lips
    nearer by 0.01 to 0.16 mm (four people). Raises `InputError` as `correspond`.
    """
    base, true = (
        NeutralFace.of(vertices, model.triangles, model.landmarks, model.regions) for vertices in (base_neutral, truth_neutral)
    )
    found = correspond(base, true)
    matched = np.flatnonzero(found.matched)
    return TrueNeutral(true.vertices, matched, found.registered[matched])


class _Placing:
    """Where a base tracker's neutral heads of one person lie on the true one; takes that share a head are registered once."""

    def __init__(self, space: MouthSpace, neutral: NDArray[np.float64]) -> None:
        self.space, self.neutral = space, neutral
        self._found: dict[bytes, TrueNeutral] = {}

    def __call__(self, base_neutral: NDArray[np.float64]) -> TrueNeutral:
        """The true head as `base_neutral` (n, 3) lies on it."""
        key = base_neutral.tobytes()
        if key not in self._found:
            self._found[key] = registered_neutral(self.space.model, base_neutral, self.neutral)
        return self._found[key]


def _load_take(files: LipTakeFiles, space: MouthSpace, placing: _Placing, contours: bool) -> LipPersonTake:
    track, sequence = MonocularTrack.load(files.track), MeshSequence.load(files.sequence)
    rings = ContourSequence.load(files.contours).contours() if contours else [None] * len(track)
    frames = np.clip(np.searchsorted(sequence.time_s, track.time_s - _SAME_MOMENT_S), 0, len(sequence) - 1)
    away = np.abs(sequence.time_s[frames] - track.time_s)
    if (away > _SAME_MOMENT_S).any():
        raise InputError(
            f"{files.name}: {int((away > _SAME_MOMENT_S).sum())} frames of the video show moments that have no mesh",
            expected="a mesh for each frame, at the same moment",
            remedy="Give the meshes the video's times.",
        )
    seen = SeenTake.of(space, track, load_camera(files.clip.camera), rings)
    return LipPersonTake(files.kind, seen, track.time_s, placing(seen.neutral), sequence, frames)
