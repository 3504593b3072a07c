"""A rig against the true one, after one rigid alignment that all other figures share."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Rig
from headcap.errors import InputError
from headcap.geometry.transforms import fit_rigid, rigid, rotation_angle


@dataclass(frozen=True)
class RigErrors:
    """How far a rig is from the true one."""

    truth_world_from_world: NDArray[np.float64]
    """(4, 4) the one rigid alignment: least squares over camera centres."""
    centre_mm: NDArray[np.float64]
    """(n_cameras,) distance of each centre, in the order of the estimated rig."""
    rotation_deg: NDArray[np.float64]
    """(n_cameras,) angle between each camera and its true rotation."""

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
    alignment = _align(rig, true_cameras)
    aligned = rig.transformed(alignment)
    turns = np.array(
        [
            a.camera_from_world[:3, :3] @ b.camera_from_world[:3, :3].T
            for a, b in zip(aligned.cameras, true_cameras.cameras, strict=True)
        ]
    )
    return RigErrors(
        truth_world_from_world=alignment,
        centre_mm=1e3 * np.linalg.norm(aligned.centres - true_cameras.centres, axis=1),
        rotation_deg=np.degrees(rotation_angle(turns)),
    )


def _align(rig: Rig, true_rig: Rig) -> NDArray[np.float64]:
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
