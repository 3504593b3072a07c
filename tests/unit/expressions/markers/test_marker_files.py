"""Marker files of every kind give the same take: labels, units, times, gaps; what is damaged is refused by name and line."""

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.expressions.markers import read_markers

NAMES = ("brow", "lip", "chin", "cheek")


@pytest.fixture
def positions(rng):
    """(6, 4, 3) metres with gaps; the last marker is labelled in no file."""
    values = 0.1 * rng.normal(size=(6, 4, 3)) + [1, 2, 0.5]
    values[2:4, 1] = np.nan
    values[5, 2] = np.nan
    return values


def write_c3d(path, positions, labels, *, unit="mm", scale=1e3, by_residual=True):
    import ezc3d

    file = ezc3d.c3d()
    file["parameters"]["POINT"]["UNITS"]["value"] = [unit]
    file["parameters"]["POINT"]["RATE"]["value"] = [120.0]
    file["parameters"]["POINT"]["LABELS"]["value"] = tuple(labels)
    points = np.ones((4, len(labels), len(positions)))
    points[:3] = scale * positions.transpose(2, 1, 0)
    if by_residual:
        # a gap as Vicon writes it: a residual of -1 at the origin
        gaps = np.isnan(points[0])
        points[:3, gaps] = 0
        residuals = np.where(gaps, -1.0, 0.2)[None]
        file["data"]["meta_points"]["residuals"] = residuals
        file["data"]["meta_points"]["camera_masks"] = np.zeros((7, *gaps.shape), bool)
    file["data"]["points"] = points
    file["parameters"]["ANALOG"]["RATE"]["value"] = [1200.0]
    file["parameters"]["ANALOG"]["LABELS"]["value"] = ("EMG",)
    file["data"]["analogs"] = np.ones((1, 1, 10 * len(positions)))
    file.write(str(path))


def write_trc(path, positions, *, unit="mm", scale=1e3, frames=None):
    names = NAMES[: positions.shape[1]]
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"120.0\t120.0\t{frames or len(positions)}\t{len(names)}\t{unit}\t120.0\t1\t{len(positions)}",
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\t" + "\t".join(f"X{k}\tY{k}\tZ{k}" for k in range(1, len(names) + 1)),
        "",
    ]
    for frame, row in enumerate(scale * positions):
        cells = ["" if np.isnan(value) else f"{value:.6f}" for value in row.ravel()]
        lines.append("\t".join([str(frame + 1), f"{frame / 120:.9f}", *cells]))
    path.write_text("\n".join(lines) + "\n")


def cells(values):
    return ",".join("" if np.isnan(value) else f"{value:.9f}" for value in values.ravel())


def write_csv(path, positions, header="time_s"):
    columns = ",".join(f"{name}_{axis}" for name in NAMES[: positions.shape[1]] for axis in "xyz")
    rows = [f"{frame if header == 'frame' else frame / 120},{cells(row)}" for frame, row in enumerate(positions)]
    path.write_text("\n".join([f"{header},{columns}", *rows]) + "\n")


def write_nexus(path, positions):
    names = [f"Ann:{name}" for name in NAMES[:-1]] + ["*12"]
    lines = ["Devices", "1200", "Frame,Sub Frame,Fx", ",,N", "1,0,3.5", "", "Trajectories", "120"]
    lines += [",," + ",,,".join(names) + ",,", "Frame,Sub Frame" + ",X,Y,Z" * len(names), ",," + ",".join(["mm"] * 12)]
    lines += [f"{frame + 5},0,{cells(1e3 * row)}" for frame, row in enumerate(positions)]
    path.write_text("\n".join([*lines, "", "Model Outputs"]) + "\n")


def check(take, positions, atol, names=NAMES):
    assert take.names == tuple(names)
    np.testing.assert_allclose(take.positions_m, positions, atol=atol)
    assert take.time_s == pytest.approx(np.arange(len(positions)) / 120, abs=1e-8)


@pytest.mark.parametrize("by_residual", [True, False])
def test_c3d_gives_labels_units_and_gaps_and_leaves_unnamed_points_out_with_a_note(positions, tmp_path, by_residual):
    write_c3d(tmp_path / "a.c3d", positions, ["Ann:brow", "Ann:lip", "Ann:chin", "*17"], by_residual=by_residual)
    take = read_markers(tmp_path / "a.c3d")
    # single precision of millimetres in metres
    check(take, positions[:, :3], 3e-7, NAMES[:3])
    assert take.notes == ("1 points without a label left out",)


def test_trc_gives_the_same_with_blanks_as_gaps(positions, tmp_path):
    write_trc(tmp_path / "a.trc", positions)
    check(read_markers(tmp_path / "a.trc"), positions, 1e-9)
    write_trc(tmp_path / "a.trc", positions, unit="m", scale=1.0)
    check(read_markers(tmp_path / "a.trc"), positions, 1e-6)


def test_both_forms_of_csv_give_the_same(positions, tmp_path):
    write_csv(tmp_path / "a.csv", positions)
    check(read_markers(tmp_path / "a.csv", unit="m"), positions, 1e-9)
    write_csv(tmp_path / "a.csv", 100 * positions, "frame")
    check(read_markers(tmp_path / "a.csv", unit="cm", rate_hz=120), positions, 1e-9)
    write_nexus(tmp_path / "a.csv", positions)
    take = read_markers(tmp_path / "a.csv")
    check(take, positions[:, :3], 1e-9, NAMES[:3])
    assert take.notes == ("1 points without a label left out",)


def test_what_csv_does_not_say_must_be_named(positions, tmp_path):
    write_csv(tmp_path / "a.csv", positions)
    with pytest.raises(InputError, match=r"a\.csv does not say its unit"):
        read_markers(tmp_path / "a.csv")
    with pytest.raises(InputError, match=r"spread over 0\.000"):
        read_markers(tmp_path / "a.csv", unit="mm")
    write_csv(tmp_path / "a.csv", positions, "frame")
    with pytest.raises(InputError, match="counts frames"):
        read_markers(tmp_path / "a.csv", unit="m")


def test_damaged_files_are_refused_with_line_and_reason(positions, tmp_path):
    write_trc(tmp_path / "a.trc", positions, frames=9)
    with pytest.raises(InputError, match="has 6 frames and says NumFrames 9"):
        read_markers(tmp_path / "a.trc")
    write_trc(tmp_path / "a.trc", positions)
    (tmp_path / "b.trc").write_text((tmp_path / "a.trc").read_text().replace("\tchin\t", "\t\t"))
    with pytest.raises(InputError, match="names 3 markers and says NumMarkers 4"):
        read_markers(tmp_path / "b.trc")
    write_csv(tmp_path / "a.csv", positions)
    text = (tmp_path / "a.csv").read_text().splitlines()
    (tmp_path / "a.csv").write_text("\n".join([*text[:3], "x" + text[3], *text[4:]]))
    with pytest.raises(InputError, match="line 4 is no row of numbers"):
        read_markers(tmp_path / "a.csv", unit="m")
    (tmp_path / "a.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="begins with the columns a, b"):
        read_markers(tmp_path / "a.csv", unit="m")
    (tmp_path / "a.c3d").write_bytes(b"nothing")
    (tmp_path / "b.trc").write_text("nothing\n")
    for name in ("a.c3d", "b.trc", "c.csv", "d.xlsx"):
        with pytest.raises(InputError, match=name):
            read_markers(tmp_path / name)


def test_a_label_given_twice_is_refused(positions, tmp_path):
    write_c3d(tmp_path / "a.c3d", positions, ["brow", "lip", "brow", "chin"])
    with pytest.raises(InputError, match="label brow more than once"):
        read_markers(tmp_path / "a.c3d")
