"""Pictures as a video that every browser plays: H.264 in mp4, without sound."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import atomic_path
from headcap.errors import InputError


def write_video(path: Path | str, images: Iterable[NDArray[np.uint8]], rate_hz: float, *, crf: float = 22.0) -> int:
    """Write RGB images (height, width, 3) uint8 of one size at a rate, one at a time; the number written.

    Odd sides gain a row or column of white, which the codec needs. The file appears whole or not at all. Raises `InputError` for
    no image at all or images of different sizes.
    """
    source = iter(images)
    first = next(source, None)
    if first is None:
        raise InputError("a video without pictures", expected="one at least", remedy="Give frames to show.")
    count = 0
    with atomic_path(path) as temporary, av.open(str(temporary), "w", format="mp4") as container:
        stream = container.add_stream(
            "libx264", rate=Fraction(rate_hz).limit_denominator(1001), options={"crf": str(crf), "preset": "veryfast"}
        )
        stream.height, stream.width = (side + side % 2 for side in first.shape[:2])
        stream.pix_fmt = "yuv420p"
        for image in (picture for part in ((first,), source) for picture in part):
            if image.shape != first.shape:
                raise InputError(
                    f"a picture of {image.shape} after {first.shape}", expected="one size", remedy="Cut all pictures alike."
                )
            container.mux(stream.encode(av.VideoFrame.from_ndarray(_even(image), format="rgb24")))
            count += 1
        container.mux(stream.encode(None))
    return count


def _even(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height, width = image.shape[:2]
    padded = np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), constant_values=255)
    return np.ascontiguousarray(padded)
