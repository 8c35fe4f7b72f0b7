"""Data for figures, report and workbench, computed from the fits of a study."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import DEFAULT
from fitting._numbers import unit_text
from fitting.effects._mechanism import MAIN
from fitting.inference._speed_residuals import SpeedResidual, modelled_speed, speed_residuals
from gyrotrack.plotting._charts import Interval

if TYPE_CHECKING:
    from fitting.discovery._difference import DifferentParameter
    from fitting.discovery._power import UpperLimit
    from fitting.discovery._residuals import Failure, ResidualTorque
    from fitting.discovery._select import Candidate
    from fitting.discovery._select import Step as FitStep
    from fitting.discovery._verdict import Diagnosis
    from fitting.effects._effect import Effect
    from fitting.effects._words import EffectName
    from fitting.inference._record import Body, Samples
    from fitting.inference._result import Fit


Array = NDArray[np.float64]
Residual = SpeedResidual

_BAND = 2.0  # half width of the drawn bands [sigma]
_MODEL_POINTS = 800
_WINDOW_POINTS = 60
_ENERGY_PIECES = 50
_MAX_ALTERNATIVES = 3


@dataclass(frozen=True)
class Curve:
    """A curve: time [s], value, and standard uncertainty (zero without one)."""

    time: Array
    value: Array
    sigma: Array


@dataclass(frozen=True)
class Energy:
    """Relative drift of kinetic plus dissipated energy: running mean and largest absolute value."""

    mean: Curve
    drift: float


@dataclass(frozen=True)
class AddedTorque:
    """Torque of a model minus torque of the base model on each body [N m], along the motion of the model."""

    name: str
    time: Array
    omega_c: Array  # speed of the main body
    torques: dict[str, Array]

    def on(self, body: str) -> Array:
        """Return the torque on one body."""
        return self.torques[body]


@dataclass(frozen=True)
class CaseModel:
    """One case with one model; each body has one or several runs: windows, and a single run of the main body."""

    speeds: dict[
        str, tuple[Curve, ...]
    ]  # modelled [rad/s], with the standard uncertainty due to the parameters
    residuals: dict[str, tuple[Residual, ...]]  # measured minus modelled speed
    torques: dict[str, ResidualTorque]  # unmodelled torque on each body


@dataclass(frozen=True)
class CaseView:
    """One case with the first and the last model of a history of fits.

    The key of a body is its role, "casing" (also for a single body) or "rotor"; in a chain, the key is the name.
    """

    label: str
    surface: str
    quantity: str
    bodies: dict[str, str]  # names of the bodies by their keys, the main body first
    torque_unit: str  # "N m", or "rad/s²" for torques per unit of inertia
    speeds: dict[str, tuple[Curve, ...]]  # measured, smoothed by a running median [rad/s]
    smoothing_width: int  # number of points of the running median
    models: tuple[CaseModel, ...]  # the base model and, if it differs, the final model
    added: AddedTorque | None  # torque of the final model minus torque of the base model
    alternatives: tuple[AddedTorque, ...]  # torques of the best other candidate effects, each after a refit
    energy: tuple[Energy, ...]  # energy balance of each step
    failures: tuple[Failure, ...]  # intervals with significant lack of fit of the base model
    # for an oscillation: measured angle from the equilibrium [rad], period [s]
    deflection: Curve | None = None
    period: float = 0.0

    @property
    def main(self) -> str:
        """Key of the main body: the casing, a single body, or the first body of a chain."""
        return next(iter(self.bodies))

    @property
    def body(self) -> str:
        """Name of the main body: "casing", or "body" for a single body without a name."""
        return self.bodies[self.main]

    @property
    def intervals(self) -> tuple[Interval, ...]:
        """Intervals with lack of fit of the base model, for the charts."""
        return self.failing(self.failures, self.models[0])

    def failing(self, failures: Sequence[Failure], model: CaseModel) -> tuple[Interval, ...]:
        """Return the intervals with lack of fit of one of `models`, for the charts.

        The intervals have a significant unmodelled torque, or a residual of the speed outside of its band, because an
        unmodelled torque also changes the speed at later times.
        """
        found = []
        for f in failures:
            text = f"{'–'.join(f.times)} s, {f.called}, {f.size_sigma:.0f} σ"
            found.append(Interval(f.t_start, f.t_stop, text, f.body))
        found += self._outside_of_bands(model, found)
        return tuple(found)

    @property
    def speed_intervals(self) -> tuple[Interval, ...]:
        """Intervals with a residual of the speed outside of its band, but without an unmodelled torque."""
        return self.intervals[len(self.failures) :]

    def _outside_of_bands(self, model: CaseModel, covering: Sequence[Interval]) -> list[Interval]:
        """Return the intervals in which a residual speed is outside of its band, except the `covering` intervals."""
        noise, found = self.models[-1], []
        runs = [
            (key, *both)
            for key in self.bodies
            for both in zip(model.residuals[key], noise.residuals[key], strict=True)
        ]
        for key, residual, band in runs:
            covered = [(i.start, i.stop) for i in covering if i.body == key]
            found += [
                Interval(a, b, f"{a:.1f}–{b:.1f} s, speed of the {self.bodies[key]}, {size:.0f} σ", key)
                for a, b, size in _outside(residual, band.sigma, covered, self.period)
            ]
        return found


def _outside(
    residual: Residual, sigma: Array, covered: Sequence[tuple[float, float]], period: float
) -> list[tuple[float, float, float]]:
    """Return the intervals in which a residual is outside of its band on one side: start, stop and largest |z|.

    For an oscillation, an interval continues if the residual changes sides within half a `period`.
    """
    ratio = residual.value / np.where(sigma > 0, sigma, np.inf)
    side = np.where(np.abs(ratio) > _BAND, np.sign(ratio), 0.0)
    if period > 0:
        side = np.abs(side)
        for i, j in pairwise(np.flatnonzero(side)):
            if residual.time[j] - residual.time[i] <= 0.5 * period:
                side[i:j] = 1.0
    uncovered = np.ones(len(ratio), dtype=bool)
    for a, b in covered:
        uncovered &= (residual.time < a) | (residual.time > b)
    parts = []
    for first, last in pairwise([0, *(np.flatnonzero(np.diff(side)) + 1), len(side)]):
        if not side[first] or np.abs(ratio[first:last]).max() < DEFAULT.failure_sigma:
            continue
        places = first + np.flatnonzero(uncovered[first:last])
        for run in np.split(places, np.flatnonzero(np.diff(places) > 1) + 1):
            if len(run):
                start = residual.time[run[0]] - 0.5 * residual.width[run[0]]
                stop = residual.time[run[-1]] + 0.5 * residual.width[run[-1]]
                parts.append((float(start), float(stop), float(np.abs(ratio[run]).max())))
    return parts


def case_view(
    history: Sequence[FitStep],
    diagnosis: Diagnosis | None,
    torques: Sequence[tuple[ResidualTorque, ...]],
    index: int,
) -> CaseView:
    """Return one case with the first and the last model of a history; `torques` are their unmodelled torques."""
    from fitting.inference._record import median_width, speeds

    base, final = history[0].fit, history[-1].fit
    record, width = base.problem.data[index].record, base.problem.data[index].smoothing_width
    fits = [base, final] if len(history) > 1 else [base]
    motion = base.problem.data[index].motion
    return CaseView(
        label=record.label,
        surface=record.surface,
        quantity=record.quantity,
        bodies={b.part: b.name for b in record.bodies},
        torque_unit=unit_text(record.torque_unit),
        speeds={
            b.part: tuple(_measured(*speeds(run, record.quantity, width)) for run in b.series)
            for b in record.bodies
        },
        smoothing_width=median_width(len(record.casing), width),
        models=tuple(_case_model(f, t, index) for f, t in zip(fits, torques, strict=True)),
        added=added_torque("final model", base, final, index) if len(fits) > 1 else None,
        alternatives=_alternatives(base, final, diagnosis, index),
        energy=tuple(_energy(r.fit, index) for r in history),
        failures=tuple(f for f in (diagnosis.failures if diagnosis else ()) if f.label == record.label),
        deflection=_measured(motion.time, motion.deflection) if len(motion.reversals) else None,
        period=motion.period if len(motion.reversals) else 0.0,
    )


def _measured(time: Array, omega: Array) -> Curve:
    return Curve(time, omega, np.zeros_like(omega))


def _case_model(fit: Fit, torques: Sequence[ResidualTorque], index: int) -> CaseModel:
    record = fit.problem.data[index].record

    def curve(body: Body, run: Samples) -> Curve:
        points = _MODEL_POINTS if body.state == MAIN or record.is_chain else _WINDOW_POINTS
        time = np.linspace(run.time[0], run.time[-1], points)
        return Curve(time, *modelled_speed(fit, index, body.state, time))

    main, others = speed_residuals(fit, index)
    pairs = [*zip(others, record.rotor, strict=True)]
    of = {b.state: tuple(r for r, run in pairs if run.state == b.state) for b in record.bodies}
    return CaseModel(
        {b.part: tuple(curve(b, run) for run in b.series) for b in record.bodies},
        {b.part: (main,) if b.state == MAIN else of[b.state] for b in record.bodies},
        {t.body: t for t in torques if t.label == record.label},
    )


def _alternatives(base: Fit, final: Fit, diagnosis: Diagnosis | None, index: int) -> tuple[AddedTorque, ...]:
    """Return the torques of the best refitted candidates that are not in the final model.

    The result is empty if the recordings differ in a parameter.
    """
    found = [
        added_torque(base.name(c.effect).words, base, c.fit, index)
        for c in (diagnosis.candidates if diagnosis is not None and diagnosis.differs is None else ())
        if c.fit is not None
        and c.physical
        and c.significant
        and not c.effect.depends_on_angle
        and c.effect.name not in final.model.names
    ]
    return tuple(s for s in found if s is not None)[:_MAX_ALTERNATIVES]


def added_torque(name: str, base: Fit, other: Fit, index: int) -> AddedTorque | None:
    """Return the torque of another model minus the torque of the base, along the other motion; None if equal."""
    from fitting.dynamics._collocation import Sampler

    old, new = base.problem.cases[index], other.problem.cases[index]
    path = other.predictions[index].path
    if set(other.model.smooth.names) <= set(base.model.smooth.names):
        return None
    if not set(old.dynamics.states) <= set(path.states):
        return None
    time = np.linspace(path.mesh.edges[0], path.mesh.edges[-1], _MODEL_POINTS)
    state = Sampler(path.mesh, time).value(path.y)
    mechanism, inertia = new.data.record.mechanism, np.array(new.data.record.inertias)
    count = len(inertia)
    after = new.dynamics.rates(time, state, other.problem.layout.numbers(other.theta, index))[:, :count]
    shared = state[:, [path.states.index(s) for s in old.dynamics.states]]
    before = old.dynamics.rates(time, shared, base.problem.layout.numbers(base.theta, index))[:, :count]
    torque = (after - before) * inertia
    torques = {body: torque[:, i].copy() for i, body in enumerate(mechanism.bodies)}
    return AddedTorque(name, time, state[:, MAIN].copy(), torques)


def _energy(fit: Fit, index: int) -> Energy:
    from scipy.ndimage import uniform_filter1d

    from fitting.inference._metrics import energy_balance

    balance = energy_balance(fit.problem.cases[index], fit.theta, fit.predictions[index].path)
    drift = balance.change
    mean = uniform_filter1d(drift, max(1, len(drift) // _ENERGY_PIECES), mode="nearest")
    return Energy(_measured(balance.time, mean), balance.drift)


@dataclass(frozen=True)
class Step:
    """One step of the history: change and figures of merit."""

    change: str
    words: str
    rmse: float
    misfit: float
    held_out: float
    delta_bic: float
    energy_drift: float
    torque_left: float
    torque_pure: float
    verdict: str


@dataclass(frozen=True)
class StudyView:
    """Data of a study for the report; `rmse_floor` is the noise limit of the rms error of the casing [rad/s]."""

    steps: tuple[Step, ...]
    rmse_floor: float
    base: Fit
    final: Fit
    added: tuple[str, ...]
    verdict: str
    sentence: str
    candidates: tuple[Candidate, ...]
    differs: DifferentParameter | None
    next_experiment: str
    whiteness: tuple[tuple[str, float], ...]
    upper_limits: tuple[UpperLimit, ...]
    cases: tuple[CaseView, ...]

    @property
    def body(self) -> str:
        """Name of the main body: "casing", or "body" for a single body without a name."""
        return self.cases[0].body

    @property
    def bodies(self) -> list[str]:
        """Names of the bodies, the main one last."""
        return [*reversed(self.cases[0].bodies.values())]

    @property
    def torque_unit(self) -> str:
        """Unit of torques: "N m", or "rad/s²" per unit of inertia."""
        return unit_text(self.final.torque_unit)

    @property
    def misfit(self) -> tuple[float, ...]:
        """The `misfit` of the base model and, if it differs, of the final model."""
        return tuple(f.misfit for f in (self.base, self.final)[: len(self.cases[0].models)])

    def name(self, effect: Effect | str) -> EffectName:
        """Return the readable name of an effect or a parameter."""
        return self.final.name(effect)

    @property
    def improved(self) -> bool:
        """Whether the final model differs from the base model."""
        return len(self.steps) > 1


def gather(history: Sequence[FitStep], diagnosis: Diagnosis | None) -> StudyView:
    """Compute the data of a study from its history of fits, base first, and the diagnosis of the base."""
    from fitting.discovery._residuals import whiteness
    from fitting.study._serialisation import history_verdict

    base, final = history[0].fit, history[-1].fit
    fits = (base, final) if len(history) > 1 else (base,)
    torques = tuple(_torques(f, diagnosis) for f in fits)
    candidates = diagnosis.candidates if diagnosis is not None else history[0].candidates
    alone = len(history) == 1 and diagnosis is not None
    return StudyView(
        steps=_steps(history),
        rmse_floor=final.rmse_noise,
        base=base,
        final=final,
        added=tuple(n for n in final.model.names if n not in base.model.names),
        verdict=diagnosis.verdict if alone and diagnosis is not None else history_verdict(history),
        sentence=diagnosis.sentence if diagnosis is not None else "",
        candidates=tuple(c for c in candidates if c.score > 0),
        differs=diagnosis.differs if diagnosis is not None else None,
        next_experiment=diagnosis.next_experiment if diagnosis is not None else "",
        whiteness=tuple((w.label, w.p_value) for w in whiteness(final)),
        upper_limits=_upper_limits(history[-1], diagnosis if len(history) == 1 else None),
        cases=tuple(case_view(history, diagnosis, torques, i) for i in range(len(base.problem.data))),
    )


def _upper_limits(last: FitStep, diagnosis: Diagnosis | None) -> tuple[UpperLimit, ...]:
    """Return the limits from the diagnosis of the final model, or compute them."""
    from fitting.discovery._power import largest_hidden

    if diagnosis is not None:
        return diagnosis.upper_limits
    final = last.fit
    if not final.converged or final.has_lack_of_fit():
        return ()
    return largest_hidden(final, (), DEFAULT, last.candidates).limits


def _steps(history: Sequence[FitStep]) -> tuple[Step, ...]:
    from fitting.study._serialisation import step_document

    steps = []
    for i, step in enumerate(history):
        d = step_document(step.fit, "", step.change, history[i - 1].fit if i else None)
        merits = {k: d[k] for k in ("misfit", "held_out", "delta_bic", "energy_drift", "verdict")}
        change, pure = step.change or "base model", max(n.pure for n in step.fit.noise)
        words = d["words"] or change
        torques: dict[str, Any] = {"torque_left": step.fit.torque_noise, "torque_pure": pure}
        steps.append(Step(change=change, words=words, rmse=d["rmse_casing"], **torques, **merits))
    return tuple(steps)


def _torques(fit: Fit, diagnosis: Diagnosis | None) -> tuple[ResidualTorque, ...]:
    from fitting.discovery._residuals import residual_torques

    if diagnosis is not None and diagnosis.fit is fit:
        return diagnosis.torques
    return tuple(residual_torques(fit))
