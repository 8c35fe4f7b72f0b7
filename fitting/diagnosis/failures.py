"""Where a fitted model fails: stretches in time and speed where the residual torque leaves its band, and ripples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fitting.diagnosis.ripple import Ripple
from fitting.diagnosis.torque import ResidualTorque
from fitting.estimation import Fit
from fitting.simulation import Sampler
from fitting.smoothing import speeds

Array = NDArray[np.float64]

_BAND = 1.96
_CLEAR = 4.0
# two amplitudes at once: noise alone is as large once in ten thousand, exp(-4.3**2 / 2)
_CLEAR_RIPPLE = 4.3
_TURNS = {1: "once a turn", 2: "twice a turn"}
_SHORTEST = 1 / 100
_MOST = 6


@dataclass(frozen=True)
class Failure:
    """A stretch where the model fails.

    Attributes
    ----------
    label, body : str
        Case and body.
    t_start, t_stop : float
        When [s].
    kind : str
        "loses torque" or "gains torque" against the model; "ripple" for a torque that follows the angle.
    where : str
        In words: in the rise, near the peak, in the tail; once or twice a turn.
    size_sigma : float
        Largest distance from zero in standard deviations.
    residual_rad_s : float
        Largest misfit of the speed in the stretch, with its sign; of a ripple, where the casing is slowest.
    residual_torque_Nm : float
        Mean torque that the model lacks; amplitude of a ripple.
    omega_c : tuple of float
        The casing's lowest and highest speed in the stretch [rad/s].
    called : str
        What people call the body: "body" in the casing's place where only one was recorded.
    """

    label: str
    body: str
    t_start: float
    t_stop: float
    kind: str
    where: str
    size_sigma: float
    residual_rad_s: float
    residual_torque_Nm: float  # noqa: N815 - the unit's own capitals
    omega_c: tuple[float, float]
    called: str

    def __str__(self) -> str:
        if self.kind == "ripple":
            return (
                f"{self.where} the {self.called} feels a torque of {self.residual_torque_Nm:.2g} N m that the model "
                f"does not have ({self.size_sigma:.0f} sigma)"
            )
        verb = "loses" if self.residual_torque_Nm < 0 else "gains"
        return (
            f"from {self.t_start:.1f} s to {self.t_stop:.1f} s, {self.where}, the {self.called} {verb} "
            f"{abs(self.residual_torque_Nm):.2g} N m more than the model says ({self.size_sigma:.0f} sigma)"
        )


def find_failures(fit: Fit, curves: Sequence[ResidualTorque], waves: Sequence[Ripple] = ()) -> list[Failure]:
    """Return the stretches in which a model fails, and what follows the angle, worst first.

    A ripple is told only where it is clearer than any stretch: a torque that lasts less than a turn cannot be told from
    one that follows the angle, and leaks into the turns in which the casing is slow. Stretches are to be mended first.

    Parameters
    ----------
    fit : Fit
        The fitted model.
    curves : sequence of ResidualTorque
        Its residual torques.
    waves : sequence of Ripple
        What it leaves against the angle.
    """
    found = [f for curve in curves for f in _stretches(fit, curve)]
    worst = {c.label: 0.0 for c in curves}
    for f in found:
        worst[f.label] = max(worst[f.label], f.size_sigma)
    found += [
        f
        for wave in waves
        for n in _TURNS
        for f in _ripple(fit, wave, n)
        if f.size_sigma > worst.get(f.label, 0.0)
    ]
    return sorted(found, key=lambda f: -f.size_sigma)[:_MOST]


def _ripple(fit: Fit, wave: Ripple, n: int) -> list[Failure]:
    amplitude, size = wave.size(n)
    if size < _CLEAR_RIPPLE:
        return []
    index = fit.labels.index(wave.label)
    record, path = fit.problem.data[index].record, fit.predictions[index].path
    t = record.casing.time
    speed = np.abs(Sampler(path.mesh, t).value(path.y[..., 1]))
    # the speed swings by torque / (inertia n omega), most where the casing is slowest but still turns
    slowest = max(float(speed.min()), float(np.sqrt(amplitude / record.I_casing)), 1e-3)
    swing = amplitude / (record.I_casing * n * slowest)
    span = float(t[0]), float(t[-1])
    return [
        Failure(
            wave.label, "casing", *span, "ripple", _TURNS[n], size, swing, amplitude,
            (float(speed.min()), float(speed.max())), record.body,
        )
    ]  # fmt: skip


def _stretches(fit: Fit, curve: ResidualTorque) -> list[Failure]:
    ratio = curve.torque / np.maximum(curve.sigma, 1e-300)
    outside = np.abs(ratio) > _BAND
    record = fit.problem.data[fit.labels.index(curve.label)].record
    called = record.body if curve.body == "casing" else curve.body
    change = np.flatnonzero(np.diff(np.sign(ratio) * outside) != 0) + 1
    edges = np.concatenate([[0], change, [len(ratio)]])
    span = curve.time[-1] - curve.time[0]
    failures = []
    for a, b in pairwise(edges):
        if not outside[a] or curve.time[b - 1] - curve.time[a] < _SHORTEST * span:
            continue
        size = float(np.abs(ratio[a:b]).max())
        if size < _CLEAR:
            continue
        mean = float(curve.torque[a:b].mean())
        failures.append(
            Failure(
                curve.label,
                curve.body,
                float(curve.time[a]),
                float(curve.time[b - 1]),
                "gains torque" if mean > 0 else "loses torque",
                _place(curve, a, b),
                size,
                _speed_misfit(fit, curve, a, b),
                mean,
                (float(curve.omega_c[a:b].min()), float(curve.omega_c[a:b].max())),
                called,
            )
        )
    return failures


def _place(curve: ResidualTorque, a: int, b: int) -> str:
    peak = int(np.argmax(np.abs(curve.omega_c)))
    top = 0.9 * abs(curve.omega_c[peak])
    if a == 0 and b == len(curve.time):
        return "all the time"
    if np.abs(curve.omega_c[a:b]).max() > top and a <= peak + (b - a) and b >= peak - (b - a):
        return "near the peak"
    return "in the rise" if b <= peak else "in the tail" if a >= peak else "around the peak"


def _speed_misfit(fit: Fit, curve: ResidualTorque, a: int, b: int) -> float:
    index = fit.labels.index(curve.label)
    record, path = fit.problem.data[index].record, fit.predictions[index].path
    runs, state = ((record.casing,), 1) if curve.body == "casing" else (record.rotor, 0)
    worst = 0.0
    for samples in runs:
        time, omega = speeds(samples, record.quantity)
        inside = (time >= curve.time[a]) & (time <= curve.time[b - 1])
        if inside.any():
            misfit = omega[inside] - Sampler(path.mesh, time[inside]).value(path.y[..., state])
            low, high = np.percentile(misfit, [5, 95])
            worst = max((worst, float(low), float(high)), key=abs)
    return worst
