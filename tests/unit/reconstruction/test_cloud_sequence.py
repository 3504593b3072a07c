from pathlib import Path

import numpy as np
import pytest

from headcap.artifacts import ArtifactError
from headcap.reconstruction.cloud_sequence import CloudSequence, cloud_file
from headcap.reconstruction.points import PointCloud


def write_chunk(folder: Path, chunk: int, frames: list[int]) -> Path:
    """A chunk whose cloud of frame k has k points."""
    done = []
    for frame in frames:
        blank = np.zeros((frame, 3), np.float32)
        cloud = PointCloud(blank, blank, np.ones(frame, np.float32), np.zeros((frame, 3), np.uint8), frame / 60)
        cloud.save(cloud_file(folder, frame))
        done.append((frame, frame / 60, cloud_file(folder, frame)))
    path = folder / f"chunk_{chunk:03d}.json"
    CloudSequence.of("pose_01", done).save(path)
    return path


def test_chunks_join_by_frame_whatever_their_order(tmp_path: Path) -> None:
    later, earlier = write_chunk(tmp_path, 1, [7, 8]), write_chunk(tmp_path, 0, [5, 6])
    joined = CloudSequence.load(later, earlier)
    assert joined.frames == (5, 6, 7, 8)
    assert [len(cloud) for cloud in joined] == [5, 6, 7, 8]
    assert len(joined[7]) == 7
    with pytest.raises(KeyError, match="no cloud of frame 9"):
        joined[9]


def test_a_moment_without_a_cloud_is_none(tmp_path: Path) -> None:
    clouds = CloudSequence.load(write_chunk(tmp_path, 0, [5, 7]))
    assert len(clouds.at(7 / 60)) == 7
    assert clouds.at(6 / 60) is None
    assert len(CloudSequence.load(write_chunk(tmp_path, 1, []))) == 0


def test_a_file_that_changed_or_went_is_refused_by_name(tmp_path: Path) -> None:
    path = write_chunk(tmp_path, 0, [5, 6])
    file = cloud_file(tmp_path, 6)
    content = bytearray(file.read_bytes())
    content[-1] ^= 1
    file.write_bytes(content)
    with pytest.raises(ArtifactError, match=r"frame_000006\.ply is missing or was changed"):
        CloudSequence.load(path)
    file.unlink()
    with pytest.raises(ArtifactError, match=r"frame_000006\.ply is missing or was changed"):
        CloudSequence.load(path)
