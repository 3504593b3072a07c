"""A rig against the true one: errors of its cameras, and the rigid alignment of the two worlds for all other figures."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from headcap.cameras import Rig
from headcap.errors import InputError
from headcap.geometry.transforms import fit_rigid, from_vector, invert, rigid, rotation_angle, transform

_GRID = 4
_REACH = 0.12


@dataclass(frozen=True)
class RigErrors:
    """How far a rig is from the true one."""

    truth_world_from_world: NDArray[np.float64]
    """(4, 4) where what the estimated rig sees lies in the true world; see `align_worlds`."""
    centre_mm: NDArray[np.float64]
    """(n_cameras,) distance of each centre after the rigid alignment of centres, in the order of the estimated rig."""
    rotation_deg: NDArray[np.float64]
    """(n_cameras,) angle between each camera and its true rotation after the same alignment."""

    @property
    def centre_error_mm(self) -> float:
        """`calibrate.centre_error_mm`: rms over cameras."""
        return float(np.sqrt(np.mean(self.centre_mm**2)))

    @property
    def rotation_error_deg(self) -> float:
        """`calibrate.rotation_error_deg`: rms over cameras."""
        return float(np.sqrt(np.mean(self.rotation_deg**2)))


def compare_rigs(rig: Rig, true_rig: Rig) -> RigErrors:
    """Errors of `rig` against `true_rig`, cameras matched by name; raises `InputError` for a name the truth lacks."""
    missing = sorted(set(rig.names) - set(true_rig.names))
    if missing:
        raise InputError(
            f"the truth knows no camera {', '.join(missing)}",
            expected=f"cameras among {', '.join(true_rig.names)}",
            remedy="Name the cameras of the session as the truth folder does (cam00, cam01, ... where it names none).",
        )
    true_cameras = Rig(tuple(true_rig[name] for name in rig.names))
    by_centres = _align_centres(rig, true_cameras)
    aligned = rig.transformed(by_centres)
    turns = np.array(
        [
            a.camera_from_world[:3, :3] @ b.camera_from_world[:3, :3].T
            for a, b in zip(aligned.cameras, true_cameras.cameras, strict=True)
        ]
    )
    return RigErrors(
        truth_world_from_world=align_worlds(rig, true_cameras, by_centres),
        centre_mm=1e3 * np.linalg.norm(aligned.centres - true_cameras.centres, axis=1),
        rotation_deg=np.degrees(rotation_angle(turns)),
    )


def align_worlds(rig: Rig, true_rig: Rig, start: NDArray) -> NDArray[np.float64]:
    """The rigid transform (4, 4) after which both rigs, camera by camera, photograph the subject's place alike.

    Least squares in pixels over a grid of points about the place the true cameras look at, a tenth of their distance
    wide. Camera centres would not do: a centre that is off together with its lens (by focal length or principal point)
    changes no picture of the subject, yet drags an alignment of centres with it, and that shift would count as an error
    of every point and mesh. Nothing that was reconstructed or tracked enters. `start` is a first guess.
    """
    points = _subject_grid(true_rig)
    seen = [camera.project(points)[0] for camera in true_rig]
    inside = [
        ((pixels > -0.5) & (pixels < np.array(camera.size) - 0.5)).all(axis=1)
        for pixels, camera in zip(seen, true_rig, strict=True)
    ]
    pairs = [(c, pixels[ok], points[ok]) for c, pixels, ok in zip(rig, seen, inside, strict=True) if ok.any()]
    if len(pairs) < 3:
        return start

    def residuals(correction: NDArray) -> NDArray[np.float64]:
        """Pixels by which the pictures of the grid differ once the alignment is corrected by a twist (6,)."""
        world_from_truth = invert(from_vector(correction) @ start)
        return np.concatenate([(c.project(transform(world_from_truth, x))[0] - pixels).ravel() for c, pixels, x in pairs])

    solved = least_squares(residuals, np.zeros(6), x_scale=1e-3, xtol=1e-12, ftol=1e-12, gtol=1e-12)
    return from_vector(solved.x) @ start


def _subject_grid(rig: Rig) -> NDArray[np.float64]:
    """Points (n, 3) about the place nearest to all optical axes."""
    axes = np.array([camera.axis for camera in rig])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    middle = np.linalg.lstsq(across.sum(axis=0), np.einsum("cij,cj->i", across, rig.centres), rcond=None)[0]
    reach = _REACH * np.median(np.linalg.norm(rig.centres - middle, axis=1))
    steps = np.linspace(-reach, reach, _GRID)
    return middle + np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)


def _align_centres(rig: Rig, true_rig: Rig) -> NDArray[np.float64]:
    spread = np.linalg.svd(rig.centres - rig.centres.mean(axis=0), compute_uv=False)
    if len(rig) >= 3 and spread[1] > 0.02 * spread[0]:
        return fit_rigid(rig.centres, true_rig.centres)
    # centres on a line leave a turn about it open: the mean rotation of the cameras closes it
    turns = sum(
        b.camera_from_world[:3, :3].T @ a.camera_from_world[:3, :3] for a, b in zip(rig.cameras, true_rig.cameras, strict=True)
    )
    u, _, vt = np.linalg.svd(turns)
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return rigid(rotation, true_rig.centres.mean(axis=0) - rotation @ rig.centres.mean(axis=0))
