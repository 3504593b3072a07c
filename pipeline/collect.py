"""The chunks of a take to one mesh sequence, held against the point clouds."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.registration.sequence import MeshSequence
from headcap.sync.timeline import TakeTimeline


def run(*, meshes: list[Path], timeline: Path, sequence: Path) -> None:
    moments = TakeTimeline.load(timeline)
    MeshSequence(take=moments.take, time_s=moments.time_s, chunks=tuple(meshes)).save(sequence)
    write_manifest(
        sequence,
        kind="mesh_sequence",
        stage="collect",
        settings_digest=digest_settings(),
        inputs=[*meshes, timeline],
        figures={},
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
