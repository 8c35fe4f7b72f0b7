"""Parameters of another study as a Gaussian prior: against the analytic posterior, and a joint fit."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import EstimationError, Model
from fitting.inference._case_data import CaseData, with_prior
from fitting.inference._fit import fit
from fitting.inference._prior import Prior
from tests.fitting.oscillators import record

RATE, STRENGTH, START, SIGMA = 10.0, 0.4, 60.0, 0.35


def test_priors_of_two_studies_are_independent_and_have_other_names():
    drum = Prior(("a.k", "b.k"), (1.0, 2.0), ((4.0, 1.0), (1.0, 9.0)), "drum")
    wheel = Prior(("c.k",), (3.0,), ((16.0,),), "wheel")
    both = drum.renamed({"b.k": "d.k"}).joined(wheel)
    assert (both.names, both.mean) == (("d.k", "c.k"), (2.0, 3.0))
    assert both.covariance == ((9.0, 0.0), (0.0, 16.0))
    assert both.source == "drum and wheel"
    with pytest.raises(EstimationError, match=r"both have the parameter a\.k"):
        drum.joined(drum)


def coasting(seed, strength=STRENGTH, span=40.0, label="run", drag=0.0):
    """Speeds of a body under a constant torque, linear in the start and in the strength; or under drag as well."""
    t = np.arange(0.0, span, 1 / RATE)
    if drag:
        slowed = (START + strength / drag) * np.exp(-drag * t) - strength / drag
        return CaseData.of(record(t, slowed, SIGMA, seed, "omega", label))
    return CaseData.of(record(t, START - strength * t, SIGMA, seed, "omega", label))


def posterior(data, mean, u):
    """Return values and covariance of (start, strength) by the normal equations."""
    t, value = data.record.casing.time, data.record.casing.value
    design = np.stack([np.ones_like(t), -t], axis=1) / (SIGMA * data.casing.scale)
    information = design.T @ design + np.diag([0.0, 1 / u**2])
    covariance = np.linalg.inv(information)
    seen = design.T @ (value / (SIGMA * data.casing.scale)) + np.array([0.0, mean / u**2])
    return covariance @ seen, covariance


@pytest.mark.parametrize("offset", [0.0, 3.0])
def test_prior_of_a_linear_model_gives_the_analytic_posterior(offset):
    alone = fit(Model.of(["touchpoint.constant"]), [coasting(2)])
    u = alone.estimates["touchpoint.constant.b1"].stderr
    mean = STRENGTH + offset * u
    (data,) = with_prior([coasting(2)], Prior(("touchpoint.constant.b1",), (mean,), ((u**2,),)))
    found = fit(Model.of(["touchpoint.constant"]), [data])
    value, covariance = posterior(data, mean, u)
    for name, i in (("initial.omega_c@run", 0), ("touchpoint.constant.b1", 1)):
        error = np.sqrt(covariance[i, i])
        assert found.estimates[name].value == pytest.approx(value[i], abs=0.1 * error)
        assert found.estimates[name].stderr == pytest.approx(error, rel=0.1)
    assert found.estimates["touchpoint.constant.b1"].stderr < 0.8 * u


def test_study_as_prior_equals_the_joint_fit_of_both():
    model = Model.of(["touchpoint.constant", "casing.air.linear"])
    first, second = coasting(2, label="first", drag=0.01), coasting(3, span=15.0, label="second", drag=0.01)
    one = fit(model, [first])
    prior = Prior.of(one.problem.layout.names, one.covariance, one.estimates, "first")
    assert prior.names == ("touchpoint.constant.b1", "casing.air.linear.b2")
    (data,) = with_prior([second], prior)
    found = fit(model, [data])
    joint = fit(model, [first, second], share=["touchpoint.constant", "casing.air.linear"])
    for name in prior.names:
        together, own = joint.estimates[name], found.estimates[name]
        assert own.value == pytest.approx(together.value, abs=0.15 * together.stderr)
        assert own.stderr == pytest.approx(together.stderr, rel=0.1)


def test_prior_of_a_parameter_of_which_each_case_has_its_own():
    """Each case is fitted as if it were alone with the prior; what the cases share is counted once."""
    model = Model.of(["touchpoint.constant"])
    runs = [coasting(5, label="a"), coasting(6, strength=0.402, label="b")]
    prior = Prior(("touchpoint.constant.b1",), (STRENGTH,), ((1e-6,),))
    joint = fit(model, with_prior(runs, prior), per_case=["touchpoint.constant.b1"])
    for run in runs:
        alone = fit(model, with_prior([run], prior)).estimates["touchpoint.constant.b1"]
        own = joint.estimates[f"touchpoint.constant.b1@{run.record.label}"]
        assert own.value == pytest.approx(alone.value, abs=0.05 * alone.stderr)
        # the noise of each run is estimated anew
        assert own.stderr == pytest.approx(alone.stderr, rel=0.15)
    shared = fit(model, with_prior(runs, prior), share=["touchpoint.constant.b1"])
    free = fit(model, runs, share=["touchpoint.constant.b1"]).estimates["touchpoint.constant.b1"]
    expected = 1 / np.sqrt(1 / free.stderr**2 + 1e6)
    assert shared.estimates["touchpoint.constant.b1"].stderr == pytest.approx(expected, rel=0.05)


def test_prior_enters_the_score_of_a_missing_effect():
    """Beside a free constant friction a second one is absorbed; a prior of the first determines it."""
    from fitting import LIBRARY
    from fitting._criteria import DEFAULT
    from fitting.discovery._score import CaseColumns, score

    extra = [LIBRARY["external.constant"]]
    (data,) = with_prior([coasting(4, 0.5)], Prior(("touchpoint.constant.b1",), (STRENGTH,), ((1e-6,),)))
    known = fit(Model.of(["touchpoint.constant"]), [data])
    free = fit(Model.of(["touchpoint.constant"]), [coasting(4, 0.5)])
    (with_it,) = score(known, extra, [CaseColumns(known, 0)], DEFAULT)
    (without,) = score(free, extra, [CaseColumns(free, 0)], DEFAULT)
    assert without.absorbed
    assert not with_it.absorbed
    assert with_it.gamma[0] == pytest.approx(-0.1, abs=0.01)


def test_marginal_prior_of_the_parameters_in_a_model():
    covariance = np.array([[4.0, 1.0], [1.0, 9.0]])
    prior = Prior(("a.k", "b.k"), (1.0, 2.0), tuple(map(tuple, covariance.tolist())))
    names, mean, inverse = prior.whitened(["b.k", "c.k"])
    assert names == ("b.k",)
    assert mean == pytest.approx([2.0])
    assert inverse[0, 0] == pytest.approx(1 / 3)
    _, _, inverse = prior.whitened(["a.k", "b.k"])
    assert inverse.T @ inverse == pytest.approx(np.linalg.inv(covariance))


def test_prior_needs_a_regular_covariance():
    with pytest.raises(EstimationError, match="singular"):
        Prior(("a.k", "b.k"), (1.0, 1.0), ((1.0, 1.0), (1.0, 1.0)))
    with pytest.raises(EstimationError, match="not finite"):
        Prior(("a.k",), (float("nan"),), ((1.0,),))
    for variance in (0.0, -0.5):
        with pytest.raises(EstimationError, match="singular"):
            Prior(("a.k",), (1.0,), ((variance,),))
    assert Prior(("a.k",), (1.0,), ((1e-30,),)).mean == (1.0,)


class TestChecks:
    @pytest.mark.parametrize(
        ("names", "mean", "covariance"),
        [
            (("a.k", "b.k"), (1.0,), ((1.0, 0.0), (0.0, 1.0))),
            (("a.k",), (1.0, 2.0), ((1.0,),)),
            (("a.k", "b.k"), (1.0, 2.0), ((1.0,),)),
            (("a.k",), (1.0,), ((1.0, 0.0), (0.0, 1.0))),
            ((), (), ()),
        ],
    )
    def test_sizes_agree(self, names, mean, covariance):
        with pytest.raises(EstimationError, match="different sizes"):
            Prior(names, mean, covariance)

    @pytest.mark.parametrize(("mean", "variance"), [(math.inf, 1.0), (1.0, math.inf), (1.0, math.nan)])
    def test_numbers_are_finite(self, mean, variance):
        with pytest.raises(EstimationError, match="not finite"):
            Prior(("a.k",), (mean,), ((variance,),))

    @pytest.mark.parametrize("sizes", [(1.0, 1.0), (1e-9, 1e3)])  # whatever the units
    @pytest.mark.parametrize(("rest", "singular"), [(2e-13, False), (7e-14, True)])
    def test_a_correlation_up_to_rounding_is_singular(self, sizes, rest, singular):
        """The smaller eigenvalue of the correlations is 1 - r; the limit is 1e-13."""
        a, b = sizes
        both = (1 - rest) * a * b
        covariance = ((a * a, both), (both, b * b))
        if singular:
            with pytest.raises(EstimationError, match="singular"):
                Prior(("a.k", "b.k"), (1.0, 1.0), covariance)
        else:
            assert Prior(("a.k", "b.k"), (1.0, 1.0), covariance).names

    def test_one_variance_of_zero_is_singular(self):
        with pytest.raises(EstimationError, match="singular"):
            Prior(("a.k", "b.k"), (1.0, 1.0), ((1.0, 0.0), (0.0, 0.0)))


def test_what_a_fit_determines_within_its_bounds_becomes_a_prior():
    def estimate(value, stderr=0.1, *, at_bound=False):
        return SimpleNamespace(value=value, stderr=stderr, at_bound=at_bound)

    names = ("a.k", "b.k", "c.k@run", "initial.omega_c@run", "d.k", "e.k", "f.k")
    estimates = {
        "a.k": estimate(1.0), "b.k": estimate(2.0, at_bound=True), "c.k@run": estimate(3.0),
        "initial.omega_c@run": estimate(4.0), "d.k": estimate(5.0, math.nan), "f.k": estimate(7.0),
    }  # fmt: skip
    covariance = np.arange(49.0).reshape(7, 7) + 100 * np.eye(7)
    found = Prior.of(names, covariance, estimates, "study")
    assert (found.names, found.mean, found.source) == (("a.k", "f.k"), (1.0, 7.0), "study")
    assert found.covariance == ((100.0, 6.0), (42.0, 148.0))
    with pytest.raises(EstimationError, match="study determines no parameter"):
        Prior.of(("b.k",), covariance, estimates, "study")


@pytest.mark.parametrize(
    ("names", "label", "shared", "expected"),
    [
        (["a.k", "b.k"], "", True, ("a.k", "b.k")),
        (["a.k", "b.k@run"], "run", True, ("a.k", "b.k@run")),
        (["a.k", "b.k@run"], "other", True, ("a.k",)),
        (["a.k", "b.k@run"], "run", False, ("b.k@run",)),  # the shared one is counted in another case
        (["c.k"], "run", True, ()),
    ],
)
def test_to_which_variables_a_prior_applies(names, label, shared, expected):
    prior = Prior(("a.k", "b.k"), (1.0, 2.0), ((4.0, 1.0), (1.0, 9.0)))
    found, mean, inverse = prior.whitened(names, label, shared=shared)
    assert found == expected
    means = {"a.k": 1.0, "b.k": 2.0}
    assert mean.tolist() == [means[n.partition("@")[0]] for n in expected]
    kept = [("a.k", "b.k").index(n.partition("@")[0]) for n in expected]
    assert inverse.T @ inverse == pytest.approx(np.linalg.inv(np.array(prior.covariance)[np.ix_(kept, kept)]))
