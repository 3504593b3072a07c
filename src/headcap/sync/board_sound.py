"""The clap of the board's recording: there the pictures tell when each camera started, so the sound tells the rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_json, save_json
from headcap.recordings.audio import read_audio
from headcap.recordings.takes import IngestedTake
from headcap.sync.clapper import ClapperEstimate, refine_clapper
from headcap.sync.offsets import TimeOffsets
from headcap.sync.settings import SyncSettings
from headcap.sync.solve import synchronise

KIND, SCHEMA = "clapper", 1


def read_sounds(take: IngestedTake) -> dict[str, tuple[NDArray[np.float32], int, float]]:
    """Per camera samples, rate and own time of the first sample; no samples where a recording has no sound."""
    silent = (np.empty(0, np.float32), 48000, 0.0)
    return {r.camera: read_audio(r.path) if r.audio_rate_hz else silent for r in take.recordings}


def place_clapper(
    take: IngestedTake,
    offsets: TimeOffsets,
    picture_offset_s: Mapping[str, float],
    picture_sigma_s: Mapping[str, float],
    camera_centres: Mapping[str, NDArray],
    clapper_m: NDArray,
    *,
    clap: bool = True,
    settings: SyncSettings | None = None,
) -> ClapperEstimate:
    """The clapper's place and each camera's lag of sound behind picture, from the board's recording.

    `offsets` are the start times that calibrate worked with, `picture_offset_s` what the board's motion adds to them and
    `picture_sigma_s` how well; `clapper_m` is the rough place, in the frame of `camera_centres`. Where there was no clap, or
    the board's motion tells nothing, the rough place stands and no camera has a lag.
    """
    rough = np.asarray(clapper_m, float)
    if not clap or not picture_offset_s:
        return ClapperEstimate(rough, np.full(3, np.inf), dict.fromkeys(camera_centres, 0.0), np.nan)
    sounds = read_sounds(take)
    heard = synchronise(sounds, take=take.take, camera_centres=camera_centres, clapper_m=rough, settings=settings).offsets
    difference = {
        camera: offsets.start_s[offsets.cameras.index(camera)] + moved - heard.start_s[heard.cameras.index(camera)]
        for camera, moved in picture_offset_s.items()
        if len(sounds[camera][0])
    }
    sigma = {camera: picture_sigma_s[camera] for camera in difference}
    return refine_clapper(camera_centres, difference, rough, picture_std_s=sigma, settings=settings)


def save_clapper(estimate: ClapperEstimate, path: Path | str) -> None:
    """Write as JSON artifact `headcap.clapper/1`; what is not finite is written as null."""
    content = asdict(estimate)
    content |= {key: [_number(v) for v in content[key]] for key in ("clapper_m", "clapper_std_m")}
    save_json(path, KIND, SCHEMA, content | {"residual_rms_s": _number(estimate.residual_rms_s)})


def load_clapper(path: Path | str) -> ClapperEstimate:
    """Read what `save_clapper` wrote; raises `ArtifactError`."""
    content = load_json(path, KIND, SCHEMA)
    vectors = {key: np.array(content[key], float) for key in ("clapper_m", "clapper_std_m")}
    residual = content["residual_rms_s"]
    return ClapperEstimate(**(content | vectors | {"residual_rms_s": np.nan if residual is None else residual}))


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
