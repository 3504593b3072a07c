"""Pictures of lips: what is wrong shows, what has no answer stays empty, and the video holds every frame."""

import av
import cv2
import numpy as np
import pytest

from headcap.errors import InputError
from headcap.evaluation.lip_errors import LipErrors
from headcap.evaluation.lips_study import LipStudy
from headcap.evaluation.metrics import save_metrics
from headcap.heads import base_head
from headcap.lips.mouth import find_mouth
from headcap.report.lips import LipFiles, write_lips_report
from headcap.report.lips_figures import error_bars, gap_curves, input_bars, roll_curves
from headcap.report.lips_pictures import comparison, error_maps, side_by_side_frames, telling_frames, write_side_by_side
from headcap.report.overlays import virtual_camera

FRAMES = 30


@pytest.fixture(scope="module")
def head():
    return base_head()


@pytest.fixture(scope="module")
def mouth(head):
    return find_mouth(head.vertices, head.triangles, head.regions)


@pytest.fixture(scope="module")
def errors(mouth):
    """A take with one opening and one roll; the correction halves the error."""
    time_s, methods = np.arange(FRAMES) / 25, ("base", "GR", "GR affine", "GR shape")
    truth = 4 * np.exp(-0.5 * ((np.arange(FRAMES) - 8) / 2.0) ** 2)
    share = np.array([1.0, 0.5, 0.6, 0.7])
    error = share[:, None] * (1 + truth)
    roll = np.zeros((5, FRAMES, 2))
    roll[-1, 20] = 30.0
    return LipErrors(
        person="anna",
        take="smile",
        methods=methods,
        time_s=time_s,
        truth_known=np.ones(FRAMES, bool),
        vertices=mouth.vertices,
        error_mm=error,
        square_mm2=1.1 * error**2,
        shape_error_mm=0.5 * error,
        vertex_error_mm=np.repeat(6 * share[:, None], len(mouth.vertices), axis=1),
        gap_mm=np.concatenate([(1 - 0.5 * share)[:, None] * truth, truth[None]]),
        roll_deg=roll,
        roll_error_deg=error,
        layer_error=np.where(share[:, None] < 1, error, np.nan),
        scale=1.0,
    )


def test_the_frames_shown_are_those_that_differ_most(errors):
    assert {8, 20} <= set(telling_frames(errors, 3).tolist())
    assert (np.diff(telling_frames(errors, 6)) > 0).all()
    assert len(telling_frames(errors, 100)) == FRAMES


def test_error_maps_colour_what_errs(head, errors):
    image = error_maps(errors, head.vertices, head.triangles, ["base", "GR"], top=6.0)
    half = image.shape[1] // 2
    # viridis: yellow is much, green half of it, blue little
    yellow = (image[..., 0].astype(int) > 120) & (image[..., 2] < 90)
    assert yellow[:, :half].sum() > 50 * max(1, yellow[:, half : int(1.7 * half)].sum())


def test_diagrams_are_drawn(errors):
    study = LipStudy.of("lips", [errors])
    for image in (error_bars(study), input_bars(study, "GR"), gap_curves(errors, ["base", "GR"]), roll_curves(errors, ["GR"])):
        assert image.ndim == 3
        assert image.std() > 5


def test_a_comparison_leaves_what_was_not_answered_empty(head, mouth):
    neutral, lost = head.vertices, np.full_like(head.vertices, np.nan)
    full, part = (
        comparison([("0.1 s", {"base": neutral, "GR": other})], head.triangles, mouth.vertices) for other in (neutral, lost)
    )
    assert full.shape == part.shape
    dark = lambda image: (image < 200).all(axis=2)[:, image.shape[1] // 2 + 10 :].sum()  # noqa: E731
    assert dark(part) < 0.2 * dark(full)


def test_the_video_shows_every_frame_and_says_what_is_missing(head, mouth, tmp_path):
    camera = virtual_camera(head.vertices, 0.0, height=200)
    photograph = np.full((camera.height, camera.width, 3), 90, np.uint8)
    meshes = np.stack([head.vertices] * 4)
    lost = meshes.copy()
    lost[2] = np.nan
    frames = list(
        side_by_side_frames(
            [photograph] * 4,
            camera,
            head.triangles,
            {"base": lost, "GR": lost, "truth": meshes},
            head.vertices[mouth.vertices],
            height=120,
        )
    )
    third = frames[0].shape[1] // 3
    assert (frames[0][30:, 2 * third + 8 :] == frames[2][30:, 2 * third + 8 :]).all()
    assert (frames[2][30:, third + 8 : 2 * third - 8] == 255).all()
    assert (frames[2][30:, : third - 8] == 90).all()
    write_side_by_side(tmp_path / "lips.mp4", frames, 25.0)
    with av.open(str(tmp_path / "lips.mp4")) as container:
        stream = container.streams.video[0]
        read = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        assert float(stream.average_rate) == 25.0
    assert len(read) == 4
    height, width = frames[0].shape[:2]
    assert read[0].shape == (height + height % 2, width + width % 2, 3)
    assert np.abs(read[3][:height, :width].astype(int) - frames[3]).mean() < 6


def test_a_video_needs_pictures(tmp_path):
    with pytest.raises(InputError, match="without pictures"):
        write_side_by_side(tmp_path / "none.mp4", [], 25.0)
    assert not (tmp_path / "none.mp4").exists()


@pytest.mark.parametrize("painted", [(), ("anna/inpaint_lips/smile.png",)])
def test_the_page_shows_what_was_painted_over_where_lips_were_tattooed(errors, tmp_path, painted):
    LipStudy.of("lips", [errors]).save(tmp_path / "tables.json")
    save_metrics(tmp_path / "figures.json", [])
    pictures = [tmp_path / "base/smile.png", *(tmp_path / name for name in painted)]
    for path in pictures:
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), np.full((20, 30, 3), 90, np.uint8))
    sheet, *inpainted = pictures
    files = LipFiles(
        tmp_path / "tables.json", tmp_path / "figures.json", (sheet,), (sheet,), (sheet,), tuple(inpainted), (sheet,)
    )
    write_lips_report(files, {"anna": "held out"}, {}, tmp_path / "lips.html")
    page = (tmp_path / "lips.html").read_text()
    assert ("Figure 5: anna, smile" in page) == ("Tattoos painted over" in page) == bool(painted)
    assert set(inpainted) <= set(files.all)
