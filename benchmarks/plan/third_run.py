"""Two effects at once: what the recommended third run adds to two recordings.

    python benchmarks/plan/third_run.py run results.jsonl --pairs 45      # adds pairs until there are so many
    python benchmarks/plan/third_run.py table results.jsonl

The pairs, the two recordings and the judgement ("both, none extra") are those of `benchmarks/discovery` (two effects of
3 % of the budget, process noise 1e-7 N m, a centre off by 2 mrad; made without a line of `fitting`). `improve` of two
recordings gives the fit of which the plan asks for a third run; the third recording is made accordingly by the same
independent simulation, and `improve` starts anew with all three. As a control, the third run repeats the first one.

The independent simulation has no other surface and no reversed rotor (the mirror image of a casing spun against the
rotor): the plan is bound to what it can make.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "discovery"))

from experiment import CASES, Hidden, integrate, record, shake, together
from hidden import LIBRARY as HIDDEN
from hidden import Draw
from judge import both
from plan import CENTRE, NOISE, Planned, budget
from plan import plan as runs_of_discovery

from fitting import Model, fit, improve, make_record, plan
from fitting.discovery._information import Run
from fitting.discovery._next_run import Bounds
from fitting.effects._library import REDUCED

# time before the end of the simulated motion at which a recording stops [s]
_MARGIN = 2.0


def main() -> None:
    """Run some pairs, or print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("run", "table"))
    parser.add_argument("results", type=Path)
    parser.add_argument("--pairs", type=int, default=45)
    parser.add_argument("--most", type=int, default=1000, help="pairs of this call at most")
    parser.add_argument("--no-control", action="store_true", help="no repetition of the first run")
    args = parser.parse_args()
    if args.what == "table":
        print("\n".join(table(args.results)))
        return
    done = (
        {json.loads(x)["key"] for x in args.results.read_text().splitlines()}
        if args.results.exists()
        else set()
    )
    pairs = [r for r in runs_of_discovery(4, ("pair",)) if r.noise == NOISE][: args.pairs]
    for run in [r for r in pairs if r.key not in done][: args.most]:
        line = answer(run, control=not args.no_control)
        with args.results.open("a") as stream:
            stream.write(json.dumps(line) + "\n")


def answer(run: Planned, *, control: bool) -> dict[str, Any]:
    """Return what is named with two recordings, with the recommended third one, and with a repetition."""
    names = [n for n in REDUCED if n not in run.hidden]
    two = [make_record(**r) for r in run.records()]
    began = [time.process_time()]
    history = improve(fit(Model.of(names), two))
    began.append(time.process_time())
    end = history[-1].fit
    usual = Bounds.of(end)
    # a reversed rotor is the mirror image of a casing spun against it
    slowest = max(usual.omega_rotor[0], usual.omega_casing[1] + 50)
    bounds = replace(
        usual, omega_rotor=(slowest, usual.omega_rotor[1]), touchpoint=(1.0, 1.0), reversible=False
    )
    proposed = plan(end, bounds=bounds).next_run
    if proposed is None:
        raise SystemExit(f"{run.key}: no run can be simulated")
    began.append(time.process_time())
    line = {
        "key": run.key, "hidden": list(run.hidden), "two": _named(history, names),
        "rivals": [list(r) for r in proposed.rivals], "sentence": proposed.sentence,
        "third": _named(improve(fit(Model.of(names), [*two, _third(run, proposed.run)])), names),
    }  # fmt: skip
    line["seconds"] = np.diff([*began, time.process_time()]).round(1).tolist()
    if control:
        record_ = two[0].rotor
        first = Run(*CASES[0]["start"], CASES[0]["span"], tuple(float(w.time[0]) for w in record_), 3.0)
        line["control"] = _named(improve(fit(Model.of(names), [*two, _third(run, first)])), names)
    return line


def _named(history: Any, names: list[str]) -> dict[str, Any]:
    fit_ = history[-1].fit
    return {"named": [n for n in fit_.model.names if n not in names], "verdict": fit_.verdict}


def _third(run: Planned, wanted: Run) -> Any:
    """Make the third recording, with the gyroscope, the surface and the noise of the first."""
    case = CASES[0] | {
        "start": (wanted.omega_rotor, wanted.omega_casing),
        "span": wanted.duration,
        "windows": tuple(w / wanted.duration for w in wanted.windows),
        "window": wanted.window_length,
        "I_casing": CASES[0]["I_casing"] * wanted.ring,
    }
    seed = zlib.crc32(run.key.encode())
    worlds: list[Hidden] = [Hidden(centre=CENTRE)]
    for name in run.hidden:
        # as in benchmarks/discovery: the moment of an event is drawn for each recording, all else is common
        key = zlib.crc32(name.encode())
        draw = Draw.of(
            case["span"], np.random.default_rng([seed, 0, key]), np.random.default_rng([seed, 1, key, 2])
        )
        worlds.append(HIDDEN[name](run.strength * budget(run.gyroscopes[0]), draw))
    # the independent simulation ends where the casing is slow, and shifts each window by up to its length
    quiet = integrate(case, together(worlds), shake(case["span"], 0.0, 1.0, np.random.default_rng(0)))
    end = min(wanted.duration, float(quiet.time[-1]) - _MARGIN)
    starts = [min(w, end - 2 * wanted.window_length) for w in wanted.windows]
    case |= {"span": end, "windows": tuple(w / end for w in starts)}
    made = record(
        case, together(worlds), torque_noise=run.noise, torque_time=run.noise_time,
        rng=np.random.default_rng([seed, 2, 2]), label="case3",
    )  # fmt: skip
    return make_record(**made)


def table(path: Path) -> list[str]:
    """Return the shares of pairs that are named, both and none extra."""
    lines = [json.loads(x) for x in path.read_text().splitlines()]
    rows = ["| recordings | both effects named, none extra |", "|---|---|"]
    for key, words in (
        ("two", "two"),
        ("third", "and the recommended third run"),
        ("control", "and a repetition"),
    ):
        some = [x for x in lines if key in x]
        right = sum(both({"hidden": x["hidden"], "named": x[key]["named"]}) for x in some)
        if some:
            rows.append(f"| {words} | {right} of {len(some)} ({100 * right / len(some):.0f} %) |")
    return rows


if __name__ == "__main__":
    main()
