"""A mesh sequence in one topology: one memory-mappable npy per chunk, read lazily through a JSON manifest."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import ArtifactError, atomic_path, load_json, save_json

KIND, SCHEMA = "mesh_sequence", 1


@dataclass(frozen=True)
class MeshSequence:
    """Positions over time; `positions` reads the chunk files lazily."""

    take: str
    time_s: NDArray[np.float64]
    """(t,) on the take's common clock."""
    chunks: tuple[Path, ...]
    """npy files (frames, vertices, 3) float32, metres, in order."""

    def __len__(self) -> int:
        return len(self.time_s)

    def __iter__(self):
        for chunk in self.chunks:
            yield from np.load(chunk, mmap_mode="r")

    def positions(self) -> NDArray[np.float32]:
        """All frames in memory, (t, n, 3) float32 metres; iterate the sequence instead where it may not fit."""
        return np.concatenate([np.load(chunk, mmap_mode="r") for chunk in self.chunks])

    def save(self, path: Path | str) -> None:
        """Write the JSON manifest `headcap.mesh_sequence/1`; the chunks are written by `save_chunk`."""
        folder = Path(path).parent
        shapes = [np.load(chunk, mmap_mode="r").shape for chunk in self.chunks]
        if sum(shape[0] for shape in shapes) != len(self) or len({shape[1:] for shape in shapes}) != 1:
            raise ValueError(f"chunks of shapes {shapes} do not make {len(self)} frames of one topology")
        content = {
            "take": self.take,
            "time_s": [float(t) for t in self.time_s],
            "vertices": shapes[0][1],
            "chunks": [
                {"file": os.path.relpath(chunk, folder), "frames": shape[0]}
                for chunk, shape in zip(self.chunks, shapes, strict=True)
            ],
        }
        save_json(path, KIND, SCHEMA, content)

    @classmethod
    def load(cls, path: Path | str) -> MeshSequence:
        """Read the manifest and check that each chunk is there and whole; raises `ArtifactError`."""
        content = load_json(path, KIND, SCHEMA)
        chunks = tuple(Path(path).parent / chunk["file"] for chunk in content["chunks"])
        for file, chunk in zip(chunks, content["chunks"], strict=True):
            if not file.exists() or np.load(file, mmap_mode="r").shape != (chunk["frames"], content["vertices"], 3):
                raise ArtifactError(f"{file} is missing or not whole; run `track` again")
        return cls(take=content["take"], time_s=np.array(content["time_s"]), chunks=chunks)


def save_chunk(path: Path | str, positions: NDArray) -> None:
    """Write one chunk (frames, vertices, 3) as float32 npy, atomically."""
    with atomic_path(path) as temporary, open(temporary, "wb") as handle:
        np.save(handle, np.ascontiguousarray(positions, np.float32))


class JoinedMeshes:
    """Meshes of several files one after another, (f, n, 3); frames are read from the memory maps when they are indexed."""

    def __init__(self, parts: Sequence[NDArray], vertices: int) -> None:
        """Of parts (f_k, n, 3); `vertices` is n, which no part need tell."""
        self._parts = [part for part in parts if len(part)]
        self._ends = np.cumsum([len(part) for part in self._parts], dtype=np.int64)
        self.shape = (int(self._ends[-1]) if self._parts else 0, vertices, 3)
        self.ndim, self.dtype = 3, np.dtype(np.float32)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, chosen: slice | NDArray) -> NDArray[np.float32]:
        """Frames (k, n, 3) in memory, by slice, numbers or mask."""
        numbers = np.arange(len(self))[chosen]
        out = np.empty((len(numbers), *self.shape[1:]), self.dtype)
        part_of = np.searchsorted(self._ends, numbers, side="right")
        for k in np.unique(part_of):
            here = part_of == k
            out[here] = self._parts[k][numbers[here] - (self._ends[k] - len(self._parts[k]))]
        return out


def joined(sequence: MeshSequence, vertices: int) -> JoinedMeshes:
    """A tracked take's frames as one array that is read when it is indexed."""
    return JoinedMeshes([np.load(chunk, mmap_mode="r") for chunk in sequence.chunks], vertices)
