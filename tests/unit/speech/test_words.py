"""Transcripts with times: both kinds of file, what is no transcript, and when words shut the lips."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from headcap.errors import InputError
from headcap.recordings.audio import read_audio
from headcap.speech.words import HOLD_S, Word, closed_letters, lip_closures, read_words


def written(folder, text):
    path = folder / "said.align"
    path.write_text(text)
    return path


def test_whole_numbers_are_samples_of_the_grid_corpus(tmp_path):
    words = read_words(written(tmp_path, "0 23750 sil\n23750 29500 bin\n29500 34000 blue\n34000 74500 sil\n"))
    assert words == (Word("bin", 0.95, 1.18), Word("blue", 1.18, 1.36))


def test_decimal_points_are_seconds(tmp_path):
    words = read_words(written(tmp_path, "0\t0.5\t\n0.5\t0.75\tGood morning\n\n0.75\t1\tsp\n"))
    assert words == (Word("good morning", 0.5, 0.75),)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("0 100 bin\nblue 200 300\n", "line 2: blue 200 300"),
        ("0 100 bin\n50 200 blue\n", "blue from 0.002 to 0.008 s"),
        ("0.5 0.5 bin\n", "bin from 0.5 to 0.5 s"),
        ("-1 100 bin\n", "line 1"),
        ("0 nan bin\n", "line 1"),
        ("0 100 sil\n", "without a word"),
        ("", "without a word"),
    ],
)
def test_what_is_no_transcript_is_refused(tmp_path, text, told):
    with pytest.raises(InputError, match=told):
        read_words(written(tmp_path, text))


def test_what_is_no_text_is_refused(tmp_path):
    (tmp_path / "said.align").write_bytes(b"\xff\xfe\x00bin")
    with pytest.raises(InputError, match="no text"):
        read_words(tmp_path / "said.align")


def test_the_words_of_the_grid_corpus_shut_the_lips_where_they_begin():
    commands = ["bin", "lay", "place", "set", "blue", "green", "red", "white", "at", "by", "in", "with", "again", "now", "please"]
    digits = ["zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine"]
    letters = "abcdefghijklmnopqrstuvxyz"  # w is not said in the corpus
    closed = {word: closed_letters(word) for word in (*commands, "soon", *digits, *letters)}
    assert {word for word, found in closed.items() if found} == {"bin", "place", "blue", "by", "please", "b", "m", "p"}
    # the name of m begins with a vowel and ends with the closure
    assert closed.pop("m") == [("m", 1.0)]
    assert all(share == 0 for found in closed.values() for _, share in found)


@pytest.mark.parametrize(
    ("word", "sounds"),
    [
        ("thumb", [("m", 1.0)]),
        ("phone", []),
        ("psalm", [("m", 1.0)]),
        ("time", [("m", 1.0)]),
        ("jump", [("m", 1.0)]),
        ("hamper", [("m", 0.5)]),
        ("baby", [("b", 0.0), ("b", 0.625)]),
        ("w", [("b", 0.5)]),
    ],
)
def test_spelling_tells_which_letters_sound(word, sounds):
    assert closed_letters(word) == sounds


def test_a_closure_is_held_within_its_word():
    words = (Word("bin", 0.95, 1.18), Word("m", 1.2, 1.5), Word("hamper", 2.0, 2.4), Word("b", 3.0, 3.04))
    closures = lip_closures(words)
    assert [closure.sound for closure in closures] == ["b", "m", "m", "b"]
    assert [closure.time_s for closure in closures] == pytest.approx([0.95 + HOLD_S / 2, 1.5 - HOLD_S / 2, 2.2, 3.02])
    # a word shorter than a closure has it in its middle
    assert closures[-1].word == "b"


WORDS = Path(__file__).parents[2] / "bench/talking_faces_words"


@pytest.mark.real
@pytest.mark.parametrize("path", sorted(WORDS.glob("*.align")), ids=lambda path: path.stem)
def test_the_words_of_the_talking_faces_fit_their_sound(path, test_data):
    """What was read off the sound: clips say what their names spell, and lips that are shut let nothing above the voice out."""
    words = read_words(path)
    initials = {"zero": "z", "one": "1", "two": "2", "three": "3", "four": "4", "five": "5", "six": "6", "seven": "7"}
    assert "".join(initials.get(word.text, word.text[0]) for word in words) == path.stem
    samples, rate_hz, start_s = read_audio(test_data / f"talking_faces/{path.stem}.mpg", 16_000)
    bright = sosfiltfilt(butter(4, 800, "high", fs=rate_hz, output="sos"), samples) ** 2
    power = np.convolve(bright, np.full(rate_hz // 100, 100 / rate_hz), mode="same")
    for closure in lip_closures(words):
        word = next(word for word in words if word.start_s <= closure.time_s <= word.end_s)
        first, at, last = (round((moment - start_s) * rate_hz) for moment in (word.start_s, closure.time_s, word.end_s))
        # within 20 ms of its middle a stop is 20 dB below its vowel at least
        assert 10 * np.log10(power[first:last].max() / power[at - rate_hz // 50 : at + rate_hz // 50].min()) > 20
