"""Check of the arguments of public functions; an error message states the argument, its value, and the required kind.

The check is added where functions are exported (`fitting.__getattr__`), so that internal calls are not slowed down;
methods of public classes call `require`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from inspect import Parameter, signature
from numbers import Integral, Real
from pathlib import Path
from typing import Any, NamedTuple

from fitting._errors import EstimationError

_SHOWN = 30
"""Length of the longest value of an argument that a message shows [characters]. Chosen: a smaller value hides short
arguments, a larger one fills the message with arrays."""


class Kind(NamedTuple):
    """Requirement on an argument: a description, a test, and a hint for the error message."""

    words: str
    fits: Callable[[Any], bool]
    hint: str = ""

    @property
    def optional(self) -> Kind:
        """The kind of values that also allows None."""
        return Kind(f"{self.words} or None", lambda x: x is None or self.fits(x), self.hint)

    @property
    def several(self) -> Kind:
        """A sequence of values of this kind."""
        return Kind(
            f"a list, each item {self.words}", lambda x: _is_list(x) and all(map(self.fits, x)), self.hint
        )


def _is_list(x: Any) -> bool:
    return isinstance(x, Iterable) and not isinstance(x, str | bytes | Mapping)


def _is_number(x: Any) -> bool:
    return isinstance(x, Real) and not isinstance(x, bool)


def _is_finite(x: Any) -> bool:
    return _is_number(x) and math.isfinite(x)


def _is_integer(x: Any) -> bool:
    return isinstance(x, Integral) and not isinstance(x, bool)


def instance(name: str, hint: str = "") -> Kind:
    """Return the kind for instances of the class with this name in this package."""

    def fits(x: Any) -> bool:
        return any(c.__name__ == name and c.__module__.startswith("fitting.") for c in type(x).__mro__)

    return Kind(f"a {name}" if name[0] not in "AEIO" else f"an {name}", fits, hint)


NUMBER = Kind("a number", _is_number, "in SI units")
FINITE = Kind("a finite number", _is_finite, "in SI units")
POSITIVE = Kind("a positive number", lambda x: _is_finite(x) and x > 0, "in SI units")
NOT_NEGATIVE = Kind("a number that is not negative", lambda x: _is_finite(x) and x >= 0, "in SI units")
INTEGER = Kind("an integer", _is_integer)
COUNT = Kind("a positive integer", lambda x: _is_integer(x) and x > 0)
SEED = Kind("an integer that is not negative", lambda x: _is_integer(x) and x >= 0)
BOOLEAN = Kind("True or False", lambda x: isinstance(x, bool))
TEXT = Kind("a string", lambda x: isinstance(x, str))
PATH = Kind("a path", lambda x: isinstance(x, str | Path) and str(x) != "", "give a str or a Path")
CALLABLE = Kind("a function", callable)
MAPPING = Kind("a mapping", lambda x: isinstance(x, Mapping))
NUMBERS = Kind(
    "a mapping of names to numbers",
    lambda x: isinstance(x, Mapping) and all(isinstance(k, str) and _is_number(v) for k, v in x.items()),
    'for example {"bearing.power.g": 0.7}',
)
# a saved fit that was read from a file has only some of these attributes, because it contains no data
FIT = Kind(
    "a Fit",
    lambda x: all(hasattr(x, n) for n in ("model", "estimates", "converged")),
    "make one with fitting.fit",
)
EFFECTS = instance("Effect", "make one with fitting.effect").several
MODEL = instance("Model", 'make one with fitting.Model.of("reduced")')
DIAGNOSIS = instance("Diagnosis", "make one with fitting.diagnose")
CRITERIA = instance("Criteria", "make one with fitting.Criteria")
RECORDS = Kind(
    "a list of cases",
    lambda x: _is_list(x) and all(any(instance(n).fits(i) for n in ("Record", "CaseData")) for i in x),
    "read them with fitting.load",
)
FITTED = Kind(
    "a mapping of names of runs to fits",
    lambda x: (
        isinstance(x, Mapping) and all(hasattr(f, "estimates") and hasattr(f, "model") for f in x.values())
    ),
    'for example {"first": fit_1, "second": fit_2}',
)


def require(name: str, value: Any, kind: Kind) -> None:
    """Raise an EstimationError unless an argument is of its kind."""
    try:
        right = kind.fits(value)
    except (TypeError, ValueError, AttributeError):
        right = False
    if not right:
        shown = repr(value)
        what = shown if len(shown) <= _SHOWN and "\n" not in shown else f"a {type(value).__name__}"
        raise EstimationError(f"{name} is {what}, not {kind.words}", kind.hint)


def checked(function: Callable[..., Any], name: str, kinds: Mapping[str, Kind]) -> Callable[..., Any]:
    """Return a public function that checks its arguments."""
    parameters = signature(function).parameters

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        places: Sequence[str] = [
            n for n, p in parameters.items() if p.kind is Parameter.POSITIONAL_OR_KEYWORD
        ]
        for key, value in (*zip(places, args, strict=False), *kwargs.items()):
            default = parameters[key].default if key in parameters else None
            if key in kinds and value is not default:
                require(key, value, kinds[key])
        return function(*args, **kwargs)

    # the public name is set, because pickle finds the function by this name
    call.__module__, call.__qualname__ = "fitting", name
    return call


_COMMON = {"extra": EFFECTS, "criteria": CRITERIA, "progress": CALLABLE, "size": POSITIVE, "max_steps": COUNT}
# kinds of the arguments of public functions
PUBLIC: dict[str, dict[str, Kind]] = {
    "budget": {"fit": FIT, "clock_rate_u": NOT_NEGATIVE, "speed_scale_u": NOT_NEGATIVE},
    "certify": {"found": DIAGNOSIS, "n": COUNT, "seed": SEED},
    "compare": {"fits": FITTED, "times": NUMBERS, "time_unit": TEXT},
    "diagnose": {"fit": FIT},
    "effect_name": {"key": TEXT, "body": TEXT, "effects": EFFECTS},
    "first_order": {"fit": FIT},
    "improve": {"base": FIT},
    "laws": {"base": FIT, "diagnosis": DIAGNOSIS, "beyond_library": BOOLEAN},
    "load_fit": {"path": PATH},
    "make_record": {
        **dict.fromkeys(("I_rotor", "I_casing"), POSITIVE),
        **dict.fromkeys(("I_rotor_u", "I_casing_u"), NUMBER),
        **dict.fromkeys(("label", "surface", "quantity", "source", "name"), TEXT),
        **dict.fromkeys(("tracked", "single", "per_inertia"), BOOLEAN),
        **dict.fromkeys(("start_sigma", "correlated"), NUMBER.several),
    },
    "plan": {"recordings": Kind("a Fit or a path", lambda x: FIT.fits(x) or PATH.fits(x), FIT.hint)}
    | {"bounds": instance("Bounds")},
    "predict_recordings": {"model": MODEL},
    "profile_interval": {"fit": FIT, "name": TEXT, "level": NUMBER},
    "read_effects": {"path": PATH},
    "scan": {"cases": RECORDS},
    "scan_lines": {"scan": instance("Scan", "make one with fitting.scan")},
    "simulate": {
        "model": MODEL,
        "numbers": NUMBERS,
        "experiment": instance("Experiment"),
        "inputs": instance("Input").several,
        "label": TEXT,
        "seed": SEED,
        **dict.fromkeys(("inertia_rotor", "inertia_casing"), POSITIVE),
    },
}


def of_function(name: str) -> dict[str, Kind]:
    """Return the kinds of the arguments of a public function."""
    return _COMMON | PUBLIC[name]
