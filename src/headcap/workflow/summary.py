"""What a run ends with: where the report lies, and the main figures."""

from pathlib import Path

from headcap.evaluation.metrics import describe, load_metrics


def summary(folder: Path) -> str:
    """Lines that name the pages of a session or study and list its figures, those past their limits marked."""
    pages = [folder / "report" / "report.html", folder / "report_neck" / "neck.html"]
    lines = [f"report of {folder.name}: {page}" for page in pages if page.is_file()]
    metrics = folder / "metrics.json"
    if metrics.is_file():
        held = [figure for figure in load_metrics(metrics) if figure.limit is not None]
        lines += [f"  {describe(figure, of_session=folder.name)}" for figure in held]
    return "\n".join(lines)
