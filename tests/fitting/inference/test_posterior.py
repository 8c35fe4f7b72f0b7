"""Draws of a posterior: mean and covariance, held and tied parameters, and walkers of a stand-in for emcee."""

import math
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import EstimationError, SimulationError
from fitting.inference import _posterior
from fitting.inference._posterior import draws

INF = math.inf


class Emcee:
    """The package: its walkers stay where they are, and number their steps."""

    def __init__(self):
        self.State = lambda begin, random_state: SimpleNamespace(begin=begin, random_state=random_state)
        self.EnsembleSampler = self.sampler

    def sampler(self, walkers, n, log):
        self.walkers, self.n, self.log = walkers, n, log
        return self

    def run_mcmc(self, state, steps):
        self.begin, self.random_state, self.steps = state.begin, state.random_state, steps

    def get_chain(self, discard):
        step, walker, variable = np.ogrid[discard : self.steps, : self.walkers, : self.n]
        return step + 1000.0 * walker + 1e6 * variable


@pytest.fixture
def emcee(monkeypatch):
    package = Emcee()
    monkeypatch.setitem(sys.modules, "emcee", package)
    return package


def fit(lower=(-INF, -INF, -INF), upper=(INF, INF, INF), *, tied=(), covariance=((4.0, 0.1), (0.1, 0.01))):
    """Variables 1, 2 and a constant 3; the residuals are 1 for each deviation of (2, 0.1) and 7."""
    whole = np.zeros((3, 3))
    whole[:2, :2] = covariance

    def predict(theta):
        if theta[0] > 50.0:
            raise SimulationError("no motion")
        return theta

    layout = SimpleNamespace(
        is_free=np.ones(3, dtype=bool), tied=tied, bounds=lambda: (np.array(lower), np.array(upper))
    )
    problem = SimpleNamespace(
        layout=layout,
        predict=predict,
        residuals=lambda t: (np.array([(t[0] - 1) / 2, (t[1] - 2) / 0.1, t[2] + 4.0]), None),
    )
    return SimpleNamespace(
        problem=problem, theta=np.array([1.0, 2.0, 3.0]), covariance=whole, variance_factor=2.0
    )


@pytest.mark.parametrize(
    ("chains", "free", "walkers"), [(1, 2, 6), (6, 2, 6), (7, 2, 8), (8, 2, 8), (1, 1, 4), (5, 1, 6)]
)
def test_emcee_gets_an_even_number_of_walkers_of_at_least_twice_the_parameters(emcee, chains, free, walkers):
    known = fit(covariance=np.diag([4.0, 0.01 * (free == 2)]))
    drawn = draws(known, 20, chains, "emcee", 1)
    assert (emcee.walkers, emcee.n) == (walkers, free)
    assert drawn.shape == (walkers, 20, 3)
    assert (drawn[..., free:] == known.theta[free:]).all()


@pytest.mark.parametrize(("count", "burnt"), [(20, 50), (200, 50), (208, 52), (400, 100)])
def test_a_quarter_of_the_draws_and_at_least_fifty_are_forgotten(emcee, count, burnt):
    drawn = draws(fit(), count, 6, "emcee", 1)
    assert emcee.steps == burnt + count
    assert drawn[0, :, 0].tolist() == list(range(burnt, burnt + count))
    assert drawn[3, 0].tolist() == [burnt + 3000.0, burnt + 3000.0 + 1e6, 3.0]


def test_the_probability_is_that_of_the_residuals_within_the_bounds(emcee):
    draws(fit((-5.0, -INF, -INF), (99.0, 2.5, INF)), 9, 6, "emcee", 1)
    rest = 49.0
    for x, square in (((1.0, 2.0), 0.0), ((3.0, 2.0), 1.0), ((1.0, 2.5), 25.0), ((-5.0, 1.8), 9.0 + 4.0)):
        assert emcee.log(np.array(x)) == pytest.approx(-0.25 * (square + rest))
    for x in ((-5.1, 2.0), (1.0, 2.6), (99.1, 2.0), (60.0, 2.0)):
        assert emcee.log(np.array(x)) == -INF


def test_walkers_begin_at_the_linearised_posterior(emcee):
    draws(fit(), 9, 4000, "emcee", 1)
    assert emcee.begin.mean(axis=0) == pytest.approx([1.0, 2.0], abs=0.15)
    assert np.cov(emcee.begin.T) == pytest.approx(np.array([[4.0, 0.1], [0.1, 0.01]]), rel=0.1)
    first, state = emcee.begin, emcee.random_state
    draws(fit(), 9, 4000, "emcee", 1)
    assert (emcee.begin == first).all()
    assert (emcee.random_state[1] == state[1]).all()
    draws(fit(), 9, 4000, "emcee", 2)
    assert (emcee.begin != first).all()
    assert (emcee.random_state[1] != state[1]).any()


def test_walkers_on_a_bound_are_moved_inside_by_a_thousandth_of_the_uncertainty(emcee):
    draws(fit((1.0, -INF, -INF), (INF, 2.0, INF), covariance=np.diag([4.0, 0.01])), 9, 400, "emcee", 1)
    x, y = emcee.begin.T
    assert x.min() > 1.0
    assert y.max() < 2.0
    assert 150 < np.sum(np.isclose(x, 1.002, atol=1e-12)) < 250
    assert 150 < np.sum(np.isclose(y, 1.9999, atol=1e-12)) < 250
    # those inside stay where they are
    inside = x[x > 1.003]
    assert np.mean(inside - 1.0) == pytest.approx(2.0 * math.sqrt(2 / math.pi), rel=0.15)


def test_tied_parameters_follow_the_walkers(emcee):
    def double(theta):
        return 2 * theta[0], None

    double.place = 2
    drawn = draws(fit(tied=(double,)), 9, 6, "emcee", 1)
    assert (drawn[..., 2] == 2 * drawn[..., 0]).all()


class TestPosterior:
    def fit(self, covariance, free=(True, True, True), tied=()):
        layout = SimpleNamespace(is_free=np.array(free), tied=tied)
        return SimpleNamespace(
            problem=SimpleNamespace(layout=layout),
            theta=np.array([1.0, 2.0, 3.0]),
            covariance=np.array(covariance),
        )

    def test_draws_have_mean_and_covariance_and_hold_the_others(self):
        covariance = np.array([[4.0, -1e-3, 0.0], [-1e-3, 1e-6, 0.0], [0.0, 0.0, np.inf]])
        found = draws(self.fit(covariance), 4000, 2, "linearised", 1)
        assert found.shape == (2, 4000, 3)
        assert (found[..., 2] == 3.0).all()
        flat = found[..., :2].reshape(-1, 2)
        assert np.cov(flat.T) == pytest.approx(covariance[:2, :2], rel=0.06)
        assert flat.mean(axis=0) == pytest.approx([1.0, 2.0], abs=0.07)
        held = draws(self.fit(covariance, free=(False, True, True)), 10, 1, "linearised", 1)
        assert (held[..., 0] == 1.0).all()
        assert np.ptp(held[..., 1]) > 0

    def test_without_an_uncertainty_there_are_no_draws(self):
        for covariance in (np.zeros((3, 3)), np.diag([np.inf] * 3)):
            with pytest.raises(EstimationError, match="no parameter"):
                draws(self.fit(covariance), 10, 1, "linearised", 1)
        with pytest.raises(EstimationError, match="no method"):
            draws(self.fit(np.eye(3)), 10, 1, "other", 1)

    def test_a_root_gives_the_covariance_even_if_it_is_singular(self):
        v = np.array([2.0, 1e-6])
        for covariance in (np.outer(v, v), np.array([[4.0, 1e-6], [1e-6, 1e-12]])):
            root = _posterior._root(covariance)
            assert root @ root.T == pytest.approx(covariance, rel=1e-6)

    def test_tied_parameters_follow_each_draw(self, monkeypatch):
        monkeypatch.setattr(_posterior, "follow", lambda row, tied: np.array([row[0], row[1], 2 * row[0]]))
        found = draws(self.fit(np.eye(3), tied=("x",)), 5, 2, "linearised", 1)
        assert found[..., 2] == pytest.approx(2 * found[..., 0])
