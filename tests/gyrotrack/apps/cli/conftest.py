"""The program as a user runs it, and small simulated cases whose answers are known."""

import contextlib
import io
import json
import shutil
from dataclasses import dataclass

import pytest

# one run of 40 s: 1,200 samples of the casing and 1,800 of the rotor
LENGTH = ["--duration", "40", "--casing-fps", "30", "--rotor-fps", "200"]


@dataclass(frozen=True)
class Said:
    """What one command answered."""

    code: int
    out: str
    err: str

    @property
    def json(self):
        """The document on stdout, which must be the only thing there."""
        return json.loads(self.out)

    @property
    def error(self):
        """The error document."""
        return self.json["error"]


@pytest.fixture
def gyrotrack(capsys, program):
    """Run a command in this process: gyrotrack("fit", path, "--json") -> Said."""

    def run(*words):
        capsys.readouterr()
        code = program([str(w) for w in words])
        said = capsys.readouterr()
        assert "Traceback" not in said.out + said.err
        return Said(code, said.out, said.err)

    return run


@pytest.fixture(scope="session")
def simulated(made_once, program):
    """Cases made once: plain (nothing hidden), drag (quadratic drag hidden), other (plain, other start)."""

    def make(folder):
        for name, settings in (
            ("plain", ["--seed", "2"]),
            (
                "drag",
                ["--seed", "1", "--add", "casing.air.quadratic", "--set", "casing.air.quadratic.k=5e-10"],
            ),
            ("other", ["--seed", "3", "--omega-rotor", "700", "--set", "touchpoint.constant.b1=5e-6"]),
        ):
            assert program(["simulate", "-o", str(folder / f"{name}.h5"), *LENGTH, *settings]) == 0

    return made_once("simulated", make)


@pytest.fixture
def case(simulated, tmp_path):
    """Copy a simulated case into this test's own folder, so that its ledger is new: case("plain")."""

    def copy(name):
        return shutil.copy(simulated / f"{name}.h5", tmp_path / f"{name}.h5")

    return copy


@pytest.fixture(scope="session")
def studied(simulated, made_once, program):
    """The case `drag`, fitted without and with the effect that it hides: two steps, made once."""

    def make(folder):
        path = shutil.copy(simulated / "drag.h5", folder / "drag.h5")
        with contextlib.redirect_stdout(io.StringIO()):
            assert program(["fit", str(path), "-q"]) == 0
            assert program(["fit", str(path), "--from", "f1", "--add", "casing.air.quadratic", "-q"]) == 0

    return made_once("studied", make)


@pytest.fixture
def study(studied, tmp_path):
    """A copy of the studied case with its ledger, for this test alone."""
    shutil.copytree(studied, tmp_path, dirs_exist_ok=True)
    return tmp_path / "drag.h5"
