"""Detection limits and power of recordings, and the next run.

    recordings (a fit of them, or their description) -> power of the search -> rivals -> the next run

The recordings are present, with the fit of a model to them, or they are described in a file
(`fitting.discovery._planned_recordings`) and simulated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fitting._criteria import DEFAULT, Criteria
from fitting._errors import EstimationError
from fitting._workers import single_blas_thread
from fitting.discovery._information import Information, rivals
from fitting.discovery._next_run import Bounds, NextRun, next_run
from fitting.discovery._planned_recordings import read_planned
from fitting.discovery._power import EffectLimits, Search
from fitting.effects._effect import Effect
from fitting.inference._process_noise import ProcessNoise
from fitting.inference._result import Fit

Progress = Callable[[int, int | None], None]

_EVALUATIONS = 60
# simulations of described recordings over which the power is averaged, and further ones for estimates of the process
# noise alone
_SIMULATIONS, _ESTIMATES = 2, 8


@dataclass(frozen=True)
class Plan:
    """Detection limits and power of some recordings, and the next run.

    Attributes
    ----------
    fit : Fit
        The model fitted to the recordings, measured or simulated.
    planned : bool
        The recordings are described and not measured.
    size : float
        Rms torque of an effect [N m] to which `power` and `runs_needed` refer.
    effects : tuple of EffectLimits
        Of every candidate effect, the one with the smallest detection limit first.
    classes : tuple of tuple of str
        Effects that these recordings would not separate.
    next_run : NextRun or None
        The proposed run; None if none can be simulated.
    warning : str
        A restriction of the answer; empty if there is none.
    """

    fit: Fit
    planned: bool
    size: float
    effects: tuple[EffectLimits, ...]
    classes: tuple[tuple[str, ...], ...]
    next_run: NextRun | None
    warning: str = field(default="")


@single_blas_thread()
def plan(
    recordings: Fit | str | Path,
    extra: Sequence[Effect] = (),
    *,
    size: float | None = None,
    bounds: Bounds | None = None,
    criteria: Criteria = DEFAULT,
    progress: Progress | None = None,
) -> Plan:
    """Return detection limit, upper limit and power for every effect, and the most informative next run.

    Parameters
    ----------
    recordings : Fit, str or Path
        A fit of the present recordings, or a TOML file that describes planned ones.
    extra : sequence of Effect
        Effects of the user, in addition to the library.
    size : float, optional
        Rms torque of an effect [N m] for `power` and `runs_needed`; by default 1 % of the rms torque of the bearing
        (for a single body, of the net torque).
    bounds : Bounds, optional
        Possible runs; by default those of the file, or according to the recordings.
    criteria : Criteria
        Thresholds of the search whose power is computed.
    progress : callable, optional
        Called with (steps done, all).

    Returns
    -------
    Plan

    Raises
    ------
    FittingError
        If the description is not valid, or the size is not positive.
    """
    if size is not None and not 0 < size < np.inf:
        raise EstimationError(f"the size of the effect is {size:g} N m", "give a positive rms torque in N m")
    planned = not isinstance(recordings, Fit)
    truth: dict[str, float] = {}
    process: list[tuple[ProcessNoise, ...]] = []
    if isinstance(recordings, Fit):
        if recordings.problem.data[0].oscillation is not None:
            raise EstimationError(
                "a plan is made for runs that begin at given speeds, and this body oscillates about an equilibrium",
                "release it from a larger angle, or record it for longer: both separate restoring torques better",
            )
        if recordings.model.rigid_contact is not None:
            raise EstimationError(
                "a plan is made for runs whose initial speeds are independent, and these bodies roll on each other",
                "plan the run of each body alone, from its own study",
            )
        fit, fits = recordings, [recordings]
    else:
        described = read_planned(recordings)
        fits = [described.fit(i) for i in range(_SIMULATIONS)]
        fit, bounds, truth = fits[0], bounds or described.bounds, described.numbers
        process = [described.process_noise(_SIMULATIONS + i) for i in range(_ESTIMATES)]
    report = progress or (lambda done, total: None)  # noqa: ARG005
    search, *others = (Search(f, extra, criteria, truth=truth, process=process) for f in fits)
    total = len(search.effects) + _EVALUATIONS
    found = []
    for i, effect in enumerate(search.effects):
        report(i, total)
        found.append(search.limits(effect, size, planned=planned, others=others))
    found.sort(key=lambda e: (not np.isfinite(e.detection_limit), np.isnan(e.torque), e.detection_torque))
    limits = {e.effect.name: e for e in found}
    scores = search.scores()
    information = Information(
        fit, [(e, scores[e.name].shape) for e in search.effects if not limits[e.name].absorbed]
    )
    significant = [s.threshold for s in scores.values()]
    alternatives = [] if planned else rivals(information, significant, criteria)
    proposed = next_run(
        information,
        alternatives,
        criteria,
        bounds or Bounds.of(fit),
        evaluations=_EVALUATIONS,
        progress=lambda done, all_: report(total - (all_ or 0) + done, total),
    )
    used = size if size is not None else search.default_size
    return Plan(fit, planned, used, tuple(found), _classes(found), proposed, _warning(fit, criteria))


def _classes(found: Sequence[EffectLimits]) -> tuple[tuple[str, ...], ...]:
    """Return groups of effects of which each is indistinguishable from another, as connected components."""
    groups: list[set[str]] = []
    for e in found:
        if not e.indistinguishable_from:
            continue
        joined = {e.effect.name, *e.indistinguishable_from}
        separate = [g for g in groups if not g & joined]
        for g in groups:
            if g & joined:
                joined |= g
        groups = [*separate, joined]
    order = [e.effect.name for e in found]
    return tuple(tuple(sorted(g, key=order.index)) for g in groups)


def _warning(fit: Fit, criteria: Criteria) -> str:
    if not fit.converged:
        return "The fit has not converged: the limits are not reliable."
    if fit.fails(criteria):
        return (
            "The model has a significant lack of fit: limits hold for a model without it. "
            "Run `gyrotrack improve` first."
        )
    return ""
