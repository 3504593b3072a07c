"""A person's filmed takes, corrected, and how far each way to correct them is from the true meshes."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.evaluation.lips_person import JudgedTake, judge_person
from headcap.evaluation.lips_study import DELIVERED
from headcap.heads import HeadModel
from headcap.lips.artifact import LipRegressor
from headcap.lips.people import LipPersonFiles
from headcap.lips.takes import MouthSpace
from headcap.lips.training import LipTrainingSettings, RegressorPlan
from headcap.registration.sequence import MeshSequence, save_chunk
from headcap.report.lips_person import draw_person, write_comparison_video


def run(
    *,
    base: Path,
    files: list[Path],
    regressors: list[Path],
    errors: list[Path],
    sequences: list[Path],
    maps: Path,
    comparison: Path,
    curves: Path,
    video: Path,
    person: LipPersonFiles,
    plans: list[RegressorPlan],
    tested: list[str],
    learnt_from: list[str],
    settings: LipTrainingSettings,
) -> None:
    space = MouthSpace.of(HeadModel.load(base), settings.mouth)
    loaded = person.load(space)
    pairs = [(plan, LipRegressor.load(path, space.model)) for plan, path in zip(plans, regressors, strict=True)]
    judged = judge_person(space, loaded, pairs, tested, learnt_from=learnt_from)
    method = DELIVERED if plans[0].relation == "GR" else plans[0].method
    for (name, take), to, sequence in zip(judged.items(), errors, sequences, strict=True):
        take.errors.save(to)
        _save_sequence(sequence, name, take, method)
    draw_person(space, loaded, judged, method, maps, comparison, curves)
    write_comparison_video(space, next(t for t in person.takes if t.name == tested[0]), judged[tested[0]], method, video)
    for artifact, kind in (*((path, "lip_errors") for path in errors), *((path, "mesh_sequence") for path in sequences)):
        write_manifest(
            artifact,
            kind=kind,
            stage="correct_lips",
            settings_digest=digest_settings(settings=settings),
            inputs=[base, *files, *regressors],
            figures={},
        )


def _save_sequence(path: Path, name: str, take: JudgedTake, method: str) -> None:
    positions = path.with_suffix(".npy")
    save_chunk(positions, take.sequences[method])
    MeshSequence(name, take.errors.time_s, (positions,)).save(path)


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
