"""Everything a session made to its figures, against truth where there is some."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.calibration.result import CalibrationResult
from headcap.evaluation.metrics import load_metrics, save_metrics
from headcap.evaluation.session import SessionFolder, evaluate_session
from headcap.evaluation.settings import EvaluateSettings
from headcap.evaluation.truth import Truth
from headcap.registration.scan import load_scan
from headcap.registration.scan_placement import ScanPlacement


def run(
    *,
    rig: Path,
    template: Path,
    placement: Path,
    ingested: list[Path],
    offsets: list[Path],
    timelines: list[Path],
    clouds: list[Path],
    starts: list[Path],
    sequences: list[Path],
    necks: list[Path],
    expressions: list[Path],
    metrics: Path,
    takes: list[str],
    scan: dict,
    truth: Path | None,
    settings: EvaluateSettings,
) -> None:
    figures = evaluate_session(
        SessionFolder(metrics.parent),
        takes,
        rig=CalibrationResult.load(rig).rig,
        truth=Truth(truth) if truth else None,
        settings=settings,
        scan=ScanPlacement.load(placement).placed(load_scan(scan["file"], scan["unit"])),
    )
    said = [figure for path in (*necks, *expressions) for figure in load_metrics(path) if figure.session == metrics.parent.name]
    save_metrics(metrics, [*figures, *said])
    write_manifest(
        metrics,
        kind="metrics",
        stage="evaluate",
        settings_digest=digest_settings(settings=settings),
        inputs=[rig, template, placement, *ingested, *offsets, *timelines, *clouds, *starts, *sequences, *necks, *expressions],
        figures={},
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
