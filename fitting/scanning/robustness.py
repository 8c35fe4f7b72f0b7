"""How steady a parameter is from case to case, and from separate fits to the joint one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

from fitting.estimation import Estimate, Fit
from fitting.scanning.runs import COLUMNS, Column

# shares of the mean: what the paper calls robust moves by a few percent, what it calls unstable by half or more
_ROBUST, _UNSTABLE = 0.1, 0.5


@dataclass(frozen=True)
class Robustness:
    """One parameter of one model across cases.

    Attributes
    ----------
    symbol, key, unit : str
        The parameter.
    mean : float
        Over the separate fits, in SI units.
    spread : float
        Largest minus smallest value of the separate fits, over their mean; nan for a single case.
    shift : float
        From the separate fits to the joint one, over the former: the joint value against their mean, or where
        each case keeps a value of its own the largest of its shifts; nan without a joint fit.
    sigma : float
        Largest difference of two separate fits over its standard error; nan where an error is not known.
    verdict : str
        By the larger of spread and shift "robust" (under a tenth), "varies" (under a half) or "unstable"; for a
        touch point by its shift alone, since surfaces may differ; "zero" or "not determined" where all separate
        fits say so; "not known" for a single case.
    """

    symbol: str
    key: str
    unit: str
    mean: float
    spread: float
    shift: float
    sigma: float
    verdict: str


def robustness(separate: Sequence[Fit], joint: Fit | None) -> tuple[Robustness, ...]:
    """Return how steady each of the paper's parameters is.

    Parameters
    ----------
    separate : sequence of Fit
        The same model on each case.
    joint : Fit or None
        The model on all these cases together, in the same order.
    """
    found = []
    for column in COLUMNS.values():
        own = [e for fit in separate for e in _of(fit, column.key)]
        if len(own) == len(separate) > 0:
            together = _of(joint, column.key) if joint is not None else []
            found.append(_one(column, own, [e.value for e in together]))
    return tuple(found)


def _of(fit: Fit, key: str) -> list[Estimate]:
    return [e for name, e in fit.estimates.items() if name.partition("@")[0] == key]


def _one(column: Column, own: Sequence[Estimate], together: Sequence[float]) -> Robustness:
    values = [e.value for e in own]
    mean = sum(values) / len(values)
    spread = _share(max(values) - min(values), mean) if len(values) > 1 else math.nan
    if len(together) == len(values) > 1:
        shift = max((_share(b - a, a) for a, b in zip(values, together, strict=True)), key=abs)
    else:
        shift = _share(together[0] - mean, mean) if together else math.nan
    pulls = [
        abs(a.value - b.value) / math.hypot(a.stderr, b.stderr)
        for a, b in combinations(own, 2)
        if a.stderr > 0 and b.stderr > 0
    ]
    sigma = max(pulls, default=math.nan)
    verdict = _verdict(column, own, spread, shift)
    return Robustness(column.symbol, column.key, column.unit, mean, spread, shift, sigma, verdict)


def _share(difference: float, of: float) -> float:
    return difference / abs(of) if of else (0.0 if difference == 0 else math.inf)


def _verdict(column: Column, own: Sequence[Estimate], spread: float, shift: float) -> str:
    if all(e.value == 0 for e in own):
        return "zero"
    if all(e.at_bound or e.stderr > abs(e.value) for e in own):
        return "not determined"
    counted = (shift,) if column.key.startswith("touchpoint.") else (spread, shift)
    worst = max((abs(x) for x in counted if not math.isnan(x)), default=math.nan)
    if math.isnan(worst):
        return "not known"
    return "robust" if worst < _ROBUST else "varies" if worst < _UNSTABLE else "unstable"
