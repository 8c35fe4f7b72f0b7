"""The figures of the paper for any study."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyrotrack.plotting._style import BLUE, GREEN, PURPLE, VERMILLION, canvas, plain, thin

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from fitting.inference._case_data import CaseData
    from fitting.inference._result import Fit
    from fitting.study._scan import Scan
    from gyrotrack.io._records import Case


Array = NDArray[np.float64]


@dataclass(frozen=True)
class Shown:
    """One of the paper's fits of one case: its short name, the fit, and which of the fit's cases it is."""

    name: str
    fit: Fit
    index: int


@dataclass(frozen=True)
class PaperCase:
    """One case: its record, the tracking behind it if there is any, and its fits (RM, GM, RM-JF, GM-JF)."""

    label: str
    data: CaseData
    case: Case | None
    fits: tuple[Shown, ...]

    @property
    def reduced(self) -> Shown:
        """The separate fit of the reduced model."""
        return self.fits[0]


def paper_cases(scan: Scan, data: Sequence[CaseData], cases: Sequence[Case]) -> list[PaperCase]:
    """Return the cases of a study with the fits that a scan made of them."""
    known = {c.label: c for c in cases}
    short = {"reduced": "RM", "general": "GM"}
    found = []
    for i, d in enumerate(data):
        fits = [Shown(short[m.name], m.separate[i], 0) for m in scan.models]
        fits += [Shown(f"{short[m.name]}-JF", m.joint, i) for m in scan.models if m.joint is not None]
        found.append(PaperCase(d.record.label, d, known.get(d.record.label), tuple(fits)))
    return found


def clear_frame(cases: Sequence[PaperCase], folders: Sequence[Path]) -> NDArray[np.uint8] | None:
    """Return a frame (red, green, blue) on which most markers are found, drawn over; None without any film."""
    from gyrotrack._errors import GyrotrackError
    from gyrotrack.io._schema import STATUS
    from gyrotrack.plotting._frames import Film, find_film

    for case in cases:
        # clips of the rotor show all papers at the higher rate
        recordings = case.case.recordings.values() if case.case is not None else ()
        for r in sorted(recordings, key=lambda r: -r.capture_fps):
            path = find_film(r, list(folders))
            if path is None or not r.markers:
                continue
            whole = np.sum([m.status == STATUS["ok"] for m in r.markers.values()], axis=0)
            try:
                with Film(path, r) as film:
                    picture = film.picture(int(np.argmax(whole)))
            except GyrotrackError:
                continue
            if picture is not None:
                return np.ascontiguousarray(picture[..., ::-1])
    return None


_LOOKS: dict[str, dict[str, Any]] = {
    "RM": {"color": BLUE, "linestyle": (0, (1, 1.4)), "linewidth": 2.2},
    "GM": {"color": VERMILLION, "linestyle": (0, (5, 2))},
    "RM-JF": {"color": PURPLE, "linestyle": (0, (6, 2, 1.5, 2))},
    "GM-JF": {"color": GREEN, "linestyle": (0, (6, 2, 1.5, 2, 1.5, 2))},
}
# curves that may lie on each other, the later the thinner
_WIDTHS = (3.0, 1.8, 1.2, 0.7)
_NAMES = "RM: reduced model, GM: general model, fitted to this case alone; JF: fitted to all cases jointly."
_CURVE, _POINTS = 900, 2500
_ACROSS, _WIDE, _HIGH = 2, 4.8, 3.4


@dataclass(frozen=True)
class PaperFigure:
    """A figure: its name as a file, the figure, and its caption."""

    name: str
    figure: Figure
    caption: str


def paper_figures(cases: Sequence[PaperCase], frame: NDArray[np.uint8] | None) -> list[PaperFigure]:
    """Return the figures; the first, a frame of the film, only where a film was found.

    Call it, and save what it returns, inside `style.look`.
    """
    found = []
    if frame is not None:
        found.append(_gyroscope(frame))
    data = (
        ("angular-positions", _angles, "Angular position of the casing, median over 51 points."),
        (
            "rotor-data",
            _rotor_data,
            (
                "Angular velocity of the rotor: measured in its windows (with two standard deviations) and the curve "
                "between them, of the reduced model or as it came with the case."
            ),
        ),
        ("rotor-fits", _rotor_fits, f"Angular velocity of the rotor and its fits. {_NAMES}"),
        (
            "casing-fits",
            _casing_fits,
            f"Angular velocity of the casing (dots, with two standard deviations) and its fits. {_NAMES}",
        ),
        (
            "residuals",
            _residuals,
            (
                "Normalised residuals of the casing's angular velocity, fit minus measured over the standard deviation "
                f"that noise gives them. {_NAMES}"
            ),
        ),
        (
            "energy",
            _energy,
            f"Kinetic energy plus all that friction has taken, against the start; constant for a right model. {_NAMES}",
        ),
    )
    return [*found, *(PaperFigure(name, _panels(cases, draw), caption) for name, draw, caption in data)]


def _panels(cases: Sequence[PaperCase], draw: Callable[[Axes, PaperCase], None]) -> Figure:
    across = min(_ACROSS, len(cases))
    down = -(-len(cases) // across)
    figure = canvas(_WIDE * across, _HIGH * down)
    axes = figure.subplots(down, across, squeeze=False).flat
    for i, ax in enumerate(axes):
        if i >= len(cases):
            ax.set_visible(False)
            continue
        draw(ax, cases[i])
        ax.set_title(f"({chr(ord('a') + i)})  {plain(cases[i].label)}" if len(cases) > 1 else "")
        ax.set_xlabel("time [s]")
        ax.margins(x=0.01)
        if len(ax.get_legend_handles_labels()[1]) > 1:
            ax.legend(loc="best")
    return figure


def _gyroscope(frame: NDArray[np.uint8]) -> PaperFigure:
    figure = canvas(_WIDE, _WIDE * frame.shape[0] / frame.shape[1])
    ax = figure.subplots()
    ax.imshow(frame)
    ax.set_axis_off()
    caption = (
        "A frame of the film with the centre, the near corners of the papers, and the rays to their middles."
    )
    return PaperFigure("gyroscope", figure, caption)


def _angles(ax: Axes, case: PaperCase) -> None:
    from scipy.ndimage import median_filter

    from fitting.inference._velocity import WIDTH

    casing = case.data.record.casing
    if case.data.is_angle:
        angle = median_filter(casing.value, min(WIDTH, len(casing)), mode="nearest")
    else:
        steps = 0.5 * (casing.value[1:] + casing.value[:-1]) * np.diff(casing.time)
        angle = np.concatenate([[0.0], np.cumsum(steps)])
    ax.plot(*thin(casing.time, angle, _POINTS), color="black", linewidth=1.4)
    ax.set_ylabel(r"$\psi_c$ [rad]")


def _rotor_data(ax: Axes, case: PaperCase) -> None:
    from fitting.inference._speed_residuals import ROTOR, modelled_speed

    curve = case.case.rotor_generated if case.case is not None else None
    if curve is not None:
        ax.plot(*thin(curve.time, curve.omega, _POINTS), color="black", linewidth=1.2, label="generated")
    else:
        time = _times(case)
        value, sigma = modelled_speed(case.reduced.fit, case.reduced.index, ROTOR, time)
        ax.fill_between(time, value - 2 * sigma, value + 2 * sigma, color="black", alpha=0.2, linewidth=0)
        ax.plot(time, value, color="black", linewidth=1.2, label="reduced model")
    _measured_rotor(ax, case)
    ax.set_ylabel(r"$\omega_r$ [rad/s]")


def _measured_rotor(ax: Axes, case: PaperCase) -> None:
    from fitting.inference._velocity import speeds

    series = case.case.rotor if case.case is not None else None
    for i, w in enumerate(case.data.record.rotor):
        time, omega = speeds(w, case.data.record.quantity)
        colour, label = (VERMILLION, GREEN, BLUE, PURPLE)[i % 4], f"window {i + 1}" if i < 3 else None
        if series is not None and len(series.time):
            sigma = np.interp(time, series.time, np.nan_to_num(series.omega_sigma))
            ax.fill_between(time, omega - 2 * sigma, omega + 2 * sigma, color=colour, alpha=0.35, linewidth=0)
        ax.plot(*thin(time, omega, _POINTS // 5), color=colour, linewidth=3, label=label)


def _rotor_fits(ax: Axes, case: PaperCase) -> None:
    from fitting.inference._speed_residuals import ROTOR

    for w in case.data.record.rotor:
        ax.axvspan(w.time[0], w.time[-1], color="#dddddd", linewidth=0, zorder=0)
    _fits(ax, case, ROTOR)
    ax.set_ylabel(r"$\omega_r$ [rad/s]")


def _casing_fits(ax: Axes, case: PaperCase) -> None:
    from fitting.inference._speed_residuals import CASING
    from fitting.inference._velocity import speeds

    time, omega = speeds(case.data.record.casing, case.data.record.quantity)
    if case.case is not None:
        series = case.case.casing
        sigma = np.interp(time, series.time, np.nan_to_num(series.omega_sigma))
        step = max(1, len(time) // _POINTS)
        few = slice(None, None, step)
        ax.fill_between(
            time[few],
            (omega - 2 * sigma)[few],
            (omega + 2 * sigma)[few],
            color="#999999",
            alpha=0.5,
            linewidth=0,
        )
    ax.plot(*thin(time, omega, _POINTS), color="black", marker=".", markersize=1.5, linestyle="none")
    _fits(ax, case, CASING)
    ax.set_ylabel(r"$\omega_c$ [rad/s]")


def _fits(ax: Axes, case: PaperCase, body: int) -> None:
    from fitting.inference._speed_residuals import modelled_speed

    time = _times(case)
    for shown in case.fits:
        value, sigma = modelled_speed(shown.fit, shown.index, body, time)
        colour = _LOOKS[shown.name]["color"]
        ax.fill_between(time, value - 2 * sigma, value + 2 * sigma, color=colour, alpha=0.15, linewidth=0)
        ax.plot(time, value, label=shown.name, **_LOOKS[shown.name])


def _residuals(ax: Axes, case: PaperCase) -> None:
    from fitting.inference._speed_residuals import speed_residuals

    for shown, width in zip(case.fits, _WIDTHS, strict=False):
        casing, _ = speed_residuals(shown.fit, shown.index)
        known = casing.sigma > 0
        z = -casing.value[known] / casing.sigma[known]
        ax.plot(
            casing.time[known],
            z,
            label=shown.name,
            **{**_LOOKS[shown.name], "linestyle": "-", "linewidth": width},
        )
    ax.axhspan(-2, 2, color="#cccccc", alpha=0.6, linewidth=0, zorder=0)
    ax.axhline(0, color="#777777", linewidth=0.8)
    ax.set_ylabel(r"$(\omega_{c,\mathrm{fit}} - \omega_{c,\mathrm{exp}}) / \sigma$")


def _energy(ax: Axes, case: PaperCase) -> None:
    from fitting.inference._metrics import energy_balance

    for shown, width in zip(case.fits, _WIDTHS, strict=False):
        fit, i = shown.fit, shown.index
        balance = energy_balance(fit.problem.cases[i], fit.theta, fit.predictions[i].path)
        change = 100 * (balance.energy / balance.energy[0] - 1)
        look_ = {**_LOOKS[shown.name], "linestyle": "-", "linewidth": width}
        ax.plot(*thin(balance.time, change, _CURVE), label=shown.name, **look_)
    ax.axhline(0, color="#777777", linewidth=0.8)
    ax.set_ylabel(r"$K_f + \int \tau\,d\psi$, change [%]")


def _times(case: PaperCase) -> Array:
    mesh = case.reduced.fit.predictions[case.reduced.index].path.mesh
    return np.linspace(mesh.edges[0], mesh.edges[-1], _CURVE)
