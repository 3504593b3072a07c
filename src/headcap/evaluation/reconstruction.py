"""Points against the true surface: how far off, and how much of it they cover."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from headcap.cameras import Rig
from headcap.evaluation.settings import EvaluateSettings
from headcap.meshes.closest_point import Surface
from headcap.meshes.normals import triangle_normals
from headcap.meshes.visibility import count_cameras


@dataclass(frozen=True)
class CloudErrors:
    """One frame's points against the true surface at that time."""

    point_error_mm: NDArray[np.float32]
    """(n_points,) distance of each point to the surface."""
    sample_gap_mm: NDArray[np.float32]
    """(n_samples,) distance to the nearest point of each surface sample that enough cameras of the rig have in view."""
    seen: NDArray[np.bool_]
    """(n_samples,) true where enough cameras that were recording have it in view."""


def compare_cloud(
    points_m: NDArray,
    vertices_m: NDArray,
    triangles: NDArray,
    true_rig: Rig,
    settings: EvaluateSettings | None = None,
    *,
    recording: tuple[str, ...] | None = None,
) -> CloudErrors:
    """Errors of points (n, 3), already in the true world, against the true surface (v, 3), (m, 3) at their time.

    `recording` names the cameras that photographed that time, all of them where it is None: cameras start and stop one by one,
    and one that has stopped sees nothing.
    """
    settings = settings or EvaluateSettings()
    if len(points_m) == 0:
        raise ValueError("a point cloud without points cannot be compared")
    error = Surface(vertices_m, triangles).closest(points_m).distance
    samples, normals = sample_surface(vertices_m, triangles, settings.surface_samples)
    groups = ([], [])
    for camera in true_rig:
        groups[recording is None or camera.name in recording].append(camera)
    stopped, present = (
        count_cameras(Rig(tuple(group)), vertices_m, triangles, samples, normals, max_angle_deg=settings.max_angle_deg)
        for group in groups
    )
    in_view = stopped + present >= settings.min_cameras
    gap = cKDTree(points_m).query(samples[in_view])[0]
    seen = present[in_view] >= settings.min_cameras
    return CloudErrors((1e3 * error).astype(np.float32), (1e3 * gap).astype(np.float32), seen)


def summarise_clouds(clouds: list[CloudErrors]) -> dict[str, float]:
    """The `reconstruct` figures over all compared frames of a take, points and samples pooled; completeness in percent."""
    error = np.concatenate([cloud.point_error_mm for cloud in clouds])
    gap = np.concatenate([cloud.sample_gap_mm for cloud in clouds])
    recording = gap[np.concatenate([cloud.seen for cloud in clouds])]
    return {
        "reconstruct.error_median_mm": float(np.median(error)),
        "reconstruct.error_p90_mm": float(np.percentile(error, 90)),
        "reconstruct.completeness_half_mm": _share_within(gap, 0.5),
        "reconstruct.completeness_1mm": _share_within(gap, 1.0),
        "reconstruct.completeness_half_mm_recording": _share_within(recording, 0.5),
        "reconstruct.completeness_1mm_recording": _share_within(recording, 1.0),
    }


def _share_within(gap_mm: NDArray, reach_mm: float) -> float:
    """Percent of gaps within reach; NaN where no part of the surface is seen by enough cameras."""
    return float(100 * np.mean(gap_mm <= reach_mm)) if len(gap_mm) else float("nan")


def sample_surface(vertices: NDArray, triangles: NDArray, count: int, seed: int = 0) -> tuple[NDArray, NDArray]:
    """Points (count, 3) spread evenly by area over a mesh, and the normals (count, 3) of their triangles.

    Stratified along the running sum of areas, so that a triangle gets its share of points to within one.
    """
    rng = np.random.default_rng(seed)
    normals = triangle_normals(vertices, triangles)
    doubled_area = np.linalg.norm(normals, axis=1)
    running = np.cumsum(doubled_area)
    places = (np.arange(count) + rng.random(count)) * (running[-1] / count)
    chosen = np.minimum(np.searchsorted(running, places, side="right"), len(triangles) - 1)
    root, along = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.stack([1 - root, root * (1 - along), root * along], axis=1)
    points = np.einsum("nc,nck->nk", weights, np.asarray(vertices, float)[triangles[chosen]])
    return points, normals[chosen] / np.maximum(doubled_area[chosen, None], 1e-30)
