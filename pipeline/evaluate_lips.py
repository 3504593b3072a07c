"""Everybody's errors to the tables of the lip paper and to figures with limits."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.evaluation.lip_errors import LipErrors
from headcap.evaluation.lips_study import LipStudy
from headcap.evaluation.metrics import save_metrics
from headcap.evaluation.settings import EvaluateSettings


def run(*, errors: list[Path], tables: Path, figures: Path, name: str, limits: dict[str, dict[str, float]]) -> None:
    study = LipStudy.of(name, [LipErrors.load(path) for path in errors])
    study.save(tables)
    save_metrics(figures, study.figures(EvaluateSettings(), limits))
    for artifact, kind in ((tables, "lip_study"), (figures, "metrics")):
        write_manifest(
            artifact,
            kind=kind,
            stage="evaluate_lips",
            settings_digest=digest_settings(limits=limits),
            inputs=errors,
            figures={},
        )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
