"""Fitted speech takes and their sounds to the regressors of one voice: a person's own, or a group's for anybody."""

import logging
from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.neck.fits import NeckFits
from headcap.neck.model import NeckModel
from headcap.neck.voice.figure import save_voice_figure
from headcap.neck.voice.training import Voice, VoiceTrainingSettings, train_voice_of
from headcap.speech.take_sound import TakeSound

PROGRESS = logging.getLogger("headcap.progress")


def run(
    *,
    model: Path,
    fits: list[Path],
    sounds: list[Path],
    regressor: Path,
    errors: Path,
    figure: Path,
    voice: Voice,
    settings: VoiceTrainingSettings,
) -> None:
    training = train_voice_of(NeckModel.load(model), voice, map(NeckFits.load, fits), map(TakeSound.load, sounds), settings)
    for remark in training.errors.remarks:
        PROGRESS.info("train_speech: %s: %s", voice.name, remark)
    save_voice_figure(figure, training)
    training.errors.save(errors)
    training.regressor.save(regressor)
    for artifact, kind, figures in ((errors, "voice_errors", {}), (regressor, "speech_regressor", training.figures())):
        write_manifest(
            artifact,
            kind=kind,
            stage="train_speech",
            settings_digest=digest_settings(settings=settings, voice=voice),
            inputs=[model, *fits, *sounds],
            figures=figures,
        )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
