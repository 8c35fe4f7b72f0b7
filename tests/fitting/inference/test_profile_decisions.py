"""The search for the ends of an interval, on deviances whose roots are known."""

import math
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import EstimationError, SimulationError
from fitting.inference import _profile as module
from fitting.inference._profile import Interval, profile, weakly_determined

TARGET = 2.0


class Known(module._Held):
    """A parameter of value 5 whose root of the rise is a given function of the deviation."""

    def __init__(self, root, *, step=TARGET, within=(-math.inf, math.inf)):
        self._target, self._range, self._step = TARGET, within, step
        self._value, self._theta = 5.0, np.array([5.0])
        self._rise, self.tried = root, []

    def _root(self, value, begin):
        self.tried.append(value)
        return self._rise(value - 5.0), np.array([value])


class TestEnds:
    @pytest.mark.parametrize("sign", [1.0, -1.0])
    @pytest.mark.parametrize(("step", "most"), [(TARGET, 1), (0.01, 14), (1.0, 3), (5.0, 3), (400.0, 12)])
    def test_of_a_parabola_they_are_standard_errors(self, sign, step, most):
        held = Known(abs, step=step)
        end, opened = held.end(sign)
        assert end == pytest.approx(5.0 + sign * TARGET, abs=0.021)
        assert opened is False
        assert len(held.tried) <= most

    @pytest.mark.parametrize(
        "rise",
        [lambda x: x**2, lambda x: math.sqrt(abs(x)), lambda x: math.expm1(abs(x)), lambda x: abs(x) ** 7],
    )
    def test_of_a_skewed_deviance_they_are_within_the_tolerance(self, rise):
        held = Known(rise)
        end, opened = held.end(1.0)
        assert abs(rise(end - 5.0) - TARGET) < 0.02
        assert not opened

    @pytest.mark.parametrize(("away", "opened"), [(1.5, True), (2.5, False)])
    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_a_bound_within_the_interval_leaves_it_open(self, sign, away, opened):
        bounds = {1.0: (-math.inf, 5.0 + away), -1.0: (5.0 - away, math.inf)}[sign]
        for step in (TARGET, 0.4, 30.0):
            end, found = Known(abs, step=step, within=bounds).end(sign)
            assert end == pytest.approx(5.0 + sign * (away if opened else TARGET), abs=0.021)
            assert found is opened

    def test_a_deviance_that_does_not_reach_the_quantile_has_no_end(self):
        held = Known(lambda x: 1.0 - math.exp(-abs(x)))
        end, opened = held.end(1.0)
        assert opened
        assert end == held.tried[-1] > 100.0

    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_trials_grow_are_interpolated_and_bisected(self, sign):
        """The root is 0.5 up to a deviation of 4, then 6: the share of the target between them is 3 / 11."""
        held = Known(lambda x: 0.5 if abs(x) < 4.0 else 6.0)
        end, opened = held.end(sign)
        third = 2.0 + 4.0 * 3 / 11
        fourth = third + (6.0 - third) * 3 / 11
        fifth = 0.5 * (fourth + 6.0)
        sixth = fourth + (fifth - fourth) * 3 / 11
        assert sign * (np.array(held.tried) - 5.0)[:6] == pytest.approx(
            [2.0, 6.0, third, fourth, fifth, sixth]
        )
        assert len(held.tried) == 20
        assert end == pytest.approx(5.0 + 4.0 * sign, abs=1e-3)
        assert not opened

    @pytest.mark.parametrize(("root", "second"), [(0.99, 6.0), (1.01, 4.6), (1.97, 4.6)])
    def test_a_step_doubles_below_half_of_the_quantile(self, root, second):
        held = Known(lambda x: root if x < 3.0 else 9.0)
        held.end(1.0)
        assert held.tried[1] - 5.0 == pytest.approx(second)

    def test_an_interpolated_trial_keeps_a_tenth_from_either_end(self):
        for low, high, share in ((1.9, 9.0, 0.1), (0.0, 2.1, 0.9), (0.5, 2.5, 0.75)):
            held = Known(lambda x, low=low, high=high: low if abs(x) <= 2.0 else high)
            held.end(1.0)
            first, second = held.tried[:2]
            assert held.tried[2] == pytest.approx(first + share * (second - first))

    def test_where_the_model_cannot_be_computed_is_an_end(self):
        """The root is half the target up to a deviation of 3, beyond which no motion exists."""
        end, opened = Known(lambda x: 1.0 if abs(x) < 3.0 else math.inf).end(-1.0)
        assert end == pytest.approx(2.0, abs=1e-3)
        assert not opened


@dataclass(frozen=True)
class Problem:
    power_laws: tuple
    noise: object = None
    held: object = None

    @classmethod
    def of(cls, layout, data):
        return cls(tuple(SimpleNamespace(d=d, f=f) for d, f in ((0, 2), (1, 3), (3, 4))))

    def with_noise(self, noise):
        return replace(self, noise=noise)

    def holding(self, names, theta):
        return replace(self, held=(*names, *theta))


@dataclass
class Layout:
    ranges: dict
    names: tuple = ("a.k", "b.k")

    @property
    def index(self):
        return {n: i for i, n in enumerate(self.names)}

    def bounds(self):
        return np.array([0.0, -9.0]), np.array([8.0, 9.0])


def fit(*, variance=0.04):
    return SimpleNamespace(
        problem=SimpleNamespace(layout=Layout({}), data=()),
        noise="noise",
        chi2=100.0,
        variance_factor=4.0,
        theta=np.array([5.0, -6.0]),
        covariance=np.diag([variance, 1.0]),
    )


class TestHeld:
    def held(self, monkeypatch, search, **changes):
        monkeypatch.setattr(module, "Problem", Problem)
        monkeypatch.setattr(module, "search", search)
        return module._Held(fit(**changes), "a.k", 2.0)

    def test_the_root_is_that_of_the_rise_in_units_of_the_noise(self, monkeypatch):
        asked = []

        def search(problem, theta, *, max_iterations, active):
            assert max_iterations == 300
            asked.append((problem, theta.tolist(), active))
            return SimpleNamespace(minimum=SimpleNamespace(cost=136.0), theta=theta + 1.0, active="active")

        held = self.held(monkeypatch, search)
        root, theta = held._root(7.0, np.array([5.0, -6.0]))
        assert root == pytest.approx(3.0)
        assert theta.tolist() == [8.0, -5.0]
        held._root(7.0, theta)
        (problem, begin, first), (_, _, second) = asked
        assert begin == [7.0, -6.0]
        assert (problem.noise, problem.held) == ("noise", ("a.k", 7.0, -6.0))
        # variables that combine the parameter that is held with another one are left as they are
        assert [(v.d, v.f) for v in problem.power_laws] == [(1, 3), (3, 4)]
        assert (first, second) == (None, "active")

    def test_a_fall_by_rounding_errors_is_none(self, monkeypatch):
        below = SimpleNamespace(minimum=SimpleNamespace(cost=99.9), theta=np.zeros(2), active=None)
        assert self.held(monkeypatch, lambda *_, **__: below)._root(7.0, np.zeros(2))[0] == 0.0

    def test_a_motion_that_cannot_be_computed_is_infinitely_bad(self, monkeypatch):
        def search(*_, **__):
            raise SimulationError("no motion")

        begin = np.array([5.0, -6.0])
        root, theta = self.held(monkeypatch, search)._root(7.0, begin)
        assert (root, theta.tolist()) == (math.inf, begin.tolist())

    @pytest.mark.parametrize(
        ("variance", "step"), [(0.04, 0.4), (math.nan, 0.25), (0.0, 0.25), (math.inf, 0.25), (-1.0, 0.25)]
    )
    def test_the_first_step_is_that_of_a_parabola(self, monkeypatch, variance, step):
        """Where no standard error is known, it is a twentieth of the value."""
        held = self.held(monkeypatch, None, variance=variance)
        assert held._step == pytest.approx(step)
        assert held._range == (0.0, 8.0)


@pytest.mark.parametrize(("level", "target"), [(0.95, 1.959964), (0.6826895, 1.0), (0.99, 2.575829)])
def test_the_quantile_is_that_of_a_normal_distribution(monkeypatch, level, target):
    def held(fit, name, quantile):
        return SimpleNamespace(end=lambda sign: (sign * quantile, sign > 0))

    monkeypatch.setattr(module, "_Held", held)
    found = profile(fit(), "a.k", level)
    assert found == Interval(pytest.approx(-target, abs=1e-6), pytest.approx(target, abs=1e-6), False, True)


@pytest.mark.parametrize("level", [0.0, 1.0, -0.1, 1.1])
def test_a_level_is_a_probability(level):
    with pytest.raises(EstimationError, match="not between 0 and 1"):
        profile(fit(), "a.k", level)


@pytest.mark.parametrize(
    ("name", "value", "stderr", "at_bound", "weak"),
    [
        ("a.k", 2.0, 0.59, False, False),
        ("a.k", 2.0, 0.61, False, True),
        ("a.k", -2.0, 0.59, False, False),
        ("a.k", -2.0, 0.61, False, True),
        ("a.k", 2.0, 0.1, True, True),
        ("initial.omega_c", 2.0, 0.9, False, False),
        ("held.k", 2.0, 0.9, False, False),
    ],
)
def test_a_parameter_of_thirty_per_cent_is_weakly_determined(name, value, stderr, at_bound, weak):
    estimate = SimpleNamespace(value=value, stderr=stderr, at_bound=at_bound)
    layout = Layout({}, ("a.k", "initial.omega_c"))
    found = SimpleNamespace(estimates={name: estimate}, problem=SimpleNamespace(layout=layout))
    assert weakly_determined(found) == ([name] if weak else [])
