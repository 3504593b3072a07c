"""Board corners in one camera's recording, with their velocities: one file per camera."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_arrays, save_arrays
from headcap.calibration.board import BoardSettings, check_board
from headcap.calibration.corners import BoardView, refine_corners
from headcap.calibration.settings import DetectSettings
from headcap.errors import InputError

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]
KIND, SCHEMA = "board_detections", 1


@dataclass(frozen=True)
class CameraDetections:
    """All board sightings of one camera, in order of time; corners of sighting i are rows first[i] to first[i + 1]."""

    camera: str
    width: int
    height: int
    searched: int
    """Frames searched, with or without success."""
    frame: NDArray[np.int64]
    """(n,) frame numbers of the sightings."""
    own_time_s: Array
    """(n,) presentation times."""
    first: NDArray[np.int64]
    """(n + 1,)."""
    corner: NDArray[np.int64]
    """(m,) corner indices of all sightings."""
    pixels: Array
    """(m, 2) integer pixel centres."""
    velocity_px_s: Array
    """(m, 2); NaN where the neighbouring frames do not tell."""

    def __len__(self) -> int:
        return len(self.frame)

    def view(self, sighting: int) -> BoardView:
        """Corners of one sighting."""
        rows = slice(self.first[sighting], self.first[sighting + 1])
        return BoardView(self.corner[rows], self.pixels[rows])

    def velocity(self, sighting: int) -> Array:
        """(n, 2) corner velocities of one sighting, pixels per second."""
        return self.velocity_px_s[self.first[sighting] : self.first[sighting + 1]]

    def speed_px_s(self) -> Array:
        """(n,) median corner speed of each sighting; NaN where unknown."""
        speed = np.linalg.norm(self.velocity_px_s, axis=1)
        pieces = [speed[a:b][np.isfinite(speed[a:b])] for a, b in zip(self.first[:-1], self.first[1:], strict=True)]
        return np.array([np.median(piece) if len(piece) else np.nan for piece in pieces])

    def save(self, path: Path | str) -> None:
        """Write as npz artifact `headcap.board_detections/1`."""
        arrays = {name: getattr(self, name) for name in ("frame", "own_time_s", "first", "corner", "pixels", "velocity_px_s")}
        meta = {"camera": self.camera, "width": self.width, "height": self.height, "searched": self.searched}
        save_arrays(path, KIND, SCHEMA, arrays, meta)

    @classmethod
    def load(cls, path: Path | str) -> CameraDetections:
        """Read what `save` wrote; raises `ArtifactError`."""
        arrays, meta = load_arrays(path, KIND, SCHEMA)
        return cls(**meta, **arrays)


@dataclass(frozen=True)
class _Sighting:
    frame: int
    time_s: float
    view: BoardView
    velocity_px_s: Array


class _Search:
    """Which frames are searched: one per interval of common time, and one more where the board moves.

    The additional frame follows one, two, ... frames later in turn. Cameras of one rate searched at fixed moments alone
    always see the board at the same phases, and then a time offset cannot be told from an uneven motion.
    """

    def __init__(self, detector: BoardDetector, interval_s: float, start_s: float) -> None:
        self.detector, self.interval_s, self.start_s = detector, interval_s, start_s
        self.sightings: list[_Sighting] = []
        self.searched, self.size = 0, (0, 0)
        self.sample: list[Grey] = []
        self._slot: int | None = None
        self._visited, self._slot_began, self._more_at = -1, 0, -1
        self._frames_per_slot, self._turn = 1, 0

    def visit(self, before: Frame | None, now: Frame, after: Frame | None) -> None:
        """Take the next frame and search it if it is one to search."""
        self._visited += 1
        self.size = now[2].shape[::-1]
        slot = int(np.floor((now[1] + self.start_s) / self.interval_s + 1e-6))
        if slot != self._slot:
            self._frames_per_slot = max(1, self._visited - self._slot_began)
            self._slot, self._slot_began = slot, self._visited
            self._search_slot(before, now, after)
        elif self._visited == self._more_at:
            self._add(_Sighting(now[0], now[1], view := self.detector.detect(now[2]), np.full(view.pixels.shape, np.nan)))

    def _search_slot(self, before: Frame | None, now: Frame, after: Frame | None) -> None:
        self.searched += 1
        if len(self.sample) < 24 and self.searched % 5 == 1:
            self.sample.append(now[2])
        view = self.detector.detect(now[2])
        if not len(view.corner):
            return
        sighting = _measured(before, now, after, view, self.detector)
        self._add(sighting)
        if np.isnan(sighting.velocity_px_s).any() and self._frames_per_slot > 1:
            self._more_at = self._visited + 1 + self._turn % (self._frames_per_slot - 1)
            self._turn += 1

    def _add(self, sighting: _Sighting) -> None:
        if len(sighting.view.corner):
            self.sightings.append(sighting)


class BoardDetector:
    """Finds one board in grey images."""

    def __init__(self, board: BoardSettings, settings: DetectSettings | None = None) -> None:
        self.board, self.settings = board, settings or DetectSettings()
        self._charuco = cv2.aruco.CharucoDetector(board.charuco()) if board.type == "charuco" else None

    def detect(self, image: Grey) -> BoardView:
        """Corners with sub-pixel places in a grey image (h, w); an empty view if the board is not seen."""
        image = 255 - image if self.board.inverted else image
        scale = min(1.0, self.settings.full_search_px / max(image.shape))
        small = image if scale == 1 else cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        view = self._charuco_view(small) if self._charuco else self._chessboard_view(small)
        if not self._usable(view) or not self._usable(view := _without_strays(view, self.board)):
            return _EMPTY
        # cv2.resize maps the pixel centre x to (x + 0.5) * scale - 0.5
        view = BoardView(view.corner, (view.pixels + 0.5) / scale - 0.5)
        pixels, _ = refine_corners(image, view, self.board)
        found = np.isfinite(pixels).all(1)
        view = BoardView(view.corner[found], pixels[found])
        return view if self._usable(view) else _EMPTY

    def _usable(self, view: BoardView) -> bool:
        return len(view.corner) >= self.settings.min_corners and not _is_line(self.board.corners[view.corner])

    def _charuco_view(self, image: Grey) -> BoardView:
        pixels, ids, _, _ = self._charuco.detectBoard(image)
        if ids is None or len(ids) == 0:
            return _EMPTY
        return BoardView(np.ravel(ids).astype(np.int64), np.array(pixels, float).reshape(-1, 2))

    def _chessboard_view(self, image: Grey) -> BoardView:
        columns, rows = self.board.squares[0] - 1, self.board.squares[1] - 1
        found, pixels = cv2.findChessboardCornersSB(image, (columns, rows), flags=cv2.CALIB_CB_ACCURACY)
        if not found:
            return _EMPTY
        grid = np.array(pixels, float).reshape(rows, columns, 2)
        return BoardView(np.arange(rows * columns), _oriented(grid, image).reshape(-1, 2))


def _without_strays(view: BoardView, board: BoardSettings) -> BoardView:
    """Leave out corners that lie off the plane's perspective image (RANSAC) by much more than the others.

    Lens distortion bends the board a little everywhere; a corner set on a marker or on its neighbour stands out.
    """
    squares = board.corners[view.corner, :2] / (board.square_size_mm * 1e-3)
    cv2.setRNGSeed(0)
    board_from_image, _ = cv2.findHomography(view.pixels, squares, cv2.RANSAC, 0.1)
    if board_from_image is None:
        return _EMPTY
    mapped = cv2.perspectiveTransform(view.pixels.reshape(-1, 1, 2), board_from_image).reshape(-1, 2)
    off = np.linalg.norm(mapped - squares, axis=1)
    keep = off < max(0.06, 5 * float(np.median(off)))
    return BoardView(view.corner[keep], view.pixels[keep])


_EMPTY = BoardView(np.empty(0, np.int64), np.empty((0, 2)))


def _oriented(grid: Array, image: Grey) -> Array:
    """Turn a (rows, columns, 2) grid so that it is seen from the front and its first square is black."""
    x, y = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if x[0] * y[1] - x[1] * y[0] < 0:
        grid = grid[:, ::-1]
    blocks = [_square_centre(grid, 0, 0), _square_centre(grid[::-1, ::-1], 0, 0)]
    # the inner square at the first corner has the colour of the board's first square
    first, last = (cv2.getRectSubPix(image, (3, 3), tuple(map(float, place))).mean() for place in blocks)
    return grid if first < last else grid[::-1, ::-1]


def _square_centre(grid: Array, row: int, column: int) -> Array:
    return grid[row : row + 2, column : column + 2].reshape(-1, 2).mean(0)


def _still_neighbour(image: Grey, view: BoardView, board: BoardSettings) -> Array | None:
    """The same corners in a neighbouring frame if they moved less than half a refinement window, else None."""
    moved, reach = refine_corners(image, view, board)
    near = np.linalg.norm(moved - view.pixels, axis=1) < 0.5 * reach
    if near.mean() < 0.9:
        return None
    return np.where(near[:, None], moved, view.pixels + np.median(moved[near] - view.pixels[near], axis=0))


def _smooth(view: BoardView, values: Array) -> Array:
    """Least-squares affine field (six numbers) of per-corner values: a board's velocity has few degrees of freedom."""
    if len(values) < 6:
        return values
    basis = np.column_stack([np.ones(len(values)), (view.pixels - view.pixels.mean(0)) / (np.ptp(view.pixels) + 1e-9)])
    return basis @ np.linalg.lstsq(basis, values, rcond=None)[0]


Frame = tuple[int, float, Grey]


def luma_frames(path: Path | str) -> Iterator[Frame]:
    """Frame number, presentation time and grey image of every frame, upright, one at a time."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        stream.thread_type = "SLICE"
        for number, frame in enumerate(container.decode(stream)):
            grey = frame.to_ndarray(format="gray")
            yield number, float(frame.pts * frame.time_base), np.ascontiguousarray(np.rot90(grey, round(frame.rotation / 90)))


def _duration_s(path: Path | str) -> float:
    with av.open(str(path)) as container:
        return float(container.duration or 0) / av.time_base


def _with_neighbours(frames: Iterable[Frame]) -> Iterator[tuple[Frame | None, Frame, Frame | None]]:
    before, now = None, None
    for after in frames:
        if now is not None:
            yield before, now, after
        before, now = now, after
    if now is not None:
        yield before, now, None


def detect_recording(
    frames: Path | str | Iterable[Frame],
    board: BoardSettings,
    camera: str,
    *,
    settings: DetectSettings | None = None,
    start_s: float = 0.0,
    times_s: Array | None = None,
) -> CameraDetections:
    """Search a recording (or frames as number, time, grey image) for the board, each `interval_s` of common time.

    `start_s` is the common time of presentation time zero as far as known: with it all cameras search the same moments.
    `times_s` replaces the presentation times by frame number. A slowly moving corner is averaged over three frames and gets
    its velocity from them; elsewhere it comes from the sightings one frame away, if they were searched. Raises `InputError`
    if another board than described is seen.
    """
    settings = settings or DetectSettings()
    interval_s = settings.interval_s
    if isinstance(frames, (str, Path)):
        interval_s = max(interval_s, _duration_s(frames) / settings.max_frames)
        frames = luma_frames(frames)
    search = _Search(BoardDetector(board, settings), interval_s, start_s)
    for before, now, after in _with_neighbours(_retimed(frames, times_s)):
        search.visit(before, now, after)
    check_board(search.sample, board, camera)
    if search.size == (0, 0):
        raise InputError(f"{camera}: no frames", expected="a recording of the board", remedy="Record the board again.")
    return _packed(camera, search.size, search.searched, search.sightings)


def _retimed(frames: Iterable[Frame], times_s: Array | None) -> Iterator[Frame]:
    for number, time, image in frames:
        yield number, (time if times_s is None else float(times_s[number])), image


def _is_line(corners: Array) -> bool:
    return np.linalg.matrix_rank(corners[:, :2] - corners[:, :2].mean(0), tol=1e-6) < 2


def _measured(before: Frame | None, now: Frame, after: Frame | None, view: BoardView, detector: BoardDetector) -> _Sighting:
    """Average over three frames and velocity where the board moves slowly and evenly; else NaN velocity."""
    board, settings = detector.board, detector.settings
    unknown = _Sighting(now[0], now[1], view, np.full(view.pixels.shape, np.nan))
    around = [(f[1], _still_neighbour(f[2], view, board)) for f in (before, after) if f is not None]
    if not around or any(pixels is None for _, pixels in around):
        return unknown
    (t0, p0), (t1, p1) = (around[0], around[-1]) if len(around) == 2 else (around[0], (now[1], view.pixels))
    velocity = _smooth(view, (p1 - p0) / (t1 - t0))
    if len(around) == 2:
        share = (now[1] - t0) / (t1 - t0)
        uneven = _smooth(view, (1 - share) * p0 + share * p1 - view.pixels)
        if np.linalg.norm(uneven, axis=1).max() > settings.max_uneven_px:
            return unknown
        # the mean of three is the place at the middle frame if the motion is even; unequal gaps shift it by the velocity
        mean = (p0 + view.pixels + p1) / 3 - velocity * ((t0 + now[1] + t1) / 3 - now[1])
        view = BoardView(view.corner, mean)
    return _Sighting(now[0], now[1], view, velocity)


def _packed(camera: str, size: tuple[int, int], searched: int, sightings: list[_Sighting]) -> CameraDetections:
    counts = [len(s.view.corner) for s in sightings]
    velocities = [
        s.velocity_px_s if np.isfinite(s.velocity_px_s).all() else _velocity_between(sightings, i)
        for i, s in enumerate(sightings)
    ]
    stack = lambda parts, width: np.concatenate(parts) if parts else np.empty((0, width))  # noqa: E731
    return CameraDetections(
        camera=camera,
        width=size[0],
        height=size[1],
        searched=searched,
        frame=np.array([s.frame for s in sightings], np.int64),
        own_time_s=np.array([s.time_s for s in sightings], float),
        first=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        corner=np.concatenate([s.view.corner for s in sightings] or [np.empty(0)]).astype(np.int64),
        pixels=stack([s.view.pixels for s in sightings], 2),
        velocity_px_s=stack(velocities, 2),
    )


def _velocity_between(sightings: list[_Sighting], index: int) -> Array:
    """Velocity from the sightings one frame before and after; NaN for corners that they do not share.

    Sightings further apart tell nothing: a board may have gone and come back in between.
    """
    now = sightings[index]
    out = np.full(now.view.pixels.shape, np.nan)
    near = [s for s in sightings[max(0, index - 1) : index + 2] if abs(s.frame - now.frame) <= 1]
    if len(near) < 3:
        return out
    first, last = near[0], near[-1]
    shared, a, b = np.intersect1d(first.view.corner, last.view.corner, return_indices=True)
    if len(shared) < 4:
        return out
    velocity = (last.view.pixels[b] - first.view.pixels[a]) / (last.time_s - first.time_s)
    _, here, there = np.intersect1d(now.view.corner, shared, return_indices=True)
    out[here] = velocity[there]
    return out
