"""Lip tattoos painted over: laws of each step, and a rehearsed person photographed with and without the tattoo."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from headcap.cameras import Camera, Rig
from headcap.errors import InputError
from headcap.heads.procedural import base_head
from headcap.lips.clips import rig_clip
from headcap.lips.inpainting import (
    InpaintingSettings,
    LipPainter,
    LipRegion,
    LipTexture,
    MeshMotion,
    TrackedTake,
    bare_lips,
    inpaint_take,
    inpainting_figure,
    lip_texture,
    most_alike,
    most_unlike,
    slightly_open,
)
from headcap.lips.inpainting.painter import _Smoother, composite
from headcap.lips.inpainting.texture import fill
from headcap.lips.inpainting.views import view_texels
from headcap.meshes.rasteriser import rasterise
from headcap.recordings.probe import probe
from headcap.recordings.takes import IngestedTake
from headcap.recordings.video import VideoFrames
from headcap.recordings.writer import write_video
from headcap.registration.sequence import MeshSequence, save_chunk
from headcap.registration.template import Template
from headcap.sync.offsets import TimeOffsets
from headcap.sync.timeline import TakeTimeline
from headcap.synthetic.lighting import Lights
from headcap.synthetic.mesh_pictures import look_of
from headcap.synthetic.mesh_takes import mesh_subject
from headcap.synthetic.rig import looking_at
from headcap.synthetic.sensor import encode
from headcap.synthetic.settings import DEFAULT_LIGHTS, SensorSettings
from headcap.synthetic.studio import Sitter, Studio
from headcap.synthetic.subject import AT_REST

SETTINGS = InpaintingSettings(texel_mm=0.5)
OPEN = AT_REST | {"jaw": 0.12}


def _camera(name, azimuth_deg):
    azimuth, target = np.radians(azimuth_deg), np.array([0, -0.07, 0.09])
    centre = target + 0.7 * np.array([np.sin(azimuth), 0.05, np.cos(azimuth)])
    matrix = np.array([[850.0, 0, 119.5], [0, 850.0, 119.5], [0, 0, 1]])
    return Camera(name, 240, 240, matrix, np.zeros(5), looking_at(centre, target, np.zeros(3)))


@dataclass(frozen=True)
class Scene:
    """A person, three cameras, and pictures without noise."""

    person: object
    rig: Rig
    looks: dict
    studio: Studio

    def mesh(self, **channels):
        return self.person.mesh(OPEN | channels)

    def picture(self, camera, tattoo, **channels):
        """BGR uint8."""
        look, state = self.looks[tattoo], OPEN | channels
        posed = look.pose(self.person.mesh(state), state)
        sitter = Sitter(lambda _: posed, look.openness, look.surface.triangles, look.grain)
        return np.ascontiguousarray(encode(self.studio.photograph(self.rig[camera], sitter, 0.0))[..., ::-1])

    def bare(self):
        """Each camera's picture of the untattooed moment."""
        return [self.picture(camera, False) for camera in self.rig.names]


@pytest.fixture(scope="module")
def scene():
    person = mesh_subject(6)
    rig = Rig((_camera("left", 35), _camera("front", 0), _camera("right", -35)))
    looks = {on: look_of(person, tattoos=False, lip_tattoo=on) for on in (False, True)}
    return Scene(person, rig, looks, Studio.of((240, 240), SensorSettings(), Lights.from_settings(DEFAULT_LIGHTS, 0.28, 0.03)))


@pytest.fixture(scope="module")
def template(scene):
    return base_head().with_vertices(scene.person.neutral_m)


@pytest.fixture(scope="module")
def texture(scene, template):
    return lip_texture(template, scene.mesh(), scene.rig, scene.bare(), "front", SETTINGS)


@pytest.fixture(scope="module")
def painter(scene, texture):
    return LipPainter(texture, scene.rig["front"], scene.mesh(), scene.picture("front", True))


def _covered(region, camera, mesh):
    """Pixels that the region may touch: some part of them, by a finer raster."""
    raster = rasterise(camera.scaled(5), mesh, region.triangles)
    inside = raster.hit & np.isin(raster.triangle, region.chosen)
    return inside.reshape(camera.height, 5, camera.width, 5).any(axis=(1, 3))


def test_the_region_is_the_lips_and_the_skin_about_them_but_not_the_mouth(texture):
    region, masks = texture.region, base_head().regions
    lips = masks["lips_upper"] | masks["lips_lower"]
    assert (region.weight[lips] == 1).all()
    assert not region.weight[masks["mouth_interior"] | masks["eyes"] | masks["ears"]].any()
    # every texel lies in its triangle, and the charts do not overlap: each texel is one place
    assert len(np.unique(region.texel, axis=0)) == len(region.texel)
    np.testing.assert_allclose(region.texel_barycentric.sum(axis=1), 1, atol=1e-6)
    placed = np.einsum("tc,tck->tk", region.texel_barycentric, region.atlas[region.atlas_triangles[region.texel_triangle]])
    np.testing.assert_allclose(placed[:, ::-1], region.texel, atol=1e-4)


def test_texels_are_as_large_as_asked_for(texture, template):
    corners = template.vertices[texture.region.triangles[texture.region.chosen]]
    area_mm2 = 0.5e6 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    # charts are near-isometric, another person's skin is a little larger or smaller
    assert area_mm2 / len(texture.region.texel) == pytest.approx(SETTINGS.texel_mm**2, rel=0.25)


def test_a_picture_of_the_untattooed_moment_comes_back(scene, template):
    """One camera's texture, rendered where it came from, is its picture, but for what two bilinear look-ups blur."""
    camera, mesh, picture = scene.rig["front"], scene.mesh(), scene.picture("front", False)
    alone = lip_texture(template, mesh, scene.rig, [None, picture, None], "front", InpaintingSettings(texel_mm=0.25))
    painted = LipPainter(alone, camera, mesh, picture).paint(mesh, picture)
    # rims of mouth and nostrils, where a pixel mixes two surfaces, no camera tells; they are filled in from beside
    told = np.repeat(255.0 * alone.known[..., None], 3, axis=2)
    told = (composite(alone.region, camera, mesh, np.full_like(picture, 255), told, 3) == 255).all(axis=2)
    told &= _covered(alone.region, camera, mesh)
    assert told.sum() > 7000
    away = painted.astype(float) - picture
    # a bilinear look-up errs by an eighth of the second difference at most, and there are two; a byte's rounding
    second = np.abs(np.diff(picture.astype(float), 2, axis=1)).max(axis=2)[told[:, 1:-1]]
    assert np.sqrt((away[told] ** 2).mean()) < 0.25 * np.sqrt((second**2).mean()) + 0.3
    assert not np.median(away[told], axis=0).any()


def test_pixels_outside_the_region_are_untouched(scene, painter):
    for channels in ({}, {"jaw": 0.6}, {"upper_roll": 1.0, "lower_roll": 1.0}, {"turn_y": 0.3}):
        mesh, picture = scene.mesh(**channels), scene.picture("front", True, **channels)
        painted = painter.paint(mesh, picture)
        changed = (painted != picture).any(axis=2)
        assert changed.sum() > 1000
        assert not (changed & ~_covered(painter.texture.region, scene.rig["front"], mesh)).any()


def _grey_levels(scene, painter, channels):
    """Of the pixels that the tattoo changes: rms error with tattoo, painted; share of the tattoo that is left."""
    mesh = scene.mesh(**channels)
    tattooed, bare = (scene.picture("front", on, **channels).astype(float) for on in (True, False))
    painted = painter.paint(mesh, tattooed.astype(np.uint8)).astype(float)
    ink = np.abs(tattooed - bare).max(axis=2) > 14
    pattern, left = (tattooed - bare)[ink], (painted - bare)[ink]
    spread = pattern - pattern.mean(axis=0)
    return np.sqrt((pattern**2).mean()), np.sqrt((left**2).mean()), (spread * left).sum() / (spread**2).sum()


POSES = (
    {"jaw": 0.5}, {"smile_left": 1.0, "smile_right": 1.0}, {"rounding": 1.0}, {"upper_roll": 1.0, "lower_roll": 1.0},
    {"turn_y": 0.25},
)  # fmt: skip


def test_the_tattoo_is_gone_and_equalisation_brings_the_shading_nearer(scene, texture, painter):
    plain = LipPainter(
        replace(texture, settings=SETTINGS.model_copy(update={"equalise": False})),
        scene.rig["front"], scene.mesh(), scene.picture("front", True),
    )  # fmt: skip
    found = np.array([[_grey_levels(scene, p, pose) for p in (plain, painter)] for pose in POSES])
    tattooed, (unequal, equal), left = found[:, 0, 0].mean(), found[:, :, 1].mean(axis=0), found[:, 1, 2]
    # measured: 37 grey levels tattooed, 6.5 painted, 4.3 shaded as the frame; a percent of the pattern is left
    assert equal < 0.8 * unequal < 0.25 * tattooed
    assert np.abs(left).max() < 0.05


def test_equalisation_at_the_reference_pose_changes_nothing(scene, texture, painter):
    shaded = painter.shaded(scene.mesh(), scene.picture("front", True))
    on_skin = tuple(texture.region.texel.T)
    np.testing.assert_allclose(shaded[on_skin], texture.colours[on_skin], atol=1e-4)


def _plane(size_mm=120.0, cells=80):
    """A flat sheet with lips in its middle and itself for texture coordinates."""
    axis = np.linspace(-0.5, 0.5, cells + 1) * 1e-3 * size_mm
    x, y = (grid.ravel() for grid in np.meshgrid(axis, axis))
    index = np.arange(len(x)).reshape(cells + 1, cells + 1)
    a, b, c, d = index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel()
    triangles = np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)]).astype(np.int32)
    middle = (np.abs(x) < 0.02) & (np.abs(y) < 0.005)
    regions = {"lips_upper": middle & (y >= 0), "lips_lower": middle & (y < 0)}
    uv = 0.5 + np.stack([x, -y], axis=1) / 0.2
    return Template(np.stack([x, y, 0 * x], axis=1), triangles, uv, triangles, regions)


@pytest.mark.parametrize("wavelength_mm", [40.0, 20.0, 12.0, 8.0])
def test_smoothing_keeps_of_a_wave_what_the_settings_say(wavelength_mm):
    sheet, smoothing_mm = _plane(), 2.0
    region = LipRegion.of(sheet, SETTINGS)
    smooth = _Smoother(region, sheet.vertices, SETTINGS.texel_mm, smoothing_mm)
    everywhere, x_mm = np.ones(len(region.texel)), 1e3 * region.at_texels(sheet.vertices)[:, :1]
    np.testing.assert_allclose(smooth(np.full((len(everywhere), 1), 7.0), everywhere), 7.0, rtol=1e-4)
    k = 2 * np.pi / wavelength_mm
    wave, inner = np.cos(k * x_mm), region.at_texels(region.weight[:, None])[:, 0] > 0.99
    kept = (smooth(wave, everywhere) * wave)[inner].sum() / (wave[inner] ** 2).sum()
    # vertices 1.5 mm apart: their Laplacian falls short of k^2 by (1.5 k)^2 / 12, a tenth at the shortest wave
    assert kept == pytest.approx(1 / (1 + (smoothing_mm * k) ** 4), abs=0.03)


def test_what_nobody_sees_is_filled_from_beside_and_what_is_seen_stays(rng):
    values, known = rng.uniform(20, 30, (40, 60, 3)), rng.random((40, 60)) < 0.7
    known[:, 30:45] = False
    filled = fill(values, known)
    np.testing.assert_allclose(filled[known], values[known], rtol=1e-6)
    assert (filled > 19.9).all()
    assert (filled < 30.1).all()


def test_cameras_of_other_exposure_make_no_difference(scene, template, texture):
    """The painted camera's own gain is kept, whatever the others'."""
    pictures = scene.bare()
    for k, gain in ((0, 0.8), (2, 1.15)):
        pictures[k] = np.clip(np.rint(gain * pictures[k].astype(float)), 0, 255).astype(np.uint8)
    other = lip_texture(template, scene.mesh(), scene.rig, pictures, "front", SETTINGS)
    both = texture.known & other.known
    assert np.abs(other.colours - texture.colours)[both].mean() < 0.5


def test_hidden_texels_are_not_seen(scene, texture):
    """From the side the far half of the face is hidden: none of its texels may be taken for seen, near ones are."""
    mesh = scene.mesh()
    view = view_texels(texture.region, _camera("side", 80), mesh, scene.picture("front", False))
    x = texture.region.at_texels(mesh)[:, 0]
    assert (view.weight[x < -0.012] > 0).mean() < 0.01
    assert (view.weight[x > 0.03] > 0).mean() > 0.9


def test_the_reference_pose_is_the_most_alike_wherever_the_head_is(scene, texture):
    meshes = [scene.mesh(jaw=0.9), scene.mesh(rounding=1.0), scene.mesh() + np.array([0.1, 0.0, 0.02]), scene.mesh(turn_y=0.3)]
    number, away_m = most_alike(meshes, scene.mesh(), texture.region)
    assert (number, away_m) == (2, pytest.approx(0, abs=1e-9))
    with pytest.raises(InputError, match="without frames"):
        most_alike([], scene.mesh(), texture.region)


def test_the_untattooed_moment_has_the_mouth_a_little_open(scene, template, texture):
    closed, little, wide = (scene.person.mesh(AT_REST | {"jaw": jaw}) for jaw in (0.0, 0.12, 0.8))
    round_open = scene.mesh(rounding=1.0)
    number, gap_mm = slightly_open([closed, wide, little, round_open], template, texture.region)
    assert number == 2
    assert 1.5 < gap_mm < 6
    assert slightly_open([closed, closed], template, texture.region)[1] < 1.5
    with pytest.raises(InputError, match="without frames"):
        slightly_open([], template, texture.region)


def test_a_texture_is_saved_whole(scene, texture, tmp_path):
    texture.save(tmp_path / "lips.npz")
    again = LipTexture.load(tmp_path / "lips.npz")
    assert again.settings == texture.settings
    tattooed, mesh = scene.picture("front", True), scene.mesh(jaw=0.4)
    painted = [LipPainter(t, scene.rig["front"], scene.mesh(), tattooed).paint(mesh, tattooed) for t in (texture, again)]
    np.testing.assert_array_equal(*painted)


def test_the_figure_shows_four_panels(scene, painter):
    figure = inpainting_figure(painter, scene.mesh(jaw=0.5), scene.picture("front", True, jaw=0.5), height_px=120)
    assert figure.shape[0] == 120
    assert figure.shape[1] > 4 * 100
    gaps = (figure == 255).all(axis=(0, 2))
    assert (np.diff(np.flatnonzero(gaps)) > 20).sum() >= 2


def test_bad_input_is_told(scene, template):
    mesh, pictures = scene.mesh(), scene.bare()
    with pytest.raises(InputError, match="has no picture"):
        lip_texture(template, mesh, scene.rig, [pictures[0], None, pictures[2]], "front", SETTINGS)
    with pytest.raises(InputError, match="does not see the mouth"):
        lip_texture(template, mesh + np.array([5.0, 0, 0]), scene.rig, pictures, "front", SETTINGS)
    bald = replace(template, regions={name: mask for name, mask in template.regions.items() if "lips" not in name})
    with pytest.raises(InputError, match="lips_upper and lips_lower"):
        LipRegion.of(bald, SETTINGS)
    flat = replace(template, uv=np.zeros((1, 2)), uv_triangles=np.zeros_like(template.uv_triangles))
    with pytest.raises(InputError, match="texture coordinates"):
        LipRegion.of(flat, SETTINGS)
    with pytest.raises(ValueError, match="odd"):
        InpaintingSettings(supersampling=2)


RATE_HZ, START_S = 25.0, {"left": 0.02, "front": 0.093, "right": 0.1}
"""The front camera fires between the moments at which the head is tracked, and has frames before and behind them."""


def _jaw(time_s):
    return 0.3 + 0.25 * np.sin(9 * (time_s - 0.2))


def _offsets(cameras, name):
    starts = tuple(START_S[camera] for camera in cameras)
    return TimeOffsets(name, tuple(cameras), starts, (0.0,) * len(starts), (1.0,) * len(starts), ("manual",) * len(starts))


def _recorded(scene, folder, name, cameras, slots, tattoo):
    """Recordings of a jaw that moves, with their start times."""
    recordings = []
    for camera in cameras:
        moments = [(slot, START_S[camera] + slot / RATE_HZ) for slot in slots]
        frames = ((slot, scene.picture(camera, tattoo, jaw=_jaw(moment))[..., ::-1]) for slot, moment in moments)
        write_video(folder / f"{name}_{camera}.mp4", frames, (240, 240), RATE_HZ, crf=8)
        recordings.append(probe(folder / f"{name}_{camera}.mp4", camera))
    return IngestedTake(name, "lips", tuple(recordings)), _offsets(cameras, name)


def _tracked(scene, folder, name, time_s):
    save_chunk(folder / f"{name}.npy", np.stack([scene.mesh(jaw=_jaw(moment)) for moment in time_s]))
    return MeshSequence(name, np.asarray(time_s), (folder / f"{name}.npy",))


MOMENTS_S = START_S["right"] + np.arange(1, 6) / RATE_HZ


@pytest.fixture(scope="module")
def takes(scene, tmp_path_factory):
    """A bare take of all cameras and a tattooed one, of which the front camera lost a frame."""
    folder = tmp_path_factory.mktemp("takes")
    bare = TrackedTake(*_recorded(scene, folder, "bare", scene.rig.names, range(3), False), None)
    tattooed = TrackedTake(*_recorded(scene, folder, "lips", ("front",), (0, 1, 2, 3, 5, 6, 7), True), None)
    return (
        replace(bare, sequence=_tracked(scene, folder, "bare", START_S["right"] + np.arange(2) / RATE_HZ)),
        replace(tattooed, sequence=_tracked(scene, folder, "lips", MOMENTS_S)),
    )


@pytest.fixture(scope="module")
def painted(scene, template, takes, tmp_path_factory):
    """The tattooed take with bare lips, and its figures."""
    folder = tmp_path_factory.mktemp("painted")
    bare = bare_lips(template, scene.rig, takes[0], "front", SETTINGS)
    return inpaint_take(bare.texture, scene.rig["front"], takes[1], folder / "lips.mp4", folder / "lips.png")


def test_a_painted_recording_keeps_the_frames_of_the_tracked_time_and_their_times(painted, takes):
    recorded, figures = painted
    (recording,), raw = recorded.recordings, takes[1].recorded["front"]
    # slot 1 comes 7 ms before the head is tracked, slot 4 is lost, slot 6 comes after it
    assert recording.rotation_deg == 0
    assert recording.frame_times_s == tuple(raw.frame_times_s[k] for k in (2, 3, 4))
    assert figures["lips.inpainted_frames"] == 3
    again = probe(recording.path, "front")
    np.testing.assert_allclose(again.frame_times_s, recording.frame_times_s, atol=0.5 / 512 / RATE_HZ)
    assert (again.width, again.height) == (raw.width, raw.height)


def test_a_painted_take_shows_the_bare_lips_of_its_own_moments(scene, painted, takes):
    (recording,), raw = painted[0].recordings, takes[1].recorded["front"]
    with VideoFrames(recording.path) as video, VideoFrames(raw.path) as tattooed:
        for k, (slot, number) in enumerate(((2, 2), (3, 3), (5, 4))):
            bare = scene.picture("front", False, jaw=_jaw(START_S["front"] + slot / RATE_HZ)).astype(float)
            ink = np.abs(tattooed[number] - bare).max(axis=2) > 14
            left, before = (np.sqrt(((picture - bare)[ink] ** 2).mean()) for picture in (video[k], tattooed[number]))
            # as in single frames without a codec
            assert left < 0.2 * before


def test_the_base_tracker_reads_a_painted_take_as_any_other(scene, painted, takes):
    timeline = TakeTimeline("lips", "right", np.arange(1, 6), MOMENTS_S)
    clip = rig_clip(scene.rig["front"], painted[0], takes[1].offsets, timeline)
    # between its first and last frame
    np.testing.assert_array_equal(clip.time_s, MOMENTS_S[1:4])
    assert [picture.shape for picture in clip.pictures()] == [(240, 240, 3)] * 3


def test_meshes_between_frames_follow_a_cubic(tmp_path, rng):
    time_s = np.array([0.0, 0.03, 0.07, 0.1, 0.17])
    terms = rng.normal(size=(4, 6, 3))

    def at(moment):
        return np.tensordot(np.asarray(moment) ** np.arange(4), terms, 1)

    save_chunk(tmp_path / "all.npy", np.stack([at(moment) for moment in time_s]))
    motion = MeshMotion(MeshSequence("take", time_s, (tmp_path / "all.npy",)), 6)
    for moment in (0.0, 0.01, 0.05, 0.1, 0.16, 0.17):
        # what float32 keeps of numbers of about one
        np.testing.assert_allclose(motion.at(moment), at(moment), atol=2e-6)
    save_chunk(tmp_path / "two.npy", np.stack([at(0.0), at(0.1)]))
    two = MeshMotion(MeshSequence("take", np.array([0.0, 0.1]), (tmp_path / "two.npy",)), 6)
    np.testing.assert_allclose(two.at(0.025), 0.75 * at(0.0) + 0.25 * at(0.1), atol=2e-6)


def test_frames_of_the_figure_are_those_that_differ_most(scene, texture):
    states = [{"jaw": 0.12}, {"jaw": 0.9}, {"jaw": 0.13}, {"rounding": 1.0}, {"jaw": 0.88}]
    meshes = [scene.mesh(**state) for state in states]
    assert most_unlike(lambda: iter(meshes), scene.mesh(), texture.region, 2) == [1, 3]
    # no frame is shown twice
    assert most_unlike(lambda: iter(meshes[:1] * 2), meshes[1], texture.region, 3) == [0]


def test_takes_that_cannot_be_painted_are_told(scene, template, texture, takes, tmp_path):
    bare, tattooed = takes
    alone = replace(bare, recorded=IngestedTake("bare", "lips", (bare.recorded["left"],)))
    with pytest.raises(InputError, match="front has no picture of bare"):
        bare_lips(template, scene.rig, alone, "front", SETTINGS)
    late = replace(tattooed, sequence=replace(tattooed.sequence, time_s=tattooed.sequence.time_s + 5))
    with pytest.raises(InputError, match="front has 0 frames of lips while the head was tracked"):
        inpaint_take(texture, scene.rig["front"], late, tmp_path / "out.mp4", tmp_path / "out.png")
    odd = replace(scene.rig["front"], width=239)
    with pytest.raises(InputError, match="239x240"):
        inpaint_take(texture, odd, tattooed, tmp_path / "out.mp4", tmp_path / "out.png")
    assert not list(tmp_path.iterdir())
