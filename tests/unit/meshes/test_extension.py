"""Continuing fields over a surface: what is known stays, what is not is smooth and asks nothing of what stood there."""

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.heads import base_head
from headcap.meshes.extension import SmoothExtension
from headcap.meshes.laplacian import bilaplacian, cotangent_laplacian, vertex_areas


@pytest.fixture(scope="module")
def head():
    return base_head()


@pytest.fixture(scope="module")
def known(head):
    return head.vertices[:, 2] > -0.04


@pytest.fixture(scope="module")
def extension(head, known):
    return SmoothExtension(head.vertices, head.triangles, known)


def test_known_values_stay_and_unknown_ones_are_not_looked_at(head, known, extension, rng):
    field = rng.normal(size=(2, len(head.vertices), 3))
    other = field.copy()
    other[:, ~known] = np.nan
    assert (extension(field)[:, known] == field[:, known]).all()
    assert np.array_equal(extension(field), extension(other))


def test_the_result_is_the_least_energy(head, known, extension, rng):
    field = np.sin(20 * head.vertices)
    found = extension(field)
    areas = vertex_areas(head.vertices, head.triangles)
    bending = bilaplacian(cotangent_laplacian(head.vertices, head.triangles, least_weight=0.0), areas)

    def energy(x: np.ndarray) -> float:
        mass = np.maximum(areas, 1e-3 * areas.mean())[:, None] / 0.05**4
        return float((x * (bending @ x)).sum() + (mass * x**2).sum())

    for _ in range(3):
        away = rng.normal(size=field.shape) * ~known[:, None]
        up, down = energy(found + 1e-3 * away), energy(found - 1e-3 * away)
        assert min(up, down) > energy(found)
        assert up - energy(found) == pytest.approx(down - energy(found), rel=1e-3)


def test_everything_known_is_left_alone_and_nothing_known_refused(head):
    field = np.ones((len(head.vertices), 3))
    everywhere = np.ones(len(head.vertices), bool)
    assert SmoothExtension(head.vertices, head.triangles, everywhere)(field) is field
    with pytest.raises(InputError, match="0 known"):
        SmoothExtension(head.vertices, head.triangles, ~everywhere)
