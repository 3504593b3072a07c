"""Everything a session made to one page."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.calibration.board import BoardSettings
from headcap.registration.scan import load_scan
from headcap.registration.scan_placement import ScanPlacement
from headcap.report.collect import SessionDescription, collect_report
from headcap.report.html import write_report, write_summary


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
    neck_pictures: list[Path],
    sync_figures: list[Path],
    residuals: list[Path],
    metrics: Path,
    report: Path,
    summary: Path,
    takes: list[str],
    scan: dict,
    board: BoardSettings,
    truth: Path | None,
    settings: dict,
) -> None:
    described = SessionDescription(
        session=settings["session"],
        subject=settings["subject"],
        rate_hz=settings["rate_hz"],
        takes=tuple(takes),
        board=board,
        allowed=tuple(settings["allow"]),
        rehearsed=settings["rehearse"] is not None,
        settings=settings,
        truth=truth,
    )
    scanned = ScanPlacement.load(placement).placed(load_scan(scan["file"], scan["unit"]))
    collected = collect_report(metrics.parent, described, scan=scanned, neck_pictures=neck_pictures)
    write_summary(collected, summary)
    write_report(collected, report)
    write_manifest(
        report,
        kind="report",
        stage="report",
        settings_digest=digest_settings(settings=settings),
        inputs=[
            metrics,
            rig,
            template,
            *ingested,
            *offsets,
            *timelines,
            *clouds,
            *starts,
            *sequences,
            *neck_pictures,
            *sync_figures,
            *residuals,
        ],
        figures={},
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
