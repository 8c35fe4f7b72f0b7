"""The tables that the goals are held against: on the paper's gyroscope, and on others."""

from __future__ import annotations

from cells import NOISES
from hidden import FAULTS, OUTSIDE, TAKEN_OUT
from judge import (
    Line,
    Share,
    both,
    bound,
    chi2_good,
    covered,
    detected,
    held_good,
    in_reach,
    right_first,
    right_named,
    single_wrong,
    sold,
)
from tabular import mean, table

# with the gyroscopes of the seeds before this one faults of the search were found
FIRST_FRESH = 3


def figures(parts: dict[str, list[Line]]) -> str:
    rows = []
    seen = [x for x in parts["library"] if x["hidden"][0] not in ("external.constant",)]
    chosen = [x for x in seen if x["cases"] == 2 and x["strength"] == 0.01]
    groups = [(words, [x for x in chosen if x["noise"] == noise]) for noise, words in NOISES]
    brief = [x for x in parts["brief"] if x["hidden"][0] not in ("external.constant",)]
    groups.append((f"{NOISES[1][1]}, correlated over 0.1 s in place of 1 s", brief))
    for words, some in groups:
        goal = "95 %" if words == NOISES[0][1] else "90 %"
        near = [x for x in some if in_reach(x)]
        rows += [
            [f"right first, two recordings, 1 %, {words}", goal, Share(map(right_first, some))],
            [f"the same, the {len(near)} in reach", "", Share(map(right_first, near))],
            ["the bound of the same, all", "", mean(map(bound, some))],
        ]
    found = [x for x in seen if detected(x)]
    for noise, words in NOISES:
        some = [x for x in found if x["noise"] == noise]
        rows.append([f"in the class, whatever is detected, {words}", "97 %", Share(map(right_named, some))])
    added = [
        x for x in found if x["verdict"] == "missing_effect" and x.get("added") and x["added"].get("chi2")
    ]
    rows += [
        ["after adding it: reduced chi2 0.9-1.1", "95 %", Share(map(chi2_good, added))],
        ["after adding it: held-out error within 5 % of the noise", "95 %", Share(map(held_good, added))],
    ]
    empty = parts["nothing"]
    for noise, words in NOISES:
        some = [x for x in empty if x["noise"] == noise]
        rows.append([f"false alarm, nothing hidden, {words}", "at most 5 %", Share(map(detected, some))])
    rows.append(["a fault of measuring sold as physics", "at most 2 %", Share(map(sold, parts["fault"]))])
    outside = [x for x in parts["outside"] if detected(x)]
    rows += [
        [
            "from outside the library, detected: unexplained or a class",
            "90 %",
            Share(not single_wrong(x) for x in outside),
        ],
        [
            "the same of laws that were written later",
            "90 %",
            Share(not single_wrong(x) for x in parts["foreign"] if detected(x)),
        ],
        [
            "two effects at once: both found, none extra",
            "80 %",
            Share(map(both, parts["pair"])),
        ],
        [
            "the same, in reach",
            "",
            Share(both(x) for x in parts["pair"] if in_reach(x)),
        ],
    ]
    strengths = [x for x in parts["library"] if x["verdict"] == "missing_effect" and right_first(x)]
    rows.append(
        ["95 % intervals of the added effect's strength cover the truth", "92-98 %", covered(strengths)]
    )
    rows.append(["the same of its shape constants", "", covered(strengths, shapes=True)])
    return table(["what", "goal", "measured"], rows)


def strong(lines: list[Line]) -> str:
    """Return the table of strong effects on gyroscopes that were drawn by lot."""
    rows = []
    for words, some in (
        ("no torque noise", [x for x in lines if not x["noise"]]),
        ("torque noise", [x for x in lines if x["noise"]]),
    ):
        near = [x for x in some if in_reach(x)]
        found = [x for x in some if x["verdict"] == "missing_effect" and right_first(x)]
        rows.append(
            [
                words,
                Share(map(right_first, some)),
                Share(map(right_first, near)),
                Share(right_named(x) for x in some if detected(x)),
                Share(map(chi2_good, found)),
                covered(found),
            ]
        )
    columns = ["", "right first", "the same, in reach", "in the class, if detected", "reduced chi2 0.9-1.1",
               "95 % intervals cover"]  # fmt: skip
    return table(columns, rows)


def elsewhere(lines: list[Line]) -> str:
    """Return the table of the gyroscopes that were drawn by lot: all seeds, and those run after the mending."""
    fresh = [x for x in lines if x["seed"] >= FIRST_FRESH]
    both_ways = zip(_by_lot(lines), _by_lot(fresh), strict=True)
    rows = [[what, measured, of_fresh] for (what, measured), (_, of_fresh) in both_ways]
    return table(["what", "all seeds", f"seeds from {FIRST_FRESH} on"], rows)


def _by_lot(lines: list[Line]) -> list[tuple[str, object]]:
    alone = [x for x in lines if len(x["hidden"]) == 1 and x["hidden"][0] != "external.constant"]
    library = [x for x in alone if x["hidden"][0] not in (*OUTSIDE, *FAULTS)]
    outside = [x for x in alone if x["hidden"][0] in OUTSIDE and detected(x)]
    faults = [x for x in alone if x["hidden"][0] in FAULTS]
    # a constant torque beside a rub is a rub: nothing is missing; what every fit takes out is no alarm either
    empty = [
        x
        for x in lines
        if not x["hidden"] or (x["hidden"][0] in ("external.constant", *TAKEN_OUT) and len(x["hidden"]) == 1)
    ]
    rows: list[tuple[str, object]] = []
    for words, some in (
        ("no torque noise", [x for x in library if not x["noise"]]),
        ("torque noise", [x for x in library if x["noise"]]),
    ):
        near = [x for x in some if in_reach(x)]
        rows += [
            (f"right first, {words}", Share(map(right_first, some))),
            ("the same, in reach", Share(map(right_first, near))),
            ("the bound of the same, all", mean(map(bound, some))),
            (
                f"in the class, whatever is detected, {words}",
                Share(right_named(x) for x in some if detected(x)),
            ),
        ]
    added = [x for x in library if x["verdict"] == "missing_effect" and right_first(x)]
    two = [x for x in lines if len(x["hidden"]) == 2]
    near = [x for x in two if in_reach(x)]
    rows += [
        (
            "from outside the library, detected: unexplained or a class",
            Share(not single_wrong(x) for x in outside),
        ),
        ("a fault of measuring sold as physics", Share(map(sold, faults))),
        ("nothing missing: a false alarm", Share(map(detected, empty))),
        ("95 % intervals of the strength cover the truth", covered(added)),
        ("two effects at once: both found, none extra", Share(map(both, two))),
        ("the same, in reach", Share(map(both, near))),
    ]
    return rows
