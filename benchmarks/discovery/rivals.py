"""What one would do otherwise, on the same recordings: sparse regression by PySINDy, and stepwise BIC.

    pip install pysindy
    python benchmarks/discovery/rivals.py --seeds 1

Both get more than they would have: the base's fitted speed of the rotor between its windows, the power of the base's
bearing as a known term, and the library's laws on a grid of shape constants. Both see speeds (angles
differentiated, means over 51 samples) and take samples as independent, as textbooks do. They look at the equation of
the casing, which is filmed all the time, and are asked about effects that show in it.
"""

from __future__ import annotations

import argparse
import os
import warnings
from pathlib import Path
from typing import Any

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import numpy as np
from answer import commit
from hidden import LIBRARY, twins
from laws import BASE_TERMS, Speeds, generic, laws
from lines import append, read_lines
from plan import STRENGTHS, Planned, plan

from fitting.dynamics._collocation import Sampler
from fitting.dynamics._model import Model
from fitting.effects._library import REDUCED
from fitting.inference._fit import fit
from fitting.inference._record import make_record

TARGET = Path(__file__).parent / "rivals.jsonl"
_SMOOTHED, _KEPT_EVERY = 51, 13
_THRESHOLDS = np.geomspace(1e-4, 0.3, 25)
_DOMAINS = 300
_MOST_TERMS = 5


def speeds(run: Planned) -> list[Speeds]:
    """Return the speeds of each recording as one would have them."""
    records = [make_record(**r) for r in run.records()]
    base = fit(Model.of(n for n in REDUCED if n not in run.hidden), records)
    found = []
    for record, prediction in zip(records, base.predictions, strict=True):
        t, psi = record.casing.time, record.casing.value
        window = np.ones(_SMOOTHED) / _SMOOTHED
        keep = slice(_SMOOTHED, -_SMOOTHED, _KEPT_EVERY)
        omega = np.convolve(np.gradient(psi, t), window, "same")[keep]
        path = prediction.path
        wr = Sampler(path.mesh, t[keep]).value(path.y[..., 0])
        found.append(Speeds(t[keep], wr, omega, np.convolve(psi, window, "same")[keep]))
    return found


def stepwise(cases: list[Speeds]) -> list[str]:
    """Add the law that lowers BIC most, again and again: speeds as integrals of laws, independent residuals."""
    y = np.concatenate([s.wc for s in cases])
    chosen = _joined([[s.integrated(s.base()), np.ones((len(s.t), 1))] for s in cases], own=True)
    candidates = [(name, _joined([[s.integrated(c)] for s, c in zip(cases, columns, strict=True)], own=own), cost)
                  for name, columns, own, cost in laws(cases)]  # fmt: skip
    named: list[str] = []
    best = _bic(chosen, y, 0)
    spent = 0
    while len(named) < _MOST_TERMS:
        scores = [(_bic(np.concatenate([chosen, c], axis=1), y, spent + cost), i)
                  for i, (name, c, cost) in enumerate(candidates) if name not in named]  # fmt: skip
        score, i = min(scores)
        if score >= best:
            break
        name, columns, cost = candidates[i]
        named.append(name)
        chosen, best, spent = np.concatenate([chosen, columns], axis=1), score, spent + cost
    return named


def sparse(cases: list[Speeds], *, own_laws: bool, weak: bool) -> list[str]:
    """Return the terms that PySINDy's STLSQ keeps beside the base's, largest part of the torque first."""
    import pysindy as ps

    rows, right = [], []
    terms = [name for name, *_ in (laws(cases) if own_laws else generic(cases))]
    tables = [list(t[1]) for t in (laws(cases) if own_laws else generic(cases))]
    for i, s in enumerate(cases):
        columns = np.concatenate([s.base(), *(t[i] for t in tables)], axis=1)
        if weak:
            library = ps.WeakPDELibrary(
                ps.PolynomialLibrary(1, include_bias=False), spatiotemporal_grid=s.t, K=_DOMAINS
            )
            library.fit(columns)
            rows.append(np.asarray(library.transform(columns)))
            right.append(np.asarray(library.convert_u_dot_integral(s.wc[:, None])))
        else:
            rows.append(columns)
            right.append(np.asarray(ps.SmoothedFiniteDifference()(s.wc[:, None], s.t)))
    a, y = np.concatenate(rows), np.concatenate(right)
    a = a / np.linalg.norm(a, axis=0)
    names = [*BASE_TERMS, *(n for n, t in zip(terms, tables, strict=True) for _ in range(t[0].shape[1]))]
    best: tuple[float, np.ndarray] = (np.inf, np.zeros(len(names)))
    for threshold in _THRESHOLDS:
        optimizer = ps.STLSQ(threshold=threshold * float(np.linalg.norm(y)), alpha=1e-9)
        w = optimizer.fit(a, y).coef_.ravel()
        if not w.any():
            continue
        rest = y[:, 0] - a @ w
        score = len(y) * float(np.log(rest @ rest)) + np.count_nonzero(w) * float(np.log(len(y)))
        best = min(best, (score, w), key=lambda b: b[0])
    size = np.abs(best[1])
    kept = [names[i] for i in np.argsort(-size) if size[i] > 0]
    return list(dict.fromkeys(n for n in kept if n not in BASE_TERMS))


def _bic(columns: np.ndarray, y: np.ndarray, spent: int) -> float:
    q, _ = np.linalg.qr(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))
    rest = y - q @ (q.T @ y)
    return len(y) * float(np.log(rest @ rest)) + (columns.shape[1] + spent) * float(np.log(len(y)))


def _joined(parts: list[list[np.ndarray]], *, own: bool) -> np.ndarray:
    blocks = [np.concatenate(p, axis=1) for p in parts]
    if not own:
        return np.concatenate(blocks)
    total = np.zeros((sum(map(len, blocks)), sum(b.shape[1] for b in blocks)))
    i = j = 0
    for b in blocks:
        total[i : i + len(b), j : j + b.shape[1]] = b
        i, j = i + len(b), j + b.shape[1]
    return total


def answers(run: Planned) -> dict[str, Any]:
    """Return what each method names, the first one first."""
    cases = speeds(run)
    methods = {
        "stepwise BIC, speeds, our laws": lambda: stepwise(cases),
        "PySINDy, generic library": lambda: sparse(cases, own_laws=False, weak=False),
        "PySINDy, generic library, weak form": lambda: sparse(cases, own_laws=False, weak=True),
        "PySINDy, our laws": lambda: sparse(cases, own_laws=True, weak=False),
        "PySINDy, our laws, weak form": lambda: sparse(cases, own_laws=True, weak=True),
    }
    said = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the methods' own, about thresholds that take everything out
        for method, ask in methods.items():
            # a generic term stands for every effect that has it, and counts as right if one of them is
            said[method] = [_best_name(n, run.hidden) for n in ask()]
    return {
        "key": run.key,
        "hidden": list(run.hidden),
        "noise": run.noise,
        "commit": commit(),
        "answers": said,
    }


def _best_name(term: str, hidden: tuple[str, ...]) -> str:
    effects = term.split("|")
    right = [e for e in effects if hidden and e in twins(hidden[0])]
    return (right or effects)[0]


def _fair(run: Planned) -> bool:
    """Two recordings, 1 %, nothing or what the casing's equation shows beside the base."""
    shown = not run.hidden or (
        run.hidden[0] in LIBRARY and not run.hidden[0].startswith(("rotor.", "external."))
    )
    return run.cases == 2 and run.strength == STRENGTHS[0] and shown


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--only", nargs="+", default=[], help="words that must all stand in the key of a run")
    options = parser.parse_args()
    done = {line["key"] for line in read_lines(TARGET)}
    for r in plan(options.seeds, ("library", "nothing")):
        if r.key not in done and _fair(r) and all(w in r.key for w in options.only):
            line = answers(r)
            append(TARGET, line)
            print(r.key, {m: n[:3] for m, n in line["answers"].items()}, flush=True)


if __name__ == "__main__":
    main()
