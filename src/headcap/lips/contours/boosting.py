"""Boosted trees: grown by LightGBM, kept as plain arrays.

Gradient boosting of the logistic loss (Friedman 2001) over binned features by LightGBM (Ke et al. 2017). Its trees are filled up
to complete ones, a row of three arrays each: they are evaluated and kept without the library.
"""

from __future__ import annotations

from dataclasses import dataclass

import lightgbm
import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.lips.contours.settings import BoostingSettings

_BINS = 64


@dataclass(frozen=True, eq=False)
class BoostedTrees:
    """t complete trees of one depth d. Inner node k asks whether a feature is above a threshold: 2k + 1 if not, 2k + 2 if so."""

    feature: NDArray[np.int32]
    """(t, 2^d - 1)."""
    threshold: NDArray[np.float32]
    """(t, 2^d - 1), infinite where a node does not part its samples."""
    value: NDArray[np.float32]
    """(t, 2^d) log-odds that each leaf adds."""

    def __call__(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Log-odds (p,) of p samples with features (k, p)."""
        out = np.zeros(values.shape[1], np.float32)
        _score(np.ascontiguousarray(values, np.float32), self.feature, self.threshold, self.value, out)
        return out

    @property
    def used(self) -> NDArray[np.int64]:
        """Features that any node asks for, rising."""
        return np.unique(self.feature[np.isfinite(self.threshold)]).astype(np.int64)

    def numbered(self, features: NDArray) -> BoostedTrees:
        """The same trees for values of these features (rising, all used ones among them) alone."""
        asks = np.isfinite(self.threshold)
        number = np.where(asks, np.searchsorted(features, self.feature), 0).astype(np.int32)
        return BoostedTrees(number, self.threshold, self.value)

    def then(self, more: BoostedTrees) -> BoostedTrees:
        """These trees and more of the same depth: their log-odds add up."""
        parts = zip((self.feature, self.threshold, self.value), (more.feature, more.threshold, more.value), strict=True)
        return BoostedTrees(*(np.concatenate(pair) for pair in parts))


def grow_trees(
    values: NDArray[np.float32],
    shows: NDArray[np.bool_],
    settings: BoostingSettings,
    seed: int,
    start: NDArray | None = None,
) -> BoostedTrees:
    """Trees that tell samples which show a contour (p,) from their features (k, p); both kinds weigh the same in all.

    With `start`, log-odds (p,) that others gave already, the trees add what those lack. Raises `InputError` where all samples are
    of one kind.
    """
    if shows.all() or not shows.any():
        raise InputError(
            f"{len(shows)} samples, {int(shows.sum())} of them on a contour",
            expected="samples on a contour and beside it",
            remedy="Give frames whose labels lie inside the picture, near the base tracker's mouth.",
        )
    weight = np.where(shows, 0.5 / shows.mean(), 0.5 / (1 - shows.mean())).astype(np.float32)
    # features that nothing parts are kept: trees number features as given
    data = lightgbm.Dataset(values.T, shows.astype(np.float32), weight=weight, init_score=start, params=_DATA)
    booster = lightgbm.train(_parameters(settings, seed), data, num_boost_round=settings.trees)
    shapes = (2**settings.depth - 1, np.int32, 0), (2**settings.depth - 1, np.float32, np.inf), (2**settings.depth, np.float32, 0)
    feature, threshold, value = (np.full((settings.trees, width), empty, dtype) for width, dtype, empty in shapes)
    for number, tree in enumerate(booster.dump_model()["tree_info"]):
        _complete(tree["tree_structure"], 0, feature[number], threshold[number], value[number])
    return BoostedTrees(feature, threshold, value)


_DATA = {"max_bin": _BINS, "feature_pre_filter": False, "verbosity": -1}


def _parameters(settings: BoostingSettings, seed: int) -> dict:
    """LightGBM's; one thread and row-wise histograms, so that equal samples give equal trees."""
    return _DATA | {
        "objective": "binary",
        "boost_from_average": False,
        "max_depth": settings.depth,
        "num_leaves": 2**settings.depth,
        "learning_rate": settings.learning_rate,
        "lambda_l2": settings.ridge,
        "min_sum_hessian_in_leaf": settings.least_curvature,
        "min_data_in_leaf": 1,
        "bagging_fraction": settings.row_share,
        "bagging_freq": 1,
        "feature_fraction": settings.feature_share,
        "seed": seed,
        "deterministic": True,
        "force_row_wise": True,
        "num_threads": 1,
    }


def _complete(node: dict, place: int, feature: NDArray, threshold: NDArray, value: NDArray) -> None:
    """Fill in a tree's arrays from a node at a place on; below a leaf all leaves are alike."""
    if "leaf_value" in node:
        first = last = place
        while first < len(feature):
            first, last = 2 * first + 1, 2 * last + 2
        value[first - len(feature) : last - len(feature) + 1] = node["leaf_value"]
        return
    feature[place], threshold[place] = node["split_feature"], _kept_below(node["threshold"])
    _complete(node["left_child"], 2 * place + 1, feature, threshold, value)
    _complete(node["right_child"], 2 * place + 2, feature, threshold, value)


def _kept_below(threshold: float) -> np.float32:
    """The largest single precision number that is not above a threshold: samples are in single precision."""
    near = np.float32(threshold)
    return near if near <= threshold else np.nextafter(near, np.float32(-np.inf))


def log_loss(log_odds: NDArray, shows: NDArray) -> float:
    """Mean logistic loss, both kinds of samples weighing the same; log 2 for log-odds of zero."""
    loss = np.logaddexp(0, np.where(shows, -log_odds, log_odds))
    return float(0.5 * (loss[shows].mean() + loss[~shows].mean()))


@njit(cache=True)
def _score(values, feature, threshold, leaf, out):
    trees, inner = feature.shape
    for t in range(trees):
        for i in range(len(out)):
            k = 0
            while k < inner:
                k = 2 * k + (2 if values[feature[t, k], i] > threshold[t, k] else 1)
            out[i] += leaf[t, k - inner]
