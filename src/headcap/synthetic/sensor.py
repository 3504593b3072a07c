"""From linear light to the 8-bit picture a camera records: exposure, white balance, noise, sRGB."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.synthetic.rig import NOISE_STREAM, SENSOR_STREAM, random_stream
from headcap.synthetic.settings import SensorSettings

_TILE = 512
_LEVELS = 16384


@dataclass(frozen=True)
class Sensor:
    """One camera's sensor; the noise of a frame depends on `purpose`, so frames can be made in any order."""

    gains: NDArray[np.float32]
    """(3,) exposure times white balance, RGB."""
    read_noise: float
    shot_noise: float
    seed: int

    def expose(self, linear: NDArray, *purpose: int) -> NDArray[np.uint8]:
        """Linear RGB (height, width, 3) to sRGB-encoded RGB uint8; `purpose` (recording, camera, frame) seeds the noise."""
        shift = random_stream(self.seed, NOISE_STREAM, 2, *purpose).integers(0, _TILE, 2)
        out = np.empty(linear.shape, np.uint8)
        _expose(linear, self.gains, self.read_noise, self.shot_noise, _noise_tile(), shift, _encoding(), out)
        return out


def build_sensors(sensor: SensorSettings, seed: int, cameras: int) -> tuple[Sensor, ...]:
    """The sensors of a number of cameras."""
    random = random_stream(seed, SENSOR_STREAM)
    exposure = np.exp(random.normal(0, sensor.exposure_sigma, (cameras, 1)))
    balance = np.exp(random.normal(0, sensor.white_balance_sigma, (cameras, 3)) * [1, 0, 1])
    gains = (exposure * balance).astype(np.float32)
    return tuple(Sensor(gain, sensor.read_noise, sensor.shot_noise, seed) for gain in gains)


_cache: dict[str, NDArray] = {}


def _noise_tile() -> NDArray[np.float32]:
    """Standard normal noise (tile, tile, 3), drawn once: each frame reads it from another corner, turned by its own place."""
    if "noise" not in _cache:
        _cache["noise"] = np.random.default_rng(20).standard_normal((_TILE, _TILE, 3)).astype(np.float32)
    return _cache["noise"]


def _encoding() -> NDArray[np.uint8]:
    if "encoding" not in _cache:
        linear = (np.arange(_LEVELS) + 0.5) / _LEVELS
        encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        _cache["encoding"] = np.rint(255 * encoded).astype(np.uint8)
    return _cache["encoding"]


@njit(cache=True, fastmath=True)
def _expose(linear, gains, read_noise, shot_noise, tile, shift, encoding, out):
    height, width = linear.shape[0], linear.shape[1]
    size, levels = tile.shape[0], len(encoding)
    read, shot = np.float32(read_noise * read_noise), np.float32(shot_noise * shot_noise)
    for y in range(height):
        noise = tile[(y + shift[0]) % size]
        i = shift[1] % size
        for x in range(width):
            for channel in range(3):
                value = linear[y, x, channel] * gains[channel]
                value += np.sqrt(read + shot * max(value, np.float32(0))) * noise[i, channel]
                level = int(value * levels)
                out[y, x, channel] = encoding[min(max(level, 0), levels - 1)]
            i = i + 1 if i + 1 < size else 0


def encode(linear: NDArray) -> NDArray[np.uint8]:
    """Linear values 0 to 1 of any shape to sRGB uint8."""
    return _encoding()[np.clip((linear * _LEVELS).astype(int), 0, _LEVELS - 1)]
