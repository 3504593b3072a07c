"""Settings of a rehearsal to recordings, scan and truth."""

import logging
from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.synthetic.rehearsal import rehearse
from headcap.synthetic.settings import RehearsalSettings

PROGRESS = logging.getLogger("headcap.progress")


def run(*, rehearsal: Path, settings: RehearsalSettings, threads: int) -> None:
    rehearse(settings, rehearsal.parent, progress=_tell, workers=threads)
    write_manifest(
        rehearsal,
        kind="rehearsal",
        stage="rehearse",
        settings_digest=digest_settings(settings=settings),
        inputs=[],
        figures={},
    )


def _tell(done: int, pieces: int, what: str) -> None:
    PROGRESS.info("rehearse %d of %d: %s", done, pieces, what)


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
