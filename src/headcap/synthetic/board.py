"""The calibration board: how it is waved, and its exact picture by intersecting every sample's ray with its plane."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from headcap.cameras import Camera, Rig
from headcap.errors import InputError
from headcap.geometry.transforms import rigid
from headcap.synthetic.rig import BOARD_STREAM, random_stream
from headcap.synthetic.settings import BoardSettings, RehearsalSettings

_SAMPLES = 3
_TEXELS_PER_SQUARE = 100
_WHITE, _BLACK, _BACK = 0.72, 0.035, 0.25


def charuco(settings: BoardSettings) -> cv2.aruco.CharucoBoard:
    """OpenCV's description of the board, metres; its origin is the outer corner of the first square."""
    number = getattr(cv2.aruco, settings.dictionary, None)
    if number is None:
        raise InputError(
            f"board dictionary {settings.dictionary!r}", expected="a name such as DICT_5X5_100", remedy="Name one of OpenCV's."
        )
    dictionary = cv2.aruco.getPredefinedDictionary(number)
    return cv2.aruco.CharucoBoard(settings.squares, settings.square_size_mm / 1000, settings.marker_size_mm / 1000, dictionary)


@dataclass(frozen=True)
class BoardMotion:
    """The board's pose over time: still in each pose, eased from one to the next."""

    settings: BoardSettings
    rotations: Rotation
    """world_from_board, one per pose."""
    positions_m: NDArray[np.float64]
    """(poses, 3) of the board's middle."""

    def world_from_board(self, time_s: float) -> NDArray[np.float64]:
        """Pose (4, 4) of the board's own frame (x along a row of squares, y down a column, z into the board)."""
        period = self.settings.hold_s + self.settings.move_s
        pose, within = divmod(max(float(time_s), 0.0), period)
        last = len(self.positions_m) - 1
        pose = min(int(pose), last)
        part = np.clip((within - self.settings.hold_s) / self.settings.move_s, 0, 1)
        part = part**3 * (10 - 15 * part + 6 * part**2)  # a hand's move: least jerk
        after = min(pose + 1, last)
        rotation = Slerp([0, 1], self.rotations[[pose, after]])(part).as_matrix()
        middle = (1 - part) * self.positions_m[pose] + part * self.positions_m[after]
        half = np.append(np.array(self.settings.squares) * self.settings.square_size_mm / 2000, 0)
        return rigid(rotation, middle - rotation @ half)

    def is_still(self, time_s: float) -> bool:
        """Whether the board rests at that moment."""
        return time_s % (self.settings.hold_s + self.settings.move_s) <= self.settings.hold_s


def wave_board(settings: RehearsalSettings, rig: Rig) -> BoardMotion:
    """Poses about the point the cameras look at, shown to one camera after another in an order that covers the rig."""
    board = settings.board
    random = random_stream(settings.seed, BOARD_STREAM)
    poses = int(np.ceil(board.duration_s / (board.hold_s + board.move_s))) + 1
    target = _point_looked_at(rig)
    shown_to = np.concatenate([random.permutation(len(rig)) for _ in range(poses // len(rig) + 1)])[:poses]
    rotations, positions = [], []
    for k, camera in enumerate(shown_to):
        position = target + random.uniform(-1, 1, 3) * board.spread_m
        back = position - rig.centres[camera]  # the board's z points away from whom it is shown to
        tilt = np.radians(board.tilt_deg) * np.array([np.cos(2.4 * k), np.sin(2.4 * k), 0]) * random.uniform(0.35, 1.0)
        turn = Rotation.from_rotvec(tilt) * Rotation.from_rotvec([0, 0, np.radians(random.uniform(-35, 35))])
        rotations.append(Rotation.from_matrix(_facing(back)) * turn)
        positions.append(position)
    return BoardMotion(board, Rotation.concatenate(rotations), np.array(positions))


def _point_looked_at(rig: Rig) -> NDArray[np.float64]:
    """The point nearest to all optical axes."""
    axes = np.array([camera.axis for camera in rig])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    return np.linalg.lstsq(across.sum(0), np.einsum("cij,cj->i", across, rig.centres), rcond=None)[0]


def _facing(back: NDArray) -> NDArray[np.float64]:
    z = back / np.linalg.norm(back)
    x = np.cross([0.0, -1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


@lru_cache(maxsize=1)
def _pattern(settings: BoardSettings) -> NDArray[np.float32]:
    """Linear reflectance of the printed board with its margin, area-averaged texels; read-only."""
    squares, texels = np.array(settings.squares), 4 * _TEXELS_PER_SQUARE
    drawn = charuco(settings).generateImage((squares * texels).tolist())
    margin = round(settings.margin_mm / settings.square_size_mm * texels / 4) * 4
    drawn = cv2.copyMakeBorder(drawn, margin, margin, margin, margin, cv2.BORDER_CONSTANT, value=255)
    size = (drawn.shape[1] // 4, drawn.shape[0] // 4)
    share = cv2.resize(drawn.astype(np.float32) / 255, size, interpolation=cv2.INTER_AREA)
    share = 1 - share if settings.inverted else share
    pattern = (_BLACK + (_WHITE - _BLACK) * share).astype(np.float32)
    pattern.setflags(write=False)
    return pattern


class BoardPainter:
    """Pictures of the board in one camera; keeps the rays of the camera's samples."""

    def __init__(self, camera: Camera, settings: BoardSettings) -> None:
        self.camera, self.settings = camera, settings

    @cached_property
    def _rays(self) -> NDArray[np.float32]:
        """Ideal image-plane coordinates (samples down, samples across, 2)."""
        across = (np.arange(self.camera.width * _SAMPLES) + 0.5) / _SAMPLES - 0.5
        down = (np.arange(self.camera.height * _SAMPLES) + 0.5) / _SAMPLES - 0.5
        # the lens bends slowly: exact on every twelfth sample, bicubic between them
        coarse_x, coarse_y = np.append(across[::12], across[-1] + 0.5), np.append(down[::12], down[-1] + 0.5)
        grid = np.stack(np.meshgrid(coarse_x, coarse_y), axis=-1)
        ideal = self.camera.undistort_pixels(grid.reshape(-1, 2)).reshape(grid.shape)
        return _fine_grid(ideal, coarse_x, coarse_y, across, down)

    def corners(self, world_from_board: NDArray) -> NDArray[np.float64]:
        """True pixels (corners, 2) of the inner chessboard corners, in OpenCV's order."""
        local = np.asarray(charuco(self.settings).getChessboardCorners(), float).reshape(-1, 3)
        return self.camera.project(local @ world_from_board[:3, :3].T + world_from_board[:3, 3])[0]

    def paint(
        self, world_from_board: NDArray, background: NDArray, light: NDArray, rows: tuple[int, int] | None = None
    ) -> NDArray:
        """Linear RGB (rows, width, 3); `light` (3,) points from the board to the light, its length is the irradiance."""
        first, last = rows or (0, self.camera.height)
        picture = np.ascontiguousarray(background, np.float32).copy()
        camera_from_board = self.camera.camera_from_world @ world_from_board
        normal = -camera_from_board[:3, 2]
        facing = float(normal @ camera_from_board[:3, 3]) < 0
        # board coordinates are a homography of the ideal image plane
        plane = np.linalg.inv(np.column_stack([camera_from_board[:3, 0], camera_from_board[:3, 1], camera_from_board[:3, 3]]))
        cosine = float(-world_from_board[:3, 2] @ light) * (1 if facing else -1)
        shade = 0.35 + 0.65 * max(cosine, 0.05)
        texel_m = self.settings.square_size_mm / 1000 / _TEXELS_PER_SQUARE
        pattern = _pattern(self.settings)
        margin = (pattern.shape[1] - self.settings.squares[0] * _TEXELS_PER_SQUARE) / 2
        box = self._box(world_from_board, margin * texel_m, first, last)
        if box is not None:
            _paint(self._rays, plane, pattern, 1 / texel_m, margin, shade, facing, first, np.array(box), picture)
        return picture

    def _box(self, world_from_board: NDArray, margin_m: float, first: int, last: int) -> tuple[int, int, int, int] | None:
        size = np.array(self.settings.squares) * self.settings.square_size_mm / 1000
        edge = np.linspace(0, 1, 9)
        rim = np.array([(x, y) for x in edge for y in edge]) * (size + 2 * margin_m) - margin_m
        points = np.column_stack([rim, np.zeros(len(rim))]) @ world_from_board[:3, :3].T + world_from_board[:3, 3]
        pixels, depth = self.camera.project(points)
        if (depth < 0.05).any():
            return (0, self.camera.width, first, last)
        low, high = np.floor(pixels.min(0)).astype(int) - 2, np.ceil(pixels.max(0)).astype(int) + 3
        x0, x1 = max(low[0], 0), min(high[0], self.camera.width)
        y0, y1 = max(low[1], first), min(high[1], last)
        return (x0, x1, y0, y1) if x0 < x1 and y0 < y1 else None


def _fine_grid(ideal: NDArray, coarse_x: NDArray, coarse_y: NDArray, across: NDArray, down: NDArray) -> NDArray[np.float32]:
    from scipy.interpolate import RectBivariateSpline

    splines = [RectBivariateSpline(coarse_y, coarse_x, ideal[..., axis]) for axis in range(2)]
    return np.stack([spline(down, across) for spline in splines], axis=-1).astype(np.float32)


@njit(cache=True, fastmath=True, error_model="numpy")
def _paint(rays, plane, pattern, texels_per_m, margin, shade, facing, first_row, box, picture):
    rows, columns = pattern.shape
    samples = _SAMPLES * _SAMPLES
    for y in range(box[2], box[3]):
        for x in range(box[0], box[1]):
            total, hits = 0.0, 0
            for sample in range(samples):
                sy, sx = y * _SAMPLES + sample // _SAMPLES, x * _SAMPLES + sample % _SAMPLES
                rx, ry = rays[sy, sx, 0], rays[sy, sx, 1]
                w = plane[2, 0] * rx + plane[2, 1] * ry + plane[2, 2]
                if w <= 0:  # behind the camera
                    continue
                u = (plane[0, 0] * rx + plane[0, 1] * ry + plane[0, 2]) / w * texels_per_m + margin - 0.5
                v = (plane[1, 0] * rx + plane[1, 1] * ry + plane[1, 2]) / w * texels_per_m + margin - 0.5
                if u < -0.5 or v < -0.5 or u > columns - 0.5 or v > rows - 0.5:
                    continue
                hits += 1
                if not facing:
                    total += _BACK
                    continue
                u, v = min(max(u, 0.0), columns - 1.001), min(max(v, 0.0), rows - 1.001)
                i, j = int(u), int(v)
                s, t = u - i, v - j
                top = pattern[j, i] * (1 - s) + pattern[j, i + 1] * s
                bottom = pattern[j + 1, i] * (1 - s) + pattern[j + 1, i + 1] * s
                total += top * (1 - t) + bottom * t
            if hits > 0:
                rest = 1 - hits / samples
                for channel in range(3):
                    out = picture[y - first_row, x, channel]
                    picture[y - first_row, x, channel] = total * shade / samples + rest * out
