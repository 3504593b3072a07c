"""Fields known on a part of a surface, continued over the rest as smoothly as can be."""

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from headcap.errors import InputError
from headcap.meshes.laplacian import Factor, bilaplacian, cotangent_laplacian, vertex_areas

_REACH_M = 0.05
"""Beyond this distance from what is known a field fades to zero."""


class SmoothExtension:
    """Replaces a field where it is unknown: least integral of |Laplacian x|^2 + |x|^2 / reach^4, known values held.

    One factor for all fields of a mesh.
    """

    def __init__(self, vertices: NDArray, triangles: NDArray, known: NDArray[np.bool_], *, reach_m: float = _REACH_M) -> None:
        """On vertices (n, 3) with the mask (n,) of what is known; raises `InputError` where nothing is."""
        self._known = np.asarray(known, bool)
        if self._known.shape != (len(vertices),) or not self._known.any():
            raise InputError(
                f"{self._known.sum()} known of a mask {self._known.shape}",
                expected=f"a mask of {len(vertices)} vertices, some of them known",
                remedy="Check which part of the surface was seen.",
            )
        vertices = np.asarray(vertices, np.float64)
        areas = vertex_areas(vertices, triangles)
        energy = bilaplacian(cotangent_laplacian(vertices, triangles, least_weight=0.0), areas)
        energy = sparse.csr_array(energy + sparse.diags_array(np.maximum(areas, 1e-3 * areas.mean()) / reach_m**4))
        rows = energy[~self._known]
        self._pull = sparse.csr_array(rows[:, self._known])
        self._factor = Factor(rows[:, ~self._known]) if not self._known.all() else None

    def __call__(self, fields: NDArray) -> NDArray:
        """Fields (..., n, k), the unknown part of which is not looked at."""
        if self._factor is None:
            return fields
        flat = np.moveaxis(fields, -2, 0).reshape(len(self._known), -1)
        filled = flat.copy()
        filled[~self._known] = self._factor.solve(-(self._pull @ flat[self._known].astype(np.float64)))
        shape = (len(self._known), *fields.shape[:-2], fields.shape[-1])
        return np.ascontiguousarray(np.moveaxis(filled.reshape(shape), 0, -2))
