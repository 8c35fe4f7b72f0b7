"""Time constant, gain and dead time of driven bodies from given parameters, without a fit."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import Estimate, EstimationError, FirstOrder, Input, Model, effect, make_record
from fitting.inference import _first_order as module
from fitting.inference._case_data import CaseData
from fitting.inference._first_order import first_order, first_order_lines
from fitting.inference._parameters import ParameterLayout
from fitting.inference._problem import Problem

TIME = np.arange(0.0, 4.0, 0.02)
LAW, DRAG, DELAY = "casing: k*drive", "casing.air.linear", "input.drive.delay"
INERTIA = {"a": 0.5, "b": 2.0}
C, K, SIZE = {"a": 0.25, "b": 0.4}, 3.0, 1e-3


def case(label, unit):
    drive = Input("drive", [0.0, 1.0], [0.0, 2.0], unit, interpolation="hold")
    value = 1.0 + np.minimum(TIME, 1.0)
    run = (TIME, value + 0.01 * np.random.default_rng(0).standard_normal(len(TIME)), np.full(len(TIME), 0.01))
    return CaseData.of(
        make_record(
            casing=run, rotor=[], I_rotor=1.0, I_casing=INERTIA[label], label=label, quantity="omega", inputs=(drive,)
        )
    )  # fmt: skip


@pytest.fixture
def made(monkeypatch):
    """Two cases with a drag of their own and a common strength of the drive."""

    def make(drags=C, unit="V", delayed=False):
        data = [case(label, unit) for label in drags]
        model = Model.of([DRAG]) + effect(LAW, data[0].record.inputs)
        if delayed:
            model = model + effect(DELAY, data[0].record.inputs)
        layout = ParameterLayout.of(model, [d.record for d in data], per_case=[f"{DRAG}.b2"])
        known = {f"{DRAG}.b2@{k}": v for k, v in drags.items()} | {f"{DRAG}.b2": drags["a"], f"{LAW}.k": K}
        theta = np.array([known.get(n, 0.0) for n in layout.names])
        covariance = np.zeros((len(theta),) * 2)
        for i, name in enumerate(layout.names):
            covariance[i, i] = (SIZE * (1 + i)) ** 2 if name in known else math.nan

        class Given(SimpleNamespace):
            pass

        monkeypatch.setattr(module, "Fit", Given)
        return Given(
            problem=Problem.of(layout, data), theta=theta, covariance=covariance, model=model, estimates={}
        )

    return make


def test_each_case_has_the_constants_of_its_own_parameters(made):
    fit = made()
    names = list(fit.problem.layout.names)
    u = {n: math.sqrt(fit.covariance[i, i]) for i, n in enumerate(names)}
    for found, label in zip(first_order(fit), C, strict=True):
        c, inertia, own = C[label], INERTIA[label], u[f"{DRAG}.b2@{label}"]
        assert (found.label, found.body) == (label, "body")
        assert found.time_constant.value == pytest.approx(inertia / c)
        assert found.time_constant.stderr == pytest.approx(inertia / c**2 * own)
        gain = found.gains["drive"]
        assert gain.value == pytest.approx(K / c)
        assert gain.stderr == pytest.approx(K / c * math.hypot(u[f"{LAW}.k"] / K, own / c))
        assert (found.time_constant.unit, gain.unit) == ("s", "rad s-1 V-1")
        assert found.delays == {}


def test_a_gain_per_rate_is_an_angle(made):
    assert first_order(made(unit="s-1"))[0].gains["drive"].unit == "rad"


def test_a_body_without_drag_has_no_constants(made):
    assert [x.label for x in first_order(made({"a": 0.0, "b": 0.4}))] == ["b"]


@pytest.mark.parametrize("variance", [math.nan, math.inf, 0.0])
def test_without_a_variance_the_uncertainty_is_unknown(made, variance):
    fit = made({"a": 0.25})
    place = next(i for i, n in enumerate(fit.problem.layout.names) if n.startswith(DRAG))
    fit.covariance[place, place] = variance
    assert math.isnan(first_order(fit)[0].time_constant.stderr)


def test_a_dead_time_is_that_of_the_case_or_the_common_one(made):
    fit = made(delayed=True)
    own, common = (Estimate(v, 0.01, "s", at_bound=False) for v in (0.1, 0.2))
    key = next(n for n in fit.problem.layout.names if n.startswith(DELAY)).partition("@")[0]
    fit.estimates = {f"{key}@b": own, key: common}
    assert [dict(x.delays) for x in first_order(fit)] == [{"drive": common}, {"drive": own}]


def test_only_a_fit_has_constants():
    with pytest.raises(EstimationError, match="a list is not a Fit"):
        first_order([])


def test_lines_name_the_case_where_there_are_several():
    constant, delay = (Estimate(v, 0.1 * v, "s", at_bound=False) for v in (2.0, 0.3))
    one, two = (FirstOrder(label, "body", constant, {}, {"drive": delay}) for label in ("a", "b"))
    assert [x for x in first_order_lines([one, two]) if not x.startswith(" ")] == [
        "first-order response of the body of a", "first-order response of the body of b",
    ]  # fmt: skip
    head, first, second = first_order_lines([one])
    assert head == "first-order response of the body"
    assert first.split()[:2] == ["time", "constant"]
    assert second.split()[:4] == ["dead", "time", "of", "drive"]
