"""All recordings of a session beside each other: one size and turn per camera, no file given to two takes."""

from pathlib import Path

from headcap.artifacts import digest_settings, save_json, write_manifest
from headcap.recordings.takes import IngestedTake, check_same_cameras


def run(*, ingested: list[Path], checked: Path) -> None:
    takes = [IngestedTake.load(path) for path in ingested]
    check_same_cameras(takes)
    save_json(checked, "take_check", 1, {"takes": [take.take for take in takes]})
    write_manifest(checked, kind="take_check", stage="ingest", settings_digest=digest_settings(), inputs=ingested, figures={})


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
