"""What figures and reports show of a study, collected from fits.

The paper's smoothing of a noisy angle has an error of its own, which no model can lower. It is found by
putting the modelled angle, with noise as strong as that of the data, through the same smoothing. The noise is
that of the fastest changes, which no motion makes: third differences of white noise of rms s have an rms of
s sqrt(20).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fitting.inference._speed_residuals import SpeedResidual, speed_residuals

if TYPE_CHECKING:
    from fitting.discovery._residuals import Failure, ResidualTorque
    from fitting.discovery._select import Candidate
    from fitting.discovery._select import Step as FitStep
    from fitting.discovery._verdict import Diagnosis
    from fitting.inference._result import Fit


Array = NDArray[np.float64]

_SEED = 1
_NORMAL = 0.6745  # median of the absolute value of a standard normal variable
_THIRD = 20.0  # 1 + 9 + 9 + 1


def smoothing_floor(fit: Fit) -> float:
    """Return the rms error of the casing's speed that noise alone leaves, over all cases [rad/s]."""
    return float(np.sqrt(np.mean([_floor(fit, i) ** 2 for i in range(len(fit.problem.data))])))


def _floor(fit: Fit, case: int) -> float:
    from fitting.dynamics._mesh import Sampler
    from fitting.inference._record import Samples
    from fitting.inference._velocity import speeds

    record, path = fit.problem.data[case].record, fit.predictions[case].path
    measured = record.casing
    noise = float(np.median(np.abs(np.diff(measured.value, 3)))) / _NORMAL / np.sqrt(_THIRD)
    sampler = Sampler(path.mesh, measured.time)
    omega = sampler.value(path.y[..., 1])
    exact = sampler.integral(*path.angle(path.states[1])) if record.quantity == "angle" else omega
    # the seed is fixed so that a report does not change from run to run
    shaken = exact + noise * np.random.default_rng(_SEED).standard_normal(len(exact))
    time, seen = speeds(Samples(measured.time, shaken, measured.sigma), record.quantity)
    return float(np.sqrt(np.mean((seen - np.interp(time, measured.time, omega)) ** 2)))


_MODEL_POINTS = 800
_WINDOW_POINTS = 60
_ENERGY_PIECES = 50
_SUGGESTED = 3


@dataclass(frozen=True)
class Curve:
    """A curve with its standard deviation (zero where it has none)."""

    time: Array
    value: Array
    sigma: Array


@dataclass(frozen=True)
class Energy:
    """Balance K + losses over its first value, minus 1: as it is, its running mean, and its largest size."""

    exact: Curve
    mean: Curve
    drift: float


@dataclass(frozen=True)
class Supplied:
    """Torque on each body that a model has and the base lacks [N m], along its own motion; `name` says which."""

    name: str
    time: Array
    omega_c: Array
    rotor: Array
    casing: Array

    def on(self, body: str) -> Array:
        """Return the torque on one body."""
        return self.rotor if body == "rotor" else self.casing


@dataclass(frozen=True)
class Seen:
    """One case under one model.

    Attributes
    ----------
    casing : Curve
        Modelled speed [rad/s] and its standard deviation from the parameters' errors.
    rotor : tuple of Curve
        The same in each window.
    casing_misfit, rotor_misfit : SpeedResidual, tuple of SpeedResidual
        Measured minus modelled speed.
    torques : dict of str to ResidualTorque
        What the model lacks, for each body.
    """

    casing: Curve
    rotor: tuple[Curve, ...]
    casing_misfit: SpeedResidual
    rotor_misfit: tuple[SpeedResidual, ...]
    torques: dict[str, ResidualTorque]


@dataclass(frozen=True)
class CaseView:
    """One case: what was measured, and what the first and the last model make of it.

    Attributes
    ----------
    body : str
        What people call the body in the casing's place: "body" where only one was recorded.
    casing, rotor : Curve, tuple of Curve
        Measured speed, smoothed as in the paper [rad/s].
    models : tuple of Seen
        The base and, if anything was added, the final model.
    supplied : Supplied or None
        Torque on each body that the final model has and the base lacks.
    suggested : tuple of Supplied
        The same for the best other candidates, each refitted.
    energy : tuple of Energy
        The balance of each rung.
    failures : tuple of Failure
        Where the base fails.
    """

    label: str
    surface: str
    quantity: str
    body: str
    casing: Curve
    rotor: tuple[Curve, ...]
    models: tuple[Seen, ...]
    supplied: Supplied | None
    suggested: tuple[Supplied, ...]
    energy: tuple[Energy, ...]
    failures: tuple[Failure, ...]


def case_view(
    rungs: Sequence[FitStep],
    diagnosis: Diagnosis | None,
    torques: Sequence[tuple[ResidualTorque, ...]],
    index: int,
) -> CaseView:
    """Return one case under the first and the last model of a ladder.

    Parameters
    ----------
    rungs : sequence of FitStep
        The ladder, base first.
    diagnosis : Diagnosis or None
        That of the base.
    torques : sequence
        What the first and the last model lack.
    index : int
        Which case.
    """
    from fitting.inference._velocity import speeds

    base, final = rungs[0].fit, rungs[-1].fit
    record = base.problem.data[index].record
    fits = [base, final] if len(rungs) > 1 else [base]
    return CaseView(
        label=record.label,
        surface=record.surface,
        quantity=record.quantity,
        body=record.body,
        casing=_measured(*speeds(record.casing, record.quantity)),
        rotor=tuple(_measured(*speeds(w, record.quantity)) for w in record.rotor),
        models=tuple(_seen(f, t, index) for f, t in zip(fits, torques, strict=True)),
        supplied=_supplied("final model", base, final, index) if len(fits) > 1 else None,
        suggested=_suggested(base, final, diagnosis, index),
        energy=tuple(_energy(r.fit, index) for r in rungs),
        failures=tuple(f for f in (diagnosis.failures if diagnosis else ()) if f.label == record.label),
    )


def _measured(time: Array, omega: Array) -> Curve:
    return Curve(time, omega, np.zeros_like(omega))


def _seen(fit: Fit, torques: Sequence[ResidualTorque], index: int) -> Seen:
    record = fit.problem.data[index].record
    casing, rotor = speed_residuals(fit, index)
    ends = record.casing.time[[0, -1]]
    return Seen(
        _modelled(fit, index, 1, np.linspace(ends[0], ends[1], _MODEL_POINTS)),
        tuple(
            _modelled(fit, index, 0, np.linspace(w.time[0], w.time[-1], _WINDOW_POINTS)) for w in record.rotor
        ),
        casing,
        rotor,
        {t.body: t for t in torques if t.label == record.label},
    )


def _modelled(fit: Fit, index: int, body: int, time: Array) -> Curve:
    from fitting.inference._speed_residuals import modelled_speed

    return Curve(time, *modelled_speed(fit, index, body, time))


def _suggested(base: Fit, final: Fit, diagnosis: Diagnosis | None, index: int) -> tuple[Supplied, ...]:
    """Return the torques of the best candidates that were refitted and are not in the final model."""
    found = [
        _supplied(c.effect.name, base, c.fit, index)
        for c in (diagnosis.candidates if diagnosis is not None else ())
        if c.fit is not None
        and c.physical
        and c.significant
        and not c.effect.depends_on_angle
        and c.effect.name not in final.model.names
    ]
    return tuple(s for s in found if s is not None)[:_SUGGESTED]


def _supplied(name: str, base: Fit, other: Fit, index: int) -> Supplied | None:
    """Return the torque that another model has and the base lacks, along the other's motion."""
    from fitting.dynamics._mesh import Sampler

    old, new = base.problem.cases[index], other.problem.cases[index]
    path = other.predictions[index].path
    if set(other.model.smooth.names) <= set(base.model.smooth.names):
        return None
    if not set(old.dynamics.states) <= set(path.states):
        return None
    time = np.linspace(path.mesh.edges[0], path.mesh.edges[-1], _MODEL_POINTS)
    state = Sampler(path.mesh, time).value(path.y)
    inertia = np.array([new.data.record.I_rotor, new.data.record.I_casing])
    gained = new.dynamics.rates(time, state, other.problem.layout.numbers(other.theta, index))[:, :2]
    seen = state[:, [path.states.index(s) for s in old.dynamics.states]]
    had = old.dynamics.rates(time, seen, base.problem.layout.numbers(base.theta, index))[:, :2]
    torque = (gained - had) * inertia
    return Supplied(name, time, state[:, 1].copy(), torque[:, 0].copy(), torque[:, 1].copy())


def _energy(fit: Fit, index: int) -> Energy:
    from scipy.ndimage import uniform_filter1d

    from fitting.inference._metrics import energy_balance

    balance = energy_balance(fit.problem.cases[index], fit.theta, fit.predictions[index].path)
    drift = balance.energy / balance.energy[0] - 1
    mean = uniform_filter1d(drift, max(1, len(drift) // _ENERGY_PIECES), mode="nearest")
    return Energy(_measured(balance.time, drift), _measured(balance.time, mean), balance.drift)


@dataclass(frozen=True)
class Step:
    """One rung: what was changed and what the errors did; see `fitting.study._serialisation.rung_document`."""

    change: str
    rmse: float
    reduced_chi2: float
    held_out: float
    delta_bic: float
    energy_drift: float
    torque_left: float
    torque_pure: float
    verdict: str


@dataclass(frozen=True)
class Content:
    """Everything that a report shows about the fits.

    `models` in a case has the base and, if anything was added, the final model. `rmse_floor` is what noise
    alone makes of the casing's rms error [rad/s].
    """

    steps: tuple[Step, ...]
    rmse_floor: float
    base: Fit
    final: Fit
    added: tuple[str, ...]
    verdict: str
    sentence: str
    candidates: tuple[Candidate, ...]
    next_experiment: str
    whiteness: tuple[tuple[str, float], ...]
    cases: tuple[CaseView, ...]

    @property
    def body(self) -> str:
        """What people call the body in the casing's place: "body" where only one was recorded."""
        return self.cases[0].body

    @property
    def improved(self) -> bool:
        """Whether there is a final model that differs from the base."""
        return len(self.steps) > 1


def gather(rungs: Sequence[FitStep], diagnosis: Diagnosis | None) -> Content:
    """Collect what is to be shown.

    Parameters
    ----------
    rungs : sequence of FitStep
        The ladder, base first.
    diagnosis : Diagnosis or None
        That of the base.
    """
    from fitting.discovery._residuals import whiteness
    from fitting.study._serialisation import ladder_verdict

    base, final = rungs[0].fit, rungs[-1].fit
    fits = (base, final) if len(rungs) > 1 else (base,)
    torques = tuple(_torques(f, diagnosis) for f in fits)
    candidates = diagnosis.candidates if diagnosis is not None else rungs[0].candidates
    verdict = ladder_verdict(rungs)
    if len(rungs) == 1 and diagnosis is not None:
        verdict = diagnosis.verdict
    return Content(
        steps=_steps(rungs),
        rmse_floor=smoothing_floor(final),
        base=base,
        final=final,
        added=tuple(n for n in final.model.names if n not in base.model.names),
        verdict=verdict,
        sentence=diagnosis.sentence if diagnosis is not None else "",
        candidates=tuple(c for c in candidates if c.score > 0),
        next_experiment=diagnosis.next_experiment if diagnosis is not None else "",
        whiteness=tuple((w.label, w.p_value) for w in whiteness(final)),
        cases=tuple(case_view(rungs, diagnosis, torques, i) for i in range(len(base.problem.data))),
    )


def _steps(rungs: Sequence[FitStep]) -> tuple[Step, ...]:
    from fitting.study._serialisation import rung_document

    steps = []
    for i, rung in enumerate(rungs):
        d = rung_document(rung.fit, "", rung.change, rungs[i - 1].fit if i else None)
        steps.append(
            Step(
                change=rung.change or "base model",
                rmse=d["rmse_casing"],
                reduced_chi2=d["reduced_chi2"],
                held_out=d["held_out"],
                delta_bic=d["delta_bic"],
                energy_drift=d["energy_drift"],
                torque_left=rung.fit.torque_noise,
                torque_pure=max(n.pure for n in rung.fit.noise),
                verdict=rung.fit.verdict,
            )
        )
    return tuple(steps)


def _torques(fit: Fit, diagnosis: Diagnosis | None) -> tuple[ResidualTorque, ...]:
    from fitting.discovery._residuals import residual_torques

    if diagnosis is not None and diagnosis.fit is fit:
        return diagnosis.torques
    return tuple(residual_torques(fit))


def correlations(fit: Fit) -> tuple[list[str], Array]:
    """Return the names of the parameters that have a finite error, and their correlation matrix."""
    variance = np.diag(fit.covariance)
    keep = np.flatnonzero(np.isfinite(variance) & (variance > 0))
    root = np.sqrt(variance[keep])
    matrix = fit.covariance[np.ix_(keep, keep)] / np.outer(root, root)
    return [fit.problem.layout.names[i] for i in keep], np.clip(matrix, -1, 1)
