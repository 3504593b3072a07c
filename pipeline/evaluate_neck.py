"""Everybody's fits and every voice's errors to the tables of the neck paper and to figures with limits."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.evaluation.metrics import save_metrics
from headcap.evaluation.neck import LarynxFile
from headcap.evaluation.neck_study import collect_study
from headcap.evaluation.settings import EvaluateSettings


def run(
    *,
    fits: list[Path],
    errors: list[Path],
    tables: Path,
    figures: Path,
    name: str,
    recorded: list[str],
    larynxes: list[LarynxFile],
    limits: dict[str, dict[str, float]],
) -> None:
    study = collect_study(name, fits, errors, recorded=recorded, larynxes=larynxes)
    study.save(tables)
    save_metrics(figures, study.figures(EvaluateSettings(), limits))
    for artifact, kind in ((tables, "neck_study"), (figures, "metrics")):
        write_manifest(
            artifact,
            kind=kind,
            stage="evaluate_neck",
            settings_digest=digest_settings(limits=limits),
            inputs=[*fits, *errors],
            figures={},
        )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
