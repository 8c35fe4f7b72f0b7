"""What one would use otherwise, on the same recordings: PySINDy, gplearn, knockoffs, stepwise BIC.

    pip install pysindy gplearn knockpy scikit-learn          (an environment of its own)
    python benchmarks/laws/rivals.py hidden|empty [--count N]

All get more than they would have: the base's fitted speed of the rotor between its windows, the base's own terms as
known columns with the fitted exponent, the laws of the grammar at a few shape constants each. PySINDy and gplearn see
the equation of the casing in smoothed speeds; knockoffs and stepwise BIC see our whitened rows with the base projected
out. A method is right if one of the first five terms that it names has the form and the variables of the hidden law;
the body need not agree. It claims something if it names any term besides the base's.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import warnings
from pathlib import Path
from typing import Any

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import numpy as np
from worlds import LAWS, World, world

from fitting.discovery._grammar import LawForm, grammar
from fitting.discovery._score import CaseColumns, ScoreContext
from fitting.dynamics._collocation import Sampler
from fitting.dynamics._model import Model
from fitting.effects._expression import Tape
from fitting.effects._library import REDUCED
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit
from fitting.inference._record import make_record
from fitting.inference._result import Fit
from fitting.law_search._laws import ranges_of

RESULTS = Path(__file__).parent / "rivals.jsonl"
_SMOOTHED, _KEPT_EVERY = 51, 39
_SHAPES = 2
_MOST = 5

Columns = list[tuple[LawForm, np.ndarray]]


def base_of(w: World, noise: float, seed: int) -> Fit:
    data = [CaseData.of(make_record(**r)) for r in w.records(noise, seed)[:2]]
    return fit(Model.of(REDUCED), data)


def forms_of(base: Fit) -> list[LawForm]:
    span = max(d.record.span[1] - d.record.span[0] for d in base.problem.data)
    found = grammar(ranges_of(base), span, bodies={"rotor", "casing"}, angles=False)
    return [f for f in found if f.effect.state is None and not f.effect.per_case]


def choices(form: LawForm) -> list[dict[str, float]]:
    """Return a few values of the shape constants of a law, spread over its grid."""
    shapes = [p for p in form.effect.parameters if p.role == "shape"]
    # the inner points of an even division: the ends of a grid are extreme
    grids = [np.array(p.grid)[np.linspace(0, len(p.grid) - 1, _SHAPES + 2).astype(int)[1:-1]] for p in shapes]
    return [
        dict(zip((p.symbol for p in shapes), map(float, v), strict=True)) for v in itertools.product(*grids)
    ]


def series(base: Fit) -> list[dict[str, np.ndarray]]:
    """Return time, smoothed speeds and torque on the casing of each case, as one would have them."""
    found = []
    for data, p in zip(base.problem.data, base.predictions, strict=True):
        t, psi = data.record.casing.time, data.record.casing.value
        window = np.ones(_SMOOTHED) / _SMOOTHED
        omega = np.convolve(np.gradient(psi, t), window, "same")
        keep = slice(_SMOOTHED, -_SMOOTHED, _KEPT_EVERY)
        omega_r = Sampler(p.path.mesh, t[keep]).value(p.path.y[..., 0])
        rate = data.record.I_casing * np.convolve(np.gradient(omega, t), window, "same")
        wc = omega[keep]
        found.append(
            {"t": t[keep], "omega_r": omega_r, "omega_c": wc, "delta": omega_r - wc, "torque": rate[keep]}
        )
    return found


def table(base: Fit, cases: list[dict[str, np.ndarray]]) -> tuple[np.ndarray, Columns]:
    """Return the base's own columns and those of the grammar, over the samples of all cases."""
    g = base.estimates["bearing.power.g"].value
    known = np.concatenate([np.stack([s["delta"], s["delta"] ** g], axis=1) for s in cases])
    blocks = []
    for i, s in enumerate(cases):
        block = np.zeros((len(s["t"]), 2 * len(cases)))
        block[:, 2 * i], block[:, 2 * i + 1] = 1.0, s["omega_c"]
        blocks.append(block)
    known = np.concatenate([known, np.concatenate(blocks)], axis=1)
    columns: Columns = []
    for form in forms_of(base):
        tape = Tape([form.effect.expression])
        phase = any(p.role == "phase" for p in form.effect.parameters)
        for shape in choices(form):
            for phi in (0.0, np.pi / 2) if phase else (0.0,):
                parts = [
                    np.asarray(tape({**s, **shape, "k": 1.0, "phi": phi})[0]) * np.ones(len(s["t"]))
                    for s in cases
                ]
                columns.append((form, np.concatenate(parts)))
    return known, [(f, c) for f, c in columns if np.isfinite(c).all() and np.ptp(c) > 0]


def pysindy_names(base: Fit, *, weak: bool) -> list[LawForm]:
    """Return the terms that an ensemble of sequentially thresholded least squares keeps, the largest first."""
    import pysindy as ps

    cases = series(base)
    known, columns = table(base, cases)
    a = np.concatenate([known, np.stack([c for _, c in columns], axis=1)], axis=1)
    y = np.concatenate([s["torque"] for s in cases])
    if weak:
        rows, right, start = [], [], 0
        for s, data in zip(cases, base.problem.data, strict=True):
            part = a[start : start + len(s["t"])]
            start += len(s["t"])
            library = ps.WeakPDELibrary(
                ps.PolynomialLibrary(1, include_bias=False), spatiotemporal_grid=s["t"], K=200
            )
            library.fit(part)
            rows.append(np.asarray(library.transform(part)))
            right.append(
                data.record.I_casing * np.asarray(library.convert_u_dot_integral(s["omega_c"][:, None]))[:, 0]
            )
        a, y = np.concatenate(rows), np.concatenate(right)
    a, y = a / np.linalg.norm(a, axis=0), y / np.linalg.norm(y)
    best: tuple[float, np.ndarray] = (np.inf, np.zeros(a.shape[1]))
    for threshold in np.geomspace(1e-3, 0.1, 4):
        optimizer = ps.EnsembleOptimizer(ps.STLSQ(threshold=threshold, alpha=1e-6), bagging=True, n_models=5)
        optimizer.fit(a, y[:, None])
        every = np.array(optimizer.coef_list)[:, 0]
        w = np.where((every != 0).mean(axis=0) > 0.6, np.median(every, axis=0), 0.0)
        kept = w != 0
        if not kept.any():
            continue
        w = np.zeros(a.shape[1])
        w[kept] = np.linalg.lstsq(a[:, kept], y, rcond=None)[0]
        rest = y - a @ w
        score = len(y) * float(np.log(rest @ rest)) + kept.sum() * float(np.log(len(y)))
        best = min(best, (score, w), key=lambda b: b[0])
    size = np.abs(best[1][known.shape[1] :])
    return _unique([columns[i][0] for i in np.argsort(-size) if size[i] > 0])


def our_rows(base: Fit) -> tuple[np.ndarray, Columns, float]:
    """Return the whitened, projected residual, and such columns of the grammar."""
    context = ScoreContext(base, 1)
    cases = [CaseColumns(base, i) for i in range(2)]
    level = context.levels[-1]
    columns: Columns = []
    for form in forms_of(base):
        trials = [c.trials(form.effect, choices(form)) for c in cases]
        rows = np.concatenate(
            [np.concatenate([t.columns for t in each]) for each in zip(*trials, strict=True)], axis=1
        )
        rows = level.gain[:, None] * context.rotated(rows)
        rows = rows - level.basis @ (level.basis.T @ rows)
        columns += [(form, c) for c in rows.T]
    size = [float(np.linalg.norm(c)) for _, c in columns]
    kept = [(f, c / s) for (f, c), s in zip(columns, size, strict=True) if s > 1e-6 * max(size)]
    return level.residual, kept, base.n_eff


def stepwise_names(base: Fit) -> list[LawForm]:
    """Add the column that lowers BIC most, again and again."""
    r, columns, n = our_rows(base)
    a, chosen, named = np.stack([c for _, c in columns], axis=1), np.zeros((len(r), 0)), []
    for _ in range(_MOST):
        left = a - chosen @ (chosen.T @ a)
        size = np.linalg.norm(left, axis=0)
        gain = np.where(size > 1e-4, (left.T @ r) ** 2 / np.maximum(size, 1e-4) ** 2, 0.0)
        i = int(np.argmax(gain))
        if gain[i] < np.log(n):
            break
        named.append(columns[i][0])
        q = left[:, i] / size[i]
        chosen, r = np.column_stack([chosen, q]), r - q * (q @ r)
    return _unique(named)


def knockoff_names(base: Fit) -> list[LawForm]:
    """Select with fixed-X knockoffs at a false discovery rate of 10 %: for each law the best of its columns."""
    from knockpy import KnockoffFilter

    r, columns, _ = our_rows(base)
    best: dict[str, tuple[LawForm, np.ndarray]] = {}
    for form, c in columns:
        if form.effect.name not in best or abs(c @ r) > abs(best[form.effect.name][1] @ r):
            best[form.effect.name] = (form, c)
    kept: list[LawForm] = []
    x = np.zeros((len(r), 0))
    for (
        form,
        c,
    ) in best.values():  # columns that are the same but for a part in a thousand stand for one another
        left = c - x @ np.linalg.lstsq(x, c, rcond=None)[0] if kept else c
        if np.linalg.norm(left) > 3e-2:
            x = np.column_stack([x, c])
            kept.append(form)
    chosen = KnockoffFilter(ksampler="fx", fstat="lasso").forward(X=x, y=r, fdr=0.1, shrinkage=None)
    order = np.argsort(-np.abs(x.T @ r))
    return [kept[i] for i in order if chosen[i]]


def gplearn_answer(w: World, base: Fit, seed: int) -> tuple[str, float]:
    """Return a formula of gplearn for the torque on the casing, and its rms error.

    Both are less what the base absorbs; the error is relative to the rms of the law.
    """
    from gplearn.genetic import SymbolicRegressor

    cases = series(base)
    known, _ = table(base, cases)
    y = np.concatenate([s["torque"] for s in cases])
    x = np.stack([np.concatenate([s[n] for s in cases]) for n in ("t", "omega_r", "omega_c")], axis=1)
    rest = y - known @ np.linalg.lstsq(known, y, rcond=None)[0]
    scale = np.abs(x).max(axis=0)
    search = SymbolicRegressor(
        population_size=400, generations=12, function_set=("add", "sub", "mul", "div", "sqrt", "log", "sin"),
        parsimony_coefficient=1e-3, random_state=seed, n_jobs=1,
    )  # fmt: skip
    keep = slice(None, None, 2)
    search.fit((x / scale)[keep], (rest / rest.std())[keep])
    if not (w.hidden.casing or w.hidden.bearing):
        return str(search._program), float("nan")  # noqa: SLF001
    (law,) = w.hidden.casing + w.hidden.bearing
    true = np.array([law(*map(float, v), 0.0) for v in x])
    found = search.predict(x / scale) * rest.std()
    project = known @ np.linalg.pinv(known)
    rest_of_law = true - project @ true
    error = (found - project @ found) - rest_of_law
    return str(search._program), float(np.sqrt(np.mean(error**2) / np.mean(rest_of_law**2)))  # noqa: SLF001


def _unique(names: list[LawForm]) -> list[LawForm]:
    return list({f.effect.name: f for f in names}.values())


def _right(w: World, named: list[LawForm]) -> bool:
    return any(f.form in w.forms and set(f.variables) == set(w.variables) for f in named[:_MOST])


def answers(index: int | None, noise: float, seed: int) -> dict[str, Any]:
    """Return for each method whether it is right and how much it claims."""
    w = world(index, seed)
    base = base_of(w, noise, seed)
    methods = {
        "PySINDy, ensemble": lambda: pysindy_names(base, weak=False),
        "PySINDy, ensemble, weak form": lambda: pysindy_names(base, weak=True),
        "stepwise BIC, our rows": lambda: stepwise_names(base),
        "knockoffs (FDR 10 %), our rows": lambda: knockoff_names(base),
    }
    line: dict[str, Any] = {"key": f"{index}|{noise:g}|{seed}", "name": w.name}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for method, ask in methods.items():
            try:
                named = ask()
                laws = [f"{f.effect.joint}: {f.effect.law}" for f in named[:_MOST]]
                line[method] = {"right": _right(w, named), "claims": len(named), "named": laws}
            except Exception as fault:  # the method's own failure is its answer
                line[method] = {"right": False, "claims": 0, "error": str(fault)[:200]}
        try:
            formula, error = gplearn_answer(w, base, seed)
            line["gplearn"] = {"formula": formula[:200], "torque_error": error}
        except Exception as fault:
            line["gplearn"] = {"error": str(fault)[:200]}
    return line


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("what", choices=["hidden", "empty"])
    parser.add_argument("--count", type=int, default=len(LAWS))
    parser.add_argument("--noise", type=float, default=0.0)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    done = set()
    if RESULTS.is_file():
        done = {json.loads(x)["key"] for x in RESULTS.read_text(encoding="utf-8").splitlines()}
    for i in range(options.count):
        index, seed = (i, options.seed) if options.what == "hidden" else (None, i)
        noise = options.noise if options.what == "hidden" else (0.0 if i % 2 else 1e-7)
        if f"{index}|{noise:g}|{seed}" in done:
            continue
        line = answers(index, noise, seed)
        with RESULTS.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(line) + "\n")
        print(json.dumps(line), flush=True)


if __name__ == "__main__":
    main()
