"""One person's neutral head and takes, as training is given them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from headcap.errors import InputError
from headcap.heads import HeadModel
from headcap.neck.fitting.compensation import check_topology

LEAST_FRAMES = 10
_MOST_TILT_DEG = 20.0


class Watched(Protocol):
    """Somebody of whom cameras saw a part."""

    @property
    def seen(self) -> NDArray[np.bool_] | None:
        """(n,) vertices, None for all."""


@dataclass(frozen=True, eq=False)
class TrainingSubject:
    """One person's pose and expression takes (section 4.1); arrays may be memory-mapped, frames that are not finite skipped."""

    name: str
    neutral: NDArray
    """(n, 3) metres, in the frame of the model: neutral pose, neutral expression, silent."""
    pose: NDArray
    """(f, n, 3) metres, pure changes of pose; no frames where there are none."""
    expression: NDArray
    """(f, n, 3) metres, silent changes of expression; no frames where there are none."""
    seen: NDArray[np.bool_] | None = None
    """(n,) vertices that cameras saw, all by default: what a tracker makes up elsewhere is not learnt from."""

    @property
    def trains(self) -> bool:
        """Whether there is anything to learn from."""
        return bool(len(self.pose) or len(self.expression))

    def personal(self, model: HeadModel) -> HeadModel:
        """The model of this person."""
        return replace(model.personal(self.neutral), name=f"{model.name} of {self.name}")

    def check(self, model: HeadModel, *, takes: tuple[str, ...] = ("pose", "expression")) -> None:
        """Raise `InputError` for another topology, too few frames, or a neutral head out of the model's frame."""
        if np.shape(self.neutral) != model.vertices.shape or not np.isfinite(self.neutral).all():
            raise InputError(
                f"subject {self.name}: a neutral head of {np.shape(self.neutral)}, or one that is not finite",
                expected=f"{model.vertices.shape}, the topology of {model.name}",
                remedy="Register the scan with this model's template.",
            )
        for name in takes:
            meshes = getattr(self, name)
            check_topology(model, meshes)
            if len(meshes) < LEAST_FRAMES:
                raise InputError(
                    f"subject {self.name}: {len(meshes)} frames of {name}",
                    expected=f"at least {LEAST_FRAMES}",
                    remedy=f"Record a longer {name} take, or leave this subject out of the training.",
                )
        if self.seen is not None and np.shape(self.seen) != (len(model.vertices),):
            raise InputError(
                f"subject {self.name}: a mask of seen vertices {np.shape(self.seen)}",
                expected=f"({len(model.vertices)},), the vertices of {model.name}",
                remedy="Pass the mask of this model's template.",
            )
        self._check_frame(model)

    def _check_frame(self, model: HeadModel) -> None:
        own, mean = (np.asarray(v, np.float64) - np.mean(v, axis=0, dtype=np.float64) for v in (self.neutral, model.vertices))
        tilt_deg = np.degrees(Rotation.align_vectors(own, mean)[0].magnitude())
        if tilt_deg > _MOST_TILT_DEG:
            raise InputError(
                f"subject {self.name}: the neutral head is turned by {tilt_deg:.0f} degrees against the model",
                expected=f"at most {_MOST_TILT_DEG:.0f} degrees: blendshapes are directions in the head's frame",
                remedy="Bring the neutral head into the model's frame: metres, y up, z out of the face.",
            )


def seen_by_all(model: HeadModel, subjects: Sequence[Watched]) -> NDArray[np.bool_]:
    """(n,) vertices that are seen of every subject; `InputError` where there are none."""
    seen = np.ones(len(model.vertices), bool)
    for subject in subjects:
        if subject.seen is not None:
            seen = seen & subject.seen
    if not seen.any():
        raise InputError(
            f"no vertex is seen of all {len(subjects)} subjects",
            expected="a part of the head that every subject shows",
            remedy="Train subjects of like recordings together.",
        )
    return seen
