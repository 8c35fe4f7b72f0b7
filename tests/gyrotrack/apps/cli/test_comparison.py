"""The command compare: two simulated spin-downs whose drag differs by 2 %."""

import json

import numpy as np
import pytest

from gyrotrack.apps.cli import _app as app


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    t = np.arange(0, 10, 0.02)
    for seed, (name, b) in enumerate({"left": 0.1, "right": 0.102}.items()):
        angle = 30 / b * (1 - np.exp(-b * t)) + 1e-3 * np.random.default_rng(seed).standard_normal(len(t))
        table = np.c_[t, angle, np.full(len(t), 1e-3)]
        np.savetxt(folder / f"{name}.csv", table, delimiter=",", header="t,angle,sigma", comments="")
        case = str(folder / f"{name}.h5")
        assert (
            app.run(["import", "--body", str(folder / f"{name}.csv"), "--inertia", "1", "-o", case, "-q"])
            == 0
        )
        assert app.run(["fit", case, "--model", "reduced", "-q"]) == 0
    return folder


def test_the_drag_differs(runs, capsys):
    picture = runs / "difference.png"
    cases = [str(runs / "left.h5"), str(runs / "right.fits.json")]
    capsys.readouterr()
    assert app.run(["compare", *cases, "--picture", str(picture), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    drag = found["parameters"]["casing.air.linear.b2"]
    values = drag["values"]
    expected = (values[1]["value"] - values[0]["value"]) / np.hypot(*(v["stderr"] for v in values))
    assert drag["difference_sigma"] == pytest.approx(expected)
    assert drag["difference_sigma"] > 5
    assert drag["mean"]["value"] == pytest.approx(0.101, rel=0.01)
    assert found["runs"] == ["left", "right"]
    assert picture.stat().st_size > 5000
    assert app.run(["compare", *cases]) == 0
    assert "differs between the runs" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("names", "code"), [(["left.h5"], 2), (["left.h5", "left.h5"], 2), (["left.h5", "x.h5"], 1)]
)
def test_wrong_input_is_one_sentence(runs, names, code, capsys):
    assert app.run(["compare", *(str(runs / n) for n in names)]) == code
    assert "Traceback" not in capsys.readouterr().err
