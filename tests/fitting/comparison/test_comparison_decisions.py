"""Mean, spread and sentences of a comparison, by a calculation without the program, on either side of each limit."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from fitting import Estimate, EstimationError, Model, compare
from fitting.comparison import _comparison as module

KEY = "casing.air.linear.b2"
LEVEL = 0.6827


def fitted(value, stderr, *, unit="N m s", at_bound=False, name=KEY, effects=("casing.air.linear",)):
    return SimpleNamespace(model=Model.of(effects), estimates={name: Estimate(value, stderr, unit, at_bound)})


def compared(values, errors):
    runs = {f"r{i}": fitted(x, u) for i, (x, u) in enumerate(zip(values, errors, strict=True))}
    (found,) = compare(runs).parameters
    return found


def chi_square(values, errors, spread):
    w = 1.0 / (np.square(errors) + spread**2)
    mean = np.sum(w * values) / np.sum(w)
    return float(np.sum(w * (values - mean) ** 2)), float(mean), float(np.sum(w))


@pytest.mark.parametrize(
    ("values", "errors"),
    [
        ([1.0, 1.9, 1.2, 3.0], [0.1, 0.2, 0.3, 0.15]),
        ([5.0, 5.1, 4.7], [0.1, 0.2, 0.05]),
        ([-2.0, 4.0], [0.5, 1.5]),
    ],
)
def test_mean_spread_and_interval_are_those_of_the_random_effects_model(values, errors):
    found, dof = compared(values, errors), len(values) - 1
    q, mean, weight = chi_square(values, errors, found.spread)
    assert q == pytest.approx(dof, rel=1e-6)
    assert found.mean == pytest.approx(mean)
    assert found.mean_u == pytest.approx(1.0 / math.sqrt(weight), rel=1e-6)
    assert found.p_value == pytest.approx(stats.chi2.sf(chi_square(values, errors, 0.0)[0], dof), rel=1e-6)
    tail = 0.5 * (1.0 - LEVEL)
    for limit, probability in zip(found.spread_interval, (tail, 1.0 - tail), strict=True):
        target = stats.chi2.isf(probability, dof)
        if limit > 0:
            assert chi_square(values, errors, limit)[0] == pytest.approx(target, rel=1e-6)
        else:
            assert chi_square(values, errors, 0.0)[0] <= target
    assert found.spread_interval[0] < found.spread < found.spread_interval[1]
    assert (found.name, found.unit) == (KEY, "N m s")
    assert [(r.run, r.value, r.stderr) for r in found.repeats] == [
        (f"r{i}", x, u) for i, (x, u) in enumerate(zip(values, errors, strict=True))
    ]
    difference = (values[1] - values[0]) / math.hypot(errors[0], errors[1])
    assert found.difference_sigma == (pytest.approx(difference) if dof == 1 else None)


def test_equal_runs_state_an_interval_of_the_spread_and_the_formal_uncertainty():
    found = compared([1.0, 1.02, 0.99], [0.1, 0.1, 0.1])
    assert (found.spread, found.spread_interval[0]) == (0.0, 0.0)
    assert found.mean_u == pytest.approx(0.1 / math.sqrt(3.0))
    assert found.difference_sigma is None
    # Q = sum (x - mean)^2 / (u^2 + s^2) is at the upper limit the 84 % quantile of the lower tail
    squares = float(np.sum((np.array([1.0, 1.02, 0.99]) - found.mean) ** 2))
    limit = squares / stats.chi2.isf(0.5 * (1.0 + LEVEL), 2) - 0.01
    assert found.spread_interval[1] == pytest.approx(math.sqrt(max(limit, 0.0)), abs=1e-9)


@pytest.mark.parametrize(("sigma", "told"), [(2.56, False), (2.60, True), (-2.60, True)])
def test_one_parameter_differs_at_one_percent(sigma, told):
    found = compare({"a": fitted(0.0, 0.6), "b": fitted(sigma, 0.8)})
    assert found.sentences[0].startswith("No significant") != told
    assert not told or "by 2.6 standard" in found.sentences[0]


@pytest.mark.parametrize(("sigma", "told"), [(2.78, False), (2.84, True)])
def test_of_two_parameters_one_differs_at_half_a_percent(sigma, told):
    effects = ("casing.air.linear", "touchpoint.constant")

    def run(x):
        return SimpleNamespace(
            model=Model.of(effects),
            estimates={
                "touchpoint.constant.k": Estimate(1.0, 0.1, "N m", False),
                KEY: Estimate(x, math.sqrt(0.5), "N m s", False),
            },
        )

    found = compare({"a": run(0.0), "b": run(sigma)})
    assert [p.name for p in found.parameters] == [KEY, "touchpoint.constant.k"]  # the least p-value first
    assert found.sentences[0].startswith("No significant difference in 2") != told


def test_the_growth_of_the_uncertainty_is_that_of_the_most_precise_run():
    found = compare({"a": fitted(0.0, 0.1), "b": fitted(10.0, 1.0)})
    spread = found.parameters[0].spread
    assert f"up to {math.hypot(0.1, spread) / 0.1:.2g} times" in found.sentences[0]


@pytest.mark.parametrize(
    ("value", "stderr", "at_bound", "bound"),
    [
        (1.0, 0.1, False, False),
        (1.0, 0.1, True, True),
        (1.0, math.inf, False, True),
        (1.0, math.nan, False, True),
        (1.0, 0.0, False, True),
    ],
)
def test_a_parameter_at_a_bound_or_without_an_uncertainty_is_not_compared(value, stderr, at_bound, bound):
    found = compare(
        {"a": fitted(1.0, 0.1), "b": fitted(1.1, 0.2), "c": fitted(value, stderr, at_bound=at_bound)}
    )
    assert [r.run for r in found.parameters[0].repeats] == ["a", "b", *([] if bound else ["c"])]
    assert found.bounds == ({KEY: ("c",)} if bound else {})
    assert any("at its bound in c" in s for s in found.sentences) == bound


def test_effects_of_some_runs_are_named_with_these_runs():
    both = ("casing.air.linear", "touchpoint.constant")
    found = compare(
        {"a": fitted(1.0, 0.1), "b": fitted(1.0, 0.1, effects=both), "c": fitted(1.0, 0.1, effects=both)}
    )
    assert found.effects == {"touchpoint.constant": ("b", "c")}
    assert any(s.endswith("is only in b, c.") for s in found.sentences)
    document = found.document({"x.h5": "reason"})
    assert document["effects"] == {"touchpoint.constant": ["b", "c"]}
    assert document["failed"] == {"x.h5": "reason"}
    own = document["parameters"][KEY]
    assert (own["mean"], own["spread"]["value"], own["unit"]) == (
        {"value": 1.0, "stderr": pytest.approx(0.1 / math.sqrt(3.0))},
        0.0,
        "N m s",
    )
    assert document["runs"] == ["a", "b", "c"]


@pytest.mark.parametrize(
    ("count", "text"), [(2, "r0, r1"), (12, "r10, r11"), (13, "r11 and 1 more"), (15, "r11 and 3 more")]
)
def test_twelve_runs_are_named(count, text):
    found = module._listed([f"r{i}" for i in range(count)])
    assert found.endswith(text)
    assert found.startswith("r0, r1")


def test_every_run_has_a_time_if_times_are_given():
    runs = {"a": fitted(1.0, 0.1), "b": fitted(1.1, 0.1)}
    with pytest.raises(EstimationError, match="run b has no time"):
        compare(runs, {"a": 1.0})
    assert compare(runs, {"a": 1.0, "b": 2.0, "c": 3.0}).population is None


@pytest.mark.parametrize("two", [False, True])
def test_effects_in_words_name_the_single_body(two):
    run = fitted(1.0, 0.1)
    if two:
        run.estimates["initial.omega_r@x"] = Estimate(1.0, 0.1, "rad/s", False)
    plain = compare({"a": run, "b": run}).called("casing.air.linear")
    named = compare({"a": run, "b": run}, body="wheel").called("casing.air.linear")
    assert ("wheel" in named) != two
    assert (plain == named) == two
    assert compare({"a": run, "b": run}).called("something") == "something"
