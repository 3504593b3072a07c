"""What became of a person's hand-made expressions, to one page."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.evaluation.expressions import compare_bases
from headcap.evaluation.metrics import load_metrics
from headcap.expressions import QuasiEigenFaces
from headcap.expressions.people import ExpressionPersonFiles
from headcap.expressions.quasi_eigen import QuasiEigenSettings
from headcap.expressions.weight_curves import read_weights
from headcap.report.expressions import collect_expressions_page, write_expressions_report
from headcap.report.provenance import manifests_of


def run(
    *,
    files: list[Path],
    faces: Path,
    weights: Path,
    figures: Path,
    page: Path,
    person: ExpressionPersonFiles,
    settings: QuasiEigenSettings,
) -> None:
    performance, made = person.performance(), QuasiEigenFaces.load(faces)
    content = collect_expressions_page(
        performance,
        made,
        compare_bases(performance, made, bounds=settings.bounds),
        bounds=settings.bounds,
        weights={"quasi": read_weights(weights).of(made.quasi.names).weights},
        overlap=settings.overlap,
        figures=load_metrics(figures),
        manifests=manifests_of({path.name: path for path in (faces, figures)}),
        settings=settings.model_dump(mode="json"),
    )
    write_expressions_report(content, page)
    write_manifest(
        page,
        kind="report",
        stage="report_expressions",
        settings_digest=digest_settings(settings=settings),
        inputs=[*files, faces, weights, figures],
        figures={},
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
