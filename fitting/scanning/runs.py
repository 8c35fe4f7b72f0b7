"""The runs of the paper's tables, in its order, and the columns that show them.

Tables 1 and 2 ask which drags of rotor and casing are needed (the bearing has its linear law): all four, then
each left out once. Tables 3 and 4 ask which laws of the bearing are needed (a1 is left out): all fifteen
choices of c, d, e and f.
"""

from __future__ import annotations

from dataclasses import dataclass

EFFECT_OF = {
    "a1": "rotor.air.linear",
    "a2": "rotor.air.quadratic",
    "b1": "touchpoint.constant",
    "b2": "casing.air.linear",
    "c": "bearing.constant",
    "d": "bearing.linear",
    "e": "bearing.quadratic",
    "f": "bearing.power",
}


@dataclass(frozen=True)
class Column:
    """One parameter in a table: the paper's symbol, its key, SI unit, and the power of ten in the header."""

    symbol: str
    key: str
    unit: str
    exponent: int


COLUMNS = {
    c.symbol: c
    for c in (
        Column("a1", "rotor.air.linear.a1", "N m s", -11),
        Column("a2", "rotor.air.quadratic.a2", "N m s2", -11),
        Column("b1", "touchpoint.constant.b1", "N m", -6),
        Column("b2", "casing.air.linear.b2", "N m s", -7),
        Column("c", "bearing.constant.c", "N m", -7),
        Column("d", "bearing.linear.d", "N m s", -7),
        Column("e", "bearing.quadratic.e", "N m s2", -11),
        Column("f", "bearing.power.f", "N m s^g", -7),
        Column("g", "bearing.power.g", "1", 0),
    )
}


@dataclass(frozen=True)
class Run:
    """One combination of terms; `g` goes with `f`."""

    terms: tuple[str, ...]

    @property
    def effects(self) -> tuple[str, ...]:
        """The effects that are on."""
        return tuple(EFFECT_OF[t] for t in self.terms)


AIR_COLUMNS = ("a1", "a2", "b1", "b2", "d")
AIR = tuple(Run(tuple(t for t in AIR_COLUMNS if t != left_out)) for left_out in ("", "a1", "a2", "b1", "b2"))

BEARING_COLUMNS = ("a2", "b1", "b2", "c", "d", "e", "f", "g")
BEARING = tuple(
    Run(("a2", "b1", "b2", *on))
    for on in ["cdef", "def", "cef", "cdf", "cde", "ef", "df", "de", "cf", "ce", "cd", "f", "e", "d", "c"]
)  # fmt: skip

_SHADES = ((0.99, "white"), (0.90, "light gray"), (0.0, "gray"))


def shade(r2: float) -> str:
    """Return the paper's shade of an R2: "white" (from 0.99), "light gray" (0.90), "gray" (0) or "dark gray"."""
    return next((name for least, name in _SHADES if r2 >= least), "dark gray")
