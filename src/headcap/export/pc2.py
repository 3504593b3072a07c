"""PC2 point caches: positions of one topology over time, as Blender's Mesh Cache and 3ds Max read them."""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import ArtifactError, atomic_path
from headcap.registration.sequence import MeshSequence

# "POINTCACHE2\0", version 1, points, first frame, frames per sample, samples; then float32 x, y, z, little endian
_HEADER = struct.Struct("<12siiffi")
_MAGIC = b"POINTCACHE2\0"


@dataclass(frozen=True)
class PointCache:
    """Content of a PC2 file."""

    positions: NDArray[np.float32]
    """(t, n, 3), memory-mapped."""
    first_frame: float
    frames_per_sample: float


def write_pc2(path: Path | str, sequence: MeshSequence, *, first_frame: float = 0.0, frames_per_sample: float = 1.0) -> None:
    """Write a sequence as PC2, frame by frame; metres, vertices in the sequence's order."""
    with atomic_path(path) as temporary, open(temporary, "wb") as handle:
        count = 0
        for positions in sequence:
            if count == 0:
                handle.write(_HEADER.pack(_MAGIC, 1, len(positions), first_frame, frames_per_sample, len(sequence)))
            handle.write(np.ascontiguousarray(positions, "<f4").tobytes())
            count += 1
        if count == 0:
            raise ValueError(f"{sequence.take}: a sequence without frames makes no point cache")


def read_pc2(path: Path | str) -> PointCache:
    """Read a PC2 file; raises `ArtifactError` where it is none or cut short."""
    with open(path, "rb") as handle:
        header = handle.read(_HEADER.size)
    if len(header) < _HEADER.size or not header.startswith(_MAGIC):
        raise ArtifactError(f"{path} is no PC2 point cache; export it again")
    _, version, points, first_frame, frames_per_sample, samples = _HEADER.unpack(header)
    if version != 1 or Path(path).stat().st_size != _HEADER.size + 12 * points * samples:
        raise ArtifactError(f"{path} is cut short or of another version ({version}); export it again")
    positions = np.memmap(path, "<f4", "r", _HEADER.size, (samples, points, 3))
    return PointCache(positions, first_frame, frames_per_sample)
