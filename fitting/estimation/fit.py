"""The fit: start values, straight variables, measured noise, errors that count it.

Two levels of random torque are found for each case. The *pure* level is what no slow torque can explain: the
noise. The *level* of the fit is what this model leaves: the same if the model is right, more if it
misses something. Parameters are estimated at the level of the fit, so that a model that fails by a
thousand sigma somewhere is not torn there; its chi-square and held-out error are told at the pure level.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from fitting.case_data import CaseData
from fitting.errors import EstimationError
from fitting.estimation.first_search import search_with_noise, shaped
from fitting.estimation.layout import Layout
from fitting.estimation.noise_levels import Noise, cautious, refine_level
from fitting.estimation.outcome import Fit, outcome
from fitting.estimation.problem import Problem
from fitting.estimation.search import search, search_around
from fitting.estimation.start import first_values
from fitting.model import Model
from fitting.record import Record

# chi2 per row with which a level of random torque is what the model leaves
_EXCUSED = 1.5


def fit(
    model: Model,
    cases: Sequence[Record | CaseData],
    *,
    share: Iterable[str] = (),
    per_case: Iterable[str] = (),
    start: Mapping[str, float] | None = None,
    noise: Sequence[Noise] | None = None,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    steady: Iterable[str] = (),
    quick: bool = False,
) -> Fit:
    """Fit a model to one case, or to several together.

    Parameters
    ----------
    model : Model
        The model.
    cases : sequence of Record or CaseData
        Each experiment; with several, the touch point, the casing's drag and the start speeds have
        a value for each, all else is shared.
    share, per_case : iterable of str
        Change which parameters are shared.
    start : mapping, optional
        Values to start from; the others come from a regression.
    noise : sequence of Noise, optional
        The noise found by an earlier fit of the same data, so that both can be compared.
    ranges : mapping, optional
        Bounds tighter than the declared ones.
    steady : iterable of str
        Parameters, by their names in the fit, that keep their start values until all others have followed.
    quick : bool
        Stop where chi-square is within about 0.01 of its minimum: enough to rank candidates.

    Returns
    -------
    Fit

    Raises
    ------
    EstimationError
        If there is nothing to fit, or labels repeat.
    """
    data = [c if isinstance(c, CaseData) else CaseData.of(c) for c in cases]
    _check(model, data)
    problem = Problem(Layout.of(model, [d.record for d in data], share, per_case, ranges), data)
    theta = first_values(problem, start)
    if noise is None:
        theta, noise = search_with_noise(problem, theta, start, quick=quick)
    elif not set(problem.layout.names) <= set(start or ()):
        # far from the minimum a model fails by far more than the noise, and a valley seen so sharply is hard to follow
        problem.set_noise(cautious(problem, theta, noise))
        theta, unknown = shaped(problem, theta, start, noise)
        theta = search_around(problem, theta, unknown)
        noise = refine_level(problem, theta, noise)
    problem.set_noise([n.whitener for n in noise])
    held = tuple(steady)
    if held:
        theta = search_around(problem, theta, held)
        # the noise that the model was excused with before the law came would excuse any shape
        noise = refine_level(problem, theta, noise)
        problem.set_noise([n.whitener for n in noise])
    _, theta = search(problem, theta, quick=quick)
    noise = refine_level(problem, theta, noise)
    problem.set_noise([n.whitener for n in noise])
    minimum, theta = search(problem, theta, quick=quick)
    if minimum.cost > _EXCUSED * problem.rows:
        noise = refine_level(problem, theta, noise, settled=True)
        problem.set_noise([n.whitener for n in noise])
        minimum, theta = search(problem, theta, quick=quick)
    return outcome(problem, theta, noise, converged=minimum.converged)


def _check(model: Model, data: Sequence[CaseData]) -> None:
    labels = [d.record.label for d in data]
    if not data or len(set(labels)) != len(labels):
        raise EstimationError(
            "the cases of a joint fit need different labels", "give them with --label when making a case"
        )
    single = [d.record.single for d in data]
    if any(single) != all(single):
        raise EstimationError(
            "one body alone and a rotor in its casing cannot be fitted together", "fit them one by one"
        )
    foreign = [e.name for e in model.effects if not e.alone] if all(single) else []
    if foreign:
        raise EstimationError(
            f"{foreign[0]} speaks of a rotor, which this record of one body does not have",
            "its laws are those that act on the casing alone: `gyrotrack effects` lists them",
        )
