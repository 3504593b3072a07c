"""A subject without a rig: takes as meshes, the voice, how high the larynx really was, and one camera's view where asked for."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.synthetic.mesh_files import rehearse_meshes
from headcap.synthetic.settings import MeshRehearsalSettings


def run(*, rehearsal: Path, settings: MeshRehearsalSettings) -> None:
    rehearse_meshes(settings, rehearsal.parent)
    write_manifest(
        rehearsal,
        kind="mesh_rehearsal",
        stage="rehearse_meshes",
        settings_digest=digest_settings(settings=settings),
        inputs=[],
        figures={},
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
