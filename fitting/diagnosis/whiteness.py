"""Whether what is left looks like noise: autocorrelation of the whitened residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitting.estimation import Fit
from fitting.estimation.problem import Projection

Array = NDArray[np.float64]

_LAGS = 12
_POWERS = 4


@dataclass(frozen=True)
class Whiteness:
    """Ljung-Box test of the casing's whitened residuals, block by block.

    Attributes
    ----------
    label : str
        Case.
    p_value : float
        Of the Ljung-Box statistic (G. Ljung, G. Box, Biometrika 65, 297 (1978)).
    """

    label: str
    p_value: float


def whiteness(fit: Fit) -> list[Whiteness]:
    """Return the test for each case of a fit."""
    from scipy.special import chdtrc

    results = []
    for data, n, p in zip(fit.problem.data, fit.noise, fit.predictions, strict=True):
        # a level of noise that has swallowed what the model misses would whiten that too
        project = Projection(data, n.whitener.at(n.pure))
        blocks, k, _ = data.casing.lift.shape
        rows = project(p.rows - data.z)[data.slices["casing"]].reshape(blocks, k)[:, :_POWERS]
        lags = min(_LAGS, blocks // 4)
        rows = rows - rows.mean(axis=0)
        power = float((rows**2).sum())
        rho = (
            np.array([float((rows[m:] * rows[:-m]).sum()) / power for m in range(1, lags + 1)])
            if lags
            else np.zeros(0)
        )
        weights = _POWERS / (blocks - np.arange(1, lags + 1))
        statistic = float(blocks * (blocks + 2) * (rho**2 * weights).sum())
        results.append(Whiteness(data.record.label, float(chdtrc(max(lags, 1), statistic))))
    return results
