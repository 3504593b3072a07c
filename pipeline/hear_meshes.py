"""The sound that came with a mesh subject's take, as the stages that listen want it."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.speech.take_sound import recorded_sound


def run(*, files: list[Path], sound: Path, person: str, take: str, recording: Path) -> None:
    heard = recorded_sound(person, take, recording)
    heard.save(sound)
    write_manifest(
        sound,
        kind="take_sound",
        stage="hear_meshes",
        settings_digest=digest_settings(person=person),
        inputs=files,
        figures={"speech.clarity_db": heard.clarity_db},
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
