"""Expression bases: hand-made shapes E^H, eigenfaces E^PCA, quasi-eigen faces E^QE (quasi-eigen paper, section 3)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_arrays, save_arrays

KIND, SCHEMA = "expression_basis", 1
QUASI_KIND, QUASI_SCHEMA = "quasi_eigen_faces", 1
LEAST_OFFSET = 1e-5
"""So small a share of mu is single precision's rounding."""


@dataclass(frozen=True, eq=False)
class ExpressionBasis:
    """k named shapes of one topology as displacements from its neutral face."""

    names: tuple[str, ...]
    neutral: NDArray[np.float32]
    """v^0 (n, 3) metres."""
    displacements: NDArray[np.float32]
    """e_i (k, n, 3) metres."""
    triangles: NDArray[np.int32]
    """(m, 3); (0, 3) where the points are markers."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "neutral", np.ascontiguousarray(self.neutral, np.float32))
        object.__setattr__(self, "displacements", np.ascontiguousarray(self.displacements, np.float32))
        object.__setattr__(self, "triangles", np.ascontiguousarray(self.triangles, np.int32).reshape(-1, 3))
        if self.displacements.shape != (len(self.names), *self.neutral.shape):
            raise ValueError(f"{len(self.names)} names, displacements {self.displacements.shape}, neutral {self.neutral.shape}")

    def __len__(self) -> int:
        return len(self.names)

    @property
    def rows(self) -> NDArray[np.float32]:
        """The displacements as rows (k, 3 n) of a matrix."""
        return self.displacements.reshape(len(self), -1)

    def blend(self, weights: NDArray) -> NDArray[np.float32]:
        """Faces (..., n, 3) of weights (..., k), metres: eq. 1."""
        offsets = np.asarray(weights, np.float32) @ self.rows
        return self.neutral + offsets.reshape(*np.shape(weights)[:-1], *self.neutral.shape)

    def chosen(self, indices: NDArray) -> ExpressionBasis:
        """Some of the shapes, in the order asked for."""
        return ExpressionBasis(
            tuple(self.names[index] for index in indices), self.neutral, self.displacements[indices], self.triangles
        )

    def save(self, path: Path | str) -> None:
        """Write as npz artifact `headcap.expression_basis/1`."""
        save_arrays(path, KIND, SCHEMA, self._arrays(), {"names": list(self.names)})

    @classmethod
    def load(cls, path: Path | str) -> ExpressionBasis:
        """Read what `save` wrote; raises `ArtifactError`."""
        arrays, meta = load_arrays(path, KIND, SCHEMA)
        return cls(names=tuple(meta["names"]), **arrays)

    def _arrays(self) -> dict[str, NDArray]:
        return {"neutral": self.neutral, "displacements": self.displacements, "triangles": self.triangles}


@dataclass(frozen=True, eq=False)
class Eigenfaces:
    """E^PCA of a performance: m principal axes about its mean displacement (eq. 2)."""

    mean: NDArray[np.float32]
    """mu (n, 3), the mean displacement from the neutral face, metres."""
    vectors: NDArray[np.float32]
    """e_j^PCA (m, n, 3), orthonormal as vectors of 3 n numbers."""
    variances: NDArray[np.float64]
    """lambda_j (m,), square metres: mean square of the coordinates along each axis, which are uncorrelated."""
    total_variance: float
    """Sum of all eigenvalues of C, kept or not."""

    def __len__(self) -> int:
        return len(self.vectors)

    @property
    def coverage(self) -> NDArray[np.float64]:
        """(m,) share of the variance that the first 1, 2, ... m axes cover, as the paper defines it below eq. 2."""
        return np.cumsum(self.variances) / self.total_variance

    @property
    def rows(self) -> NDArray[np.float32]:
        """The axes as rows (m, 3 n) of a matrix."""
        return self.vectors.reshape(len(self), -1)

    @property
    def offset(self) -> NDArray[np.float32]:
        """(n, 3) from the neutral face to the hyperplane, metres: what of mu no axis tells, and eq. 4 adds to every shape."""
        rows, mean = self.rows.astype(np.float64), self.mean.ravel().astype(np.float64)
        return (mean - (rows @ mean) @ rows).astype(np.float32).reshape(self.mean.shape)

    def first(self, count: int) -> Eigenfaces:
        """The first axes alone."""
        return Eigenfaces(self.mean, self.vectors[:count], self.variances[:count], self.total_variance)

    def through_neutral(self, count: int | None = None) -> Eigenfaces:
        """The first axes, all by default, and one more, the direction of their `offset`: a hyperplane through the neutral face.

        Sums of eq. 5 begin at the neutral face, not at mu: without this axis the offset ties shapes to each other, and k shapes
        span k - 1 directions of the hyperplane. Its variance is that of the axes left out; what no axis tells counts as none.
        """
        kept, left = self.first(len(self) if count is None else count), self.rows[count:] if count is not None else self.rows[:0]
        offset = kept.offset.astype(np.float64)
        length = np.linalg.norm(offset)
        if length <= LEAST_OFFSET * np.linalg.norm(self.mean):
            return kept
        unit = offset / length
        variance = float(np.square(left @ unit.ravel()) @ self.variances[len(kept) :])
        vectors = np.concatenate([kept.vectors, unit.astype(np.float32)[None]])
        return Eigenfaces(self.mean, vectors, np.append(kept.variances, variance), self.total_variance)


@dataclass(frozen=True, eq=False)
class QuasiEigenFaces:
    """Hand-made shapes and what a performance made of them (section 4)."""

    hand: ExpressionBasis
    """E^H."""
    eigen: Eigenfaces
    """E^PCA, as many axes as there are hand-made shapes or more where frames allow: what they are compared with."""
    quasi: ExpressionBasis
    """E^QE: one shape of the same name for each hand-made one, then the eigenfaces it was augmented with."""
    coordinates: NDArray[np.float64]
    """W^PCA-to-QE (k, m) of the hand-made shapes, metres: eq. 3."""
    missing: tuple[int, ...]
    """Axes of the hyperplane that the hand-made shapes leave out (post-treatment)."""
    hyperplane: Eigenfaces = None
    """The m axes that shapes were projected onto, E^PCA itself by default (see `Eigenfaces.through_neutral`)."""

    def __post_init__(self) -> None:
        if self.hyperplane is None:
            object.__setattr__(self, "hyperplane", self.eigen)

    def save(self, path: Path | str) -> None:
        """Write as npz artifact `headcap.quasi_eigen_faces/1`."""
        arrays = {
            "neutral": self.hand.neutral,
            "triangles": self.hand.triangles,
            "hand": self.hand.displacements,
            "quasi": self.quasi.displacements,
            "mean": self.eigen.mean,
            "vectors": self.eigen.vectors,
            "variances": self.eigen.variances,
            "hyperplane_vectors": self.hyperplane.vectors,
            "hyperplane_variances": self.hyperplane.variances,
            "coordinates": self.coordinates,
            "missing": np.array(self.missing, np.int64),
        }
        meta = {
            "hand": list(self.hand.names),
            "quasi": list(self.quasi.names),
            "total_variance": self.eigen.total_variance,
        }
        save_arrays(path, QUASI_KIND, QUASI_SCHEMA, arrays, meta)

    @classmethod
    def load(cls, path: Path | str) -> QuasiEigenFaces:
        """Read what `save` wrote; raises `ArtifactError`."""
        arrays, meta = load_arrays(path, QUASI_KIND, QUASI_SCHEMA)
        neutral, triangles, mean, total = arrays["neutral"], arrays["triangles"], arrays["mean"], meta["total_variance"]
        return cls(
            hand=ExpressionBasis(meta["hand"], neutral, arrays["hand"], triangles),
            eigen=Eigenfaces(mean, arrays["vectors"], arrays["variances"], total),
            quasi=ExpressionBasis(meta["quasi"], neutral, arrays["quasi"], triangles),
            coordinates=arrays["coordinates"],
            missing=tuple(int(axis) for axis in arrays["missing"]),
            hyperplane=Eigenfaces(mean, arrays["hyperplane_vectors"], arrays["hyperplane_variances"], total),
        )
