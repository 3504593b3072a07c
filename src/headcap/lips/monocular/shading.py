"""Fine detail by shading: a displacement of the skin that explains how intensity changes from place to place.

Lip paper, section 3.2: "shading-based geometry refinement (i.e. shape-from-shading under estimated lighting and albedo) can be
applied to extract fine-scale static and transient surface details". It gives no equations; these follow the base that it names
(Garrido et al. 2013, 2016; Valgaerts et al. 2012; Wu et al. 2011), which compare gradients of shading. On the tracked skin,
subdivided, vertices x_v and unit normals N_v of a frame, the unknown is a height d_v along N_v, metres. With I the picture, u the
projection, n(d) the displaced surface's vertex normals, a the albedo, S(n) the shading of second-order harmonics,

    E(d) = sum_(v,w) w_vw |D_vw|^2 / sigma_I^2
         + sum_v m_v ((d_v / sigma_d)^2 + (l^2 (M^-1 L d)_v / sigma_d)^2)
    D_vw = I(u(x_v + d_v N_v)) - I(u(x_w + d_w N_w)) - (a_v S(n_v(d)) - a_w S(n_w(d)))

over edges (v, w) between vertices in view, three channels each. A light or an albedo that is off by the same amount on both ends
cancels. L is the cotangent Laplacian, M lumped areas, m_v a vertex' share of the mean area: the second sum is closeness and
smoothness, a normal prior of deviation sigma_d whose waves shorter than 2 pi l are damped. Solved by Gauss-Newton with the
analytic Jacobian (of the picture's samples and of the normals by all heights about them) and conjugate gradients; w_vw are Geman
and McClure's robust weights, so that hairs and highlights do not become ridges.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg

from headcap.errors import InputError
from headcap.lips.monocular.harmonics import shading, shading_slopes
from headcap.lips.monocular.photometric import Level, see
from headcap.meshes.laplacian import Factor, bilaplacian, cotangent_laplacian, vertex_areas
from headcap.meshes.normals import vertex_normals
from headcap.meshes.subdivision import subdivide_butterfly
from headcap.meshes.topology import boundary_mask, mesh_edges

_HIDDEN_M = 0.002
"""A vertex so far behind what its pixel sees is hidden."""
_HELD = 1e4
"""Weight of heights at the mesh's border, over the prior's: they stay."""
_SOLVED, _MOST_ROUNDS = 1e-4, 200
_HALVINGS = 4
_LEAST_LIGHT = 0.1
"""Share of the skin's median shading below which nothing is told of its albedo."""


class ShadingSettings(BaseModel):
    """Refinement of a tracked frame by its shading; the paper gives no numbers.

    On two rehearsed heads, 360 x 640 pixels, with wrinkles and bumps of 0.18 mm rms, normals err by 2.8 and 3.0 degrees without;
    where the mesh lies where it belongs 2.3 and 2.1 are left, on the base tracker's own meshes 2.2 and 3.8: painted skin that
    slips a little looks like wrinkles. So nothing is refined unless it is asked for.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    subdivisions: int = Field(
        0,
        ge=0,
        le=2,
        description="How often the model's triangles are split in four, with an albedo as fine (`painted_albedo`): what is "
        "painted between vertices is carved otherwise. Normals of wrinkles of 10 mm on a tracked rehearsed head err by 2.2 "
        "degrees unsplit and 2.4 split once, in the place of 2.8 without refinement",
    )
    noise: float = Field(0.006, gt=0, description="Standard deviation of differences of linear intensity along an edge")
    robust_sigmas: float = Field(4.0, gt=0, description="Difference, in these, at which an edge loses three quarters of its say")
    depth_mm: float = Field(
        0.25,
        gt=0,
        description="Standard deviation of heights. Of wrinkles of 0.18 mm rms on a rehearsed head 0.14 mm are left with "
        "0.25, and 0.16 mm with 0.5",
    )
    length_mm: float = Field(1.0, gt=0, description="Length l below which, over 2 pi, waves are damped")
    albedo_mm: float = Field(
        0.0,
        ge=0,
        description="What of the albedo changes within less is taken for shape; 0 takes all of it for paint, and shows what "
        "differs from the frame that the albedo was taken in. On a rehearsed head with blotched skin 4 to 10 mm carve the "
        "blotches: normals err by 4.9 degrees in the place of 2.8; for skin of one colour only",
    )
    least_cosine: float = Field(0.35, gt=0, lt=1, description="Of normal and view, below which skin is seen too obliquely")
    iterations: int = Field(6, ge=1, description="Gauss-Newton steps at most")
    step_mm: float = Field(0.003, gt=0, description="A step of smaller rms is the last")


@dataclass(frozen=True, eq=False)
class ShadedDetail:
    """A frame's skin with its fine detail."""

    vertices: NDArray[np.float64]
    """(N, 3) camera axes, metres; the first n are the tracked mesh's."""
    triangles: NDArray[np.int32]
    """(M, 3)"""
    height_m: NDArray[np.float64]
    """(N,) d, outwards."""
    seen: NDArray[np.bool_]
    """(N,) vertices that the picture tells of; others hang on the prior and their neighbours."""
    difference_before: float
    """Root mean square of D over edges in view, linear intensity, at d = 0."""
    difference_after: float


def shaded_detail(
    level: Level,
    vertices: NDArray,
    triangles: NDArray,
    light: NDArray,
    albedo: NDArray,
    confidence: NDArray | None = None,
    settings: ShadingSettings | None = None,
) -> ShadedDetail:
    """Refine a tracked frame's skin (section 3.2, see the module).

    `vertices` (n, 3) metres in the camera's axes with `triangles` (m, 3), as `FaceSurface.in_camera` gives them; `light` (3, 9)
    and `albedo` (n, 3) as the tracker estimated them, channels as in the level's picture, linear; `confidence` (n,) 0 to 1, 0 for
    what is no skin. Raises `InputError` where no skin is in view.
    """
    settings = settings or ShadingSettings()
    problem = ShadingProblem.of(level, vertices, triangles, light, albedo, confidence, settings)
    height = np.zeros(len(problem.vertices))
    before = problem.root_mean_square(height)
    height = problem.solve(height)
    refined = problem.vertices + height[:, None] * problem.normals
    return ShadedDetail(refined, problem.triangles, height, problem.seen, before, problem.root_mean_square(height))


def painted_albedo(
    level: Level, vertices: NDArray, triangles: NDArray, light: NDArray, settings: ShadingSettings | None = None
) -> NDArray[np.float64]:
    """Albedo (N, 3) with which the tracked skin of a reference frame, split as the settings say, looks exactly as its picture.

    a_v = I(u(x_v)) / S(n_v), sampled as later frames are: what those then show is how they differ from the reference, transient
    detail, and the skin's own painting is not carved. Arguments as of `shaded_detail`; skin that faces away has none worth using.
    """
    settings = settings or ShadingSettings()
    vertices, triangles = np.asarray(vertices, np.float64), np.ascontiguousarray(triangles, np.int32)
    for _ in range(settings.subdivisions):
        step = subdivide_butterfly(triangles, len(vertices))
        vertices, triangles = step.carry(vertices), step.triangles
    colours = bilinear(level.picture, level.camera.project(vertices)[0])[0]
    lit = shading(vertex_normals(vertices, triangles), light)
    return colours / np.maximum(lit, _LEAST_LIGHT * np.median(np.abs(lit)))


@dataclass(frozen=True, eq=False)
class ShadingProblem:
    """E(d) of one frame; N vertices, E edges in view."""

    settings: ShadingSettings
    level: Level
    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    normals: NDArray[np.float64]
    """N_v (N, 3)."""
    light: NDArray[np.float64]
    albedo: NDArray[np.float64]
    """(N, 3)"""
    seen: NDArray[np.bool_]
    edges: NDArray[np.int64]
    """(E, 2)"""
    trust: NDArray[np.float64]
    """(E,) least confidence of the two ends."""
    prior: sparse.csr_array
    """(N, N), 1/m^2."""
    turns: tuple[NDArray[np.int64], NDArray[np.int64]]
    """Rows and columns (9 M,) of the derivative of normals by heights: corner by moved corner of each triangle."""

    @classmethod
    def of(
        cls,
        level: Level,
        vertices: NDArray,
        triangles: NDArray,
        light: NDArray,
        albedo: NDArray,
        confidence: NDArray | None,
        settings: ShadingSettings,
    ) -> ShadingProblem:
        """Of a tracked frame, see `shaded_detail`."""
        vertices, albedo = np.asarray(vertices, np.float64), np.asarray(albedo, np.float64)
        trust = np.ones(len(vertices)) if confidence is None else np.asarray(confidence, np.float64)
        if settings.albedo_mm and len(albedo) == len(vertices):
            albedo = smoothed(albedo, trust, vertices, triangles, 1e-3 * settings.albedo_mm)
        triangles = np.ascontiguousarray(triangles, np.int32)
        for _ in range(settings.subdivisions):
            step = subdivide_butterfly(triangles, len(vertices))
            if len(albedo) == len(vertices):
                albedo = step.carry(albedo)
            vertices, triangles = step.carry(vertices), step.triangles
            trust = np.concatenate([trust, trust[step.split_edges].min(axis=1)])
        if len(albedo) != len(vertices):
            raise InputError(
                f"an albedo of {len(albedo)} vertices",
                expected=f"one for each vertex tracked, or for each of the {len(vertices)} of the mesh as it is split",
                remedy="Take it with `painted_albedo` and the same settings.",
            )
        normals = vertex_normals(vertices, triangles)
        seen = (trust > 0) & _in_view(level, vertices, triangles, normals, settings.least_cosine)
        edges = mesh_edges(triangles).vertices.astype(np.int64)
        edges = edges[seen[edges].all(axis=1)]
        if not len(edges):
            raise InputError(
                "no skin in view", expected="a tracked face in the picture", remedy="Leave out frames that were lost."
            )
        corners = triangles.astype(np.int64)
        turns = np.repeat(corners, 3, axis=1).ravel(), np.tile(corners, (1, 3)).ravel()
        prior = _prior(vertices, triangles, settings)
        light = np.asarray(light, np.float64)
        return cls(
            settings, level, vertices, triangles, normals, light, albedo, seen, edges, trust[edges].min(axis=1), prior, turns
        )

    def differences(self, height: NDArray) -> NDArray[np.float64]:
        """D (E, 3) at heights (N,), metres."""
        moved = self.vertices + height[:, None] * self.normals
        left = self._observed(moved)[0] - self.albedo * shading(vertex_normals(moved, self.triangles), self.light)
        return left[self.edges[:, 0]] - left[self.edges[:, 1]]

    def jacobians(self, height: NDArray) -> tuple[NDArray[np.float64], list[sparse.csr_array]]:
        """D (E, 3), and the derivative (E, N) of each of its channels by the heights (N,)."""
        moved = self.vertices + height[:, None] * self.normals
        observed, slopes = self._observed(moved)
        opposite = _opposite(moved, self.triangles)
        unit, length = _normal_sums(opposite, self.triangles, len(moved))
        left = observed - self.albedo * shading(unit, self.light)
        # how colours change with the sum of crosses: through the unit normal, which feels no change along itself
        free = self.albedo[:, :, None] * shading_slopes(unit, self.light)
        across = (free - np.einsum("vqi,vi->vq", free, unit)[..., None] * unit[:, None]) / length[:, None, None]
        # with s = (b - a) x (c - a): ds = da x (b - c) + db x (c - a) + dc x (a - b)
        by_height = np.cross(self.normals[self.triangles], opposite)
        ends = self.edges
        jacobians = []
        for q in range(3):
            data = np.einsum("mvi,mji->mvj", across[:, q][self.triangles], by_height).ravel()
            shown = sparse.csr_array((data, self.turns), shape=(len(moved), len(moved)))
            by_vertex = sparse.csr_array(sparse.diags_array(slopes[:, q]) - shown)
            jacobians.append(by_vertex[ends[:, 0]] - by_vertex[ends[:, 1]])
        return left[ends[:, 0]] - left[ends[:, 1]], jacobians

    def cost(self, height: NDArray) -> float:
        """E(d) with the robust function rho(x) = x^2 / (1 + x^2 / k^2) of |D| / sigma_I, k `robust_sigmas`."""
        square = (self.differences(height) ** 2).sum(axis=1) / self.settings.noise**2
        data = self.trust * square / (1 + square / self.settings.robust_sigmas**2)
        return float(data.sum() + height @ (self.prior @ height))

    def solve(self, height: NDArray) -> NDArray[np.float64]:
        """Heights (N,) of a minimum near given ones, by Gauss-Newton with halved steps where the cost would rise."""
        cost = self.cost(height)
        for _ in range(self.settings.iterations):
            step = self._step(height)
            for _ in range(_HALVINGS):
                there = self.cost(height + step)
                if there < cost:
                    break
                step = 0.5 * step
            else:
                break
            height, cost = height + step, there
            if np.sqrt(np.mean(step**2)) < 1e-3 * self.settings.step_mm:
                break
        return height

    def root_mean_square(self, height: NDArray) -> float:
        """Of D."""
        return float(np.sqrt(np.mean(self.differences(height) ** 2)))

    def _step(self, height: NDArray) -> NDArray[np.float64]:
        left, jacobians = self.jacobians(height)
        square = (left**2).sum(axis=1) / self.settings.noise**2
        weight = self.trust / (1 + square / self.settings.robust_sigmas**2) ** 2 / self.settings.noise**2
        joined = sparse.csr_array(sparse.vstack([sparse.diags_array(np.sqrt(weight)) @ one for one in jacobians]))
        right = -(joined.T @ (np.sqrt(weight)[:, None] * left).T.ravel()) - self.prior @ height
        turned = sparse.csr_array(joined.T)
        diagonal = joined.power(2).sum(axis=0) + self.prior.diagonal()
        n = len(height)
        matrix = LinearOperator((n, n), matvec=lambda x: turned @ (joined @ x) + self.prior @ x, dtype=float)
        scale = LinearOperator((n, n), matvec=lambda x: x / diagonal, dtype=float)
        return cg(matrix, right, rtol=_SOLVED, maxiter=_MOST_ROUNDS, M=scale)[0]

    def _observed(self, moved: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Colours (N, 3) of the picture where moved vertices (N, 3) appear, and their derivative (N, 3) by the heights."""
        pixels, by_place = self.level.camera.project_with_jacobian(moved)
        colours, slopes = bilinear(self.level.picture, pixels)
        return colours, np.einsum("vqk,vki,vi->vq", slopes, by_place, self.normals)


def bilinear(picture: NDArray, pixels: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Colours (n, q) of a picture (height, width, q) at pixels (n, 2), and their derivative (n, q, 2); borders go on outside."""
    height, width = picture.shape[:2]
    at = np.clip(pixels, 0, np.array([width, height]) - 1.001)
    low = np.floor(at).astype(np.int64)
    (x, y), (across, down) = low.T, (at - low).T
    corners = [picture[y + j, x + i].astype(np.float64) for j in range(2) for i in range(2)]
    across, down = across[:, None], down[:, None]
    upper, lower = (corners[k] + across * (corners[k + 1] - corners[k]) for k in (0, 2))
    by_x = (1 - down) * (corners[1] - corners[0]) + down * (corners[3] - corners[2])
    return upper + down * (lower - upper), np.stack([by_x, lower - upper], axis=-1)


def smoothed(values: NDArray, trust: NDArray, vertices: NDArray, triangles: NDArray, length_m: float) -> NDArray[np.float64]:
    """Values (n, q) on a mesh without what changes within less than a length: (T M + l^2 L) y = T M x, T the trust (n,)."""
    areas = vertex_areas(vertices, triangles)
    pull = (np.asarray(trust, np.float64) + 1e-6) * np.maximum(areas, 1e-3 * areas.mean())
    laplacian = cotangent_laplacian(vertices, triangles, least_weight=0.0)
    return Factor(sparse.diags_array(pull) + length_m**2 * laplacian).solve(pull[:, None] * values)


def _prior(vertices: NDArray, triangles: NDArray, settings: ShadingSettings) -> sparse.csr_array:
    """m / sigma_d^2 + l^4 / (sigma_d^2 mean M) L^T M^-1 L (N, N); the mesh's border is held."""
    areas = vertex_areas(vertices, triangles)
    areas = np.maximum(areas, 1e-3 * areas.mean())
    laplacian = cotangent_laplacian(vertices, triangles, least_weight=0.0)
    own = areas / areas.mean() + _HELD * boundary_mask(triangles, len(vertices))
    bent = (1e-3 * settings.length_mm) ** 4 / areas.mean() * bilaplacian(laplacian, areas)
    return sparse.csr_array((sparse.diags_array(own) + bent) / (1e-3 * settings.depth_mm) ** 2)


def _in_view(level: Level, vertices: NDArray, triangles: NDArray, normals: NDArray, least_cosine: float) -> NDArray[np.bool_]:
    """(N,) vertices that the camera sees, not too obliquely, away from borders of the skin and of the picture."""
    view = see(level, vertices, triangles)
    cosine = -np.einsum("vi,vi->v", normals, vertices) / np.linalg.norm(vertices, axis=1)
    width, height = level.camera.size
    column, row = np.rint(np.nan_to_num(view.pixels, nan=-9.0)).astype(np.int64).T
    inside = (column >= 1) & (column < width - 1) & (row >= 1) & (row < height - 1)
    nearest, alone = np.full(len(vertices), -np.inf), np.zeros(len(vertices), bool)
    nearest[inside] = view.raster.depth[row[inside], column[inside]]
    # beside a border a sample mixes skin with what is behind it
    alone[inside] = cv2.erode(view.usable.astype(np.uint8), np.ones((3, 3), np.uint8))[row[inside], column[inside]] > 0
    return alone & (cosine > least_cosine) & (view.depth < nearest + _HIDDEN_M)


def _opposite(vertices: NDArray, triangles: NDArray) -> NDArray[np.float64]:
    """(m, 3, 3) of each triangle (a, b, c) the edges b - c, c - a, a - b."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return np.stack([b - c, c - a, a - b], axis=1)


def _normal_sums(opposite: NDArray, triangles: NDArray, n: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Unit vertex normals (n, 3), and the lengths (n,) of the sums of cross products that they are the directions of."""
    whole = np.cross(-opposite[:, 2], opposite[:, 1])
    sums = np.stack([np.bincount(triangles.ravel(), np.repeat(whole[:, i], 3), n) for i in range(3)], axis=1)
    length = np.maximum(np.linalg.norm(sums, axis=1), 1e-30)
    return sums / length[:, None], length
