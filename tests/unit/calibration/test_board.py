"""Boards seen in drawn images: corners where they are, wrong boards named."""

import cv2
import numpy as np
import pytest

from headcap.calibration.board import BoardSettings, check_board, read_board
from headcap.calibration.detection import BoardDetector, CameraDetections, detect_recording
from headcap.errors import InputError
from headcap.geometry.transforms import from_vector, transform

SIZE = (640, 720)
FOCAL = 900.0
OVERSAMPLED = 4


def charuco(**changes) -> BoardSettings:
    given = {"dictionary": "DICT_5X5_100", "squares": (7, 9), "square_size_mm": 25, "marker_size_mm": 18}
    return BoardSettings(**{**given, **changes})


def flat_picture(board: BoardSettings, per_square: int) -> np.ndarray:
    """The board's print with a margin of half a square, `per_square` pixels to a square."""
    margin = per_square // 2
    if board.type == "charuco":
        return board.charuco().generateImage(tuple(n * per_square + 2 * margin for n in board.squares), marginSize=margin)
    rows, columns = np.indices((board.squares[1], board.squares[0]))
    squares = np.where((rows + columns) % 2 == 0, 0, 255).astype(np.uint8)
    return np.pad(np.kron(squares, np.ones((per_square, per_square), np.uint8)), margin, constant_values=255)


def draw(board: BoardSettings, pose: np.ndarray, *, ground: int = 90) -> tuple[np.ndarray, np.ndarray]:
    """A pinhole image of the board and its true corners, by oversampling and averaging; pose is (6,) camera_from_board."""
    per_square = 60
    picture = flat_picture(board, per_square)
    camera_from_board = from_vector(pose)
    matrix = np.array([[FOCAL, 0, 319.5], [0, FOCAL, 359.5], [0, 0, 1]])
    image_from_plane = matrix @ camera_from_board[:3][:, [0, 1, 3]]
    square_m = board.square_size_mm * 1e-3
    scale = square_m / per_square  # print pixel p lies at (p + 0.5 - margin) * scale on the board
    plane_from_print = np.array(
        [[scale, 0, scale * (0.5 - per_square // 2)], [0, scale, scale * (0.5 - per_square // 2)], [0, 0, 1]]
    )
    s = OVERSAMPLED
    fine_from_image = np.array([[s, 0, (s - 1) / 2], [0, s, (s - 1) / 2], [0, 0, 1]])
    fine = cv2.warpPerspective(
        picture,
        fine_from_image @ image_from_plane @ plane_from_print,
        (SIZE[0] * s, SIZE[1] * s),
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=ground,
    )
    image = cv2.resize(fine, SIZE, interpolation=cv2.INTER_AREA)
    local = transform(camera_from_board, board.corners)
    return cv2.GaussianBlur(image, (3, 3), 0.6), local[:, :2] / local[:, 2:] * FOCAL + np.array([319.5, 359.5])


POSES = [np.array([0.1, -0.3, 0.2, -0.08, -0.11, 0.5]), np.array([-0.5, 0.4, -0.6, -0.12, -0.02, 0.55])]


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize(
    "board",
    [charuco(), charuco(inverted=True), BoardSettings(type="chessboard", squares=(7, 10), square_size_mm=22)],
    ids=["charuco", "inverted", "chessboard"],
)
def test_corners_lie_where_they_are(board, pose):
    image, true = draw(board, pose)
    view = BoardDetector(board).detect(255 - image if board.inverted else image)
    assert len(view.corner) > 0.9 * len(board.corners)
    error = view.pixels - true[view.corner]
    # a clean image of 256 grey levels, sampled 4 x 4 times: half a pixel of misunderstanding is ten times this
    assert np.sqrt((error**2).mean()) < 0.05
    assert np.abs(error.mean(0)).max() < 0.03


def test_large_images_are_searched_small_and_refined_large():
    board = charuco()
    image, true = draw(board, POSES[0])
    view = BoardDetector(board, BoardDetector(board).settings.model_copy(update={"full_search_px": 360})).detect(image)
    assert len(view.corner) > 40
    assert np.sqrt(((view.pixels - true[view.corner]) ** 2).mean()) < 0.05


def test_a_recording_gives_places_and_velocities(tmp_path):
    board, velocity_m_s, rate_hz = charuco(), 0.02, 60.0
    frames = []
    for k in range(12):
        pose = POSES[0] + np.r_[0, 0, 0, velocity_m_s * k / rate_hz, 0, 0]
        frames.append((k, k / rate_hz, draw(board, pose)[0]))
    seen = detect_recording(frames, board, "cam00")
    assert len(seen) == 4  # 0.2 s, one in 0.05 s
    # 0.02 m/s at 0.5 m and 900 px: 36 px/s, over the board 30 to 42 by its tilt
    np.testing.assert_allclose(seen.speed_px_s(), 36, rtol=0.1)
    np.testing.assert_allclose(seen.velocity(1)[:, 1].mean(), 0, atol=1.5)
    seen.save(tmp_path / "a.npz")
    back = CameraDetections.load(tmp_path / "a.npz")
    np.testing.assert_array_equal(back.pixels, seen.pixels)
    assert (back.camera, back.width, back.height) == ("cam00", *SIZE)


@pytest.mark.parametrize(
    ("described", "told"),
    [
        ({"squares": (5, 7)}, r"marker ids up to 30.*ids 0 to 16.*squares"),
        ({"squares": (9, 7)}, r"squares from their described places.*Exchange"),
        ({"marker_size_mm": 14}, r"markers measure 0\.(69|7).*expected 0\.560 = 14 mm / 25 mm"),
        ({"dictionary": "DICT_4X4_100"}, r"markers of DICT_5X5_1000.*Correct dictionary"),
        ({"inverted": True}, r"expected DICT_5X5_100, inverted: true.*inverted"),
    ],
)
def test_another_board_than_described_is_named(described, told):
    images = [draw(charuco(), pose)[0] for pose in POSES]
    check_board(images, charuco(), "cam07")
    with pytest.raises(InputError, match=r"cam07: .*" + told):
        check_board(images, charuco(**described), "cam07")


def test_board_files_are_refused_by_key(tmp_path):
    path = tmp_path / "board.yaml"
    path.write_text("type: charuco\ndictionary: DICT_5X5_100\nsquares: [7, 9]\nsquare_size_mm: 0.025\nmarker: 18\n")
    with pytest.raises(InputError, match=r"square_size_mm.*marker: Extra"):
        read_board(path)
    path.write_text("type: chessboard\nsquares: [7, 9]\nsquare_size_mm: 25\n")
    with pytest.raises(InputError, match="one side of a chessboard must be even"):
        read_board(path)
    path.write_text("type: charuco\ndictionary: DICT_5X5_100\nsquares: [7, 9]\nsquare_size_mm: 25\nmarker_size_mm: 18\n")
    assert read_board(path) == charuco()
