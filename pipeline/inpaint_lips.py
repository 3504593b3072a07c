"""A tattooed take, as one camera recorded it, to a recording of the same lips bare."""

import logging
from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.calibration.result import CalibrationResult
from headcap.lips.clips import frontal_camera
from headcap.lips.inpainting import InpaintingSettings, TrackedTakeFiles, bare_lips, inpaint_take
from headcap.registration.template import Template

PROGRESS = logging.getLogger("headcap.progress")


def run(
    *,
    rig: Path,
    start: Path,
    ingested: Path,
    offsets: Path,
    sequence: Path,
    bare_start: Path,
    bare_ingested: Path,
    bare_offsets: Path,
    bare_sequence: Path,
    inpainted: Path,
    video: Path,
    texture: Path,
    picture: Path,
    name: str | None,
    settings: InpaintingSettings,
) -> None:
    cameras = CalibrationResult.load(rig).rig
    chosen = name or frontal_camera(cameras, Template.load(start))
    bare_take = TrackedTakeFiles(bare_ingested, bare_offsets, bare_sequence).load()
    bare = bare_lips(Template.load(bare_start), cameras, bare_take, chosen, settings)
    bare.texture.save(texture)
    take = TrackedTakeFiles(ingested, offsets, sequence).load()
    painted, figures = inpaint_take(bare.texture, cameras[chosen], take, video, picture)
    painted.save(inpainted)
    PROGRESS.info("inpaint_lips %s: %d frames of %s", painted.take, figures["lips.inpainted_frames"], chosen)
    for artifact, kind in ((texture, "lip_texture"), (inpainted, "ingested_take")):
        write_manifest(
            artifact,
            kind=kind,
            stage="inpaint_lips",
            settings_digest=digest_settings(settings=settings, name=name),
            inputs=[rig, start, ingested, offsets, sequence, bare_start, bare_ingested, bare_offsets, bare_sequence],
            figures=figures | {"lips.untattooed_gap_mm": bare.gap_mm},
        )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
