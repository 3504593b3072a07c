"""One bare throat, its chart and a larynx of known form on it."""

import numpy as np
import pytest

from headcap.heads import HeadModel, procedural_model
from headcap.neck import LarynxMap, NeckChart, build_chart, larynx_map


def bump_m(uv_m: np.ndarray) -> np.ndarray:
    """A larynx 5 mm high: two Gaussians about 10 mm wide, not symmetric along v."""
    u, v = 1e3 * uv_m[..., 0], 1e3 * uv_m[..., 1]
    shield = 5.0 * np.exp(-0.5 * ((u / 8) ** 2 + (v / 7) ** 2))
    return 1e-3 * (shield + 1.5 * np.exp(-0.5 * ((u / 9) ** 2 + ((v + 13) / 6) ** 2)))


@pytest.fixture(scope="session")
def model() -> HeadModel:
    return procedural_model(3, 3, np.float64)


@pytest.fixture(scope="session")
def chart(model) -> NeckChart:
    return build_chart(model)


@pytest.fixture(scope="session")
def larynx(model, chart) -> LarynxMap:
    """W holds the bump's values at its pixels: the truth is known everywhere."""
    empty = larynx_map(model, chart, np.array([0.0, -0.3, 0.95]))
    rows, columns = empty.weights_m.shape
    u, v = np.meshgrid(np.arange(columns), np.arange(rows))
    return empty.with_weights(bump_m(empty.origin_m + empty.pitch_m * np.stack([u, v], axis=-1)))
