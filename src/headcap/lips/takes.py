"""Takes as a lip regressor sees them: the base track in its canonical frame, its contours, and what can be made of the two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.heads import HeadModel
from headcap.lips.correction import CanonicalMeshes, CorrectionLayer, Identity, TrueNeutral, canonical_truth
from headcap.lips.features import FeatureSpace, LipContours, LipFeatures, lip_features
from headcap.lips.foreign_tracks import BaseTrack, canonical_track
from headcap.lips.held_contours import HeldContours
from headcap.lips.mesh_contours import MeshContours
from headcap.lips.mouth import Mouth, MouthSettings, find_mouth

_RESTING_SHARE = 0.2
"""Frames of least expression that tell what a person's mouth is like at rest."""
BORDER_WEIGHT = 1.0
"""Of contours as constraints of corrections (section 8). Of the outer one alone, on two people whom no regressor had seen,
weights of 0, 0.3, 1, 3 and 100 took 17, 24, 26, 26 and 25 % and 21, 30, 31, 30 and 30 % off the base tracker's error. On six
people, one left out in turn, the drop is 22 % without contours, 25 % with the outer one, 25 % with rims and corners held as well
(`held_contours`), whatever the rims' weight between 0.3 and 3; the rms error of the gap falls from 1.07 to 0.95 and 0.83 mm."""


@dataclass(frozen=True, eq=False)
class MouthSpace:
    """What all people of a study share: the head model's mouth and where features are taken on it."""

    model: HeadModel
    mouth: Mouth
    settings: MouthSettings
    features: FeatureSpace

    @classmethod
    def of(cls, model: HeadModel, settings: MouthSettings | None = None) -> MouthSpace:
        """Of a head model; raises `InputError` for models without lips or corners of the eyes."""
        settings = settings or MouthSettings()
        mouth = find_mouth(np.asarray(model.vertices, float), model.triangles, model.regions, settings)
        return cls(model, mouth, settings, FeatureSpace.of(model, mouth))

    @cached_property
    def contours(self) -> MeshContours:
        """What a camera sees of the model's lips."""
        return MeshContours.of(np.asarray(self.model.vertices, float), self.mouth, self.model.regions)


@dataclass(frozen=True, eq=False)
class SeenTake:
    """One take of f frames of one person."""

    space: MouthSpace
    base: CanonicalMeshes
    """What the base tracker makes of it; NaN where it lost the face."""
    neutral: NDArray[np.float64]
    """C_0 (n, 3): the person at rest as the base tracker believes, canonical."""
    camera: Camera
    contours: tuple[LipContours | None, ...]
    compensate_rotation: bool = True

    @classmethod
    def of(
        cls,
        space: MouthSpace,
        track: BaseTrack,
        camera: Camera,
        contours: Sequence[LipContours | None],
        *,
        compensate_rotation: bool = True,
    ) -> SeenTake:
        """Of a base track, ours or another program's; C_0 is the tracked identity at rest.

        The paper has it in the first frame (section 4.2).

        Raises `InputError` for a track of another head model or another number of contours.
        """
        neutral = np.asarray(track.neutral(space.model), np.float64)
        base = canonical_track(track, space.model, space.mouth)
        if len(contours) != len(base.meshes):
            raise InputError(
                f"contours of {len(contours)} frames", expected=f"{len(base.meshes)}", remedy="Find them in this clip."
            )
        return cls(space, base, neutral, camera, tuple(contours), compensate_rotation)

    def __len__(self) -> int:
        return len(self.base.meshes)

    @cached_property
    def features(self) -> LipFeatures:
        """f (f, m) of section 5.1, absolute."""
        return lip_features(
            self.space.features,
            self.base,
            self.neutral,
            self.camera,
            self.contours,
            compensate_rotation=self.compensate_rotation,
        )

    def layer(self, identity: Identity = "kept") -> CorrectionLayer:
        """The correction layer on this take's neutral; as it is, of expression alone: who the person is stays as tracked."""
        return CorrectionLayer(self.space.mouth, self.neutral, identity)

    def parameters(self, truth_neutral: NDArray | TrueNeutral, truth: NDArray) -> NDArray[np.float32]:
        """l_f of eq. 1 (f, T, 9) against true meshes (f, n, 3) with their neutral (n, 3)."""
        return self.layer().parameters(self.base.meshes, truth_neutral, truth)

    def identity_difference(self, truth_neutral: NDArray | TrueNeutral) -> NDArray[np.float32]:
        """D_0 of eq. 1 (T, 9), C_0 -> H_0: what the tracked neutral mouth lacks of the true one (n, 3), at the tracker's size."""
        true = TrueNeutral.of(truth_neutral, self.space.mouth.steady)
        return self.layer("corrected").parameters(self.neutral[None], true, true.vertices[None])[0]

    def known(self, truth_neutral: NDArray | TrueNeutral) -> SeenTake:
        """The same take of somebody whose true neutral head (n, 3) is known from the rig: D_0 of eq. 1 put in beforehand.

        What the tracker's neutral head lacks is added to every frame, so that the layer need not learn who somebody is; the
        scale stays the tracker's, which one camera cannot tell.
        """
        true, _ = canonical_truth(truth_neutral, self.neutral, self.space.mouth.steady)
        moved = replace(self.base, meshes=self.base.meshes + (true - self.neutral))
        return replace(self, base=moved, neutral=true, contours=self.contours)

    def corrected(self, parameters: NDArray, held: float | None = None, identity: Identity = "kept") -> NDArray[np.float64]:
        """Meshes (f, n, 3) in the world with a layer (f, T, 9) of that identity put in; NaN where a frame tells none.

        With `held`, the weight of contours as constraints (section 8), the lips are drawn to them (`HeldContours`).
        """
        layer, where = self.layer(identity), self.base.world_from_canonical
        found = layer.corrected(self.base.meshes, parameters)
        if held is not None:
            quiet = quiet_frames(self.features.shape)
            contours = HeldContours(self.space.features, self.space.contours, self.camera, self.contours, held, quiet)
            found = contours.drawn(layer, found, where)
        return self.base.world(found)


def resting_distances(takes: Sequence[SeenTake]) -> NDArray[np.float64]:
    """(20,) contour distances of a person at rest: the median over those frames of their takes that show least expression.

    The paper's distances are absolute; see `LipFeatures.anchored`. NaN where no frame has contours.
    """
    shape = np.concatenate([take.features.shape for take in takes])
    distances = np.concatenate([take.features.distances for take in takes])
    told = np.isfinite(shape).all(axis=1) & np.isfinite(distances).all(axis=1)
    if not told.any():
        return np.full(distances.shape[1], np.nan)
    return np.median(distances[told][quiet_frames(shape[told])], axis=0)


def quiet_frames(shape: NDArray) -> NDArray[np.bool_]:
    """(f,) frames that show least expression psi (f, k), a fifth of those that were tracked: taken for a person at rest."""
    size = np.linalg.norm(shape, axis=1)
    known = np.isfinite(size)
    return known & (size <= np.quantile(size[known], _RESTING_SHARE)) if known.any() else known
