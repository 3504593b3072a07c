"""A small session as a report sees it: a ball before four cameras, its photographs, points, mesh and errors."""

from dataclasses import replace

import numpy as np
import pytest

from headcap.artifacts import Manifest
from headcap.calibration.detection import CameraDetections
from headcap.calibration.result import CalibrationResult, CameraFigures
from headcap.cameras import Camera, Rig
from headcap.evaluation.metrics import make_figure
from headcap.evaluation.settings import EvaluateSettings
from headcap.evaluation.tracking import TrackingErrors
from headcap.geometry.transforms import rigid
from headcap.reconstruction.points import PointCloud
from headcap.registration.residuals import TrackResiduals
from headcap.registration.template import Template
from headcap.report.inputs import (
    BoardPicture,
    CalibrationReport,
    CloudGaps,
    FrameView,
    RegisterReport,
    ReportInputs,
    TakeReport,
)
from headcap.sync.offsets import TimeOffsets


def ball(radius_m: float = 0.1, rows: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """A ball about the origin: vertices (n, 3), triangles counter-clockwise seen from outside."""
    polar, around = np.meshgrid(np.linspace(0.02, np.pi - 0.02, rows), np.linspace(0, 2 * np.pi, 2 * rows, endpoint=False))
    x, y, z = np.sin(polar) * np.sin(around), np.cos(polar), np.sin(polar) * np.cos(around)
    index = np.arange(polar.size).reshape(polar.shape)
    a, b = index[:, :-1].ravel(), index[:, 1:].ravel()
    c, d = np.roll(index, -1, 0)[:, 1:].ravel(), np.roll(index, -1, 0)[:, :-1].ravel()
    vertices = radius_m * np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    return vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)


def camera_at(name: str, azimuth_deg: float) -> Camera:
    angle = np.radians(azimuth_deg)
    centre = 0.8 * np.array([np.sin(angle), 0.0, np.cos(angle)])
    rotation = np.stack([[np.cos(angle), 0, -np.sin(angle)], [0, -1, 0], -centre / 0.8])
    matrix = np.array([[500.0, 0, 79.5], [0, 500, 99.5], [0, 0, 1]])
    return Camera(name, 160, 200, matrix, np.zeros(5), rigid(rotation, -rotation @ centre))


@pytest.fixture(scope="module")
def rig() -> Rig:
    return Rig(tuple(camera_at(f"cam{i:02d}", azimuth) for i, azimuth in enumerate((-50, -5, 30, 70))))


@pytest.fixture(scope="module")
def template() -> Template:
    vertices, triangles = ball()
    uv = np.stack([np.arctan2(vertices[:, 0], vertices[:, 2]) / 7 + 0.5, 0.5 - 4 * vertices[:, 1]], axis=1)
    regions = {
        "lips_upper": (np.abs(vertices[:, 0]) < 0.03) & (np.abs(vertices[:, 1] + 0.02) < 0.015) & (vertices[:, 2] > 0),
        "lips_lower": (np.abs(vertices[:, 0]) < 0.03) & (np.abs(vertices[:, 1] + 0.05) < 0.015) & (vertices[:, 2] > 0),
    }
    texture = np.full((32, 32, 3), 120, np.uint8)
    return Template(vertices, triangles, uv, triangles, regions, {}, texture, np.ones((32, 32), bool))


@pytest.fixture(scope="module")
def inputs(rig: Rig, template: Template) -> ReportInputs:
    """A session with everything in it."""
    rng, names, count = np.random.default_rng(20130), rig.names, len(rig)
    positions = np.stack([template.vertices + 0.001 * t for t in range(4)]).astype(np.float32)
    points = positions[1] * 1.002
    cloud = PointCloud(points, points / 0.1, np.ones(len(points), np.float32), np.full((len(points), 3), 180, np.uint8), 0.1)
    error = rng.uniform(0, 0.4, len(points)).astype(np.float32)
    photograph = rng.integers(60, 90, (200, 160, 3), np.uint8)
    errors = TrackingErrors(
        take="smile",
        frames=np.arange(4),
        time_s=0.1 * np.arange(4),
        surface_mm=np.tile(error, (4, 1)),
        drift_mm=np.tile(2 * error, (4, 1)),
        seen=rng.random((4, len(points))) < 0.8,
        lip_gap_mm=np.array([1.0, 3, 5, 2]),
        true_lip_gap_mm=np.array([1.1, 3.2, 4.8, 2.0]),
    )
    take = TakeReport(
        take="smile",
        kind="expression",
        frames=4,
        offsets=TimeOffsets("smile", names, (0.0, 0.01, 0.02, 0.03), (0.0,) * count, (0.9,) * count, ("clap",) * count),
        true_start_s=dict(zip(names, (0.0, 0.0101, 0.02, 0.03), strict=True)),
        views=tuple(FrameView(1, 0.1, rig[name], photograph, positions[1], cloud, error) for name in names[1:3]),
        gaps=CloudGaps(np.arange(4), np.full(4, 0.1), np.full(4, 0.4)),
        errors=errors,
        neutral=positions[0],
        residuals=TrackResiduals.of(
            "smile", range(4), {"surface_flow_residual": [0.2, 0.3, 0.25, 0.2], "last_step_mm": [0.1] * 4}
        ),
        sync_figure=np.full((60, 90, 3), 200, np.uint8),
    )
    corners = rng.uniform(20, 140, (12, 2))
    detections = tuple(
        CameraDetections(
            name, 160, 200, 9, np.array([3]), np.array([0.05]), np.array([0, 12]), np.arange(12), corners, np.zeros((12, 2))
        )
        for name in names
    )
    result = CalibrationResult(rig, tuple(CameraFigures(n, 0.1, 0.3, 0.6, 9, 99, 0) for n in names), 0.1, 0.3, 0.05, 3, ())
    settings = EvaluateSettings()
    figures = [
        ("calibrate.heldout_rms_px", 0.1, None),
        ("track.drift_median_mm", 0.14, "smile"),
        ("track.drift_p95_mm", 0.9, "smile"),
    ]
    return ReportInputs(
        session="study_one",
        subject="<nobody>",
        rate_hz=60.0,
        figures=tuple(make_figure(n, v, session="study_one", take=t, settings=settings) for n, v, t in figures),
        calibration=CalibrationReport(result, detections, (BoardPicture("cam01", 3, photograph, corners, corners + 0.1),)),
        register=RegisterReport(template, template.vertices, template.triangles, error.astype(float)),
        takes=(take,),
        rehearsed=True,
        manifests=(
            ("calibrate/rig.json", Manifest("rig.json", "rig", "calibrate", "ab" * 32, "cd" * 32, {}, {}, "0.1", "ef" * 20)),
        ),
        versions={"headcap": "0.1", "numpy": "2"},
        settings={"track": {"steps": 5}},
    )


@pytest.fixture
def bare(inputs: ReportInputs) -> ReportInputs:
    """The same session of which nothing but figures is left."""
    return replace(inputs, calibration=None, register=None, takes=(), manifests=(), settings={}, rehearsed=False)
