"""Numbers, uncertainties and units as text, for example (7.16 ± 0.04) × 10⁻⁷ N m s."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any

_LONG = 3
"""A number with a power of ten is printed with all its digits if it has more digits than this number [1]. Chosen:
shorter numbers need only one digit of the mantissa; a larger value rounds precise numbers, a smaller one prints long
numbers."""
_RAISED = str.maketrans("0123456789+-g.", "⁰¹²³⁴⁵⁶⁷⁸⁹⁺⁻ᵍ·")
_UNIT = re.compile(r"(?<![\w.])(kg m|N m s|N m|rad s|s|K|m|[AVN](?=-\d))\^?(-?\d(?:\.\d+)?|g)(?!\w|\.\d)")
_POWER = re.compile(r"x 10\^(-?\d+)")
# a number in a sentence, followed by its uncertainty, its unit or a bracket; not a number in a formula
_SCIENTIFIC = re.compile(r"(?<![\w.*])(\d+(?:\.\d+)?)e([+-]\d+)(?=\)| \+-| N m| m?rad| urad| s\b)")
# spaces within a number: before its uncertainty and its power of ten, and inside its unit
_JOINED = re.compile(r"(?<=\d) [±×] (?=\d)|(?<=\)) × (?=10)|\bN m(?: s[⁻⁰-⁹¹²³]*)?(?![\w])")
_AFTER_NUMBER = re.compile(r"(?<=[\d)⁰-⁹¹²³]) (?=(?:m?rad|N|kg|J|K|s|ms|px|%|σ|sigma|times)(?![\w.]))")
POWERS = {"": "", "m": "$10^{-3}$", "µ": "$10^{-6}$", "n": "$10^{-9}$", "p": "$10^{-12}$"}
TORQUE = "N m"
PER_INERTIA = "rad/s2"
"""Unit of a torque per unit of inertia, for bodies of unknown moment of inertia."""
PER_TORQUE = "kg-1 m-2"
"""Unit of the factor of a torque in N m that acts on a body of unknown moment of inertia."""
_STRENGTH = re.compile(r"N m(?: s(?:\^?([^ ]+))?)?((?: (?:A|V|K)(?:-?\d*\.?\d+)?)*)")
_PREFIXES = ((1.0, ""), (1e3, "m"), (1e6, "µ"), (1e9, "n"), (1e12, "p"))
_SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
_GREEK = {
    "omega": "ω",
    "phi": "φ",
    "eps": "ε",
    "tau": "τ",
    "psi": "ψ",
    "kappa": "κ",
    "chi": "χ",
    "delta": "D",
}


def symbol_parts(symbol: str) -> tuple[str, str]:
    """Return the letter of a symbol and its index: b2 is b and 2, omega_c is ω and c."""
    head, _, tail = symbol.partition("_")
    letters = head.rstrip("0123456789")
    found, index = (letters, head[len(letters) :] + tail) if letters else (symbol, "")
    return _GREEK.get(found, found), index


def symbol_text(symbol: str) -> str:
    """Return a symbol in one line: b₂, ω_c, ε."""
    head, index = symbol_parts(symbol)
    return head + (f"_{index}" if index and not index.isdigit() else index.translate(_SUBSCRIPTS))


def superscript(number: int) -> str:
    """Return an integer as an exponent: -7 becomes ⁻⁷."""
    return str(number).translate(_RAISED)


def unit_text(unit: str) -> str:
    """Return a unit with raised exponents: ``N m s2`` becomes N m s². The unit of a pure number is empty."""
    if unit == "1":
        return ""
    return _UNIT.sub(lambda m: m[1] + m[2].translate(_RAISED), unit)


# replacements of the ASCII that a terminal prints
_TYPESET = (
    (re.compile(r"(?<=\d) u(?=(?:N m|rad)\b)"), " µ"),
    (re.compile(r"(?<=\d) sigma\b"), " σ"),
    (re.compile(r"(?<![\w.,*^(=-])-(?=\d+(?:\.\d+)?(?: \+-| [µmnp]?(?:N m|rad)\b| ×| x 10))"), "−"),
    (re.compile(r"\bdBIC\b"), "ΔBIC"),
    (re.compile(r"\bchi2\b"), "χ²"),
)


def typeset(text: str) -> str:
    """Return a sentence or a rounded number with ±, ×, σ, µ and raised exponents."""
    for pattern, sign in _TYPESET:
        text = pattern.sub(sign, text)
    text = _SCIENTIFIC.sub(lambda m: f"{m[1]} × 10{superscript(int(m[2]))}", text)
    text = _POWER.sub(lambda m: f"× 10{superscript(int(m[1]))}", text)
    return unit_text(text.replace(" +- ", " ± "))


def nonbreaking(text: str) -> str:
    """Return text with non-breaking spaces between numbers, their uncertainties, powers of ten and units."""
    text = _JOINED.sub(lambda m: m[0].replace(" ", "\u00a0"), text)
    return _AFTER_NUMBER.sub("\u00a0", text)


def with_uncertainty(value: float, error: float, unit: str) -> str:
    """Return a value with its standard uncertainty, both rounded to the same digit."""
    text = typeset(rounded(value, error, "" if unit == "1" else unit))
    return text.replace("-", "−", 1) if text.startswith(("-", "(-")) else text


def short(value: float, digits: int = 3) -> str:
    """Return a number for a table with few digits: 0.0462, 6.6 × 10⁵, or a dash for a missing number."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "∞"
    if value != 0 and not 1e-3 <= abs(value) < 1e5:
        places = digits - 1 if digits > _LONG else max(0, digits - 2)
        mantissa, _, exponent = f"{value:.{places}e}".partition("e")
        text = f"{mantissa} × 10{superscript(int(exponent))}"
    else:
        text = f"{value:#.{digits}g}".rstrip(".") if 0 < abs(value) < 10.0**digits else f"{value:.0f}"
        text = f"{value:.0f}" if "e" in text else text  # rounded up to a power of ten
    return text.replace("-", "−", 1) if text.startswith("-") else text


def plain(value: float) -> str:
    """Return a number for a sentence with three digits; numbers from 0.0001 to 99 999 have no exponent."""
    text = f"{value:.3g}"
    if "e" not in text:
        return text
    if 1 <= abs(value) < 99950:
        return f"{float(text):.0f}"
    mantissa, _, exponent = text.partition("e")
    return f"{mantissa} x 10^{int(exponent)}"


def interval(first: float, last: float) -> tuple[str, str]:
    """Return both ends of an interval, with enough digits to show its length."""
    length = last - first
    digits = 1 if length <= 0 else min(max(1 - math.floor(math.log10(length)), 1), 6)
    return f"{first:.{digits}f}", f"{last:.{digits}f}"


def percentage(share: float) -> str:
    """Return a share in per cent: two digits below 10 %, whole per cent above, 99.6 % only near 100 %."""
    percent = 100 * share
    if percent < 10:
        return f"{plain(float(f'{percent:.2g}'))} %"
    return f"{percent:.0f} %" if percent < 99 or share >= 1 else f"{min(percent, 100.0):.3g} %"


def probability(p: float) -> str:
    """Return a p-value: 0.34, 2 × 10⁻⁷, or < 10⁻³⁰."""
    if math.isfinite(p) and p < 1e-30:
        return f"< 10{superscript(-30)}"
    return short(p, 2)


def stated_probability(p: float) -> str:
    """Return a p-value with its sign of relation: p = 0.34, p = 2 × 10⁻⁷, or p < 10⁻³⁰."""
    text = probability(p)
    return f"p {text}" if text.startswith("<") else f"p = {text}"


def scaled(largest: float, prefixes: Iterable[tuple[float, str]] = _PREFIXES) -> tuple[float, str]:
    """Return the factor and the unit prefix that scale a magnitude to 0.5 to 500; without such a prefix, 1 and ""."""
    return next((p for p in prefixes if largest * p[0] >= 0.5), _PREFIXES[0])


_RAD_PER_S = frozenset({"rad/s", "rad s-1"})
_RPM = 30.0 / math.pi
"""Revolutions per minute in one radian per second [1]. Derived: 60 / (2 pi)."""
_SPEED: ContextVar[str] = ContextVar("speed", default="rad/s")


@contextmanager
def speeds_in(unit: str) -> Iterator[None]:
    """Print angular velocities in "rpm" or "rad/s" within the block; numbers in documents stay in SI units."""
    token = _SPEED.set(unit)
    try:
        yield
    finally:
        _SPEED.reset(token)


def speed_unit() -> str:
    """Return the unit in which angular velocities are printed: "rad/s", or "rpm" (see `speeds_in`)."""
    return _SPEED.get()


def speed(value: float) -> float:
    """Return an angular velocity [rad/s] in the unit in which it is printed."""
    return value * _RPM if _SPEED.get() == "rpm" else value


def rounded(value: float, error: float, unit: str = "") -> str:
    """Return ``(7.16 +- 0.04) x 10^-7 N m s``; an angular velocity in the unit of `speeds_in`.

    The uncertainty has two digits if these digits are between 10 and 29, and otherwise one digit. The value is rounded
    to the same digit.
    """
    if unit in _RAD_PER_S and _SPEED.get() == "rpm":
        value, error, unit = speed(value), speed(error), "rpm"
    if not math.isfinite(value):
        return "not a number"
    tail = f" {unit}" if unit and unit != "1" else ""
    if not math.isfinite(error) or error <= 0:
        return f"{value:.4g}{tail}"
    leading = math.floor(math.log10(error))
    digits = -leading + (1 if error / 10.0**leading < 2.95 else 0)
    exponent = math.floor(math.log10(max(abs(value), error)))
    if -3 < exponent < 5:
        places = max(0, digits)
        return f"{round(value, digits):.{places}f} +- {round(error, digits):.{places}f}{tail}"
    places = max(0, digits + exponent)
    scale = 10.0**exponent
    return f"({value / scale:.{places}f} +- {error / scale:.{places}f}) x 10^{exponent}{tail}"


def per_inertia(unit: str) -> str:
    """Return the unit of a parameter of a torque divided by kg m2, with rad = 1: ``N m s`` becomes s-1."""
    found = _STRENGTH.fullmatch(unit)
    if found is None:
        return unit
    power, tail = (found[1] or "1") if " s" in unit else "0", found[2]
    try:
        exponent = float(power) - 2
    except ValueError:
        return f"s^({power}-2){tail}"
    if power in {"0", "-1"}:
        return f"rad/s{-exponent:g}{tail}"
    return (f"s{exponent:g}" if exponent not in {0, 1} else "s" if exponent else "1") + tail


@dataclass(frozen=True)
class Units:
    """The units of the torques of a case and of quantities that are computed from torques.

    Parameters
    ----------
    torque, energy, inertia : str
        Units of a torque, an energy and a moment of inertia; `inertia` is empty if the moment of inertia is unknown.
    gain : str
        Unit of the ratio of a torque to a recorded torque.
    note : str
        Explanation for the reader; empty for SI units.
    of : callable
        Function that converts the SI unit of a constant of a torque law to its unit in this system of units.
    steps : tuple
        Smallest torque, factor and unit of each prefix in sentences, largest first.
    prefixes : tuple
        Factors and prefixes of scaled tables.
    """

    torque: str
    energy: str
    inertia: str
    gain: str
    note: str
    of: Callable[[str], str]
    steps: tuple[tuple[float, float, str], ...]
    prefixes: tuple[tuple[float, str], ...]

    @classmethod
    def common(cls, several: Iterable[Units]) -> Units:
        """Return the units of a joint fit of cases: SI units if any case has SI units."""
        # compared by value, because a record may come from another process
        return max(several, key=lambda u: u == SI)

    @classmethod
    def by_torque(cls, unit: str) -> Units:
        """Return the units whose unit of torque is `unit`; SI units if no units have this unit."""
        return {PER_INERTIA: WITHOUT_INERTIA}.get(unit, SI)


SI = Units(
    TORQUE, "J", "kg m2", "1", "", str,
    steps=((0.1, 1.0, "N m"), (1e-3, 1e3, "mN m"), (1e-8, 1e6, "uN m"), (0.0, 1e9, "nN m")), prefixes=_PREFIXES,
)  # fmt: skip
# for bodies of unknown moment of inertia: their torques are angular accelerations, which have no prefixes
WITHOUT_INERTIA = Units(
    PER_INERTIA, "rad²/s²", "", PER_TORQUE, "torques are per unit of inertia", per_inertia,
    steps=((0.1, 1.0, "rad/s2"), (1e-4, 1e3, "mrad/s2"), (0.0, 1e6, "urad/s2")), prefixes=(),
)  # fmt: skip


_LINES = 20
"""Largest number of lines of the repr of a result [lines]. Chosen: one screen of a console; a smaller value hides
parameters, a larger one scrolls."""
_COLUMNS = 120
"""Width of the repr of a result [characters]. Chosen: a smaller value cuts sentences, a larger one wraps in narrow
consoles."""


def on_screen(lines: Iterable[str]) -> str:
    """Return lines as the repr of a result: at most 20, of at most 120 columns."""
    cut = [x if len(x) <= _COLUMNS else f"{x[: _COLUMNS - 3]}..." for x in lines]
    if len(cut) > _LINES:
        cut = [*cut[: _LINES - 1], f"... {len(cut) - _LINES + 1} more lines"]
    return "\n".join(cut)


def span_of(name: str, values: Any, unit: str) -> str:
    """Return a description of an array: its number of values and its range."""
    if not len(values):
        return f"{name}: no values"
    return f"{name}: {len(values)} values from {min(values):.4g} to {max(values):.4g} {unit}".rstrip()


def to_json(value: Any) -> Any:
    """Return a value that JSON can represent: nan becomes None, infinities become "inf" and "-inf"."""
    if isinstance(value, dict):
        return {str(k): to_json(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [to_json(v) for v in value]
    if hasattr(value, "tolist"):
        return to_json(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else ("inf" if value > 0 else "-inf")
    return value


def format_torque(value: float, sigma: float = float("nan"), unit: str = TORQUE) -> str:
    """Return a torque with the unit prefix of its size, rounded to its standard uncertainty if it has one.

    The units are nN m below 0.01 uN m, uN m below 1 mN m, mN m below 0.1 N m, and N m; for `unit` "rad/s2" they are
    urad/s2, mrad/s2 and rad/s2.
    """
    size = max(abs(value), abs(sigma) if sigma == sigma else 0.0)
    steps = Units.by_torque(unit).steps
    _, scale, unit = next((step for step in steps if size >= step[0]), steps[-1])
    if not math.isfinite(sigma) or sigma <= 0:
        return f"{plain(value * scale)} {unit}"
    return rounded(value * scale, sigma * scale, unit)
