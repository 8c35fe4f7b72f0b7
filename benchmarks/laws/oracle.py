"""What could be found at best: one who knows the law, or its form, and the noise.

Three limits, each of the same recordings as the search:

size
    Sigma by which the hidden law, at its true constants, is seen beside the base whose parameters are free.
set
    Laws of the grammar that even data without any noise leave within the equivalence width, for the noise of the
    recordings: the response to the true torque is scored instead of the residuals, at the true level of the noise, and
    BIC and description length are added as the search does. No search can make a smaller set of honest width.
known form
    The fit of the base and the true form, the best of those of the grammar that count as it, constants free. Its
    error of the torque, and of the third recording, is what noise alone costs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from worlds import World

from fitting._criteria import DEFAULT
from fitting._workers import WorkerPool
from fitting.discovery._grammar import LawForm
from fitting.discovery._score import CaseColumns, ScoreContext, score
from fitting.dynamics._collocation import Sampler
from fitting.inference._result import Fit
from fitting.law_search._laws import _Chosen, _refined_shapes, _Scored, _Search, _Steps


@dataclass(frozen=True)
class Oracle:
    """The limits of one world; `fit` is that of the known form, None if its search fails."""

    size: float
    set_size: int
    rank: int
    fit: Fit | None


def oracle(w: World, base: Fit, noise: float) -> Oracle:
    """Return the limits for a world with a hidden law, from the base fitted to its recordings."""
    search = _Search(base, DEFAULT, WorkerPool(0), _Steps(None))
    effects = [f.effect for f in search.forms]
    cases = [CaseColumns(base, i) for i in range(len(base.problem.cases))]
    ideal = _ideal(base, _response(w, base, cases), noise)
    found = [_refined_shapes(ideal, s, cases) for s in score(base, effects, cases, DEFAULT, context=ideal)]
    worth = np.array([
        s.score - (s.columns + len(s.shape[0])) * np.log(base.n_eff) - f.description_length
        for s, f in zip(found, search.forms, strict=True)
    ])  # fmt: skip
    right = np.array([counts_as(w, f) for f in search.forms])
    size = float(np.linalg.norm(ideal.levels[0].residual))
    return Oracle(
        size,
        int(np.sum(worth > worth.max() - DEFAULT.equivalence_width)),
        1 + int(np.sum(worth > worth[right].max())),
        _known_form(search, base, cases, right),
    )


def counts_as(w: World, law: LawForm) -> bool:
    """Return whether a law of the grammar has the form, the body and the variables of the hidden one."""
    return law.form in w.forms and law.effect.joint == w.body and set(law.variables) == set(w.variables)


def _response(w: World, base: Fit, cases: list[CaseColumns]) -> np.ndarray:
    """Return the response of the rows of all cases to the hidden torque."""
    (law,) = w.hidden.casing + w.hidden.bearing + w.hidden.rotor
    rows = []
    for case, p in zip(cases, base.predictions, strict=True):
        response = case.response
        t = response.centres
        y = Sampler(p.path.mesh, t).value(p.path.y)
        torque = np.array([law(float(s), float(v[0]), float(v[1]), 0.0) for s, v in zip(t, y, strict=True)])
        acting = {"casing": response.casing, "rotor": response.rotor}.get(
            w.body, response.casing - response.rotor
        )
        seen = acting @ torque
        rows.append(np.concatenate([seen, np.zeros(len(case.case.data.z) - len(seen))]))
    return np.concatenate(rows)


def _ideal(base: Fit, response: np.ndarray, noise: float) -> ScoreContext:
    """Return linearised data whose residual is the response alone, at the true level of the process noise."""
    context = ScoreContext(base, 1)
    context._residual = context.rotated(response)  # noqa: SLF001
    context.levels = [context._level([n.whitener.at(noise) for n in base.noise], context.free)]  # noqa: SLF001
    return context


def _known_form(search: _Search, base: Fit, cases: list[CaseColumns], right: np.ndarray) -> Fit | None:
    search.forms = [f for f, r in zip(search.forms, right, strict=True) if r]
    context = ScoreContext(base, 1)
    found = score(base, [f.effect for f in search.forms], cases, DEFAULT, context=context)
    scored = _Scored([_refined_shapes(context, s, cases) for s in found], context, cases)
    chosen = [_Chosen(f, s, scored) for f, s in zip(search.forms, scored.scores, strict=True)]
    refits = search._refits(chosen, base, base.noise)  # noqa: SLF001
    return min((r.fit for r in refits), key=lambda f: f.deviance, default=None)
