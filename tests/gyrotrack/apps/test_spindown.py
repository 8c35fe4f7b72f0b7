"""Motion of one body: kinds, values, claimed uncertainties; the command on tables and films."""

import json
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, least_squares

from fitting import Model
from fitting.discovery import _select
from fitting.discovery._oscillator import OscillatorLaws, Strength
from gyrotrack import TrackingError, import_body
from gyrotrack.apps import _spindown
from gyrotrack.apps._motion import motion_of, start_of_motion
from gyrotrack.apps._spindown import SpindownOptions, read_source
from gyrotrack.apps.cli import _tracking
from gyrotrack.tracking._diagnosis import RefusedFilmError
from gyrotrack.tracking._film import Film
from gyrotrack.tracking._first_look import FirstLook
from gyrotrack.tracking._silhouettes import CompactBody

REAL = Path(__file__).parents[4] / "shared" / "real"


def noisy(t, angle, sigma, seed):
    return angle + np.random.default_rng(seed).normal(0, sigma, len(t)), np.full(len(t), sigma)


def test_spin_down():
    t = np.arange(600) / 100
    angle, sigma = noisy(t, 30 * t - 0.5 * 2.0 * t**2, 2e-3, 1)
    found = motion_of(t, angle, sigma)
    assert found.kind == "spin-down"
    assert found.alpha.value == pytest.approx(-2.0, abs=4 * found.alpha.stderr)
    assert found.alpha.stderr < 0.01
    assert found.omega["first"] == pytest.approx(30, abs=0.05)
    assert found.omega["last"] == pytest.approx(30 - 2 * t[-1], abs=0.05)


def test_speeds_at_the_ends_of_a_long_coast_down():
    """Quadratic drag over two decades: a polynomial through the whole record ends with a negative speed."""
    t = 400 * np.linspace(0, 1, 4000) ** 1.5
    angle, sigma = noisy(t, np.log1p(90 * 0.02 * t) / 0.02, 1e-2, 4)
    found = motion_of(t, angle, sigma)
    assert found.omega["last"] == pytest.approx(90 / (1 + 90 * 0.02 * t[-1]), rel=0.05)
    assert found.omega["first"] == pytest.approx(90, rel=0.2)


@pytest.mark.slow
def test_steady_with_a_hub_out_of_place():
    t = np.arange(250) / 25
    clean = 3.4 * t
    angle, sigma = noisy(t, clean + 0.02 * np.cos(clean + 0.3) + 0.01 * np.sin(2 * clean), 1e-3, 2)
    found = motion_of(t, angle, sigma)
    assert found.kind == "steady"
    assert found.omega_mean.value == pytest.approx(3.4, abs=4 * found.omega_mean.stderr)
    assert found.omega_mean.stderr < 1e-3


def test_oscillation():
    t = np.arange(600) / 30
    angle, sigma = noisy(t, 0.1 * np.exp(-0.01 * t) * np.cos(2 * np.pi * t / 1.47) + 0.3, 1e-3, 3)
    found = motion_of(t, angle, sigma)
    assert found.kind == "oscillation"
    assert found.period.value == pytest.approx(1.47, abs=4 * found.period.stderr)
    assert found.amplitude.value == pytest.approx(0.1 * np.exp(-0.1), rel=0.01)
    assert found.decay.value == pytest.approx(0.01, abs=4 * found.decay.stderr)
    quality = found.quality_factor
    assert quality.value == pytest.approx(np.pi / (0.01 * 1.47), abs=4 * quality.stderr)
    assert quality.stderr / quality.value == pytest.approx(found.decay.stderr / found.decay.value, rel=0.01)


@pytest.mark.parametrize(
    ("rate", "amplitude", "drag"), [(12.0, 1.3, 0.02), pytest.param(40.0, 2.2, 0.05, marks=pytest.mark.slow)]
)
def test_a_pendulum_whose_period_changes_with_its_amplitude(rate, amplitude, drag):
    """The phase of a sinusoid of one frequency slips by turns; period and decay at the middle are exact ones."""
    exact = solve_ivp(
        lambda t, y: [y[1], -rate * np.sin(y[0]) - drag * y[1]],
        (0, 60),
        [amplitude, 0],
        rtol=1e-10,
        atol=1e-12,
        dense_output=True,
    ).sol
    t = np.arange(0, 60, 0.02)
    angle, sigma = noisy(t, exact(t)[0], 2e-3, 4)
    found = motion_of(t, angle, sigma)
    assert found.kind == "oscillation"
    fine = np.linspace(0, 60, 120_001)
    crossing = np.flatnonzero(np.diff(np.sign(exact(fine)[0])))
    at = np.array([brentq(lambda x: exact(x)[0], fine[i], fine[i + 1]) for i in crossing])
    phase = np.polynomial.Polynomial.fit(at, 0.5 * np.arange(len(at)), 9)
    assert found.period.value == pytest.approx(1 / phase.deriv()(t[-1] / 2), rel=2e-4)
    assert found.period.stderr < 2e-4 * found.period.value


def test_an_oscillation_keeps_its_sign(tmp_path):
    t = np.arange(0, 20, 0.02)
    angle = np.cos(3.2 * t) * np.exp(-0.02 * t)
    assert angle[-1] < angle[0]
    path = tmp_path / "swing.csv"
    np.savetxt(path, np.c_[t, angle], delimiter=",", header="t [s],angle [rad]", comments="")
    case = import_body(path, 1.0)
    assert case.extra["sense"] == 1
    assert not any("negative sense" in w for w in case.warnings)


@pytest.mark.slow
@pytest.mark.parametrize(("speed", "factor"), [(23.0, 0.5), (4.0, 3.0)])
def test_halves_of_the_ring_that_differ_widen_the_uncertainty(speed, factor):
    """By half the difference over many turns; over less than two, also by the leverage of a displaced hub."""
    t = np.arange(100) / 75
    angle, sigma = noisy(t, speed * t - 0.2 * t**2, 2e-4, 5)
    series = SimpleNamespace(time=t, sigma=sigma)
    halves = np.stack([angle + 0.02 * t**2, angle - 0.02 * t**2])  # alpha differs by 0.08 rad/s2
    recording = SimpleNamespace(bodies={"casing": SimpleNamespace(time=t)})
    tracked = SimpleNamespace(halves=halves, hub_leverage=3.0, distance_error=0.0)
    plain = motion_of(t, angle, sigma)
    found = _spindown._with_view_errors(plain, series, recording, tracked)
    assert found.alpha.value == plain.alpha.value
    assert found.alpha.stderr == pytest.approx(np.hypot(plain.alpha.stderr, factor * 0.08), rel=0.05)
    tracked.distance_error = 0.2
    scaled = _spindown._with_view_errors(plain, series, recording, tracked).omega_mean
    assert scaled.stderr == pytest.approx(0.2 * scaled.value, rel=0.05)


@pytest.mark.slow
def test_uncertainties_are_those_of_repeated_runs():
    t = np.arange(200) / 50
    truth = 12 * t - 0.5 * 0.8 * t**2
    z = []
    for seed in range(24):
        angle, sigma = noisy(t, truth, 3e-3, seed)
        found = motion_of(t, angle, sigma)
        z.append((found.alpha.value + 0.8) / found.alpha.stderr)
    # a parabola has fewer terms than the polynomials that are averaged
    assert 0.5 < np.std(z) < 1.4


def test_a_hand_at_the_start_is_found():
    t = np.arange(1000) / 100
    speed = np.where(t < 2, 15 * t, 30 - 1.0 * (t - 2))
    angle = np.cumsum(speed) / 100
    first = start_of_motion(t, angle, np.full(len(t), 1e-3))
    assert t[first] == pytest.approx(2.0, abs=0.4)
    assert start_of_motion(t, 30 * t - 0.5 * t**2, np.full(len(t), 1e-3)) == 0
    assert start_of_motion(t, np.sin(t), np.full(len(t), 1e-3)) == 0


@pytest.mark.slow
def test_command_on_a_table(tmp_path, monkeypatch, capsys, program):
    monkeypatch.chdir(tmp_path)
    t = np.arange(400) / 40
    rate = 0.12
    angle = 20 / rate * (1 - np.exp(-rate * t)) + np.random.default_rng(0).normal(0, 1e-3, len(t))
    np.savetxt("wheel.csv", np.stack([t, angle], axis=1), delimiter=",", header="t,angle", comments="")
    code = program(["spindown", "wheel.csv", "-o", "wheel.h5", "--json"])
    document = json.loads(capsys.readouterr().out)
    assert code in (0, 3), document
    assert set(document) >= {"case", "report", "motion", "ladder", "diagnosis"}
    motion = document["motion"]
    assert motion["kind"] == "spin-down"
    assert motion["period"] is None
    truth = -20 * rate * np.exp(-rate * 0.5 * t[-1])
    assert motion["alpha"]["value"] == pytest.approx(truth, rel=0.02)
    assert Path("wheel.h5").is_file()
    assert document["ladder"]
    assert Path(document["report"]).is_file()


@pytest.mark.slow
@pytest.mark.usefixtures("unsearched")
@pytest.mark.release
def test_units_follow_the_inertia(tmp_path, monkeypatch, capsys, program):
    monkeypatch.chdir(tmp_path)
    t = np.arange(200) / 20
    angle = 20 * t - 0.3 * t**2 + 0.002 * t**3 + np.random.default_rng(0).normal(0, 1e-3, len(t))
    np.savetxt("wheel.csv", np.stack([t, angle], axis=1), delimiter=",", header="t,angle", comments="")
    # with an inertia, diagnose and plan write the units that their own tests read
    runs = (
        ([], "rad/s2", "N m", ("fit", "diagnose", "plan", "ladder")),
        (["--inertia", "1"], "N m", "rad/s2 rms", ("fit", "ladder")),
    )
    for inertia, unit, foreign, commands in runs:
        assert program(["spindown", "wheel.csv", "-o", "wheel.h5", "--force", *inertia]) in (0, 3)
        texts = [capsys.readouterr().out]
        for command in commands:
            program([command, "wheel.h5"])
            texts.append(capsys.readouterr().out)
        whole = "\n".join(texts)
        assert unit in whole
        assert foreign not in whole
        assert "casing's" not in whole
        page = Path("wheel.html").read_text(encoding="utf-8")
        if not inertia:
            assert "rad/s²" in page
            assert "N m" not in page.replace("\u00a0", " ")


@pytest.mark.slow
@pytest.mark.usefixtures("unsearched")
def test_a_table_of_points_without_header(tmp_path, monkeypatch, capsys, program):
    monkeypatch.chdir(tmp_path)
    t = np.arange(500) / 50
    angle, _ = noisy(t, 9 * t - 0.3 * t**2, 1e-3, 4)
    np.savetxt("points.txt", np.stack([t, 40 + 5 * np.cos(angle), 30 + 5 * np.sin(angle)], axis=1))
    columns = ["--column", "t=1", "--column", "x=2", "--column", "y=3"]
    program(["spindown", "points.txt", *columns, "--centre", "40,30", "--json"])
    alpha = json.loads(capsys.readouterr().out)["motion"]["alpha"]
    assert alpha["value"] == pytest.approx(-0.6, abs=4 * alpha["stderr"])


@pytest.mark.slow
@pytest.mark.usefixtures("unsearched")
def test_command_on_pulses(tmp_path, monkeypatch, capsys, program):
    monkeypatch.chdir(tmp_path)
    turns = np.arange(0, 60, 0.5)
    a = -0.6
    t = (-25 + np.sqrt(25**2 + 2 * a * 2 * np.pi * turns)) / a  # angle = 25 t + a t^2 / 2
    np.savetxt("pulses.txt", t + np.random.default_rng(0).normal(0, 1e-5, len(t)))
    program(["spindown", "pulses.txt", "--pulses-per-turn", "2", "-o", "p.h5", "--json"])
    motion = json.loads(capsys.readouterr().out)["motion"]
    assert motion["alpha"]["value"] == pytest.approx(a, abs=5 * motion["alpha"]["stderr"] + 1e-3)


@pytest.mark.parametrize("extra", [["--hub", "a,b"], ["--inertia", "-1"]])
def test_wrong_options(tmp_path, monkeypatch, extra, capsys, program):
    monkeypatch.chdir(tmp_path)
    Path("wheel.csv").write_text("t,angle\n0,0\n1,1\n")
    assert program(["spindown", "wheel.csv", *extra]) in (1, 2)
    assert not Path("wheel.h5").exists()


@pytest.mark.parametrize("name", ["film.mpg", "FILM.MTS", "film.gif"])
def test_films_of_all_cameras_are_read_as_films(tmp_path, monkeypatch, name, capsys, program):
    monkeypatch.chdir(tmp_path)
    Path(name).write_bytes(b"no film")
    assert program(["spindown", name]) == 1
    assert "is not a film that can be read" in capsys.readouterr().err


def correlated(rng, n, sigma, frames):
    """Return noise whose neighbours are correlated over a number of frames."""
    share = np.exp(-1 / frames)
    steps = rng.normal(0, sigma * np.sqrt(1 - share**2), n + 20 * frames)
    out = np.zeros(len(steps))
    for k in range(1, len(steps)):
        out[k] = share * out[k - 1] + steps[k]
    return out[-n:]


@pytest.mark.slow
@pytest.mark.release
def test_uncertainties_contain_correlated_errors():
    t = np.arange(300) / 60
    truth = 4 * t - 0.1 * t**2
    rate, mean = [], []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        found = motion_of(t, truth + correlated(rng, len(t), 3e-3, 8), np.full(len(t), 1e-3))
        rate.append((found.alpha.value + 0.2) / found.alpha.stderr)
        mean.append((found.omega_mean.value - (4 - 0.2 * t.mean())) / found.omega_mean.stderr)
    assert 0.4 < np.std(rate) < 1.4
    assert 0.4 < np.std(mean) < 1.4


@pytest.mark.slow
def test_less_than_one_turn_with_a_tilted_camera():
    """The harmonics of the view cannot be told from the motion: they are in the uncertainty."""
    t = np.arange(100) / 50
    truth = 1.5 * t - 0.15 * t**2
    z = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        view = 0.012 * np.cos(truth + rng.uniform(0, 6.3)) + 0.008 * np.cos(2 * truth + rng.uniform(0, 6.3))
        found = motion_of(t, truth + view + rng.normal(0, 1e-3, len(t)), np.full(len(t), 1e-3))
        z.append((found.alpha.value + 0.3) / found.alpha.stderr)
    assert np.sqrt(np.mean(np.square(z))) < 1.5


def test_ends_of_an_oscillation_have_its_speed():
    t = np.arange(600) / 30
    angle, sigma = noisy(t, 0.1 * np.sin(2 * np.pi * t / 1.47), 1e-4, 3)
    assert motion_of(t, angle, sigma).omega["first"] == pytest.approx(0.1 * 2 * np.pi / 1.47, rel=0.01)


def dots(film):
    """Return the mean speed of both dots of the turntable, by a projective view of two concentric circles."""
    places = []
    for frame in film.frames():
        shown = np.where(frame > 170, frame, 0).astype(float)
        y, x = np.mgrid[0:480, 0:600]
        shown[np.hypot(x - 305, y - 240) > 185] = 0
        count, label, size, _ = cv2.connectedComponentsWithStats((shown > 0).astype(np.uint8))
        row = []
        for k in range(1, count):
            if 150 < size[k, cv2.CC_STAT_AREA] < 700:
                here = (label == k) * shown
                row.append((np.sum(here * x) / here.sum(), np.sum(here * y) / here.sum()))
        places.append(sorted(row, key=lambda p: np.hypot(p[0] - 305, p[1] - 240)))
    seen = np.array(places)
    t = np.arange(len(seen)) / 25

    def view(c):
        out = []
        for radius, phase in ((1.0, c[8]), (c[9], c[10])):
            u, v = radius * np.cos(phase + c[11] * t), radius * np.sin(phase + c[11] * t)
            depth = 1 + c[6] * u + c[7] * v
            out.append(
                np.stack([c[0] + c[1] * u + c[2] * v, c[3] + c[2] * u + c[5] * v], axis=1) / depth[:, None]
            )
        return (np.stack(out, axis=1) - seen).ravel()

    phases = [np.arctan2(*(seen[0, k] - [305, 240])[::-1]) for k in (0, 1)]
    start = [305, 105, 0, 240, 0, 105, 0, 0, phases[0], 1.6, phases[1], 3.4]
    fit = least_squares(view, start, x_scale=np.maximum(np.abs(start), 0.01))
    return fit.x[11]


@pytest.mark.slow
@pytest.mark.usefixtures("unsearched")
@pytest.mark.release
def test_a_film_that_shows_two_rotations_ends_with_exit_code_3(tmp_path, monkeypatch, capsys, program):
    """Three equal arms that turn by 66 to 40 degrees a frame look like +54 to +80; both are stated, one is taken."""
    monkeypatch.chdir(tmp_path)
    fps, omega, alpha = 30, 34.6, -4.5
    film = cv2.VideoWriter("spinner.mp4", cv2.VideoWriter_fourcc(*"mp4v"), fps, (200, 200))
    rng = np.random.default_rng(0)
    for k in range(90):
        t = k / fps
        psi = 0.4 + omega * t + 0.5 * alpha * t**2
        picture = np.full((200, 200), 160, np.uint8)
        for arm in range(3):
            a = psi + arm * 2 * np.pi / 3
            place = (round(16 * (100 + 48 * np.cos(a))), round(16 * (100 + 48 * np.sin(a))))
            cv2.line(picture, (1600, 1600), place, 70, 24, cv2.LINE_AA, 4)
            cv2.circle(picture, place, 24 * 16, 70, -1, cv2.LINE_AA, 4)
            cv2.circle(picture, place, 12 * 16, 220, -1, cv2.LINE_AA, 4)
        noisy_picture = np.clip(picture + rng.normal(0, 3, picture.shape), 0, 255).astype(np.uint8)
        film.write(cv2.cvtColor(noisy_picture, cv2.COLOR_GRAY2BGR))
    film.release()
    code = program(["spindown", "spinner.mp4", "-o", "s.h5", "--json"])
    captured = capsys.readouterr()
    document = json.loads(captured.out)
    assert code == 3
    assert document["ambiguous"]
    assert "looks the same when rotated by 120 degrees" in captured.err
    found = document["motion"]["alpha"]
    assert found["value"] == pytest.approx(alpha, abs=4 * found["stderr"])
    assert found["stderr"] < 0.02


@pytest.mark.slow
@pytest.mark.skipif(not REAL.is_dir(), reason="no films of others")
def test_turntable(measured_film):
    source = REAL / "turntable" / "turntable_33rpm.mp4"
    code, document, err, _ = measured_film(source)
    motion = document["motion"]
    assert code == 0
    assert "container" in err
    assert motion["kind"] == "steady"
    assert document["diagnosis"] is None  # a steady rotation shows no torque
    found = motion["omega_mean"]
    assert found["stderr"] < 0.01
    assert found["value"] == pytest.approx(dots(Film(source)), abs=3 * found["stderr"])
    # a simple track of the two dots, without perspective, gives 3.38 +- 0.01
    assert found["value"] == pytest.approx(3.38, abs=3 * np.hypot(0.01, found["stderr"]))


@pytest.mark.slow
@pytest.mark.skipif(not REAL.is_dir(), reason="no films of others")
def test_wheel(measured_film):
    code, document, _, _ = measured_film(REAL / "bicycle_wheel_300fps.mp4", "--capture-fps", "300")
    motion = document["motion"]
    assert code == 0
    assert motion["kind"] == "spin-down"
    assert motion["alpha"]["value"] == pytest.approx(-0.402, abs=np.hypot(0.018, motion["alpha"]["stderr"]))
    assert motion["alpha"]["stderr"] < 0.08
    assert motion["omega"]["first"] == pytest.approx(22.957, abs=np.hypot(0.03, motion["omega_u"]["first"]))
    assert motion["omega_u"]["first"] < 0.08


@pytest.mark.slow
@pytest.mark.skipif(not REAL.is_dir(), reason="no films of others")
def test_trifilar():
    """Period and amplitude of the table agree with the points of another tracker."""
    folder = REAL / "trifilar"
    series = read_source(folder / "trifilar_720p.mp4", SpindownOptions()).case.casing
    motion = motion_of(series.time, series.angle, series.sigma)
    assert motion.kind == "oscillation"
    outer, inner = (
        np.loadtxt(folder / name, delimiter=",", skiprows=1) for name in ("centre_dot.csv", "Point_1.csv")
    )
    arm = (outer[:, 1] - inner[:, 1]) + 1j * (outer[:, 2] - inner[:, 2])
    angle = -np.unwrap(np.angle(arm))
    fresh = np.flatnonzero(np.abs(np.diff(outer[:, 1:], axis=0)).max(axis=1) > 0.02) + 1  # no repeated frames
    theirs = motion_of(fresh / 30, angle[fresh], np.full(len(fresh), 1e-3))
    assert motion.period.value == pytest.approx(theirs.period.value, rel=5e-4)
    assert motion.amplitude.value == pytest.approx(theirs.amplitude.value, rel=0.005)


@pytest.mark.slow
@pytest.mark.skipif(not REAL.is_dir(), reason="no films of others")
@pytest.mark.release
def test_two_bodies_about_one_axis():
    """By the picture, most of which turns with the casing; a selected body is that of `extract`."""
    film = REAL / "pathtraced" / "casing_wood.mp4"
    case = read_source(film, SpindownOptions()).case
    assert any("flickers by 3 % rms" in w for w in (*case.warnings, *case.recordings["casing"].warnings))
    series = case.casing
    motion = motion_of(series.time, series.angle, series.sigma)
    truth = np.genfromtxt(film.with_suffix(".csv"), delimiter=",", names=True)
    assert motion.omega_mean.value == pytest.approx(truth["omega_casing_rad_s"].mean(), rel=0.01)


def test_two_bodies_are_not_tracked_as_the_papers_gyroscope(monkeypatch):
    """Markers of equal colour on two bodies are no markers of one: the user selects a body."""

    def two(*_):
        raise RefusedFilmError("Two bodies turn.", "Give --hub X,Y.", kind="two bodies", evidence={})

    def never(*_, **__):
        pytest.fail("the film is tracked by its markers")

    film = SimpleNamespace(info=SimpleNamespace(tag_fps=30.0))
    monkeypatch.setattr(_spindown, "Film", lambda _: film)
    monkeypatch.setattr(_spindown, "first_look", lambda _: FirstLook((0, 0)))
    monkeypatch.setattr(_spindown, "film_recording", two)
    monkeypatch.setattr(_spindown, "extract", never)
    with pytest.raises(RefusedFilmError):
        _spindown._film(Path("two.mp4"), _spindown.SpindownOptions(), None)


@pytest.mark.parametrize("swing", [0.02, 0.23])
def test_coloured_things_at_rest_are_not_the_papers_markers(monkeypatch, swing):
    """A red shirt was tracked as the casing of a gyroscope at rest, and a hand with a motor as one that turns."""

    def none(*_, **__):
        raise TrackingError("No body that turns about a hub is found.", "Give --hub X,Y.")

    class Frames:
        info = SimpleNamespace(tag_fps=30.0)
        stabilised = False

        def __len__(self):
            return 200

    shirt = SimpleNamespace(time=np.arange(200) / 30, angle=swing * np.sin(np.arange(200)))
    found = SimpleNamespace(bodies={"casing": shirt})
    monkeypatch.setattr(_spindown, "Film", lambda _: Frames())
    monkeypatch.setattr(_spindown, "first_look", lambda _: FirstLook((0, 0)))
    monkeypatch.setattr(_spindown, "film_recording", none)
    monkeypatch.setattr(_spindown, "point_recording", none)
    monkeypatch.setattr(_spindown, "extract", lambda *_, **__: found)
    with pytest.raises(TrackingError, match="No body that turns"):
        _spindown._film(Path("shirt.mp4"), _spindown.SpindownOptions(), None)


def coast_down(path):
    t = np.arange(400) / 100
    angle, _ = noisy(t, 30 * t - 0.5 * 2.0 * t**2, 2e-3, 1)
    path.write_text("t,angle\n" + "".join(f"{a:.4f},{b:.6f}\n" for a, b in zip(t, angle, strict=True)))


@pytest.mark.slow
def test_an_interrupted_command_can_be_repeated_as_it_is(tmp_path, monkeypatch, capsys, program):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    coast_down(tmp_path / "wheel.csv")
    monkeypatch.setattr(_select, "improve", interrupted)
    assert program(["spindown", "wheel.csv"]) == 130
    assert "Interrupted" in capsys.readouterr().err
    assert not list(tmp_path.glob("*.h5"))


def test_at_most_three_alternative_sets_of_laws_are_listed():
    def lines(count):
        classes = tuple((f"casing.{k}",) for k in range(count))
        laws = SimpleNamespace(
            restoring=classes[0],
            restoring_classes=classes[:1],
            damping=classes[0],
            damping_classes=classes,
            parameters={},
        )
        return _tracking._oscillator_lines(laws)[1]

    assert lines(4).endswith("(or casing.1 or casing.2 or casing.3)")
    assert lines(8).endswith("(or casing.1 or casing.2 or casing.3 or 4 more)")


def test_a_fit_that_contradicts_the_averaged_equations_is_stated():
    spring, cubic = ("casing.spring.linear",), ("casing.spring.linear", "casing.spring.cubic")
    strength = Strength(12.0, 0.1, "rad/s2")
    laws = OscillatorLaws(spring, (), (spring, cubic), ((),), {"casing.spring.linear.k": strength})
    exact = SimpleNamespace(value=12.01, stderr=0.002, unit="rad/s2")
    same, nothing = laws.with_fit(
        SimpleNamespace(model=Model.of(spring), estimates={"casing.spring.linear.k": exact})
    )
    assert nothing == ""
    assert same.parameters == {"casing.spring.linear.k": Strength(12.01, 0.002, "rad/s2", approximate=False)}
    assert _tracking._oscillator_lines(laws)[0].startswith(
        "restoring  casing.spring.linear.k about 12.00 +- 0.10 rad/s2 (or"
    )
    assert "k = 12.0100 +- 0.0020 rad/s2" in _tracking._oscillator_lines(same)[0]
    kept, sentence = laws.with_fit(SimpleNamespace(model=Model.of(["casing.gravity"]), estimates={}))
    assert kept == laws
    assert "restoring torque of the fitted model is casing.gravity" in sentence


def _exact(value, stderr):
    return SimpleNamespace(
        model=Model.of(["casing.spring.linear"]),
        estimates={"casing.spring.linear.k": SimpleNamespace(value=value, stderr=stderr, unit="rad/s2")},
    )


@pytest.mark.parametrize(
    ("value", "stderr", "kept"),
    [
        (14.3, 0.01, False),  # 19 %: the error of averaged equations
        (14.5, 0.01, True),  # 21 %, and 25 standard uncertainties
        (14.5, 0.6, False),  # 4 standard uncertainties
        (0.0, np.nan, True),  # at its bound
    ],
)
def test_a_strength_that_contradicts_amplitude_and_phase_does_not_replace_theirs(value, stderr, kept):
    spring = ("casing.spring.linear",)
    strength = Strength(12.0, 0.1, "rad/s2")
    laws = OscillatorLaws(spring, (), (spring,), ((),), {"casing.spring.linear.k": strength})
    found, sentence = laws.with_fit(_exact(value, stderr))
    assert (found == laws) is kept
    assert ("which are shown" in sentence) is kept
    assert ("the measured period requires 12 rad/s2" in laws.wrong_period(_exact(value, stderr))) is kept


def test_a_wrong_damping_does_not_change_the_period():
    spring, dry = ("casing.spring.linear",), ("touchpoint.constant",)
    strengths = {
        "casing.spring.linear.k": Strength(12.0, 0.1, "rad/s2"),
        "touchpoint.constant.b1": Strength(0.01, 1e-4, "rad/s2"),
    }
    laws = OscillatorLaws(spring, dry, (spring,), (dry,), strengths)
    exact = {k: SimpleNamespace(value=v.value, stderr=v.stderr, unit=v.unit) for k, v in strengths.items()}
    exact["touchpoint.constant.b1"].value = 0.0
    fitted = SimpleNamespace(model=Model.of([*spring, *dry]), estimates=exact)
    assert laws.with_fit(fitted)[1] != ""
    assert laws.wrong_period(fitted) == ""


@pytest.mark.slow
def test_the_uncertainty_of_a_period_is_true_where_the_damping_is_not_that_of_the_model():
    """Friction of the square of the speed changes the amplitude unlike any exponential; noise alone is 1 mrad."""
    pulls = []
    for seed in range(6):
        t = np.arange(0, 40, 0.02)
        run = solve_ivp(
            lambda t, y: [y[1], -12 * y[0] - 0.05 * abs(y[1]) * y[1]],
            (0, 40), [1.0 + 0.05 * seed, 0.0], t_eval=t, rtol=1e-10, atol=1e-12,
        )  # fmt: skip
        found = motion_of(t, *noisy(t, run.y[0], 2e-3, seed))
        # averaged over a period, damping changes the period in second order only
        pulls.append((found.period.value - 2 * np.pi / np.sqrt(12)) / found.period.stderr)
        assert found.period.stderr < 3e-4
    assert np.sqrt(np.mean(np.square(pulls))) < 1.6


CASES = Path(__file__).parents[4] / "shared" / "cases" / "tables"


def _said(program, capsys, *arguments):
    code = program(["spindown", *map(str, arguments), "--json"])
    return code, json.loads(capsys.readouterr().out)


def _pendulum(tmp_path, law):
    """Write 20 periods of a pendulum released at 1.4 rad, with dry friction of 0.07 rad/s2 and noise of 2 mrad."""
    t = np.arange(0, 22, 1 / 40)
    run = solve_ivp(
        lambda t, y: [y[1], law(*y) - 0.07 * np.tanh(y[1] / 1e-3)],
        (0, 22), [1.4, 0.0], t_eval=t, rtol=1e-9, atol=1e-10, method="LSODA",
    )  # fmt: skip
    angle = noisy(t, run.y[0], 2e-3, 3)[0]
    path = tmp_path / "pendulum.csv"
    np.savetxt(path, np.c_[t, angle], delimiter=",", header="t [s],theta [rad]", comments="")
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("quadratic", "viscous", "damping"),
    [
        (0.0, 0.05, {"touchpoint.constant", "casing.air.linear"}),
        (0.01, 0.0, {"touchpoint.constant", "casing.air.quadratic"}),
    ],
)
@pytest.mark.release
def test_gravity_and_two_kinds_of_friction_are_named_together(
    tmp_path, capsys, monkeypatch, program, quadratic, viscous, damping
):
    monkeypatch.chdir(tmp_path)
    path = _pendulum(tmp_path, lambda x, v: -37.2 * np.sin(x) - (quadratic * abs(v) + viscous) * v)
    code, found = _said(program, capsys, path)
    assert code == 0
    assert found["oscillator"]["restoring"] == ["casing.gravity"]
    assert set(found["oscillator"]["damping"]) == damping
    assert [step["added"] for step in found["ladder"]] == [""]
    assert found["diagnosis"]["verdict"] == "adequate"
    strength = found["oscillator"]["parameters"]["casing.gravity.k"]
    assert strength["value"] == pytest.approx(37.2, abs=4 * strength["stderr"])


@pytest.mark.slow
@pytest.mark.skipif(not CASES.exists(), reason="the shared cases are not here")
def test_a_computed_table_is_described(tmp_path, capsys, monkeypatch, program):
    monkeypatch.chdir(tmp_path)
    code, exact = _said(program, capsys, CASES / "exact.csv")
    assert (code, exact["diagnosis"]["verdict"], len(exact["ladder"])) == (0, "adequate", 1)


@pytest.mark.slow
@pytest.mark.skipif(not CASES.exists(), reason="the shared cases are not here")
@pytest.mark.release
def test_cases_of_oscillators(tmp_path, capsys, monkeypatch, program):
    monkeypatch.chdir(tmp_path)
    _, found = _said(program, capsys, CASES / "pendulum_94deg.csv")
    values = {k: v["value"] for k, v in found["oscillator"]["parameters"].items()}
    assert values == pytest.approx(
        {"casing.gravity.k": 37.2, "touchpoint.constant.b1": 0.067, "casing.air.quadratic.k": 0.0033},
        rel=0.01,
    )


@pytest.mark.slow
@pytest.mark.skipif(not CASES.exists(), reason="the shared cases are not here")
@pytest.mark.usefixtures("unsearched")
@pytest.mark.release
def test_an_oscillator_whose_period_drifts(tmp_path, capsys, monkeypatch, program):
    """A kink after 9 s, and a period that shortens from 15.5 to 14 s: no further law describes that either."""
    monkeypatch.chdir(tmp_path)
    code, found = _said(program, capsys, CASES / "title_line.txt", "--column", "angle=2")
    period = found["motion"]["period"]
    assert code == 3
    assert abs(period["value"] - 15) < 2 * period["stderr"]
    assert all(v["approximate"] for v in found["oscillator"]["parameters"].values())


@pytest.mark.slow
@pytest.mark.parametrize(("periods", "searched"), [(12, True), (130, False)])
@pytest.mark.release
def test_an_oscillation_of_hundreds_of_reversals_is_not_searched_for_further_laws(
    tmp_path, capsys, monkeypatch, program, unsearched, periods, searched
):
    """A dry friction that begins halfway is no law of the list; 12 periods would be searched for it."""
    monkeypatch.chdir(tmp_path)
    t = np.arange(0, periods * 2 * np.pi / 5, 0.05)
    size = 0.06 if searched else 0.02
    later = 0.5 * t[-1]
    run = solve_ivp(
        lambda t, y: [y[1], -25 * y[0] - 0.6 / t_end * y[1] - size * (t > later) * np.tanh(y[1] / 1e-3)],
        (0, t_end := float(t[-1])), [1.0, 0.0], t_eval=t, rtol=1e-8, atol=1e-9, max_step=0.05, method="LSODA",
    )  # fmt: skip
    angle = noisy(t, run.y[0], 2e-3, 5)[0]
    np.savetxt("s.csv", np.c_[t, angle], delimiter=",", header="t [s],theta [rad]", comments="")
    _, found = _said(program, capsys, "s.csv")
    assert found["oscillator"]["restoring"] == ["casing.spring.linear"]
    assert unsearched == [None if searched else 0]
    assert any("no law was fitted except" in w for w in found["warnings"]) is not searched


@pytest.mark.parametrize("hub", [None, (80.0, -100.0), (80.0, 10.0)])
@pytest.mark.parametrize(("alone", "way"), [(0.9, "point"), (0.4, "ring")])
def test_a_body_that_alone_moves_on_an_arc_is_followed_as_a_point(monkeypatch, hub, alone, way):
    """The tracker of textures takes minutes where the pivot is outside the picture, and has larger errors inside."""
    place = np.stack([80 + 60 * np.sin(np.arange(30)), np.full(30, 60.0)], axis=1)
    place += np.random.default_rng(0).normal(0, 0.3, place.shape)
    look = FirstLook((120, 160), CompactBody(8.0, place, alone))
    found = SimpleNamespace(width=160, height=120)
    ring = SimpleNamespace(ring=SimpleNamespace(hub=(80.0, 10.0)))
    monkeypatch.setattr(_spindown, "Film", lambda _: SimpleNamespace(info=SimpleNamespace(tag_fps=30.0)))
    monkeypatch.setattr(_spindown, "first_look", lambda _: look)
    monkeypatch.setattr(_spindown, "point_recording", lambda *_: (found, "point"))
    monkeypatch.setattr(_spindown, "film_recording", lambda *_: (found, ring))
    _, (_, tracked) = _spindown._film(Path("ball.mp4"), _spindown.SpindownOptions(hub=hub), None)
    assert tracked == ("point" if way == "point" else ring)


def test_a_failed_trial_of_the_papers_markers_leaves_the_film_to_other_trackers(monkeypatch):
    """A drawn pendulum at rest made the prediction of its angle singular, and the command stopped there."""

    def singular(*_, **__):
        raise np.linalg.LinAlgError("Singular matrix")

    film = SimpleNamespace(info=SimpleNamespace(tag_fps=30.0))
    monkeypatch.setattr(_spindown, "is_coloured", lambda _: True)
    monkeypatch.setattr(_spindown, "extract", singular)
    assert _spindown._papers_markers(Path("drawn.gif"), film, _spindown.SpindownOptions(), None) is None


@pytest.mark.parametrize(
    ("verdict", "last"),
    [("adequate", True), ("missing_effect", True), ("undecided", False), ("unexplained", False)],
)
def test_laws_of_the_body_are_established(verdict, last):
    steps = [SimpleNamespace(fit=name) for name in ("base", "with a step")]
    assert _spindown._supported("base", steps, verdict) == ("with a step" if last else "base")


@pytest.mark.parametrize(("interlaced", "rate"), [(True, 60.0), (False, 30.0)])
def test_a_frame_of_an_interlaced_film_holds_two_pictures(interlaced, rate):
    fps, origin, warnings = _spindown._rate(SimpleNamespace(interlaced=interlaced), 30.0)
    assert (fps, origin) == (rate, "--capture-fps")
    assert any("60 fields" in w for w in warnings) == interlaced
