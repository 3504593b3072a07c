"""The medium-scale layer: what a person's face is beyond the model's identities (lip paper, section 3.2; Garrido et al. 2016).

A smooth displacement at rest, d(v) = sum_k phi_k(v) c_k with c_k in R^3, in the lowest manifold harmonics of the face:
eigenvectors of L phi_k = lambda_k M phi_k (Vallet and Levy 2008; cotangent Laplacian L, lumped areas M). They vanish at the
face's border, where the rest of the head joins on. The coefficients are unknowns beside beta, of the same photometric energy, and
have a normal prior whose deviation falls with the square of the wavelength, sigma_k = sigma lambda_1 / lambda_k.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import eigsh

from headcap.meshes.laplacian import cotangent_laplacian, vertex_areas
from headcap.meshes.topology import boundary_mask, vertex_components


def manifold_harmonics(vertices: NDArray, triangles: NDArray, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Harmonics (count, n), of unit mean square over the area, and their lambda_k (count,), 1/m^2, rising.

    Of a mesh (n, 3), (m, 3), metres: of its largest piece, zero on that piece's borders and on the others.
    """
    labels = vertex_components(triangles, len(vertices))
    inside = np.flatnonzero((labels == np.bincount(labels).argmax()) & ~boundary_mask(triangles, len(vertices)))
    areas = np.maximum(vertex_areas(vertices, triangles), 1e-12)
    stiffness = cotangent_laplacian(vertices, triangles)[inside][:, inside]
    mass = sparse.diags_array(areas[inside])
    # a fixed start makes one face's layer the same in every run
    values, modes = eigsh(sparse.csc_array(stiffness), count, sparse.csc_array(mass), sigma=-1e-6, v0=np.ones(len(inside)))
    out = np.zeros((count, len(vertices)))
    out[:, inside] = modes.T * np.sqrt(areas.sum())
    return out, values


def medium_layer(vertices: NDArray, triangles: NDArray, count: int, deviation_m: float) -> NDArray[np.float32]:
    """Displacements (3 count, n, 3), metres per standard deviation: each harmonic along each axis, the longest waves first.

    `deviation_m` is sigma, the root mean square displacement that is expected of the longest wave.
    """
    if count == 0:
        return np.zeros((0, *vertices.shape), np.float32)
    modes, values = manifold_harmonics(vertices, triangles, count)
    scaled = (deviation_m * values[0] / values)[:, None] * modes
    out = np.zeros((count, 3, *vertices.shape), np.float32)
    for axis in range(3):
        out[:, axis, :, axis] = scaled
    return out.reshape(3 * count, *vertices.shape)
