"""Points of other programs become the angles that they were made from."""

import io
import os
import pickle

import h5py
import numpy as np
import pytest

from gyrotrack import DatasetError, UsageError, import_case
from gyrotrack.io.readers._motion_table import ReadOptions, read_names
from gyrotrack.io.readers._point_files import listed_names
from gyrotrack.io.readers._points import circle_centre
from gyrotrack.io.readers._registry import read_motion

N = 400
FPS = 100.0
TIME = np.arange(N) / FPS
ANGLE = 0.3 + 20 * TIME - 0.5 * TIME**2
CENTRE = np.array([320.0, 240.0])
ARM = 90.0
NOISE = 0.05


@pytest.fixture
def places():
    """Centre and marker in a picture, y downwards, with noise; the marker turns counter-clockwise as seen."""
    rng = np.random.default_rng(5)
    marker = CENTRE + ARM * np.stack([np.cos(ANGLE), -np.sin(ANGLE)], axis=1)
    return {
        "hub": CENTRE + rng.normal(0, NOISE, (N, 2)),
        "tape": marker + rng.normal(0, NOISE, (N, 2)),
    }


def right(table, expected=ANGLE, seen=slice(None), centred=False):
    """The angle is the truth but for the noise, and a constant where the centre is exact."""
    error = np.angle(np.exp(1j * (table.value - expected[seen])))
    return np.abs(error).max() < 6 * NOISE * (1 if centred else np.sqrt(2)) / ARM


def write(path, text):
    path.write_text(text)
    return path


def rows(*columns, sep=","):
    return "".join(
        sep.join("" if c != c else repr(float(c)) for c in row) + "\n" for row in zip(*columns, strict=True)
    )


def test_tracker_one_track_with_axes_at_the_centre(tmp_path, places):
    xy = (places["tape"] - CENTRE) * [1, -1] * 1e-3  # Tracker: metres, y upwards
    path = write(tmp_path / "a.txt", "mass_A\nt\tx\ty\n" + rows(TIME, *xy.T, sep="\t"))
    table = read_motion(path, ReadOptions(centre="0,0"))
    assert right(table)
    np.testing.assert_allclose(table.time, TIME)
    assert right(read_motion(path), centred=True)  # without a word: about the middle of the path


def test_tracker_two_tracks_and_decimal_commas(tmp_path, places):
    hub, tape = places["hub"] * [1, -1], places["tape"] * [1, -1]
    body = rows(TIME, *hub.T, *tape.T, sep=";").replace(".", ",")
    path = write(tmp_path / "a.txt", "#multi:\n;centre;;mass B;\nt;x;y;x;y\n" + body)
    assert right(read_motion(path))
    path = write(tmp_path / "b.txt", "t;x_{centre};y_{centre};x_{mass B};y_{mass B}\n" + body)
    assert right(read_motion(path))


def test_tracker_with_gaps_and_steps(tmp_path, places):
    xy = (places["tape"] - CENTRE) * [1, -1]
    xy[50:60] = np.nan
    path = write(tmp_path / "a.csv", "mass A\nframe,x,y,v_{x}\n" + rows(np.arange(N), *xy.T, TIME))
    table = read_motion(path, ReadOptions(centre="0,0", fps=FPS, start=2.0))
    assert len(table.time) == N - 10
    np.testing.assert_allclose(table.time[:2], [2.0, 2.01])
    assert right(table, seen=np.r_[0:50, 60:N])


def deeplabcut(places, individuals=False):
    frame = np.arange(N)
    sure = np.ones(N)
    sure[7] = 0.1
    head = ["scorer" + ",net" * 6]
    if individuals:
        head.append("individuals" + ",one" * 6)
    head += ["bodyparts" + ",hub" * 3 + ",tape" * 3, "coords" + ",x,y,likelihood" * 2]
    body = rows(frame, *places["hub"].T, np.ones(N), *places["tape"].T, sure)
    return "\n".join(head) + "\n" + body.replace("\n", "\n")


@pytest.mark.parametrize("individuals", [False, True])
def test_deeplabcut_csv(tmp_path, places, individuals):
    places["tape"][7] = 0.0  # where the network was not sure it said nonsense
    path = write(tmp_path / "dlc.csv", deeplabcut(places, individuals))
    table = read_motion(path, ReadOptions(fps=FPS))
    assert len(table.time) == N - 1
    assert right(table, seen=np.delete(np.arange(N), 7))
    with pytest.raises(UsageError, match="contains frame numbers"):
        read_motion(path)
    with pytest.raises(UsageError, match="has no point 'nose'"):
        read_motion(path, ReadOptions(marker="nose", fps=FPS))


@pytest.mark.filterwarnings("ignore")  # of PyTables
@pytest.mark.parametrize("form", ["table", "fixed"])
@pytest.mark.parametrize("individuals", [False, True])
def test_deeplabcut_hdf5_as_pandas_writes_it(tmp_path, places, form, individuals):
    pd = pytest.importorskip("pandas")
    pytest.importorskip("tables")
    lines = [0, 1, 2, 3] if individuals else [0, 1, 2]
    header = pd.read_csv(io.StringIO(deeplabcut(places, individuals)), header=lines, index_col=0)
    header.to_hdf(tmp_path / "dlc.h5", key="df_with_missing", format=form, mode="w")
    table = read_motion(tmp_path / "dlc.h5", ReadOptions(fps=FPS))
    assert right(table, seen=np.delete(np.arange(N), 7))


def test_deeplabcut_hdf5_by_hand(tmp_path, places):
    """The same layout without PyTables: a table of index and one block, its names as a pickled list of tuples."""
    names = [("net", p, c) for p in ("hub", "tape") for c in ("x", "y", "likelihood")]
    block = np.column_stack([places["hub"], np.ones(N), places["tape"], np.ones(N)])
    rec = np.zeros(N, dtype=[("index", "i8"), ("values_block_0", "f8", (6,))])
    rec["index"], rec["values_block_0"] = np.arange(N), block
    for protocol in (0, 2, 4, 5):
        with h5py.File(tmp_path / "dlc.h5", "w") as file:
            table = file.create_dataset("df_with_missing/table", data=rec, chunks=(64,), compression="gzip")
            table.attrs["values_block_0_kind"] = np.void(pickle.dumps(names, protocol))
        assert right(read_motion(tmp_path / "dlc.h5", ReadOptions(fps=FPS)))


def sleap(path, places, tracks=1):
    values = np.stack([places["hub"].T, places["tape"].T], axis=1)[None].repeat(tracks, axis=0)
    with h5py.File(path, "w") as file:
        file.create_dataset("tracks", data=values, compression="gzip")
        file["node_names"] = [b"hub", b"tape"]
        file["track_names"] = [b"one"]
        file["point_scores"] = np.ones((1, 2, N))
    return path


def test_sleap_hdf5(tmp_path, places):
    assert right(read_motion(sleap(tmp_path / "s.h5", places), ReadOptions(fps=FPS)))
    with pytest.raises(DatasetError, match="2 tracked instances"):
        read_motion(sleap(tmp_path / "s2.h5", places, tracks=2), ReadOptions(fps=FPS))


def test_sleap_csv(tmp_path, places):
    head = "track,frame_idx,instance.score,hub.x,hub.y,hub.score,tape.x,tape.y,tape.score\n"
    one = np.ones(N)
    body = rows(np.arange(N), one, *places["hub"].T, one, *places["tape"].T, one)
    body = "".join("track_0," + line + "\n" for line in body.splitlines())
    assert right(read_motion(write(tmp_path / "s.csv", head + body), ReadOptions(fps=FPS)))


def test_the_circle_through_a_noisy_path():
    rng = np.random.default_rng(1)
    errors = []
    for _ in range(200):
        a = rng.uniform(0, 2 * np.pi) + np.linspace(0, 13, 300)
        path = [7.0, -3.0] + 40 * np.stack([np.cos(a), np.sin(a)], axis=1) + rng.normal(0, 0.1, (300, 2))
        errors.append(circle_centre(path) - [7.0, -3.0])
    # the mean of n points on a circle: sigma sqrt(2 / n) in each coordinate
    assert np.std(errors) == pytest.approx(0.1 * np.sqrt(2 / 300), rel=0.2)
    assert np.abs(np.mean(errors, axis=0)).max() < 4 * 0.1 * np.sqrt(2 / 300 / 200)


def bob(seed, count, noise):
    """Return the path of a bob 0.5 m below its pivot, with an amplitude of 0.19 rad."""
    angle = 0.19 * np.cos(4.4 * np.arange(count) / 30)
    path = 0.5 * np.column_stack([np.sin(angle), -np.cos(angle)])
    return path + np.random.default_rng(seed).normal(0.0, noise, path.shape)


def test_the_circle_through_a_short_arc_is_not_too_small():
    """The linear fit alone gives a distance of 0.38 m."""
    distances = np.array([-circle_centre(bob(seed, 4000, 0.0018))[1] + 0.5 for seed in range(8)])
    assert np.mean(distances) == pytest.approx(0.5, rel=0.01)


def test_the_uncertainty_of_a_fitted_centre_scales_all_angles(tmp_path):
    scales, predicted = [], []
    for seed in range(8):
        rows = [f"{k / 30:.6f},{x:.9f},{y:.9f},{seed}" for k, (x, y) in enumerate(bob(seed, 600, 0.003))]
        (path := tmp_path / f"{seed}.csv").write_text("\n".join(["t,x,y,other", *rows]))
        table = read_motion(path, ReadOptions())
        assert table.reading.left_out == ("'other'",)
        assert "all angles share a relative uncertainty" in table.notes[-1]
        swing = table.value - table.value.mean()
        scales.append(np.ptp(table.value) / 0.38 - 1.0)
        predicted.append(np.linalg.norm(table.changes.T @ swing / (swing @ swing)))
    assert 0.4 < np.std(scales) / np.mean(predicted) < 2.0
    given = read_motion(path, ReadOptions(centre="0,0"))
    assert given.changes is None
    assert not any("share" in note for note in given.notes)


def test_a_marker_that_passes_the_centre_is_refused(tmp_path):
    path = write(
        tmp_path / "a.txt", "m\nt\tx\ty\n" + rows(TIME, np.linspace(-1, 1, N), np.zeros(N), sep="\t")
    )
    with pytest.raises(DatasetError, match="is too close"):
        read_motion(path, ReadOptions(centre="0,0"))


class Evil:
    def __reduce__(self):
        return os.system, ("echo run > evil",)


@pytest.mark.parametrize(
    "stored",
    [
        pickle.dumps([Evil()]),
        pickle.dumps([(1, "x")]),
        pickle.dumps({"a": 1}),
        pickle.dumps([["x"]]),
        b"",
        b"(lp0\n",
        b"cos\nsystem\n(S'true'\ntR.",
        b"a.",
        b"\x85.",
        pickle.dumps([("a",)])[:-1],
        b"I1\n.",
    ],
)
def test_what_is_not_a_list_of_names_is_refused_and_nothing_runs(stored, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(DatasetError):
        listed_names(stored)
    assert not list(tmp_path.iterdir())


def test_coordinates_by_number(tmp_path, places):
    xy = (places["tape"] - CENTRE) * [1, -1]
    path = write(tmp_path / "a.txt", rows(np.full(N, 7.0), *xy.T, TIME))
    options = ReadOptions(names=read_names(["x=2", "y=3", "t=4"]))
    found = read_motion(path, options)
    assert right(found, centred=True)
    np.testing.assert_allclose(found.time, TIME)
    assert right(read_motion(path, ReadOptions(names=options.names, centre="0,0")))
    first = write(tmp_path / "b.txt", rows(TIME, *xy.T))  # the first column is the time
    np.testing.assert_array_equal(
        read_motion(first, ReadOptions(names=read_names(["x=2", "y=3"]))).value, found.value
    )


def test_a_column_may_be_given_for_one_body():
    options = ["casing.x=2", "rotor.x=3", "t=Zeit"]
    assert read_names(options, "casing") == {"2": ("x", ""), "zeit": ("t", "")}
    assert read_names(options, "rotor") == {"3": ("x", ""), "zeit": ("t", "")}
    with pytest.raises(UsageError, match="unknown column"):
        read_names(["casing.x=2"], bodies=("wheel",))


def test_columns_by_name(tmp_path):
    path = write(
        tmp_path / "a.csv",
        "Zeit;Drehung;Fehler;angle\n" + rows(TIME * 1e3, np.degrees(ANGLE), np.full(N, 0.1), TIME, sep=";"),
    )
    names = read_names(["t=Zeit [ms]", "angle=Drehung [deg]", "sigma=Fehler"])
    table = read_motion(path, ReadOptions(names=names))
    np.testing.assert_allclose(table.time, TIME)
    np.testing.assert_allclose(table.value, ANGLE)
    np.testing.assert_allclose(table.sigma, np.radians(0.1))
    for wrong in ("Zeit", "time=", "z=Zeit"):
        with pytest.raises(UsageError, match=r"unknown column|no column"):
            read_names([wrong])
    with pytest.raises(DatasetError, match="no column for the"):
        read_motion(path, ReadOptions(names=read_names(["t=Zeit"])))


def test_a_case_of_points(tmp_path, places):
    """Casing by SLEAP, rotor by Tracker: speeds and clock are those of the truth."""
    casing = sleap(tmp_path / "casing.h5", places)
    turning = 300 * TIME
    xy = 0.05 * np.stack([np.cos(turning), np.sin(turning)], axis=1) + np.random.default_rng(2).normal(
        0, 1e-5, (N, 2)
    )
    rotor = write(tmp_path / "rotor.txt", "mass_A\nt\tx\ty\n" + rows(TIME / 10, *xy.T, sep="\t"))
    case = import_case(
        casing,
        [rotor],
        options=[ReadOptions(fps=FPS), ReadOptions(centre="0,0", start=1.5)],
        I_rotor=5.54e-5,
        I_casing=2.06e-5,
    )
    assert np.nanmedian(case.casing.omega) == pytest.approx(20 - 2.0, rel=0.01)
    assert np.nanmedian(case.rotor.omega) == pytest.approx(3000, rel=0.01)
    assert case.rotor.time[0] == pytest.approx(1.5)
    assert np.median(case.casing.sigma) == pytest.approx(NOISE * np.sqrt(2) / ARM, rel=0.3)


def test_a_path_that_is_not_a_circle_needs_a_centre(tmp_path):
    """A wandering point: its direction from the centre of a fitted circle is no angle of rotation."""
    x = 630 + 6 * np.sin(3 * TIME)
    y = 160 + 12 * np.sin(2 * TIME + 1)
    path = write(tmp_path / "a.csv", "t,x,y\n" + rows(TIME, x, y))
    with pytest.raises(
        DatasetError, match=r"not a circle about its fitted centre.* % of the radius"
    ) as error:
        read_motion(path, ReadOptions(marker=None))
    assert "--centre 320,240" in error.value.hint
    assert len(read_motion(path, ReadOptions(centre="500,160")).time) == N


def test_a_circle_seen_obliquely_is_one(tmp_path):
    """At 40 degrees the ellipse has an axis ratio of 0.77."""
    xy = CENTRE + ARM * np.stack([np.cos(ANGLE), -0.77 * np.sin(ANGLE)], axis=1)
    path = write(tmp_path / "a.csv", "t,x,y\n" + rows(TIME, *xy.T))
    turned = np.unwrap(read_motion(path, ReadOptions()).value)
    assert abs(turned[-1] - turned[0]) == pytest.approx(ANGLE[-1] - ANGLE[0], abs=0.3)


@pytest.mark.parametrize(("head", "factor"), [("t (ms)", 1e3), ("t", 1.0)])
def test_the_unit_of_the_time_of_tracked_points(tmp_path, places, head, factor):
    path = write(tmp_path / "a.txt", f"{head},x,y\n" + rows(factor * TIME, *places["tape"].T))
    np.testing.assert_allclose(read_motion(path).time, TIME, atol=1e-9)


def test_an_outlier_among_points_moves_no_centre(tmp_path, places):
    tape = places["tape"].copy()
    tape[100] = 1e9
    path = write(tmp_path / "a.txt", "t,x,y\n" + rows(TIME, *tape.T))
    made = read_motion(path)
    assert len(made.time) == N - 1
    assert any("far from both neighbours" in note for note in made.notes)
