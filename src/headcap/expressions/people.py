"""A person whose hand-made expressions become quasi-eigen faces: where takes and shapes lie, and how they are read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from headcap.expressions.basis import ExpressionBasis
from headcap.expressions.basis_files import read_basis
from headcap.expressions.basis_registration import registered
from headcap.expressions.performance import Performance
from headcap.expressions.performance_files import PerformanceSettings, read_performance
from headcap.registration.template import Template


@dataclass(frozen=True)
class ExpressionPersonFiles:
    """Where one person's neutral head, takes and hand-made shapes lie."""

    name: str
    template: Path
    sequences: dict[str, Path]
    """Mesh sequences by take."""
    basis: Path
    """As `read_basis` takes it, metres."""

    def performance(self, settings: PerformanceSettings | None = None) -> Performance:
        """All takes one after another as displacements from the template; raises `InputError` as `read_performance`."""
        return read_performance(tuple(self.sequences.values()), neutral=Template.load(self.template), settings=settings)

    def hand_made(self, performance: Performance) -> ExpressionBasis:
        """The hand-made shapes on the person's neutral head, which need not be the one that they were made on.

        Raises `InputError` as `read_basis` and `registered`.
        """
        known = dict(Template.load(self.template).landmarks)
        return registered(read_basis(self.basis), performance.neutral, performance.triangles, onto_landmarks=known).basis
