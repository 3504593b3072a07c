"""Dense flow recovers known shifts under changed exposure, tells occlusion, and inverts itself."""

import cv2
import numpy as np
import pytest

from headcap.registration.flow import FlowSettings, consistent, dense_flow, sample


def _texture(rng: np.random.Generator, size: int = 128) -> np.ndarray:
    noise = cv2.GaussianBlur(rng.normal(size=(size, size)).astype(np.float32), (0, 0), 2.5)
    return 128 + 50 * noise / noise.std()


def _shifted(image: np.ndarray, dx: float, dy: float) -> np.ndarray:
    matrix = np.float32([[1, 0, dx], [0, 1, dy]])
    return cv2.warpAffine(image, matrix, image.shape[::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


@pytest.mark.parametrize("shift", [(0.4, -0.3), (3.25, 1.5), (-7.5, 4.0)])
def test_shift_is_found_under_gain_offset_and_shading(rng, shift):
    image = _texture(rng)
    ramp = np.linspace(0.7, 1.2, image.shape[1], dtype=np.float32)
    other = 0.8 * ramp * _shifted(image, *shift) + 12 + rng.normal(0, 1.5, image.shape)
    flow = dense_flow(image, other, FlowSettings(window_px=21))
    inner = flow.displacement[20:-20, 20:-20]
    error = np.linalg.norm(inner - np.float32(shift), axis=2)
    # 8-bit grey levels and noise of 1.5 levels on texture of slope ~20 per pixel: about 0.05 px, twice that allowed
    assert np.median(error) < 0.1
    assert np.median(flow.mismatch[20:-20, 20:-20]) < 0.2


def test_inverse_leads_back(rng):
    image = _texture(rng)
    flow = dense_flow(image, _shifted(image, 2.0, -1.0), FlowSettings(window_px=21))
    pixels = rng.uniform(30, 90, (50, 2))
    there = pixels + flow.at(pixels)
    # the fixed point contracts by the flow's slope (well below 0.5 here) at each of its four steps
    assert np.abs(there + flow.inverse_at(there) - pixels).max() < 0.02


def test_covered_part_is_inconsistent(rng):
    image, other = _texture(rng), None
    patch = _texture(np.random.default_rng(5), 40)
    other = image.copy()
    other[44:84, 44:84] = patch
    settings = FlowSettings(window_px=21)
    agree = consistent(dense_flow(image, other, settings), dense_flow(other, image, settings), 0.5)
    assert agree[10:34, 10:118].mean() > 0.95
    assert agree[50:78, 50:78].mean() < 0.6


def test_sample_is_linear_and_nan_outside():
    field = np.add.outer(np.arange(5.0), 10 * np.arange(4.0))
    assert np.allclose(sample(field, np.array([[1.5, 2.25], [3.0, 4.0]])), [2.25 + 15, 34])
    assert np.isnan(sample(field, np.array([[-0.1, 0.0], [0.0, 4.5], [np.nan, 1.0]]))).all()


def _read_truth(path) -> np.ndarray:
    with open(path, "rb") as handle:
        handle.read(4)
        width, height = np.fromfile(handle, np.int32, 2)
        return np.fromfile(handle, np.float32).reshape(height, width, 2)


@pytest.mark.real
def test_error_on_middlebury_is_at_most_dis_mediums(test_data):
    ours, peer = [], []
    for folder in sorted((test_data / "flow").iterdir()):
        if not folder.is_dir():
            continue
        first, second = (cv2.imread(str(folder / f"frame{n}.png"), cv2.IMREAD_GRAYSCALE) for n in (10, 11))
        truth = _read_truth(next(folder.glob("flow10.flo")))
        known = (np.abs(truth) < 1e9).all(2)
        error = lambda found: np.linalg.norm(found - truth, axis=2)[known].mean()  # noqa: B023, E731
        ours.append(error(dense_flow(first, second, FlowSettings()).displacement))
        peer.append(error(cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(first, second, None)))
    assert np.mean(ours) <= np.mean(peer)
