"""A speech take's recordings to the sound that its regressors are trained on: that of the clearest microphone."""

import logging
from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.recordings.takes import IngestedTake
from headcap.speech.take_sound import clearest_sound
from headcap.sync.board_sound import load_clapper
from headcap.sync.offsets import TimeOffsets
from headcap.sync.timeline import TakeTimeline

PROGRESS = logging.getLogger("headcap.progress")


def run(*, ingested: Path, offsets: Path, timeline: Path, clapper: Path, sound: Path, person: str) -> None:
    moments = TakeTimeline.load(timeline).time_s
    delays_s = load_clapper(clapper).av_offset_s
    heard = clearest_sound(person, IngestedTake.load(ingested), TimeOffsets.load(offsets), moments, delays_s)
    PROGRESS.info("hear: %s by %s, %.0f dB over its pauses", heard.take, heard.camera, heard.clarity_db)
    heard.save(sound)
    write_manifest(
        sound,
        kind="take_sound",
        stage="hear",
        settings_digest=digest_settings(person=person),
        inputs=[ingested, offsets, timeline, clapper],
        figures={"speech.clarity_db": heard.clarity_db},
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
