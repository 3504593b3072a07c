"""From features to the correction layer: a radial basis function network, and the affine baseline (lip paper, section 5.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy.linalg import cho_factor, cho_solve, eigh
from scipy.spatial.distance import cdist

from headcap.errors import InputError
from headcap.lips.features import LipFeatures
from headcap.lips.principal import principal_corrections
from headcap.lips.triangle_parameters import PARAMETERS

Inputs = Literal["combined", "shape", "distances"]


class RegressionSettings(BaseModel):
    """Training a regressor."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["rbf", "affine"] = Field("rbf", description="Network of eq. 3, or features times weights plus bias")
    inputs: Inputs = Field("combined", description="Shape vector and contour distances, or one of the two (table 2)")
    every: int = Field(10, ge=1, description="Every so manieth frame of a take is a prototype, at least (the paper: tenth)")
    prototypes: int = Field(
        320,
        ge=1,
        description="How many prototypes there should be: smaller training sets are sampled more densely than `every`, down to "
        "each frame (the paper's tenth of 3,289 frames are 329). A network spans no more than its neurons: with fewer of them "
        "than features it loses to an affine map, whatever alpha and beta",
    )
    alphas: tuple[float, ...] = Field(
        (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0),
        min_length=1,
        description="Ridge parameters of eq. 4 that are tried",
    )
    betas: tuple[float, ...] = Field((0.01, 0.03, 0.1, 0.3, 1.0, 3.0), min_length=1, description="Scales of eq. 2 that are tried")
    leave_out: Literal["takes", "persons"] = Field(
        "takes", description="What cross-validation leaves out together; persons for a regressor that is to serve others"
    )
    folds: int = Field(5, ge=2, description="Most parts of the training set that are left out in turn")
    components: int = Field(150, ge=1, description="Principal components of the corrections that right-hand sides are reduced to")
    reduced: bool = Field(
        True,
        description="Whether weights stay in these components: half the memory, a fifth of the time; else each number has one",
    )
    seed: int = Field(0, ge=0, description="Of the range finder for the components")


@dataclass(frozen=True, eq=False)
class LipTake:
    """Training frames of one take."""

    person: str
    name: str
    features: LipFeatures
    parameters: NDArray[np.float32]
    """l_f of eq. 1 (f, T, 9); may be a memory map."""

    def __post_init__(self) -> None:
        if self.parameters.ndim != 3 or self.parameters.shape[::2] != (len(self.features), PARAMETERS):
            raise InputError(
                f"{self.person} {self.name}: {len(self.features)} frames of features, corrections {self.parameters.shape}",
                expected="one correction (T, 9) per frame",
                remedy="Make features and corrections of the same frames.",
            )


@dataclass(frozen=True, eq=False)
class FeatureScaling:
    """What makes shape vector and distances comparable: each in units of its own spread over the training frames.

    Eq. 2 measures one distance for both and the paper names no units; this way neither drowns the other, whatever the
    blendshapes' number and the head's size.
    """

    inputs: Inputs
    mean: NDArray[np.float64]
    """(m,)"""
    scale: NDArray[np.float64]
    """(m,) one value for all of the shape vector, one for all distances: root of their total variance."""

    @classmethod
    def of(cls, features: Sequence[LipFeatures], inputs: Inputs) -> FeatureScaling:
        """Of training frames."""
        groups = [np.concatenate(group) for group in zip(*(_groups(part, inputs) for part in features), strict=True)]
        means = [group.mean(axis=0) for group in groups]
        spreads = [np.sqrt(((group - mean) ** 2).sum(axis=1).mean()) for group, mean in zip(groups, means, strict=True)]
        scale = [np.full(group.shape[1], spread or 1.0) for group, spread in zip(groups, spreads, strict=True)]
        return cls(inputs, np.concatenate(means), np.concatenate(scale))

    def __call__(self, features: LipFeatures) -> NDArray[np.float64]:
        """f of eq. 2 (f, m), dimensionless; NaN where a frame tells none."""
        joined = np.concatenate(_groups(features, self.inputs), axis=1)
        if joined.shape[1] != len(self.mean):
            raise InputError(
                f"{joined.shape[1]} features", expected=f"{len(self.mean)}", remedy="Make features in the regressor's own space."
            )
        return (joined - self.mean) / self.scale


@dataclass(frozen=True, eq=False)
class Network:
    """Eq. 3: a layer of neurons, weights, and a bias that is not penalised; without prototypes the features stand for neurons."""

    prototypes: NDArray[np.float64]
    """p_n (N, m), scaled features; N = 0 for the affine regressor."""
    beta: float
    """Of eq. 2."""
    alpha: float
    """Of eq. 4."""
    weights: NDArray
    """w_n (N or m, q)."""
    bias: NDArray
    """b (q,)."""

    def __call__(self, inputs: NDArray) -> NDArray:
        """Outputs (f, q) of scaled features (f, m)."""
        return activations(inputs, self.prototypes, self.beta).astype(self.weights.dtype) @ self.weights + self.bias


@dataclass(frozen=True, eq=False)
class TrainedRegression:
    """What training finds; `artifact.LipRegressor` says whose it is."""

    scaling: FeatureScaling
    network: Network
    components: NDArray[np.float32] | None
    """(q, 9 T) that the network's outputs weigh; None where they are the layer itself."""
    mean: NDArray[np.float32]
    """(9 T,) added to it."""
    figures: dict[str, float] = field(default_factory=dict)
    """Frames used and skipped, cross-validated rms error of the nine numbers, that of predicting the mean, share of the
    corrections' variance that the components lose."""

    def __call__(self, features: LipFeatures) -> NDArray[np.float32]:
        """l (f, T, 9) of frames' features (eq. 3); NaN where a frame tells none."""
        inputs = self.scaling(features)
        out = np.full((len(features), len(self.mean)), np.nan, np.float32)
        told = np.isfinite(inputs).all(axis=1)
        found = self.network(inputs[told])
        if self.components is not None:
            found = found.astype(np.float32) @ self.components
        out[told] = found + self.mean
        return out.reshape(len(features), -1, PARAMETERS)


def activations(inputs: NDArray, prototypes: NDArray, beta: float) -> NDArray[np.float64]:
    """Phi_n (f, N) of eq. 2, exp(-beta |p_n - f|^2); the features themselves where there are no prototypes."""
    return np.exp(-beta * cdist(inputs, prototypes, "sqeuclidean")) if len(prototypes) else inputs


def train_regression(takes: Sequence[LipTake], settings: RegressionSettings | None = None) -> TrainedRegression:
    """Weights of eq. 4 by ridge regression, alpha and beta by cross-validation.

    Normal equations are factored once for all right-hand sides. Right-hand sides are the corrections' coordinates in their
    principal components: the sum of squares of eq. 4 is the same in these up to what they lose, which no regression sees. Frames
    without features or corrections are skipped and counted. Raises `InputError` for too few frames.
    """
    settings = settings or RegressionSettings()
    kept, skipped = _kept(takes, settings.inputs)
    frames = sum(len(take.features) for take in kept)
    if frames < 2 * settings.every or frames < 2 * settings.folds:
        raise InputError(
            f"{frames} frames with features and corrections of {len(takes)} takes ({skipped} skipped)",
            expected=f"at least {2 * max(settings.every, settings.folds)}",
            remedy="Record lip takes whose contours are found.",
        )
    scaling = FeatureScaling.of([take.features for take in kept], settings.inputs)
    inputs = [scaling(take.features) for take in kept]
    flat = [take.parameters.reshape(len(take.features), -1) for take in kept]
    principal = principal_corrections(flat, settings.components, settings.seed)
    errors = cross_validation(inputs, principal.coordinates, fold_labels(kept, settings), settings)
    at = np.unravel_index(errors.argmin(), errors.shape)
    beta, alpha = _betas(settings)[at[0]], settings.alphas[at[1]]
    prototypes = _prototypes(inputs, sampling(frames, settings), settings)
    if settings.reduced:
        network = fit_network(inputs, principal.coordinates, prototypes, beta, alpha)
    else:
        network = fit_network(inputs, [part - principal.mean for part in flat], prototypes, beta, alpha, np.float32)
    unit = frames * len(principal.mean)
    figures = {
        "frames": float(frames),
        "skipped_frames": float(skipped),
        "cross_validation_rms": float(np.sqrt((errors.min() + principal.lost) / unit)),
        "predicting_mean_rms": float(np.sqrt(principal.energy / unit)),
        "lost_variance": principal.lost / max(principal.energy, 1e-300),
    }
    return TrainedRegression(scaling, network, principal.components if settings.reduced else None, principal.mean, figures)


def fit_network(
    inputs: Sequence[NDArray],
    targets: Sequence[NDArray],
    prototypes: NDArray,
    beta: float,
    alpha: float,
    dtype: type = np.float64,
) -> Network:
    """Eq. 4 of takes' scaled features (f, m) and targets (f, q): one Cholesky factor of N x N for all q right-hand sides.

    The bias is free: it takes up the means, so that (Phi^T Phi + alpha I) w = Phi^T l holds with both about their means.
    """
    neurons = [activations(part, prototypes, beta) for part in inputs]
    frames = sum(map(len, neurons))
    mean = sum(part.sum(axis=0) for part in neurons) / frames
    mean_target = sum(part.sum(axis=0, dtype=np.float64) for part in targets) / frames
    gram = sum((part - mean).T @ (part - mean) for part in neurons)
    cross = sum((part - mean).T.astype(target.dtype) @ target for part, target in zip(neurons, targets, strict=True))
    weights = cho_solve(cho_factor(gram + alpha * np.eye(len(gram))), cross)
    return Network(prototypes, beta, alpha, weights.astype(dtype), (mean_target - mean @ weights).astype(dtype))


def cross_validation(
    inputs: Sequence[NDArray], targets: Sequence[NDArray], labels: Sequence[NDArray], settings: RegressionSettings
) -> NDArray[np.float64]:
    """Squared errors (betas, alphas) on frames left out of everything, prototypes included, summed over all parts.

    `labels` (f,) per take number the parts. For each scale the Gram matrix is decomposed once and serves all ridge parameters.
    """
    betas, step = _betas(settings), sampling(sum(map(len, inputs)), settings)
    errors = np.zeros((len(betas), len(settings.alphas)))
    for fold in range(1 + max(int(part.max()) for part in labels)):
        training = [(x[part != fold], y[part != fold]) for x, y, part in zip(inputs, targets, labels, strict=True)]
        x, y = (np.concatenate(parts) for parts in zip(*training, strict=True))
        left_x, left_y = (
            np.concatenate([a[p == fold] for a, p in zip(arrays, labels, strict=True)]) for arrays in (inputs, targets)
        )
        prototypes = _prototypes([part for part, _ in training], step, settings)
        for row, beta in zip(errors, betas, strict=True):
            row += _path_errors(
                activations(x, prototypes, beta), y, activations(left_x, prototypes, beta), left_y, settings.alphas
            )
    return errors


def sampling(frames: int, settings: RegressionSettings) -> int:
    """Every so manieth frame is a prototype: `every`, or less where that would give too few of them (section 5.2).

    Measured on nine filmed people of 108 frames each, one left out in turn: rms over the mouth's vertices of what the regressed
    layer lacks, 1.3 mm without one. An affine map leaves 0.46 mm, every third frame as a prototype 0.38 mm (288 of them), each
    frame 0.35 mm; features of shape alone 0.53 mm, distances alone 0.62 mm. Of six such people every tenth frame leaves 0.56 mm
    (60 prototypes for 103 features), every fifth 0.48 mm, each 0.42 mm, the affine map 0.55 mm. Of ten people's own regressors
    (72 frames, another take) every tenth frame leaves 0.91 mm, each 0.55 mm, the affine map 0.57 mm; of five people's common one
    0.66, 0.51 and 0.59 mm.
    """
    return int(np.clip(frames // settings.prototypes, 1, settings.every))


def fold_labels(takes: Sequence[LipTake], settings: RegressionSettings) -> list[NDArray[np.int64]]:
    """Per take (f,) the part that each frame belongs to: whole persons or takes; stretches where there is one take alone."""
    by_person = settings.leave_out == "persons" and len({take.person for take in takes}) > 1
    # a take and its mirror image have one name, and are left out together
    wholes = [(take.person,) if by_person else (take.person, take.name) for take in takes]
    names = list(dict.fromkeys(wholes))
    if len(names) == 1:
        return [np.arange(len(take.features)) * settings.folds // len(take.features) for take in takes]
    return [np.full(len(take.features), names.index(whole) % settings.folds) for take, whole in zip(takes, wholes, strict=True)]


def _path_errors(x: NDArray, y: NDArray, left_x: NDArray, left_y: NDArray, alphas: Sequence[float]) -> NDArray[np.float64]:
    mean_x, mean_y = x.mean(axis=0), y.mean(axis=0)
    values, vectors = eigh((x - mean_x).T @ (x - mean_x))
    cross = vectors.T @ ((x - mean_x).T @ (y - mean_y))
    shown, wanted = (left_x - mean_x) @ vectors, left_y - mean_y
    values = np.maximum(values, 0.0)
    return np.array([((shown @ (cross / (values + alpha)[:, None]) - wanted) ** 2).sum() for alpha in alphas])


def _prototypes(inputs: Sequence[NDArray], step: int, settings: RegressionSettings) -> NDArray[np.float64]:
    """(N, m) a temporally uniform sampling of each take (section 5.2)."""
    if settings.kind == "affine":
        return np.zeros((0, inputs[0].shape[1]))
    return np.concatenate([part[::step] for part in inputs])


def _betas(settings: RegressionSettings) -> tuple[float, ...]:
    return settings.betas if settings.kind == "rbf" else (0.0,)


def _groups(features: LipFeatures, inputs: Inputs) -> list[NDArray]:
    return [getattr(features, name) for name in ("shape", "distances") if inputs in ("combined", name)]


def _kept(takes: Sequence[LipTake], inputs: Inputs) -> tuple[list[LipTake], int]:
    """Takes without frames that tell nothing, and how many these were; takes that are whole are not copied."""
    kept, skipped = [], 0
    for take in takes:
        told = np.isfinite(np.concatenate(_groups(take.features, inputs), axis=1)).all(axis=1)
        # frame by frame: a memory map of a whole take is not read at once
        told &= np.array([bool(np.isfinite(frame).all()) for frame in take.parameters], bool)
        skipped += int((~told).sum())
        if told.all() and len(told):
            kept.append(take)
        elif told.any():
            kept.append(LipTake(take.person, take.name, take.features.frames(told), take.parameters[told]))
    return kept, skipped
