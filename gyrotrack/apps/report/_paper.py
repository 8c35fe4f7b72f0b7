"""The figures and tables of the paper, for any study."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gyrotrack._errors import OutputError
from gyrotrack.io._atomic import new_file
from gyrotrack.io._outputs import new_outputs
from gyrotrack.plotting._charts import (
    BLUE,
    GREEN,
    PURPLE,
    VERMILLION,
    Chart,
    Trace,
    canvas,
    concatenated,
    draw,
    picture_file,
    plain,
    style,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from fitting.inference._case_data import CaseData
    from fitting.inference._result import Fit
    from fitting.paper._scan import Scan
    from gyrotrack.io._records import Case


Array = NDArray[np.float64]


@dataclass(frozen=True)
class CaseFit:
    """One of the paper's fits of one case: short name, fit, and index of the case in the fit."""

    name: str
    fit: Fit
    index: int


@dataclass(frozen=True)
class PaperCase:
    """One case: its data, its recordings (optional), and its fits (RM, GM, RM-JF, GM-JF)."""

    label: str
    data: CaseData
    case: Case | None
    fits: tuple[CaseFit, ...]

    @property
    def reduced(self) -> CaseFit:
        """The separate fit of the reduced model."""
        return self.fits[0]


def paper_cases(scan: Scan, data: Sequence[CaseData], cases: Sequence[Case]) -> list[PaperCase]:
    """Return the cases of a study, each with its fits from a scan."""
    known = {c.label: c for c in cases}
    short = {"reduced": "RM", "general": "GM"}
    found = []
    for i, d in enumerate(data):
        fits = [CaseFit(short[m.name], m.separate[i], 0) for m in scan.models]
        fits += [CaseFit(f"{short[m.name]}-JF", m.joint, i) for m in scan.models if m.joint is not None]
        found.append(PaperCase(d.record.label, d, known.get(d.record.label), tuple(fits)))
    return found


def clear_frame(cases: Sequence[PaperCase], folders: Sequence[Path]) -> NDArray[np.uint8] | None:
    """Return the frame (RGB) with the most detected markers, with the overlay; None without a film."""
    from gyrotrack._errors import GyrotrackError
    from gyrotrack.io._schema import STATUS
    from gyrotrack.plotting._frames import Film, find_film

    for case in cases:
        # films at the higher capture rate show the markers of both bodies
        recordings = case.case.recordings.values() if case.case is not None else ()
        for r in sorted(recordings, key=lambda r: -r.capture_fps):
            path = find_film(r, list(folders))
            if path is None or not r.markers:
                continue
            found_markers = np.sum([m.status == STATUS["ok"] for m in r.markers.values()], axis=0)
            try:
                with Film(path, r) as film:
                    picture = film.picture(int(np.argmax(found_markers)))
            except GyrotrackError:
                continue
            if picture is not None:
                return np.ascontiguousarray(picture[..., ::-1])
    return None


# decreasing line widths keep coinciding curves visible
_STYLES: dict[str, tuple[str, tuple[float, ...], float]] = {
    "RM": (BLUE, (2.0, 3.0), 3.0),
    "GM": (VERMILLION, (9.0, 3.6), 1.8),
    "RM-JF": (PURPLE, (7.0, 2.4, 1.8, 2.4), 1.4),
    "GM-JF": (GREEN, (6.0, 2.0, 1.5, 2.0, 1.5, 2.0), 1.0),
}
_NAMES = "RM: reduced model, GM: general model, fitted to this case alone; JF: fitted to all cases jointly."
_CURVE, _POINTS = 900, 2500
_ACROSS, _WIDE, _HIGH = 2, 4.8, 3.4


@dataclass(frozen=True)
class PaperFigure:
    """A figure with its file name and caption."""

    name: str
    figure: Figure
    caption: str


def paper_figures(cases: Sequence[PaperCase], frame: NDArray[np.uint8] | None) -> list[PaperFigure]:
    """Return the figures of the paper, within the context `style`; the first figure needs a frame of the film."""
    found = []
    if frame is not None:
        figure = canvas(_WIDE, _WIDE * frame.shape[0] / frame.shape[1])
        ax = figure.subplots()
        ax.imshow(frame)
        ax.set_axis_off()
        caption = "A frame of the film: centre, inner corners of the markers, rays to the marker centres."
        found.append(PaperFigure("gyroscope", figure, caption))
    for name, (chart, caption) in _FIGURES.items():
        found.append(PaperFigure(name, _panels(cases, chart), caption.replace("{names}", _NAMES)))
    return found


def _panels(cases: Sequence[PaperCase], chart: Callable[[PaperCase], Chart]) -> Figure:
    across = min(_ACROSS, len(cases))
    down = -(-len(cases) // across)
    figure = canvas(_WIDE * across, _HIGH * down)
    axes = figure.subplots(down, across, squeeze=False).flat
    for i, ax in enumerate(axes):
        if i >= len(cases):
            ax.set_visible(False)
            continue
        draw(ax, chart(cases[i]), most=_POINTS)
        ax.set_title(f"({chr(ord('a') + i)})  {plain(cases[i].label)}" if len(cases) > 1 else "")
        if len(ax.get_legend_handles_labels()[1]) > 1:
            ax.legend(loc="best")
    return figure


def _chart(title: str, unit: str, traces: Sequence[Trace]) -> Chart:
    return Chart("paper", title, unit, tuple(traces), "")


def _angles(case: PaperCase) -> Chart:
    from scipy.ndimage import median_filter

    from fitting.inference._record import WIDTH

    casing = case.data.record.casing
    if case.data.is_angle:
        angle = median_filter(casing.value, min(WIDTH, len(casing)), mode="nearest")
    else:
        steps = 0.5 * (casing.value[1:] + casing.value[:-1]) * np.diff(casing.time)
        angle = np.concatenate([[0.0], np.cumsum(steps)])
    return _chart(r"$\psi_c$", "rad", [Trace("casing", casing.time, angle, "black")])


def _rotor_data(case: PaperCase) -> Chart:
    from fitting.inference._record import speeds
    from fitting.inference._speed_residuals import ROTOR

    generated = case.case.rotor_generated if case.case is not None else None
    if generated is not None:
        traces = [Trace("generated", generated.time, generated.omega, "black", width=1.4)]
    else:
        traces = [_modelled(case.reduced, ROTOR, "reduced model", "black", (), 1.4)]
    series = case.case.rotor if case.case is not None else None
    for i, w in enumerate(case.data.record.rotor):
        time, omega = speeds(w, case.data.record.quantity)
        sigma = None
        if series is not None and len(series.time):
            sigma = np.interp(time, series.time, np.nan_to_num(series.omega_sigma))
        colour = (VERMILLION, GREEN, BLUE, PURPLE)[i % 4]
        label = f"window {i + 1}" if i < 3 else "_more"
        traces.append(Trace(label, time, omega, colour, sigma, width=3.0, scale="reference"))
    return _chart(r"$\omega_r$", "rad/s", traces)


def _modelled(
    shown: CaseFit, body: int, label: str, colour: str, dash: tuple[float, ...], width: float
) -> Trace:
    from fitting.inference._speed_residuals import modelled_speed

    mesh = shown.fit.predictions[shown.index].path.mesh
    time = np.linspace(mesh.edges[0], mesh.edges[-1], _CURVE)
    value, sigma = modelled_speed(shown.fit, shown.index, body, time)
    return Trace(label, time, value, colour, sigma, width=width, dash=dash)


def _fits(case: PaperCase, body: int) -> list[Trace]:
    return [
        _modelled(f, body, f.name, colour, dash, width)
        for f in case.fits
        for colour, dash, width in [_STYLES[f.name]]
    ]


def _rotor_fits(case: PaperCase) -> Chart:
    from fitting.inference._record import speeds
    from fitting.inference._speed_residuals import ROTOR

    parts = [(*speeds(w, case.data.record.quantity), None) for w in case.data.record.rotor]
    measured = concatenated("measured", parts, "#c9c9c9", width=6.0, scale="reference")
    return _chart(r"$\omega_r$", "rad/s", [measured, *_fits(case, ROTOR)])


def _casing_fits(case: PaperCase) -> Chart:
    from fitting.inference._record import speeds
    from fitting.inference._speed_residuals import CASING

    time, omega = speeds(case.data.record.casing, case.data.record.quantity)
    sigma = None
    if case.case is not None:
        sigma = np.interp(time, case.case.casing.time, np.nan_to_num(case.case.casing.omega_sigma))
    measured = Trace("measured", time, omega, "#8c8c8c", sigma, width=3.0, scale="reference")
    return _chart(r"$\omega_c$", "rad/s", [measured, *_fits(case, CASING)])


def _residuals(case: PaperCase) -> Chart:
    from fitting.inference._speed_residuals import speed_residuals

    traces: list[Trace] = []
    for f in case.fits:
        casing, _ = speed_residuals(f.fit, f.index)
        known = casing.sigma > 0
        z = -casing.value[known] / casing.sigma[known]
        if not traces:
            ones = np.ones_like(z)
            traces.append(Trace("±2 σ", casing.time[known], 0 * ones, "#cccccc", ones, "band"))
        colour, _, width = _STYLES[f.name]
        traces.append(Trace(f.name, casing.time[known], z, colour, width=width))
    return _chart(r"$\omega_c$, fit − measured", "σ", traces)


def _energy(case: PaperCase) -> Chart:
    from fitting.inference._metrics import energy_balance

    traces = []
    for f in case.fits:
        balance = energy_balance(f.fit.problem.cases[f.index], f.fit.theta, f.fit.predictions[f.index].path)
        change = 100 * (balance.energy / balance.energy[0] - 1)
        colour, _, width = _STYLES[f.name]
        traces.append(Trace(f.name, balance.time, change, colour, width=width))
    return _chart(r"$K_f + \int \tau\,d\psi$, change", "%", traces)


_FIGURES: dict[str, tuple[Callable[[PaperCase], Chart], str]] = {
    "angular-positions": (_angles, "Angular position of the casing, median over 51 points."),
    "rotor-data": (
        _rotor_data,
        (
            "Angular velocity of the rotor: measured in its windows (with two standard uncertainties) and the curve "
            "between them, from the reduced model or as stored with the case."
        ),
    ),
    "rotor-fits": (_rotor_fits, "Angular velocity of the rotor and its fits. {names}"),
    "casing-fits": (
        _casing_fits,
        "Angular velocity of the casing (grey, with two standard uncertainties) and its fits. {names}",
    ),
    "residuals": (
        _residuals,
        (
            "Normalised residuals of the casing's angular velocity, fit minus measured, divided by the standard "
            "uncertainty due to noise. {names}"
        ),
    ),
    "energy": (
        _energy,
        "Kinetic plus dissipated energy relative to its initial value; constant for a complete model. {names}",
    ),
}

FORMATS = ("pdf", "svg", "png")
_DPI = 300
_TABLE = re.compile(r"\\begin\{table\}.*?\\label\{tab:([^}]*)\}.*?\\end\{table\}\n?", re.DOTALL)
# embedded TrueType fonts in PDF, paths in SVG
_PRINT = {"pdf.fonttype": 42, "svg.fonttype": "path"}


# the first file in the list of outputs; if this file exists, the folder contains an output
MAIN = "tables.tex"


def write_figures(
    folder: Path,
    scan: Scan,
    data: Sequence[CaseData],
    cases: Sequence[Case],
    *,
    formats: Sequence[str] = FORMATS[:1],
    films: Sequence[Path] = (),
    force: bool = False,
) -> list[Path]:
    """Write the figures and tables of the paper for a study.

    `data` and `cases` are the scanned cases, compressed and as stored. `films` are folders that may contain the films,
    for the figure of the gyroscope. The result lists the files: figures (pdf, svg, png), ``figures.tex`` with their
    captions, one file per table, and ``tables.tex`` with all tables.
    """
    documents: dict[str, bytes] = {}
    shown = paper_cases(scan, data, cases)
    with style(_PRINT):
        figures = paper_figures(shown, clear_frame(shown, films))
        for f in figures:
            documents |= {
                f"{f.name}.{kind}": picture_file(f.figure, kind, dpi=_DPI, title=f.name) for kind in formats
            }
    documents["figures.tex"] = _figures_tex(figures).encode()
    tables = {name: text.encode("utf-8") for name, text in _tables(scan).items()}
    documents = {MAIN: tables.pop(MAIN), **tables, **documents}
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        what = f"Cannot create the folder {folder}: {error.strerror}."
        raise OutputError(what, "Choose another folder with -o.") from None
    with new_outputs(*(folder / name for name in documents), force=force):
        for name, document in documents.items():
            with new_file(folder / name, force=force) as stream:
                stream.write(document)
    return [folder / name for name in documents]


def _figures_tex(figures: Sequence[PaperFigure]) -> str:
    blocks = [
        "\\begin{figure}[htbp]\n  \\centering\n"
        f"  \\includegraphics[width=\\textwidth]{{{f.name}}}\n  \\caption{{{f.caption}}}\n"
        f"  \\label{{fig:{f.name}}}\n\\end{{figure}}\n"
        for f in figures
    ]
    return "% made by gyrotrack figures; needs graphicx\n" + "\n".join(blocks)


def _tables(scan: Scan) -> dict[str, str]:
    """Return all tables in one file, and each in a separate file."""
    from fitting.paper._tables import scan_latex

    whole = scan_latex(scan)
    head = whole[: whole.index("\\begin{table}")]
    each: dict[str, str] = {}
    for m in _TABLE.finditer(whole):
        name = re.sub(r"[^A-Za-z0-9-]+", "-", m[1]).strip("-") or "table"
        each[f"table-{len(each) + 1}-{name}.tex"] = head + m[0]
    return {"tables.tex": whole, **each}
