"""What counts as right: judgements of one line, and shares of many with their intervals."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from hidden import twins
from scipy.stats import beta, ncx2, norm

Line = dict[str, Any]
# an ideal test of one effect, at the level of false alarms that a search of the library has
_IDEAL_ALARMS = 0.02
_IDEAL_CANDIDATES = 30
_IN_REACH = 0.9
_FOUR_DIGITS = 2e-3


class Share:
    """A number of hits among trials, printed with its 95 % interval (Clopper-Pearson)."""

    def __init__(self, hits: Iterable[bool]) -> None:
        found = [bool(h) for h in hits]
        self.hits, self.n = sum(found), len(found)

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper end."""
        k, n = self.hits, self.n
        low = float(beta.ppf(0.025, k, n - k + 1)) if k else 0.0
        return low, float(beta.ppf(0.975, k + 1, n - k)) if k < n else 1.0

    def __str__(self) -> str:
        if not self.n:
            return "-"
        low, high = self.interval
        return (
            f"{100 * self.hits / self.n:.0f} % ({self.hits} of {self.n}; {100 * low:.0f}-{100 * high:.0f} %)"
        )


def right_first(line: Line) -> bool:
    """The answer is "missing effect", and the one that it names first is the hidden one or its twin."""
    return (
        line["verdict"] == "missing_effect"
        and bool(line["named"])
        and line["named"][0] in twins(line["hidden"][0])
    )


def right_named(line: Line) -> bool:
    """The hidden effect or its twin is in the class that the answer names."""
    return bool(twins(line["hidden"][0]) & set(line["named"]))


def detected(line: Line) -> bool:
    """The answer is not "adequate"."""
    return line["verdict"] != "adequate"


def power(line: Line, which: int = 0) -> float:
    """Return how often an ideal test would detect what is hidden, or the second of two."""
    threshold = float(norm.isf(_IDEAL_ALARMS / _IDEAL_CANDIDATES / 2)) ** 2
    return float(ncx2.sf(threshold, 1, max(float(line["sigma"][which][1]) ** 2, 1e-9)))


def bound(line: Line) -> float:
    """Return how often an ideal method would name all that is hidden, each with one rival."""
    return math.prod(power(line, i) * float(norm.cdf(s[2] / 2)) for i, s in enumerate(line["sigma"]))


def in_reach(line: Line) -> bool:
    """An ideal method would name it first in nine of ten recordings; of two effects, name both."""
    return bound(line) > _IN_REACH


def extra(line: Line) -> list[str]:
    """Return what a ladder added that is none of the hidden effects, nor a twin of one."""
    return [n for n in line["named"] if not any(n in twins(h) for h in line["hidden"])]


def all_found(line: Line) -> bool:
    """Every hidden effect, or its twin, was added."""
    return all(twins(h) & set(line["named"]) for h in line["hidden"])


def both(line: Line) -> bool:
    """Every hidden effect was added, and nothing else."""
    return all_found(line) and not extra(line)


def physics_first(line: Line) -> bool:
    """A physical effect is named first."""
    return bool(line["named"]) and line["kinds"][0] == "physical"


def sold(line: Line) -> bool:
    """A fault of measuring is called physics: a physical effect is named and the fault is not."""
    return physics_first(line) and line["hidden"][0] not in line["named"]


def single_wrong(line: Line) -> bool:
    """One name that is not true, with nothing beside it."""
    return line["verdict"] == "missing_effect" and len(line["named"]) == 1


def chi2_good(line: Line) -> bool:
    """After adding the best candidate, chi-square of every casing is within a tenth of its degrees of freedom."""
    return all(x is not None and 0.9 <= x <= 1.1 for x in line["added"]["chi2"])


def held_good(line: Line) -> bool:
    """After adding the best candidate, the held-out error of every casing is within 5 % of the noise."""
    return all(x is not None and abs(x - 1) <= 0.05 for x in line["added"]["held"])


def pulls(line: Line, *, shapes: bool = False) -> list[float]:
    """Return (estimate - truth) / error of the strength, or of the shape constants, in each case."""
    added = line.get("added")
    if not added:
        return []
    strength = {"k", "a1", "a2", "b1", "b2", "c", "d", "e", "f", "eps", "dt"}
    found = []
    for name, value, error, truth, pull in added["parameters"]:
        symbol = name.partition("@")[0].rsplit(".", 1)[1]
        if pull is None or (symbol in strength) == shapes:
            continue
        if symbol == "phi" and abs(pull) * error > math.pi:
            # older lines count a phase beyond the turn; what four digits cannot tell is left out
            if error < _FOUR_DIGITS:
                continue
            pull = math.remainder(value - truth, 2 * math.pi) / error
        found.append(float(pull))
    return found


def covered(lines: Iterable[Line], *, shapes: bool = False) -> Share:
    """Return how often the 95 % interval holds the truth."""
    return Share(abs(p) < 1.96 for line in lines for p in pulls(line, shapes=shapes))
