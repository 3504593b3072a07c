"""The file of figures of a session or study: `headcap.metrics/1`."""

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from headcap.artifacts import load_json, save_json
from headcap.evaluation.catalogue import CATALOGUE, unit_of
from headcap.evaluation.settings import EvaluateSettings

KIND, SCHEMA = "metrics", 1


@dataclass(frozen=True)
class Figure:
    """One measured number with its limit."""

    name: str
    value: float | None
    """None where the figure could not be measured."""
    unit: str
    session: str
    take: str | None = None
    limit: float | None = None
    ok: bool | None = None
    """None where no limit is in force."""

    @property
    def at_least(self) -> bool:
        """True where the limit is a least value."""
        return self.name in CATALOGUE and CATALOGUE[self.name].at_least


def make_figure(name: str, value: float, *, session: str, take: str | None, settings: EvaluateSettings) -> Figure:
    """A figure held to the limit in force; a value that is not finite is kept as None and fails its limit."""
    limit = settings.limit(name)
    number = float(value) if math.isfinite(value) else None
    ok = None
    if limit is not None:
        at_least = name in CATALOGUE and CATALOGUE[name].at_least
        ok = number is not None and (number >= limit if at_least else number <= limit)
    return Figure(name, number, unit_of(name), session, take, limit, ok)


def save_metrics(path: Path | str, figures: Iterable[Figure]) -> None:
    """Write `metrics.json`, figures in the order given."""
    save_json(path, KIND, SCHEMA, {"figures": [asdict(figure) for figure in figures]})


def load_metrics(path: Path | str) -> tuple[Figure, ...]:
    """Read what `save_metrics` wrote; raises `ArtifactError`."""
    return tuple(Figure(**figure) for figure in load_json(path, KIND, SCHEMA)["figures"])


def join_metrics(paths: Iterable[Path]) -> list[Figure]:
    """Figures of several files in a row, each of a name, session and take once; raises `ArtifactError`."""
    figures = [figure for path in paths for figure in load_metrics(path)]
    return list({(figure.name, figure.session, figure.take): figure for figure in figures}.values())


def describe(figure: Figure, *, of_session: str | None = None) -> str:
    """One line for a terminal: value, unit, limit and verdict; the session is named where it is not `of_session`."""
    named = [part for part in (figure.session if of_session != figure.session else "", figure.take) if part]
    where = f"{figure.name:<36} {' '.join(named):<18}"
    value = "not measured" if figure.value is None else f"{figure.value:.4g} {figure.unit}".rstrip()
    if figure.limit is None:
        return f"{where} {value}"
    sign, verdict = (">=" if figure.at_least else "<="), ("ok" if figure.ok else "PAST ITS LIMIT")
    return f"{where} {value} ({sign} {figure.limit:g}: {verdict})"
