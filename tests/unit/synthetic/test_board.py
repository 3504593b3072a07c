import cv2
import numpy as np

from headcap.synthetic.board import BoardPainter, charuco, wave_board
from headcap.synthetic.rig import build_rig
from headcap.synthetic.sensor import build_sensors
from headcap.synthetic.settings import ArcSettings, BoardSettings, RehearsalSettings


def test_corners_are_found_where_the_truth_projects_them():
    settings = RehearsalSettings(arc=ArcSettings(cameras=8))
    rig, sensors = build_rig(settings), build_sensors(settings.sensor, settings.seed, 8)
    waved = wave_board(settings, rig)
    detector = cv2.aruco.CharucoDetector(charuco(settings.board))
    errors = []
    for c in (2, 5):
        painter = BoardPainter(rig[c], settings.board)
        for pose in range(12):
            world_from_board = waved.world_from_board(0.05 + 0.2 * pose)
            away = rig[c].centre - world_from_board[:3, 3]
            if -world_from_board[:3, 2] @ away < 0.6 * np.linalg.norm(away):
                continue  # beyond 53 degrees the detector itself is biased by more than what is asked here
            background = np.full((rig[c].height, rig[c].width, 3), 0.05, np.float32)
            picture = sensors[c].expose(painter.paint(world_from_board, background, np.array([0.3, 0.5, 0.8])), 0, c, pose)
            corners, ids = detector.detectBoard(np.ascontiguousarray(picture[..., ::-1]))[:2]
            if ids is not None:
                errors.append(np.asarray(corners).reshape(-1, 2) - painter.corners(world_from_board)[np.ravel(ids)])
    errors = np.concatenate(errors)
    assert len(errors) > 200
    # cornerSubPix on noisy 0.75 mm pixels scatters by 0.03 to 0.06 px; a half-pixel or lens slip would show as 0.1 px and more
    assert np.abs(errors.mean(0)).max() < 0.02
    assert np.sqrt((errors**2).mean()) < 0.1


def test_the_board_rests_then_moves_and_cameras_do_not_all_see_it():
    settings = RehearsalSettings(board=BoardSettings(duration_s=4, hold_s=0.1, move_s=0.1))
    rig = build_rig(settings)
    waved = wave_board(settings, rig)
    pose = waved.world_from_board
    np.testing.assert_array_equal(pose(0.41), pose(0.49))
    assert np.abs(pose(0.55) - pose(0.49)).max() > 1e-3
    # a rest begins where the move ended, at rest: over 2 us the pose changes by less than 1e-9
    np.testing.assert_allclose(pose(0.6 - 1e-6), pose(0.6 + 1e-6), atol=1e-9)
    facing = []
    for k in range(18):
        world_from_board = pose(0.05 + 0.2 * k)
        away = rig.centres - world_from_board[:3, 3]
        facing.append((away @ -world_from_board[:3, 2]) / np.linalg.norm(away, axis=1) > 0.4)
    seen = np.array(facing)
    assert seen.any(0).all()
    assert not seen.all(1).any()


def test_an_inverted_board_swaps_black_and_white():
    rig = build_rig(RehearsalSettings(arc=ArcSettings(cameras=3)))
    light, background = np.array([0, 0, 1.0]), np.full((rig[1].height, rig[1].width, 3), 0.05, np.float32)
    settings = RehearsalSettings(arc=ArcSettings(cameras=3))
    pose = wave_board(settings, rig).world_from_board(0.05)
    plain = BoardPainter(rig[1], BoardSettings()).paint(pose, background, light)
    inverted = BoardPainter(rig[1], BoardSettings(inverted=True)).paint(pose, background, light)
    on_board = np.abs(plain - background).max(-1) > 0.01
    assert np.corrcoef(plain[on_board].ravel(), inverted[on_board].ravel())[0, 1] < -0.8
