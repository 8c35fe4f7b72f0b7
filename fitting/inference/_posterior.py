"""Draws from the posterior distribution of the parameters, for ArviZ.

There are two distributions. The first is the normal distribution of the linearised problem, N(theta, covariance), from
which all standard uncertainties are taken. The second is the likelihood of the fit at its noise with a flat prior
within the bounds. The package emcee (D. Foreman-Mackey et al., PASP 125, 306 (2013)) samples it with the
affine-invariant ensemble of J. Goodman, J. Weare, Commun. Appl. Math. Comput. Sci. 5, 65 (2010). If the fit has a lack
of fit, the log-likelihood is divided by the factor by which the variances are increased.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fitting._arguments import COUNT, require
from fitting._errors import EstimationError, FittingError
from fitting.inference._problem import Problem
from fitting.inference._ties import follow

Array = NDArray[np.float64]

METHODS = ("linearised", "emcee")


class Solved(Protocol):
    """The attributes of a `Fit` that determine its posterior."""

    @property
    def problem(self) -> Problem: ...
    @property
    def theta(self) -> Array: ...
    @property
    def covariance(self) -> Array: ...
    @property
    def variance_factor(self) -> float: ...


def draws(fit: Solved, count: int, chains: int, method: str, seed: int) -> Array:
    """Return draws of all variables of a fit, (chains, count, variables); variables at a bound are constant.

    An EstimationError is raised if an argument is wrong, the fit has no covariance, or emcee is not installed.
    """
    require("draws", count, COUNT)
    require("chains", chains, COUNT)
    if method not in METHODS:
        raise EstimationError(f"there is no method {str(method)[:30]!r}", f"use {' or '.join(METHODS)}")
    covariance = fit.covariance
    free = (np.diag(covariance) > 0) & np.isfinite(np.diag(covariance)) & fit.problem.layout.is_free
    if not free.any():
        raise EstimationError("no parameter of this fit has an uncertainty", "see `fit_report()`")
    rng = np.random.default_rng(seed)
    root = _root(covariance[np.ix_(free, free)])
    if method == "emcee":
        return _sampled(fit, free, root, count, chains, rng)
    theta = np.tile(fit.theta, (chains, count, 1))
    theta[..., free] += rng.standard_normal((chains, count, int(free.sum()))) @ root.T
    return _followed(fit, theta)


def _root(covariance: Array) -> Array:
    """Return a matrix whose product with its transpose is the covariance, which may be singular."""
    size = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    return np.asarray(size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def _followed(fit: Solved, theta: Array) -> Array:
    tied = fit.problem.layout.tied
    if tied:
        flat = theta.reshape(-1, theta.shape[-1])
        theta = np.array([follow(row, tied) for row in flat]).reshape(theta.shape)
    return theta


def _sampled(
    fit: Solved, free: NDArray[np.bool_], root: Array, count: int, chains: int, rng: np.random.Generator
) -> Array:
    try:
        import emcee
    except ImportError:
        raise EstimationError(
            "sampling needs emcee, which is not installed", 'pip install "gyrotrack[bayes]"'
        ) from None
    # an ensemble of n parameters needs at least 2 n walkers
    n = int(free.sum())
    walkers = max(chains, 2 * n + 2)
    walkers += walkers % 2
    lower, upper = fit.problem.layout.bounds()
    limits = lower[free], upper[free]
    scale = np.sqrt(np.diag(fit.covariance)[free])
    begin = np.clip(fit.theta[free] + rng.standard_normal((walkers, n)) @ root.T, *limits)
    # walkers that start on a bound are moved inside, because two walkers on a bound would coincide
    begin += 1e-3 * scale * np.where(begin <= limits[0], 1.0, np.where(begin >= limits[1], -1.0, 0.0))

    def log_probability(x: Array) -> float:
        if (x < limits[0]).any() or (x > limits[1]).any():
            return -np.inf
        theta = fit.theta.copy()
        theta[free] = x
        try:
            r, _ = fit.problem.residuals(fit.problem.predict(theta))
        except FittingError:
            return -np.inf
        return float(-0.5 * (r @ r) / fit.variance_factor)

    sampler = emcee.EnsembleSampler(walkers, n, log_probability)
    state = np.random.RandomState(rng.integers(2**31)).get_state()
    # the walkers start at the linearised posterior, and forget it within a quarter of the draws
    burnt = max(count // 4, 50)
    sampler.run_mcmc(emcee.State(begin, random_state=state), burnt + count)
    theta = np.tile(fit.theta, (walkers, count, 1))
    theta[..., free] = np.swapaxes(sampler.get_chain(discard=burnt), 0, 1)
    return _followed(fit, theta)


def to_arviz(fit: Solved, names: dict[str, int], **options: Any) -> Any:
    """Return an arviz data tree (InferenceData before version 1) with draws of the named variables."""
    try:
        import arviz
    except ImportError:
        raise EstimationError(
            "a posterior for ArviZ needs arviz, which is not installed", 'pip install "gyrotrack[bayes]"'
        ) from None
    drawn = draws(fit, **options)
    posterior = {name: drawn[..., i] for name, i in names.items()}
    if int(arviz.__version__.partition(".")[0]) > 0:
        return arviz.from_dict({"posterior": posterior})
    return arviz.from_dict(posterior=posterior)
