"""All that a study says of necks and voices to one page."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.neck.subjects import SubjectFiles
from headcap.report.study import write_study_report
from headcap.report.study_collect import StudyFiles, collect_study_page


def run(
    *,
    tables: Path,
    figures: Path,
    model: Path,
    fits: list[Path],
    models: list[Path],
    regressors: list[Path],
    sounds: list[Path],
    page: Path,
    people: list[SubjectFiles],
    voices: list[str],
    groups: dict[str, tuple[str, ...]],
    settings: dict,
) -> None:
    by_voice = dict(zip(voices, regressors, strict=True))
    files = StudyFiles(tables, figures, model, tuple(fits), tuple(models), tuple(people), by_voice, groups, tuple(sounds))
    write_study_report(collect_study_page(files, settings), page)
    write_manifest(
        page,
        kind="report",
        stage="report_neck",
        settings_digest=digest_settings(settings=settings),
        inputs=files.all,
        figures={},
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
