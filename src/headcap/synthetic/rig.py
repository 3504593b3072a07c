"""The described rig as exact cameras, and the clocks of its recordings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from headcap.cameras import Camera, Rig
from headcap.synthetic.settings import ArcSettings, CameraSettings, ClockSettings, RehearsalSettings, VideoSettings

# one stream of random numbers per purpose, so that adding a take or a camera leaves all others as they were
RIG_STREAM, CLOCK_STREAM, SENSOR_STREAM, NOISE_STREAM, SOUND_STREAM, MOTION_STREAM, SUBJECT_STREAM, BOARD_STREAM = range(8)


def random_stream(seed: int, *purpose: int) -> np.random.Generator:
    """A generator of its own for each purpose."""
    return np.random.default_rng([seed, *purpose])


def looking_at(centre_m: NDArray, target_m: NDArray, turn_rad: NDArray) -> NDArray:
    """camera_from_world (4, 4) of an upright camera that looks at a target, then is turned by a vector in its own axes."""
    forward = np.asarray(target_m, float) - centre_m
    forward /= np.linalg.norm(forward)
    up = np.array([0.0, 1.0, 0.0]) if abs(forward[1]) < 0.999 else np.array([0.0, 0.0, -1.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    rotation = Rotation.from_rotvec(turn_rad).as_matrix() @ np.stack([right, np.cross(forward, right), forward])
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation, -rotation @ centre_m
    return out


def build_rig(settings: RehearsalSettings) -> Rig:
    """The cameras of a rehearsal."""
    described = settings.cameras
    if described is not None:
        return Rig(tuple(build_camera(camera, settings.video) for camera in described))
    random = random_stream(settings.seed, RIG_STREAM)
    return Rig(tuple(_arc_camera(settings.arc, settings.video, index, random) for index in range(settings.arc.cameras)))


def _arc_camera(arc: ArcSettings, video: VideoSettings, index: int, random: np.random.Generator) -> Camera:
    rows = len(arc.rows_deg)
    column, row = divmod(index, rows)
    in_row = len(range(row, arc.cameras, rows))
    azimuth = np.radians(arc.half_angle_deg) * (2 * (column + 0.5) / in_row - 1) * in_row / max(in_row - 1, 1)
    elevation = np.radians(arc.rows_deg[row])
    direction = np.array([np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)])
    centre = np.array(arc.target_m) + arc.distance_m * direction + random.normal(0, arc.placement_sigma_m, 3)
    settings = CameraSettings(
        name=f"cam{index:02d}",
        position_m=tuple(centre),
        look_at_m=arc.target_m,
        vertical_fov_deg=arc.vertical_fov_deg * (1 + random.normal(0, arc.fov_sigma)),
        principal_point_offset_px=tuple(random.normal(0, arc.principal_point_sigma_px, 2)),
        distortion=tuple(np.array(arc.distortion) + random.normal(0, 1, 5) * arc.distortion_sigma),
    )
    return build_camera(settings, video, random.normal(0, np.radians(arc.aim_sigma_deg), 3))


def build_camera(settings: CameraSettings, video: VideoSettings, turn_rad: NDArray | float = 0.0) -> Camera:
    """A described camera, turned by a vector (3,) in its own axes."""
    focal = 0.5 * video.height / np.tan(np.radians(settings.vertical_fov_deg) / 2)
    cx, cy = np.array([video.width - 1, video.height - 1]) / 2 + settings.principal_point_offset_px
    turn = turn_rad + np.array([0, 0, np.radians(settings.roll_deg)])
    return Camera(
        name=settings.name,
        width=video.width,
        height=video.height,
        matrix=np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1]]),
        distortion=np.array(settings.distortion),
        camera_from_world=looking_at(np.array(settings.position_m), np.array(settings.look_at_m), turn),
    )


@dataclass(frozen=True)
class Clock:
    """A recording's clock: common time = start_s + (1 + drift_ppm * 1e-6) * own time."""

    start_s: float
    drift_ppm: float
    audio_lag_s: float
    """How much later than the picture the sound track tells the same moment, own seconds."""
    kept_frames: NDArray[np.int64]
    """Frame slots that were recorded; slot k is presented at k / rate on the own clock."""

    def common_time(self, own_s: NDArray) -> NDArray:
        """Own seconds to common seconds."""
        return self.start_s + (1 + self.drift_ppm * 1e-6) * np.asarray(own_s, float)


def build_clocks(settings: RehearsalSettings, recording: int, frames: int, names: tuple[str, ...]) -> tuple[Clock, ...]:
    """The clocks of one recording (0 is the board's, then the takes in order), one per camera.

    A camera's drift and lag belong to the device and are the same in every recording.
    """
    clock = settings.clock
    starts = random_stream(settings.seed, CLOCK_STREAM, recording + 1).uniform(0, clock.start_spread_s, len(names))
    devices = random_stream(settings.seed, CLOCK_STREAM, 0)
    drift = devices.normal(0, 1, len(names)) * clock.drift_ppm_sigma
    lag = devices.normal(0, 1, len(names)) * clock.audio_lag_sigma_s
    kept = [_kept(clock, name, frames, (settings.seed, recording, c)) for c, name in enumerate(names)]
    return tuple(Clock(float(s), float(d), float(a), k) for s, d, a, k in zip(starts, drift, lag, kept, strict=True))


def _kept(clock: ClockSettings, name: str, frames: int, purpose: tuple[int, int, int]) -> NDArray[np.int64]:
    seed, recording, camera = purpose
    keep = random_stream(seed, CLOCK_STREAM, recording + 1, camera).random(frames) >= clock.dropped_share
    keep[[k for lost in clock.dropped_frames if lost.camera == name for k in lost.frames if k < frames]] = False
    keep[0] = True  # a recording begins with its first frame
    return np.flatnonzero(keep)
