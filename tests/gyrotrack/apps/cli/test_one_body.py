"""A wheel from a table to a report: no command asks for its rotor."""

import html
import re

import h5py
import numpy as np
import pytest


@pytest.fixture
def wheel(tmp_path):
    """A table of a wheel that loses speed by dry and by quadratic friction, in turns a minute."""
    t = np.arange(0, 30, 0.02)
    a, b = np.sqrt(2e-4 * 4e-7), 2e-3  # I dw/dt = -c - k w^2: w = sqrt(c/k) tan(phi - sqrt(ck)/I t)
    w = np.sqrt(2e-4 / 4e-7) * np.tan(np.arctan(60 / np.sqrt(2e-4 / 4e-7)) - a / b * t)
    rng = np.random.default_rng(3)
    path = tmp_path / "wheel.csv"
    rows = zip(t, -(w + rng.normal(0, 0.03, len(t))) * 30 / np.pi, strict=True)
    path.write_text("time [s];speed [rpm]\n" + "".join(f"{x:.3f};{y:.6f}\n" for x, y in rows))
    return path


@pytest.mark.slow
@pytest.mark.release
def test_a_wheel(gyrotrack, wheel, tmp_path):
    case = tmp_path / "wheel.h5"
    said = gyrotrack("import", "--body", wheel, "--inertia", "2e-3", "-o", case, "--json")
    assert said.code == 0
    assert said.json["sense"] == -1
    assert said.json["casing"]["omega_max"] == pytest.approx(60, rel=0.01)
    assert said.json["casing"]["median_sigma"] == pytest.approx(0.03, rel=0.1)  # of the speeds [rad/s]
    said = gyrotrack("info", case, "--verify", "--json")
    assert said.json["sound"]
    assert said.json["bodies"] == "one"
    assert said.json["casing"]["median_sigma"] == pytest.approx(0.03, rel=0.1)
    assert gyrotrack("fit", case).code == 0
    said = gyrotrack("improve", case, "--json")
    assert said.json["verdict"] == "missing_effect"
    k = said.json["final"]["parameters"]["casing.air.quadratic.k"]
    assert abs(k["value"] - 4e-7) < 4 * k["stderr"]
    assert said.json["final"]["cases"][0]["rotor"]["rmse"] is None
    assert "rotor" not in gyrotrack("fit", case, "--add", "casing: -q*omega_c**3").out
    assert gyrotrack("export", case, "-o", tmp_path / "w.csv", "--json").json["rows"] == 1500
    assert gyrotrack("report", case, "-o", tmp_path / "w.html").code == 0
    page = (tmp_path / "w.html").read_text()
    assert "body 1500;" in page
    shown = html.unescape(re.sub(r"<[^>]+>", " ", page))
    for verb in ("info", "fit", "diagnose", "ladder"):
        said = gyrotrack(verb, case)
        assert said.code == 0
        shown += said.out
    assert "near the peak speed of the body" in shown
    assert "rmse of the angular rate of the body" in shown
    # the names of laws begin with the joint that they act on; no sentence speaks of a casing or a rotor
    shown = shown.replace('"body":"casing"', "")  # a key of the charts
    assert not re.findall(r".{30}(?<!-)\b(?:[Cc]asing|[Rr]otor)\b(?!\.[a-z]|:).{30}", shown)
    said = gyrotrack("fit", case, "--add", "bearing.linear")
    assert said.code == 1
    assert "needs rotor data" in said.err


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["--body", "w.csv", "--inertia", "1", "--rotor", "r.csv"],
        ["--casing", "w.csv", "--inertia", "1"],
    ],
)
def test_half_of_what_is_needed(gyrotrack, tmp_path, words):
    said = gyrotrack("import", *words, "-o", tmp_path / "c.h5")
    assert said.code == 2
    assert "or --body" in said.err


@pytest.mark.slow
def test_body_without_inertia(gyrotrack, wheel, tmp_path):
    """No moment of inertia is invented: torques are per unit of inertia, and say so; with one they are in N m."""
    case = tmp_path / "w.h5"
    said = gyrotrack("import", "--body", wheel, "-o", case)
    assert said.code == 0
    assert "torques are per unit of inertia, in rad/s2" in said.err
    assert "unknown; torques are per unit of inertia" in gyrotrack("info", case).out
    alone = gyrotrack("fit", case, "--json").json["parameters"]["touchpoint.constant.b1"]
    assert alone["unit"] == "rad/s2"
    said = gyrotrack("import", "--body", wheel, "--inertia", "2e-3", "-o", case, "--force")
    assert "per unit of inertia" not in said.err
    known = gyrotrack("fit", case, "--json").json["parameters"]["touchpoint.constant.b1"]
    assert known["unit"] == "N m"
    assert alone["value"] == pytest.approx(known["value"] / 2e-3, rel=1e-6)


@pytest.mark.slow
def test_prior_from_another_study(gyrotrack, wheel, tmp_path):
    """The first half of a run is the prior of the second; it is in the output, the JSON and the ledger."""
    first, second = tmp_path / "first.h5", tmp_path / "second.h5"
    for case, limits in ((first, ("--to", "15")), (second, ("--from", "15"))):
        assert gyrotrack("import", "--body", wheel, "--inertia", "2e-3", "-o", case, *limits).code == 0
    add = ("--add", "casing.air.quadratic", "--drop", "casing.air.linear", "--json")
    known = gyrotrack("fit", first, *add).json["parameters"]["casing.air.quadratic.k"]
    alone = gyrotrack("fit", second, *add).json["parameters"]["casing.air.quadratic.k"]
    said = gyrotrack("fit", second, "--from", "f2", "--prior", first, "--json")
    found = said.json["parameters"]["casing.air.quadratic.k"]
    assert said.json["prior"]["names"] == ["touchpoint.constant.b1", "casing.air.quadratic.k"]
    assert said.json["prior"]["mean"][1] == pytest.approx(known["value"])
    assert said.json["prior"]["covariance"][1][1] ** 0.5 == pytest.approx(known["stderr"])
    assert found["stderr"] < min(known["stderr"], alone["stderr"])
    assert abs(found["value"] - 4e-7) < 4 * found["stderr"]
    # a fit that continues keeps the prior
    again = gyrotrack("fit", second, "--from", "f3")
    assert "prior from first.h5 (f2): touchpoint.constant.b1" in again.out
    said = gyrotrack("fit", second, "--prior", second)
    assert said.code == 2
    assert "use these data twice" in said.err


@pytest.mark.slow
def test_a_wheel_that_rolls_with_the_priors_of_each_body(gyrotrack, tmp_path):
    """Drum and wheel alone, then in contact: the drag of the wheel is known, the rolling resistance is found."""
    rng = np.random.default_rng(5)
    drum, wheel, n = 2.0, 0.1, 2.5

    def table(name, **columns):
        path = tmp_path / name
        lines = [
            ",".join(columns),
            *(",".join(f"{v:.6f}" for v in row) for row in zip(*columns.values(), strict=True)),
        ]
        path.write_text("\n".join(lines), encoding="utf-8")
        return path

    def noisy(angle):
        return angle + 2e-3 * rng.standard_normal(len(angle))

    def coast(t, start, inertia, friction, drag):
        held, rate = friction / drag, drag / inertia
        return (start + held) * (1 - np.exp(-rate * t)) / rate - held * t

    t = np.arange(0.0, 60.0, 0.05)
    alone = {
        "drum": (table("drum.csv", t=t, angle=noisy(coast(t, 30.0, drum, 0.1, 0.01))), drum),
        "wheel": (table("wheel.csv", t=t, angle=noisy(coast(t, 80.0, wheel, 0.01, 1e-3))), wheel),
    }
    for name, (path, inertia) in alone.items():
        case = tmp_path / f"{name}.h5"
        assert (
            gyrotrack("import", "--body", path, "--inertia", str(inertia), "-o", case, "--keep-all").code == 0
        )
        assert gyrotrack("fit", case).code == 0
    rolled = coast(t, 30.0, drum + n**2 * wheel, 0.1 + n * (0.01 + 0.05), 0.01 + n**2 * 1e-3)
    both = table("both.csv", t=t, slow=noisy(rolled), fast=noisy(n * rolled))
    case = tmp_path / "both.h5"
    names = ["casing.angle=slow", "rotor.angle=fast", "t=t"]
    options = [word for name in names for word in ("--column", name)]
    inertias = ("--inertia-casing", str(drum), "--inertia-rotor", str(wheel))
    said = gyrotrack("import", "--casing", both, "--rotor", both, *options, *inertias, "-o", case)
    assert said.code == 0, said.err
    model = tmp_path / "rolling.toml"
    effects = ["contact.rolling", "rotor.air.linear", "touchpoint.constant", "casing.air.linear"]
    law = '[[effect]]\nname = "resistance"\nbody = "rotor"\nlaw = "-k*sign(omega_r)"\n'
    model.write_text(f"effects = {effects}\n".replace("'", '"') + law, encoding="utf-8")
    priors = ("--prior", tmp_path / "drum.h5", "--prior-rotor", tmp_path / "wheel.h5")
    said = gyrotrack("fit", case, "--model", model, *priors, "--json")
    assert said.code == 0, said.err
    assert "drum.h5 (f1) and wheel.h5 (f1)" in said.json["prior"]["source"]
    assert "rotor.air.linear.a1" in said.json["prior"]["names"]
    found = said.json["parameters"]
    for key, true in {"contact.rolling.n": n, "resistance.k": 0.06, "rotor.air.linear.a1": 1e-3}.items():
        assert abs(found[key]["value"] - true) < 4 * found[key]["stderr"], key
    assert found["resistance.k"]["stderr"] < 0.01
    said = gyrotrack("fit", case, "--prior", tmp_path / "drum.h5", "--prior-rotor", tmp_path / "drum.h5")
    assert said.code == 2
    assert "study of both bodies" in said.err
    said = gyrotrack("plan", case)
    assert said.code == 1
    assert "roll on each other" in said.err


def test_a_prior_in_other_units_is_refused(gyrotrack, wheel, tmp_path):
    ratio, case = tmp_path / "ratio.h5", tmp_path / "case.h5"
    assert gyrotrack("import", "--body", wheel, "--inertia", "2e-3", "-o", case, "--from", "15").code == 0
    assert gyrotrack("import", "--body", wheel, "--inertia", "1", "-o", ratio, "--to", "15").code == 0
    with h5py.File(ratio, "r+") as file:
        file.attrs["per_inertia"] = 1
    assert gyrotrack("fit", ratio).code == 0
    said = gyrotrack("fit", case, "--prior", ratio)
    assert said.code == 2
    assert "in s-1, but these cases need N m s" in said.err


def pulses(path, per_turn, rng, start=60.0, slowing=1.5, last=20.0, jitter=1e-5):
    """Write pulses of a wheel that slows down evenly; return turns, times without jitter and speeds."""
    whole = (start**2 - last**2) / (2 * slowing) * per_turn / (2 * np.pi)
    turned = 2 * np.pi * np.arange(int(whole)) / per_turn
    omega = np.sqrt(start**2 - 2 * slowing * turned)
    time = (start - omega) / slowing
    path.write_text("t\n" + "".join(f"{x:.9f}\n" for x in time + jitter * rng.standard_normal(len(time))))
    return turned, time, omega


def information(time, omega, jitter=1e-5):
    """Return the standard uncertainty of the deceleration, with start angle and start speed free [rad/s2]."""
    design = np.stack([np.ones_like(time), time, -(time**2) / 2], axis=1) / (omega * jitter)[:, None]
    return np.sqrt(np.linalg.inv(design.T @ design)[2, 2])


# the errors of single pulses are well below the interval between them
@pytest.mark.slow
@pytest.mark.parametrize(("most", "jitter"), [(100, 1e-5), (1000, 2e-6)], ids=["100", "1000"])
def test_pulses_once_and_many_times_per_turn(gyrotrack, tmp_path, most, jitter):
    """Parameters agree, and their uncertainties are what the times of the pulses tell."""
    rng = np.random.default_rng(11)
    found, expected = {}, {}
    for per_turn in (1, most):
        table, case = tmp_path / f"p{per_turn}.csv", tmp_path / f"p{per_turn}.h5"
        _, time, omega = pulses(table, per_turn, rng, jitter=jitter)
        expected[per_turn] = information(time, omega, jitter)
        said = gyrotrack(
            "import", "--body", table, "--pulses-per-turn", per_turn, "--inertia", "1", "-o", case
        )
        assert said.code == 0, said.err
        said = gyrotrack("fit", case, "--model", "linear", "--drop", "casing.air.linear", "--json")
        found[per_turn] = said.json["parameters"]["touchpoint.constant.b1"]
    one, many = found[1], found[most]
    assert abs(one["value"] - 1.5) < 4 * one["stderr"]
    assert abs(many["value"] - 1.5) < 4 * many["stderr"]
    assert abs(one["value"] - many["value"]) < 4 * np.hypot(one["stderr"], many["stderr"])
    assert one["stderr"] == pytest.approx(expected[1], rel=0.35)
    # more than the pulses alone tell, by the process noise that cannot be excluded
    assert 0.65 < many["stderr"] / expected[most] < 1.5
    ratio = expected[1] / expected[most]
    assert ratio == pytest.approx(np.sqrt(most), rel=0.1)
    assert 0.6 < one["stderr"] / many["stderr"] / ratio < 1.4
