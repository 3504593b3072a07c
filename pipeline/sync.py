"""A take's recordings to start times on one clock, and the moments at which the take is worked on."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.artifacts.gates import enforce, judge
from headcap.calibration.result import CalibrationResult
from headcap.recordings.takes import IngestedTake
from headcap.sync.board_sound import load_clapper, read_sounds
from headcap.sync.figure import save_sync_figure
from headcap.sync.settings import SyncSettings
from headcap.sync.solve import synchronise
from headcap.sync.timeline import make_timeline


def run(
    *,
    ingested: Path,
    rig: Path,
    clapper: Path,
    offsets: Path,
    timeline: Path,
    figure: Path,
    manual_s: dict[str, float],
    frames: tuple[int, int] | None,
    limits: dict[str, float],
    allow: tuple[str, ...],
    settings: SyncSettings,
) -> None:
    take, calibrated, placed = IngestedTake.load(ingested), CalibrationResult.load(rig).rig, load_clapper(clapper)
    sounds = read_sounds(take)
    found = synchronise(
        sounds,
        take=take.take,
        camera_centres=dict(zip(calibrated.names, calibrated.centres, strict=True)),
        clapper_m=placed.clapper_m,
        av_offset_s=placed.av_offset_s,
        manual_start_s=manual_s,
        settings=settings,
    )
    remedy = f"{take.take}: listen to its recordings, or give its start times by hand under offsets_s."
    enforce(judge(found.figures, limits, allow), remedy)
    make_timeline(take, found.offsets, frames=frames).save(timeline)
    found.offsets.save(offsets)
    save_sync_figure(figure, found, sounds, min_confidence=settings.min_confidence)
    digest = digest_settings(settings=settings, manual_s=manual_s, frames=frames)
    for artifact, kind, figures in ((offsets, "time_offsets", found.figures), (timeline, "take_timeline", {})):
        write_manifest(
            artifact, kind=kind, stage="sync", settings_digest=digest, inputs=[ingested, rig, clapper], figures=figures
        )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
