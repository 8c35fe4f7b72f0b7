"""Prior knowledge of parameters: values and covariance from another study.

A Gaussian prior with mean m and covariance C = L L' acts like a measurement of the parameters theta. It adds the
following rows, in units of their noise, to the rows of a case:

    L^-1 (theta - m).

The sum of squares is then minus twice the logarithm of the posterior density, and (J'J)^-1 is the covariance of the
posterior distribution. In a linear model, the estimate is (J'J + C^-1)^-1 (J'z + C^-1 m), the combination of both
studies by generalised least squares (A. Gelman et al., Bayesian Data Analysis, 3rd ed., ch. 14.8). Because the prior
consists of rows, the score test, the test of lack of fit and every refit take it into account.

If each case of a joint fit has its own value of a parameter, the prior applies to each of these values. The uncertainty
of the prior must then include the spread between runs.

The studies must be independent: with a prior from the same data, the data would count twice.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from fitting._errors import EstimationError
from fitting.inference._linear_algebra import block_diagonal

Array = NDArray[np.float64]

_SINGULAR = 1e-13
"""Relative eigenvalue below which a covariance is singular [1]. Chosen: a smaller value accepts rounding errors, a
larger one refuses strongly correlated parameters."""


@dataclass(frozen=True)
class Prior:
    """A Gaussian prior."""

    names: tuple[str, ...]  # parameters, ``effect.symbol``
    mean: tuple[float, ...]  # values of the parameters [SI]
    covariance: tuple[tuple[float, ...], ...]  # covariance of the parameters [SI]
    source: str = ""  # the study that determined them

    def __post_init__(self) -> None:
        matrix = np.array(self.covariance, dtype=float)
        if matrix.shape != (len(self.names),) * 2 or len(self.mean) != len(self.names) or not self.names:
            raise EstimationError("the prior has values, names and covariance of different sizes")
        if not (np.isfinite(matrix).all() and np.isfinite(self.mean).all()):
            raise EstimationError("the prior has a value that is not finite")
        size = np.sqrt(np.maximum(np.diag(matrix), 0.0))
        if not (size > 0).all() or np.linalg.eigvalsh(matrix / np.outer(size, size))[0] < _SINGULAR:
            raise EstimationError(
                "the covariance of the prior is singular",
                "The parameters of that study are degenerate: drop an effect from its model.",
            )

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        covariance: Sequence[Sequence[float]],
        estimates: Mapping[str, Any],
        source: str,
    ) -> Self:
        """Return the prior of a fit: all parameters of its effects that it determines within their bounds.

        Initial speeds, and parameters with a value for each case, belong to the runs of that study and are left out.
        """
        kept = [
            i
            for i, name in enumerate(names)
            if "@" not in name
            and name in estimates
            and not estimates[name].at_bound
            and math.isfinite(estimates[name].stderr)
        ]
        if not kept:
            raise EstimationError(
                f"{source} determines no parameter that another study could use",
                "It needs a fit with an effect whose strength is not at its bound.",
            )
        matrix = np.array(covariance, dtype=float)[np.ix_(kept, kept)]
        return cls(
            tuple(names[i] for i in kept),
            tuple(float(estimates[names[i]].value) for i in kept),
            tuple(tuple(row) for row in matrix.tolist()),
            source,
        )

    def renamed(self, names: Mapping[str, str]) -> Self:
        """Return the prior of parameters with other names; parameters without a new name are left out."""
        kept = [i for i, name in enumerate(self.names) if name in names]
        covariance = tuple(tuple(self.covariance[i][j] for j in kept) for i in kept)
        new = tuple(names[self.names[i]] for i in kept)
        return replace(self, names=new, mean=tuple(self.mean[i] for i in kept), covariance=covariance)

    def joined(self, other: Self) -> Self:
        """Return two priors from independent studies as a single prior; no parameter may occur in both."""
        twice = sorted({*self.names} & {*other.names})
        if twice:
            raise EstimationError(
                f"{self.source} and {other.source} both have the parameter {twice[0]}",
                "Leave one of them out.",
            )
        covariance = block_diagonal([np.array(self.covariance), np.array(other.covariance)])
        return replace(
            self,
            names=(*self.names, *other.names),
            mean=(*self.mean, *other.mean),
            covariance=tuple(map(tuple, covariance.tolist())),
            source=f"{self.source} and {other.source}",
        )

    def whitened(
        self, names: Sequence[str], label: str = "", *, shared: bool = True
    ) -> tuple[tuple[str, ...], Array, Array]:
        """Return the variables to which the prior applies, their means (k,), and L^-1 (k, k) of their covariance.

        With a `label`, a prior of a parameter with a value for each case applies to ``name@label``. Parameters that all
        cases share are included only if `shared`: in a joint fit their prior must count only once.
        """
        found = {}
        for i, name in enumerate(self.names):
            if name in names and shared:
                found[i] = name
            elif f"{name}@{label}" in names:
                found[i] = f"{name}@{label}"
        present = list(found)
        lower = np.linalg.cholesky(np.array(self.covariance)[np.ix_(present, present)])
        return tuple(found.values()), np.array(self.mean)[present], np.linalg.inv(lower)
