"""The chunks of a take to one mesh sequence, and what the tracker was left with to one file."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.registration.residuals import TrackResiduals
from headcap.registration.sequence import MeshSequence
from headcap.sync.timeline import TakeTimeline


def run(*, meshes: list[Path], chunk_residuals: list[Path], timeline: Path, sequence: Path, residuals: Path) -> None:
    moments = TakeTimeline.load(timeline)
    TrackResiduals.joined(map(TrackResiduals.load, chunk_residuals)).save(residuals)
    MeshSequence(take=moments.take, time_s=moments.time_s, chunks=tuple(meshes)).save(sequence)
    made = ((residuals, "track_residuals", chunk_residuals), (sequence, "mesh_sequence", [*meshes, timeline]))
    for artifact, kind, inputs in made:
        write_manifest(artifact, kind=kind, stage="collect", settings_digest=digest_settings(), inputs=inputs, figures={})


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
