"""The report as one HTML file or PDF: result, figures and tables."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, is_dataclass, replace
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fitting._numbers import (
    interval,
    nonbreaking,
    probability,
    rounded,
    scaled,
    short,
    typeset,
    unit_text,
)
from fitting.effects._expression import latex
from fitting.effects._words import of_body, symbol_meanings
from fitting.inference._result import angle_noise_lines
from gyrotrack._errors import OutputError
from gyrotrack.apps.report import _tables as tables
from gyrotrack.apps.report._laws import laws_of_body
from gyrotrack.io._atomic import new_file, open_side_file, refusal, refuse_existing
from gyrotrack.io._scratch import scratch_folder
from gyrotrack.io.readers._reading import units_of_file
from gyrotrack.plotting import _case_charts as charts
from gyrotrack.plotting import _charts as widgets
from gyrotrack.plotting._charts import AFTER, Chart, Dashboard, Picture, chart_picture, themed
from gyrotrack.plotting._discovery import (
    candidates_picture,
    correlation_picture,
    formula,
    history_finding,
    history_picture,
)
from gyrotrack.plotting._ghost import Animation, Stretch, animated, stretches, write_ghost_film
from gyrotrack.plotting._study_data import CaseView, StudyView, gather
from gyrotrack.plotting._tracking import Tile, Tracks, contact_sheets, sync_picture, tracks_of

if TYPE_CHECKING:
    from fitting.discovery._certificate import Certificate
    from fitting.discovery._residuals import Failure
    from fitting.discovery._select import Step
    from fitting.discovery._verdict import Diagnosis
    from fitting.inference._record import Record
    from fitting.inference._result import Fit
    from gyrotrack.io._records import Case
    from gyrotrack.plotting._tracking import Sheet
    from gyrotrack.tracking._film_tracker import Progress


_SMALL_P = 0.01
# largest number of animated pictures of a case
_MAX_GHOSTS = 4
# sizes of the overview figures [inch]: of each of two stacked figures, and of a figure as high as both together
_WIDE, _TALL = (6.6, 2.45), (4.6, 5.1)
_VERDICTS = {
    "adequate": ("good", "✓", "Consistent with noise"),
    "missing_effect": ("found", "✚", "Missing"),
    "unexplained": ("open", "!", "Unexplained torque"),
    "undecided": ("open", "?", "Undecided"),
}
_FINAL = {
    "no_lack_of_fit": "The final model has no significant lack of fit.",
    "lack_of_fit": "The final model has a significant lack of fit; the added effect is a hypothesis.",
    "not_determined": "The data do not determine all parameters of the final model; remove unnecessary effects.",
    "not_converged": "The final fit did not converge; its results are not valid.",
}


@dataclass(frozen=True)
class Section:
    """The figures of one case, with a heading if there are several cases; `details` are drawn only for a PDF."""

    heading: str
    surface: str
    overview: tuple[Picture, ...]
    windows: Picture | None
    details: tuple[Picture, ...]
    sync: Picture | None
    dashboard: Dashboard
    sheets: tuple[Sheet, ...]
    ghosts: tuple[Animation, ...]


@dataclass(frozen=True)
class Equation:
    """One equation, as SVG and as text."""

    latex: str
    svg: str


@dataclass(frozen=True)
class Added:
    """An added effect: name in words, key, joint, law, signature, parameters and their meanings.

    The law appears at two places of the page. It is drawn twice, because SVG ids must be unique.
    """

    name: str
    key: str
    joint: str
    above: Equation
    below: Equation
    signature: str
    values: str
    meanings: tuple[tuple[str, str], ...]


_UNPHYSICAL = "Negative dissipation, unphysical: {}. The parameters of this model are not physical constants."


def report_parts(
    view: StudyView,
    recordings: Sequence[Case],
    films: Sequence[Path],
    provenance: Mapping[str, str],
    *,
    static: bool,
    certificate: Certificate | None = None,
) -> dict[str, Any]:
    """Return the content of a report with lines of `provenance`.

    With `static`, the interactive charts are added as figures.
    """
    by_label = {case.label: case for case in recordings}
    plausibility = tables.plausibility_rows(view.final)
    unphysical = sorted({p.effect for p in plausibility if p.is_unphysical})
    sections = [
        _section(view, i, by_label.get(v.label), films, static=static) for i, v in enumerate(view.cases)
    ]
    return {
        "view": view,
        "title": ", ".join(v.label for v in view.cases),
        "verdict": _headline(view),
        "facts": [*_owner_facts(view, recordings), *_facts(view)],
        "misfit": [short(x, 2) for x in view.misfit],
        "sentence": typeset(view.sentence),
        "outcome": history_finding(view) + (f" {_FINAL[view.final.verdict]}" if view.improved else ""),
        "caveat": _UNPHYSICAL.format(", ".join(unphysical)) if unphysical else "",
        "certificate": None
        if certificate is None
        else {"sentence": certificate.sentence, "rows": [list(row) for row in certificate.rows]},
        "failures": _failures(view),
        "sections": sections,
        "history": history_picture(view),
        "candidates": candidates_picture(view),
        "candidate_rows": tables.candidate_rows(view),
        "limit_rows": tables.limit_rows(view),
        "parameters": tables.parameter_rows(view),
        "correlation": correlation_picture(view),
        "plausibility": plausibility,
        "base_equations": _equations(view.base, "base"),
        "base_meanings": _meanings(view),
        "final_equations": _equations(view.final, "final") if view.improved else [],
        "added": _added(view),
        "whiteness": _whiteness(view),
        "clips": [
            tables.clip_row(r, c.placements.get(k)) for c in recordings for k, r in c.recordings.items()
        ],
        "provenance": tables.origin_rows(view.base, provenance),
    }


def _section(
    view: StudyView, index: int, case: Case | None, films: Sequence[Path], *, static: bool
) -> Section:
    v = view.cases[index]
    steps = [s.words for s in view.steps]
    tracks = tracks_of(case) if case is not None else None
    intervals = [i for i in v.intervals if i.body == v.main]
    of_angle = _torque_of_the_angle(view, v)
    overview = (
        (charts.speed_chart(v, v.main), _WIDE),
        (charts.normalised_chart(v), _WIDE),
        (of_angle[0] if of_angle else charts.torque_law_chart(v, alternatives=not view.improved), _TALL),
    )
    dashboard = charts.case_dashboard(v, tracks, steps)
    return Section(
        heading=v.label if len(view.cases) > 1 else "",
        surface=v.surface,
        overview=tuple(
            chart_picture(c, intervals if c.name != "speed" else (), name=f"{c.name}{index}", size=size)
            for c, size in overview
        ),
        windows=charts.windows_picture(v, f"windows{index}") if "rotor" in v.bodies else None,
        details=_details(v, index, steps, tracks) if static else (),
        sync=sync_picture(tracks, f"sync{index}") if tracks is not None else None,
        dashboard=replace(dashboard, charts=(*dashboard.charts[:3], *of_angle, *dashboard.charts[3:])),
        sheets=tuple(contact_sheets(case, films, [(f.t_start, f.t_stop) for f in v.failures]))
        if case is not None and films
        else (),
        ghosts=tuple(a for s in ghost_stretches(view, index, case, films) if (a := animated(s)) is not None)
        if case is not None
        else (),
    )


def _torque_of_the_angle(view: StudyView, v: CaseView) -> list[Chart]:
    """Return the charts of the unmodelled torque of a case against the angle.

    The list is empty if the torque does not repeat in each turn.
    """
    if not any(f.kind == "ripple" for f in v.failures):
        return []
    fits = (view.base, view.final) if view.improved else (view.base,)
    harmonics = [[h for h in f.angle_harmonics if h.label == v.label] for f in fits]
    return charts.torque_angle_charts(harmonics, charts.NAMES, v.body, view.base.torque_unit)


def ghost_stretches(view: StudyView, index: int, case: Case, films: Sequence[Path]) -> list[Stretch]:
    """Return the parts of the films of a case on which predicted markers are drawn.

    The markers are predicted by the base model and, if it was improved, by the final model.
    """
    fits, names = [view.base], ["base model"]
    if view.improved:
        fits.append(view.final)
        words = " and ".join(view.name(n).words for n in view.added)
        names.append(f"with {words}" if words else "final model")
    intervals = [(f.body, f.t_start, f.t_stop) for f in view.cases[index].failures if f.kind != "ripple"]
    return stretches(case, fits, names, intervals, films, index)[:_MAX_GHOSTS]


def _details(v: CaseView, index: int, steps: Sequence[str], tracks: Tracks | None) -> tuple[Picture, ...]:
    """Return the figures that are interactive charts in the HTML report."""
    found = [charts.torque_chart(v, body) for body in v.bodies]
    found.append(charts.energy_chart(v, steps))
    if tracks is not None:
        found += charts.tracking_charts(tracks)
    shaded = [i for i in v.intervals if i.body == v.main]
    return tuple(chart_picture(c, shaded, name=f"{c.name}{index}", size=(6.6, 2.4)) for c in found)


def _headline(view: StudyView) -> tuple[str, str, str]:
    """Return the style class of the verdict, its symbol, and the verdict in words with the missing effects."""
    kind, sign, words = _VERDICTS[view.verdict]
    if view.differs is not None and view.verdict != "missing_effect":
        different = ", ".join(view.name(n).words for n in view.differs.names)
        example = ", for example" if view.differs.others else ""
        return "found", "≠", f"The recordings differ{example} in {different}"
    if view.verdict == "unexplained" and view.added:
        words += f"; closest law: {' and '.join(view.name(n).words for n in view.added)}"
    if view.verdict != "missing_effect":
        return kind, sign, words
    best = next((c for c in view.candidates if c.significant), None)
    names = view.added or ((best.effect.name,) if best is not None else ())
    if best is not None and not view.added and not best.physical:
        words = "Fault of the measurement"
    rivals = {c.effect.name: c.indistinguishable_from for c in view.candidates}
    known = {c.effect.name: c.effect for c in view.candidates}

    def called(key: str) -> str:
        return view.name(known.get(key, key)).words

    classes = [
        f"one of {'; '.join(called(m) for m in (n, *rivals[n]))}" if rivals.get(n) else called(n)
        for n in names
    ]
    return kind, sign, f"{words}: {' and '.join(classes)}" if classes else words


def _facts(view: StudyView) -> list[tuple[str, str]]:
    """Return the reason for "undecided", location and size of unmodelled torques, and significance of the result."""
    reason = [("Why", typeset(view.sentence))] if view.verdict == "undecided" else []
    rows = [*reason, *_where(view)]
    best = next((c for c in view.candidates if c.significant), None)
    tested = f"{len(view.candidates)} candidate effects tested, none"
    text = f"{tested} significant" if view.candidates else ""
    if view.differs is not None:
        p = _equal(probability(view.differs.p_value))
        text = f"ΔBIC {short(view.differs.delta_bic)}, false-alarm probability {p}"
    elif best is not None:
        p = f"false-alarm probability {_equal(probability(best.p_value))}"
        alike = "; ".join(view.name(n).words for n in best.indistinguishable_from)
        alike = f"indistinguishable from {alike}" if alike else "no indistinguishable candidate"
        bic = f"ΔBIC {short(best.delta_bic)}, " if best.delta_bic == best.delta_bic else ""
        text = f"{bic}{p}; {alike}"
        if view.verdict == "undecided":
            text = f"{view.name(best.effect).words}: {text}"
        if view.verdict == "adequate":
            text = f"{tested} accepted; most significant: {view.name(best.effect).words}, {p}"
    return [*rows, ("Significance", text)] if text else rows


def _where(view: StudyView) -> list[tuple[str, str]]:
    """Return the shaded intervals: intervals of each unmodelled torque, and other intervals of the speed.

    In the other intervals, the residual of the speed is outside its confidence band.
    """
    named = len(view.cases) > 1
    rows = []
    failures = sorted((f for v in view.cases for f in v.failures), key=lambda f: -f.size_sigma)
    if failures:
        rows.append(("Where", f"Unmodelled torque {'; '.join(_interval(f, named=named) for f in failures)}"))
    speeds: dict[str, list[str]] = {}
    for v in view.cases:
        for i in v.speed_intervals:
            body = f"{v.bodies[i.body]}{f' of {v.label}' if named else ''}"
            speeds.setdefault(body, []).append("–".join(interval(i.start, i.stop)))
    parts = [f"{body} {', '.join(spans)} s" for body, spans in speeds.items()]
    if parts:
        speed = "Speed outside its band"
        title, text = ("", f"{speed}, as an effect of an earlier torque") if failures else ("Where", speed)
        rows.append((title, f"{text}: {'; '.join(parts)}"))
    return rows


def _owner_facts(view: StudyView, recordings: Sequence[Case]) -> list[tuple[str, str]]:
    """Return the parameters of the laws of a single body with their meanings, and the largest speed.

    The largest speed is also in the unit of the file.
    """
    rows = [
        (
            view.name(
                law.parameter
            ).words,  # a symbol at the beginning is not capitalised, because k and K differ
            typeset(f"{rounded(law.value, law.stderr, law.unit)}: {law.meaning}"),
        )
        for law in laws_of_body(view.final)
    ]
    readings = [r for case in recordings for r in case.extra.get("reading", [])]
    own = next((found for r in readings if (found := units_of_file(r))), {})
    if rows and "omega" in own:
        unit, scale = own["omega"]
        speed = np.abs(view.cases[0].speeds[view.cases[0].main][0].value)
        largest = f"{short(float(speed.max()))} rad/s, {short(float(speed.max()) / scale)} {unit}"
        rows.insert(0, ("Largest speed", largest))
    return rows


def _interval(f: Failure, *, named: bool) -> str:
    factor, prefix = scaled(abs(f.residual_torque_Nm))
    sign = "" if f.kind == "ripple" else "+" if f.residual_torque_Nm > 0 else "−"
    size = f"{sign}{short(factor * abs(f.residual_torque_Nm), 2)} {prefix}{unit_text(f.unit)}"
    of = f" of {f.label}" if named else ""
    first, last = f.times
    largest = f"(up to {f.size_sigma:.0f} σ from zero)".replace(" ", "\N{NO-BREAK SPACE}")
    return f"{size} on the {f.called}{of}, {first}–{last} s {largest}"


def _failures(view: StudyView) -> list[str]:
    several = len(view.cases) > 1
    return [(f"{f.label}: " if several else "") + typeset(str(f)) for v in view.cases for f in v.failures]


def _whiteness(view: StudyView) -> str:
    """Return the result of the whiteness test, with an explanation if it seems to contradict the verdict."""
    several = len(view.whiteness) > 1
    text = ", ".join(f"{label} " * several + f"p {_equal(probability(p))}" for label, p in view.whiteness)
    if any(p < _SMALL_P for _, p in view.whiteness) and view.final.verdict == "no_lack_of_fit":
        text += ". A small p indicates correlated residuals; process noise causes them and is included in the verdict"
    noise = [typeset(line[:1].upper() + line[1:]) for line in angle_noise_lines(view.final)]
    return ". ".join([text, *noise])


def _equal(number: str) -> str:
    return number if number.startswith("<") else f"= {number}"


def _equations(fit: Fit, name: str) -> list[Equation]:
    lines = fit.model.equations(fit.problem.data[0].record.parts)
    return [Equation(line, formula(line, f"{name}{i}")) for i, line in enumerate(lines)]


# symbols of a gyroscope, with their meanings: moments of inertia, and torque of the joint
_OF_PART = {
    "rotor": ("I_r", "moment of inertia of the rotor"),
    "casing": ("I_c", "moment of inertia of the casing"),
    "bearing": ("τ_cr", "torque of the bearing, between rotor and casing"),
}


def _of_parts(record: Record) -> Iterator[tuple[str, str]]:
    """Yield the symbols of the moments of inertia and of the torques of joints, with their meanings."""
    for b in reversed(record.bodies):
        yield (f"I_{b.name}", f"moment of inertia of the {b.name}") if record.is_chain else _OF_PART[b.part]
    for name in record.joints:
        c = record.mechanism.joints[name]
        meaning = f"torque of the {name}, from the {c.first} to the {c.second}"
        yield (f"τ_{name}", meaning) if record.is_chain else _OF_PART[name]


def _meanings(view: StudyView) -> list[tuple[str, str]]:
    """Return the symbols of the equations of the base model with their meanings."""
    record = view.base.problem.data[0].record
    found = (
        *_of_parts(record),
        *symbol_meanings(view.base.model.effects, view.body, view.final.units),
    )
    return [(s, of_body(text, view.body)) for s, text in found]


def _added(view: StudyView) -> list[Added]:
    """Return the added effects."""
    found = []
    for i, effect in enumerate(e for e in view.final.model.effects if e.name in view.added):
        source = latex(effect.expression)
        above, below = (
            Equation(effect.law, formula(source, f"{n}{i}", colour=AFTER)) for n in ("top", "below")
        )
        values = [
            tables.with_symbol(k, e)
            for k, e in view.final.estimates.items()
            if k.partition("@")[0].rpartition(".")[0] == effect.name
        ]
        joint = (tables.JOINTS | {"casing": view.body}).get(effect.site, effect.site)
        name = view.name(effect)
        signature = of_body(effect.signature, view.body)
        found.append(
            Added(
                name.words,
                name.key,
                joint,
                above,
                below,
                signature,
                ", ".join(values),
                symbol_meanings([effect], view.body, view.final.units),
            )
        )
    return found


def pdf(parts: Mapping[str, Any], *, appendix: bool = False) -> bytes:
    """Return a report (from `report_parts`) as a PDF of four pages, with all tables in an `appendix` if requested.

    Typst receives text as data and never parses it as markup.
    """
    try:
        import typst
    except ImportError:
        raise OutputError(
            "A PDF needs the package typst, which is not installed.",
            "Run: pip install typst; or write .html and print it from a browser.",
        ) from None
    with scratch_folder() as folder:
        images = _Images(folder)
        document = images.plain({k: v for k, v in parts.items() if k != "view"})
        view = parts["view"]
        document |= {
            "appendix": appendix,
            "budget": tables.budget_rows(view),
            "experiment": tables.experiment_rows(view),
            "improved": view.improved,
            "body": view.body,
            "bodies": view.bodies,
            "torque_unit": view.torque_unit,
            "energy_unit": view.final.units.energy,
            "cases": len(view.cases),
            "surfaces": [[v.label, v.surface] for v in view.cases if v.surface],
            "next_experiment": view.next_experiment,
        }
        # invalid bytes in file names become question marks
        text = json.dumps(document, ensure_ascii=False).encode("utf-8", "replace")
        (folder / "report.json").write_bytes(text)
        template = resources.files("gyrotrack.apps.report").joinpath("report.typ")
        (folder / "report.typ").write_bytes(template.read_bytes())
        try:
            return bytes(typst.compile(folder / "report.typ", root=folder))
        except typst.TypstError as error:
            what = f"Typst failed: {str(error).splitlines()[0]}."
            raise OutputError(what, "Write .html and print it from a browser.") from error


class _Images:
    """Writes pictures to files, and replaces the pictures in the document by the names of these files."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._count = 0

    def plain(self, value: Any) -> Any:
        """Return a value as JSON types."""
        if isinstance(value, Picture):
            file = self._write(".svg", value.svg.encode("utf-8", "replace"))
            return {"file": file, "caption": value.caption, "finding": value.finding}
        if isinstance(value, Animation):
            still = self._write(".jpg", value.jpeg)
            return {"file": still, "finding": value.finding, "caption": value.caption}
        if isinstance(value, Tile):
            return {"file": self._write(".jpg", value.jpeg), "text": value.text}
        if is_dataclass(value) and not isinstance(value, type):
            # interactive charts are for the HTML report only
            value = {k: getattr(value, k) for k in value.__dataclass_fields__ if k != "dashboard"}
        if isinstance(value, Mapping):
            found = {str(k): self.plain(v) for k, v in value.items()}
            if isinstance(value.get("svg"), str):
                found["svg"] = self._write(".svg", value["svg"].encode("utf-8")) if value["svg"] else ""
            return found
        if isinstance(value, list | tuple):
            return [self.plain(v) for v in value]
        return nonbreaking(value) if isinstance(value, str) else value

    def _write(self, suffix: str, data: bytes) -> str:
        self._count += 1
        name = f"{self._count}{suffix}"
        (self._folder / name).write_bytes(data)
        return name


def write_report(
    path: Path,
    history: Sequence[Step],
    diagnosis: Diagnosis | None,
    *,
    recordings: Sequence[Case] = (),
    films: Sequence[Path] = (),
    provenance: Mapping[str, str] | None = None,
    certificate: Certificate | None = None,
    appendix: bool = False,
    force: bool = False,
) -> Path:
    """Write the report of a history of fits.

    Parameters
    ----------
    path : Path
        The file to write: PDF if it ends in ``.pdf``, otherwise HTML. The file is written completely or not at all.
    history : sequence of Step
        The history of fits, base first; at least one.
    diagnosis : Diagnosis or None
        Diagnosis of the base.
    recordings : sequence of Case
        The cases from `gyrotrack.io._hdf5.read_case`, for clips and tracking.
    films : sequence of Path
        Folders that may contain the films; their frames are included.
    provenance : mapping of str to str, optional
        Further lines of provenance, for example ``command`` and ``date``.
    certificate : Certificate, optional
        The test of the diagnosis on simulated recordings.
    appendix : bool
        Add all tables and figures to the four pages of a PDF.
    force : bool
        Replace an existing file.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    OutputError
        The file exists and `force` is not set, or it cannot be written.
    """
    path = Path(path)
    refuse_existing(path, force=force)
    is_pdf = path.suffix.lower() == ".pdf"
    view = gather(history, diagnosis)
    parts = report_parts(view, recordings, films, provenance or {}, static=is_pdf, certificate=certificate)
    # file names may contain bytes that are not valid UTF-8
    try:
        document = pdf(parts, appendix=appendix) if is_pdf else html(parts).encode("utf-8", "replace")
    except OSError as error:  # the parts of a PDF are written to the temporary folder first
        raise refusal(Path(tempfile.gettempdir()), error) from error
    with new_file(path, force=force) as stream:
        stream.write(document)
    return path


def write_overlay(
    path: Path,
    history: Sequence[Step],
    diagnosis: Diagnosis | None,
    recordings: Sequence[Case],
    films: Sequence[Path],
    *,
    force: bool = False,
    progress: Progress | None = None,
) -> Path:
    """Write one film of the parts of a study with a lack of fit.

    The film shows the markers predicted by the base model and, if it was improved, by the final model. It also shows
    the run of the casing or of the single body, but at most `_MAX_GHOSTS` parts of each case. A ``.webp`` file contains
    only the first part.

    Parameters
    ----------
    path : Path
        The file to write, ``.mp4`` or ``.webp``.
    history, diagnosis, recordings, films, force
        As for `write_report`.
    progress : callable, optional
        Called with (frames written, frames in total).

    Raises
    ------
    OutputError
        There is no film, or the file exists and `force` is not set.
    """
    view = gather(history, diagnosis)
    by_label = {case.label: case for case in recordings}
    shown = [
        s
        for i, v in enumerate(view.cases)
        if v.label in by_label
        for s in ghost_stretches(view, i, by_label[v.label], films)
    ]
    return write_ghost_film(path, shown, force=force, progress=progress)


_GENERATOR = b'<meta name="generator" content="gyrotrack">'
_HEAD = 200  # number of bytes that are read to recognise a report [bytes]


def is_report(path: Path) -> bool:
    """Return whether a report may be written to this path: the file is missing, or is a report of this program."""
    try:
        with open_side_file(path) as stream:
            return _GENERATOR in stream.read(_HEAD)
    except FileNotFoundError:
        return True
    except (OSError, OutputError):
        return False


def html(parts: Mapping[str, Any]) -> str:
    """Return the report as one self-contained HTML page."""
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup

    folder = resources.files("gyrotrack.apps.report")
    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        # markup is returned unchanged
        finalize=lambda value: nonbreaking(value) if type(value) is str else value,
    )
    environment.filters["themed"] = themed
    # a long key breaks at its dots
    environment.filters["breakable"] = lambda key: Markup(".<wbr>").join(key.split("."))
    template = environment.from_string(folder.joinpath("page.html.jinja").read_text("utf-8"))
    scripts = (*widgets.scripts(), folder.joinpath("page.js").read_text("utf-8"))
    return template.render(
        **parts,
        style=widgets.theme() + folder.joinpath("page.css").read_text("utf-8") + widgets.style_sheet(),
        scripts=scripts,
        policy=widgets.content_policy(scripts),
        data=widgets.as_data([widgets.dashboard_document(s.dashboard) for s in parts["sections"]]),
    )
