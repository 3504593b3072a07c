"""Quality gates: a stage's figures held against limits, with the session's waivers."""

from dataclasses import dataclass

from headcap.errors import GateFailure

# figures of which more is better; of all others, less is
_MINIMA = (
    "within_", "coverage", "poses", "points", "confidence", "completeness", "share_",
    "larynx_correlation", "pose_error_drop", "expression_error_drop", "speech_error_drop", "larynx_part", "speech_part",
    "clarity", "takes", "frames", "voiced_share", "ps_error_drop", "ms_error_drop", "gr_error_drop", "shape_error_drop",
    "gr_reprojected_error_drop", "closures_shown", "base_closures_shown",
    "hand_over_qe", "median_correlation", "own_closest_share",
)  # fmt: skip


@dataclass(frozen=True)
class Gate:
    """One figure against its limit."""

    figure: str
    value: float
    limit: float
    waived: bool = False

    @property
    def ok(self) -> bool:
        """Whether the figure keeps the limit; NaN never does."""
        return self.value >= self.limit if is_minimum(self.figure) else self.value <= self.limit

    def __str__(self) -> str:
        sense = "at least" if is_minimum(self.figure) else "at most"
        return f"{self.figure} is {self.value:.4g}; expected {sense} {self.limit:.4g}"


def is_minimum(figure: str) -> bool:
    """True where the limit of a figure is a least value, as of `reconstruct.completeness_half_mm`."""
    return figure.rsplit(".", 1)[-1].startswith(_MINIMA)


def judge(figures: dict[str, float], limits: dict[str, float], allow: tuple[str, ...] = ()) -> tuple[Gate, ...]:
    """Gates of the figures that have a limit, in the figures' order."""
    return tuple(Gate(name, value, limits[name], name in allow) for name, value in figures.items() if name in limits)


def enforce(gates: tuple[Gate, ...], remedy: str) -> None:
    """Raise `GateFailure` that tells every gate which neither holds nor is waived, and what to do."""
    failed = [gate for gate in gates if not gate.ok and not gate.waived]
    if failed:
        told = "; ".join(map(str, failed))
        names = ", ".join(gate.figure for gate in failed)
        raise GateFailure(f"{told}. {remedy} To go on all the same, name it in the session's allow: [{names}].")
