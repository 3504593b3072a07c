"""PC2 point caches, read: positions of one topology over time, as Blender's Mesh Cache and 3ds Max write them."""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import ArtifactError

# "POINTCACHE2\0", version 1, points, first frame, frames per sample, samples; then float32 x, y, z, little endian
HEADER = struct.Struct("<12siiffi")
MAGIC = b"POINTCACHE2\0"


@dataclass(frozen=True)
class PointCache:
    """Content of a PC2 file."""

    positions: NDArray[np.float32]
    """(t, n, 3), memory-mapped."""
    first_frame: float
    frames_per_sample: float


def read_pc2(path: Path | str) -> PointCache:
    """Read a PC2 file; raises `ArtifactError` where it is none or cut short."""
    with open(path, "rb") as handle:
        header = handle.read(HEADER.size)
    if len(header) < HEADER.size or not header.startswith(MAGIC):
        raise ArtifactError(f"{path} is no PC2 point cache; export it again")
    _, version, points, first_frame, frames_per_sample, samples = HEADER.unpack(header)
    if version != 1 or Path(path).stat().st_size != HEADER.size + 12 * points * samples:
        raise ArtifactError(f"{path} is cut short or of another version ({version}); export it again")
    positions = np.memmap(path, "<f4", "r", HEADER.size, (samples, points, 3))
    return PointCache(positions, first_frame, frames_per_sample)
