import pytest

from headcap.artifacts.gates import enforce, is_minimum, judge
from headcap.errors import GateFailure
from headcap.evaluation.catalogue import CATALOGUE


def test_sense_agrees_with_the_catalogue_of_figures() -> None:
    assert {name: is_minimum(name) for name in CATALOGUE} == {name: kind.at_least for name, kind in CATALOGUE.items()}


@pytest.mark.parametrize(("value", "ok"), [(0.5, True), (1.0, True), (1.1, False), (float("nan"), False)])
def test_a_figure_past_its_limit_fails(value: float, ok: bool) -> None:
    assert [gate.ok for gate in judge({"sync.residual_ms": value}, {"sync.residual_ms": 1.0})] == [ok]


def test_failure_tells_value_expectation_and_remedy_and_can_be_waived() -> None:
    figures, limits = (
        {"reconstruct.points": 12.0, "sync.residual_ms": 0.1},
        {"reconstruct.points": 2000.0, "sync.residual_ms": 1.0},
    )
    with pytest.raises(
        GateFailure, match=r"points is 12; expected at least 2000\. Light the face\..*allow: \[reconstruct\.points\]"
    ):
        enforce(judge(figures, limits), "Light the face.")
    enforce(judge(figures, limits, allow=("reconstruct.points",)), "Light the face.")
