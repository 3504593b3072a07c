"""The rig from corner observations of a made-up scene: truth recovered within what the noise allows."""

from dataclasses import replace

import numpy as np
import pytest

from headcap.calibration.gauge import canonical_frame, looked_at_point
from headcap.calibration.grouping import group_poses
from headcap.calibration.overlays import overlays
from headcap.calibration.polish import lens_jacobian
from headcap.calibration.result import CalibrationResult, check_gates
from headcap.calibration.settings import CalibrateLimits, CalibrateSettings
from headcap.calibration.solve import calibrate
from headcap.calibration.start import start_poses
from headcap.calibration.timing import refine_timing
from headcap.errors import GateFailure, InputError
from headcap.geometry.transforms import fit_rigid, rigid, rotation_angle


def errors(rig, true):
    """Rms centre error in mm and rotation error in degrees after one rigid alignment."""
    aligned = rig.transformed(fit_rigid(rig.centres, true.centres))
    centre = np.sqrt(((aligned.centres - true.centres) ** 2).sum(1).mean())
    turn = np.array([a.camera_from_world[:3, :3] @ b.camera_from_world[:3, :3].T for a, b in zip(aligned, true, strict=True)])
    return 1e3 * centre, np.degrees(np.sqrt((rotation_angle(turn) ** 2).mean()))


@pytest.fixture(scope="module")
def result(scene):
    return calibrate(scene.detections, scene.offsets, scene.board, CalibrateSettings())


def test_truth_is_recovered(scene, result):
    centre_mm, rotation_deg = errors(result.rig, scene.rig)
    # 0.05 px at 1500 px and 1 m is 0.033 mm across; focal length and distance trade against each other about ten times
    # weaker, and some 30 views of 40 corners average the noise: 0.3 mm is far beyond it, a wrong half pixel far beyond 0.3
    assert centre_mm < 0.3
    # the principal point (about one pixel of 1500) carries the rotation
    assert rotation_deg < 0.05
    # two axes of 0.05 px each, and the rig's own error well below that
    assert result.heldout_rms_px == pytest.approx(0.05 * np.sqrt(2), rel=0.15)
    assert result.heldout_p95_px == pytest.approx(0.05 * np.sqrt(-2 * np.log(0.05)), rel=0.15)
    # a corner seen by n cameras is good to 0.033 mm / sqrt(n) across and about twice that in depth
    assert result.board_scale_error_mm < 0.08


@pytest.mark.parametrize("lost", ["nearly all", "all but a row"])
def test_views_whose_corners_were_not_followed_tell_no_pose(scene, lost):
    """A neighbouring frame may show a few of a view's corners, or a row of them: no pose comes of these, and none is needed."""
    crippled = []
    for seen in scene.detections:
        velocity = seen.velocity_px_s.copy()
        for sighting in range(0, len(seen), 4):
            first, last = seen.first[sighting : sighting + 2]
            corner = seen.corner[first:last]
            followed = np.arange(len(corner)) < 3 if lost == "nearly all" else corner // 6 == corner[0] // 6
            velocity[first:last][~followed] = np.nan
        crippled.append(replace(seen, velocity_px_s=velocity))
    poses = group_poses({seen.camera: seen for seen in crippled}, scene.offsets, CalibrateSettings().group)
    assert min(len(view.corner) for pose in poses for view in pose.views.values()) >= 6
    rows = [np.unique(view.corner // 6) for pose in poses for view in pose.views.values()]
    assert min(map(len, rows)) > 1
    centre_mm, rotation_deg = errors(calibrate(crippled, scene.offsets, scene.board, CalibrateSettings()).rig, scene.rig)
    # three quarters of the views are left: within the limits that all of them keep
    assert centre_mm < 0.3
    assert rotation_deg < 0.05


def test_the_result_is_in_its_canonical_frame(result):
    # the faint pull that parallel axes need is a millionth, and depends on the frame by that much
    np.testing.assert_allclose(canonical_frame(result.rig), np.eye(4), atol=1e-5)
    np.testing.assert_allclose(looked_at_point(result.rig), 0, atol=1e-5)
    up = -np.mean([c.camera_from_world[1, :3] for c in result.rig], axis=0)
    assert up[1] / np.linalg.norm(up) == pytest.approx(1)
    assert result.rig.centres.mean(0)[2] > 0.5  # the cameras stand in front, on +z
    assert result.rig.centres[0, 0] * result.rig[0].axis[0] < 0
    # +x is to the right in the image of a frontal camera
    frontal = max(result.rig, key=lambda c: c.centre[2])
    assert frontal.project(np.array([[0.05, 0, 0]]))[0][0, 0] > frontal.project(np.zeros((1, 3)))[0][0, 0]


def test_the_canonical_frame_follows_the_rig(scene, rng):
    moved = rigid(np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.normal(size=3))
    moved[:3, :3] *= np.sign(np.linalg.det(moved[:3, :3]))
    a = scene.rig.transformed(canonical_frame(scene.rig))
    other = scene.rig.transformed(moved)
    b = other.transformed(canonical_frame(other))
    np.testing.assert_allclose(a.centres, b.centres, atol=1e-5)  # the faint pull again


def test_result_survives_its_file(result, tmp_path):
    result.save(tmp_path / "rig.json")
    back = CalibrationResult.load(tmp_path / "rig.json")
    assert back.cameras == result.cameras
    assert back.figures() == result.figures()
    np.testing.assert_array_equal(back.rig.centres, result.rig.centres)
    np.testing.assert_array_equal(back.poses[3].world_from_board, result.poses[3].world_from_board)


def test_the_moving_board_tells_time_offsets(scene, result, rng):
    noise = rng.normal(0, 2e-3, 6)
    start = tuple(np.array(scene.offsets.start_s) + noise)
    timing = refine_timing(
        result.rig, scene.detections, replace(scene.offsets, start_s=start), scene.board, CalibrateSettings().timing
    )
    # 0.05 px at about 1500 px/s is 0.03 ms for one corner and axis; a board's corners give few microseconds, the spline's
    # misfit at the ends of a move some more
    error_s = np.array(timing.av_offset_s) + (noise - noise.mean())
    assert np.sqrt((error_s**2).mean()) < 2e-5
    assert max(timing.sigma_s) < 1e-5
    assert sum(timing.av_offset_s) == pytest.approx(0, abs=1e-9)
    corrected = timing.apply(replace(scene.offsets, start_s=start))
    assert np.ptp(np.array(corrected.start_s) - scene.offsets.start_s) < 8e-5


def test_a_still_board_tells_no_time(scene, result):
    still = []
    for d in scene.detections:
        keep = np.flatnonzero(np.isfinite(d.speed_px_s()))
        rows = np.concatenate([np.arange(d.first[i], d.first[i + 1]) for i in keep])
        counts = np.diff(d.first)[keep]
        still.append(
            replace(
                d,
                frame=d.frame[keep],
                own_time_s=d.own_time_s[keep],
                first=np.r_[0, np.cumsum(counts)],
                corner=d.corner[rows],
                pixels=d.pixels[rows],
                velocity_px_s=d.velocity_px_s[rows],
            )
        )
    assert refine_timing(result.rig, still, scene.offsets, scene.board, CalibrateSettings().timing) is None


def test_false_corners_are_left_out(scene):
    rng = np.random.default_rng(1)
    spoiled = []
    for d in scene.detections:
        pixels = d.pixels.copy()
        false = rng.random(len(pixels)) < 0.01
        pixels[false] += rng.normal(0, 20, (false.sum(), 2))
        spoiled.append(replace(d, pixels=pixels))
    settings = CalibrateSettings()
    poor = calibrate(spoiled, scene.offsets, scene.board, settings)
    # one corner in a hundred, tens of pixels off, counts as nothing: the same limits as without
    assert errors(poor.rig, scene.rig)[0] < 0.3
    assert sum(c.rejected for c in poor.cameras) > 0


def test_known_lenses_stay(scene):
    from headcap.calibration.intrinsics import Lens

    camera = scene.rig[2]
    lens = Lens(camera.width, camera.height, camera.matrix, camera.distortion)
    found = calibrate(scene.detections[:3], scene.offsets, scene.board, CalibrateSettings(), known_lenses={"cam02": lens})
    np.testing.assert_allclose(found.rig["cam02"].matrix, camera.matrix, atol=1e-9)


def test_a_camera_alone_is_named(scene):
    names = scene.rig.names
    lonely = replace(scene.detections[4], own_time_s=scene.detections[4].own_time_s + 100.0)
    detections = [*scene.detections[:4], lonely, scene.detections[5]]
    with pytest.raises(Exception, match="cam04"):
        calibrate(detections, scene.offsets, scene.board, CalibrateSettings())
    with pytest.raises(InputError, match="no board pose shared"):
        start_poses([], {}, scene.board.corners, names)


def test_gates_name_the_camera_and_what_to_do(result):
    with pytest.raises(GateFailure, match=r"cam03: calibrate.heldout_rms_px is 0\.0.*expected at most 0\.01.*focus"):
        check_gates(result, CalibrateLimits(heldout_rms_px=0.01))
    told = check_gates(result, CalibrateLimits(heldout_rms_px=0.01), allow=("calibrate.heldout_rms_px",))
    assert len(told) == 6
    assert check_gates(result, CalibrateLimits(coverage=0.05)) == ()


def test_lens_jacobian_is_the_difference_quotient(scene, rng):
    camera, xy = scene.rig[1], rng.uniform(-0.2, 0.2, (5, 2))
    jacobian = lens_jacobian(camera, xy)
    for i, step in enumerate((1e-2, 1e-2, 1e-2, 1e-2, 1e-4, 1e-4, 1e-6, 1e-6)):
        matrix, distortion = camera.matrix.copy(), camera.distortion.copy()
        if i < 4:
            matrix[(0, 1, 0, 1)[i], (0, 1, 2, 2)[i]] += step
        else:
            distortion[i - 4] += step
        moved = replace(camera, matrix=matrix, distortion=distortion)
        quotient = (moved.pixels_from_normalised(xy) - camera.pixels_from_normalised(xy)) / step
        np.testing.assert_allclose(jacobian[..., i], quotient, rtol=1e-6, atol=1e-6)  # pixels are linear in each


def test_overlays_show_every_camera(scene, result):
    sheets = overlays(result, scene.detections, scene.board, {})
    assert set(sheets) == {"coverage", "reprojection"}
    assert all(s.ndim == 3 and s.dtype == np.uint8 and s.std() > 5 for s in sheets.values())
