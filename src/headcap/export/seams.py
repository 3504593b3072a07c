"""Vertices split where the texture is: most formats keep one texture coordinate per vertex."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.registration.template import Template


@dataclass(frozen=True)
class SplitMesh:
    """A template's topology with one texture coordinate per vertex."""

    source: NDArray[np.int64]
    """(k,) the template's vertex behind each split one."""
    uv: NDArray[np.float64]
    """(k, 2) u right, v down."""
    triangles: NDArray[np.int32]
    """(m, 3) into the split vertices, in the template's order."""


def split_at_seams(template: Template) -> SplitMesh:
    """One vertex per pair of position and texture coordinate, in the order of the template's vertices."""
    pairs = np.stack([template.triangles.ravel(), template.uv_triangles.ravel()], axis=1)
    unique, inverse = np.unique(pairs, axis=0, return_inverse=True)
    return SplitMesh(
        source=unique[:, 0].astype(np.int64),
        uv=template.uv[unique[:, 1]],
        triangles=inverse.reshape(-1, 3).astype(np.int32),
    )
