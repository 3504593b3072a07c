"""One frame of 16 cameras at 1080x1920: CPU-seconds and memory of reconstruct and of track, and the errors of what they made.

The recordings are rehearsed: rendered, encoded and read back, so that the benchmark needs none of its own. The rehearsal's
rig and start times stand in for calibration and synchronisation; all else is done as the stages do it, on one thread, each
stage in a process of its own. There is no peer. Rendering is kept beside the results; delete that folder to render again.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from run import measure, peak_memory_gib, write

from headcap.artifacts import digest_settings
from headcap.cameras import Rig
from headcap.evaluation.reconstruction import compare_cloud, summarise_clouds
from headcap.evaluation.tracking import compare_sequence
from headcap.evaluation.truth import Truth
from headcap.heads import base_head
from headcap.reconstruction.cloud_sequence import CloudSequence, cloud_file
from headcap.reconstruction.frame import reconstruct_frame
from headcap.reconstruction.points import PointCloud
from headcap.reconstruction.settings import ReconstructSettings
from headcap.recordings.frames import TakeFrames
from headcap.recordings.probe import probe
from headcap.recordings.takes import IngestedTake
from headcap.registration.place import place_template
from headcap.registration.register import register_scan
from headcap.registration.scan import load_scan
from headcap.registration.sequence import MeshSequence, save_chunk
from headcap.registration.start import prepare_start
from headcap.registration.template import Template
from headcap.registration.track_settings import TrackSettings
from headcap.registration.tracker import track_anchors, track_chunk
from headcap.sync import TimeOffsets
from headcap.sync.timeline import open_take
from headcap.synthetic import rehearsal
from headcap.synthetic.settings import ClockSettings, DroppedFrames, RehearsalSettings, TakeSettings, VideoSettings

TAKE, CAMERAS, RATE = "free_01", 16, 30.0
# The subject rests for 0.40 s. Frames before the last one at rest are left out of the recordings, to render less.
REST, LAST = 11, 17
"""Frame of the camera that started last at which tracking starts; last frame rendered."""
TRACKED = 4
"""Frames after the first; around each of them every camera has the two frames that flow asks for."""
MEASURED = (3, 4)
"""Of these, the frames reconstructed at full size. The others' clouds, at half size, are there for the tracker alone."""
TIMES = ("seconds", "cpu_seconds")
RECONSTRUCT = ReconstructSettings(engine="patchmatch")

SETTINGS = RehearsalSettings(
    video=VideoSettings(width=1080, height=1920, rate_hz=RATE),
    clock=ClockSettings(
        start_spread_s=1 / RATE,
        dropped_frames=tuple(
            DroppedFrames(camera=f"cam{c:02d}", frames=tuple(range(1, REST - 1)))  # the first is kept in any case
            for c in range(CAMERAS)
        ),
    ),
    takes=(TakeSettings(name=TAKE, kind="free", duration_s=(LAST + 1) / RATE),),
)


def run(out_path: Path) -> None:
    """Measure both stages and write their figures."""
    # named by the settings: what is there was rendered from them
    folder = out_path.with_suffix("").resolve() / digest_settings(settings=SETTINGS)[:12]
    # a process of its own for each, so that its peak of memory is its own
    found = {name: _in_own_process(name, folder) for name in PARTS}
    reconstructed, tracked = found["reconstruct"], found["track"]
    ours = {key: reconstructed[key] + tracked[key] for key in TIMES}
    for name in ("reconstruct", "track"):
        part = found[name]
        errors = ", ".join(f"{key} {value:.3g}" for key, value in part["errors"].items())
        print(f"  {name}: {part['cpu_seconds']:.2f} CPU-s per frame, {part['peak_memory_gib']:.2f} GiB; {errors}", flush=True)
    write(
        out_path,
        ours=ours | {"name": f"reconstruct and track, one frame of {CAMERAS} views of 1080x1920"},
        figures=found,
        memory_gib=max(part["peak_memory_gib"] for name, part in found.items() if name != "render"),
    )


def render(folder: Path) -> dict:
    """The take's recordings, the scan and the truth; what an earlier run left is kept."""
    planned, pictures = rehearsal.plan(SETTINGS), 0
    for camera, clock in zip(planned.rig.names, planned.clocks[TAKE], strict=True):
        if not (folder / planned.path(TAKE, camera)).is_file():
            rehearsal.rehearse_recording(SETTINGS, TAKE, camera, folder)
            pictures += len(clock.kept_frames)
    if not (folder / rehearsal.DESCRIPTION).is_file():
        rehearsal.rehearse_truth(SETTINGS, TAKE, folder)
        rehearsal.rehearse_scan(SETTINGS, folder)
        rehearsal.write_description(SETTINGS, folder)
    return {"pictures": pictures}


def reconstruct(folder: Path) -> dict:
    """Photographs to points: the measured frames at full size, then the others at half size."""
    shoot = Shoot(folder)
    clouds, took = {}, []
    with shoot.open() as take:
        reduced_cloud(shoot, take, 0, 0.25)  # compiles
        for number in MEASURED:
            clouds[number], parts = measured_cloud(shoot, take, number)
            took.append(parts)
        memory = peak_memory_gib()
        for number in set(range(TRACKED + 1)) - set(MEASURED):
            clouds[number] = reduced_cloud(shoot, take, number, 0.5)
    for number, cloud in clouds.items():
        cloud.save(cloud_file(folder / "clouds", number))
    truth = shoot.truth.take(TAKE)
    errors = [compare_cloud(clouds[n].positions, truth.at(shoot.times_s[n]), shoot.truth.triangles, shoot.rig) for n in MEASURED]
    mean = {name: {key: float(np.mean([parts[name][key] for parts in took])) for key in TIMES} for name in took[0]}
    return {
        **{key: sum(part[key] for part in mean.values()) for key in TIMES},
        "cpu_seconds_of": {name: part["cpu_seconds"] for name, part in mean.items()},
        "peak_memory_gib": memory,
        "points": [len(clouds[number]) for number in MEASURED],
        "errors": _named(summarise_clouds(errors)),
    }


def start(folder: Path) -> dict:
    """Scan and first frame to the template the tracker starts from."""
    shoot = Shoot(folder)
    registered = register_scan(base_head(), load_scan(folder / "scan/neutral.ply", "mm"))
    cloud = PointCloud.load(cloud_file(folder / "clouds", 0))
    placed = registered.template.transformed(place_template(registered.template, cloud))
    with shoot.open() as take:
        images = take.images_at(shoot.times_s[0])
    prepared = prepare_start(placed, shoot.rig, [images.get(name) for name in shoot.rig.names], cloud, TrackSettings())
    prepared.save(folder / "start.npz")
    return {"vertices": len(prepared.vertices), "register_error_median_mm": registered.figures["register.error_median_mm"]}


def track(folder: Path) -> dict:
    """Coarse and fine pass; a job's set-up, paid once for hundreds of frames, falls out of the difference of two runs."""
    shoot, template, settings = Shoot(folder), Template.load(folder / "start.npz"), TrackSettings()
    files = [(number, time_s, cloud_file(folder / "clouds", number)) for number, time_s in enumerate(shoot.times_s.tolist())]
    clouds, made = CloudSequence.of(TAKE, files), {}

    def coarse(count: int) -> None:
        with shoot.open() as take:
            made["anchors"] = track_anchors(template, shoot.rig, take, clouds.at, shoot.times_s[: count + 1], settings)

    def fine(count: int) -> None:
        with shoot.open() as take:
            made["positions"] = track_chunk(template, made["anchors"], shoot.rig, take, clouds.at, 0, count, settings)[0]

    passes = {"coarse": _per_frame(coarse), "fine": _per_frame(fine)}
    memory = peak_memory_gib()
    save_chunk(folder / "chunk_000.npy", made["positions"])
    sequence = MeshSequence(TAKE, shoot.times_s, (folder / "chunk_000.npy",))
    errors = compare_sequence(sequence, template, shoot.truth, rig=shoot.rig, truth_world_from_world=np.eye(4), clock_shift_s=0.0)
    moved_mm = 1e3 * np.linalg.norm(made["positions"][-1] - made["positions"][0], axis=1)
    return {
        **{key: sum(part[key] for part in passes.values()) for key in TIMES},
        "cpu_seconds_of": {name: part["cpu_seconds"] for name, part in passes.items()},
        "peak_memory_gib": memory,
        "keyframes": len(made["anchors"].keyframes),
        "moved_p95_mm": float(np.percentile(moved_mm, 95)),
        "errors": _named(errors.figures()),
    }


PARTS: dict[str, Callable[[Path], dict]] = {"render": render, "reconstruct": reconstruct, "start": start, "track": track}


class Shoot:
    """The rehearsed take, its cameras and clocks as the truth states them."""

    def __init__(self, folder: Path) -> None:
        self.truth = Truth(folder / "truth")
        self.rig: Rig = self.truth.rig
        names, starts, drifts = self.rig.names, self.truth.start_s(TAKE), self.truth.drift_ppm(TAKE)
        recordings = tuple(probe(folder / rehearsal.plan(SETTINGS).path(TAKE, name), name) for name in names)
        self.ingested = IngestedTake(TAKE, SETTINGS.takes[0].kind, recordings)
        stated = ([starts[name] for name in names], [drifts[name] for name in names])
        self.offsets = TimeOffsets(TAKE, names, *map(tuple, stated), (1.0,) * len(names), ("manual",) * len(names))
        with self.open() as take:
            times_s = take.timeline().time_s
        first = int(np.argmin(np.abs(times_s - (max(starts.values()) + REST / RATE))))
        self.times_s = times_s[first : first + TRACKED + 1]

    def open(self) -> TakeFrames:
        """Frames on the common clock."""
        return open_take(self.ingested, self.offsets)


def measured_cloud(shoot: Shoot, take: TakeFrames, number: int) -> tuple[PointCloud, dict[str, dict[str, float]]]:
    """Points of one frame at full size, and what its parts took."""
    time_s, images, found = shoot.times_s[number], {}, []
    bring = measure(lambda: images.update(take.images_at(time_s)))
    rig, photographs = shoot.rig.only(images), list(images.values())
    estimate = measure(lambda: found.append(reconstruct_frame(rig, photographs, time_s=time_s, settings=RECONSTRUCT)))
    return found[0], {"images at one moment": bring, "depth and fusion": estimate}


def reduced_cloud(shoot: Shoot, take: TakeFrames, number: int, scale: float) -> PointCloud:
    """Points of one frame from reduced photographs."""
    images = take.images_at(shoot.times_s[number])
    rig = Rig(tuple(camera.scaled(scale) for camera in shoot.rig.only(images)))
    reduced = [
        cv2.resize(image, camera.size, interpolation=cv2.INTER_AREA) for image, camera in zip(images.values(), rig, strict=True)
    ]
    return reconstruct_frame(rig, reduced, time_s=shoot.times_s[number], settings=RECONSTRUCT)


def _per_frame(work: Callable[[int], None]) -> dict[str, float]:
    """Seconds per frame of a pass; the first of the short runs compiles."""
    short, long = measure(lambda: work(1), repeats=2), measure(lambda: work(TRACKED))
    return {key: (long[key] - short[key]) / (TRACKED - 1) for key in short}


def _named(figures: dict[str, float]) -> dict[str, float]:
    return {name.split(".", 1)[1]: value for name, value in figures.items()}


def _in_own_process(name: str, folder: Path) -> dict:
    folder.mkdir(parents=True, exist_ok=True)
    subprocess.run([sys.executable, __file__, name, str(folder)], check=True)
    return json.loads((folder / f"{name}.json").read_text())


def _part(name: str, folder: Path) -> None:
    cv2.setNumThreads(1)
    begun = time.process_time()
    found = PARTS[name](folder)
    whole = {"whole_cpu_seconds": time.process_time() - begun, "peak_memory_gib": peak_memory_gib()}
    (folder / f"{name}.json").write_text(json.dumps(whole | found))


if __name__ == "__main__":
    _part(sys.argv[1], Path(sys.argv[2]))
