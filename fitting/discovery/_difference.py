"""A parameter that recordings share and that has another value in each of them: an alternative to a missing effect.

Grease that has warmed up, another point on the table or a screw that has come loose changes a parameter between two
recordings. Fitted with one value, they show a lack of fit that an effect of the library may imitate. The hypothesis is

    theta_k, k = 1...K, instead of one theta for K recordings:    K - 1 additional parameters,

scored like an effect (`_score`) and refitted for the parameters with the largest scores.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from fitting._criteria import Criteria
from fitting._numbers import rounded
from fitting.discovery._grammar import description_length
from fitting.discovery._refine import refitted_at
from fitting.discovery._score import CaseColumns, Score, ScoreContext, score, score_of_columns
from fitting.effects._effect import Effect
from fitting.effects._words import effect_name
from fitting.inference._fit import fit
from fitting.inference._params import Estimate
from fitting.inference._result import Fit
from fitting.inference._trace import attempt

_REFITTED = 2
"""Shared parameters with the largest scores that are fitted with a value for each recording [1]. Chosen: fewer may omit
the best one, because scores are first order; more cost time."""


@dataclass(frozen=True)
class DifferentParameter:
    """A parameter shared by the recordings that has another value in each of them."""

    name: str  # ``<effect>.<symbol>``
    estimates: dict[str, Estimate]  # by label; their errors may be strongly correlated
    differences: dict[str, Estimate]  # value in each other recording minus that in the first, by label
    indistinguishable_from: tuple[str, ...]  # parameters whose difference describes the data as well
    delta_bic: float  # BIC with a value for each recording minus BIC of the base
    p_value: (
        float  # probability of such a difference in any shared parameter if all are equal in the recordings
    )

    @property
    def sentence(self) -> str:
        """What differs by how much, and the option that fits it."""
        values = [f"{rounded(e.value, e.stderr, e.unit)} in {label}" for label, e in self.estimates.items()]
        first = next(iter(self.estimates))
        values += [
            f"{label} minus {first} {rounded(e.value, e.stderr, e.unit)}"
            for label, e in self.differences.items()
        ]
        alike = " or ".join(str(effect_name(n)) for n in (self.name, *self.indistinguishable_from))
        return (
            f"The recordings may differ in {alike} "
            f"({', '.join(values)}): with its own value in each recording the model "
            f"describes the data without another law; fit with `--per-case {self.name}`."
        )


class SeparateValues(NamedTuple):
    """A parameter that differs, and the fit with a value for each recording."""

    parameter: DifferentParameter
    fit: Fit

    @property
    def penalised_bic(self) -> float:
        """BIC plus the description length of the name of a parameter."""
        return self.fit.bic + description_length(1)


def different_parameter(
    base: Fit, criteria: Criteria, *, rival: tuple[Fit, float] | None = None, least: float = 0.0
) -> SeparateValues | None:
    """Return the shared parameter whose difference between the recordings describes the data best, or None.

    `rival` is the fit of another explanation, whose noise is used, and its penalised BIC: the difference must
    describe the data as well; without it, better than the base. Without a score of at least `least` nothing is
    refitted.
    """
    layout = base.problem.layout
    # one at its bound may be there only because of the difference
    keys = [k for k in base.model.free if k not in layout.per_case]
    if len(layout.records) < 2 or not keys:
        return None
    context, ends = ScoreContext(base, 1), np.cumsum([0, *(len(d.z) for d in base.problem.data)])
    scores = {}
    for key in keys:
        columns = np.zeros((int(ends[-1]), len(layout.records) - 1))
        for i, p in enumerate(base.predictions[1:], 1):
            columns[ends[i] : ends[i + 1], i - 1] = p.jacobian[:, layout.index[key]]
        scores[key] = score_of_columns(context, columns)
    usual, own = layout.choices
    noise = base.noise if rival is None else rival[0].noise
    trials: dict[str, Fit] = {}
    for key in sorted(keys, key=lambda k: -scores[k])[:_REFITTED]:
        if scores[key] < least:
            continue
        values = base.values
        start = values | {f"{key}@{r.label}": values[key] for r in layout.records}
        with attempt(f"{key} per recording"):
            trials[key] = fit(
                base.model, base.problem.data, share=[k for k in usual if k != key], per_case=[*own, key],
                start={k: v for k, v in start.items() if k != key}, noise=noise,
            )  # fmt: skip
    if not trials:
        return None
    name = min(trials, key=lambda k: trials[k].deviance)
    found = trials[name]
    same = base if rival is None else refitted_at(base, noise)
    single = float(chdtrc(len(layout.records) - 1, max(same.deviance - found.deviance, 0.0)))
    p_value = min(1.0, len(keys) * single)
    first, *others = [found.problem.layout.index[f"{name}@{r.label}"] for r in layout.records]
    estimates = {r.label: found.estimates[f"{name}@{r.label}"] for r in layout.records}
    differences = {}
    for label, i in zip(list(estimates)[1:], others, strict=True):
        c = found.covariance
        u = float(np.sqrt(max(c[i, i] + c[first, first] - 2 * c[i, first], 0.0)))
        value = float(found.theta[i] - found.theta[first])
        differences[label] = replace(estimates[label], value=value, stderr=u)
    similar = tuple(
        k for k, f in trials.items() if k != name and f.deviance < found.deviance + criteria.equivalence_width
    )
    parameter = DifferentParameter(name, estimates, differences, similar, found.bic - same.bic, p_value)
    separate = SeparateValues(parameter, found)
    limit = same.bic - criteria.evidence if rival is None else rival[1] + criteria.equivalence_width
    return separate if p_value < criteria.significance and separate.penalised_bic < limit else None


def improves_on_difference(
    separate: SeparateValues, effects: Sequence[Effect], lengths: Sequence[float], criteria: Criteria
) -> bool:
    """Return whether effects or laws describe the data better than different values of a shared parameter.

    To first order about the fit with these values, the difference being part of the residuals; `lengths` are the
    description lengths of the laws, 0 for effects of the library.
    """
    about = separate.fit
    cases = [CaseColumns(about, i) for i in range(len(about.predictions))]
    own = [
        i for i, n in enumerate(about.problem.layout.names) if n.partition("@")[0] == separate.parameter.name
    ]
    change = about.theta[own] - about.theta[own].mean()
    rows = np.concatenate([p.jacobian[:, own] @ change for p in about.predictions])
    context = ScoreContext(about, 1, torque_rows=rows, shared=separate.parameter.name)
    scores = score(about, effects, cases, criteria, context=context)
    limit = score_of_columns(context, rows[:, None]) - description_length(1)
    limit -= (len(own) - 1) * float(np.log(about.n_eff))
    return max(penalised(s, n, about.n_eff) for s, n in zip(scores, lengths, strict=True)) > limit


def penalised(s: Score, length: float, n_eff: float) -> float:
    """Return a score minus the penalties of the constants and of the length of the formula."""
    return s.score - (s.columns + len(s.shape[0])) * float(np.log(n_eff)) - length
