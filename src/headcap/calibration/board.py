"""The calibration board: what it is, where its corners lie, and a check that the board seen is the board described."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from headcap.errors import InputError

Array = NDArray[np.float64]
DICTIONARIES = tuple(sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_")))


class BoardSettings(BaseModel):
    """One flat calibration board, printed once and carried through the rig."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    type: Literal["charuco", "chessboard"] = Field("charuco", description="ChArUco board or plain chessboard")
    dictionary: str | None = Field(None, description="ArUco dictionary of a ChArUco board, e.g. DICT_5X5_100")
    squares: tuple[int, int] = Field(description="squares along the board's x and y, black and white ones alike")
    square_size_mm: float = Field(gt=2, lt=500, description="side of a square, measured on the print")
    marker_size_mm: float | None = Field(None, gt=1, description="side of a ChArUco marker, measured on the print")
    inverted: bool = Field(False, description="black and white exchanged: detection works on 255 minus the image")
    legacy_pattern: bool = Field(False, description="ChArUco layout of OpenCV before 4.6 (differs for an even number of rows)")

    @model_validator(mode="after")
    def _consistent(self) -> BoardSettings:
        if min(self.squares) < 3:
            raise ValueError(f"squares {self.squares}: a board needs at least 3 squares along each side")
        if self.type == "chessboard" and sum(self.squares) % 2 == 0:
            raise ValueError(f"squares {self.squares}: one side of a chessboard must be even, the other odd, to tell its top")
        if self.type == "charuco":
            if self.dictionary not in DICTIONARIES:
                raise ValueError(f"dictionary {self.dictionary!r} is none of OpenCV's, e.g. DICT_5X5_100")
            if self.marker_size_mm is None or self.marker_size_mm >= self.square_size_mm:
                raise ValueError("marker_size_mm must be given and smaller than square_size_mm")
        return self

    @cached_property
    def corners(self) -> Array:
        """(n, 3) inner corners on the board, metres: x along the rows, y down, z = 0 (into the board)."""
        columns, rows = self.squares[0] - 1, self.squares[1] - 1
        x, y = np.meshgrid(np.arange(1, columns + 1), np.arange(1, rows + 1))
        return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1) * self.square_size_mm * 1e-3

    def charuco(self) -> cv2.aruco.CharucoBoard:
        """OpenCV's form of a ChArUco board, metres."""
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        board = cv2.aruco.CharucoBoard(self.squares, self.square_size_mm * 1e-3, self.marker_size_mm * 1e-3, dictionary)
        board.setLegacyPattern(self.legacy_pattern)
        return board


def read_board(path: Path | str) -> BoardSettings:
    """Read a board.yaml with the keys of `BoardSettings`; raises `InputError` naming every wrong key."""
    path = Path(path)
    try:
        document = yaml.safe_load(path.read_text())
        return BoardSettings(**document)
    except (OSError, yaml.YAMLError, TypeError) as error:
        raise InputError(
            f"{path.name}: {error}",
            expected="a YAML file describing the board",
            remedy="Write type, dictionary, squares and sizes.",
        ) from error
    except ValidationError as error:
        found = "; ".join(f"{'.'.join(map(str, e['loc'])) or 'board'}: {e['msg']}" for e in error.errors())
        raise InputError(
            f"{path.name}: {found}",
            expected=f"keys among {', '.join(BoardSettings.model_fields)}",
            remedy="Measure the printed board and correct the file.",
        ) from error


@dataclass(frozen=True)
class SeenMarkers:
    """Markers of one image as the ArUco detector reports them."""

    ids: NDArray[np.int64]
    corners: Array
    """(n, 4, 2) pixels."""


def find_markers(image: NDArray[np.uint8], dictionary: str) -> SeenMarkers:
    """Markers of one dictionary in a grey image."""
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)))
    corners, ids, _ = detector.detectMarkers(image)
    if ids is None or len(ids) == 0:
        return SeenMarkers(np.empty(0, np.int64), np.empty((0, 4, 2)))
    return SeenMarkers(np.ravel(ids).astype(np.int64), np.array(corners, float).reshape(-1, 4, 2))


def check_board(images: list[NDArray[np.uint8]], board: BoardSettings, camera: str) -> None:
    """Raise `InputError` if grey images show another board than described (ChArUco only; sees nothing: no error).

    Noticed: ids outside the board, another layout of squares, another ratio of marker to square, another dictionary,
    an inverted print. A board that is wrong in scale alone cannot be told from its pictures.
    """
    if board.type != "charuco":
        return
    seen = [find_markers(_as_printed(image, board), board.dictionary) for image in images]
    if not any(len(s.ids) for s in seen):
        _explain_nothing_seen(images, board, camera)
        return
    _check_ids(seen, board, camera)
    _check_layout(seen, board, camera)


def _as_printed(image: NDArray[np.uint8], board: BoardSettings) -> NDArray[np.uint8]:
    return 255 - image if board.inverted else image


def _explain_nothing_seen(images: list[NDArray[np.uint8]], board: BoardSettings, camera: str) -> None:
    """Raise if another dictionary or the inverted image explains that no marker was found."""
    for inverted in (board.inverted, not board.inverted):
        for name in (board.dictionary, "DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_ARUCO_ORIGINAL"):
            seen = sum(len(find_markers(255 - image if inverted else image, name).ids) for image in images)
            # a handful of markers can be chance: noise decodes as 4x4 codes now and then
            if seen >= 4 * max(1, len(images) // 4):
                raise InputError(
                    f"{camera}: the board shows markers of {name}{' with black and white exchanged' if inverted else ''}",
                    expected=f"{board.dictionary}, inverted: {str(board.inverted).lower()}",
                    remedy="Correct dictionary and inverted in the board file.",
                )


def _check_ids(seen: list[SeenMarkers], board: BoardSettings, camera: str) -> None:
    count = len(board.charuco().getIds())
    ids = np.concatenate([s.ids for s in seen])
    outside = np.unique(ids[ids >= count])
    if len(outside) > 1 and (ids >= count).mean() > 0.05:
        raise InputError(
            f"{camera}: marker ids up to {ids.max()} on the board",
            expected=f"ids 0 to {count - 1} of a board of {board.squares[0]} x {board.squares[1]} squares",
            remedy="Correct squares (and dictionary) in the board file.",
        )


def _check_layout(seen: list[SeenMarkers], board: BoardSettings, camera: str) -> None:
    """Map marker centres onto the described board and compare places and sizes there, in squares."""
    described = board.charuco()
    places = np.array(described.getObjPoints(), float).reshape(-1, 4, 3)[..., :2] / (board.square_size_mm * 1e-3)
    misplaced, ratios, sides_px = [], [], []
    for markers in seen:
        known = markers.ids < len(places)
        if known.sum() < 6:
            continue
        target, pixels = places[markers.ids[known]], markers.corners[known]
        board_from_image, _ = cv2.findHomography(pixels.mean(1), target.mean(1))
        if board_from_image is None:
            continue
        mapped = cv2.perspectiveTransform(pixels.reshape(-1, 1, 2), board_from_image).reshape(-1, 4, 2)
        misplaced.append(np.median(np.linalg.norm(mapped.mean(1) - target.mean(1), axis=1)))
        ratios.append(np.median(np.linalg.norm(mapped - np.roll(mapped, 1, axis=1), axis=2)))
        sides_px.append(np.median(np.linalg.norm(pixels - np.roll(pixels, 1, axis=1), axis=2)))
    if not misplaced:
        return
    # lens distortion bends a board by a few hundredths of a square; a wrong layout misplaces by whole squares
    if np.median(misplaced) > 0.2:
        raise InputError(
            f"{camera}: markers lie {np.median(misplaced):.1f} squares from their described places",
            expected=f"the layout of {board.squares[0]} x {board.squares[1]} squares",
            remedy="Exchange or correct the two numbers of squares, or set legacy_pattern for boards made before OpenCV 4.6.",
        )
    declared = board.marker_size_mm / board.square_size_mm
    # the detector puts marker corners on whole pixels, up to half a pixel inside: it shows on small markers
    if abs(np.median(ratios) / declared - 1) > 0.06 + 1 / np.median(sides_px):
        raise InputError(
            f"{camera}: markers measure {np.median(ratios):.3f} of a square",
            expected=f"{declared:.3f} = {board.marker_size_mm:g} mm / {board.square_size_mm:g} mm",
            remedy="Measure square and marker on the print and correct the board file.",
        )
