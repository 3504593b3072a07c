"""The first frame: the registered template placed rigidly on a point cloud in the rig's world."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial.transform import Rotation

from headcap.errors import InputError
from headcap.geometry.transforms import from_vector, rigid, transform
from headcap.meshes.closest_point import Surface
from headcap.meshes.normals import vertex_normals
from headcap.reconstruction.points import PointCloud
from headcap.registration.template import Template


class PlaceSettings(BaseModel):
    """Rigid placement by the first frame's points."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    points: int = Field(6000, ge=200, description="Points of the cloud used")
    rounds: int = Field(40, ge=1, description="Rounds of nearest points of the winning start")
    kept_share: float = Field(0.75, gt=0, le=1, description="Share of points that count (hair, clothes and hands do not fit)")
    start_angles_deg: tuple[float, ...] = Field((-25, 0, 25), description="Pitch and yaw tried where no start is given")
    worst_fit_mm: float = Field(
        2.5, gt=0, description="Past this trimmed median distance the template is taken for another subject"
    )
    seed: int = Field(3, description="Seed of the chosen points")


@dataclass(frozen=True)
class PlacedTemplate:
    """Where the template stands and how well it fits."""

    world_from_template: NDArray[np.float64]
    """(4, 4) rigid."""
    figures: dict[str, float]
    """place.error_median_mm, place.error_p90_mm over the kept share; place.within_2mm_pct over all points."""


def place_template(
    template: Template, cloud: PointCloud, settings: PlaceSettings | None = None, start: NDArray | None = None
) -> NDArray[np.float64]:
    """world_from_template (4, 4); see `fit_placement`, which also gives figures."""
    return fit_placement(template, cloud, settings, start).world_from_template


def fit_placement(
    template: Template, cloud: PointCloud, settings: PlaceSettings | None = None, start: NDArray | None = None
) -> PlacedTemplate:
    """Trimmed point-to-plane fit of the template to the cloud.

    Both frames are y up and z out of the face to within some 30 degrees; `start` (4, 4) replaces the tried angles.
    Raises `InputError` where the cloud is too small or the template does not fit it.
    """
    settings = settings or PlaceSettings()
    if len(cloud) < 200:
        raise InputError(
            f"the first frame's cloud has {len(cloud)} points", expected="at least 200", remedy="Check reconstruct's figures."
        )
    points, normals = _thinned(cloud, settings)
    surface = Surface(template.vertices, template.triangles)
    template_normals = vertex_normals(template.vertices, template.triangles)
    starts = [np.asarray(start, float)] if start is not None else _starts(template, points, settings)
    few = slice(None, None, max(1, len(points) // 700))
    rough = [_icp(surface, template_normals, points[few], normals[few], pose, 15, settings) for pose in starts]
    best = min(rough, key=lambda result: result[1])[0]
    pose, _ = _icp(surface, template_normals, points, normals, best, settings.rounds, settings)
    return PlacedTemplate(pose, _checked(surface, points, pose, settings))


def _thinned(cloud: PointCloud, settings: PlaceSettings) -> tuple[NDArray, NDArray]:
    chosen = np.random.default_rng(settings.seed).permutation(len(cloud))[: settings.points]
    return cloud.positions[chosen].astype(float), cloud.normals[chosen].astype(float)


def _starts(template: Template, points: NDArray, settings: PlaceSettings) -> list[NDArray]:
    """The face over the points' front, turned by each pair of angles.

    A cloud shows what cameras see, seldom the back of the head: its front surface is matched to the template's.
    """
    face = template.vertices[template.regions["face"]] if "face" in template.regions else template.vertices
    out = []
    for pitch in settings.start_angles_deg:
        for yaw in settings.start_angles_deg:
            rotation = Rotation.from_euler("xy", [pitch, yaw], degrees=True).as_matrix()
            turned = template.vertices @ rotation.T
            # robust extents: the top of the head and its sides stand where the cloud's do, the front where its front is
            low, high = np.percentile(points, [2, 99], axis=0)
            own_low, own_high = np.percentile(turned, [2, 99], axis=0)
            centre = np.array([0.5 * (low[0] + high[0] - own_low[0] - own_high[0]), high[1] - own_high[1], high[2] - own_high[2]])
            middle = points.mean(0) - (face @ rotation.T).mean(0)
            out += [rigid(rotation, centre), rigid(rotation, middle)]
    return out


def _icp(
    surface: Surface,
    template_normals: NDArray,
    points: NDArray,
    normals: NDArray,
    pose: NDArray,
    rounds: int,
    settings: PlaceSettings,
) -> tuple[NDArray, float]:
    """Pose and trimmed median distance in metres after so many rounds."""
    for _ in range(rounds):
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        found = surface.closest(local)
        own = found.interpolate(surface.triangles, template_normals)
        facing = np.einsum("nk,nk->n", own, normals @ pose[:3, :3])
        cost = found.distance + np.where(facing > 0.3, 0.0, 0.05)
        scale = max(2.0 * np.quantile(cost, 0.5 * settings.kept_share), 5e-4)
        weight = np.where(cost <= np.quantile(cost, settings.kept_share), 1.0 / (1.0 + (cost / scale) ** 2) ** 2, 0.0)
        step = _plane_step(transform(pose, found.points), own @ pose[:3, :3].T, points, weight)
        pose = step @ pose
        if np.abs(step - np.eye(4)).max() < 1e-7:
            break
    distance = np.sort(surface.closest((points - pose[:3, 3]) @ pose[:3, :3]).distance)
    return pose, float(distance[: int(settings.kept_share * len(distance))].mean())


def _plane_step(moving: NDArray, normal: NDArray, target: NDArray, weight: NDArray) -> NDArray:
    """Small rigid motion (4, 4) of the template's points towards the cloud, along the template's normals."""
    centre = moving.mean(0)
    rows = np.concatenate([np.cross(moving - centre, normal) * 10.0, normal], axis=1)
    right = np.einsum("nk,nk->n", target - moving, normal)
    matrix = (rows * weight[:, None]).T @ rows + 1e-6 * max(weight.sum(), 1.0) * np.eye(6)
    solution = np.linalg.solve(matrix, (rows * weight[:, None]).T @ right)
    turn = from_vector(np.concatenate([10.0 * solution[:3], np.zeros(3)]))[:3, :3]
    return rigid(turn, centre + solution[3:] - turn @ centre)


def _checked(surface: Surface, points: NDArray, pose: NDArray, settings: PlaceSettings) -> dict[str, float]:
    distance = 1e3 * np.sort(surface.closest((points - pose[:3, 3]) @ pose[:3, :3]).distance)
    kept = distance[: int(settings.kept_share * len(distance))]
    median = float(np.median(kept))
    if median > settings.worst_fit_mm:
        raise InputError(
            f"the registered scan fits the first frame's points to {median:.1f} mm",
            expected=f"at most {settings.worst_fit_mm:g} mm",
            remedy="Check that the scan is of this subject and in the right unit, and that the first frame shows the face.",
        )
    return {
        "place.error_median_mm": median,
        "place.error_p90_mm": float(np.percentile(kept, 90)),
        "place.within_2mm_pct": float(100.0 * (distance < 2.0).mean()),
    }
