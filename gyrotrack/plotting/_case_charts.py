"""The charts of one case: speeds, residuals, unmodelled torque, energy balance, tracking quality."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fitting._numbers import scaled, short, unit_text
from gyrotrack.plotting._charts import (
    AFTER,
    BEFORE,
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    WIDTH,
    Chart,
    Dashboard,
    Picture,
    Trace,
    canvas,
    concatenated,
    draw,
    markup,
    style,
)
from gyrotrack.plotting._study_data import CaseView, Curve, Residual
from gyrotrack.plotting._tracking import Tracks, centre_finding, sigma_finding

if TYPE_CHECKING:
    from fitting.inference._angle_harmonics import AngleHarmonics

Array = NDArray[np.float64]

NAMES = ("base model", "final model")
_MEASURED, _NOISE, _INK = "#a9abb1", "#8c8e94", "#000000"
_MODEL_STYLES: tuple[tuple[str, tuple[float, ...]], ...] = ((BEFORE, ()), (AFTER, (6.0, 3.0)))
_ALTERNATIVES = (GREEN, PURPLE, ORANGE)
_STEPS = (GREEN, PURPLE, SKY, "#555555")
_CLIPS = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY)
_POWERS = {"": "1", "m": "10⁻³", "µ": "10⁻⁶", "n": "10⁻⁹", "p": "10⁻¹²"}
_RPM = 60 / (2 * np.pi)
# largest standard uncertainty of a drawn torque, as a multiple of the smallest standard uncertainty of the curve
_UNDETERMINED = 3.0
# number of intervals of the deflection in which the unmodelled torque is averaged; smallest number of points in each
_INTERVALS, _FEWEST = 24, 4
# if a residual exceeds _LARGE [σ], the scale is linear up to _LINEAR [σ] and logarithmic beyond
_LARGE, _LINEAR = 20.0, 3.0


def case_dashboard(
    view: CaseView, tracks: Tracks | None, steps: Sequence[str], *, names: Sequence[str] = NAMES
) -> Dashboard:
    """Return all charts of one case; `steps` names the steps of the history, `names` the first and the last model."""
    main, *others = view.bodies
    charts = [speed_chart(view, main, names), residual_chart(view, main, names)]
    charts.append(torque_law_chart(view, names))
    charts += [torque_chart(view, b, names) for b in view.bodies]
    for body in others:
        charts += [speed_chart(view, body, names), residual_chart(view, body, names)]
    charts += [normalised_chart(view, names), energy_chart(view, steps)]
    if tracks is not None:
        charts += tracking_charts(tracks)
    # charts that show all bodies shade the intervals of the main body
    return Dashboard(view.label, tuple(replace(c, body=c.body or main) for c in charts), view.intervals)


def speed_chart(view: CaseView, body: str, names: Sequence[str] = NAMES) -> Chart:
    """Return the chart of measured and modelled speed of a body."""
    measured = view.speeds[body]
    points = [(c.time, c.value, None) for c in measured]
    traces = [concatenated("measured", points, _MEASURED, width=3.0, scale="reference")]
    for m, label, (colour, dash) in zip(view.models, names, _MODEL_STYLES, strict=False):
        parts = [(c.time, c.value, c.sigma) for c in m.speeds[body]]
        traces.append(concatenated(label, parts, colour, width=1.5, dash=dash))
    largest = max(float(np.abs(c.value).max()) for c in measured)
    known = [float(c.sigma.max()) for m in view.models for c in m.speeds[body]]
    caption = (
        f"Angular velocity, median over {view.smoothing_width} points; bands: ±2 σ due to the parameters"
    )
    caption += f" (at most {short(2 * max(known), 2)} rad/s)." if body == view.main else "."
    finding = (
        f"The speed of the {view.bodies[body]} reaches {short(largest)} rad/s ({short(largest * _RPM)} rpm)."
    )
    return Chart(
        "speed" if body == view.main else body,
        f"Speed of the {view.bodies[body]}",
        "rad/s",
        tuple(traces),
        finding,
        caption=caption,
        body=body,
    )


def residual_chart(view: CaseView, body: str, names: Sequence[str] = NAMES) -> Chart:
    """Return the chart of measured minus modelled speed of a body for each model, with the noise band."""
    groups = [m.residuals[body] for m in view.models]
    factor, prefix = scaled(max(float(np.abs(r.value).max()) for g in groups for r in g))
    band = [(r.time, 0.0 * r.value, factor * r.sigma) for r in groups[-1]]
    traces = [concatenated("±2 σ of noise", band, _NOISE, kind="band")]
    for g, label, (colour, _) in zip(groups, names, _MODEL_STYLES, strict=False):
        parts = [(r.time, factor * r.value, None) for r in g]
        traces.append(concatenated(label, parts, colour, kind="points", width=1.2))
    called = view.bodies[body]
    width = float(np.median(groups[0][0].width))
    return Chart(
        f"residual-{body}",
        f"Residual, {called}",
        f"{prefix}rad/s",
        tuple(traces),
        residual_finding(groups, called),
        caption=f"Measured minus modelled angular velocity of the {called}, mean over {short(width, 2)} s. "
        "Grey band: ±2 σ of noise, the same for all models.",
        body=body,
    )


def difference_chart(view: CaseView, names: Sequence[str] = NAMES) -> list[Chart]:
    """Return the chart of the difference of the main body's speed between last and first model; empty for one model."""
    if len(view.models) < 2:
        return []
    (first,), (last,) = (view.models[i].speeds[view.main] for i in (0, -1))
    difference = last.value - np.interp(last.time, first.time, first.value)
    largest = float(np.abs(difference).max())
    factor, prefix = scaled(largest)
    title = f"{names[1]} minus {names[0]}"
    return [
        Chart(
            "difference",
            f"Modelled speed of the {view.body}, {title}",
            f"{prefix}rad/s",
            (Trace(title, last.time, factor * difference, _MODEL_STYLES[-1][0]),),
            f"The modelled speeds of the {view.body} differ by at most {short(largest)} rad/s.",
        )
    ]


def residual_finding(groups: Sequence[Sequence[Residual]], called: str) -> str:
    """Return the size of the residuals of the first and last model, as a sentence."""
    largest = [max(float(np.abs(r.value).max()) for r in g) for g in groups]
    text = f"Residual of the {called} with the base model: up to {short(largest[0])} rad/s"
    if len(groups) > 1:
        text += f"; with the final model: up to {short(largest[-1])} rad/s"
    return text + "."


def normalised_chart(view: CaseView, names: Sequence[str] = NAMES) -> Chart:
    """Return the chart of the residuals of all models in units of the noise of the last model."""
    (last,) = view.models[-1].residuals[view.main]
    noise = last.sigma
    known = noise > 0
    scale = np.where(known, noise, 1.0)
    time = last.time
    nothing = np.where(known, 0.0, np.nan)
    traces = [Trace("±2 σ of noise", time, nothing, _NOISE, np.where(known, 1.0, np.nan), "band")]
    for m, label, (colour, _) in zip(view.models, names, _MODEL_STYLES, strict=False):
        z = np.where(known, m.residuals[view.main][0].value / scale, np.nan)
        traces.append(Trace(label, time, z, colour, kind="points", width=1.2))
    largest = max(float(np.nanmax(np.abs(t.value), initial=0.0)) for t in traces)
    return Chart(
        "normalised",
        f"Residual, {view.body}",
        "σ",
        tuple(traces),
        residual_finding([m.residuals[view.main] for m in view.models], view.body),
        caption=f"Measured minus modelled angular velocity of the {view.body}, divided by the standard uncertainty due "
        "to noise, the same for all models. Grey band: ±2 σ.",
        linear_within=_LINEAR if largest > _LARGE else 0.0,
    )


def _torque_scale(view: CaseView, body: str) -> tuple[float, str]:
    return scaled(max(float(np.abs(m.torques[body].torque).max()) for m in view.models))


def _determined(torque: Array, sigma: Array) -> tuple[Array, Array]:
    """Return torque and standard uncertainty, NaN where the data do not determine the torque."""
    known = sigma <= _UNDETERMINED * sigma.min()
    return np.where(known, torque, np.nan), np.where(known, sigma, np.nan)


def torque_chart(view: CaseView, body: str, names: Sequence[str] = NAMES) -> Chart:
    """Return the chart of the unmodelled torque on a body against time, with the torques of candidate effects."""
    factor, prefix = _torque_scale(view, body)
    traces = []
    for m, label, (colour, _) in zip(view.models, names, _MODEL_STYLES, strict=False):
        torque, sigma = _determined(m.torques[body].torque, m.torques[body].sigma)
        traces.append(Trace(label, m.torques[body].time, factor * torque, colour, factor * sigma))
    if view.added is not None and view.added.on(body).any():
        a = view.added
        law = factor * a.on(body)
        traces.append(Trace("difference", a.time, law, _INK, dash=(2.0, 2.0), scale="none"))
    for a, colour in zip(view.alternatives, _ALTERNATIVES, strict=False):
        if a.on(body).any():
            law = factor * a.on(body)
            traces.append(Trace(a.name, a.time, law, colour, width=1.2, dash=(6.0, 2.0), scale="none"))
    called = view.bodies[body]
    return Chart(
        f"torque-{body}",
        f"Unmodelled torque, {called}",
        f"{prefix}{view.torque_unit}",
        tuple(traces),
        _torque_finding(view, body),
        caption="Unmodelled torque, inferred from the residual without assuming a law; bands: ±2 σ. Dotted "
        "(difference): torque of the final model minus that of the base model; dashed: the same for other candidates "
        "after a refit.",
        body=body,
    )


def torque_speed_chart(view: CaseView, names: Sequence[str] = NAMES, *, alternatives: bool = True) -> Chart:
    """Return the chart of the unmodelled torque on the casing against its speed, with the added torque."""
    factor, prefix = _torque_scale(view, view.main)
    traces: list[Trace] = []
    for m, label, (colour, _) in zip(view.models, names, _MODEL_STYLES, strict=False):
        curve = m.torques[view.main]
        torque, sigma = _determined(curve.torque, curve.sigma)
        branches = _branches(curve.omega_c)
        for k, part in enumerate(branches):
            rising = k == 0 and len(branches) > 1
            name, dash = (f"{label}, accelerating", (4.0, 2.0)) if rising else (label, ())
            band = factor * torque[part], colour, factor * sigma[part]
            traces.append(Trace(name, curve.omega_c[part], *band, dash=dash))
    laws = [("difference", view.added, _INK, 1.8)] if view.added is not None else []
    for a, colour in zip(view.alternatives if alternatives else (), _ALTERNATIVES, strict=False):
        laws.append((a.name, a, colour, 1.2))
    for name, a, colour, width in laws:
        law = factor * a.on(view.main)
        branches = _branches(a.omega_c) if law.any() else []
        for k, part in enumerate(branches):
            label = f"{name}, accelerating" if k == 0 and len(branches) > 1 else name
            options: dict[str, Any] = {"dash": (2.0, 2.0) if k == 0 else (1.0, 1.0), "scale": "none"}
            traces.append(Trace(label, a.omega_c[part], law[part], colour, width=width, **options))
    return Chart(
        "torque-speed",
        f"Unmodelled torque, {view.body}",
        f"{prefix}{view.torque_unit}",
        tuple(traces),
        _torque_finding(view, view.main),
        x_label=f"speed of the {view.body} [rad/s]",
        caption="Unmodelled torque against speed, inferred from the residual without assuming a law; bands: ±2 σ. "
        f"Dashed: acceleration of the {view.body}. For friction that depends on speed only, both curves coincide. "
        "Dotted: the difference, final minus base model, after a refit of the other parameters.",
    )


def torque_law_chart(view: CaseView, names: Sequence[str] = NAMES, *, alternatives: bool = True) -> Chart:
    """Return the chart of the unmodelled torque against the deflection for an oscillation, else against the speed."""
    if view.deflection is None:
        return torque_speed_chart(view, names, alternatives=alternatives)
    return _torque_deflection_chart(view, view.deflection, names)


def _torque_deflection_chart(view: CaseView, deflection: Curve, names: Sequence[str]) -> Chart:
    """Return the chart of the unmodelled torque on an oscillating body against its angle from the equilibrium."""
    factor, prefix = _torque_scale(view, view.main)
    traces = []
    for m, label, (colour, _) in zip(view.models, names, _MODEL_STYLES, strict=False):
        curve = m.torques[view.main]
        torque, _ = _determined(curve.torque, curve.sigma)
        angle = np.interp(curve.time, deflection.time, deflection.value)
        for sense, name, dash in ((1, f"{label}, increasing", ()), (-1, f"{label}, decreasing", (4.0, 2.0))):
            known = np.isfinite(torque) & (np.sign(curve.omega_c) == sense)
            x, mean, error = _means(angle[known], factor * torque[known])
            traces.append(Trace(name, x, mean, colour, error, dash=dash))
    return Chart(
        "torque-deflection",
        f"Unmodelled torque, {view.body}",
        f"{prefix}{view.torque_unit}",
        tuple(traces),
        _torque_finding(view, view.main),
        x_label=f"deflection of the {view.body} [rad]",
        caption="Unmodelled torque against the angle from the equilibrium, inferred from the residual without assuming "
        "a law, for increasing and decreasing angle: means, with bands of ±2 standard errors. For a restoring law both "
        "curves coincide; friction separates them.",
    )


def _means(x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Return the means of x and y, and the standard error of the mean of y, in equal intervals with enough points."""
    if not len(x):
        return (np.zeros(0),) * 3
    place = np.digitize(x, np.linspace(x.min(), x.max(), _INTERVALS + 1)[1:-1])
    parts = [np.flatnonzero(place == k) for k in range(_INTERVALS)]
    parts = [p for p in parts if len(p) >= _FEWEST]
    error = [float(y[p].std(ddof=1)) / np.sqrt(len(p)) for p in parts]
    return np.array([x[p].mean() for p in parts]), np.array([y[p].mean() for p in parts]), np.array(error)


def torque_angle_charts(
    harmonics: Sequence[Sequence[AngleHarmonics]], names: Sequence[str], body: str, unit: str
) -> list[Chart]:
    """Return the chart of the harmonics (in the angle) of the unmodelled torque, for the first case of each fit."""
    curves = [(name, r[0]) for name, r in zip(names, harmonics, strict=False) if r]
    if not curves:
        return []
    factor, prefix = scaled(max(float(np.abs(r.torque).max()) for _, r in curves))
    traces = [
        Trace(name, r.angle, factor * r.torque, colour, factor * r.sigma)
        for (name, r), (colour, _) in zip(curves, _MODEL_STYLES, strict=False)
    ]
    sizes = ", ".join(f"{n}: {r.size(1)[1]:.1f} and {r.size(2)[1]:.1f} σ" for n, r in curves)
    return [
        Chart(
            "torque-angle",
            "Unmodelled torque against the angle",
            f"{prefix}{unit_text(unit)}",
            tuple(traces),
            f"First and second harmonic of the unmodelled torque in the angle of the {body}, {sizes}.",
            x_label=f"angle of the {body} [rad]",
        )
    ]


def _branches(speed: Array) -> list[NDArray[np.intp]]:
    """Return the indices before and after the peak of the speed, each in order of speed; one list for a short part."""
    peak = int(np.argmax(np.abs(speed)))
    parts = [np.arange(peak + 1), np.arange(peak, len(speed))]
    if min(map(len, parts)) < 3:
        parts = [max(parts, key=len)]
    found = []
    for part in parts:
        _, first = np.unique(speed[part], return_index=True)
        found.append(part[first])
    return found


def _torque_finding(view: CaseView, body: str) -> str:
    parts = []
    for m, label in zip(view.models, NAMES, strict=False):
        curve = m.torques[body]
        if not curve.torque.any():
            parts.append(f"No unmodelled torque is resolved with the {label}.")
            continue
        outside = float(np.mean(np.abs(curve.torque) > 2 * curve.sigma))
        largest = int(np.argmax(np.abs(curve.torque)))
        factor, prefix = scaled(abs(float(curve.torque[largest])))
        parts.append(
            f"Unmodelled torque on the {view.bodies[body]} with the {label}: up to "
            f"{short(factor * abs(float(curve.torque[largest])))} {prefix}{view.torque_unit}, outside ±2 σ "
            f"for {100 * outside:.0f} % of the time."
        )
    return " ".join(parts)


def energy_chart(view: CaseView, steps: Sequence[str]) -> Chart:
    """Return the chart of the relative drift of the energy balance for each step of the history."""
    colours = [BEFORE, *[_STEPS[i % len(_STEPS)] for i in range(len(view.energy) - 2)], AFTER]
    factor, prefix = scaled(max(e.drift for e in view.energy))
    traces = [
        Trace(step, e.mean.time, factor * e.mean.value, colour)
        for e, step, colour in zip(view.energy, steps, colours, strict=False)
    ]
    drifts = [short(e.drift) for e in view.energy]
    finding = (
        f"Largest relative drift of the energy balance: {' → '.join(dict.fromkeys([drifts[0], drifts[-1]]))}."
    )
    return Chart(
        "energy",
        "Energy balance, drift",
        _POWERS[prefix],
        tuple(traces),
        finding,
        caption="Kinetic energy plus dissipated energy, relative to its initial value, running mean; constant "
        f"for a complete model. Computed with the measured speed of the {view.body}.",
    )


def tracking_charts(tracks: Tracks) -> list[Chart]:
    """Return the charts of the standard uncertainty of the angles and of the motion of the centre in the image."""
    sigma: list[Trace] = []
    for body in sorted({s.body for s in tracks.sigmas}):
        curves = [(s.clip, s.time, 1e3 * s.value) for s in tracks.sigmas if s.body == body]
        sigma += _combined_traces(body, curves, len(sigma))
    centre: list[Trace] = []
    for axis in (0, 1):
        curves = [(c.clip, c.time, c.place[:, axis]) for c in tracks.centres]
        centre += _combined_traces("xy"[axis], curves, len(centre))
    caption = "Estimated from the consistency and the sharpness of the markers."
    title, finding = "Uncertainty of the angles", sigma_finding(tracks.sigmas)
    charts = [Chart("sigma", title, "mrad", tuple(sigma), finding, caption=caption)] if sigma else []
    caption = "Centre in the image, relative to its median; tracking corrects the angles for this motion."
    title, finding = "Motion of the centre", centre_finding(tracks.centres)
    return [*charts, Chart("centre", title, "px", tuple(centre), finding, caption=caption)]


def _combined_traces(prefix: str, curves: Sequence[tuple[str, Array, Array]], used: int) -> list[Trace]:
    """Combine curves (clip, time, value) that do not overlap in time into common traces."""
    lanes: list[tuple[str, list[tuple[Array, Array, None]]]] = []
    for name, time, value in sorted(curves, key=lambda c: float(c[1][0])):
        free = next((lane for _, lane in lanes if lane[-1][0][-1] < time[0]), None)
        if free is None:
            lanes.append((name, free := []))
        free.append((time, value, None))
    traces = []
    for i, (name, lane) in enumerate(lanes, used):
        label = f"{prefix}, {name} …" if len(lane) > 1 else f"{prefix}, {name}"
        traces.append(concatenated(label, lane, _CLIPS[i % len(_CLIPS)], width=1.0))
    return traces


_MAX_WINDOWS = 8
_MAX_COLUMNS = 4


def windows_picture(view: CaseView, name: str) -> Picture:
    """Draw speed and residual of the rotor in each window."""
    count = len(view.speeds["rotor"])
    shown = np.unique(np.linspace(0, count - 1, min(count, _MAX_WINDOWS)).round().astype(int))
    across = min(_MAX_COLUMNS, len(shown))
    down = -(-len(shown) // across)
    speed, residual = speed_chart(view, "rotor"), residual_chart(view, "rotor")
    intervals = [i for i in view.intervals if i.body == "rotor"]
    with style():
        figure = canvas(WIDTH, 3.6 * down)
        axes = figure.subplots(2 * down, across, squeeze=False, height_ratios=[1.15, 1] * down)
        for ax in axes.flat:
            ax.set_visible(False)
        for place, i in enumerate(shown):
            row, column = divmod(place, across)
            time, value = view.speeds["rotor"][i].time, view.speeds["rotor"][i].value
            room = 0.02 * (time[-1] - time[0])
            window = (float(time[0] - room), float(time[-1] + room))
            pair = axes[2 * row, column], axes[2 * row + 1, column]
            draw(pair[0], speed, intervals, window=window, limits=(float(value.min()), float(value.max())))
            draw(pair[1], residual, intervals, window=window)
            for ax in pair:
                ax.set_visible(True)
                ax.set_ylabel(
                    ax.get_ylabel().replace(" of the", "\nof the").replace(", ", ",\n")
                    if column == 0
                    else "",
                    fontsize=9,
                )
            pair[0].set_title(f"window {i + 1}", fontweight="normal")
            pair[0].set_xticklabels([])
            pair[0].set_xlabel("")
        handles, names = axes[0, 0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside upper right", ncols=3)
        more = f" {len(shown)} of {count} windows are shown." if len(shown) < count else ""
        return Picture(
            name, markup(figure, name, residual.finding), residual.caption + more, residual.finding
        )
