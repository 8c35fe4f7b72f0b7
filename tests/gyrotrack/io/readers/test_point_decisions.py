"""Points tracked by other programs, and bodies of exported cases: files whose points, frames and angles are known."""

import math
import pickle
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from gyrotrack import DatasetError, UsageError
from gyrotrack.io.readers import _point_files, _point_tables
from gyrotrack.io.readers._motion_table import ReadOptions
from gyrotrack.io.readers._point_files import listed_names, read_hdf5, read_project
from gyrotrack.io.readers._point_tables import particles_of, read_point_table
from gyrotrack.io.readers._points import MIN_SAMPLES, Points, angle_of, circle_centre
from gyrotrack.io.readers._text_table import content_lines, read_text

PATH = Path("a.csv")


def lines_of(text):
    return content_lines(PATH, text.encode())[0]


def table(text):
    return read_point_table(PATH, lines_of(text))


# ---- angles


def circle(count=60, centre=(5.0, 3.0), radius=2.0, turns=2.2, y_down=False, **options):
    angle = 0.3 + 2 * np.pi * turns * np.arange(count) / count
    sign = -1 if y_down else 1
    place = np.array(centre) + radius * np.stack([np.cos(angle), sign * np.sin(angle)], axis=1)
    return Points(PATH, np.arange(count) / 50, {"p": place}, {}, y_down, False, **options), angle


def wrapped(angle):
    return np.angle(np.exp(1j * angle))


@pytest.mark.parametrize("y_down", [True, False])
@pytest.mark.parametrize("centre", [None, "orbit", "5,3"])
def test_angle_of_a_point_is_counter_clockwise(y_down, centre):
    points, angle = circle(y_down=y_down)
    found = angle_of(points, ReadOptions(centre=centre, start=10.0))
    np.testing.assert_allclose(wrapped(found.angle - angle), 0, atol=1e-9)
    np.testing.assert_allclose(found.time, points.time + 10)
    assert found.used == {"p"}
    assert found.sigma is None
    assert found.doubts == ()


def test_angle_about_another_point():
    points, angle = circle()
    drift = 0.1 * np.arange(60)[:, None] * np.ones(2)
    both = replace(
        points, places={"Hub": np.tile([5.0, 3.0], (60, 1)) + drift, "p": points.places["p"] + drift}
    )
    for options in (ReadOptions(), ReadOptions(centre="Hub"), ReadOptions(centre="Hub", marker="p")):
        found = angle_of(both, options)
        np.testing.assert_allclose(wrapped(found.angle - angle), 0, atol=1e-9)
        assert found.used == {"Hub", "p"}
    three = replace(both, places={**both.places, "q": both.places["p"]})
    with pytest.raises(UsageError, match="--marker"):
        angle_of(three, ReadOptions())
    assert angle_of(three, ReadOptions(body="q")).used == {"Hub", "q"}
    for options in (ReadOptions(marker="z"), ReadOptions(centre="z")):
        with pytest.raises(UsageError, match="no point"):
            angle_of(both, options)


def test_frames_and_errors_of_a_point():
    points, _ = circle()
    counted = replace(points, time=np.arange(60.0), counted=True, errors={"p": np.full(60, 0.1)})
    found = angle_of(counted, ReadOptions(fps=25.0, centre="5,3", start=1.0))
    np.testing.assert_allclose(found.time, 1 + np.arange(60) / 25)
    np.testing.assert_allclose(found.sigma, 0.05)


def test_unlikely_points_are_not_used():
    points, _ = circle()
    likelihood = np.where(np.arange(60) % 3 == 0, 0.6, 0.59)
    unsure = replace(points, likelihood={"p": likelihood})
    found = angle_of(unsure, ReadOptions(centre="5,3"))
    np.testing.assert_array_equal(np.isnan(found.angle), likelihood < 0.6)
    assert not np.isnan(angle_of(unsure, ReadOptions(centre="5,3", likelihood=0.59)).angle).any()
    places = {"hub": np.tile([5.0, 3.0], (60, 1)), "p": points.places["p"]}
    hidden = replace(points, places=places, likelihood={"hub": likelihood})
    np.testing.assert_array_equal(np.isnan(angle_of(hidden, ReadOptions()).angle), likelihood < 0.6)
    least = MIN_SAMPLES
    for count in (least, least - 1):
        few = replace(points, likelihood={"p": (np.arange(60) < count).astype(float)})
        if count < least:
            with pytest.raises(DatasetError, match="at least"):
                angle_of(few, ReadOptions(centre="5,3"))
        else:
            assert np.isfinite(angle_of(few, ReadOptions(centre="5,3")).angle).sum() == least


def test_undefined_angles_are_refused():
    points, _ = circle()
    for distance, refused in ((0.18, True), (0.22, False)):
        place = points.places["p"].copy()
        place[7] = np.array([5.0, 3.0]) + 2 * distance * np.array([0.6, 0.8])
        near = replace(points, places={"p": place})
        if refused:
            with pytest.raises(DatasetError, match="too close"):
                angle_of(near, ReadOptions(centre="5,3"))
        else:
            angle_of(near, ReadOptions(centre="5,3"))
    flat = replace(points, places={"p": np.stack([points.places["p"][:, 0], np.full(60, 9.0)], axis=1)})
    with pytest.raises(DatasetError, match="y of 'p' is 9"):
        angle_of(flat, ReadOptions(centre="5,3"))


@pytest.mark.parametrize(("ratio", "refused"), [(0.7, False), (0.6, True)])
def test_a_path_has_a_centre_if_it_is_nearly_a_circle(ratio, refused):
    """The rms deviation of an ellipse from a circle, divided by the mean radius, is 0.13 and 0.18."""
    points, _ = circle(400, turns=3)
    place = np.array([5.0, 3.0]) + (points.places["p"] - [5.0, 3.0]) * [1.0, ratio]
    flat = replace(points, places={"p": place})
    if refused:
        with pytest.raises(DatasetError, match="not a circle"):
            angle_of(flat, ReadOptions())
    else:
        angle_of(flat, ReadOptions())


@pytest.mark.parametrize(
    ("offset", "noise", "doubt"),
    [(0.06, 1e-3, True), (0.04, 1e-3, False), (0.4, 1e-3, True), (0.06, 0.4, False)],
)
def test_a_centre_beside_the_circle_is_doubted(offset, noise, doubt):
    """The offset is in radii; at least 5 % of the radius, and three uncertainties of the fitted centre."""
    points, _ = circle(60, radius=2.0)
    place = points.places["p"] + noise * np.random.default_rng(0).normal(size=(60, 2))
    found = angle_of(replace(points, places={"p": place}), ReadOptions(centre=f"{5 + 2 * offset},3"))
    assert bool(found.doubts) is doubt
    assert (found.doubts[0] in found.notes) if doubt else not found.doubts
    if doubt and offset == 0.4:
        assert "0.8 +- " in found.doubts[0]
        u = float(found.doubts[0].split("0.8 +- ")[1].split()[0])
        assert 0.7 < u / (noise * math.sqrt(4 / 60)) < 2


def test_centre_of_a_circle():
    arc = np.linspace(0, 1.5, 9)
    place = np.stack([4 + 3 * np.cos(arc), -1 + 3 * np.sin(arc)], axis=1)
    np.testing.assert_allclose(circle_centre(place), [4, -1])
    place[2] = np.nan
    np.testing.assert_allclose(circle_centre(place), [4, -1])
    assert np.isnan(circle_centre(place[:3])).all()
    np.testing.assert_allclose(circle_centre(place[3:6]), [4, -1])


# ---- tables


def test_particles_of_trackpy():
    rows = "y,x,frame,particle,ep\n" + "".join(
        f"{k},{10 * k},{k + 5},{p},{e}\n"
        for k in range(4)
        for p, e in ((0, 0.1 * (k + 1)), (3, -1))
        if not (k == 2 and p == 3)
    )
    raw = read_text(PATH, *content_lines(PATH, rows.encode()))
    points = particles_of(raw)
    assert list(points.places) == ["0", "3"]
    np.testing.assert_allclose(points.time, [5, 6, 7, 8])
    np.testing.assert_allclose(points.places["0"], [[0, 0], [10, 1], [20, 2], [30, 3]])
    assert np.isnan(points.places["3"][2]).all()
    np.testing.assert_allclose(points.errors["0"], [0.1, 0.2, 0.3, 0.4])
    assert (points.y_down, points.counted) == (True, True)
    for head in ("y,x,frame,other,ep", "y,z,frame,particle,ep", "y,x,time,particle,ep"):
        lines = content_lines(PATH, rows.replace("y,x,frame,particle,ep", head).encode())
        assert particles_of(read_text(PATH, *lines)) is None
    assert read_point_table(PATH, lines_of(rows)) is None


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("x", ("x", "")), ("X (m)", ("x", "")), ("y_px", ("y", "")), ("x_{mass A}", ("x", "mass A")),
        ("x_A", ("x", "A")),
        ("A_x", ("x", "A")), ("A.y", ("y", "A")), ("acc_x", ("", "")), ("gyro_x", ("", "")), ("x [deg/s]", ("", "")),
        ("mag.y", ("", "")), ("linear_accel_x", ("", "")), ("t", ("", "")), ("xy", ("", "")), ("x [deg]", ("", "")),
    ],
)  # fmt: skip
def test_axes_in_headers(name, expected):
    assert _point_tables._axis(name) == expected


def test_exports_of_tracker():
    rows = "".join(f"{0.04 * k:.2f},{k},{2 * k},{3 * k},{4 * k}\n" for k in range(5))
    points = table("t,x_A,y_A,x_B,y_B\n" + rows)
    np.testing.assert_allclose(points.places["B"], np.outer(range(5), [3, 4]))
    np.testing.assert_allclose(points.time, 0.04 * np.arange(5))
    assert (points.y_down, points.counted) == (False, False)
    points = table(",mass A,,mass B,\nt,x,y,x,y\n" + rows)
    np.testing.assert_allclose(points.places["mass B"], np.outer(range(5), [3, 4]))
    points = table("t,x,y,x,y\n" + rows)
    assert list(points.places) == ["a", "a 2"]
    np.testing.assert_allclose(
        table("t [ms],x,y\n" + "".join(f"{40 * k},{k},{k}\n" for k in range(5))).time, 0.04 * np.arange(5)
    )
    points = table("frame,x,y\n" + "".join(f"{k},{k},{k}\n" for k in range(5)))
    assert points.counted
    assert table("t,angle\n" + rows) is None
    assert table("t,x\n0,1\n1,2\n") is None
    with pytest.raises(DatasetError, match="x, y and z"):
        table("t,x,y,z\n0,1,2,3\n1,2,3,4\n")
    with pytest.raises(DatasetError, match="no column for the time"):
        table("a,x,y\n0,1,2\n1,2,3\n")
    with pytest.raises(DatasetError, match="unknown unit"):
        table("t [unit of more than thirty characters],x,y\n0,1,2\n1,2,3\n")


def test_rows_of_points():
    whole = "t,x,y\n0,1,2\n0.1,2,3\n0.2,3,4\n"
    assert len(table(whole + "0.3,4").time) == 3
    assert len(table(whole.replace("\n0.1", ",\n0.1")).time) == 3
    assert np.isnan(table(whole + "0.3,4\n0.4,1,1\n").places["a"][3, 1])
    for odd in ("0.3,1,2,3\n0.4,1,1\n", "0.3,x,1\n0.4,1,1\n"):
        with pytest.raises(DatasetError, match="line 5"):
            table(whole + odd)


@pytest.mark.parametrize(
    "individuals", ["", "individuals,m1,m1,m1,m1,m1,m1\n", "individuals,m1,m1,m1,m2,m2,m2\n"]
)
def test_tables_of_deeplabcut(individuals):
    head = (
        "scorer,s,s,s,s,s,s\n" + individuals + "bodyparts,a,a,a,b,b,b\ncoords,x,y,likelihood,x,y,likelihood\n"
    )
    points = table(head + "".join(f"{k},{k},{2 * k},0.9,{3 * k},{4 * k},0.{k}\n" for k in range(5)))
    names = ["m1.a", "m2.b"] if "m2" in individuals else ["a", "b"]
    assert list(points.places) == names
    np.testing.assert_allclose(points.places[names[1]], np.outer(range(5), [3, 4]))
    np.testing.assert_allclose(points.likelihood[names[1]], [0, 0.1, 0.2, 0.3, 0.4])
    np.testing.assert_allclose(points.time, range(5))
    with pytest.raises(DatasetError, match="bodyparts"):
        table("scorer,s,s\ncoords,x,y\n0,1,2\n")


def test_tables_of_sleap():
    head = "track,frame_idx,instance.score,a.x,a.y,a.score\n"
    points = table(head + "".join(f"t1,{k + 2},0.5,{k},{2 * k},0.8\n" for k in range(4)))
    assert list(points.places) == ["a"]
    np.testing.assert_allclose(points.places["a"], np.outer(range(4), [1, 2]))
    np.testing.assert_allclose(points.time, [2, 3, 4, 5])
    np.testing.assert_allclose(points.likelihood["a"], 0.8)
    with pytest.raises(DatasetError, match="2 tracked"):
        table(head + "t1,0,0.5,1,1,1\nt2,0,0.5,1,1,1\n")


# ---- binary files


@pytest.mark.parametrize("protocol", [0, 1, 2, 4])
def test_pickled_names(protocol):
    names = [("s", "a", "x"), ("s", "a", "y"), ("s", "m", "b", "x")]
    assert listed_names(pickle.dumps(names, protocol)) == names
    for other in ("text", [], [("a",), ["b"]], [()], [(1, 2)], {"a": 1}, print):
        if other == []:
            continue
        with pytest.raises(DatasetError):
            listed_names(pickle.dumps(other, protocol))
    with pytest.raises(DatasetError):
        listed_names(pickle.dumps(names, protocol)[:-1])
    with pytest.raises(DatasetError):
        listed_names(pickle.dumps([("a", str(k)) for k in range(4000)], protocol))


def hdf5(tmp_path, **datasets):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        for name, values in datasets.items():
            file[name] = values
    return path


def test_files_of_sleap(tmp_path):
    tracks = np.arange(2 * 3 * 5, dtype=float).reshape(1, 2, 3, 5)
    names = np.array([b"a", b"b", b"c"])
    scores = np.linspace(0, 1, 15).reshape(1, 3, 5)
    points = read_hdf5(hdf5(tmp_path, tracks=tracks, node_names=names, point_scores=scores))
    np.testing.assert_allclose(points.places["b"], np.stack([tracks[0, 0, 1], tracks[0, 1, 1]], axis=1))
    np.testing.assert_allclose(points.likelihood["c"], scores[0, 2])
    assert points.counted
    assert points.y_down
    assert (
        read_hdf5(hdf5(tmp_path, tracks=tracks, node_names=names, point_scores=scores[:, :2])).likelihood
        == {}
    )
    for shape, count in (((2, 2, 3, 5), 3), ((1, 3, 3, 5), 3), ((1, 2, 3, 5), 2), ((2, 3, 5), 3)):
        with pytest.raises(DatasetError):
            read_hdf5(hdf5(tmp_path, tracks=np.zeros(shape), node_names=names[:count]))
    with pytest.raises(DatasetError, match="without points"):
        read_hdf5(hdf5(tmp_path, tracks=tracks))


@pytest.mark.parametrize("axis", ["keypoint", "keypoints"])
@pytest.mark.parametrize("individuals", [True, False])
def test_poses_of_movement(tmp_path, axis, individuals):
    position = np.arange(6 * 2 * 3, dtype=float).reshape(6, 2, 3)
    confidence = np.linspace(0, 1, 18).reshape(6, 3)
    names, time = np.array([b"a", b"b", b"c"]), np.arange(6.0) / 10
    shaped = (position[..., None], confidence[..., None]) if individuals else (position, confidence)
    datasets = {"position": shaped[0], "confidence": shaped[1], axis: names, "time": time}
    path = hdf5(tmp_path, **datasets)
    points = read_hdf5(path)
    np.testing.assert_allclose(points.places["b"], position[:, :, 1])
    np.testing.assert_allclose(points.likelihood["c"], confidence[:, 2])
    np.testing.assert_allclose(points.time, time)
    assert points.counted
    with h5py.File(path, "a") as file:
        file["time"].attrs["units"] = "seconds"
    assert not read_hdf5(path).counted
    with h5py.File(path, "a") as file:
        file.attrs["time_unit"] = "frames"
    assert read_hdf5(path).counted
    assert read_hdf5(hdf5(tmp_path, **datasets | {"confidence": confidence[:4]})).likelihood == {}
    for wrong in (np.zeros((6, 2, 3, 2)), np.zeros((6, 1, 3)), np.zeros((6, 2, 2)), np.zeros((6, 2))):
        with pytest.raises(DatasetError):
            read_hdf5(hdf5(tmp_path, **datasets | {"position": wrong}))


@pytest.mark.parametrize("individuals", [0, 1, 2])
def test_pandas_tables_of_deeplabcut(tmp_path, individuals):
    owners = [("m1", "m1", "m1", "m2", "m2", "m2"), ("m1",) * 6][individuals != 2]
    names = [
        (("s",) + ((owners[k],) if individuals else ()) + ("ab"[k // 3], ("x", "y", "likelihood")[k % 3]))
        for k in range(6)
    ]
    values = np.arange(24, dtype=float).reshape(4, 6)
    expected = ["m1.a", "m2.b"] if individuals == 2 else ["a", "b"]
    rows = np.zeros(4, dtype=[("index", "i8"), ("values_block_0", "f8", (6,))])
    rows["index"], rows["values_block_0"] = np.arange(4) + 3, values
    path = hdf5(tmp_path, **{"df_with_missing/table": rows})
    with h5py.File(path, "a") as file:
        file["df_with_missing/table"].attrs["values_block_0_kind"] = np.void(pickle.dumps(names, 0))
    levels = list(zip(*names, strict=True))
    fixed = {"df_with_missing/block0_values": values, "df_with_missing/axis1": np.arange(4) + 3}
    for k, level in enumerate(levels):
        words = sorted(set(level))
        fixed[f"df_with_missing/block0_items_level{k}"] = np.array([w.encode() for w in words])
        fixed[f"df_with_missing/block0_items_label{k}"] = np.array([words.index(w) for w in level])
    (tmp_path / "fixed").mkdir()
    other = hdf5(tmp_path / "fixed", **fixed)
    with h5py.File(other, "a") as file:
        file["df_with_missing"].attrs["block0_items_nlevels"] = len(levels)
    for each in (path, other):
        points = read_hdf5(each)
        assert list(points.places) == expected
        np.testing.assert_allclose(points.places[expected[1]], values[:, 3:5])
        np.testing.assert_allclose(points.likelihood[expected[0]], values[:, 2])
        np.testing.assert_allclose(points.time, [3, 4, 5, 6])
    with h5py.File(other, "a") as file:
        file["df_with_missing/block1_values"] = values
    with pytest.raises(DatasetError):
        read_hdf5(other)


PROJECT = """<object class="tracker.TrackerPanel">
<property name="videoclip"><object class="VideoClip"><property name="startframe">2</property>
<property name="stepsize">2</property><property name="starttime">500.0</property></object></property>
<property name="clipcontrol"><object class="C">{delta}</object></property>
<property name="length_unit">{unit}</property>
<property name="coords"><object class="Coords"><property name="framedata">
<property name="[0]"><object class="F"><property name="xorigin">10.0</property><property name="yorigin">20.0</property>
<property name="angle">0.0</property><property name="xscale">4.0</property>
<property name="yscale">5.0</property></object></property>
<property name="[4]"><object class="F"><property name="xorigin">10.0</property><property name="yorigin">20.0</property>
<property name="angle">30.0</property><property name="xscale">4.0</property>
<property name="yscale">5.0</property></object></property>
</property></object></property>
<property name="tracks"><object class="org.PointMass"><property name="name">A</property><property name="framedata">
<property name="[2]"><object class="P"><property name="x">18.0</property>
<property name="y">10.0</property></object></property>
<property name="[4]"><object class="P"><property name="x">18.0</property>
<property name="y">10.0</property></object></property>
</property></object><object class="org.Other"><property name="name">B</property></object></property></object>"""


def test_projects_of_tracker():
    def read(text):
        return read_project(PATH, text.encode(), None)

    text = PROJECT.format(delta='<property name="delta_t">40.0</property>', unit="cm")
    points = read(text)
    assert list(points.places) == ["A", "origin"]
    np.testing.assert_allclose(points.time, [0.5, 0.58])
    c, s = math.cos(math.radians(30)), math.sin(math.radians(30))
    np.testing.assert_allclose(
        points.places["A"], [[0.02, 0.02], [0.01 * (8 * c + 10 * s) / 4, 0.01 * (-8 * s + 10 * c) / 5]]
    )
    assert (points.places["origin"] == 0).all()
    assert (points.y_down, points.counted) == (False, False)
    for unit, size in (("m", 1), ("mm", 1e-3), ("km", 1e3), ("in", 0.0254), ("ft", 0.3048), ("px", 1)):
        np.testing.assert_allclose(
            read(PROJECT.format(delta="", unit=unit)).places["A"][0], [2 * size, 2 * size]
        )
    counted = read(PROJECT.format(delta="", unit="m"))
    np.testing.assert_allclose(counted.time, [0, 1])
    assert counted.counted
    for wrong in (
        text.replace(">5.0<", ">0.0<"), text.replace("PointMass", "Line"), "<!DOCTYPE a>" + text, text[:-9],
        text.replace(">18.0<", ">z<"),
    ):  # fmt: skip
        with pytest.raises(DatasetError):
            read(wrong)
    assert len(read(text.replace("PointMass", "CenterOfMass")).places) == 2


def test_large_projects_are_refused(monkeypatch):
    text = PROJECT.format(delta="", unit="m").encode()
    monkeypatch.setattr(_point_files, "_MAX_MARKUP", text.count(b"<") + text.count(b"="))
    read_project(PATH, text, None)
    monkeypatch.setattr(_point_files, "_MAX_MARKUP", text.count(b"<") + text.count(b"=") - 1)
    with pytest.raises(DatasetError, match="larger"):
        read_project(PATH, text, None)


def test_a_body_of_a_case_is_found_by_its_own_name(monkeypatch):
    """The first body of a chain is also the casing."""
    values = {n: np.arange(3.0) + k for k, n in enumerate(("motor", "drum"))}
    series = [SimpleNamespace(name=n, time=v, value=10 * v, u=0.1 * v) for n, v in values.items()]
    stored = SimpleNamespace(casing=series[0], others=series[1:], attributes={"quantity": "angle"})
    monkeypatch.setattr(_point_files, "READER", SimpleNamespace(open=lambda *_: nullcontext("file")))
    monkeypatch.setattr(_point_files, "read_stored_case", lambda file, reader: stored)
    monkeypatch.setattr(_point_files, "table_of", lambda path, names, columns: (names, columns))
    for body, own in (("", "motor"), ("casing", "motor"), ("motor", "motor"), ("drum", "drum")):
        names, columns = _point_files._case_body("a.h5", body)
        assert names == ["t", "angle", "sigma"]
        np.testing.assert_allclose(columns, [values[own], 10 * values[own], 0.1 * values[own]])
    with pytest.raises(DatasetError) as caught:
        _point_files._case_body("a.h5", "rotor")
    assert caught.value.hint == "Its series: casing, motor, drum."


def test_an_unknown_uncertainty_of_a_particle_is_its_median():
    rows = "y,x,frame,particle,ep\n" + "".join(
        f"{k},{k},{k},1,{e}\n" for k, e in enumerate(("0.1", "", "0.3", "-1", "0.5"))
    )
    rows += "".join(f"{k},{k},{k},2,\n" for k in range(5))
    points = particles_of(read_text(PATH, *content_lines(PATH, rows.encode())))
    np.testing.assert_allclose(points.errors["1"], [0.1, 0.2, 0.3, 0.2, 0.5])
    assert "2" not in points.errors


def test_a_table_of_one_row_has_no_truncated_row():
    assert len(table("t,x,y\n0,1,2\n0.3,4").time) == 2
    assert len(table("t,x,y\n0,1,2\n0.1,2,3\n0.3,4").time) == 2
    assert len(table("t,x,y\n0,1,2\n0.1,2,3\n0.3,4,5").time) == 3


EXPORT = Path("a.nc")


@pytest.fixture
def exported():
    with h5py.File("memory", "w", driver="core", backing_store=False) as file:
        for name, factor in (("casing", 1.0), ("rotor", 10.0)):
            group = file.create_group(name)
            columns = ("time", "angle", "sigma", "omega", "omega_sigma")
            for k, column in enumerate(columns):
                group[column] = factor * (k + np.arange(3.0))
        yield file


@pytest.mark.parametrize(("body", "factor"), [("", 1.0), ("casing", 1.0), ("rotor", 10.0)])
@pytest.mark.parametrize(("quantity", "first"), [(None, 1), ("angle", 1), ("omega", 3)])
def test_an_exported_body_has_the_measured_quantity(exported, body, factor, quantity, first):
    if quantity:
        exported.attrs["quantity"] = quantity
    raw = _point_files._exported_body(EXPORT, exported, body)
    assert raw.names == ("t", quantity or "angle", "sigma")
    for place, k in enumerate((0, first, first + 1)):
        assert raw.numbers(place) == pytest.approx(factor * (k + np.arange(3.0)))


def test_a_body_that_was_not_exported_is_refused(exported):
    exported.create_group("empty")
    for body in ("wheel", "empty"):
        with pytest.raises(DatasetError, match=f"no series '{body}'"):
            _point_files._exported_body(EXPORT, exported, body)
