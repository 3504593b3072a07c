"""The point clouds of consecutive frames: one PLY file each, listed in a JSON file that is written last."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from headcap.artifacts import ArtifactError, digest_file, load_json, save_json
from headcap.reconstruction.points import PointCloud

KIND, SCHEMA = "cloud_sequence", 1


@dataclass(frozen=True)
class CloudSequence:
    """Point clouds by frame; they are read when asked for."""

    take: str
    frames: tuple[int, ...]
    """Frame numbers of the take; a frame that too few cameras saw is left out."""
    time_s: tuple[float, ...]
    """Their moments on the common clock."""
    files: tuple[Path, ...]
    """PLY files, frame by frame."""

    @classmethod
    def of(cls, take: str, clouds: Iterable[tuple[int, float, Path]]) -> CloudSequence:
        """From frame, moment and file of each cloud."""
        clouds = list(clouds)
        return cls(take, *(tuple(cloud[k] for cloud in clouds) for k in range(3)))

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, frame: int) -> PointCloud:
        """The cloud of a frame number; raises `KeyError` where the sequence does not hold it."""
        if frame not in self.frames:
            raise KeyError(f"{self.take} has no cloud of frame {frame}")
        return PointCloud.load(self.files[self.frames.index(frame)])

    def at(self, time_s: float) -> PointCloud | None:
        """The cloud of a moment, or None where that frame has none."""
        match = [k for k, time in enumerate(self.time_s) if abs(time - time_s) < 1e-6]
        return PointCloud.load(self.files[match[0]]) if match else None

    def __iter__(self) -> Iterator[PointCloud]:
        return map(PointCloud.load, self.files)

    def save(self, path: Path | str) -> None:
        """Write the JSON artifact `headcap.cloud_sequence/1` with the digest of each file."""
        folder = Path(path).parent
        clouds = [
            {"frame": frame, "time_s": time, "file": os.path.relpath(file, folder), "digest": digest_file(file)}
            for frame, time, file in zip(self.frames, self.time_s, self.files, strict=True)
        ]
        save_json(path, KIND, SCHEMA, {"take": self.take, "clouds": clouds})

    @classmethod
    def load(cls, *paths: Path | str) -> CloudSequence:
        """Read and join lists of one take; raises `ArtifactError` where a file is missing or not the one listed."""
        take, clouds = "", []
        for path in paths:
            content = load_json(path, KIND, SCHEMA)
            if take and content["take"] != take:
                raise ArtifactError(f"{path} is of {content['take']}, not of {take}; give lists of one take")
            take = content["take"]
            clouds += [(cloud["frame"], cloud["time_s"], _checked(Path(path), cloud)) for cloud in content["clouds"]]
        return cls.of(take, sorted(clouds))


def _checked(listing: Path, cloud: dict) -> Path:
    file = listing.parent / cloud["file"]
    if not file.exists() or digest_file(file) != cloud["digest"]:
        raise ArtifactError(f"{file} is missing or was changed; delete {listing} and run `reconstruct` again")
    return file


def cloud_file(folder: Path | str, frame: int) -> Path:
    """Where the cloud of a frame lies."""
    return Path(folder) / f"frame_{frame:06d}.ply"
