"""The scan to the subject in the model's topology."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.artifacts.gates import enforce, judge
from headcap.heads.procedural import base_head
from headcap.registration.picks import read_picks
from headcap.registration.register import RegisterSettings, register_scan
from headcap.registration.scan import load_scan
from headcap.registration.scan_placement import ScanPlacement


def run(
    *,
    scan: Path,
    picks: list[Path],
    template: Path,
    placement: Path,
    described: dict,
    limits: dict[str, float],
    allow: tuple[str, ...],
    settings: RegisterSettings,
) -> None:
    loaded = load_scan(described["file"], described["unit"])
    picked = read_picks(picks[0], described["unit"]) if picks else None
    found = register_scan(base_head(), loaded, settings, picked)
    remedy = "Check the scan's unit and that it shows the neutral face; or give picks of at least three landmarks."
    enforce(judge(found.figures, limits, allow), remedy)
    ScanPlacement(found.base_from_scan).save(placement)
    found.template.save(template)
    write_manifest(
        template,
        kind="template",
        stage="register",
        settings_digest=digest_settings(settings=settings, unit=described["unit"]),
        inputs=[Path(described["file"]), *picks],
        figures=found.figures,
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
