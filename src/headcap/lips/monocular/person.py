"""Who a video shows, apart from what the face does: the model's shape and the layer beyond it, known from other pictures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.heads import HeadModel


@dataclass(frozen=True, eq=False)
class MonocularPerson:
    """One person's neutral head as one camera's pictures tell it."""

    model: str
    """Digest of the head model."""
    shape: NDArray[np.float64]
    """beta (s,)."""
    layer: NDArray[np.float32]
    """(n, 3) metres: the medium-scale layer on the model's neutral head."""

    def neutral(self, model: HeadModel) -> NDArray[np.float64]:
        """(n, 3) at rest, metres, in the head's frame. Raises `InputError` for another head model."""
        if model.digest != self.model:
            raise InputError(
                f"a person of head model {self.model}",
                expected=f"one of {model.name}, {model.digest}",
                remedy="Give the head model that the person was found with, or find the person again.",
            )
        return np.asarray(model.identity(self.shape), np.float64) + self.layer
