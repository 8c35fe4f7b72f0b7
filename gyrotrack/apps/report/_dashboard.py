"""The run of a case as interactive charts on one time axis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fitting._numbers import scaled
from fitting.inference._speed_residuals import SpeedResidual
from gyrotrack.plotting._interactive import Board, Chart, Mark, Trace
from gyrotrack.plotting._motion import misfit_finding, motion_finding, rotor_finding
from gyrotrack.plotting._parameters import energy_finding
from gyrotrack.plotting._study_data import CaseView, Curve
from gyrotrack.plotting._style import AFTER, BEFORE, GREEN, ORANGE, PURPLE, SKY
from gyrotrack.plotting._torque import known, torque_finding
from gyrotrack.plotting._tracking import COLOURS, Tracks, centre_finding, sigma_finding

if TYPE_CHECKING:
    from fitting.discovery._residuals import Failure


Array = NDArray[np.float64]

_GREY, _NOISE = "#a9abb1", "#8c8e94"
_LOOKS = ((BEFORE, ()), (AFTER, (6.0, 3.0)))
NAMES = ("base model", "final model")
_OTHERS = (GREEN, PURPLE, ORANGE)
_POWERS = {"": "1", "m": "10⁻³", "µ": "10⁻⁶", "n": "10⁻⁹", "p": "10⁻¹²"}
_BETWEEN = (GREEN, PURPLE, SKY, "#555555")


def case_board(
    view: CaseView, tracks: Tracks | None, steps: Sequence[str], *, names: Sequence[str] = NAMES
) -> Board:
    """Return the charts of one case.

    Parameters
    ----------
    view : CaseView
        The case.
    tracks : Tracks or None
        What tracking made of its clips.
    steps : sequence of str
        What each rung of the ladder is called.
    names : sequence of str
        What the first and the last model are called.
    """
    charts = [
        _speed(view, names),
        _misfit(view, "casing", names),
        _normalised(view, names),
        *((_rotor(view, names), _misfit(view, "rotor", names)) if view.rotor else ()),
        _torque(view, "casing", names),
        *((_torque(view, "rotor", names),) if view.rotor else ()),
        _energy(view, steps),
    ]
    if tracks is not None:
        charts += [_sigma(tracks), _centre(tracks)]
    return Board(view.label, tuple(charts), tuple(mark(f) for f in view.failures))


def mark(failure: Failure) -> Mark:
    """Return the mark of a failing stretch."""
    text = f"{failure.t_start:.1f}–{failure.t_stop:.1f} s, {failure.called}, {failure.size_sigma:.0f} σ"
    return Mark(failure.t_start, failure.t_stop, text)


def joined(curves: Sequence[Array], *, gap: float = np.nan) -> Array:
    """Return arrays one after the other with a gap between them."""
    parts = [np.concatenate([c, [gap if np.isnan(gap) else c[-1]]]) for c in curves if len(c)]
    return np.concatenate(parts) if parts else np.zeros(0)


def windows(
    label: str, curves: Sequence[Curve], colour: str, *, width: float, dash: tuple[float, ...]
) -> Trace:
    """Return one trace of curves with gaps between them."""
    time = joined([c.time for c in curves], gap=0.0)
    value, sigma = joined([c.value for c in curves]), joined([c.sigma for c in curves])
    return Trace(label, time, value, colour, sigma if np.nansum(sigma) > 0 else None, "line", width, dash)


def _speed(view: CaseView, names: Sequence[str]) -> Chart:
    traces = [Trace("measured", view.casing.time, view.casing.value, _GREY, width=3.0)]
    for m, label, (colour, dash) in zip(view.models, names, _LOOKS, strict=False):
        traces.append(Trace(label, m.casing.time, m.casing.value, colour, m.casing.sigma, dash=dash))
    return Chart("speed", f"Speed of the {view.body}", "rad/s", tuple(traces), motion_finding(view))


def _rotor(view: CaseView, names: Sequence[str]) -> Chart:
    traces = [windows("measured", view.rotor, _GREY, width=3.0, dash=())]
    for m, label, (colour, dash) in zip(view.models, names, _LOOKS, strict=False):
        traces.append(windows(label, m.rotor, colour, width=1.5, dash=dash))
    return Chart("rotor", "Speed of the rotor in its windows", "rad/s", tuple(traces), rotor_finding(view))


def misfit_traces(misfits: Sequence[SpeedResidual], factor: float, colour: str, label: str) -> list[Trace]:
    """Return a misfit as dots, and the band of the noise about zero."""
    time = joined([m.time for m in misfits], gap=0.0)
    value, sigma = (joined([factor * getattr(m, n) for m in misfits]) for n in ("value", "sigma"))
    band = Trace(
        "±2 σ of noise alone", time, np.where(np.isfinite(sigma), 0.0, np.nan), _NOISE, sigma, "band"
    )
    return [band, Trace(label, time, value, colour, kind="points", width=1.2)]


def _misfit(view: CaseView, body: str, names: Sequence[str]) -> Chart:
    groups = [(m.casing_misfit,) if body == "casing" else m.rotor_misfit for m in view.models]
    largest = max(float(np.abs(m.value).max()) for g in groups for m in g)
    factor, prefix = scaled(largest)
    traces: list[Trace] = []
    for g, label, (colour, _) in zip(groups, names, _LOOKS, strict=False):
        found = misfit_traces(g, factor, colour, label)
        traces = [found[0], *traces[1:], found[1]]
    finding = misfit_finding(view) if body == "casing" else rotor_finding(view)
    called = view.body if body == "casing" else body
    return Chart(
        f"misfit-{body}", f"Measured minus model, {called}", f"{prefix}rad/s", tuple(traces), finding
    )


def _normalised(view: CaseView, names: Sequence[str]) -> Chart:
    traces: list[Trace] = []
    for m, label, (colour, _) in zip(view.models, names, _LOOKS, strict=False):
        x = m.casing_misfit
        z = np.where(x.sigma > 0, x.value / np.where(x.sigma > 0, x.sigma, 1.0), np.nan)
        if not traces:
            ones = np.ones_like(z)
            traces.append(Trace("±2 σ", x.time, 0.0 * ones, _NOISE, ones, "band"))
        traces.append(Trace(label, x.time, z, colour, kind="points", width=1.2))
    return Chart(
        "normalised", f"Normalised residual, {view.body}", "σ of noise", tuple(traces), misfit_finding(view)
    )


def _torque(view: CaseView, body: str, names: Sequence[str]) -> Chart:
    largest = max(float(np.abs(m.torques[body].torque).max()) for m in view.models)
    factor, prefix = scaled(largest)
    traces = []
    for m, label, (colour, _) in zip(view.models, names, _LOOKS, strict=False):
        torque, sigma = known(m.torques[body])
        traces.append(Trace(label, m.torques[body].time, factor * torque, colour, factor * sigma))
    if view.supplied is not None and view.supplied.on(body).any():
        s = view.supplied
        name = f"{names[-1]} − {names[0]}"
        traces.append(Trace(name, s.time, factor * s.on(body), "#000000", dash=(2.0, 2.0), beside=True))
    for s, colour in zip(view.suggested, _OTHERS, strict=False):
        if s.on(body).any():
            torque = factor * s.on(body)
            traces.append(Trace(s.name, s.time, torque, colour, width=1.2, dash=(6.0, 2.0), beside=True))
    called = view.body if body == "casing" else body
    return Chart(
        f"torque-{body}",
        f"Missing torque on the {called}",
        f"{prefix}N m",
        tuple(traces),
        torque_finding(view),
    )


def _energy(view: CaseView, steps: Sequence[str]) -> Chart:
    colours = [BEFORE, *[_BETWEEN[i % len(_BETWEEN)] for i in range(len(view.energy) - 2)], AFTER]
    factor, prefix = scaled(max(e.drift for e in view.energy))
    traces = [
        Trace(step, e.mean.time, factor * e.mean.value, colour)
        for e, step, colour in zip(view.energy, steps, colours, strict=False)
    ]
    return Chart(
        "energy", "Energy balance, relative drift", _POWERS[prefix], tuple(traces), energy_finding(view)
    )


def _sigma(tracks: Tracks) -> Chart:
    traces: list[Trace] = []
    for body in sorted({s.body for s in tracks.sigmas}):
        curves = [
            (s.clip, Curve(s.time, 1e3 * s.value, np.zeros_like(s.value)))
            for s in tracks.sigmas
            if s.body == body
        ]
        for name, lane in _lanes(curves):
            colour = COLOURS[len(traces) % len(COLOURS)]
            traces.append(windows(f"{body}, {name}", lane, colour, width=1.0, dash=()))
    finding = sigma_finding(tracks.sigmas)
    return Chart("sigma", "Standard deviation of the angles", "mrad", tuple(traces), finding)


def _centre(tracks: Tracks) -> Chart:
    traces: list[Trace] = []
    for axis in (0, 1):
        curves = [(c.clip, Curve(c.time, c.place[:, axis], np.zeros(len(c.time)))) for c in tracks.centres]
        for name, lane in _lanes(curves):
            colour = COLOURS[len(traces) % len(COLOURS)]
            traces.append(windows(f"{'xy'[axis]}, {name}", lane, colour, width=1.0, dash=()))
    return Chart("centre", "Motion of the centre", "px", tuple(traces), centre_finding(tracks.centres))


def _lanes(curves: Sequence[tuple[str, Curve]]) -> list[tuple[str, list[Curve]]]:
    """Return curves that do not overlap in time together, in order, under the name of the first."""
    lanes: list[tuple[str, list[Curve]]] = []
    for name, curve in sorted(curves, key=lambda c: float(c[1].time[0])):
        free = next((lane for _, lane in lanes if lane[-1].time[-1] < curve.time[0]), None)
        if free is None:
            lanes.append((name, [curve]))
        else:
            free.append(curve)
    return [(name + (" …" if len(lane) > 1 else ""), lane) for name, lane in lanes]
