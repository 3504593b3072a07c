"""The coarse trajectory of a take: where every frame of every chunk starts from."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import ArtifactError, save_arrays
from headcap.registration.keyframes import Keyframe

KIND, SCHEMA = "anchors", 2
MARGIN = 2
"""Neighbours on either side from which a frame's motion is known."""
BLOCK = 64
"""Frames per array in the file, so that a chunk reads its own part only."""


@dataclass(frozen=True)
class Anchors:
    """Vertices of every frame as the coarse pass found them, and the residuals it left."""

    first: int
    """Number of the first frame held."""
    time_s: NDArray[np.float64]
    """(t,) on the take's common clock."""
    positions: NDArray[np.float32]
    """(t, n, 3) metres."""
    residual_px: NDArray[np.float64]
    """(t,) median flow left after the graph, in pixels of the reduced images; 0 at the reference frame."""
    start_s: float
    """Time of the take's first frame, the reference."""
    keyframes: tuple[Keyframe, ...] = ()
    """Later frames whose photographs show what the reference frame hides, in the order they were found."""

    def __len__(self) -> int:
        return len(self.time_s)

    def save(self, path: Path | str) -> None:
        """Write as npz artifact `headcap.anchors/2`, in blocks of frames."""
        blocks = {f"positions/{start:06d}": self.positions[start : start + BLOCK] for start in range(0, len(self), BLOCK)}
        for number, keyframe in enumerate(self.keyframes):
            blocks[f"keyframes/{number:03d}/pixels"] = keyframe.pixels
            blocks[f"keyframes/{number:03d}/serves"] = keyframe.serves
        save_arrays(
            path,
            KIND,
            SCHEMA,
            {"time_s": self.time_s, "residual_px": self.residual_px, **blocks},
            {"first": self.first, "start_s": self.start_s, "keyframes_s": [keyframe.time_s for keyframe in self.keyframes]},
        )

    @classmethod
    def load(cls, path: Path | str, first: int = 0, last: int | None = None) -> Anchors:
        """Read frames `first` to `last` (inclusive) and `MARGIN` neighbours on either side; raises `ArtifactError`."""
        with np.load(path, allow_pickle=False) as archive:
            header = json.loads(str(archive["__header__"])) if "__header__" in archive.files else {}
            if header.get("schema") != f"headcap.{KIND}/{SCHEMA}":
                found = header.get("schema", "no headcap artifact")
                raise ArtifactError(
                    f"{path} holds {found}, expected headcap.{KIND}/{SCHEMA}; run `track` again with this version"
                )
            times, residuals, start = archive["time_s"], archive["residual_px"], header["meta"]["first"]
            low = max(first - MARGIN - start, 0)
            high = len(times) - 1 if last is None else min(last + MARGIN - start, len(times) - 1)
            keyframes = tuple(
                Keyframe(time_s, archive[f"keyframes/{k:03d}/pixels"], archive[f"keyframes/{k:03d}/serves"])
                for k, time_s in enumerate(header["meta"]["keyframes_s"])
            )
            blocks = [archive[f"positions/{b:06d}"] for b in range(low // BLOCK * BLOCK, high + 1, BLOCK)]
        positions = np.concatenate(blocks)[low % BLOCK :][: high - low + 1]
        return cls(start + low, times[low : high + 1], positions, residuals[low : high + 1], header["meta"]["start_s"], keyframes)

    def frame(self, number: int) -> NDArray[np.float64]:
        """Vertices (n, 3) of frame `number` of the take."""
        return self.positions[number - self.first].astype(np.float64)
