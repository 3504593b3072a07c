"""The generic head model that a study's people are fitted with, before anything is learnt from them."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.heads import procedural_model


def run(*, model: Path) -> None:
    procedural_model().save(model)
    write_manifest(model, kind="head_model", stage="head_model", settings_digest=digest_settings(), inputs=[], figures={})


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
