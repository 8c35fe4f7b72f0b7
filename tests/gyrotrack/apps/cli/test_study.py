"""`diagnose`, `improve`, `ladder`, `effects` and `simulate` as a user runs them."""

import json
import subprocess
import sys

import h5py
import numpy as np
import pytest

from fitting import LIBRARY

DRAG = 5e-10  # of the case `drag`


class TestDiagnose:
    @pytest.mark.slow
    def test_a_hidden_effect_comes_first(self, gyrotrack, study, monkeypatch):
        documents = []
        monkeypatch.setattr("gyrotrack.apps.cli._output.Output.result", lambda _, d: documents.append(d))
        said = gyrotrack("diagnose", study, "--from", "f1")
        assert said.out.startswith("Significant lack of fit: ")
        assert "significant lack of fit:" in said.out
        assert "candidate effects:" in said.out
        assert max(map(len, said.out.splitlines())) <= 80
        (found,) = documents
        assert json.dumps(found)
        assert {"fit_id", "verdict", "sentence", "failures", "candidates", "next_experiment"} <= set(found)
        assert found["fit_id"] == "f1"
        assert found["verdict"] == "missing_effect"
        assert "casing.air.quadratic" in found["sentence"]
        first = found["candidates"][0]
        assert first["effect"] == "casing.air.quadratic"
        assert first["kind"] == "physical"
        assert first["p_value"] < 1e-6
        assert first["delta_bic"] < -100
        assert first["held_out_gain"] > 0
        assert first["indistinguishable_from"] == []
        strength = first["parameters"]["casing.air.quadratic.k"]
        assert abs(strength["value"] - DRAG) < 4 * strength["stderr"]
        assert len({c["effect"] for c in found["candidates"]}) == len(found["candidates"])
        for c in found["candidates"]:
            assert {
                "effect",
                "kind",
                "score",
                "delta_bic",
                "p_value",
                "held_out_gain",
                "indistinguishable_from",
                "parameters",
            } <= set(c)
            assert c["kind"] == LIBRARY[c["effect"]].kind
        assert found["failures"]
        for f in found["failures"]:
            assert f["label"] == "drag"
            assert f["body"] in {"casing", "rotor"}
            assert 0 <= f["t_start"] < f["t_stop"] <= 40.01
            assert f["size_sigma"] > 2
            assert {"kind", "residual_rad_s", "residual_torque_Nm"} <= set(f)
        # the drag is at most 1.5e-5 N m, and other terms have swallowed most of it
        assert all(abs(f["residual_torque_Nm"]) < 1.5e-5 for f in found["failures"])

    @pytest.mark.slow
    def test_nothing_hidden_is_adequate(self, gyrotrack, case, tmp_path):
        said = gyrotrack("diagnose", case("plain"), "--json")
        assert said.code == 0
        found = said.json
        assert found["verdict"] == "adequate"
        assert not any(c["significant"] for c in found["candidates"])
        # without a fit so far the reduced model was fitted and kept
        assert found["fit_id"] == "f1"
        assert (tmp_path / "plain.fits.json").exists()

    @pytest.mark.slow
    def test_the_latest_rung_is_what_is_diagnosed(self, gyrotrack, study):
        found = gyrotrack("diagnose", study, "--json").json
        assert found["fit_id"] == "f2"
        assert found["verdict"] == "adequate"


class TestImprove:
    @pytest.mark.slow
    def test_the_error_falls_to_the_noise(self, gyrotrack, case):
        said = gyrotrack("improve", case("drag"), "--json")
        assert said.code == 0
        assert said.err == ""
        found = said.json
        assert found["verdict"] == "missing_effect"
        first, last = found["ladder"]
        keys = {"fit_id", "added", "rmse_casing", "reduced_chi2", "held_out", "delta_bic"}
        assert all(keys <= set(rung) for rung in (first, last))
        assert last["added"] == "+casing.air.quadratic"
        assert last["rmse_casing"] < 0.5 * first["rmse_casing"]
        assert last["held_out"] < first["held_out"]
        assert last["delta_bic"] < -100
        final = found["final"]
        assert final["fit_id"] == last["fit_id"] == "f2"
        assert final["verdict"] == "no_lack_of_fit"
        strength = final["parameters"]["casing.air.quadratic.k"]
        assert abs(strength["value"] - DRAG) < 4 * strength["stderr"]

    @pytest.mark.slow
    def test_nothing_hidden_adds_nothing(self, gyrotrack, case, monkeypatch):
        documents = []
        monkeypatch.setattr("gyrotrack.apps.cli._output.Output.result", lambda _, d: documents.append(d))
        said = gyrotrack("improve", case("plain"))
        assert said.code == 0
        assert "verdict: the model is adequate; no effect was added" in said.out
        (found,) = documents
        assert found["verdict"] == "adequate"
        assert len(found["ladder"]) == 1
        assert len(found["final"]["model"]) == 5


class TestLadder:
    @pytest.mark.slow
    def test_what_was_added_and_what_the_error_did(self, gyrotrack, study):
        said = gyrotrack("ladder", study)
        assert said.code == 0
        lines = said.out.splitlines()
        bars = [line.count("#") for line in lines if "#" in line]
        assert len(bars) == 2
        assert bars[0] > 2 * bars[1] > 0
        assert "+casing.air.quadratic" in said.out
        assert max(map(len, lines)) <= 100

    def test_keys(self, gyrotrack, study):
        rungs = gyrotrack("ladder", study, "--json").json["ladder"]
        assert [r["fit_id"] for r in rungs] == ["f1", "f2"]
        assert [r["parent"] for r in rungs] == ["", "f1"]

    def test_without_a_fit(self, gyrotrack, case):
        said = gyrotrack("ladder", case("plain"))
        assert said.code == 1
        assert "no fit of these cases yet" in said.err
        assert "gyrotrack fit" in said.err

    def test_of_other_data_under_the_same_name(self, gyrotrack, study, simulated):
        study.write_bytes((simulated / "plain.h5").read_bytes())
        assert gyrotrack("ladder", study).code == 1  # the ledger knows its data by digest, not by name


class TestEffects:
    def test_all_names(self, gyrotrack):
        said = gyrotrack("effects")
        assert said.code == 0
        assert [line.split()[0] for line in said.out.splitlines() if line[0] != " "] == list(LIBRARY)
        found = gyrotrack("effects", "--json").json["effects"]
        assert [e["name"] for e in found] == list(LIBRARY)
        for e in found:
            assert e["kind"] in {"physical", "measurement"}
            assert all({"symbol", "unit", "lower", "upper"} <= set(p) for p in e["parameters"])
            assert e["signature"]
            assert set(e["confused_with"]) <= set(LIBRARY), e["name"]

    def test_one_page(self, gyrotrack):
        said = gyrotrack("effects", "casing.windage")
        assert said.code == 0
        assert said.out.startswith("casing.windage (physical)")
        assert "[N m s2]" in said.out
        assert "bearing.load" in said.out
        one = gyrotrack("effects", "casing.windage", "--json").json
        assert one["joint"] == "casing"
        assert one["parameters"][0]["unit"] == "N m s2"

    def test_unknown(self, gyrotrack):
        said = gyrotrack("effects", "casing.winage")
        assert said.code == 1
        assert "did you mean casing.windage" in said.err

    def test_ones_own(self, gyrotrack, tmp_path):
        file = tmp_path / "mine.toml"
        file.write_text('[[effect]]\nname = "my.drag"\nbody = "casing"\nlaw = "-k*omega_c**3"\n')
        said = gyrotrack("effects", "my.drag", "--effects", file, "--json")
        assert said.json["law"] == "-k*omega_c**3"
        assert said.json["parameters"][0]["unit"] == "N m s3"


SHORT = ["--duration", "12", "--window-length", "1"]


class TestSimulate:
    def numbers(self, path):
        with h5py.File(path) as file:
            return np.array(file["casing/angle"]), np.array(file["rotor/angle"])

    def test_the_same_seed_gives_the_same_numbers(self, gyrotrack, tmp_path):
        for name, seed in (("a", 7), ("b", 7), ("c", 8)):
            assert gyrotrack("simulate", "-o", tmp_path / f"{name}.h5", *SHORT, "--seed", seed).code == 0
        a, b, c = (self.numbers(tmp_path / f"{n}.h5") for n in "abc")
        assert all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))
        assert not np.array_equal(a[0], c[0])
        # another seed is another noise on the same motion
        assert np.std(a[0] - c[0]) == pytest.approx(np.sqrt(2) * 1e-3, rel=0.1)

    def test_what_it_says(self, gyrotrack, tmp_path):
        said = gyrotrack(
            "simulate", "-o", tmp_path / "x.h5", *SHORT, "--add", "casing.windage",
            "--set", "casing.windage.k=2e-12", "--set", "bearing.power.g=1.1", "--json",
        )  # fmt: skip
        assert said.code == 0
        assert said.err.startswith("Default moments of inertia are those of the paper")
        assert said.json["model"][-1] == "casing.windage"
        assert said.json["parameters"]["casing.windage.k"] == 2e-12
        assert said.json["parameters"]["bearing.power.g"] == 1.1
        info = gyrotrack("info", tmp_path / "x.h5", "--json").json
        assert info["sound"] is True
        assert info["kind"] == "case"
        assert info["label"] == "x"

    def test_strength_is_a_share_of_the_budget(self, gyrotrack, tmp_path):
        words = ["--add", "casing.air.quadratic", "--force", "--json"]
        k = {}
        for strength in (0.01, 0.05):
            said = gyrotrack("simulate", "-o", tmp_path / "x.h5", *SHORT, "--strength", strength, *words)
            k[strength] = said.json["parameters"]["casing.air.quadratic.k"]
        assert k[0.05] == pytest.approx(5 * k[0.01])
        assert 50 < np.sqrt(0.05 * 1e-4 / k[0.05]) < 200  # the speed at which it is 5 % of 1e-4 N m [rad/s]

    @pytest.mark.parametrize(
        ("words", "code", "match"),
        [
            (["--set", "gravity=9.81"], 2, "is not an assignment to a parameter of the model"),
            (["--set", "bearing.power.g"], 2, "is not an assignment to a parameter of the model"),
            (["--set", "bearing.power.g=much"], 2, "'much' is not a number"),
            (["--add", "bearing.haeting"], 1, "did you mean bearing.heating"),
            (["--add", "camera.centre"], 2, "--centre-offset"),
            (["--drop", "bearing.heating"], 1, "not in the model"),
            (["--window", "300"], 1, "outside the recording"),
            (["--duration", "-1"], 1, ""),
            (["--duration", "nan"], 1, ""),
            (["--duration", "long"], 2, "valid number"),
        ],
    )
    def test_wrong_wishes(self, gyrotrack, tmp_path, words, code, match):
        said = gyrotrack("simulate", "-o", tmp_path / "x.h5", *SHORT, *words)
        assert said.code == code
        assert match in said.err
        assert "A bug" not in said.err
        assert not list(tmp_path.iterdir())

    def test_it_does_not_overwrite(self, gyrotrack, tmp_path):
        (tmp_path / "x.h5").write_bytes(b"mine")
        said = gyrotrack("simulate", "-o", tmp_path / "x.h5", *SHORT)
        assert said.code == 1
        assert "already exists" in said.err
        assert "--force" in said.err
        assert (tmp_path / "x.h5").read_bytes() == b"mine"
        assert gyrotrack("simulate", "-o", tmp_path / "x.h5", *SHORT, "--force").code == 0


class TestAsAProcess:
    """The same through a real process: what stands on which stream, and the exit code."""

    def run(self, *words):
        command = [sys.executable, "-m", "gyrotrack", *map(str, words)]
        return subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)

    @pytest.mark.slow
    def test_fit(self, case):
        done = self.run("fit", case("plain"), "--json")
        assert done.returncode == 0
        assert done.stderr == ""
        assert json.loads(done.stdout)["verdict"] == "no_lack_of_fit"

    @pytest.mark.slow
    def test_a_missing_file(self, tmp_path):
        done = self.run("diagnose", tmp_path / "missing.h5", "--json")
        assert done.returncode == 1
        assert done.stderr == ""
        assert json.loads(done.stdout)["error"]["code"] == "record"

    def test_wrong_usage(self):
        done = self.run("improve")
        assert done.returncode == 2
        assert done.stdout == ""
        assert "Missing argument" in done.stderr


@pytest.mark.slow
def test_the_budget_of_a_fit(gyrotrack, case):
    path = case("plain")
    found = gyrotrack("budget", path, "--clock-rate", "1e-3", "--json").json
    assert found["fit_id"] == "f1"
    b = found["parameters"]["casing.air.linear.b2"]
    clock = next(c for c in b["contributions"] if c["source"] == "clock rate")
    assert clock["type"] == "B"
    assert clock["u"] == pytest.approx(1e-3 * b["value"], rel=0.01)  # N m s has one second below the line
    said = gyrotrack("budget", path)
    assert "casing.air.linear.b2" in said.out
    assert gyrotrack("budget", path, "--clock-rate", "2").code == 2
