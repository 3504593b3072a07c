"""The template and a take's first frame to the template on that frame, textured by all cameras."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.calibration.result import CalibrationResult
from headcap.reconstruction.cloud_sequence import CloudSequence
from headcap.recordings.takes import IngestedTake
from headcap.registration.place import PlaceSettings, fit_placement
from headcap.registration.start import prepare_start
from headcap.registration.template import Template
from headcap.registration.track_settings import TrackSettings
from headcap.sync import TimeOffsets
from headcap.sync.timeline import TakeTimeline, open_take


def run(
    *,
    template: Path,
    clouds: Path,
    ingested: Path,
    offsets: Path,
    timeline: Path,
    rig: Path,
    start: Path,
    place: PlaceSettings,
    settings: TrackSettings,
) -> None:
    moments, calibrated = TakeTimeline.load(timeline), CalibrationResult.load(rig).rig
    first_s = float(moments.time_s[0])
    with open_take(IngestedTake.load(ingested), TimeOffsets.load(offsets)) as take:
        images = take.images_at(first_s)
    cloud = CloudSequence.load(clouds)[int(moments.frames[0])]
    registered = Template.load(template)
    placed = fit_placement(registered, cloud, place)
    in_world = registered.transformed(placed.world_from_template)
    prepared = prepare_start(in_world, calibrated, [images.get(name) for name in calibrated.names], cloud, settings)
    prepared.save(start)
    write_manifest(
        start,
        kind="template",
        stage="track_start",
        settings_digest=digest_settings(settings=settings, place=place),
        inputs=[template, clouds, ingested, offsets, timeline, rig],
        figures=placed.figures,
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
