"""Shared parameters whose values differ between the recordings: an alternative to a missing effect.

A parameter changes between two recordings if, for example, the grease warms up, the body is placed elsewhere on the
table, or a screw comes loose. A fit with a shared value then has a lack of fit that an effect of the library may
imitate. The hypothesis replaces one value theta for K recordings by

    theta_k, k = 1...K    (K - 1 additional parameters).

It is scored like an effect (`_score`), and the parameters with the largest scores are refitted. Two set-ups may differ
in several parameters. In this case all parameters first get separate values; then the parameters that do not need
separate values are shared again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
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
from fitting.inference._noise import Noise
from fitting.inference._params import Estimate
from fitting.inference._result import Fit
from fitting.inference._trace import attempt

_REFITTED = 2
"""Number of shared parameters with the largest scores that are fitted with a value for each recording [1]. Chosen:
scores are of first order, so a smaller number may omit the best parameter; a larger one costs time."""


@dataclass(frozen=True)
class ValuesPerRecording:
    """The values of one parameter in the recordings."""

    name: str  # ``<effect>.<symbol>``
    # values by label of the recording; the errors of the values may be strongly correlated
    estimates: dict[str, Estimate]
    differences: dict[str, Estimate]  # value in each other recording minus the value in the first, by label

    @property
    def text(self) -> str:
        """The value in each recording."""
        return ", ".join(f"{rounded(e.value, e.stderr, e.unit)} in {x}" for x, e in self.estimates.items())

    @property
    def largest(self) -> float:
        """The largest difference between two recordings [sigma].

        It is 0 if no uncertainty is known, for example at a bound.
        """
        return max(
            (abs(e.value) / e.stderr for e in self.differences.values() if e.stderr > 0.0), default=0.0
        )


@dataclass(frozen=True)
class DifferentParameter(ValuesPerRecording):
    """A shared parameter whose values in the recordings differ, and any further parameters with separate values."""

    # other parameters that describe the data equally well if their values differ
    indistinguishable_from: tuple[str, ...]
    delta_bic: float  # BIC with a value for each recording minus BIC of the base
    # probability of such a difference in any shared parameter if no parameter differs between the recordings
    p_value: float
    others: tuple[ValuesPerRecording, ...] = ()  # other parameters with a value for each recording

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all parameters that differ."""
        return self.name, *(p.name for p in self.others)

    @property
    def sentence(self) -> str:
        """A sentence with the parameters that may differ, their values, and the options that separate them in a fit."""
        options = " ".join(f"--per-case {n}" for n in self.names)
        if self.others:
            values = "; ".join(f"{effect_name(p.name)}: {p.text}" for p in (self, *self.others))
            return (
                f"The recordings differ: with separate values of {len(self.names)} parameters for each recording the "
                f"model describes the data without another law. {values}. Fit with `{options}`."
            )
        alike = " or ".join(str(effect_name(n)) for n in (self.name, *self.indistinguishable_from))
        first = next(iter(self.estimates))
        values = ", ".join(
            [self.text]
            + [f"{x} minus {first} {rounded(e.value, e.stderr, e.unit)}" for x, e in self.differences.items()]
        )
        return (
            f"The recordings may differ in {alike} ({values}): with a separate value for each recording, the model "
            f"describes the data without another law; fit with `{options}`."
        )


class SeparateValues(NamedTuple):
    """Parameters that differ, and the fit with separate values for the recordings."""

    parameter: DifferentParameter
    fit: Fit

    @property
    def penalised_bic(self) -> float:
        """BIC plus the description length of the names of the parameters."""
        return self.fit.bic + description_length(len(self.parameter.names))


def different_parameter(
    base: Fit, criteria: Criteria, *, rival: tuple[Fit, float] | None = None, least: float = 0.0
) -> SeparateValues | None:
    """Return the shared parameter whose separate values describe the data best; None if separate values do not help.

    `rival` contains the fit of an alternative explanation and its penalised BIC. With a rival, the fit with separate
    values must describe the data as well as the rival does, at the noise of the rival. Without a rival, it must
    describe the data better than the base.

    A parameter is refitted only if its score, the predicted fall of the deviance, is at least `least`. If no single
    parameter suffices, several parameters may differ; this is tested only without a rival.
    """
    layout = base.problem.layout
    # parameters at a bound are tested as well: a difference between the recordings may shift the shared value to its
    # bound
    keys = [k for k in base.model.free if k not in layout.per_case]
    if len(layout.records) < 2 or not keys:
        return None
    context, ends = ScoreContext(base, 1), np.cumsum([0, *(len(d.z) for d in base.problem.data)])
    columns = {}
    for key in keys:
        columns[key] = np.zeros((int(ends[-1]), len(layout.records) - 1))
        for i, p in enumerate(base.predictions[1:], 1):
            columns[key][ends[i] : ends[i + 1], i - 1] = p.jacobian[:, layout.index[key]]
    scores = {k: score_of_columns(context, c) for k, c in columns.items()}
    promising = [k for k in sorted(keys, key=lambda k: -scores[k])[:_REFITTED] if scores[k] >= least]
    one = _one_that_differs(base, promising, len(keys), criteria, rival)
    if rival is not None or len(keys) == 1 or (one is not None and not one.fit.fails(criteria)):
        return one
    if score_of_columns(context, np.concatenate(list(columns.values()), axis=1)) < least:
        return one
    return _several_that_differ(base, keys, criteria) or one


def _one_that_differs(
    base: Fit, keys: Sequence[str], tests: int, criteria: Criteria, rival: tuple[Fit, float] | None
) -> SeparateValues | None:
    """Return the parameter of `keys` whose separate values describe the data best; None if they do not suffice.

    The p-value is multiplied by the number `tests` of scored parameters.
    """
    noise = base.noise if rival is None else rival[0].noise
    trials: dict[str, Fit] = {}
    for key in keys:
        start = base.values | {f"{key}@{r.label}": base.values[key] for r in base.problem.layout.records}
        with attempt(f"{key} per recording"):
            trials[key] = _fit_per_recording(
                base, [key], start={k: v for k, v in start.items() if k != key}, noise=noise
            )
    if not trials:
        return None
    name = min(trials, key=lambda k: trials[k].deviance)
    found = trials[name]
    same = base if rival is None else refitted_at(base, noise)
    single = float(chdtrc(len(base.problem.layout.records) - 1, max(same.deviance - found.deviance, 0.0)))
    p_value = min(1.0, tests * single)
    similar = tuple(
        k for k, f in trials.items() if k != name and f.deviance < found.deviance + criteria.equivalence_width
    )
    values = vars(_values(found, name))
    parameter = DifferentParameter(
        **values, indistinguishable_from=similar, delta_bic=found.bic - same.bic, p_value=p_value
    )
    separate = SeparateValues(parameter, found)
    limit = same.bic - criteria.evidence if rival is None else rival[1] + criteria.equivalence_width
    return separate if p_value < criteria.significance and separate.penalised_bic < limit else None


def _several_that_differ(base: Fit, keys: Sequence[str], criteria: Criteria) -> SeparateValues | None:
    """Return parameters whose separate values describe the data; None if separate values of all do not suffice.

    The shared values of the base are a compromise between the recordings, and its noise contains the differences of the
    recordings. Therefore the first fit does not use the initial values and the noise of the base. Then parameters are
    shared again one by one, in ascending order of their difference, if this lowers the BIC and causes no lack of fit.
    """
    found = None
    with attempt("all parameters per recording"):
        found = _fit_per_recording(base, keys)
    if found is None or found.fails(criteria):
        return None
    values = sorted((_values(found, k) for k in keys), key=lambda v: v.largest)
    tried = 0
    while len(values) > 1 and tried < len(values):
        shared, rest = values[tried], [v for i, v in enumerate(values) if i != tried]
        tried += 1
        start = {k: v for k, v in found.values.items() if k.partition("@")[0] != shared.name}
        value, u = np.array([(e.value, e.stderr) for e in shared.estimates.values()]).T
        # a value at a bound has no uncertainty
        start[shared.name] = float(np.average(value, weights=u**-2 if (u > 0).all() else None))
        with attempt(f"{shared.name} for all recordings"):
            fewer = _fit_per_recording(base, [v.name for v in rest], start=start, noise=found.noise)
            if fewer.bic < found.bic and not fewer.fails(criteria):
                found, tried = fewer, 0
                values = sorted((_values(fewer, v.name) for v in rest), key=lambda v: v.largest)
    *others, first = values
    constants = len(values) * (len(base.problem.layout.records) - 1)
    single = float(chdtrc(constants, max(base.deviance - found.deviance, 0.0)))
    p_value = min(1.0, math.comb(len(keys), len(values)) * single)
    parameter = DifferentParameter(
        **vars(first),
        indistinguishable_from=(),
        delta_bic=found.bic - base.bic,
        p_value=p_value,
        others=tuple(others[::-1]),
    )
    separate = SeparateValues(parameter, found)
    better = separate.penalised_bic < base.bic - criteria.evidence
    return separate if p_value < criteria.significance and better else None


def _fit_per_recording(
    base: Fit,
    keys: Sequence[str],
    *,
    start: Mapping[str, float] | None = None,
    noise: Sequence[Noise] | None = None,
) -> Fit:
    """Return the fit of the base model with separate values of the parameters `keys` for the recordings."""
    usual, own = base.problem.layout.choices
    share, per_case = [k for k in usual if k not in keys], [*own, *keys]
    return fit(base.model, base.problem.data, share=share, per_case=per_case, start=start, noise=noise)


def _values(found: Fit, name: str) -> ValuesPerRecording:
    """Return the separate values of a parameter, and their differences from the value in the first recording.

    The standard uncertainty of a difference contains the covariance of the two values.
    """
    labels = [r.label for r in found.problem.layout.records]
    first, *others = [found.problem.layout.index[f"{name}@{label}"] for label in labels]
    estimates = {label: found.estimates[f"{name}@{label}"] for label in labels}
    differences = {}
    for label, i in zip(labels[1:], others, strict=True):
        c = found.covariance
        u = float(np.sqrt(max(c[i, i] + c[first, first] - 2 * c[i, first], 0.0)))
        value = float(found.theta[i] - found.theta[first])
        differences[label] = replace(estimates[label], value=value, stderr=u)
    return ValuesPerRecording(name, estimates, differences)


def improves_on_difference(
    separate: SeparateValues, effects: Sequence[Effect], lengths: Sequence[float], criteria: Criteria
) -> bool:
    """Return whether an effect or a law describes the data better than separate values of shared parameters.

    The comparison is of first order about the fit with separate values. The contribution of the differences to the
    motion is added to the residuals. `lengths` contains the description length of each law, and 0 for effects of the
    library.
    """
    about = separate.fit
    cases = [CaseColumns(about, i) for i in range(len(about.predictions))]
    names = separate.parameter.names
    of_name = [
        [i for i, n in enumerate(about.problem.layout.names) if n.partition("@")[0] == k] for k in names
    ]
    own = [i for indices in of_name for i in indices]
    change = np.concatenate([about.theta[i] - about.theta[i].mean() for i in of_name])
    rows = np.concatenate([p.jacobian[:, own] @ change for p in about.predictions])
    context = ScoreContext(about, 1, torque_rows=rows, shared=names)
    scores = score(about, effects, cases, criteria, context=context)
    limit = score_of_columns(context, rows[:, None]) - description_length(len(names))
    limit -= (len(own) - len(names)) * float(np.log(about.n_eff))
    return max(penalised(s, n, about.n_eff) for s, n in zip(scores, lengths, strict=True)) > limit


def penalised(s: Score, length: float, n_eff: float) -> float:
    """Return a score minus the penalties for the number of constants and for the length of the formula."""
    return s.score - (s.columns + len(s.shape[0])) * float(np.log(n_eff)) - length
