"""The board's recordings to start times by sound alone, before the cameras' places are known."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.recordings.takes import IngestedTake
from headcap.sync.board_sound import read_sounds
from headcap.sync.settings import SyncSettings
from headcap.sync.solve import synchronise


def run(*, ingested: Path, checked: Path, offsets: Path, manual_s: dict[str, float], settings: SyncSettings) -> None:
    take = IngestedTake.load(ingested)
    found = synchronise(read_sounds(take), take=take.take, manual_start_s=manual_s, settings=settings)
    found.offsets.save(offsets)
    write_manifest(
        offsets,
        kind="time_offsets",
        stage="sync_board",
        settings_digest=digest_settings(settings=settings, manual_s=manual_s),
        inputs=[ingested, checked],
        figures={},
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
