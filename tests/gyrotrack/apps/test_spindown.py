"""Motion of one body: kinds, values, claimed uncertainties; the command on tables and films."""

import json
from pathlib import Path

import numpy as np
import pytest

from gyrotrack.apps._spindown import motion_of, start_of_motion
from gyrotrack.apps.cli import _app as app

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


def test_uncertainties_are_those_of_repeated_runs():
    t = np.arange(200) / 50
    truth = 12 * t - 0.5 * 0.8 * t**2
    z = []
    for seed in range(40):
        angle, sigma = noisy(t, truth, 3e-3, seed)
        found = motion_of(t, angle, sigma)
        z.append((found.alpha.value + 0.8) / found.alpha.stderr)
    assert 0.7 < np.std(z) < 1.4


def test_a_hand_at_the_start_is_found():
    t = np.arange(1000) / 100
    speed = np.where(t < 2, 15 * t, 30 - 1.0 * (t - 2))
    angle = np.cumsum(speed) / 100
    first = start_of_motion(t, angle, np.full(len(t), 1e-3))
    assert t[first] == pytest.approx(2.0, abs=0.4)
    assert start_of_motion(t, 30 * t - 0.5 * t**2, np.full(len(t), 1e-3)) == 0
    assert start_of_motion(t, np.sin(t), np.full(len(t), 1e-3)) == 0


@pytest.mark.slow
def test_command_on_a_table(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    t = np.arange(400) / 40
    rate = 0.12
    angle = 20 / rate * (1 - np.exp(-rate * t)) + np.random.default_rng(0).normal(0, 1e-3, len(t))
    np.savetxt("wheel.csv", np.stack([t, angle], axis=1), delimiter=",", header="t,angle", comments="")
    code = app.run(["spindown", "wheel.csv", "-o", "wheel.h5", "--json"])
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
def test_command_on_pulses(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    turns = np.arange(0, 60, 0.5)
    a = -0.6
    t = (-25 + np.sqrt(25**2 + 2 * a * 2 * np.pi * turns)) / a  # angle = 25 t + a t^2 / 2
    np.savetxt("pulses.txt", t + np.random.default_rng(0).normal(0, 1e-5, len(t)))
    app.run(["spindown", "pulses.txt", "--pulses-per-turn", "2", "-o", "p.h5", "--json"])
    motion = json.loads(capsys.readouterr().out)["motion"]
    assert motion["alpha"]["value"] == pytest.approx(a, abs=5 * motion["alpha"]["stderr"] + 1e-3)


@pytest.mark.parametrize("extra", [["--hub", "a,b"], ["--inertia", "-1"]])
def test_wrong_options(tmp_path, monkeypatch, extra, capsys):
    monkeypatch.chdir(tmp_path)
    Path("wheel.csv").write_text("t,angle\n0,0\n1,1\n")
    assert app.run(["spindown", "wheel.csv", *extra]) in (1, 2)
    assert not Path("wheel.h5").exists()


@pytest.mark.slow
@pytest.mark.skipif(not REAL.is_dir(), reason="no films of others")
def test_turntable(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    app.run(["spindown", str(REAL / "turntable" / "turntable_33rpm.mp4"), "-o", "t.h5", "--json"])
    captured = capsys.readouterr()
    motion = json.loads(captured.out)["motion"]
    assert "container" in captured.err
    assert motion["kind"] == "steady"
    # both dots come back to their place after 46.15 +- 0.05 frames of 25 a second, whatever the camera's tilt
    assert motion["omega_mean"]["value"] == pytest.approx(3.403, abs=0.007)


@pytest.mark.slow
@pytest.mark.skipif(not REAL.is_dir(), reason="no films of others")
def test_wheel(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    film = str(REAL / "bicycle_wheel_300fps.mp4")
    app.run(["spindown", film, "--capture-fps", "300", "-o", "w.h5", "--json"])
    motion = json.loads(capsys.readouterr().out)["motion"]
    assert motion["alpha"]["value"] == pytest.approx(-0.396, abs=0.05)
