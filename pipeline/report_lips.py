"""All that a study says of lips to one page."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.report.lips import LipFiles, write_lips_report


def run(
    *,
    tables: Path,
    figures: Path,
    maps: list[Path],
    comparisons: list[Path],
    curves: list[Path],
    inpainted: list[Path],
    sheets: list[Path],
    page: Path,
    people: dict[str, str],
    settings: dict,
) -> None:
    files = LipFiles(tables, figures, tuple(maps), tuple(comparisons), tuple(curves), tuple(inpainted), tuple(sheets))
    write_lips_report(files, people, settings, page)
    write_manifest(
        page,
        kind="report",
        stage="report_lips",
        settings_digest=digest_settings(settings=settings),
        inputs=files.all,
        figures={},
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
