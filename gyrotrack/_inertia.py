"""A moment of inertia, parsed from a text with optional unit and standard uncertainty."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from gyrotrack._errors import UsageError

_NUMBER = r"[+]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_FORM = re.compile(
    rf"\(?\s*(?P<value>{_NUMBER})\s*(?:(?:\+-|\+/-|±)\s*(?P<u>{_NUMBER})\s*)?\)?\s*(?P<unit>[a-zµ].*)?",
    re.IGNORECASE,
)
_MASS = {"kg": 1.0, "g": 1e-3, "mg": 1e-6}
_LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_UNIT = re.compile(r"(kg|g|mg)\s*[*·. ]?\s*(m|cm|mm)\s*(?:\^|\*\*)?\s*(?:2|²)")
_EXAMPLE = 'Write it as "5.54e-5 +- 0.06e-5" (kg m2) or "554 g cm2"; the uncertainty is optional.'

# limits of plausible values: 1 mg at a radius of 1 mm, 1 t at 10 m
SMALLEST, LARGEST = 1e-12, 1e5


@dataclass(frozen=True)
class Inertia:
    """A moment of inertia."""

    value: float  # in kg m2
    u: float = math.nan  # standard uncertainty [kg m2]; NaN if it is not given

    @classmethod
    def of(cls, text: str | float | Inertia, body: str = "body") -> Inertia:
        """Read a moment of inertia: a number in kg m2, or a text with optional uncertainty and unit.

        Forms: "5.54e-5 +- 0.06e-5", "554 g cm2", "(554 +- 6) g cm2"; masses in kg, g, mg; lengths in m, cm, mm. A
        UsageError says that it cannot be parsed, or is not plausible (`SMALLEST`, `LARGEST`).

        Examples
        --------
        >>> Inertia.of("(554 +- 6) g cm2")
        Inertia(value=5.54e-05, u=6e-07)
        """
        if isinstance(text, Inertia):
            return text
        found = _FORM.fullmatch(str(text).strip())
        unit = _UNIT.fullmatch((found["unit"] or "kg m2").strip()) if found else None
        if found is None or unit is None:
            raise UsageError(f"'{str(text)[:40]}' is not a moment of inertia of the {body}.", _EXAMPLE)
        factor = _MASS[unit[1]] * _LENGTH[unit[2]] ** 2
        # rounded, so that 554 g cm2 is exactly 5.54e-5 kg m2
        value = float(f"{float(found['value']) * factor:.15g}")
        u = float(f"{float(found['u']) * factor:.15g}") if found["u"] else math.nan
        if not SMALLEST <= value <= LARGEST:
            raise UsageError(
                f"A moment of inertia of {value:g} kg m2 is not possible for the {body}.",
                "Check number and unit; without a unit it is in kg m2.",
            )
        if u >= value:
            raise UsageError(
                f"The uncertainty of the moment of inertia of the {body} is not smaller than its value.",
                _EXAMPLE,
            )
        return cls(value, u)

    @classmethod
    def required(cls, text: str | float | Inertia | None, body: str) -> Inertia:
        """Read a moment of inertia that has no default; see `of`."""
        if text is None:
            raise UsageError(
                f"The moment of inertia of the {body} is not given; torques follow from it.",
                f'Give --inertia-{body} "VALUE +- UNCERTAINTY" in kg m2, such as "5.54e-5 +- 0.06e-5".',
            )
        return cls.of(text, body)
