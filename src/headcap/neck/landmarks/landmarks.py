"""Sparse landmarks over time: where they lie on the head, and where they were seen, in 3D or in one camera's picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.heads import HeadModel


@dataclass(frozen=True, eq=False)
class LandmarkPoints:
    """k places on a head model's surface."""

    names: tuple[str, ...]
    corners: NDArray[np.int64]
    """(k, 3) vertices of the triangle each lies in; three times the same one for a landmark on a vertex."""
    shares: NDArray[np.float64]
    """(k, 3) barycentric coordinates; rows sum to one."""

    def __len__(self) -> int:
        return len(self.names)

    @classmethod
    def named(cls, model: HeadModel, names: Sequence[str]) -> LandmarkPoints:
        """The model's own landmarks of those names; raises `InputError` for one that it has not."""
        missing = [name for name in names if name not in model.landmarks]
        if missing:
            raise InputError(
                f"landmark {missing[0]!r}",
                expected=f"landmarks of {model.name}: {', '.join(sorted(model.landmarks))}",
                remedy="Name one of them, or tell the vertex that it lies on.",
            )
        return cls.of_vertices(model, [model.landmarks[name] for name in names], names)

    @classmethod
    def of_vertices(cls, model: HeadModel, vertices: Sequence[int], names: Sequence[str] | None = None) -> LandmarkPoints:
        """Landmarks on vertices (k,)."""
        corners = np.repeat(np.asarray(vertices, np.int64)[:, None], 3, axis=1)
        names = [f"vertex {v}" for v in vertices] if names is None else names
        return cls(tuple(names), corners, np.tile([1.0, 0.0, 0.0], (len(corners), 1))).checked(model)

    @classmethod
    def of_triangles(
        cls, model: HeadModel, triangles: Sequence[int], shares: NDArray, names: Sequence[str] | None = None
    ) -> LandmarkPoints:
        """Landmarks in triangles (k,) of the model at barycentric coordinates (k, 3)."""
        triangles = np.asarray(triangles, np.int64)
        if len(triangles) and not (triangles.min() >= 0 and triangles.max() < len(model.triangles)):
            raise _refused(f"a landmark in triangle {triangles.max()}", f"one of {len(model.triangles)} of {model.name}")
        names = [f"triangle {t}" for t in triangles] if names is None else names
        corners = model.triangles[triangles].astype(np.int64)
        return cls(tuple(names), corners, np.asarray(shares, float).reshape(-1, 3)).checked(model)

    @classmethod
    def joined(cls, parts: Sequence[LandmarkPoints]) -> LandmarkPoints:
        """All of them, in order."""
        names = tuple(name for part in parts for name in part.names)
        return cls(names, np.concatenate([p.corners for p in parts]), np.concatenate([p.shares for p in parts]))

    def checked(self, model: HeadModel) -> LandmarkPoints:
        """These; raises `InputError` for vertices the model has not, or shares that do not make a point of the triangle."""
        corners, shares = self.corners, self.shares
        if len(corners) and not (corners.min() >= 0 and corners.max() < len(model.vertices)):
            raise _refused(f"a landmark on vertex {corners.max()}", f"vertices 0 to {len(model.vertices) - 1} of {model.name}")
        wrong = (np.abs(shares.sum(axis=1) - 1.0) > 1e-3) | (shares < -1e-6).any(axis=1) | ~np.isfinite(shares).all(axis=1)
        if shares.shape != corners.shape or wrong.any():
            name = self.names[int(wrong.argmax())] if shares.shape == corners.shape else self.names[0]
            raise _refused(f"barycentric coordinates of landmark {name}", "three shares that sum to one")
        return self

    def at(self, vertices: NDArray) -> NDArray[np.float64]:
        """Places (..., k, 3) on meshes (..., n, 3)."""
        return np.einsum("...kcx,kc->...kx", vertices[..., self.corners, :], self.shares)


@dataclass(frozen=True, eq=False)
class Landmarks:
    """k landmarks seen over f frames."""

    points: LandmarkPoints
    time_s: NDArray[np.float64]
    """(f,) rising."""
    seen: NDArray[np.float64]
    """(f, k, 3) metres in the room, or (f, k, 2) pixels (integer coordinates are pixel centres); NaN where not seen."""
    camera: Camera | None = None
    """That took the pixels."""

    def __post_init__(self) -> None:
        time_s, seen = np.asarray(self.time_s, float), np.asarray(self.seen, float)
        if time_s.ndim != 1 or len(time_s) == 0 or not np.isfinite(time_s).all() or (np.diff(time_s) <= 0).any():
            raise _refused(f"moments of shape {time_s.shape}", "one rising, finite moment per frame, at least one")
        if seen.shape not in ((len(time_s), len(self.points), 3), (len(time_s), len(self.points), 2)):
            wanted = f"({len(time_s)}, {len(self.points)}, 3 metres or 2 pixels)"
            raise _refused(f"landmarks of shape {seen.shape}", f"{wanted}: frames, landmarks, coordinates")
        if seen.shape[2] == 2 and self.camera is None:
            raise _refused("landmarks in pixels without a camera", "the calibrated camera that took the pictures")
        # a landmark of which one coordinate is unknown was not seen
        whole = np.where(np.isfinite(seen).all(axis=2, keepdims=True), seen, np.nan)
        object.__setattr__(self, "time_s", time_s)
        object.__setattr__(self, "seen", whole)

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def flat(self) -> bool:
        """Whether they are pixels."""
        return self.seen.shape[2] == 2

    @property
    def visible(self) -> NDArray[np.bool_]:
        """(f, k)."""
        return np.isfinite(self.seen[..., 0])


def _refused(found: str, expected: str) -> InputError:
    return InputError(found, expected=expected, remedy="Correct the landmarks, or use the model they were made for.")
