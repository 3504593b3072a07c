"""The page of single videos: every clip with its video, what was answered and what was not, and closures beside chance."""

import base64
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from headcap.evaluation.lip_clip import CORRECTED, LipClip
from headcap.evaluation.lip_errors import BASE
from headcap.lips.monocular import FrameState
from headcap.recordings.writer import write_video
from headcap.report.lip_clip import ClipFiles, write_clip_report
from headcap.report.lip_clip_figures import clip_curves, told_frames
from headcap.report.lip_clip_video import sound_of_frames
from headcap.speech.words import Word

FRAMES = 60


@pytest.fixture(scope="module")
def clip() -> LipClip:
    """Lips that shut for both closures once they are corrected; lost for a while, later without contours."""
    time_s = np.arange(FRAMES) / 25
    gap = np.stack([np.full(FRAMES, 3.0) + 0.2 * np.sin(9 * time_s), 6 + 2 * np.cos(2 * np.pi * 3 * time_s)])
    for moment in (0.43, 1.03):
        gap[1] -= (gap[1] - 0.2) * np.exp(-0.5 * ((time_s - moment) / 0.05) ** 2)
    contours = np.stack([np.full((FRAMES, 2), 2.0), np.full((FRAMES, 2), 1.0)])
    states = [FrameState.TRACKED] * FRAMES
    states[40:43] = [FrameState.LOST] * 3
    states[43] = FrameState.RESTARTED
    gap[:, 40:43], contours[:, 40:43] = np.nan, np.nan
    gap[1, 50], contours[:, 50] = np.nan, np.nan
    residual = np.where(np.isfinite(gap[0]), 0.0123, np.nan)
    words = (Word("bin", 0.4, 0.7), Word("red", 0.7, 1.0), Word("by", 1.0, 1.2), Word("<now>", 1.2, 1.5))
    found = np.isfinite(contours[0, :, 0])
    many = (BASE, CORRECTED), tuple(states), time_s, residual, residual, found, np.full(FRAMES, 60.0), gap, contours, words
    return LipClip("anna", *many)


def files(clip, folder) -> ClipFiles:
    folder.mkdir()
    clip.save(folder / "clip.npz")
    shades = (np.full((32, 64, 3), 3 * k, np.uint8) for k in range(FRAMES))
    write_video(folder / "overlay.mp4", enumerate(shades), (64, 32), 25.0)
    return ClipFiles(folder / "clip.npz", folder / "overlay.mp4", folder / "corrected.json")


def test_frames_are_told_as_runs():
    assert told_frames(np.array([3, 7, 8, 9, 12])) == "3, 7 to 9, 12"
    assert told_frames(np.array([], int)) == "none"


def test_the_curves_show_closures_and_what_is_missing(clip):
    image, plain = clip_curves(clip), clip_curves(replace(clip, words=()))
    assert image.shape == plain.shape
    upper = slice(0, image.shape[0] // 2)
    assert (image[upper] != plain[upper]).any(axis=2).sum() > 1000
    # the stripe of lost frames is red: more red than blue by far
    red = (image[..., 0].astype(int) - image[..., 2] > 40) & (image[..., 1] < 200)
    assert red.any(axis=0).sum() > 0.02 * image.shape[1]
    nothing = replace(clip, gap_mm=np.full_like(clip.gap_mm, np.nan), contour_px=np.full_like(clip.contour_px, np.nan))
    assert clip_curves(nothing).shape == image.shape


def test_the_page_holds_every_clip_and_what_has_no_answer(clip, tmp_path):
    both = [files(clip, tmp_path / "anna"), files(replace(clip, name="<ben>", words=()), tmp_path / "ben")]
    write_clip_report(both, {"wall": "no face in 20 frames"}, {"regressor": "lips.npz"}, tmp_path / "lips.html")
    page = (tmp_path / "lips.html").read_text()
    videos = re.findall(r'<video[^>]*src="data:video/mp4;base64,([^"]+)"', page)
    assert [base64.b64decode(video) for video in videos] == [each.overlay.read_bytes() for each in both]
    posters = re.findall(r'<video[^>]*poster="data:image/jpeg;base64,([^"]+)"', page)
    shown = [cv2.imdecode(np.frombuffer(base64.b64decode(poster), np.uint8), cv2.IMREAD_COLOR).mean() / 3 for poster in posters]
    # the first closure at 0.43 s, and the middle of a clip without words; codes of a video err by one or two
    assert np.abs(np.array(shown) - [0.43 * 25, FRAMES / 2]).max() < 1.5
    # nothing is fetched, and videos within the page may play
    assert "media-src data:" in page
    assert "http" not in page.replace('<meta http-equiv="', "")
    assert "Frames lost: 40 to 42. Found again: 43." in page
    assert "were not found: 50." in page
    assert "no face in 20 frames" in page
    assert "<ben>" not in page
    assert "&lt;ben&gt;" in page


def test_closures_stand_beside_chance(clip, tmp_path):
    write_clip_report([files(clip, tmp_path / "anna")], {}, {}, tmp_path / "lips.html")
    page = re.sub(r"<[^>]+>", " ", (tmp_path / "lips.html").read_text())
    assert re.search(r"corrected\s+2 of 2", page)
    assert re.search(r"base tracker\s+0 of 2", page)
    assert re.search(r"bin\s+b\s+0.43", page)
    assert re.search(r"by\s+b\s+1.03", page)


def test_without_words_nothing_is_said_of_closures(clip, tmp_path):
    write_clip_report([files(replace(clip, words=()), tmp_path / "anna")], {}, {}, tmp_path / "lips.html")
    assert "by chance" not in (tmp_path / "lips.html").read_text()


def test_sound_is_cut_to_the_frames_and_silence_fills_what_is_missing(tmp_path):
    """A click at 0.5 s stays where it is, whichever frames are shown."""
    samples = np.zeros(48_000, np.float32)
    samples[24_000:24_048] = 0.8
    black = np.zeros((32, 32, 3), np.uint8)
    write_video(tmp_path / "click.mp4", ((k, black) for k in range(25)), (32, 32), 25.0, sound=samples)
    for first_s, last_s in ((0.0, 0.96), (0.4, 0.8), (-0.2, 1.4)):
        heard = sound_of_frames(tmp_path / "click.mp4", np.array([first_s, last_s]))
        assert len(heard) == round((last_s - first_s) * 48_000) + 1
        # a coder of sound smears a click over some hundred samples
        assert np.abs(heard).argmax() / 48_000 == pytest.approx(0.5 - first_s, abs=0.005)
    write_video(tmp_path / "silent.mp4", ((k, black) for k in range(3)), (32, 32), 25.0)
    assert sound_of_frames(tmp_path / "silent.mp4", np.array([0.0, 0.08])) is None
