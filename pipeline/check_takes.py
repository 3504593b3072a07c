"""All recordings of a session beside each other: one size and turn per camera, no file given to two takes, none frozen."""

from pathlib import Path

from headcap.artifacts import digest_settings, save_json, write_manifest
from headcap.errors import InputErrors
from headcap.recordings.settings import IngestSettings
from headcap.recordings.takes import IngestedTake, check_same_cameras, freezes_of
from headcap.sync.rough import rough_start_s
from headcap.sync.settings import SyncSettings


def run(
    *,
    ingested: list[Path],
    checked: Path,
    manual_s: dict[str, dict[str, float]],
    settings: IngestSettings,
    sync: SyncSettings,
) -> None:
    takes = [IngestedTake.load(path) for path in ingested]
    check_same_cameras(takes)
    frozen = []
    for take in takes:
        frozen += freezes_of(take, settings, start_s=rough_start_s(take, manual_s[take.take], sync))
    if frozen:
        raise InputErrors(frozen)
    save_json(checked, "take_check", 1, {"takes": [take.take for take in takes]})
    digest = digest_settings(settings=settings, sync=sync, manual_s=manual_s)
    write_manifest(checked, kind="take_check", stage="ingest", settings_digest=digest, inputs=ingested, figures={})


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
