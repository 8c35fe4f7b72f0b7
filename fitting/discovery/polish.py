"""What is looked at again with the noise that the better model leaves.

What fluctuates fast and was missing before may have been taken for noise: it hid whatever is smaller, and made
candidates look alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from fitting.discovery.ranking import Candidate, arranged
from fitting.discovery.sharpening import again, sharpest
from fitting.errors import FittingError
from fitting.estimation import Fit
from fitting.estimation.noise_levels import Noise, measure_noise

# noise that falls by less when an effect is added is the same noise, measured twice
_QUIETER = 0.8
# BIC must fall by this much: "positive" evidence after R. Kass, A. Raftery, J. Am. Stat. Assoc. 90, 773 (1995)
_EVIDENCE = 2.0


def polished(found: Fit) -> Fit:
    """Return a fit that was made quickly, at its minimum, with the noise that its own model leaves."""
    end = sharpest(again(found, found.noise))
    noise = measure_noise(end.problem, end.theta)
    if all(new.pure >= _QUIETER * old.pure for new, old in zip(noise, end.noise, strict=True)):
        return end
    quieter = sharpest(again(end, noise))
    return quieter if quieter.bic < end.bic - _EVIDENCE else end


def is_quieter(fit: Fit, than: Fit) -> bool:
    """Return whether there is less noise than in another fit: what no torque explains, or what the model leaves."""
    return any(
        n.pure < old.pure or n.level < _QUIETER * old.level
        for n, old in zip(fit.noise, than.noise, strict=True)
    )


def reconsidered(
    base: Fit, candidates: Sequence[Candidate], chosen: Candidate, noise: Sequence[Noise]
) -> list[Candidate]:
    """Return the candidates in their order and classes, one and its look-alikes refitted at another noise.

    Parameters
    ----------
    base : Fit
        The fit without them.
    candidates : sequence of Candidate
        As they were ranked at the noise of the base.
    chosen : Candidate
        One of them.
    noise : sequence of Noise
        What it leaves.
    """
    try:
        plain = again(base, noise)
    except FittingError:
        return list(candidates)
    alike = {chosen.effect.name, *chosen.indistinguishable_from}
    return arranged([_refitted(c, plain, noise) if c.effect.name in alike else c for c in candidates])


def _refitted(c: Candidate, base: Fit, noise: Sequence[Noise]) -> Candidate:
    """Return a candidate with its refit at another noise; without one if the search runs away there."""
    if c.fit is None:
        return c
    try:
        end = again(c.fit, noise)
    except FittingError:
        return replace(c, delta_bic=float("nan"), fit=None)
    own = {k: e for k, e in end.estimates.items() if k.startswith(c.effect.name + ".")}
    return replace(
        c, score=base.deviance - end.deviance, delta_bic=end.bic - base.bic, estimates=own, fit=end
    )
