"""Recordings of a take, or of the board, to an ingested take: probed, and refused where they cannot be used."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.recordings.settings import IngestSettings
from headcap.recordings.takes import ingest_take


def run(
    *,
    files: list[Path],
    ingested: Path,
    recording: str,
    paths: dict[str, Path],
    recorded: dict,
    rate_hz: float,
    settings: IngestSettings,
) -> None:
    frames = recorded.get("frames")
    take = ingest_take(
        recording,
        recorded.get("kind", "board"),
        paths,
        rate_hz=rate_hz,
        needs_sound=recorded["clap"],
        min_frames=frames[1] + 1 if frames else None,
        settings=settings,
    )
    take.save(ingested)
    write_manifest(
        ingested,
        kind="ingested_take",
        stage="ingest",
        settings_digest=digest_settings(settings=settings, recorded=recorded, rate_hz=rate_hz),
        inputs=list(paths.values()),
        figures={},
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
