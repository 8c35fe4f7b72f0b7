"""Moments of inertia as people write them: value, uncertainty, unit, and what is refused."""

import json
import math

import h5py
import pytest

from gyrotrack import UsageError
from gyrotrack.apps.batch._experiments import Clip, Experiment, with_inertias
from gyrotrack.apps.cli._app import run
from gyrotrack.io._records import Inertia


@pytest.mark.parametrize(
    ("text", "value", "u"),
    [
        ("5.54e-5", 5.54e-5, math.nan),
        (5.54e-5, 5.54e-5, math.nan),
        ("5.54e-5 +- 0.06e-5", 5.54e-5, 6e-7),
        ("5.54e-5 ± 6e-7 kg m2", 5.54e-5, 6e-7),
        ("5.54e-5+/-6e-7kg m^2", 5.54e-5, 6e-7),
        ("554 g cm2", 5.54e-5, math.nan),
        ("(554 +- 6) g cm2", 5.54e-5, 6e-7),
        ("554 +- 6 g*cm**2", 5.54e-5, 6e-7),
        ("55400 g mm²", 5.54e-5, math.nan),
        ("0.05 kg·cm2", 5e-6, math.nan),
        ("16 g cm2 +- 0.1", 1.6e-6, 1e-8),
        ("16 g cm2 ± 0.1 g cm2", 1.6e-6, 1e-8),
        ("16 g cm2 +- 1 %", 1.6e-6, 1.6e-8),
        ("16 +- 2% g cm2", 1.6e-6, 3.2e-8),
    ],
)
def test_read(text, value, u):
    found = Inertia.of(text)
    assert found.value == pytest.approx(value, rel=1e-14)
    assert found.u == pytest.approx(u, rel=1e-14, nan_ok=True)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "16 g cm2 +- 0.1 kg m2",
        "heavy",
        "-5e-5",
        "0",
        "nan",
        "inf",
        "5e-5 kg",
        "5e-5 m2",
        "5 g cm3",
        "1e-5 +- 2e-5",
        "5e9",
        "1e-300",
        "1 +- x",
    ],
)
def test_refused(text):
    with pytest.raises(UsageError):
        Inertia.of(text, "rotor")


def test_no_default(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    rows = "".join(f"{i / 100},{3 * i / 100}\n" for i in range(300))
    for name in ("c.csv", "r.csv"):
        (tmp_path / name).write_text("t,angle\n" + rows)
    words = ["import", "--casing", "c.csv", "--rotor", "r.csv", "-o", "a.h5", "--json"]
    assert run(words) == 2
    error = json.loads(capsys.readouterr().out)["error"]
    assert error["message"].startswith("The moment of inertia of the rotor is not given")
    assert run([*words, "--inertia-rotor", "(554 +- 6) g cm2"]) == 2
    assert "of the casing" in json.loads(capsys.readouterr().out)["error"]["message"]
    assert run([*words, "--inertia-rotor", "(554 +- 6) g cm2", "--inertia-casing", "2.06e-5"]) == 0
    with h5py.File("a.h5") as file:
        assert file.attrs["I_rotor"] == 5.54e-5
        assert file.attrs["I_rotor_u"] == 6e-7
        assert file.attrs["I_casing"] == 2.06e-5
        assert math.isnan(file.attrs.get("I_casing_u", math.nan))
    assert run(["sync", "c.h5", "r.h5", "-o", "b.h5"]) == 2


def test_a_batch_takes_the_manifest_before_the_option(tmp_path):
    films = (Clip(tmp_path / "c.mp4", "casing"), Clip(tmp_path / "r.mp4", "rotor"))
    noted = Experiment("a", films, inertia_rotor="554 g cm2", inertia_casing="2e-5")
    plain = Experiment("b", films)
    options = {"rotor": "6e-5", "casing": "3e-5"}
    made = with_inertias([noted, plain], options)
    assert [(e.inertia_rotor, e.inertia_casing) for e in made] == [("554 g cm2", "2e-5"), ("6e-5", "3e-5")]
    nothing = {"rotor": None, "casing": None}
    with pytest.raises(UsageError, match="of the rotor of the case 'b'"):
        with_inertias([plain], nothing)
    assert (
        with_inertias([plain], nothing, skip={"--inertia-rotor", "--inertia-casing"})[0].inertia_rotor is None
    )
    single = Experiment("c", (Clip(tmp_path / "w.mp4"),))
    assert with_inertias([single], nothing) == (single,)


def test_simulate_names_the_inertias_of_the_paper_and_stores_a_stated_uncertainty(tmp_path, capsys):
    words = ["simulate", "-o", str(tmp_path / "a.h5"), "--duration", "12", "--window-length", "1"]
    assert run([*words, "--inertia-rotor", "(554 +- 6) g cm2"]) == 0
    assert "rotor 5.54e-5, casing 2.06e-5 kg m2" in capsys.readouterr().err
    with h5py.File(tmp_path / "a.h5") as file:
        assert file.attrs["I_rotor_u"] == pytest.approx(6e-7)
        assert "I_casing_u" not in file.attrs
