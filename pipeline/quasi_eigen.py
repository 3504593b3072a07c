"""Hand-made expressions and what a person was captured doing to quasi-eigen faces, and how well they reproduce it."""

from pathlib import Path

from headcap.artifacts import digest_settings, save_json, write_manifest
from headcap.evaluation.expressions import KIND, SCHEMA, compare_bases, expression_metrics
from headcap.evaluation.metrics import save_metrics
from headcap.evaluation.settings import EvaluateSettings
from headcap.export.expressions import write_basis
from headcap.expressions.people import ExpressionPersonFiles
from headcap.expressions.quasi_eigen import QuasiEigenSettings, convert_basis
from headcap.expressions.weight_curves import WeightCurves, write_weights


def run(
    *,
    files: list[Path],
    faces: Path,
    basis: Path,
    weights: Path,
    errors: Path,
    figures: Path,
    person: ExpressionPersonFiles,
    settings: QuasiEigenSettings,
    limits: dict[str, float],
) -> None:
    performance = person.performance()
    made = convert_basis(performance, person.hand_made(performance), settings)
    compared = compare_bases(performance, made, bounds=settings.bounds)
    curves = WeightCurves(made.quasi.names, performance.time_s, settings.solver(made.quasi).solve(performance))
    made.save(faces)
    write_basis(basis, made.quasi, curves)
    write_weights(weights, curves)
    save_json(errors, KIND, SCHEMA, compared.to_json())
    save_metrics(figures, expression_metrics(compared, person.name, EvaluateSettings(limits=limits)))
    for artifact, kind in ((faces, "quasi_eigen_faces"), (errors, KIND), (figures, "metrics")):
        write_manifest(
            artifact,
            kind=kind,
            stage="quasi_eigen",
            settings_digest=digest_settings(settings=settings, limits=limits),
            inputs=files,
            figures=compared.figures(),
        )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
