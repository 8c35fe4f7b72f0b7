"""Averaged equations of oscillations whose amplitude and phase are known, and searches that begin with them."""

import math
from types import SimpleNamespace

import numpy as np
import oscillators
import pytest
from scipy.integrate import solve_ivp

from fitting import EstimationError, Model
from fitting.inference import _initial_values as initial
from fitting.inference._averaging import averaged
from fitting.inference._oscillation import SlowMotion
from fitting.inference._parameters import ParameterLayout

SPRING, DRY, LINEAR, QUADRATIC = (
    "casing.spring.linear.k", "touchpoint.constant.b1", "casing.air.linear.b2", "casing.air.quadratic.k",
)  # fmt: skip
RATE = 3.5


def slow_motion(dry, linear, quadratic, *, begin=2.0, span=60.0, phase=0.4):
    """Return amplitude and phase of an oscillation of 3.5 rad/s that these frictions damp, by averaging."""
    time = np.linspace(begin + 0.5, begin + span, 60)
    fall = lambda t, a: -linear * a / 2 - 2 * dry / (np.pi * RATE) - 4 * quadratic * RATE * a**2 / (3 * np.pi)  # noqa: E731
    a = solve_ivp(fall, (time[0], time[-1]), [1.2], t_eval=time, rtol=1e-10, atol=1e-12).y[0]
    return SlowMotion(time, a, RATE * (time - begin) + phase)


def fitted(frictions, *, noise=0.0, errors=None, begin=2.0):
    values = dict.fromkeys((DRY, LINEAR, QUADRATIC), 0.0) | frictions
    slow = slow_motion(*values.values(), begin=begin)
    if noise:
        rng = np.random.default_rng(1)
        slow = SlowMotion(
            slow.time,
            slow.amplitude + noise * rng.standard_normal(60),
            slow.phase + 2 * noise / slow.amplitude * slow.amplitude.max() * rng.standard_normal(60),
        )
    t = np.linspace(begin, begin + 60.0, 400)
    record = oscillators.record(t, np.cos(t), 1e-3, 0)
    data = SimpleNamespace(motion=SimpleNamespace(slow_motion=slow), record=record)
    model = Model.of(tuple(n.rpartition(".")[0] for n in (SPRING, *frictions)))
    layout = ParameterLayout.of(model, [record])
    theta = np.ones(len(layout.names))
    found = averaged(layout, [data], theta, initial._strengths, initial._regress, errors)
    assert (theta == 1.0).all()
    return dict(zip(layout.names, found.theta, strict=True)), found, slow


class TestAveraged:
    @pytest.mark.parametrize(
        "frictions",
        [
            {LINEAR: 0.05},
            {DRY: 0.02},
            {QUADRATIC: 0.03},
            {DRY: 0.02, LINEAR: 0.01},
            {LINEAR: 0.02, QUADRATIC: 0.01},
        ],
    )
    def test_strengths_are_those_that_damp_the_motion(self, frictions):
        values, found, slow = fitted(frictions)
        for name, value in frictions.items():
            assert values[name] == pytest.approx(value, rel=0.01), name
        # the curvature of the amplitude lowers the frequency by a millionth
        assert values[SPRING] == pytest.approx(RATE**2, rel=1e-3)
        assert found.phase_error < 1e-3
        # the first sample is half a second before the first amplitude
        a = slow.amplitude[0] - 0.5 * np.gradient(slow.amplitude, slow.time)[0]
        (omega,) = (v for k, v in values.items() if k.startswith("initial.omega_c"))
        (deflection,) = (v for k, v in values.items() if k.startswith("initial.deflection"))
        assert deflection == pytest.approx(a * math.cos(0.4), rel=2e-3)
        assert omega == pytest.approx(-a * RATE * math.sin(0.4), rel=2e-3)
        assert next(v for k, v in values.items() if k.startswith("initial.omega_r")) == 0.0

    def test_errors_follow_from_the_residuals_or_are_given(self):
        """A phase has the error of the deflection divided by the amplitude; here it is twice that of the amplitude."""
        _, found, slow = fitted({LINEAR: 0.05}, noise=1e-3)
        relative = slow.amplitude / slow.amplitude.max()
        ((keys, design, rest),), (scale,) = found.rows, found.scales
        amplitude, phase = scale.reshape(2, -1)
        assert amplitude == pytest.approx(np.full(60, amplitude[0]))
        assert amplitude[0] == pytest.approx(1e-3, rel=0.3)
        assert phase * relative == pytest.approx(np.full(60, found.phase_error))
        assert 1.3e-3 < found.phase_error < 3e-3
        assert design.shape == (120, len(keys))
        rest = rest.reshape(2, -1)
        assert np.mean(rest**2, axis=1) == pytest.approx([1.0, 1.0])
        # neither the initial amplitude nor the initial phase counts
        assert rest[0].sum() == pytest.approx(0.0, abs=1e-6)
        assert rest[1] @ relative == pytest.approx(0.0, abs=1e-6)
        for column in design.T.reshape(len(keys), 2, -1):
            assert column[0].sum() == pytest.approx(0.0, abs=1e-6 * np.abs(column).max())
            assert column[1] @ relative == pytest.approx(0.0, abs=1e-6 * np.abs(column).max())
        given = [np.full(120, 0.5)]
        _, again, _ = fitted({LINEAR: 0.05}, noise=1e-3, errors=given)
        assert again.scales[0] is given[0]
        assert again.rows[0][2].reshape(2, -1)[0] == pytest.approx(
            rest[0] * amplitude / 0.5, rel=0.2, abs=2e-4
        )

    def test_a_motion_of_few_periods_has_no_averages(self):
        record = oscillators.record(np.linspace(0.0, 9.0, 99), np.zeros(99), 1e-3, 0)
        data = SimpleNamespace(motion=SimpleNamespace(slow_motion=None), record=record)
        model = Model.of(("casing.spring.linear",))
        layout = ParameterLayout.of(model, [record])
        assert averaged(layout, [data], np.zeros(len(layout.names)), None, None) is None
        assert initial.averaged_fit(model, [data]) is None


@pytest.mark.parametrize(("best", "found"), [(0.0, 0.0), (0.011, 0.0112), (0.5, 0.477), (3.0, 1.0)])
def test_a_dead_time_is_that_of_the_best_regression(monkeypatch, best, found):
    """Two recordings at intervals of 0.01 and 0.02 s, of 5 and 10 s; the error of the first one is 9 times as large."""
    layout = SimpleNamespace(places=lambda case, keys: np.array([{"T": 0, "k": 1}[k] for k in keys]))
    monkeypatch.setattr(initial, "_dead_times", lambda layout: ["T"])

    def equations(layout, case, times, speeds, deflection, trial):
        off = (trial[0] - best) * (3.0 if case == 0 else 1.0)
        return ["k"], np.array([[1.0], [1.0]]), np.array([2.0 + off, 2.0 - off])

    monkeypatch.setattr(initial, "_equations", equations)
    monkeypatch.setattr(initial, "_regress", lambda layout, parts: (np.array([1]), np.array([2.0])))
    rough = [(np.arange(0.0, 5.0, 0.01), None), (np.arange(0.0, 10.005, 0.02), None)]
    theta = initial._with_dead_times(layout, rough, ("d1", "d2"), np.array([7.0, 5.0]))
    grid = np.array([0.0, *np.geomspace(0.01, 1.0, 40)])
    assert theta[0] == pytest.approx(grid[np.argmin(np.abs(grid - best))])
    assert theta[0] == pytest.approx(found, rel=0.06)
    assert theta[1] == 5.0


@pytest.mark.parametrize(
    ("periods", "counts"), [((2.0,), []), ((2.1,), [2]), ((9.0, 3.0), [2, 4, 8]), ((8.0,), [2, 4])]
)
def test_an_oscillation_is_searched_through_doubled_numbers_of_periods(monkeypatch, periods, counts):
    searched = []

    def search(problem, theta, *, quick, max_iterations):
        assert (quick, max_iterations) == (True, 60)
        searched.append((problem, theta))
        if len(searched) == 2:
            raise EstimationError("no minimum")
        return SimpleNamespace(theta=theta + 1)

    monkeypatch.setattr(initial, "search", search)
    monkeypatch.setattr(
        initial, "_first_periods", lambda d, count: SimpleNamespace(of=(d.motion.periods, count))
    )
    monkeypatch.setattr(
        initial.CaseData, "of", lambda record, criteria: SimpleNamespace(record=record, criteria=criteria)
    )
    monkeypatch.setattr(initial.Problem, "of", lambda layout, data: [d.record.of for d in data])
    monkeypatch.setattr(initial, "replace", lambda layout, records: None)
    data = [SimpleNamespace(motion=SimpleNamespace(periods=p), criteria="c") for p in periods]
    theta = initial._period_by_period(SimpleNamespace(layout=None, data=data), 10)
    assert [p for p, _ in searched] == [[(p, c) for p in periods] for c in counts]
    assert theta == 10 + len(counts) - (len(counts) > 1)
    # a search that fails leaves the values of the one before
    assert [t for _, t in searched] == [10, 11, 11][: len(counts)]


@pytest.mark.parametrize("target", [(3.0, 4.0, 0.0), (0.0, 0.0, 0.0)])
def test_the_error_of_the_equations_is_the_share_that_the_strengths_leave(monkeypatch, target):
    """Of two recordings, the second with twice the change of the speeds; the strength is half of that needed."""
    layout = SimpleNamespace(places=lambda case, keys: [0])
    monkeypatch.setattr(initial.ParameterLayout, "of", lambda model, records: layout)
    monkeypatch.setattr(initial, "reference_speed", lambda data, mechanism: 1.0)
    monkeypatch.setattr(initial, "start_values", lambda *_: np.array([0.5]))
    monkeypatch.setattr(
        initial, "_equations",
        lambda layout, case, times, speeds, deflection, theta: (
            ["k"],
            (case + 1.0) * np.array([*target[:2], 0.0])[:, None],
            (case + 1.0) * np.array([*target[:2], 5.0 * any(target)]),
        ),
    )  # fmt: skip
    motion = SimpleNamespace(time=np.array([0.0, 1.0]), deflection=np.array([0.0, 1.0]))
    data = [SimpleNamespace(record=None, initial_speeds=(np.zeros(3), np.zeros((3, 2))), motion=motion)] * 2
    model = SimpleNamespace(restoring=False, mechanism=None)
    # half of 5 and all of 5 are left, of 5 and 5
    expected = math.sqrt((2.5**2 + 25.0) / 50.0) if any(target) else 0.0
    assert initial.equation_error(model, data) == pytest.approx(expected)
    monkeypatch.setattr(initial, "averaged_fit", lambda model, data: SimpleNamespace(phase_error=0.3))
    assert initial.equation_error(model, data) == pytest.approx(expected)
    model.restoring = True
    assert initial.equation_error(model, data) == 0.3
