"""Points of a film as a user follows them: `extract --point`, `export --table points`, `spindown --point`."""

import csv
import json

import cv2
import numpy as np
import pytest

from gyrotrack.apps.cli._app import run


@pytest.fixture(scope="module")
def film(bob, made_once):
    """A blue bob on a thread with the pivot above the picture, and what was drawn."""
    drawn = bob(frames=60, period=0.6, colour=True)
    return made_once("film-bob", lambda folder: drawn.write(folder / "bob.mp4")) / "bob.mp4", drawn


def document(capsys):
    captured = capsys.readouterr()
    return json.loads(captured.out), captured.err


def click(drawn, dx=0.0):
    x, y = drawn.place[0]
    return f"{x + dx:.0f},{y:.0f}"


def rows(path):
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.slow
def test_a_point_becomes_a_table_with_uncertainties(film, tmp_path, capsys):
    path, drawn = film
    target, table = tmp_path / "bob.h5", tmp_path / "bob.csv"
    words = ["extract", str(path), "--point", click(drawn), "-o", str(target), "--json"]
    assert run([*words, "--capture-fps", "50"]) == 0
    said, _ = document(capsys)
    assert said["points"]["point"]["samples"] == 60
    assert 0.002 < said["points"]["point"]["median_sigma_px"] < 0.1
    assert run(["export", str(target), "--table", "points", "-o", str(table)]) == 0
    found = rows(table)
    assert list(found[0]) == [
        "clip", "point", "time [s]", "frame_number", "x [px]", "y [px]", "sigma_x [px]", "sigma_y [px]"
    ]  # fmt: skip
    x = np.array([float(row["x [px]"]) for row in found])
    assert (x - drawn.place[:, 0]).std() < 0.2  # the place on the bob that is followed turns with it
    assert float(found[-1]["time [s]"]) == pytest.approx(59 / 50)


@pytest.mark.slow
def test_a_scale_gives_metres(film, tmp_path, capsys):
    path, drawn = film
    target, table = tmp_path / "bob.h5", tmp_path / "bob.csv"
    words = [
        "extract",
        str(path),
        "--colour",
        "blue",
        "--hub",
        "80,-120",
        "--scale",
        "0.002",
        "-o",
        str(target),
    ]
    assert run([*words, "--capture-fps", "50"]) == 0
    assert run(["export", str(target), "--table", "points", "-o", str(table)]) == 0
    found = rows(table)
    y = np.array([float(row["y [m]"]) for row in found])
    exact = drawn.place[[int(row["frame_number"]) for row in found], 1]
    assert len(found) > 50
    assert np.abs(y / 0.002 - exact).max() < 1.5  # of chroma, which has half the resolution
    assert run(["info", str(target)]) == 0
    assert "NOT SOUND" not in capsys.readouterr().out


@pytest.mark.slow
def test_several_points_have_a_track_each(bob, tmp_path, capsys):
    one, two = (
        bob(hub=(x, -120.0), amplitude=0.1, frames=40, thread=False, texture=0.0) for x in (45.0, 115.0)
    )

    class Both(bob):
        def pictures(self):
            return [np.minimum(a, b) for a, b in zip(one.pictures(), two.pictures(), strict=True)]

    path = Both(frames=40).write(tmp_path / "two.mp4")
    target = tmp_path / "two.h5"
    clicks = " ".join(f"{b.place[0, 0]:.0f},{b.place[0, 1]:.0f}" for b in (one, two))
    assert (
        run(["extract", str(path), "--points", clicks, "-o", str(target), "--json", "--capture-fps", "50"])
        == 0
    )
    said, _ = document(capsys)
    assert {name: part["samples"] for name, part in said["points"].items()} == {"point_1": 40, "point_2": 40}
    table = tmp_path / "two.csv"
    assert run(["export", str(target), "--table", "points", "-o", str(table)]) == 0
    second = [float(r["x [px]"]) for r in rows(table) if r["point"] == "point_2"]
    assert np.mean(second) == pytest.approx(two.place[:, 0].mean(), abs=1.0)


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (["--point", "here"], 2, "--point 'here' is not a position"),
        (["--point", "nan,3"], 2, "not finite numbers"),
        (["--point", "900,3"], 2, "outside the picture of 160 x 120 px"),
        (["--point", "80,60", "--body", "casing"], 2, "apply to markers, not to points"),
        (["--hub", "80,-120"], 2, "Select a point"),
        (["--colour", "blue", "--scale", "-1"], 2, "Invalid scale"),
        (["--colour", "mauve"], 2, "mauve"),
    ],
)
def test_wrong_usage_is_one_sentence(film, tmp_path, capsys, words, code, text):
    target = tmp_path / "out.h5"
    assert run(["extract", str(film[0]), *words, "-o", str(target)]) == code
    assert text in " ".join(capsys.readouterr().err.split())
    assert not target.exists()


def test_points_are_of_films_and_a_table_is_refused(tmp_path, capsys):
    table = tmp_path / "run.csv"
    table.write_text("t,angle\n" + "\n".join(f"{k / 10},{k / 5}" for k in range(40)))
    assert run(["spindown", str(table), "--point", "3,4", "-o", str(tmp_path / "o.h5")]) == 2
    assert "apply to films" in capsys.readouterr().err
    assert run(["export", str(tmp_path / "no.h5"), "--table", "points", "-o", str(tmp_path / "o.csv")]) == 1


@pytest.fixture(scope="module")
def tilted(bob, made_once):
    """A pendulum seen from above at 36.9 degrees: all heights shrink to 0.8."""
    drawn = bob(frames=64, texture=0.0, thread=False)

    class Squeezed(bob):
        def pictures(self):
            return [cv2.resize(p, (160, 96), interpolation=cv2.INTER_AREA) for p in drawn.pictures()]

    return made_once(
        "film-tilted", lambda folder: Squeezed(size=(96, 160), frames=64).write(folder / "t.mp4")
    )


@pytest.mark.slow
@pytest.mark.parametrize(("tilt", "right"), [("36.87", True), (None, False)])
def test_a_given_tilt_corrects_the_angles(tilted, bob, tmp_path, tilt, right):
    """Without it, the hub at 0.8 of its height gives angles that are larger by 1 / 0.8."""
    from gyrotrack.apps._points import read_tilt
    from gyrotrack.apps._spindown import SpindownOptions, point_recording
    from gyrotrack.tracking._film import Film

    drawn = bob(frames=64)
    hub, start = ((x, 0.8 * (y + 0.5) - 0.5) for x, y in (drawn.hub, drawn.place[0]))
    options = SpindownOptions(point=start, hub=hub, capture_fps=50.0, tilt=tilt and read_tilt(tilt))
    recording, found = point_recording(Film(tilted / "t.mp4", tilt=options.tilt), options)
    exact = np.ptp(drawn.angle(drawn.time))
    assert np.ptp(found.angle) == pytest.approx(exact if right else exact / 0.8, rel=0.015)
    assert (found.view < 0.03) == right
    place = recording.points["point"]  # in the picture, not in the corrected one
    assert np.abs(place.x - drawn.place[:, 0]).max() < 2.0
    assert recording.centre[0] == pytest.approx(hub, abs=1e-6)


@pytest.mark.parametrize(
    ("text", "refused"),
    [("30", False), ("75,0", False), ("76", True), ("-1", True), ("steep", True), ("1,2,3", True)],
)
def test_a_tilt_is_between_0_and_75_degrees(text, refused):
    from gyrotrack import UsageError
    from gyrotrack.apps._points import read_tilt

    if refused:
        with pytest.raises(UsageError, match="tilt"):
            read_tilt(text)
    else:
        assert np.degrees(read_tilt(text).angle) == pytest.approx(float(text.split(",")[0]))


@pytest.mark.slow
@pytest.mark.parametrize("crf", [14, 23])
def test_spindown_measures_a_pendulum_by_its_bob(bob, tmp_path, capsys, crf):
    """Period 1.1 s, amplitude 0.25 exp(-0.03 t) rad; the pivot is given within 1 px, at a distance of 190 px."""
    drawn = bob(frames=400)
    path = drawn.write(tmp_path / "bob.mp4", crf=crf)
    words = [
        "spindown",
        str(path),
        "--point",
        click(drawn, 2.0),
        "--hub",
        "80.7,-119.5",
        "--capture-fps",
        "50",
    ]
    code = run([*words, "-o", str(tmp_path / "bob.h5"), "--json"])
    said, _ = document(capsys)
    assert code in (0, 3)  # the laws of the motion are tested elsewhere
    motion = said["motion"]
    assert not said["ambiguous"]
    assert motion["kind"] == "oscillation"
    assert motion["period"]["value"] == pytest.approx(1.1, rel=1e-3)
    middle = 0.25 * np.exp(-0.03 * 0.5 * 399 / 50)
    amplitude = motion["amplitude"]
    assert abs(amplitude["value"] - middle) < 3 * amplitude["stderr"]
    assert 0.002 * middle < amplitude["stderr"] < 0.05 * middle
    assert (tmp_path / "bob.png").exists()
