"""The figures of all sessions and of the neck model to one file for the study."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.evaluation.metrics import join_metrics, save_metrics


def run(*, parts: list[Path], metrics: Path) -> None:
    save_metrics(metrics, join_metrics(parts))
    write_manifest(metrics, kind="metrics", stage="evaluate_study", settings_digest=digest_settings(), inputs=parts, figures={})


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
