"""The board's sound against the board's motion: the clapper's place, and each camera's lag of sound behind picture."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.calibration.result import CalibrationResult
from headcap.recordings.takes import IngestedTake
from headcap.sync import TimeOffsets
from headcap.sync.board_sound import place_clapper, save_clapper
from headcap.sync.settings import SyncSettings


def run(
    *,
    ingested: Path,
    rig: Path,
    offsets: Path,
    clapper: Path,
    clap: bool,
    clapper_m: tuple[float, float, float],
    settings: SyncSettings,
) -> None:
    result = CalibrationResult.load(rig)
    timed = [camera for camera in result.cameras if camera.av_offset_s is not None]
    found = place_clapper(
        IngestedTake.load(ingested),
        TimeOffsets.load(offsets),
        {camera.camera: camera.av_offset_s for camera in timed},
        {camera.camera: camera.av_offset_sigma_s for camera in timed},
        dict(zip(result.rig.names, result.rig.centres, strict=True)),
        clapper_m,
        clap=clap,
        settings=settings,
    )
    save_clapper(found, clapper)
    write_manifest(
        clapper,
        kind="clapper",
        stage="place_clapper",
        settings_digest=digest_settings(settings=settings, clap=clap, clapper_m=clapper_m),
        inputs=[ingested, rig, offsets],
        figures={},
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
