"""Small video files written on the spot."""

from collections.abc import Callable, Iterable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

WIDTH, HEIGHT, RATE = 128, 160, 50
AUDIO_RATE = 48000


def textured(seed: int = 7, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """A smooth pattern (height, width + 40, 3) uint8 with detail at 4 to 30 pixels, wide enough to slide."""
    rng = np.random.default_rng(seed)
    picture = np.zeros((height, width + 40, 3))
    y, x = np.mgrid[:height, : width + 40]
    for _ in range(24):
        direction, wave = rng.uniform(0, np.pi), rng.uniform(6, 30)
        phase = (x * np.cos(direction) + y * np.sin(direction)) * 2 * np.pi / wave + rng.uniform(0, 6.3)
        picture += rng.uniform(3, 12) * np.sin(phase)[..., None] * rng.uniform(0.5, 1, 3)
    return np.clip(picture + 120, 0, 255).astype(np.uint8)


def sliding(count: int, seed: int = 7, width: int = WIDTH, height: int = HEIGHT) -> list[np.ndarray]:
    """Frames of a pattern that slides one pixel a frame, back and forth over 30."""
    pattern = textured(seed, width, height)
    shifts = [abs((k + 30) % 60 - 30) for k in range(count)]
    return [np.ascontiguousarray(pattern[:, s : s + width]) for s in shifts]


def _add_sound(container, samples: np.ndarray) -> Callable[[], None]:
    stream = container.add_stream("aac", rate=AUDIO_RATE, layout="mono")

    def write() -> None:
        frame = av.AudioFrame.from_ndarray(samples[None].astype(np.float32), format="fltp", layout="mono")
        frame.sample_rate, frame.pts, frame.time_base = AUDIO_RATE, 0, Fraction(1, AUDIO_RATE)
        for packet in [*stream.encode(frame), *stream.encode(None)]:
            container.mux(packet)

    return write


def turned(mp4: bytes, deg: int) -> bytes:
    """The mp4 with its picture track's matrix set to a turn by so many degrees counter-clockwise (a multiple of 90)."""
    at = mp4.index(b"tkhd") + 4 + 40  # version 0: 4 flags, 20 times and ids, 8 reserved, 8 layer to reserved
    across, up = {0: (1, 0), 90: (0, 1), 180: (-1, 0), 270: (0, -1)}[deg]
    fixed = [across << 16, -up * 0x10000, 0, up << 16, across << 16, 0, 0, 0, 0x40000000]
    return mp4[:at] + b"".join(value.to_bytes(4, "big", signed=True) for value in fixed) + mp4[at + 36 :]


@pytest.fixture
def with_display_rotation() -> Callable[[bytes, int], bytes]:
    """`turned`: a file that asks to be shown turned."""
    return turned


@pytest.fixture
def slide() -> Callable[..., list[np.ndarray]]:
    """`sliding`: frames whose content moves one pixel a frame."""
    return sliding


@pytest.fixture
def write_video(tmp_path: Path) -> Callable[..., Path]:
    """Write frames as H.264 mp4: `numbers` gives each frame's place on the grid (dropped frames leave some out)."""

    def write(
        name: str,
        frames: Iterable[np.ndarray],
        *,
        rate: int = RATE,
        numbers: Iterable[float] | None = None,
        sound: np.ndarray | None = None,
        gop: int = 12,
        faststart: bool = False,
    ) -> Path:
        frames, path = list(frames), tmp_path / f"{name}.mp4"
        height, width = frames[0].shape[:2]
        options = {"movflags": "faststart"} if faststart else {}
        with av.open(str(path), "w", options=options) as container:
            stream = container.add_stream("libx264", rate=rate)
            stream.width, stream.height, stream.pix_fmt, stream.gop_size = width, height, "yuv420p", gop
            stream.time_base = stream.codec_context.time_base = Fraction(1, 12800)
            stream.codec_context.thread_count = 1
            stream.options = {"crf": "10", "preset": "veryfast"}
            write_sound = _add_sound(container, sound) if sound is not None else None
            for image, number in zip(frames, range(len(frames)) if numbers is None else numbers, strict=False):
                frame = av.VideoFrame.from_ndarray(image, format="bgr24")
                frame.pts, frame.time_base = round(number * 12800 / rate), Fraction(1, 12800)
                for packet in stream.encode(frame):
                    container.mux(packet)
            for packet in stream.encode(None):
                container.mux(packet)
            if write_sound:
                write_sound()
        return path

    return write
