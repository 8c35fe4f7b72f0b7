"""The tables of single effects, faults, laws from outside the library, and pairs."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from hidden import BASE, FAULTS, LIBRARY, OUTSIDE, TAKEN_OUT
from judge import (
    Line,
    Share,
    all_found,
    both,
    bound,
    detected,
    extra,
    in_reach,
    physics_first,
    power,
    right_first,
    right_named,
    single_wrong,
    sold,
)
from tabular import mean, rounded, table

NOISES = ((0.0, "no torque noise"), (1e-7, "torque noise 1e-7 N m, centre off by 2 mrad"))


def each(lines: list[Line]) -> list[str]:
    """Return a table for each number of recordings and noise: hits first, hits named, runs, and the bound."""
    tables = []
    for cases in (2, 1):
        for noise, words in NOISES:
            some = [x for x in lines if x["cases"] == cases and x["noise"] == noise]
            if not some:
                continue
            strengths = sorted({x["strength"] for x in some})
            columns = ["hidden", *(f"{100 * s:g} %: first, in class, of; bound; sigma" for s in strengths)]
            rows = []
            for name in (*LIBRARY, *BASE):
                same = [x for x in some if x["hidden"] == [name]]
                rows.append(
                    [f"`{name}`", *(_cell([x for x in same if x["strength"] == s]) for s in strengths)]
                )
            total = ["all", *(_cell([x for x in some if x["strength"] == s], sigma=False) for s in strengths)]
            recordings = "two recordings" if cases == 2 else "one recording"
            tables += [f"### {recordings.capitalize()}, {words}", table(columns, [*rows, total])]
    return tables


def _cell(lines: list[Line], *, sigma: bool = True) -> str:
    if not lines:
        return "-"
    first, named = sum(map(right_first, lines)), sum(map(right_named, lines))
    size = f"; {rounded(np.median([x['sigma'][0][1] for x in lines]))}" if sigma else ""
    return f"{first}, {named}, {len(lines)}; {mean(map(bound, lines))}{size}"


def faults(parts: dict[str, list[Line]]) -> str:
    rows = []
    for name in FAULTS:
        some = [x for x in parts["fault"] if x["hidden"] == [name]]
        right = (lambda x: not detected(x)) if name in TAKEN_OUT else right_named
        wish = "taken out: adequate" if name in TAKEN_OUT else "named"
        rows.append(
            [
                f"`{name}`",
                wish,
                Share(map(right, some)),
                Share(map(physics_first, some)),
                Share(map(sold, some)),
            ]
        )
    for cases in (2, 1):
        some = [x for x in parts["nothing"] if x["cases"] == cases]
        what = f"nothing, {cases} recording{'s' if cases > 1 else ''}"
        rows.append(
            [what, "adequate", Share(not detected(x) for x in some), Share(map(physics_first, some)), "-"]
        )
    return table(["hidden", "right is", "right", "physics named first", "and the fault not named"], rows)


def outside(lines: list[Line], names: Iterable[str] = OUTSIDE) -> str:
    rows = []
    for name in names:
        some = [x for x in lines if x["hidden"] == [name]]
        rows.append([
            name,
            Share(map(detected, some)),
            mean(map(power, some)),
            sum(x["verdict"] == "unexplained" for x in some),
            sum(x["verdict"] == "missing_effect" and len(x["named"]) > 1 for x in some),
            Share(map(single_wrong, some)),
            mean(float(x["sigma"][0][2] > 4) for x in some),
        ])  # fmt: skip
    columns = ["hidden", "detected", "an ideal test", "unexplained", "a class", "one wrong name",
               "more than 4 sigma from any one effect"]  # fmt: skip
    return table(columns, rows)


def pairs(lines: list[Line]) -> str:
    rows = []
    for noise, words in NOISES:
        some = [x for x in lines if x["noise"] == noise]
        near = [x for x in some if in_reach(x)]
        rows.append([
            words,
            Share(map(both, some)),
            Share(map(all_found, some)),
            Share(bool(extra(x)) for x in some),
            mean(map(bound, some)),
            Share(map(both, near)),
        ])  # fmt: skip
    columns = ["", "both, none extra", "both", "something extra", "the bound", "both, none extra, in reach"]
    return table(columns, rows)
