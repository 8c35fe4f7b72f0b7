import os

# the matrices of a fit are small: several BLAS threads would spend ten times the work waiting for each other
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pickle
from collections.abc import Callable
from dataclasses import dataclass

import pytest

from fitting import REDUCED, Diagnosis, Experiment, Model, Record, diagnose, fit, improve, simulate
from fitting.discovery._select import Step
from fitting.dynamics._collocation import Path
from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR
from fitting.inference._case_data import CaseData
from fitting.inference._simulation import simulate_path

MISSING = "casing.air.quadratic"
NUMBERS = {
    "rotor.air.quadratic.a2": 9.97e-11,
    "touchpoint.constant.b1": 2.88e-6,
    "casing.air.linear.b2": 8.28e-7,
    "bearing.linear.d": 1.57e-7,
    "bearing.power.f": 1.26e-8,
    "bearing.power.g": 1.32,
    "casing.air.quadratic.k": 3e-10,
}
TRUTH = Model.of([*REDUCED, MISSING])
SHORT = Experiment(duration=60.0, casing_fps=20.0, rotor_fps=60.0, windows=(3.0, 25.0, 52.0), sigma=5e-4)


@dataclass(frozen=True)
class Story:
    record: Record
    rungs: list[Step]
    diagnosis: Diagnosis


def recording(seed: int = 1) -> Record:
    return simulate(
        TRUTH, NUMBERS, SHORT, inertia_rotor=5.54e-5, inertia_casing=2.06e-5, seed=seed, label="run"
    )


@pytest.fixture(scope="session")
def record_of() -> Callable[[int], Record]:
    """Return a recording of the true model by its seed."""
    return recording


@pytest.fixture(scope="session")
def true_path() -> Path:
    """The exact motion behind every recording."""
    inertias = {INERTIA_ROTOR: 5.54e-5, INERTIA_CASING: 2.06e-5}
    return simulate_path(TRUTH, NUMBERS | inertias, SHORT)[1]


@pytest.fixture(scope="session")
def story(made_once) -> Story:
    """A recording, the history of its fits and its diagnosis, computed once for all processes."""

    def make(folder):
        record = recording()
        base = fit(Model.of(REDUCED), [CaseData.of(record)])
        diagnosis = diagnose(base)
        steps = improve(base, first=diagnosis.candidates, max_steps=1)
        folder.joinpath("story.pickle").write_bytes(pickle.dumps((record, steps, diagnosis)))

    return Story(*pickle.loads(made_once("story", make).joinpath("story.pickle").read_bytes()))  # noqa: S301
