"""How well `laws` finds laws outside the library, on recordings made elsewhere.

    python benchmarks/laws/run.py hidden [--noise 1e-7] [--only NUMBER ...] [--seed N]
    python benchmarks/laws/run.py empty --count 60 [--noise 1e-7]
    python benchmarks/laws/run.py library [--noise 1e-7] [--seed N]     # short recordings, effects of the library

Each run appends a line of JSON to results.jsonl; `table.py` writes RESULTS.md and success.png.
"""

from __future__ import annotations

import argparse
import json
import os
import time
import traceback
from pathlib import Path
from typing import Any

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import numpy as np
from oracle import oracle
from worlds import EFFECTS, LAWS, World, of_library, world

from fitting._criteria import DEFAULT
from fitting._errors import FittingError
from fitting._workers import WorkerPool
from fitting.discovery._verdict import diagnose
from fitting.dynamics._collocation import Sampler
from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR, Model
from fitting.effects._library import REDUCED
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit
from fitting.inference._record import make_record
from fitting.inference._result import Fit
from fitting.law_search._laws import Law, Laws, _Search, _Steps, laws, with_classes

RESULTS = Path(__file__).parent / "results.jsonl"
_POINTS = 1500


def hidden(index: int, noise: float, seed: int, *, diagnosed: bool) -> dict[str, Any]:
    """Search for the hidden law of this number; without the diagnosis, which takes longer, unless `diagnosed`."""
    w = world(index, seed)
    began = time.process_time()
    data = [CaseData.of(make_record(**r)) for r in w.records(noise, seed)]
    base = fit(Model.of(REDUCED), data[:2])
    if diagnosed:
        found = laws(base)
    else:
        set_ = _Search(base, DEFAULT, WorkerPool(0), _Steps(None)).best_set()
        found = Laws(
            base, "law" if set_ else "none", "", with_classes(set_, DEFAULT) if set_ else (), None, (), "", 0
        )
    line: dict[str, Any] = {
        "key": f"hidden|{index}|{noise:g}|{seed}", "name": w.name, "noise": noise, "verdict": found.verdict,
        "library": found.library.effect.name if found.library else None,
        "set": [x.formula for x in found.answer], "all": [x.formula for x in found.laws],
        "form": any(_is_true(w, x) for x in found.answer[:5]), "set_size": len(found.answer),
        "form_of_torques": any(_is_true(w, x) for group in found.torques[:5] for x in group),
        "torques": len(found.torques),
        "first": bool(found.laws) and _is_true(w, found.laws[0]),
        "diagnosed": diagnosed, "p": found.laws[0].p_value if found.laws else None,
        "seconds": time.process_time() - began,
    }  # fmt: skip
    best = found.laws[0].fit if found.laws else (found.library.fit if found.library is not None else None)
    if best is None:
        best = base
    line |= {"torque_error": torque_error(w, best), "third": third(best, data[2])}
    limit = oracle(w, base, noise)
    line |= {"oracle": limit.size, "oracle_set": limit.set_size, "oracle_rank": limit.rank}
    if limit.fit is not None:
        line |= {"oracle_torque_error": torque_error(w, limit.fit), "oracle_third": third(limit.fit, data[2])}
    return line


def _is_true(w: World, law: Law) -> bool:
    terms = law.form.split(" + ")
    variables = law.fit.model.names[-len(terms) :]
    own = [
        (form, e.joint, frozenset(name.split(".")[2].replace("_omega", " omega").replace("_t", " t").split()))
        for form, e, name in zip(terms, law.effects, variables, strict=True)
    ]
    return any(f in w.forms and j == w.body and v == frozenset(w.variables) for f, j, v in own)


def torque_error(w: World, found: Fit) -> float:
    """Return the rms error of the net torques along the true motion, over the rms of the hidden torque."""
    wrong, size = [], []
    for case in range(2):
        true = w.motion(case)
        first, last = found.problem.data[case].record.span
        keep = (true.time > first) & (true.time < last)
        t, y, a = true.time[keep], true.speed[keep], true.acceleration[keep]
        step = max(1, len(t) // _POINTS)
        t, y, a = t[::step], y[::step], a[::step]
        numbers = found.problem.layout.numbers(found.theta, case)
        own = found.predictions[case].path
        if own.y.shape[-1] > 2:
            y = np.concatenate([y, Sampler(own.mesh, t).value(own.y)[:, 2:]], axis=1)
        rates = found.problem.cases[case].dynamics.rates(t, y, numbers)
        for body, key in ((0, INERTIA_ROTOR), (1, INERTIA_CASING)):
            wrong.append(numbers[key] * (rates[:, body] - a[:, body]))
        (law,) = w.hidden.casing + w.hidden.bearing + w.hidden.rotor
        size.append([law(float(s), float(v[0]), float(v[1]), 0.0) for s, v in zip(t, y, strict=True)])
    error = np.sqrt(np.mean(np.concatenate(wrong) ** 2))
    return float(error / np.sqrt(np.mean(np.concatenate(size) ** 2)))


def third(found: Fit, data: CaseData) -> float:
    """Return the rms error of the casing's angle in a third recording over the noise.

    What the recordings share is held; touch point, drag of the casing and start speeds are free, as in a joint fit.
    """
    from fitting.paper._scan import _prediction_error

    shared = {k: found.estimates[k].value for k in found.model.free if k in found.estimates}
    # of an event every recording has its own; there is none here
    try:
        alone = fit(found.model.with_fixed(shared), [data])
    except FittingError:
        # at the other speed the law has no solution
        return float("inf")
    return float(_prediction_error(alone.cases[0].casing))


def empty(seed: int, noise: float) -> dict[str, Any]:
    """Search where nothing is hidden, with the whole command: law, effect and different parameter are all false."""
    w = world(None, seed)
    data = [CaseData.of(make_record(**r)) for r in w.records(noise, seed, count=2)]
    base = fit(Model.of(REDUCED), data)
    found = laws(base)
    claimed = [x.formula for x in found.laws[:3]]
    if found.verdict != "none" and not claimed:
        claimed = [found.differs.name if found.differs is not None else found.verdict]
    return {
        "key": f"empty|{seed}|{noise:g}", "noise": noise, "claimed": claimed, "verdict": found.verdict,
        "p": found.laws[0].p_value if found.laws else None,
        "delta_bic": found.laws[0].delta_bic if found.laws else None, "base": base.verdict,
    }  # fmt: skip


def library(name: str, noise: float, seed: int) -> dict[str, Any]:
    """Hide an effect of the library, ask for laws: it must stay the answer wherever the diagnosis names it."""
    began = time.process_time()
    base = fit(
        Model.of([n for n in REDUCED if n != name]),
        [make_record(**r) for r in of_library(name, noise, seed)],
    )
    known = diagnose(base)
    best = known.candidates[0] if known.verdict == "missing_effect" and known.candidates else None
    found = laws(base, diagnosis=known)
    answer = found.library
    return {
        "key": f"library|{name}|{noise:g}|{seed}", "hidden": name, "noise": noise, "diagnosis": known.verdict,
        "form": known.form,
        "diagnosed": [] if best is None else [best.effect.name, *best.indistinguishable_from],
        "verdict": found.verdict,
        "named": [] if answer is None else [answer.effect.name, *answer.indistinguishable_from],
        "laws": [x.formula for x in found.answer[:5]], "seconds": time.process_time() - began,
    }  # fmt: skip


def append(line: dict[str, Any]) -> None:
    with RESULTS.open("a", encoding="utf-8") as stream:
        stream.write(json.dumps(line) + "\n")
    print(json.dumps(line), flush=True)


def lines() -> dict[str, dict[str, Any]]:
    if not RESULTS.is_file():
        return {}
    return {x["key"]: x for x in map(json.loads, RESULTS.read_text(encoding="utf-8").splitlines())}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("what", choices=["hidden", "empty", "library"])
    parser.add_argument("--noise", type=float, default=0.0)
    parser.add_argument("--only", type=int, nargs="+", help="numbers of laws, or of effects of the library")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--first", type=int, default=0, help="seed of the first of the empty recordings")
    parser.add_argument("--diagnosed", action="store_true", help="the whole command, the diagnosis included")
    parser.add_argument("--again", action="store_true", help="run what is in the results already")
    options = parser.parse_args()
    done = {} if options.again else lines()
    if options.what == "hidden":
        for index in options.only or range(len(LAWS)):
            key = f"hidden|{index}|{options.noise:g}|{options.seed}"
            if key not in done:
                _kept(
                    key,
                    lambda index=index: hidden(
                        index, options.noise, options.seed, diagnosed=options.diagnosed
                    ),
                )
    elif options.what == "library":
        for name in [EFFECTS[i] for i in options.only or range(len(EFFECTS))]:
            key = f"library|{name}|{options.noise:g}|{options.seed}"
            if key not in done:
                _kept(key, lambda name=name: library(name, options.noise, options.seed))
    else:
        for seed in range(options.first, options.first + options.count):
            key = f"empty|{seed}|{options.noise:g}"
            if key not in done:
                _kept(key, lambda seed=seed: empty(seed, options.noise))


def _kept(key: str, work: Any) -> None:
    try:
        append(work())
    except Exception as fault:  # whatever went wrong belongs into the table
        append({"key": key, "error": "".join(traceback.format_exception_only(fault)).strip()})
        traceback.print_exc()


if __name__ == "__main__":
    main()
