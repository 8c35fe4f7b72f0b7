"""Write RESULTS.md and success.png from results.jsonl and rivals.jsonl.

python benchmarks/laws/table.py
"""

from __future__ import annotations

import itertools
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "discovery"))

from hidden import twins
from judge import Share

HERE = Path(__file__).parent
Line = dict[str, Any]
OURS = "gyrotrack laws"
# a law is seen from this size on [sigma]; an answer has at most so many members
_SEEN, _MOST = 5.0, 5
_LARGE = 1000.0
_BINS = (0.0, 5.0, 15.0, 100.0, np.inf)
_HEAD = """# Laws outside the library

Made by `python benchmarks/laws/table.py` from results.jsonl and rivals.jsonl. Gyroscopes, laws, constants and cameras
are drawn by lot and integrated in plain Python (benchmarks/discovery); two recordings are searched, and a third
recording at 60-80 % of the speed is predicted. The largest torque of a law is 1-5 % of the bearing's.

- Form: the true form is among the first five formulas of the set. Torques: the true form is among the first five
  torques, where formulas with the same torque along the recorded motion count once.
- Torque error: rms of the error of the net torques on both bodies, for the fit of the best law along the true motion,
  divided by the rms of the hidden torque.
- Third: rms error of the predicted angle of the casing in the third recording, divided by the noise. Touch point,
  drag of the casing and initial speeds are free.
- Oracle (oracle.py) knows the true form. Sigma: size of the law that the base cannot represent. Set: number of laws
  that data without noise would leave within the equivalence width. Torque error: error of a fit of the true form.

Each line of results.jsonl has the commit that was measured. Lines without process noise are older than lines with
process noise.

The command makes a diagnosis before the search. Only the tables with the title "the whole command" include this
diagnosis; the other tables measure the search alone. Most forms of the hidden laws are in the grammar; their
constants, bodies and mixtures with the base are drawn.
"""


def read(name: str) -> list[Line]:
    """Return the last line of each key that is no error."""
    file = HERE / name
    if not file.is_file():
        return []
    every = {x["key"]: x for x in map(json.loads, file.read_text(encoding="utf-8").splitlines())}
    return [x for x in every.values() if "error" not in x]


def main() -> None:
    lines = read("results.jsonl")
    text = [_HEAD]
    for noise in sorted({x["noise"] for x in lines if x["key"].startswith("hidden")}):
        text += hidden([x for x in lines if x["key"].startswith("hidden") and x["noise"] == noise], noise)
    text += whole([x for x in lines if x["key"].startswith("whole")], "")
    text += whole([x for x in lines if x["key"].startswith("again")], ", with the short cut")
    text += empty([x for x in lines if x["key"].startswith("empty")])
    text += library([x for x in lines if x["key"].startswith("library")])
    text += rivals(lines, read("rivals.jsonl"))
    (HERE / "RESULTS.md").write_text("\n".join([*text, ""]), encoding="utf-8")


def hidden(lines: list[Line], noise: float) -> list[str]:
    """Return the table of one process noise, and the shares of all laws and of those that an oracle sees."""
    text = [
        f"## Hidden laws, process noise {noise:g} N m",
        "",
        "| hidden | form | formulas | torques | torque error | third | oracle: sigma | set | torque error | first |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for x in lines:
        first = f"`{x['set'][0]}`" if x["set"] else "none"
        text.append(
            f"| {x['name']} | {'yes' if x['form'] else 'no'} | {x['set_size']} | {_known(x, 'torques')} | "
            f"{100 * x['torque_error']:.2g} % | {x['third']:.3g} | {_known(x, 'oracle', '.3g')} | "
            f"{_known(x, 'oracle_set')} | {_percent(x.get('oracle_torque_error'))} | {first} |"
        )
    large = [x for x in lines if _size(x) >= _SEEN]
    rows: list[tuple[str, Sequence[Line], Callable[[Line], bool]]] = [
        ("form, all", lines, lambda x: x["form"]),
        (f"form, of at least {_SEEN:g} sigma", large, lambda x: x["form"]),
        ("torque within 3 %, all", lines, lambda x: x["torque_error"] < 0.03),
        ("third below 1.5, all", lines, lambda x: x["third"] < 1.5),
        (f"third below 1.5, of at least {_SEEN:g} sigma", large, lambda x: x["third"] < 1.5),
    ]
    with_oracle = [x for x in lines if "oracle_set" in x]
    if with_oracle:
        form = [x for x in with_oracle if x["oracle_set"] <= _MOST and _size(x) >= _SEEN]
        torque = [x for x in with_oracle if x.get("oracle_torque_error", 1.0) < 0.03 and _size(x) >= _SEEN]
        rows += [
            ("form, where the oracle's set has at most five", form, lambda x: x["form"]),
            (f"form among the first five torques, of at least {_SEEN:g} sigma", [x for x in large if "torques" in x],
             lambda x: x["form_of_torques"]),
            ("torque within 3 %, where the known form reaches it", torque, lambda x: x["torque_error"] < 0.03),
        ]  # fmt: skip
    text += ["", f"{len(lines)} laws were run.", "", "| share | |", "|---|---|"]
    return [*text, *(f"| {words} | {Share(good(x) for x in some)} |" for words, some, good in rows), ""]


def whole(lines: list[Line], words: str) -> list[str]:
    """Return what the whole command answers, the diagnosis by the library included."""
    if not lines:
        return []
    text = [
        f"## Hidden laws, the whole command{words}, no process noise",
        "",
        "The gyroscopes and constants differ from those above. Where the library has the law, or a law with the same",
        "torque apart from the base, the name of this law is the right answer."
        + (" The complete diagnosis runs only where an effect of the library may suffice." if words else ""),
        "",
        "| hidden | answer | true form | torque error | third | CPU s |",
        "|---|---|---|---|---|---|",
    ]
    for x in lines:
        answer = x["library"] or next(iter(x["set"]), "none")
        text.append(
            f"| {x['name']} | `{answer}` | {'yes' if _right(x) else 'no'} | {100 * x['torque_error']:.2g} % | "
            f"{x['third']:.3g} | {x['seconds']:.0f} |"
        )
    rows: list[tuple[str, Callable[[Line], bool]]] = [
        ("true form in the set, or the library's name of it", _right),
        ("torque within 3 %", lambda x: x["torque_error"] < 0.03),
        ("third below 1.5", lambda x: x["third"] < 1.5),
    ]
    text += ["", "| share | |", "|---|---|"]
    return [*text, *(f"| {share} | {Share(good(x) for x in lines)} |" for share, good in rows), ""]


# laws that the library has, by itself or beside the constant friction of the base
_IN_LIBRARY = {"eddy-current brake": "casing.brake.eddy", "draught that dies away": "casing.seal.cooling"}


def _right(x: Line) -> bool:
    return bool(x["form"]) or (x["library"] is not None and _IN_LIBRARY.get(x["name"]) == x["library"])


def _size(x: Line) -> float:
    # where it was not computed, there is no process noise and the law is huge
    return _LARGE if x.get("oracle") is None else float(x["oracle"])


def _known(x: Line, key: str, form: str = "") -> str:
    return format(x[key], form) if x.get(key) is not None else "-"


def _percent(x: float | None) -> str:
    return "-" if x is None else f"{100 * x:.2g} %"


def empty(lines: list[Line]) -> list[str]:
    """Return the share of empty recordings in which a law is claimed, for each process noise."""
    text = ["## Nothing hidden", "", "| process noise [N m] | a law is claimed |", "|---|---|"]
    noises = sorted({x["noise"] for x in lines})
    rows = [f"| {n:g} | {Share(bool(x['claimed']) for x in lines if x['noise'] == n)} |" for n in noises]
    return [*text, *rows, ""]


def library(lines: list[Line]) -> list[str]:
    """Return how often an effect of the library stays the answer."""
    if not lines:
        return []
    named = [x for x in lines if twins(x["hidden"]) & set(x["diagnosed"])]
    failed = [x for x in lines if not twins(x["hidden"]) & set(x["named"])]
    text = [
        "## An effect of the library is hidden",
        "",
        "Two recordings of 40-80 s, 3 % of the budget, the whole command.",
        "",
        "| | |",
        "|---|---|",
        f"| `diagnose` names it | {Share(x in named for x in lines)} |",
        f"| `laws` names it, of those | {Share(bool(twins(x['hidden']) & set(x['named'])) for x in named)} |",
        f"| `laws` names it, of all | {Share(x not in failed for x in lines)} |",
        "",
    ]
    for x in failed:
        answer = ", ".join(x["named"] or x["laws"][:2]) or "nothing"
        named_ = ", ".join(x["diagnosed"][:3]) or "-"
        text.append(f"- {x['hidden']}: diagnosis {x['diagnosis']} ({named_}), laws {x['verdict']}: {answer}")
    return [*text, ""]


def rivals(lines: list[Line], others: list[Line]) -> list[str]:
    """Return the table of other methods on the same recordings, and draw success against the size of the law."""
    ours = {x["key"].removeprefix("hidden|"): x for x in lines if x["key"].startswith("hidden")}
    common = [x for x in others if x["name"] and x["key"] in ours]
    methods = list(
        dict.fromkeys(k for x in others for k, v in x.items() if isinstance(v, dict) and "claims" in v)
    )
    if not common:
        return []
    points: dict[str, list[tuple[float, bool]]] = {OURS: [(_size(x), x["form"]) for x in ours.values()]}
    for m in methods:
        points[m] = [(_size(ours[x["key"]]), x[m]["right"]) for x in common]
    noises = sorted({ours[x["key"]]["noise"] for x in common})
    text = [
        "## Other methods on the same recordings",
        "",
        "Right: the true form is among the first five. `rivals.py` states what each method is given.",
        "",
        "| method | "
        + " | ".join(f"right, {n:g} N m" for n in noises)
        + " | claims where nothing is hidden |",
        "|---|" + "---|" * (len(noises) + 1),
    ]
    nothing = [x for x in others if not x["name"]]
    for m in (OURS, *methods):
        cells = []
        for n in noises:
            some = [x for x in common if ours[x["key"]]["noise"] == n]
            cells.append(str(Share((ours[x["key"]]["form"] if m == OURS else x[m]["right"]) for x in some)))
        empty_ = [x for x in lines if x["key"].startswith("empty")]
        claims = (
            Share(bool(x["claimed"]) for x in empty_)
            if m == OURS
            else Share(x[m]["claims"] > 0 for x in nothing)
        )
        text.append(f"| {m} | {' | '.join(cells)} | {claims} |")
    errors = [x["gplearn"]["torque_error"] for x in common if "torque_error" in x.get("gplearn", {})]
    good = [e for e in errors if np.isfinite(e)]
    if good:
        text += [
            "",
            "gplearn returns a formula for the unmodelled torque on the casing that is not in the grammar: its error",
        ]
        text.append(
            f"below 3 % in {sum(e < 0.03 for e in good)} of {len(good)}, below 30 % in {sum(e < 0.3 for e in good)}."
        )
    draw(points)
    return [*text, "", "![success](success.png)"]


def draw(points: dict[str, list[tuple[float, bool]]]) -> None:
    """Draw the share of right answers against the size of the hidden law."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    # the interval of the shares (95 %) is drawn for one method alone, for the sake of legibility
    figure, ax = plt.subplots(figsize=(8.0, 4.8), layout="constrained")
    colours = ("#0072B2", "#D55E00", "#E69F00", "#009E73", "#CC79A7")
    for place, (method, some) in enumerate(points.items()):
        x, y, low, high = [], [], [], []
        for a, b in itertools.pairwise(_BINS):
            inside = [(max(s, 1.0), r) for s, r in some if a <= s < b]
            if not inside:
                continue
            share = Share(r for _, r in inside)
            x.append(float(np.exp(np.mean([np.log(min(s, 2e4)) for s, _ in inside]))) * 1.05 ** (place - 2))
            y.append(100 * share.hits / share.n)
            low.append(y[-1] - 100 * share.interval[0])
            high.append(100 * share.interval[1] - y[-1])
        ours = method == OURS
        ax.errorbar(
            x, y, yerr=(low, high) if ours else None, marker="o", capsize=3, linewidth=2.4 if ours else 1.2,
            color=colours[place % len(colours)], label=f"{method} ({len(some)} laws)", zorder=5 if ours else 3,
        )  # fmt: skip
    ax.axhline(80, color="#444444", linestyle="--", linewidth=1, label="80 %")
    ax.set_xscale("log")
    ax.set_ylim(-3, 103)
    ax.set_xlabel("size of the hidden law beside the base model [sigma]")
    ax.set_ylabel("true form in the first five [%]")
    ax.legend(frameon=False, fontsize=9, loc="upper left", bbox_to_anchor=(0.42, 0.72))
    ax.grid(alpha=0.3)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    figure.savefig(HERE / "success.png", dpi=130)


if __name__ == "__main__":
    main()
