"""Residual torque against time and speed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fitting._numbers import scaled, short
from gyrotrack.plotting._study_data import CaseView
from gyrotrack.plotting._style import (
    AFTER,
    BEFORE,
    GREEN,
    ORANGE,
    PURPLE,
    WIDTH,
    Picture,
    canvas,
    failing,
    look,
    panel,
    picture,
    plain,
    zero,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from fitting.discovery._residuals import ResidualTorque
    from gyrotrack.plotting._study_data import Supplied


Array = NDArray[np.float64]
# how many times the smallest standard deviation still counts as known
_TOLD = 3.0
_BODIES = ("casing", "rotor")
_OTHERS = (GREEN, PURPLE, ORANGE)


def torque_picture(view: CaseView, name: str) -> Picture:
    """Draw the missing torque on each body for the base and the final model."""
    largest = max(float(np.abs(t.torque).max()) for m in view.models for t in m.torques.values())
    factor, prefix = scaled(largest)
    bodies = [b for b in _BODIES if b in view.models[0].torques]  # a record of one body knows no rotor
    with look():
        figure = canvas(WIDTH, 2.9 * len(bodies))
        axes = figure.subplots(len(bodies), 2, sharey="row", sharex="col", squeeze=False)
        for row, body in enumerate(bodies):
            for seen, colour, label in zip(
                view.models, (BEFORE, AFTER), ("base model", "final model"), strict=False
            ):
                curve = seen.torques[body]
                _against_time(axes[row, 0], curve, factor, colour, label)
                _against_speed(axes[row, 1], curve, factor, colour)
            _law(axes[row], view, body, factor)
            failing(axes[row, 0], view, body)
            called = view.body if body == "casing" else body
            axes[row, 0].set_ylabel(f"torque on the {called} [{prefix}N m]", fontsize=10)
            panel(axes[row, 0], "ac"[row], f"{called}, against time")
            panel(axes[row, 1], "bd"[row], f"{called}, against the {view.body}'s speed")
            low, high = _limits(view, body, factor)
            axes[row, 0].set_ylim(low, high)
        axes[-1, 0].set_xlabel("time [s]")
        axes[-1, 1].set_xlabel(r"$\omega_c$ [rad/s]")
        handles, names = _entries(axes[:, 0])
        figure.legend(handles, names, loc="outside upper right", ncols=3)
        return picture(name, figure, _caption(view), torque_finding(view))


def _entries(axes: NDArray[np.object_]) -> tuple[list[Any], list[str]]:
    """Return each entry of the legends once."""
    found: dict[str, Any] = {}
    for ax in axes:
        handles, names = ax.get_legend_handles_labels()
        found |= {n: h for h, n in zip(handles, names, strict=True) if n not in found}
    return list(found.values()), list(found)


def _against_time(ax: Axes, curve: ResidualTorque, factor: float, colour: str, label: str) -> None:
    torque, sigma = known(curve)
    ax.fill_between(
        curve.time,
        factor * (torque - 2 * sigma),
        factor * (torque + 2 * sigma),
        color=colour,
        alpha=0.22,
        linewidth=0,
    )
    ax.plot(curve.time, factor * torque, color=colour, label=label)
    zero(ax)
    ax.margins(x=0.01)


def _against_speed(ax: Axes, curve: ResidualTorque, factor: float, colour: str) -> None:
    torque, sigma = known(curve)
    peak = int(np.argmax(np.abs(curve.omega_c)))
    for part, dashes in ((slice(0, peak + 1), (0, (2, 1.2))), (slice(peak, None), "-")):
        speed, middle, edge = curve.omega_c[part], factor * torque[part], 2 * factor * sigma[part]
        ax.fill_between(speed, middle - edge, middle + edge, color=colour, alpha=0.18, linewidth=0)
        ax.plot(speed, middle, color=colour, linestyle=dashes)
    zero(ax)


def known(curve: ResidualTorque) -> tuple[Array, Array]:
    """Return torque and standard deviation; nan where the data say little."""
    told = curve.sigma <= _TOLD * curve.sigma.min()
    return np.where(told, curve.torque, np.nan), np.where(told, curve.sigma, np.nan)


def _law(axes: NDArray[np.object_], view: CaseView, body: str, factor: float) -> None:
    """Draw the torque of the final model over the base's, and those of other candidates."""
    looks: list[tuple[str, Any, float, Supplied]] = []
    if view.supplied is not None:
        looks.append(("black", ":", 1.5, view.supplied))
    looks += [(c, (0, (4, 1.5)), 1.0, s) for c, s in zip(_OTHERS, view.suggested, strict=False)]
    for colour, dashes, width, s in looks:
        torque = factor * s.on(body)
        if not torque.any():
            continue
        name = "final model's torque − base model's" if s is view.supplied else plain(s.name)
        axes[0].plot(s.time, torque, color=colour, linewidth=width, linestyle=dashes, label=name)
        axes[1].plot(s.omega_c, torque, color=colour, linewidth=width, linestyle=dashes)


def _limits(view: CaseView, body: str, factor: float) -> tuple[float, float]:
    """Return limits that hold the curves; bands that are far wider are cut."""
    curves = [known(m.torques[body]) for m in view.models]
    size = max(float(np.nanmax(np.abs(torque))) for torque, _ in curves)
    wide = max(float(np.nanmax(np.abs(torque) + 2 * sigma)) for torque, sigma in curves)
    top = 1.15 * factor * min(wide, 2.5 * size if size > 0 else wide)
    return (-top, top) if top > 0 else (-1.0, 1.0)


def _caption(view: CaseView) -> str:
    text = (
        "Torque that the model lacks, inferred from the misfit without assuming a law; band: two "
        "standard deviations. "
        + (
            "The rotor's is drawn only in and near its windows, where the data know it. "
            if view.rotor
            else ""
        )
        + f"Against the speed, dashed is while the {view.body} speeds up, full while it slows down: a friction "
        "that depends on the speed alone gives one curve for both."
    )
    if view.supplied is not None:
        text += (
            " Dotted: the torque that the final model has more than the base; where both agree the law "
            "that was added is what was missing."
        )
    if view.suggested:
        text += " Dashed and thin: what other candidates would supply, each after a refit of its own."
    return text


def torque_finding(view: CaseView) -> str:
    """Return what the torques say."""
    parts = []
    for seen, label in zip(view.models, ("base model", "final model"), strict=False):
        curve = seen.torques["casing"]
        if not curve.torque.any():
            parts.append(f"The {label} lacks no torque that the data could show.")
            continue
        outside = float(np.mean(np.abs(curve.torque) > 2 * curve.sigma))
        parts.append(
            f"The {label} lacks up to {short(float(np.abs(curve.torque).max()))} N m on the {view.body}, "
            f"outside the band for {100 * outside:.0f} % of the time."
        )
    return " ".join(parts)
