"""One run asked: what `diagnose` and `improve` say about it, beside what is true."""

from __future__ import annotations

import math
import subprocess
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from hidden import twins
from oracle import Oracle
from plan import Planned

from fitting.discovery._select import Candidate, Step, best, improve
from fitting.discovery._verdict import Diagnosis, diagnose
from fitting.dynamics._model import Model
from fitting.effects._library import LIBRARY, REDUCED
from fitting.inference._fit import fit
from fitting.inference._record import make_record
from fitting.inference._result import Fit

_KEPT = 6


def answer(run: Planned) -> dict[str, Any]:
    """Make the recordings of a run, fit the base without what is hidden, ask, and keep what is needed to judge.

    Returns
    -------
    dict
        ``named``: the effects that the answer names, the first one first, empty for "adequate".
        ``ranked``: the best candidates, and the hidden one, as [name, kind, score, delta_bic, p, refitted].
        ``added``: the parameters of the first as [name, value, stderr, truth, (value - truth) / stderr], and its
        refit's ``chi2`` and ``held`` for each casing, and ``verdict``.
        ``sigma``: the size of each hidden effect: whole, beside the base (and the other effect, where there are two),
        and beside base and nearest ``rival``.
        ``seconds``: of CPU, for the fit and for the answer.
        For two effects ``rungs`` and, as ``named``, the effects of the last rung that the base has not.
    """
    records = [make_record(**r) for r in run.records()]
    base_names = [n for n in REDUCED if n not in run.hidden]
    began = time.process_time()
    base = fit(Model.of(base_names), records)
    seconds = [time.process_time() - began]
    line: dict[str, Any] = {
        "key": run.key,
        "part": run.part,
        "hidden": list(run.hidden),
        "strength": run.strength,
        "cases": run.cases,
        "noise": run.noise,
        "seed": run.seed,
        "commit": commit(),
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "base": quality(base) | {"verdict": base.verdict},
    }
    line |= _sizes(run, base)
    began = time.process_time()
    if len(run.hidden) == 2:
        rungs = improve(base)
        line |= _ladder(rungs, base_names, run)
    else:
        line |= _answered(diagnose(base), run)
    return line | {"seconds": [*seconds, time.process_time() - began]}


def _sizes(run: Planned, base: Fit) -> dict[str, Any]:
    """Return the size of what is hidden in sigma, each effect beside the other where there are two."""
    if not run.hidden:
        return {}
    oracle = Oracle(base, run.noise, run.noise_time)
    worlds = {name: run.worlds_of(name) for name in run.hidden}
    found = []
    for name in run.hidden:
        told = oracle
        for other in worlds.keys() - {name}:
            told = told.default_for(other, worlds[other])
        found.append(told.reach(name, worlds[name]))
    return {
        "sigma": [[r.whole, r.beside_base, r.beside_rival] for r in found],
        "rival": [r.rival for r in found],
    }


def _answered(found: Diagnosis, run: Planned) -> dict[str, Any]:
    chosen = None if found.verdict == "adequate" else best(found.candidates)
    named = [chosen.effect.name, *chosen.indistinguishable_from] if chosen else []
    return {
        "verdict": found.verdict,
        "form": found.form,
        "explained": found.explained,
        "named": named,
        "kinds": [LIBRARY[n].kind if n in LIBRARY else "unknown" for n in named],
        "ranked": _ranked(found.candidates, run),
        "added": _added(chosen, run) if chosen else None,
    }


def _ranked(candidates: Sequence[Candidate], run: Planned) -> list[list[Any]]:
    """Return the first candidates, and those that are right wherever they stand."""
    right = frozenset().union(*(twins(h) for h in run.hidden))
    return [_row(c) for i, c in enumerate(candidates) if i < _KEPT or c.effect.name in right]


def _row(c: Candidate) -> list[Any]:
    return [c.effect.name, c.effect.kind, c.score, c.delta_bic, c.p_value, c.fit is not None]


def _added(chosen: Candidate, run: Planned) -> dict[str, Any]:
    right = len(run.hidden) == 1 and chosen.effect.name in twins(run.hidden[0])
    worlds = run.worlds_of(run.hidden[0]) if right else []
    rows = []
    for key, e in chosen.estimates.items():
        name, _, label = key.partition("@")
        # a parameter that all cases share has the truth of the first
        i = int(label.removeprefix("case")) - 1 if label else 0
        truth = worlds[i].truth.get(name.rsplit(".", 1)[1]) if worlds else None
        # told before the numbers are shortened: a strength may be known to more than four digits
        off = e.value - truth if truth is not None else None
        if off is not None and name.endswith(".phi"):
            off = math.remainder(off, 2 * math.pi)
        pull = off / e.stderr if off is not None and e.stderr else None
        rows.append([key, e.value, e.stderr, truth, pull])
    refit = {} if chosen.fit is None else quality(chosen.fit) | {"verdict": chosen.fit.verdict}
    return {"name": chosen.effect.name, "parameters": rows, **refit}


def _ladder(rungs: list[Step], base_names: list[str], run: Planned) -> dict[str, Any]:
    final = [n for n in rungs[-1].fit.model.names if n not in base_names]
    if not final:
        verdict = "adequate" if rungs[-1].fit.verdict == "no_lack_of_fit" else "unexplained"
    else:
        verdict = "missing_effect" if rungs[-1].fit.verdict == "no_lack_of_fit" else "unexplained"
    return {
        "verdict": verdict,
        "named": final,
        "kinds": [LIBRARY[n].kind for n in final],
        "added": None,
        "rungs": [{"change": r.change, **quality(r.fit), "bic": r.fit.bic - rungs[0].fit.bic} for r in rungs],
        "ranked": _ranked(rungs[0].candidates, run),
    }


def quality(fitted: Fit) -> dict[str, Any]:
    """Return chi-square over its degrees of freedom and the held-out error of each casing, and the level."""
    return {
        "chi2": [c.casing.reduced_chi2 for c in fitted.cases],
        "held": [c.casing.held_out for c in fitted.cases],
        "level": float(np.max([n.level for n in fitted.noise])),
    }


@cache
def commit() -> str:
    """Return the commit that is measured; a plus sign says that `fitting` or the benchmark was changed since."""
    here = Path(__file__).parent

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=here, capture_output=True, text=True, check=False)
        return done.stdout.strip()

    name = git("rev-parse", "--short=9", "HEAD") or "unknown"
    return name + ("+" if git("status", "--porcelain", "--", "*.py", "../../fitting") else "")
