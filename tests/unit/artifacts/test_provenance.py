from pathlib import Path

import pytest

from headcap.artifacts import ArtifactError, digest_settings, save_json, write_manifest
from headcap.artifacts.provenance import provenance_tree


@pytest.fixture
def chain(tmp_path: Path) -> Path:
    """A recording, an artifact made from it, and one made from that."""
    recording, middle, last = tmp_path / "cam.mp4", tmp_path / "ingest" / "take.json", tmp_path / "sync" / "take.json"
    recording.write_bytes(b"pictures")
    for artifact, source, stage in ((middle, recording, "ingest"), (last, middle, "sync")):
        save_json(artifact, stage, 1, {})
        figures = {"sync.residual_ms": 0.01} if stage == "sync" else {}
        write_manifest(artifact, kind=stage, stage=stage, settings_digest=digest_settings(a=1), inputs=[source], figures=figures)
    return last


def test_tree_reaches_from_the_result_to_the_recording(chain: Path) -> None:
    told = "\n".join(provenance_tree(chain))
    assert told.index("[sync") < told.index("[ingest") < told.index("cam.mp4")
    assert "sync.residual_ms = 0.01" in told
    assert "CHANGED" not in told


def test_changed_and_missing_inputs_are_marked(chain: Path) -> None:
    recording = chain.parents[1] / "cam.mp4"
    recording.write_bytes(b"other pictures")
    assert "cam.mp4 CHANGED" in "\n".join(provenance_tree(chain))
    recording.unlink()
    assert "cam.mp4 MISSING" in "\n".join(provenance_tree(chain))


def test_a_file_without_manifest_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ArtifactError, match="no manifest"):
        provenance_tree(tmp_path / "nothing.json")


def test_settings_digest_tells_settings_apart_whatever_their_order() -> None:
    assert digest_settings(a=1, b=2) == digest_settings(b=2, a=1) != digest_settings(a=1, b=3)
