"""Tables 1, 2 and 3 of the lip paper (section 6) over the takes of a study, with confidence intervals over takes.

The paper's own rows stand in `PAPER_TABLE_1` to `PAPER_TABLE_3`, for orientation: other people, other cameras.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from headcap.artifacts import ArtifactError, load_json, save_json
from headcap.errors import InputError
from headcap.evaluation.lip_errors import BASE, CONTOUR, LipErrors
from headcap.evaluation.metrics import Figure, make_figure
from headcap.evaluation.settings import EvaluateSettings

KIND, SCHEMA = "lip_study", 1
ALL = "all"
"""Scope of rows over everybody's takes; other scopes are persons."""
RELATIONS = ("PS", "MS", "GR")
AFFINE, SHAPE, DISTANCES, REPROJECTED = "affine", "shape", "distances", "reprojected"
DELIVERED = f"GR {REPROJECTED}"
"""What `headcap lips` does for anybody: contours are constraints of the correction."""

PAPER_TABLE_1 = {BASE: (4.0, 1.4), CONTOUR: (3.9, 1.2), "PS": (3.3, 1.2), "MS": (3.0, 1.0), "GR": (3.2, 1.1)}
"""Mean and standard deviation of the tracking error, mm (the paper's centimetres times ten)."""
PAPER_TABLE_2 = {SHAPE: (0.14, 0.05), DISTANCES: (0.17, 0.06), "combined": (0.13, 0.04), AFFINE: (0.14, 0.05)}
"""Mean and standard deviation of the feature space error; the affine regressor's stands in the text."""
PAPER_TABLE_3 = {SHAPE: (3.2, 1.2), DISTANCES: (3.3, 1.3), "combined": (3.0, 1.0)}
"""As table 1, by what the regressor was told."""


class LipStudySettings(BaseModel):
    """Confidence intervals of a study of lips."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    confidence: float = Field(0.95, gt=0, lt=1, description="Share of resampled studies that an interval holds")
    samples: int = Field(5000, ge=100, description="Times that takes are drawn again, with replacement")
    seed: int = Field(0, ge=0, description="Of these draws")


@dataclass(frozen=True)
class Estimate:
    """A number with its interval over takes."""

    value: float
    low: float | None
    """None for a single take, which tells nothing about others."""
    high: float | None


@dataclass(frozen=True)
class LipRow:
    """A method over a scope: a column of the paper's tables."""

    scope: str
    method: str
    takes: int
    frames: int
    """That all methods of a take answered; means are over these."""
    unanswered: int
    """Frames with truth that this method gave no answer to; they enter no mean."""
    error_mm: Estimate
    """mu of tables 1 and 3: mean over vertices and frames."""
    deviation_mm: float
    """sigma: standard deviation over vertices and frames."""
    base_error_mm: float
    """The base tracker's mu over the same frames."""
    drop_pct: Estimate
    """What the method takes off the base tracker's error, % of it."""
    shape_error_mm: Estimate
    """Mean error after one more rigid alignment, of the mouth alone: its shape, apart from where it is."""
    shape_drop_pct: Estimate
    """What the method takes off the base tracker's error of shape, % of it."""
    gap_error_mm: float
    """rms error of the distance between the lips."""
    roll_error_deg: float
    """Mean angle by which lips are rolled wrongly."""
    layer_error: Estimate | None
    """mu of table 2; None for what is not regressed."""
    layer_deviation: float | None
    """sigma of table 2, over frames."""

    @property
    def error_cm(self) -> tuple[float, float]:
        """mu and sigma in the paper's centimetres."""
        return 0.1 * self.error_mm.value, 0.1 * self.deviation_mm


@dataclass(frozen=True)
class LipDifference:
    """What one method errs less than another, take by take on the same frames."""

    scope: str
    method: str
    other: str
    takes: int
    gain_mm: Estimate
    """Mean error of `other` less that of `method`; above zero where `method` is better."""

    @property
    def certain(self) -> bool:
        """Whether the whole interval is above zero."""
        return self.gain_mm.low is not None and self.gain_mm.low > 0


@dataclass(frozen=True)
class LipStudy:
    """What a study says of lips."""

    name: str
    confidence: float
    rows: tuple[LipRow, ...]
    differences: tuple[LipDifference, ...]

    @classmethod
    def of(cls, name: str, takes: Sequence[LipErrors], settings: LipStudySettings | None = None) -> LipStudy:
        """From takes that no regressor was trained on; raises `InputError` without any.

        Intervals are percentiles over takes drawn again with replacement (Efron's bootstrap): frames of one take resemble each
        other and are no sample of their own. With a handful of takes such intervals are too narrow, so that rows say how many
        there were. Takes weigh by their frames, as the paper's means over frames do.
        """
        if not takes:
            raise InputError("no takes", expected="one at least", remedy="Keep lip takes out of training to test on.")
        settings = settings or LipStudySettings()
        persons = list(dict.fromkeys(take.person for take in takes))
        scopes = {ALL: list(takes)} | {person: [take for take in takes if take.person == person] for person in persons}
        rows, differences = [], []
        for scope, chosen in scopes.items():
            methods = list(dict.fromkeys(method for take in chosen for method in take.methods))
            made = [_row(scope, method, chosen, settings) for method in methods]
            rows += [row for row in made if row is not None]
            differences += _differences(scope, methods, chosen, settings)
        return cls(name, settings.confidence, tuple(rows), tuple(differences))

    def row(self, method: str, scope: str = ALL) -> LipRow | None:
        """A method's row; None where nothing was compared."""
        return next((row for row in self.rows if (row.scope, row.method) == (scope, method)), None)

    def table_1(self, scope: str = ALL) -> list[LipRow]:
        """Base tracker, contour-based tracker, PS, MS, GR, in the paper's order."""
        return [row for row in (self.row(method, scope) for method in PAPER_TABLE_1) if row is not None]

    def by_inputs(self, relation: str, scope: str = ALL) -> dict[str, LipRow]:
        """Tables 2 (`layer_error`) and 3 (`error_mm`), and the affine regressor, of one kind of regressor: PS, MS or GR."""
        named = {SHAPE: f"{relation} {SHAPE}", DISTANCES: f"{relation} {DISTANCES}", "combined": relation}
        named[AFFINE] = f"{relation} {AFFINE}"
        found = {name: self.row(method, scope) for name, method in named.items()}
        return {name: row for name, row in found.items() if row is not None}

    def figures(self, settings: EvaluateSettings, limits: Mapping[str, Mapping[str, float]] | None = None) -> list[Figure]:
        """Figures of every scope, `session` naming the study or the person; `limits` by scope go before those of `settings`."""
        out = []
        for scope in dict.fromkeys(row.scope for row in self.rows):
            own = settings.with_limits((limits or {}).get(scope, {}))
            session = self.name if scope == ALL else scope
            named = _named({row.method: row for row in self.rows if row.scope == scope})
            out += [make_figure(name, value, session=session, take=None, settings=own) for name, value in named.items()]
        return out

    def save(self, path: Path | str) -> None:
        """Write as JSON artifact `headcap.lip_study/1`."""
        save_json(path, KIND, SCHEMA, asdict(self))

    @classmethod
    def load(cls, path: Path | str) -> LipStudy:
        """Read what `save` wrote; raises `ArtifactError`."""
        content = load_json(path, KIND, SCHEMA)
        try:
            rows = tuple(LipRow(**_with_estimates(row)) for row in content["rows"])
            differences = tuple(LipDifference(**_with_estimates(row)) for row in content["differences"])
            return cls(content["name"], content["confidence"], rows, differences)
        except (KeyError, TypeError) as error:
            raise ArtifactError(f"{path} holds no whole study of lips ({error}); make it again") from error


def interval(
    sums: NDArray, statistic: Callable[[NDArray], NDArray], settings: LipStudySettings
) -> tuple[float | None, float | None]:
    """Bootstrap interval of a statistic of sums over takes (t, c): `statistic` maps (samples, c) to (samples,)."""
    if len(sums) < 2:
        return None, None
    draws = np.random.default_rng(settings.seed).multinomial(len(sums), np.full(len(sums), 1 / len(sums)), settings.samples)
    tail = 50 * (1 - settings.confidence)
    low, high = np.percentile(statistic(draws @ sums), [tail, 100 - tail])
    return float(low), float(high)


def _estimate(sums: NDArray, statistic: Callable[[NDArray], NDArray], settings: LipStudySettings) -> Estimate:
    return Estimate(float(statistic(sums.sum(axis=0, keepdims=True))[0]), *interval(sums, statistic, settings))


def _mean(sums: NDArray) -> NDArray:
    return sums[:, 1] / sums[:, 0]


def _drop_pct(sums: NDArray) -> NDArray:
    return 100 * (1 - sums[:, 1] / sums[:, 2])


def _row(scope: str, method: str, takes: Sequence[LipErrors], settings: LipStudySettings) -> LipRow | None:
    """None where the method and the base share no frame."""
    known = [take for take in takes if method in take.methods]
    used = [take for take in known if (take.answered[take.row(method)] & take.common).any()]
    if not used:
        return None
    sums = np.array([_sums(take, method) for take in used])
    frames, error, base, square, gap, roll, *_ = sums.sum(axis=0)
    mean = error / frames
    layers, layer_deviation = _layer(used, method, settings)
    return LipRow(
        scope=scope,
        method=method,
        takes=len(used),
        frames=int(frames),
        unanswered=sum(take.unanswered(method) for take in known),
        error_mm=_estimate(sums, _mean, settings),
        deviation_mm=float(np.sqrt(max(square / frames - mean**2, 0.0))),
        base_error_mm=float(base / frames),
        drop_pct=_estimate(sums, _drop_pct, settings),
        shape_error_mm=_estimate(sums[:, [0, -2, -1]], _mean, settings),
        shape_drop_pct=_estimate(sums[:, [0, -2, -1]], _drop_pct, settings),
        gap_error_mm=float(np.sqrt(gap / frames)),
        roll_error_deg=float(roll / frames),
        layer_error=layers,
        layer_deviation=layer_deviation,
    )


def _sums(take: LipErrors, method: str) -> list[float]:
    """Frames, and sums over them: error, the base's error, squared error, squared error of the gap, error of the roll; errors of
    shape, own and the base's."""
    row, used = take.row(method), take.common
    gap = take.gap_mm[row] - take.gap_mm[-1]
    parts = (take.error_mm[row], take.error_mm[0], take.square_mm2[row], gap**2, take.roll_error_deg[row])
    parts += (take.shape_error_mm[row], take.shape_error_mm[0])
    return [float(used.sum()), *(float(part[used].sum()) for part in parts)]


def _layer(takes: Sequence[LipErrors], method: str, settings: LipStudySettings) -> tuple[Estimate | None, float | None]:
    parts = [take.layer_error[take.row(method)][take.common] for take in takes]
    parts = [part[np.isfinite(part)] for part in parts]
    parts = [part for part in parts if len(part)]
    if not parts:
        return None, None
    sums = np.array([[len(part), part.sum()] for part in parts], float)
    return _estimate(sums, _mean, settings), float(np.concatenate(parts).std())


def _differences(scope: str, methods: list[str], takes: Sequence[LipErrors], settings: LipStudySettings) -> list[LipDifference]:
    """Of every regressor against its variants and the contour-based tracker."""
    pairs = [(one, f"{one} {variant}") for one in RELATIONS for variant in (AFFINE, SHAPE, DISTANCES, REPROJECTED)]
    pairs += [(one, CONTOUR) for one in RELATIONS] + [(CONTOUR, BASE)]
    out = []
    for one, other in pairs:
        used = [take for take in takes if {one, other} <= set(take.methods)]
        used = [take for take in used if (take.answered[[take.row(one), take.row(other)]].all(axis=0) & take.common).any()]
        if used and {one, other} <= set(methods):
            sums = np.array([[*_sums(take, one)[:2], _sums(take, other)[1]] for take in used])
            gain = _estimate(sums, lambda parts: (parts[:, 2] - parts[:, 1]) / parts[:, 0], settings)
            out.append(LipDifference(scope, one, other, len(used), gain))
    return out


def _named(rows: Mapping[str, LipRow]) -> dict[str, float]:
    """Figures by name."""
    out = {}
    if BASE in rows:
        base = rows[BASE]
        out = {"lips.base_error_mm": base.error_mm.value, "lips.base_gap_error_mm": base.gap_error_mm}
        out["lips.base_shape_error_mm"] = base.shape_error_mm.value
        out |= {"lips.base_roll_error_deg": base.roll_error_deg, "lips.base_unanswered_frames": float(base.unanswered)}
    if CONTOUR in rows:
        out["lips.contour_error_mm"] = rows[CONTOUR].error_mm.value
    for relation in RELATIONS:
        if relation in rows:
            out[f"lips.{relation.lower()}_error_mm"] = rows[relation].error_mm.value
            out[f"lips.{relation.lower()}_error_drop_pct"] = rows[relation].drop_pct.value
    if DELIVERED in rows:
        out["lips.gr_reprojected_error_mm"] = rows[DELIVERED].error_mm.value
        out["lips.gr_reprojected_error_drop_pct"] = rows[DELIVERED].drop_pct.value
    # what a user gets: the regressor that knows least of them
    found = next((rows[method] for method in (DELIVERED, *reversed(RELATIONS)) if method in rows), None)
    if found is not None:
        out |= {"lips.error_mm": found.error_mm.value, "lips.gap_error_mm": found.gap_error_mm}
        out |= {"lips.shape_error_mm": found.shape_error_mm.value, "lips.shape_error_drop_pct": found.shape_drop_pct.value}
        out |= {"lips.roll_error_deg": found.roll_error_deg, "lips.unanswered_frames": float(found.unanswered)}
    return out


def _with_estimates(row: dict) -> dict:
    """A row as read, its estimates as such."""
    return {name: Estimate(**value) if isinstance(value, dict) else value for name, value in row.items()}
