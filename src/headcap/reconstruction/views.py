"""What stereo needs of a rig: distortion-free images in a pyramid, sources per view, the depths to search."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera, Rig
from headcap.errors import InputError
from headcap.reconstruction.settings import MatchingSettings, ReconstructSettings


@dataclass(frozen=True)
class View:
    """One photograph as an ideal pinhole camera would have taken it."""

    camera: Camera
    """Virtual camera without distortion."""
    grey: NDArray[np.float32]
    """(height, width) grey levels of 255."""
    colour: NDArray[np.uint8]
    """(height, width, 3) BGR."""
    valid: NDArray[np.bool_]
    """(height, width) inside the photograph and the mask."""


@dataclass(frozen=True)
class Level:
    """All views at one pyramid level, in one array that kernels index by flat offset."""

    images: NDArray[np.float32]
    """(n_views, height, width), padded to the largest view."""
    sizes: NDArray[np.int32]
    """(n_views, 2) width, height without padding."""
    matrices: NDArray[np.float64]
    """(n_views, 3, 3) K."""
    valid: tuple[NDArray[np.bool_], ...]
    """Per view (height, width)."""


def pinhole_views(
    rig: Rig, images_bgr: list[NDArray[np.uint8]], masks: list[NDArray] | None, settings: ReconstructSettings
) -> tuple[View, ...]:
    """Undistort all photographs; raises `InputError` for too few cameras or images of the wrong size."""
    _check(rig, images_bgr, masks)
    masks = [None] * len(rig) if masks is None else masks
    return tuple(_pinhole_view(camera, image, mask, settings) for camera, image, mask in zip(rig, images_bgr, masks, strict=True))


def _check(rig: Rig, images: list[NDArray], masks: list[NDArray] | None) -> None:
    if len(rig) < 3:
        raise InputError(f"{len(rig)} cameras", expected="at least 3", remedy="Dense stereo checks each point in a third view.")
    if len(images) != len(rig):
        raise InputError(f"{len(images)} images", expected=f"{len(rig)}, one per camera", remedy="Give them in the rig's order.")
    for camera, image in zip(rig, images, strict=True):
        if image.ndim != 3 or image.shape != (camera.height, camera.width, 3) or image.dtype != np.uint8:
            raise InputError(
                f"camera {camera.name}: image of shape {image.shape}, {image.dtype}",
                expected=f"({camera.height}, {camera.width}, 3) uint8",
                remedy="Calibrate with recordings of the same size and rotation.",
            )
    for camera, mask in zip(rig, masks or [], strict=masks is not None):
        if mask.shape != (camera.height, camera.width):
            raise InputError(
                f"camera {camera.name}: mask of shape {mask.shape}",
                expected=f"({camera.height}, {camera.width})",
                remedy="Make masks at the photographs' size.",
            )


def _pinhole_view(camera: Camera, image: NDArray[np.uint8], mask: NDArray | None, settings: ReconstructSettings) -> View:
    blank = np.full((camera.height, camera.width), 255, np.uint8) if mask is None else np.where(mask, 255, 0).astype(np.uint8)
    factor = working_scale(camera.size, settings)
    if factor < 1:
        camera = resized(camera, (round(camera.width * factor), round(camera.height * factor)))
        image = cv2.resize(image, camera.size, interpolation=cv2.INTER_AREA)
        blank = cv2.resize(blank, camera.size, interpolation=cv2.INTER_NEAREST)
    if camera.distortion.any():
        maps = cv2.initUndistortRectifyMap(camera.matrix, camera.distortion, None, camera.matrix, camera.size, cv2.CV_32FC1)
        # cubic: bilinear blurs by an amount that changes over the image and biases sub-pixel matching
        image = cv2.remap(image, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        blank = cv2.remap(blank, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    grey = cv2.cvtColor(image.astype(np.float32), cv2.COLOR_BGR2GRAY)
    return View(replace(camera, distortion=np.zeros(5)), grey, image, blank > 250)


def working_scale(size: tuple[int, int], settings: ReconstructSettings) -> float:
    """Factor by which a photograph of (width, height) is shrunk before anything else."""
    if settings.scale is not None:
        return settings.scale
    return min(1.0, float(np.sqrt(settings.most_pixels / (size[0] * size[1]))))


def resized(camera: Camera, size: tuple[int, int]) -> Camera:
    """The camera of the image resized to (width, height), whose factors may differ a little after rounding."""
    factors = np.array(size) / camera.size
    matrix = camera.matrix.copy()
    matrix[:2] *= factors[:, None]
    matrix[:2, 2] += 0.5 * factors - 0.5
    return replace(camera, width=size[0], height=size[1], matrix=matrix)


def build_level(views: tuple[View, ...], level: int, smoothing_px: float) -> Level:
    """The views shrunk by 2**level."""
    factor = 0.5**level
    greys, valid, matrices = [], [], []
    for view in views:
        size = (max(8, round(view.camera.width * factor)), max(8, round(view.camera.height * factor)))
        camera = resized(view.camera, size)
        grey = cv2.resize(view.grey, size, interpolation=cv2.INTER_AREA) if level else view.grey
        if smoothing_px > 0:
            grey = cv2.GaussianBlur(grey, (0, 0), smoothing_px)
        greys.append(grey)
        mask = cv2.resize(view.valid.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) if level else view.valid
        valid.append(mask.astype(bool))
        matrices.append(camera.matrix)
    sizes = np.array([grey.shape[::-1] for grey in greys], np.int32)
    images = np.zeros((len(views), sizes[:, 1].max(), sizes[:, 0].max()), np.float32)
    for target, grey in zip(images, greys, strict=True):
        target[: grey.shape[0], : grey.shape[1]] = grey
    return Level(images, sizes, np.array(matrices), tuple(valid))


def subject_centre(rig: Rig) -> NDArray[np.float64]:
    """(3,) point nearest to all optical axes, world metres."""
    axes = np.array([camera.axis for camera in rig])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    return np.linalg.lstsq(across.sum(0), np.einsum("cij,cj->i", across, rig.centres), rcond=None)[0]


def choose_sources(rig: Rig, centre: NDArray, settings: MatchingSettings) -> list[NDArray[np.int32]]:
    """Per view the indices of its sources, best first, by the angle between their rays to the subject.

    About 20 degrees is preferred (a smaller base loses depth, a larger one likeness, as in MVSNet's view selection,
    Yao et al. 2018, section 4.1). A view with no neighbour in the permitted range gets an empty list.
    """
    rays = centre - rig.centres
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    angle = np.rad2deg(np.arccos(np.clip(rays @ rays.T, -1, 1)))
    spread = np.where(angle < 20, 10.0, 20.0)
    score = np.exp(-0.5 * ((angle - 20) / spread) ** 2)
    score[(angle < settings.min_angle_deg) | (angle > settings.max_angle_deg)] = -1
    np.fill_diagonal(score, -1)
    order = np.argsort(-score, axis=1, kind="stable")
    return [row[score[view, row] > 0][: settings.sources].astype(np.int32) for view, row in enumerate(order)]


def depth_range(rig: Rig, centre: NDArray, settings: ReconstructSettings) -> NDArray[np.float64]:
    """(n_views, 2) near and far depth in metres: a ball around the centre as large as the widest view of it."""
    distance = np.array([camera.camera_from_world[2] @ np.append(centre, 1) for camera in rig])
    if (distance <= 0).any():
        names = [camera.name for camera, z in zip(rig, distance, strict=True) if z <= 0]
        raise InputError(
            f"cameras {', '.join(names)} look away from the point that the others look at",
            expected="cameras around one subject",
            remedy="Check the calibration, or leave these cameras out.",
        )
    reach = np.array([0.5 * np.hypot(*camera.size) / camera.matrix[0, 0] for camera in rig])
    radius = np.median(distance * reach)
    near = np.maximum(distance - radius, 0.25 * distance) if settings.near_m is None else np.full(len(rig), settings.near_m)
    far = distance + radius if settings.far_m is None else np.full(len(rig), settings.far_m)
    if (near >= far).any():
        raise InputError(
            f"near {near.max():.3f} m, far {far.min():.3f} m", expected="near < far", remedy="Mend near_m and far_m."
        )
    return np.stack([near, far], 1)


def pair_geometry(cameras: list[Camera], matrices: NDArray, view: int, sources: NDArray) -> tuple[NDArray, NDArray]:
    """Warps of one view into its sources: a pixel (u, v, 1) of inverse depth w maps to `M @ (u, v, 1) + t * w`.

    Returns M (n, 3, 3) and t (n, 3), float64, for intrinsics `matrices` (n_views, 3, 3).
    """
    inverse = np.linalg.inv(matrices[view])
    world_from_view = np.linalg.inv(cameras[view].camera_from_world)
    motions = [cameras[s].camera_from_world @ world_from_view for s in sources]
    rotation = np.array([matrices[s] @ motion[:3, :3] @ inverse for s, motion in zip(sources, motions, strict=True)])
    shift = np.array([matrices[s] @ motion[:3, 3] for s, motion in zip(sources, motions, strict=True)])
    return rotation.reshape(-1, 3, 3), shift.reshape(-1, 3)
