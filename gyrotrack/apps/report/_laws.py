"""The fitted laws of a single body in words: the effect of each strength on the motion."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fitting.effects._words import of_body

if TYPE_CHECKING:
    from fitting.inference._result import Fit


@dataclass(frozen=True)
class LawOfBody:
    """A strength or shape constant of a fitted law."""

    parameter: str  #: Key of the parameter.
    words: str  #: The parameter in words.
    value: float  #: Value [`unit`].
    stderr: float  #: Standard error [`unit`].
    unit: str  #: Unit of value and standard error.
    meaning: str  #: Meaning, with the effect on the motion.


_SIGNIFICANT = 3.0  # smallest strength whose effect on the motion is stated [standard uncertainties]
# effect on the motion of a strength divided by the moment of inertia, `a`
_IN_MOTION: dict[str, Callable[[float], str]] = {
    "touchpoint.constant.b1": lambda a: f"it slows the body by {a:.4g} rad/s2 at any speed",
    "casing.air.linear.b2": lambda a: f"alone, the speed falls to 1/e in {1 / a:.4g} s",
    "casing.air.quadratic.k": lambda a: (
        f"alone, the speed halves in {math.log(2) / a / (2 * math.pi):.4g} turns"
    ),
    "casing.spring.linear.k": lambda a: f"a period of {2 * math.pi / math.sqrt(a):.4g} s",
    "casing.gravity.k": lambda a: f"a period of {2 * math.pi / math.sqrt(a):.4g} s at small amplitude",
}


def laws_of_body(fit: Fit) -> tuple[LawOfBody, ...]:
    """Return the law parameters of a single body without joints; without other bodies, each law has a clear effect."""
    record = fit.problem.data[0].record
    if record.joints:
        return ()
    found = []
    parameters = fit.model.parameters
    for name, e in fit.estimates.items():
        key = name.partition("@")[0]
        if key not in parameters or not key.rpartition(".")[0] or key.startswith("initial."):
            continue
        words = of_body(parameters[key].meaning, record.body)
        in_motion = _IN_MOTION.get(key)
        if in_motion is not None and e.value > _SIGNIFICANT * e.stderr:
            words = f"{words}; {in_motion(e.value / record.I_casing)}"
        found.append(LawOfBody(key, str(fit.name(key)), e.value, e.stderr, e.unit, words))
    return tuple(found)
