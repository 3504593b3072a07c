"""All that a single video's lips are corrected with, in one file: head model, contour detector, regressor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_arrays, save_arrays
from headcap.errors import InputError
from headcap.heads import HeadModel
from headcap.lips.artifact import LipRegressor
from headcap.lips.clips import Clip
from headcap.lips.contours import ContourDetector, ContourFinder, ContourSequence, MouthLocator, SearchSettings, find_contours
from headcap.lips.foreign_tracks import BaseTrack
from headcap.lips.monocular import MonocularSettings
from headcap.lips.takes import BORDER_WEIGHT, MouthSpace, SeenTake
from headcap.lips.training import regressed

KIND, SCHEMA = "lip_kit", 1
_PARTS = ("head", "detector", "regressor")


@dataclass(frozen=True, eq=False)
class CorrectedClip:
    """What a kit makes of one clip of f frames."""

    take: SeenTake
    contours: ContourSequence
    meshes: NDArray[np.float32]
    """(f, n, 3) corrected, metres, in the camera's world; NaN where the face was lost or no contours were found."""

    @property
    def answered(self) -> NDArray[np.bool_]:
        """(f,) frames that were corrected."""
        return np.isfinite(self.meshes).all(axis=(1, 2))


@dataclass(frozen=True, eq=False)
class LipKit:
    """What `headcap lips` needs beside a video."""

    head: HeadModel
    detector: ContourDetector
    regressor: LipRegressor
    monocular: MonocularSettings
    search: SearchSettings

    @cached_property
    def space(self) -> MouthSpace:
        """The head model's mouth, as the regressor was trained with it."""
        regressor = self.regressor
        return MouthSpace(self.head, regressor.mouth(self.head), regressor.mouth_settings, regressor.space)

    @property
    def finder(self) -> ContourFinder:
        """Finds contours in pictures of which a base track is known."""
        return ContourFinder(self.detector, MouthLocator.of(self.space.mouth, self.space.features), self.search)

    def correct(self, clip: Clip, track: BaseTrack) -> CorrectedClip:
        """Find contours and correct a clip that was tracked with this kit's head model, by our base tracker or another.

        Contours are constraints of the correction (section 8, `BORDER_WEIGHT`). Frames that the base tracker lost, or whose
        contours were not found, are NaN and never made up. Raises `InputError` for a track of another head model and a clip in
        which no frame shows both contours.
        """
        regressor, space = self.regressor, self.space
        found = find_contours(self.finder, clip.pictures(), track.meshes(self.head), clip.camera)
        if not found.found.any():
            raise InputError(
                f"lip contours in none of {len(found)} frames",
                expected="lips that the detector knows in one frame at least",
                remedy="Look at the tracked face; train or adapt the detector on labelled frames of this light.",
            )
        take = SeenTake.of(space, track, clip.camera, found.contours())
        parameters = regressed(regressor, {"clip": take})["clip"]
        return CorrectedClip(take, found, take.corrected(parameters, BORDER_WEIGHT, regressor.identity).astype(np.float32))

    def save(self, path: Path | str) -> None:
        """Write as npz artifact `headcap.lip_kit/1`."""
        arrays, meta = {}, {"monocular": self.monocular.model_dump(mode="json"), "search": self.search.model_dump(mode="json")}
        for part in _PARTS:
            own, meta[part] = getattr(self, part).to_arrays()
            arrays |= {f"{part}/{name}": array for name, array in own.items()}
        save_arrays(path, KIND, SCHEMA, arrays, meta)

    @classmethod
    def load(cls, path: Path | str) -> LipKit:
        """Read what `save` wrote; raises `ArtifactError`, and `InputError` where head model and regressor do not agree."""
        arrays, meta = load_arrays(path, KIND, SCHEMA)
        own = {
            part: {name.removeprefix(f"{part}/"): array for name, array in arrays.items() if name.startswith(f"{part}/")}
            for part in _PARTS
        }
        head = HeadModel.from_arrays(own["head"], meta["head"])
        regressor = LipRegressor.from_arrays(own["regressor"], meta["regressor"])
        regressor.check_model(head)
        return cls(
            head,
            ContourDetector.from_arrays(own["detector"], meta["detector"]),
            regressor,
            MonocularSettings.model_validate(meta["monocular"]),
            SearchSettings.model_validate(meta["search"]),
        )
