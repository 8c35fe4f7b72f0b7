"""Differences between runs and the spread over repeats, against hand calculation and simulation."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import Estimate, EstimationError, Model, compare

KEY = "casing.air.linear.b2"


def fitted(value, stderr, *, effects=("casing.air.linear",), at_bound=False, name=KEY):
    model = Model.of(effects)
    return SimpleNamespace(model=model, estimates={name: Estimate(value, stderr, "N m s", at_bound)})


def test_two_runs_differ_by_their_combined_uncertainty():
    found = compare({"left": fitted(1.0, 0.03), "right": fitted(1.2, 0.04)})
    (p,) = found.parameters
    assert p.difference_sigma == pytest.approx(4.0)
    assert p.p_value == pytest.approx(math.erfc(4 / math.sqrt(2)), rel=1e-6)
    # Paule-Mandel of two: (x2 - x1)^2 / 2 = tau^2 + mean square uncertainty, weighted alike
    weights = 1 / (np.array([0.03, 0.04]) ** 2 + p.spread**2)
    assert weights @ (np.array([1.0, 1.2]) - p.mean) ** 2 == pytest.approx(1.0)
    assert "4.0 standard uncertainties" in found.sentences[0]
    # with the spread the runs agree, and a single run claims no more than its repeatability
    totals = [p.total(r) for r in p.repeats]
    assert totals == pytest.approx([math.hypot(0.03, p.spread), math.hypot(0.04, p.spread)])
    assert 0.2 / math.hypot(*totals) < 1.1
    assert found.document()["parameters"][KEY]["values"][0]["total"] == pytest.approx(totals[0])


def test_changepoints_are_not_compared_between_runs():
    step = {"effects": ("touchpoint.step",)}
    runs = {
        "a": fitted(3.0, 0.1, name="touchpoint.step.t0", **step),
        "b": fitted(90.0, 0.1, name="touchpoint.step.t0", **step),
    }
    assert compare(runs).parameters == ()
    strengths = {n: fitted(3.0, 0.1, name="touchpoint.step.k", **step) for n in runs}
    assert len(compare(strengths).parameters) == 1


def test_equal_runs_have_no_spread_and_the_weighted_mean():
    found = compare({"a": fitted(1.0, 0.1), "b": fitted(1.1, 0.2), "c": fitted(0.95, 0.1)})
    (p,) = found.parameters
    assert p.spread == 0
    assert p.mean == pytest.approx((1.0 / 0.01 + 1.1 / 0.04 + 0.95 / 0.01) / 225)
    assert p.mean_u == pytest.approx(1 / 15)
    assert found.sentences[0].startswith("No significant difference")


def test_effects_and_bounds_that_differ_are_named():
    both = ("casing.air.linear", "touchpoint.constant")
    found = compare({"a": fitted(1.0, 0.1, effects=both), "b": fitted(0.0, float("nan"), at_bound=True)})
    assert found.effects == {"touchpoint.constant": ("a",)}
    assert found.bounds == {KEY: ("b",)}
    assert found.parameters == ()


def test_cases_of_a_joint_fit_are_repeats():
    one = fitted(1.0, 0.1, name=f"{KEY}@x")
    found = compare({"a": one, "b": fitted(1.1, 0.1)})
    assert [r.run for r in found.parameters[0].repeats] == ["a:x", "b"]


def test_a_single_run_is_refused():
    with pytest.raises(EstimationError, match="two fits"):
        compare({"a": fitted(1.0, 0.1)})


@pytest.mark.slow
@pytest.mark.release
def test_intervals_of_mean_and_spread_have_the_stated_coverage():
    """600 sets of 8 runs of unequal uncertainty: 68 % intervals of spread, and of the mean by Student's t with 7."""
    rng = np.random.default_rng(1)
    inside = {"mean": 0, "spread": 0}
    for _ in range(600):
        u = rng.uniform(0.05, 0.3, 8)
        x = 5 + rng.normal(0, 0.2, 8) + rng.normal(0, u)
        (p,) = compare({str(i): fitted(a, b) for i, (a, b) in enumerate(zip(x, u, strict=True))}).parameters
        inside["mean"] += (
            abs(p.mean - 5) < 1.077 * p.mean_u
        )  # 68.3 % of Student's t with 7 degrees of freedom
        inside["spread"] += p.spread_interval[0] <= 0.2 <= p.spread_interval[1]
    # binomial standard deviation of 600 trials: 0.019
    assert inside["spread"] / 600 == pytest.approx(0.683, abs=0.06)
    assert inside["mean"] / 600 == pytest.approx(0.683, abs=0.06)
