import hashlib
import json

import av
import cv2
import numpy as np
import pytest
import yaml

from headcap.cameras import Camera
from headcap.meshes.rasteriser import rasterise
from headcap.synthetic.crew import carry_out
from headcap.synthetic.rehearsal import CALIBRATION, performance_of, plan, rehearse, rehearse_recording, subject_of
from headcap.synthetic.settings import (
    ArcSettings,
    BoardSettings,
    CameraSettings,
    ClockSettings,
    DroppedFrames,
    RehearsalSettings,
    ScanSettings,
    SensorSettings,
    TakeSettings,
    VideoSettings,
)

SETTINGS = RehearsalSettings(
    seed=7,
    arc=ArcSettings(cameras=3),
    video=VideoSettings(width=108, height=192, rate_hz=30),
    board=BoardSettings(duration_s=0.4, hold_s=0.1, move_s=0.1),
    takes=(TakeSettings(name="free_01", kind="free", duration_s=0.6),),
    clock=ClockSettings(drift_ppm_sigma=30, dropped_frames=(DroppedFrames(camera="cam01", frames=(5, 6, 11)),)),
    scan=ScanSettings(triangles=20_000),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rehearsal")
    told = []
    rehearse(SETTINGS, folder, progress=lambda done, pieces, name: told.append((done, pieces)), workers=2)
    assert told == [(k + 1, 8) for k in range(8)]
    return folder


def _read(path):
    with av.open(str(path)) as container:
        times, pictures = zip(*[(f.time, f.to_ndarray(format="rgb24")) for f in container.decode(video=0)], strict=True)
    with av.open(str(path)) as container:
        sound = np.concatenate([f.to_ndarray()[0] for f in container.decode(audio=0)])
    return np.array(times), np.array(pictures), sound


def _truth_cameras(folder):
    rig = json.loads((folder / "truth/rig.json").read_text())
    cameras = []
    for c in rig["cameras"]:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = c["R"], c["t"]
        cameras.append(Camera(c["name"], rig["width"], rig["height"], np.array(c["K"]), np.array(c["dist"]), pose))
    return rig, cameras


def test_presentation_times_tell_the_truth_and_show_missing_frames(folder):
    for camera, missing in (("cam00", ()), ("cam01", (5, 6, 11))):
        times = _read(folder / f"takes/free_01/{camera}.mp4")[0]
        slots = np.setdiff1d(np.arange(18), missing)
        np.testing.assert_allclose(times, slots / 30, atol=1e-6)
    rig = json.loads((folder / "truth/rig.json").read_text())
    assert rig["takes"]["free_01"]["dropped_frames"][1] == [5, 6, 11]


def test_the_truth_has_the_layout_that_evaluation_reads(folder):
    rig = _truth_cameras(folder)[0]
    assert {"fps", "width", "height", "pixel_centre", "cameras", "takes"} <= set(rig)
    assert set(rig["takes"]) == {CALIBRATION, "free_01"}
    assert {"first_frame_time_s", "clap_time_s", "clap_position_m", "frames"} <= set(rig["takes"]["free_01"])
    take, topology = np.load(folder / "truth/free_01.npz"), np.load(folder / "truth/topology.npz")
    last = int(np.argmax(rig["takes"]["free_01"]["first_frame_time_s"]))
    assert int(take["reference_camera"]) == last
    clock = plan(SETTINGS).clocks["free_01"][last]
    np.testing.assert_allclose(take["time_s"], clock.common_time(clock.kept_frames / 30))
    n = len(take["first_m"])
    assert take["vertices_mm_i16"].shape == (len(take["time_s"]), n, 3)
    assert topology["faces"].max() == n - 1
    assert len(topology["inner_lip_upper"]) == len(topology["inner_lip_lower"]) == 3
    k = len(take["time_s"]) - 1
    exact = subject_of(SETTINGS).vertices(performance_of(SETTINGS, "free_01").state(float(take["time_s"][k])))
    # stored to 4 micrometres: half of that, and float32 of a quarter of a metre
    np.testing.assert_allclose(take["first_m"] + take["vertices_mm_i16"][k] * 4e-6, exact, atol=2.1e-6)
    assert yaml.safe_load((folder / "board.yaml").read_text())["squares"] == [7, 9]


def test_each_camera_shows_the_subject_at_its_own_moment(folder):
    rig, cameras = _truth_cameras(folder)
    subject, performance = subject_of(SETTINGS), performance_of(SETTINGS, "free_01")
    for c in (0, 2):
        times, pictures, _ = _read(folder / f"takes/free_01/cam{c:02d}.mp4")
        start, drift = (rig["takes"]["free_01"][key][c] for key in ("first_frame_time_s", "drift_ppm"))
        vertices = subject.vertices(performance.state(start + (1 + drift * 1e-6) * times[-1]))
        seen = rasterise(cameras[c], vertices, subject.surface.triangles).hit
        background = np.median(pictures[-1][:8].reshape(-1, 3), axis=0)
        shown = (np.abs(pictures[-1].astype(float) - background).max(-1) > 14).astype(np.uint8)
        shown = cv2.morphologyEx(shown, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8)) > 0  # shade as dark as the room
        near = cv2.dilate(seen.astype(np.uint8), np.ones((3, 3))) > cv2.erode(seen.astype(np.uint8), np.ones((3, 3)))
        # away from the outline's one or two pixels of anti-aliasing and compression, what is seen is shown
        assert (seen != shown)[~near].mean() < 0.01


def test_a_recording_is_the_same_to_the_last_bit(folder, tmp_path):
    for recording, camera in ((CALIBRATION, "cam02"), ("free_01", "cam01")):
        path = rehearse_recording(SETTINGS, recording, camera, tmp_path)
        digests = [hashlib.sha256((root / path).read_bytes()).hexdigest() for root in (folder, tmp_path)]
        assert digests[0] == digests[1]


def test_a_piece_that_fails_is_told_by_name(tmp_path):
    pieces = [("rehearse_recording", "no_such_take", "cam00")]
    with pytest.raises(RuntimeError, match="rehearse_recording no_such_take cam00: ValueError"):
        list(carry_out(pieces, SETTINGS.model_dump_json(), tmp_path, 2))


def test_the_scan_lies_on_the_subject_in_its_own_unit_place_and_topology(folder):
    import trimesh
    from scipy.spatial import cKDTree

    scan = trimesh.load(folder / "scan/neutral.ply", process=False)
    placed = json.loads((folder / "truth/scan.json").read_text())["scan_from_world"]
    world = (scan.vertices - placed["t"]) @ np.array(placed["R"]) / placed["scale"]
    rest = subject_of(SETTINGS).rest_m
    distance = cKDTree(rest).query(world)[0]
    # vertices of the subject lie up to 4 mm apart, so the nearest one is within 2.5 mm of any point of its surface
    assert np.percentile(distance, 99) < 0.0025
    assert len(scan.vertices) != len(rest)
    assert np.ptp(scan.visual.vertex_colors[:, :3].astype(int), axis=0).min() > 60
    assert len(scan.faces) <= 20_000


def test_a_rolling_shutter_reads_rows_later(tmp_path):
    settings = SETTINGS.model_copy(
        update={
            "sensor": SensorSettings(rolling_shutter_s=0.03, rolling_shutter_bands=4),
            "clock": ClockSettings(start_spread_s=0),
        }
    )
    still = settings.model_copy(update={"sensor": SensorSettings()})
    rolled = _read(tmp_path / "a" / rehearse_recording(settings, CALIBRATION, "cam01", tmp_path / "a"))[1].astype(float)
    whole = _read(tmp_path / "b" / rehearse_recording(still, CALIBRATION, "cam01", tmp_path / "b"))[1].astype(float)
    # the board rests until 0.1 s: frame 0 agrees (its noise is the same); in frame 4, halfway through the move, the
    # lower rows are ahead of the global shutter's
    difference = np.abs(rolled - whole).mean((1, 2, 3))
    assert difference[0] < 0.5
    assert difference[4] > 2 * difference[0] + 0.5


def test_lips_are_tattooed_where_the_take_says_so(tmp_path):
    """Without a word in takes of lips alone; at first the subject rests, so that ink is all that tells the takes apart."""
    said = {"lips": None, "bare": False, "speech": None, "inked": True}
    kinds = {"lips": "lips", "bare": "lips", "speech": "speech", "inked": "speech"}
    settings = RehearsalSettings(
        seed=7,
        cameras=(CameraSettings(name="front", position_m=(0, -0.07, 0.7), look_at_m=(0, -0.07, 0.09), vertical_fov_deg=12),),
        video=VideoSettings(width=96, height=96, rate_hz=5),
        takes=tuple(TakeSettings(name=name, kind=kinds[name], duration_s=0.5, lip_tattoo=said[name]) for name in said),
    )
    first = {}
    for name in said:
        path = rehearse_recording(settings, name, "front", tmp_path)
        first[name] = _read(tmp_path / path)[1][0].astype(float)

    def apart(a, b):
        return np.abs(first[a] - first[b])[24:72, 24:72].mean()

    # noise and codec make one difference, ink the other
    assert apart("lips", "inked") < 5
    assert apart("bare", "speech") < 5
    assert apart("lips", "bare") > 4 * max(apart("lips", "inked"), apart("bare", "speech"))
