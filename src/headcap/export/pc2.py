"""PC2 point caches, written: positions of one topology over time, as Blender's Mesh Cache and 3ds Max read them."""

from pathlib import Path

import numpy as np

from headcap.artifacts import atomic_path
from headcap.registration.point_cache import HEADER, MAGIC
from headcap.registration.sequence import MeshSequence


def write_pc2(path: Path | str, sequence: MeshSequence, *, first_frame: float = 0.0, frames_per_sample: float = 1.0) -> None:
    """Write a sequence as PC2, frame by frame; metres, vertices in the sequence's order."""
    with atomic_path(path) as temporary, open(temporary, "wb") as handle:
        count = 0
        for positions in sequence:
            if count == 0:
                handle.write(HEADER.pack(MAGIC, 1, len(positions), first_frame, frames_per_sample, len(sequence)))
            handle.write(np.ascontiguousarray(positions, "<f4").tobytes())
            count += 1
        if count == 0:
            raise ValueError(f"{sequence.take}: a sequence without frames makes no point cache")
