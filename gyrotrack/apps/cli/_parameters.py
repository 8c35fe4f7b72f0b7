"""Parameters of a fit as text: each effect in words, and beneath it the symbols, values and keys of its parameters."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fitting.inference._profile import Interval
    from fitting.inference._result import Fit

_WIDTH = 79


def parameter_lines(fit: Fit, intervals: Mapping[str, Interval] | None = None) -> list[str]:
    """Return lines with all parameters, then undetermined parameters, degenerate parameters, and profile intervals."""
    from fitting.inference._result import GENERATED, estimate_text, not_determined
    from fitting.study._serialisation import not_determined_together

    lines = _grouped(fit, {name: estimate_text(fit, name) for name in fit.estimates})
    if getattr(fit, "generated", False):
        lines += ["", *textwrap.wrap(GENERATED, _WIDTH)]
    if weak := not_determined(fit.estimates):
        text = f"not determined by these data: {'; '.join(in_words(fit, n) for n in weak)}"
        lines += ["", *textwrap.wrap(text, _WIDTH)]
    for direction in not_determined_together(fit):
        parts = "; ".join(f"{in_words(fit, n)} by {100 * w:+.0f} %" for n, w in direction.items())
        lines += textwrap.wrap(f"degenerate parameters: {parts}", _WIDTH)
    if intervals:
        lines += ["", "95 % intervals by profile likelihood:"]
        lines += _grouped(fit, {n: _interval(i, fit.estimates[n].unit) for n, i in intervals.items()})
    return lines


def in_words(fit: Fit, name: str) -> str:
    """Return a parameter in words; in a joint fit, with its case."""
    case = name.partition("@")[2]
    return fit.name(name).words + (f" ({case})" if case and len(fit.labels) > 1 else "")


def _grouped(fit: Fit, texts: Mapping[str, str]) -> list[str]:
    """Return lines with the text, symbol and key of each parameter, beneath the name of its effect."""
    lines: list[str] = []
    effect = ""
    for name, text in texts.items():
        key, _, case = name.partition("@")
        owner, _, symbol = key.rpartition(".")
        if owner != effect:
            heading = "initial speed" if owner == "initial" else fit.name(owner).words
            lines += textwrap.wrap(heading, _WIDTH, initial_indent="  ", subsequent_indent="    ")
            effect = owner
        where = f" ({case})" if case and len(fit.labels) > 1 else ""
        lines += _aligned(f"    {symbol}{where} = {text}", _key(fit, name))
    return lines


def _key(fit: Fit, name: str) -> str:
    """Return the key of a parameter in the form that commands accept."""
    key = fit.name(name).key or name.partition("@")[0]
    case = name.partition("@")[2]
    return f"{key}@{case}" if case and len(fit.labels) > 1 else key


def _aligned(text: str, key: str) -> list[str]:
    """Return a text with a key at the right end of the same line, or on a second line if there is no room."""
    room = _WIDTH - len(text) - len(key)
    return [f"{text}{' ' * room}{key}"] if room > 1 else [text, f"{key:>{_WIDTH}}"]


def _interval(i: Interval, unit: str) -> str:
    if i.lower_open and i.upper_open:
        return "no limit on either side"
    if i.lower_open:
        return f"below {i.upper:.4g} {unit}"
    if i.upper_open:
        return f"above {i.lower:.4g} {unit}"
    return f"{i.lower:.4g} to {i.upper:.4g} {unit}"


def key_beneath(words: str, key: str) -> list[str]:
    """Return a heading in words, and beneath it the key if the key differs from the words."""
    lines = textwrap.wrap(words, _WIDTH, subsequent_indent="  ") or [key]
    return lines if key in {"", words} else [*lines, f"  ({key})"]
