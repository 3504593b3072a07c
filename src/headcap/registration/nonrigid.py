"""Bend a placed template onto a scan: nearest points both ways against a thin plate that turns with the surface.

Minimises over vertices v, with lumped areas A, cotangent Laplacian L, mass M and local rotations R_i,
    sum_i A_i w_i |v_i - q_i|^2  +  sum_s a_s |B_s v - s|^2
    + l^4 |M^-1/2 (L v - R L v0)|^2  +  (0.15 l)^2 sum_ij c_ij |(v_i - v_j) - R_ij (v0_i - v0_j)|^2,
where q_i is the scan point nearest to v_i and B_s v the template point nearest to scan sample s. The length l says below
what size bumps of the scan are followed; it shrinks stage by stage (Amberg et al. 2007, Sorkine & Alexa 2007). The matrix is
N x N for all three coordinates; it is factored once per round.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy import sparse

from headcap.meshes.closest_point import Surface
from headcap.meshes.laplacian import Factor, bilaplacian, cotangent_laplacian, vertex_areas
from headcap.meshes.normals import triangle_normals, vertex_normals
from headcap.meshes.topology import boundary_mask, grow, mesh_edges, vertex_adjacency
from headcap.registration.align import Samples
from headcap.registration.scan import Scan


class NonrigidSettings(BaseModel):
    """Coarse-to-fine fit of the template to the scan."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    lengths_mm: tuple[float, ...] = Field(
        (60, 40, 28, 20, 14, 10, 7, 5, 3.5, 2.5, 1.8, 1.3),
        description="Smoothing length stage by stage; the last is a little over half the finest edges",
    )
    rounds: int = Field(3, ge=1, description="Rounds of nearest points per stage")
    reach_mm: tuple[float, float] = Field((30.0, 3.0), description="Robust scale of the distance in the first and last stage")
    least_cosine: float = Field(0.5, description="Nearest points whose normals differ more pull nothing")
    samples: int = Field(5000, description="Scan points that pull on the template (the other way round)")
    back_weight: float = Field(0.6, description="Weight of those pulls")
    line_weight: float = Field(15.0, description="Weight of feature lines and picks against a vertex's own area")
    membrane: float = Field(0.15, description="Length of the membrane term as a share of the smoothing length")
    seed: int = Field(5, description="Seed of the scan samples")


@dataclass(frozen=True)
class Lines:
    """Vertices that must come to lie at given places."""

    vertices: NDArray[np.int64]
    """(k,)."""
    targets: NDArray[np.float64]
    """(k, 3) metres."""
    alone: bool | NDArray[np.bool_] = False
    """(k,) or one for all: whether a vertex stands alone and not in a row of others that are held as well."""

    @classmethod
    def none(cls) -> "Lines":
        """No constraint."""
        return cls(np.zeros(0, np.int64), np.zeros((0, 3)))

    def joined(self, other: "Lines") -> "Lines":
        """Both sets."""
        alone = [np.broadcast_to(lines.alone, lines.vertices.shape) for lines in (self, other)]
        vertices = np.concatenate([self.vertices, other.vertices])
        return Lines(vertices, np.concatenate([self.targets, other.targets]), np.concatenate(alone))

    def area(self, plate: "Plate", length_m: float) -> NDArray[np.float64]:
        """Area (k,) that each vertex speaks for: its own, and where it stands alone what the plate moves along with it.

        Against a plate of smoothing length l the data of about l^2 hold a vertex in its place: a lone vertex that weighed
        but its own few square millimetres would be carried along by its neighbours.
        """
        own = plate.area[self.vertices]
        return np.where(self.alone, np.maximum(own, length_m**2), own)


class Target:
    """The scan, ready for nearest-point queries."""

    def __init__(self, scan: Scan, settings: NonrigidSettings) -> None:
        self.surface = Surface(scan.vertices, scan.triangles)
        self.normals = scan.normals()
        self.rim = scan.boundary()
        self.samples = Samples.of(scan.vertices, scan.triangles, settings.samples, settings.seed)
        area = 0.5 * np.linalg.norm(triangle_normals(scan.vertices, scan.triangles), axis=1).sum()
        self.sample_area = area / settings.samples

    def nearest(self, points: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """Nearest points (k, 3), their normals (k, 3), and true (k,) where they lie on the rim of a hole."""
        found = self.surface.closest(points)
        normals = found.interpolate(self.surface.triangles, self.normals)
        corners = self.rim[self.surface.triangles[found.triangle]]
        on_rim = ((found.barycentric > 1e-6) <= corners).all(1)
        return found.points, normals, on_rim


class Plate:
    """The template at rest: its energy matrices and what rotations need."""

    def __init__(self, rest: NDArray, triangles: NDArray) -> None:
        self.rest, self.triangles = rest, triangles
        self.laplacian = cotangent_laplacian(rest, triangles, least_weight=0.02)
        area = vertex_areas(rest, triangles)
        # the tiniest vertices would else be stiffer than the rest by orders of magnitude
        self.area = np.maximum(area, 0.3 * np.median(area))
        self.bending = bilaplacian(self.laplacian, self.area)
        pairs = mesh_edges(triangles).vertices
        self.i = np.concatenate([pairs[:, 0], pairs[:, 1]])
        self.j = np.concatenate([pairs[:, 1], pairs[:, 0]])
        self.cotangent = -np.asarray(self.laplacian[self.i, self.j]).ravel()
        self.edges = rest[self.i] - rest[self.j]
        self.adjacency = vertex_adjacency(triangles, len(rest))

    def rotations(self, vertices: NDArray) -> NDArray:
        """(n, 3, 3) best local rotations from the rest shape."""
        moved = vertices[self.i] - vertices[self.j]
        outer = (self.cotangent[:, None, None] * moved[:, :, None] * self.edges[:, None, :]).reshape(-1, 9)
        sums = np.stack([np.bincount(self.i, outer[:, k], len(self.rest)) for k in range(9)], axis=1).reshape(-1, 3, 3)
        u, _, vt = np.linalg.svd(sums)
        u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]
        return u @ vt

    def matrix(self, length_m: float, membrane: float) -> sparse.csr_array:
        """Energy matrix (n, n) for a smoothing length."""
        return sparse.csr_array(length_m**4 * self.bending + (membrane * length_m) ** 2 * self.laplacian)

    def right(self, rotations: NDArray, length_m: float, membrane: float) -> NDArray:
        """Right-hand side (n, 3) that asks for the rest shape turned by the rotations."""
        curvature = np.einsum("nij,nj->ni", rotations, self.laplacian @ self.rest)
        bend = self.laplacian.T @ (curvature / self.area[:, None])
        half = 0.5 * np.einsum("eij,ej->ei", rotations[self.i] + rotations[self.j], self.edges) * self.cotangent[:, None]
        pull = np.stack([np.bincount(self.i, half[:, k], len(self.rest)) for k in range(3)], axis=1)
        return length_m**4 * bend + (membrane * length_m) ** 2 * pull


def fit_stage(
    plate: Plate,
    vertices: NDArray,
    pulled: NDArray[np.bool_],
    target: Target,
    lines: Lines,
    stage: int,
    settings: NonrigidSettings,
) -> NDArray:
    """One stage's rounds: vertices (n, 3) nearer to the scan; only `pulled` (n,) vertices feel it."""
    length = 1e-3 * settings.lengths_mm[stage]
    share = stage / max(len(settings.lengths_mm) - 1, 1)
    reach = 1e-3 * settings.reach_mm[0] * (settings.reach_mm[1] / settings.reach_mm[0]) ** share
    for _ in range(settings.rounds):
        matrix, right = _pulls(plate, vertices, pulled, target, reach, settings)
        matrix, right = _with_lines(plate, lines, matrix, right, settings.line_weight, length)
        matrix = matrix + plate.matrix(length, settings.membrane)
        right = right + plate.right(plate.rotations(vertices), length, settings.membrane)
        vertices = Factor(matrix).solve(right)
    return vertices


def _pulls(
    plate: Plate, vertices: NDArray, pulled: NDArray, target: Target, reach: float, settings: NonrigidSettings
) -> tuple[sparse.csr_array, NDArray]:
    """Data terms both ways as a matrix (n, n) and right-hand side (n, 3)."""
    n = len(vertices)
    normals = vertex_normals(vertices, plate.triangles)
    points, scan_normals, on_rim = target.nearest(vertices)
    weight = _pair_weight(vertices, points, normals, scan_normals, reach, settings) * plate.area
    weight[on_rim | ~pulled] = 0.0
    matrix, right = sparse.diags_array(weight, format="csr"), weight[:, None] * points
    samples = target.samples
    skin = plate.triangles[pulled[plate.triangles].all(1)]
    found = Surface(vertices, skin).closest(samples.points)
    corners = skin[found.triangle]
    facing = found.interpolate(skin, normals)
    back = _pair_weight(found.points, samples.points, facing, samples.normals, reach, settings)
    back *= settings.back_weight * target.sample_area
    edge = boundary_mask(skin, n)
    back[((found.barycentric > 1e-6) <= edge[corners]).all(1)] = 0.0
    rows = np.repeat(np.arange(len(corners)), 3)
    b = sparse.csr_array((found.barycentric.ravel(), (rows, corners.ravel())), shape=(len(corners), n))
    weighted = b.T @ sparse.diags_array(back)
    return matrix + weighted @ b, right + weighted @ samples.points


def _pair_weight(
    a: NDArray, b: NDArray, normal_a: NDArray, normal_b: NDArray, reach: float, settings: NonrigidSettings
) -> NDArray:
    squared = ((a - b) ** 2).sum(1)
    cosine = np.einsum("nk,nk->n", normal_a, normal_b) / np.maximum(np.linalg.norm(normal_b, axis=1), 1e-9)
    return np.where(cosine > settings.least_cosine, cosine, 0.0) / (1.0 + squared / reach**2) ** 2


def _with_lines(plate: Plate, lines: Lines, matrix: sparse.csr_array, right: NDArray, weight: float, length_m: float) -> tuple:
    if len(lines.vertices) == 0:
        return matrix, right
    pull = np.zeros(len(right))
    pull[lines.vertices] = weight * lines.area(plate, length_m)
    right = right.copy()
    right[lines.vertices] += pull[lines.vertices, None] * lines.targets
    return matrix + sparse.diags_array(pull), right


def flipped_triangles(vertices: NDArray, triangles: NDArray) -> NDArray[np.bool_]:
    """(m,) true where a triangle looks against the mean of the triangles around it."""
    normals = triangle_normals(vertices, triangles)
    unit = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    around = vertex_normals(vertices, triangles)[triangles].sum(1)
    return np.einsum("nk,nk->n", unit, around) < 0


def unfold(plate: Plate, vertices: NDArray, spare: NDArray[np.bool_], rounds: int = 6) -> NDArray:
    """Vertices (n, 3) with folds that the rest shape has not relaxed: around them only the plate counts.

    `spare` (n,) vertices are left out of the check (surfaces rolled up by design).
    """
    at_rest = flipped_triangles(plate.rest, plate.triangles) | spare[plate.triangles].any(1)
    for turn in range(rounds):
        bad = flipped_triangles(vertices, plate.triangles) & ~at_rest
        if not bad.any():
            break
        mask = np.zeros(len(vertices), bool)
        mask[plate.triangles[bad].ravel()] = True
        free = grow(mask, plate.adjacency, 1 + turn)
        hold = sparse.diags_array(np.where(free, 1e-3, 1e3) * plate.area, format="csr")
        length = 0.008
        matrix = hold + plate.matrix(length, 0.5)
        # first let the fold open without its own wrong rotations: those of the neighbourhood stand in
        rotations = _smooth_rotations(plate, plate.rotations(vertices), free)
        right = hold @ vertices + plate.right(rotations, length, 0.5)
        solved = Factor(matrix).solve(right)
        vertices = np.where(free[:, None], solved, vertices)
    return vertices


def _smooth_rotations(plate: Plate, rotations: NDArray, free: NDArray) -> NDArray:
    mixed = rotations.reshape(-1, 9)
    degree = np.maximum(plate.adjacency.sum(axis=1), 1.0)[:, None]
    for _ in range(6):
        mixed = np.where(free[:, None], (plate.adjacency @ mixed) / degree, mixed)
    u, _, vt = np.linalg.svd(mixed.reshape(-1, 3, 3))
    u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]
    return u @ vt
