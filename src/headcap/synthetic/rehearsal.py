"""A whole rehearsal on disk: recordings, scan, board and the truth; piece by piece or all at once."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from headcap.artifacts import atomic_path
from headcap.cameras import Rig
from headcap.heads.procedural import base_head
from headcap.recordings.writer import write_video
from headcap.synthetic import truth
from headcap.synthetic.board import BoardMotion, BoardPainter, wave_board
from headcap.synthetic.crew import Piece, carry_out
from headcap.synthetic.growth import grow_subject
from headcap.synthetic.hand_made import write_hand_made
from headcap.synthetic.lighting import Lights
from headcap.synthetic.mesh_takes import mesh_subject
from headcap.synthetic.performance import Performance, perform
from headcap.synthetic.rig import MOTION_STREAM, Clock, build_clocks, build_rig, random_stream
from headcap.synthetic.scan import write_scan
from headcap.synthetic.sensor import build_sensors
from headcap.synthetic.settings import X264_PRESET, RehearsalSettings
from headcap.synthetic.sound import record, take_sources
from headcap.synthetic.studio import Sitter, Studio
from headcap.synthetic.subject import Subject

CALIBRATION, DESCRIPTION = "calibration", "rehearsal.json"
Progress = Callable[[int, int, str], None]
"""Called with pieces done, pieces in all, and what was just finished."""


@dataclass(frozen=True)
class Rehearsal:
    """Everything that settings decide, before anything is rendered."""

    settings: RehearsalSettings
    rig: Rig
    clocks: dict[str, tuple[Clock, ...]]
    """Per recording (`CALIBRATION` and the takes), per camera."""
    frames: dict[str, int]
    """Frame slots of each recording."""

    @property
    def recordings(self) -> tuple[str, ...]:
        """`CALIBRATION`, then the takes."""
        return tuple(self.frames)

    def path(self, recording: str, camera: str) -> Path:
        """A recording's place inside the rehearsal's folder."""
        return Path(recording if recording == CALIBRATION else f"takes/{recording}") / f"{camera}.mp4"


@lru_cache(maxsize=2)
def plan(settings: RehearsalSettings) -> Rehearsal:
    """The rig and the clocks of a rehearsal."""
    rig = build_rig(settings)
    durations = {CALIBRATION: settings.board.duration_s} | {take.name: take.duration_s for take in settings.takes}
    frames = {name: round(duration * settings.video.rate_hz) for name, duration in durations.items()}
    clocks = {name: build_clocks(settings, k, count, rig.names) for k, (name, count) in enumerate(frames.items())}
    return Rehearsal(settings, rig, clocks, frames)


@lru_cache(maxsize=1)
def subject_of(settings: RehearsalSettings) -> Subject:
    """The subject of a rehearsal."""
    return grow_subject(base_head(), settings.subject, settings.seed)


@lru_cache(maxsize=8)
def performance_of(settings: RehearsalSettings, take: str) -> Performance:
    """What the subject does in a take."""
    index = [t.name for t in settings.takes].index(take)
    chosen = settings.takes[index]
    end = chosen.duration_s + settings.clock.start_spread_s
    random = random_stream(settings.seed, MOTION_STREAM, index)
    return perform(random, chosen.kind, end, chosen.intensity, chosen.lip_shapes)


def rehearse(settings: RehearsalSettings, folder: Path | str, *, progress: Progress | None = None, workers: int = 1) -> Rehearsal:
    """Write a whole rehearsal into `folder`: `calibration/`, `takes/<take>/`, `scan/`, `board.yaml`, `rehearsal.json`, `truth/`.

    `rehearsal.json` comes last: where it is, all else is there. `workers` processes render recordings side by side; the
    files do not depend on their number.
    """
    rehearsal, folder = plan(settings), Path(folder)
    pieces: list[Piece] = [("rehearse_truth", take.name) for take in settings.takes] + [("rehearse_scan",)]
    # takes first, their pieces are the longest: workers then finish together
    for name in reversed(rehearsal.recordings):
        pieces += [("rehearse_recording", name, camera) for camera in rehearsal.rig.names]
    (folder / DESCRIPTION).unlink(missing_ok=True)
    finished = (
        carry_out(pieces, settings.model_dump_json(), folder, workers) if workers > 1 else _one_by_one(pieces, settings, folder)
    )
    for done, name in enumerate(finished, 1):
        if progress is not None:
            progress(done, len(pieces), name)
    if settings.sculpt is not None:
        write_hand_made(folder, mesh_subject(settings.seed, settings.subject), settings.sculpt)
    write_description(settings, folder)
    return rehearsal


def _one_by_one(pieces: list[Piece], settings: RehearsalSettings, folder: Path) -> Iterator[str]:
    for function, *arguments in pieces:
        yield str(globals()[function](settings, *arguments, folder))


def rehearse_recording(settings: RehearsalSettings, recording: str, camera: str, folder: Path | str) -> Path:
    """Render and write one camera's recording of the board (`CALIBRATION`) or of a take; gives its path in the folder."""
    rehearsal = plan(settings)
    index, c = rehearsal.recordings.index(recording), rehearsal.rig.names.index(camera)
    path = rehearsal.path(recording, camera)
    duration = rehearsal.frames[recording] / settings.video.rate_hz
    clock = rehearsal.clocks[recording][c]
    speech, mouth = None, np.zeros(3)
    if recording != CALIBRATION:
        speech, mouth = performance_of(settings, recording).speech, subject_of(settings).places.mouth
    sources = take_sources(settings, index, duration + settings.clock.start_spread_s, speech, mouth)
    samples = int(duration * settings.sound.rate_hz)
    sound = record(settings, sources, clock, rehearsal.rig[c].centre, samples, (index, c))
    frames = _board_frames(rehearsal, c) if recording == CALIBRATION else _take_frames(rehearsal, recording, c)
    exposed = _exposed(frames, rehearsal, index, c)
    video = settings.video
    write_video(
        Path(folder) / path, exposed, (video.width, video.height), video.rate_hz, crf=video.crf, preset=X264_PRESET, sound=sound,
        sound_rate_hz=settings.sound.rate_hz,
    )  # fmt: skip
    return path


def rehearse_camera(settings: RehearsalSettings, camera: str, folder: Path | str) -> list[Path]:
    """Render and write all recordings of one camera: the piece that a workflow's job takes; gives their paths in the folder."""
    return [rehearse_recording(settings, recording, camera, folder) for recording in plan(settings).recordings]


def rehearse_truth(settings: RehearsalSettings, take: str, folder: Path | str) -> Path:
    """Write the truth of one take; gives its path in the folder."""
    clocks, rate = plan(settings).clocks[take], settings.video.rate_hz
    truth.write_take_truth(Path(folder) / "truth", take, subject_of(settings), performance_of(settings, take), clocks, rate)
    return Path("truth") / f"{take}.npz"


def rehearse_scan(settings: RehearsalSettings, folder: Path | str) -> Path:
    """Write the scan, its placement and the subject's topology; gives the scan's path in the folder."""
    folder, subject = Path(folder), subject_of(settings)
    write_scan(folder / "scan/neutral.ply", subject, settings.scan, settings.seed)
    truth.write_topology_truth(folder / "truth", subject)
    truth.write_scan_truth(folder / "truth", settings)
    return Path("scan/neutral.ply")


def write_description(settings: RehearsalSettings, folder: Path | str) -> None:
    """Write `board.yaml`, `rehearsal.json` (what a session file needs to know, and the settings) and `truth/rig.json`."""
    rehearsal, folder, board = plan(settings), Path(folder), settings.board
    content = {
        "type": "charuco",
        "dictionary": board.dictionary,
        "squares": list(board.squares),
        "square_size_mm": board.square_size_mm,
        "marker_size_mm": board.marker_size_mm,
        "inverted": board.inverted,
    }
    with atomic_path(folder / "board.yaml") as temporary:
        temporary.write_text(yaml.safe_dump(content, sort_keys=False))
    takes = {take.name: {"kind": take.kind, "frames": rehearsal.frames[take.name]} for take in settings.takes}
    session = {
        "rate_hz": settings.video.rate_hz,
        "size": [settings.video.width, settings.video.height],
        "cameras": list(rehearsal.rig.names),
        "board": "board.yaml",
        "calibration": {c: str(rehearsal.path(CALIBRATION, c)) for c in rehearsal.rig.names},
        "calibration_frames": rehearsal.frames[CALIBRATION],
        "takes": {n: t | {"files": {c: str(rehearsal.path(n, c)) for c in rehearsal.rig.names}} for n, t in takes.items()},
        "scan": {"file": "scan/neutral.ply", "unit_m": settings.scan.unit_m},
        "clapper_m": list(settings.sound.clap_position_m),
        "truth": "truth",
        "settings": settings.model_dump(mode="json"),
    }
    truth.write_rig_truth(folder / "truth", settings, rehearsal.rig, rehearsal.clocks, rehearsal.frames)
    with atomic_path(folder / DESCRIPTION) as temporary:
        temporary.write_text(json.dumps(session, indent=1) + "\n")


def _exposed(
    frames: Iterator[tuple[int, NDArray]], rehearsal: Rehearsal, recording: int, camera: int
) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    sensor = build_sensors(rehearsal.settings.sensor, rehearsal.settings.seed, len(rehearsal.rig))[camera]
    for slot, linear in frames:
        yield slot, sensor.expose(linear, recording, camera, slot)


def _frame_times(rehearsal: Rehearsal, recording: str, camera: int) -> Iterator[tuple[int, float]]:
    clock = rehearsal.clocks[recording][camera]
    for slot in clock.kept_frames.tolist():
        yield slot, float(clock.common_time(slot / rehearsal.settings.video.rate_hz))


def _studio(settings: RehearsalSettings) -> Studio:
    lights = Lights.from_settings(settings.lights, settings.ambient, settings.gloss)
    return Studio.of((settings.video.width, settings.video.height), settings.sensor, lights)


def _board_frames(rehearsal: Rehearsal, c: int) -> Iterator[tuple[int, NDArray[np.float32]]]:
    settings = rehearsal.settings
    waved: BoardMotion = wave_board(settings, rehearsal.rig)
    painter, studio = BoardPainter(rehearsal.rig[c], settings.board), _studio(settings)
    light = studio.lights.directions[:1].sum(0)
    shown, parts = np.empty(0), []
    for slot, time in _frame_times(rehearsal, CALIBRATION, c):
        poses = np.array([waved.world_from_board(time + later) for _, later in studio.bands])
        # most of the time the board rests, and looks as it did before
        if not np.array_equal(poses, shown):
            bands = [rows for rows, _ in studio.bands]
            parts = [
                painter.paint(pose, studio.background[a:b], light, (a, b)) for pose, (a, b) in zip(poses, bands, strict=True)
            ]
            shown = poses
        yield slot, np.concatenate(parts)


def _take_frames(rehearsal: Rehearsal, take: str, c: int) -> Iterator[tuple[int, NDArray[np.float32]]]:
    settings, subject = rehearsal.settings, subject_of(rehearsal.settings)
    performance, studio = performance_of(settings, take), _studio(settings)
    tattooed = next(t for t in settings.takes if t.name == take).lips_tattooed
    surface = subject.lips_surface if tattooed else subject.surface
    sitter = Sitter(
        lambda time: (subject.vertices(performance.state(time)), surface), subject.openness, subject.occluder, subject.grain
    )
    for slot, time in _frame_times(rehearsal, take, c):
        yield slot, studio.photograph(rehearsal.rig[c], sitter, time)
