"""Preconditioned conjugate gradient for one or several right-hand sides taken as one vector."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Operator = Callable[[NDArray], NDArray]


def conjugate_gradient(
    apply: Operator, precondition: Operator, right: NDArray, tolerance: float, most_steps: int
) -> tuple[NDArray[np.float64], bool]:
    """Solve apply(x) = right from x = 0; also whether the preconditioned residual fell by `tolerance` within `most_steps`.

    `apply` and `precondition` are symmetric positive definite on arrays shaped as `right`.
    """
    solution, residual = np.zeros_like(right), right.copy()
    direction = preconditioned = precondition(residual)
    product = start = float(np.vdot(residual, preconditioned))
    for _ in range(most_steps):
        if product <= start * tolerance**2:
            return solution, True
        image = apply(direction)
        length = product / float(np.vdot(direction, image))
        solution += length * direction
        residual -= length * image
        preconditioned = precondition(residual)
        product, before = float(np.vdot(residual, preconditioned)), product
        direction = preconditioned + (product / before) * direction
    return solution, product <= start * tolerance**2
