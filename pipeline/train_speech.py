"""Fitted speech takes and their sound to the person's speech regressors."""

import logging
from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.neck.fits import NeckFits
from headcap.neck.model import NeckModel
from headcap.neck.voice_figure import save_voice_figure
from headcap.neck.voice_training import VoiceTrainingSettings, train_voice
from headcap.recordings.takes import IngestedTake
from headcap.speech.take_sound import clearest_sound
from headcap.sync.board_sound import load_clapper
from headcap.sync.offsets import TimeOffsets

PROGRESS = logging.getLogger("headcap.progress")


def run(
    *,
    model: Path,
    fits: Path,
    ingested: list[Path],
    offsets: list[Path],
    clapper: Path,
    regressor: Path,
    figure: Path,
    settings: VoiceTrainingSettings,
) -> None:
    neck, fitted, delays_s = NeckModel.load(model), NeckFits.load(fits), load_clapper(clapper).av_offset_s
    moments = {take.take: take.time_s for take in fitted.takes}
    takes = [(IngestedTake.load(take), TimeOffsets.load(start)) for take, start in zip(ingested, offsets, strict=True)]
    sounds = {take.take: clearest_sound(take, start, moments[take.take], delays_s) for take, start in takes}
    for sound in sounds.values():
        PROGRESS.info("train_speech: %s by %s, %.0f dB over its pauses", sound.take, sound.camera, sound.clarity_db)
    training = train_voice(neck, fitted, sounds, settings)
    for remark in training.remarks():
        PROGRESS.info("train_speech: %s", remark)
    save_voice_figure(figure, training)
    training.regressor.save(regressor)
    write_manifest(
        regressor,
        kind="speech_regressor",
        stage="train_speech",
        settings_digest=digest_settings(settings=settings),
        inputs=[model, fits, *ingested, *offsets, clapper],
        figures=training.figures(),
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
