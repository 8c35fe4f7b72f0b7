"""One HTML file that needs nothing else: no network, no script but its own, every name escaped."""

from __future__ import annotations

import platform
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata, resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gyrotrack.dataset.writing import new_file, refuse_existing
from gyrotrack.report.case_view import CaseView
from gyrotrack.report.content import Content, gather
from gyrotrack.report.figures import Picture
from gyrotrack.report.notation import short, typeset

if TYPE_CHECKING:
    from fitting.case_data import CaseData
    from fitting.discovery import Diagnosis, Rung
    from fitting.estimation import Fit
    from gyrotrack.dataset import Case
    from gyrotrack.report.frames import Sheet
    from gyrotrack.report.tracks import Tracks

_LIBRARIES = ("numpy", "scipy", "h5py", "matplotlib", "av", "opencv-contrib-python-headless")
_VERDICTS = {
    "adequate": ("good", "✓", "The model is adequate"),
    "missing_effect": ("found", "✚", "A missing effect was found"),
    "unexplained": ("open", "!", "An unexplained torque remains"),
}


@dataclass(frozen=True)
class Section:
    """The figures of one case, under a heading if there are several."""

    heading: str
    surface: str
    motion: tuple[Picture, ...]
    misfit: tuple[Picture, ...]
    torque: Picture
    energy: Picture
    tracking: tuple[Picture, ...]
    sheets: tuple[Sheet, ...]


@dataclass(frozen=True)
class Equation:
    """One line of a model: drawn, and as text if it could not be."""

    latex: str
    svg: str


def write_report(
    path: Path,
    rungs: Sequence[Rung],
    diagnosis: Diagnosis | None,
    *,
    recordings: Sequence[Case] = (),
    films: Sequence[Path] = (),
    provenance: Mapping[str, str] | None = None,
    force: bool = False,
) -> Path:
    """Write the report of a ladder of fits.

    Parameters
    ----------
    path : Path
        The file to write, ``.pdf`` or else HTML; it appears whole or not at all.
    rungs : sequence of Rung
        The ladder, base first; one rung is enough.
    diagnosis : Diagnosis or None
        That of the first rung.
    recordings : sequence of Case
        The cases as `gyrotrack.dataset.read_case` gives them, for the tracking behind the fits.
    films : sequence of Path
        Folders where the films of the recordings may lie; frames of those found are shown.
    provenance : mapping of str to str, optional
        More lines on where this comes from, such as ``command`` and ``date``.
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
    content = gather(rungs, diagnosis)
    parts = report_parts(content, recordings, films, provenance or {})
    if path.suffix.lower() == ".pdf":
        from gyrotrack.report.pdf import pdf

        document = pdf(parts)
    else:
        # names of files may hold bytes that are no text
        document = render(parts).encode("utf-8", "replace")
    with new_file(path, force=force) as stream:
        stream.write(document)
    return path


def render(parts: Mapping[str, Any]) -> str:
    """Return the page."""
    from jinja2 import Environment, StrictUndefined

    from gyrotrack import charts

    folder = resources.files("gyrotrack.report")
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.from_string(folder.joinpath("page.html.jinja").read_text("utf-8"))
    scripts = (charts.script(), folder.joinpath("page.js").read_text("utf-8"))
    return template.render(
        **parts,
        style=folder.joinpath("page.css").read_text("utf-8") + charts.style(),
        scripts=scripts,
        policy=charts.content_policy(scripts),
        data=charts.as_data([charts.board_document(b) for b in parts["boards"]]),
    )


def report_parts(
    content: Content, recordings: Sequence[Case], films: Sequence[Path], provenance: Mapping[str, str]
) -> dict[str, Any]:
    """Return everything that stands in a report, ready to be laid out."""
    from gyrotrack.report import tables
    from gyrotrack.report.boards import case_board
    from gyrotrack.report.figures.candidates import candidates_picture
    from gyrotrack.report.figures.ladder import ladder_picture
    from gyrotrack.report.figures.numbers import correlation_picture
    from gyrotrack.report.plausibility import plausibility_rows
    from gyrotrack.report.tracks import tracks_of

    clips = [row for case in recordings for row in tables.clip_rows(case.recordings, case.placements)]
    by_label = {case.label: case for case in recordings}
    tracks = {label: tracks_of(case) for label, case in by_label.items()}
    steps = tuple(s.change for s in content.steps)
    return {
        "content": content,
        "title": ", ".join(v.label for v in content.cases),
        "verdict": _VERDICTS[content.verdict],
        "sentence": typeset(content.sentence),
        "outcome": outcome(content),
        "failures": _failures(content),
        "ladder": ladder_picture(content),
        "sections": [
            _section(content, v, i, by_label.get(v.label), tracks.get(v.label), films)
            for i, v in enumerate(content.cases)
        ],
        "boards": [case_board(v, tracks.get(v.label), steps) for v in content.cases],
        "candidates": candidates_picture(content.candidates),
        "candidate_rows": tables.candidate_rows(content.candidates),
        "parameters": tables.parameter_rows(content),
        "plausibility": plausibility_rows(content.final),
        "correlation": correlation_picture(content),
        "base_equations": _equations(content.base, "base"),
        "final_equations": _equations(content.final, "final") if content.improved else [],
        "added": _added(content),
        "whiteness": [(label, short(p, 2)) for label, p in content.whiteness],
        "clips": clips,
        "provenance": _provenance(content, provenance),
    }


def outcome(content: Content) -> str:
    """Return what the final model says, in words."""
    from gyrotrack.report.figures.ladder import ladder_finding

    if not content.improved:
        return ladder_finding(content.steps)
    end = {
        "adequate": "What the final model leaves is noise.",
        "misfit": "The final model still misses something: take what was added as a hypothesis.",
        "not converged": "The final fit did not converge: do not trust its numbers.",
    }[content.final.verdict]
    return f"{ladder_finding(content.steps)} {_found(content)} {end}"


def _found(content: Content) -> str:
    """Return the parameters of what was added."""
    from gyrotrack.report.tables import named

    found: dict[str, list[str]] = {}
    for key, e in content.final.estimates.items():
        effect = key.partition("@")[0].rpartition(".")[0]
        if effect in content.added:
            found.setdefault(effect, []).append(named(key, e))
    texts = [f"{effect}: {', '.join(values)}" for effect, values in found.items()]
    return f"Found: {'; '.join(texts)}." if texts else ""


def _failures(content: Content) -> list[str]:
    return [
        (f"{f.label}: " if len(content.cases) > 1 else "") + typeset(str(f))
        for v in content.cases
        for f in v.failures
    ]


def _section(
    content: Content,
    view: CaseView,
    index: int,
    case: Case | None,
    tracks: Tracks | None,
    films: Sequence[Path],
) -> Section:
    from gyrotrack.report.figures.misfit import misfit_picture
    from gyrotrack.report.figures.motion import casing_picture, rotor_picture
    from gyrotrack.report.figures.numbers import energy_picture
    from gyrotrack.report.figures.torque import torque_picture
    from gyrotrack.report.frames import contact_sheets

    changes = tuple(s.change for s in content.steps)
    stretches = [(f.t_start, f.t_stop) for f in view.failures]
    return Section(
        heading=view.label if len(content.cases) > 1 else "",
        surface=view.surface,
        misfit=(misfit_picture(view, f"misfit{index}"),),
        motion=(
            casing_picture(view, f"casing{index}"),
            *((rotor_picture(view, f"rotor{index}"),) if view.rotor else ()),
        ),
        torque=torque_picture(view, f"torque{index}"),
        energy=energy_picture(view, changes, f"energy{index}"),
        tracking=_tracking(view, tracks, index),
        sheets=tuple(contact_sheets(case, films, stretches)) if case is not None and films else (),
    )


def _tracking(view: CaseView, tracks: Tracks | None, index: int) -> tuple[Picture, ...]:
    from gyrotrack.report.figures.tracking import centre_picture, sigma_picture, sync_picture

    if tracks is None:
        return ()
    return (
        sigma_picture(tracks, view, f"sigma{index}"),
        centre_picture(tracks, view, f"centre{index}"),
        sync_picture(tracks, f"sync{index}"),
    )


def _equations(fit: Fit, name: str) -> list[Equation]:
    from gyrotrack.report.figures.mathematics import formula

    lines = fit.model.equations()
    return [Equation(line, formula(line, f"{name}{i}")) for i, line in enumerate(lines)]


def _added(content: Content) -> list[tuple[str, Equation, str]]:
    """Return the effects that were added: name, law, and what tells them from others."""
    from fitting.expression import latex
    from gyrotrack.report.figures.mathematics import formula
    from gyrotrack.report.figures.style import AFTER

    found = []
    for i, effect in enumerate(e for e in content.final.model.effects if e.name in content.added):
        source = latex(effect.expression)
        found.append(
            (effect.name, Equation(effect.law, formula(source, f"added{i}", colour=AFTER)), effect.signature)
        )
    return found


def _provenance(content: Content, given: Mapping[str, str]) -> list[tuple[str, str]]:
    from gyrotrack import __version__

    rows = [(str(k), str(v)) for k, v in given.items()]
    for data in content.base.problem.data:
        r = data.record
        rows.append((f"case {r.label}", f"{r.source or 'in memory'}; SHA-256 of the numbers {r.digest}"))
        rows.append((f"samples of {r.label}", _samples(data)))
    rows.append(("gyrotrack", __version__))
    rows.append(("Python", f"{platform.python_version()} on {sys.platform}"))
    return [*rows, *_versions()]


def _samples(data: CaseData) -> str:
    r = data.record
    if r.single:
        facts = f"one body {len(r.casing)}; {data.n_effective:.0f} effective; I {short(r.I_casing, 4)} kg m²"
        return f"{facts}; measured: {r.quantity}"
    rotor = f"rotor {sum(len(w) for w in r.rotor)} in {len(r.rotor)} windows"
    inertia = f"I_rotor {short(r.I_rotor, 4)}, I_casing {short(r.I_casing, 4)} kg m²"
    seen = f"casing {len(r.casing)}, {rotor}; {data.n_effective:.0f} effective"
    return f"{seen}; {inertia}; measured: {r.quantity}"


def _versions() -> list[tuple[str, str]]:
    rows: list[tuple[str, Any]] = []
    for name in _LIBRARIES:
        try:
            rows.append((name, metadata.version(name)))
        except metadata.PackageNotFoundError:
            continue
    return [("libraries", ", ".join(f"{n} {v}" for n, v in rows))]
