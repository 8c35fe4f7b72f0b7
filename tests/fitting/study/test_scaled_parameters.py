"""Parameters in units of the largest speed: start, bounds and grid have SI units wherever they are used."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import Effect, Model, Parameter, make_record
from fitting.discovery import _next_run
from fitting.inference._parameters import ParameterLayout, parameters_at
from fitting.law_search import _documents, _laws
from fitting.paper import _scan

LARGEST = 40.0
TIME = np.linspace(0.0, 10.0, 200)
RECORD = make_record(
    casing=(TIME, np.full(200, LARGEST), np.full(200, 1e-3)),
    rotor=[],
    I_rotor=1.0,
    I_casing=1.0,
    quantity="omega",
)
SHAPES = (
    Parameter("w", "s-1", "shape", 0.01, 2.0, 0.5, (0.1, 0.5, 1.0), scale="speed"),
    Parameter("n", "1", "shape", 0.5, 4.0, 2.0, (1.0, 2.0, 3.0)),
)
LAW = Effect("casing.lab", "casing", "-k*abs(omega_c/w)**n", (Parameter("k", "N m"), *SHAPES))
FIT = SimpleNamespace(problem=SimpleNamespace(layout=SimpleNamespace(records=(RECORD,))), values={})
# start, bounds and grid [SI units]
EXPECTED = {"w": (20.0, 0.4, 80.0, (4.0, 20.0, 40.0)), "n": (2.0, 0.5, 4.0, (1.0, 2.0, 3.0))}


@pytest.mark.parametrize("symbol", ["w", "n"])
def test_values_are_those_of_the_recording(symbol):
    p = parameters_at([LAW], [RECORD])[f"casing.lab.{symbol}"]
    assert (p.start, p.lower, p.upper, p.grid) == (*map(pytest.approx, EXPECTED[symbol]),)
    assert ParameterLayout.of(Model((LAW,)), [RECORD]).parameter(f"casing.lab.{symbol}") == p


@pytest.mark.parametrize("symbol", ["w", "n"])
def test_an_extended_model_starts_with_them(symbol):
    found = _scan._extended(Model((LAW,)), FIT)
    assert found[f"casing.lab.{symbol}"] == pytest.approx(EXPECTED[symbol][0])
    inner = SimpleNamespace(**{**vars(FIT), "values": {"casing.lab.w": 7.0}})
    assert _scan._extended(Model((LAW,)), inner)["casing.lab.w"] == 7.0


def test_a_planned_run_has_them_where_nothing_was_estimated():
    estimates = {f"casing.lab.n@{i}": SimpleNamespace(value=v) for i, v in enumerate((1.0, 2.0))}
    found = _next_run._mean_values(LAW, estimates, [RECORD])
    assert found == {"k": 0.0, "w": pytest.approx(20.0), "n": 1.5}


@pytest.mark.parametrize(("value", "grid"), [(20.0, True), (90.0, False)])
def test_a_saved_law_has_bounds_in_its_unit(value, grid):
    law = SimpleNamespace(
        effects=(LAW,), form="power", fit=FIT, estimates={"casing.lab.w": SimpleNamespace(value=value)}
    )
    lines = _documents._tables(law, ["lab"], "a test")
    of_w = lines[lines.index("[effect.parameters.w]") :]
    bounds = [float(line.partition(" = ")[2]) for line in of_w if line.startswith(("lower", "upper"))]
    assert bounds[:2] == pytest.approx([0.4, 80.0])
    # trial values about 90 rad/s are within the bounds where they are smaller
    (trials, *_) = [line for line in of_w if line.startswith("grid")]
    assert (str(value) in trials) is grid


@pytest.mark.parametrize(("w", "within"), [(20.0, True), (1000.0, False)])
def test_shapes_are_refined_within_bounds_in_their_unit(monkeypatch, w, within):
    tried = []
    score = SimpleNamespace(
        effect=replace(LAW), score=1.0, absorbed=False, shape=[{"w": w, "n": 2.0}], null=None, trials=1
    )
    case = SimpleNamespace(
        parameters=lambda effect: effect.parameters_at({"omega_c": LARGEST, "omega_r": LARGEST}, 10.0),
        trials=lambda effect, choices: tried.extend(choices),
    )
    monkeypatch.setattr(_laws, "stacked", lambda trials, **options: ())
    monkeypatch.setattr(_laws, "best_group", lambda *arguments, **options: score)
    _laws._refined_shapes(SimpleNamespace(levels=None), score, [case])
    values = np.array([c["w"] for c in tried])
    assert values.max() <= 80.0 * (1 + 1e-12)
    assert bool(values.min() < w < values.max()) is within
