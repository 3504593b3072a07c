"""Expressions: hand-made shapes turned into a basis that covers a captured performance (quasi-eigen faces)."""

from headcap.expressions.basis import Eigenfaces, ExpressionBasis, QuasiEigenFaces
from headcap.expressions.performance import Performance

__all__ = ["Eigenfaces", "ExpressionBasis", "Performance", "QuasiEigenFaces"]
