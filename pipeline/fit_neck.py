"""One person's tracked takes to coefficients of the study's neck model, and how far each part of the model is off."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.heads.model import HeadModel
from headcap.neck.figure import save_fits_figure
from headcap.neck.fitting.subject import fit_subject
from headcap.neck.model import NeckModel
from headcap.neck.subjects import SubjectFiles
from headcap.neck.training.study import NeckTrainingSettings, person_of


def run(
    *,
    files: list[Path],
    base: Path,
    model: Path,
    fits: Path,
    fitted_model: Path,
    figure: Path,
    person: SubjectFiles,
    held_out: bool,
    settings: NeckTrainingSettings,
) -> None:
    generic, neck = HeadModel.load(base), NeckModel.load(model)
    subject = person.load(generic)
    neck = neck.of_person(person_of(neck, subject, settings, fits.parent))
    fitted = fit_subject(neck, generic, subject, settings.fit, held_out=held_out)
    save_fits_figure(figure, fitted)
    fitted.save(fits)
    neck.save(fitted_model)
    for artifact, kind, figures in ((fits, "neck_fits", fitted.figures()), (fitted_model, "neck_model", {})):
        write_manifest(
            artifact,
            kind=kind,
            stage="fit_neck",
            settings_digest=digest_settings(settings=settings),
            inputs=[base, model, *files],
            figures=figures,
        )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
