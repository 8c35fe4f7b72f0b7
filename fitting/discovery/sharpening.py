"""Searches with less noise than a model leaves, for where that noise holds the search."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from fitting.errors import FittingError
from fitting.estimation import Fit, fit
from fitting.estimation.noise_levels import Noise

# BIC must fall by this much: "positive" evidence after R. Kass, A. Raftery, J. Am. Stat. Assoc. 90, 773 (1995)
_EVIDENCE = 2.0


def excused(found: Fit) -> bool:
    """Return whether a fit leaves more than the noise of the data, which counts as noise in it."""
    return any(n.level > n.pure for n in found.noise)


def sharpest(found: Fit) -> Fit:
    """Return a fit, or the one from a search with no more noise than the data has if that describes the data better.

    Where the noise that a model is excused with hides what is wrong about a shape, nothing moves it.
    """
    if not excused(found):
        return found
    pure = [replace(n, level=n.pure, whitener=n.whitener.at(n.pure)) for n in found.noise]
    # without an excuse a search may run away to where nothing can be integrated
    with suppress(FittingError):
        sharp = again(found, pure)
        return sharp if sharp.deviance < found.deviance - _EVIDENCE else found
    return found


def again(found: Fit, noise: Sequence[Noise]) -> Fit:
    """Return a fit made again from its own values at a given noise, to the end."""
    layout = found.problem.layout
    return fit(
        found.model,
        found.problem.data,
        share=[k for k in found.model.free if k not in layout.per_case] if len(layout.records) > 1 else (),
        per_case=layout.per_case,
        start={k: e.value for k, e in found.estimates.items()},
        noise=noise,
    )
