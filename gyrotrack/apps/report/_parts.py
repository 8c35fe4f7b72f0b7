"""The contents of a report: answer, figures and tables, in reading order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitting._numbers import probability, scaled, short, typeset, unit_text
from gyrotrack.apps.report import _tables as tables
from gyrotrack.apps.report._frames import contact_sheets
from gyrotrack.plotting import _case_charts as charts
from gyrotrack.plotting._charts import Dashboard, chart_picture
from gyrotrack.plotting._discovery import candidates_picture, history_finding, history_picture
from gyrotrack.plotting._parameters import correlation_picture, formula
from gyrotrack.plotting._study_data import CaseView, StudyView
from gyrotrack.plotting._style import AFTER, Picture
from gyrotrack.plotting._tracking import Tracks, sync_picture, tracks_of

if TYPE_CHECKING:
    from fitting.discovery._residuals import Failure
    from fitting.inference._result import Fit
    from gyrotrack.apps.report._frames import Sheet
    from gyrotrack.io._records import Case


_DOUBTFUL = 0.01
_MOST_INTERVALS = 3
# the figures of the first screen [inch]: two stacked, one as high as both
_WIDE, _TALL = (6.6, 2.45), (4.6, 5.1)
_VERDICTS = {
    "adequate": ("good", "✓", "Consistent with noise"),
    "missing_effect": ("found", "✚", "Missing effect"),
    "unexplained": ("open", "!", "Unexplained torque"),
}
_FINAL = {
    "adequate": "The residual of the final model is consistent with noise.",
    "misfit": "The final model has a significant lack of fit; the added effect is a hypothesis.",
    "not determined": "The data do not determine every parameter of the final model; drop what is not needed.",
    "not converged": "The final fit did not converge; its numbers are not valid.",
}


@dataclass(frozen=True)
class Section:
    """The figures of one case, under a heading if there are several cases.

    `overview` are speed, residual and torque against speed; `details` are drawn only where no script runs (PDF).
    """

    heading: str
    surface: str
    overview: tuple[Picture, ...]
    windows: Picture | None
    details: tuple[Picture, ...]
    sync: Picture | None
    dashboard: Dashboard
    sheets: tuple[Sheet, ...]


@dataclass(frozen=True)
class Equation:
    """One line of a model: typeset, and as text where it cannot be."""

    latex: str
    svg: str


@dataclass(frozen=True)
class Added:
    """An added effect: where it acts, its law (twice, since ids are unique), its signature, its parameters."""

    name: str
    joint: str
    above: Equation
    below: Equation
    signature: str
    values: str


def report_parts(
    view: StudyView,
    recordings: Sequence[Case],
    films: Sequence[Path],
    provenance: Mapping[str, str],
    *,
    static: bool,
) -> dict[str, Any]:
    """Return everything that a report contains, ready for layout.

    Parameters
    ----------
    view : StudyView
        The fits.
    recordings : sequence of Case
        The cases with their clips.
    films : sequence of Path
        Folders that may contain the films.
    provenance : mapping
        Further lines of provenance.
    static : bool
        Whether to draw the charts that a page with scripts draws by itself.
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
        "facts": _facts(view),
        "rms": [f"{short(x, 2)}" for x in view.residual_rms],
        "sentence": typeset(view.sentence),
        "outcome": f"{history_finding(view)} {_FINAL[view.final.verdict]}"
        if view.improved
        else history_finding(view),
        "caveat": f"Negative dissipation, unphysical: {', '.join(unphysical)}. The parameters of this model are no "
        "physical constants; check them before use."
        if unphysical
        else "",
        "failures": _failures(view),
        "sections": sections,
        "history": history_picture(view),
        "candidates": candidates_picture(view.candidates),
        "candidate_rows": tables.candidate_rows(view),
        "parameters": tables.parameter_rows(view),
        "correlation": correlation_picture(view),
        "plausibility": plausibility,
        "base_equations": _equations(view.base, "base"),
        "final_equations": _equations(view.final, "final") if view.improved else [],
        "added": _added(view),
        "whiteness": _whiteness(view),
        "clips": [row for case in recordings for row in tables.clip_rows(case.recordings, case.placements)],
        "provenance": tables.origin_rows(view.base, provenance),
    }


def _section(
    view: StudyView, index: int, case: Case | None, films: Sequence[Path], *, static: bool
) -> Section:
    v = view.cases[index]
    steps = [s.change for s in view.steps]
    tracks = tracks_of(case) if case is not None else None
    intervals = [i for i in v.intervals if i.body == "casing"]
    overview = (
        (charts.speed_chart(v, "casing"), _WIDE),
        (charts.normalised_chart(v), _WIDE),
        (charts.torque_speed_chart(v, alternatives=not view.improved), _TALL),
    )
    return Section(
        heading=v.label if len(view.cases) > 1 else "",
        surface=v.surface,
        overview=tuple(
            chart_picture(c, intervals if c.name != "speed" else (), name=f"{c.name}{index}", size=size)
            for c, size in overview
        ),
        windows=charts.windows_picture(v, f"windows{index}") if v.rotor else None,
        details=_details(v, index, steps, tracks) if static else (),
        sync=sync_picture(tracks, f"sync{index}") if tracks is not None else None,
        dashboard=charts.case_dashboard(v, tracks, steps),
        sheets=tuple(contact_sheets(case, films, [(f.t_start, f.t_stop) for f in v.failures]))
        if case is not None and films
        else (),
    )


def _details(v: CaseView, index: int, steps: Sequence[str], tracks: Tracks | None) -> tuple[Picture, ...]:
    """Return the figures that the page draws as interactive charts."""
    found = [charts.torque_chart(v, "casing")]
    if v.rotor:
        found.append(charts.torque_chart(v, "rotor"))
    found.append(charts.energy_chart(v, steps))
    if tracks is not None:
        found += charts.tracking_charts(tracks)
    return tuple(
        chart_picture(
            c, [i for i in v.intervals if i.body == "casing"], name=f"{c.name}{index}", size=(6.6, 2.4)
        )
        for c in found
    )


def _headline(view: StudyView) -> tuple[str, str, str]:
    """Return the kind of verdict, its sign, and the verdict with the missing effects."""
    kind, sign, words = _VERDICTS[view.verdict]
    if view.verdict != "missing_effect":
        return kind, sign, words
    best = next((c for c in view.candidates if c.significant), None)
    names = view.added or ((best.effect.name,) if best is not None else ())
    rivals = {c.effect.name: c.indistinguishable_from for c in view.candidates}
    said = [f"one of {', '.join((n, *rivals[n]))}" if rivals.get(n) else n for n in names]
    return kind, sign, f"{words}: {' and '.join(said)}" if said else words


def _facts(view: StudyView) -> list[tuple[str, str]]:
    """Return where the base model fails, and how certain the answer is."""
    rows = []
    failures = sorted((f for v in view.cases for f in v.failures), key=lambda f: -f.size_sigma)
    if failures:
        more = f"; {len(failures) - _MOST_INTERVALS} more" if len(failures) > _MOST_INTERVALS else ""
        rows.append(
            (
                "Where",
                "Unmodelled torque "
                + "; ".join(_interval(f, named=len(view.cases) > 1) for f in failures[:_MOST_INTERVALS])
                + more,
            )
        )
    best = next((c for c in view.candidates if c.significant), None)
    if best is not None:
        certainty = f"ΔBIC {short(best.delta_bic)}, " if best.delta_bic == best.delta_bic else ""
        certainty += f"p {_equal(probability(best.p_value))}"
        if best.indistinguishable_from:
            certainty += f"; indistinguishable from {', '.join(best.indistinguishable_from)}"
        else:
            certainty += "; no indistinguishable candidate"
        rows.append(("Significance", certainty))
    elif view.candidates:
        rows.append(("Significance", f"{len(view.candidates)} candidate effects tested, none significant"))
    return rows


def _interval(f: Failure, *, named: bool) -> str:
    factor, prefix = scaled(abs(f.residual_torque_Nm))
    sign = "" if f.kind == "ripple" else "+" if f.residual_torque_Nm > 0 else "−"
    size = f"{sign}{short(factor * abs(f.residual_torque_Nm), 2)} {prefix}{unit_text(f.unit)}"
    of = f" of {f.label}" if named else ""
    return f"{size} on the {f.called}{of} from {f.t_start:.1f} s to {f.t_stop:.1f} s ({f.size_sigma:.0f} σ)"


def _failures(view: StudyView) -> list[str]:
    several = len(view.cases) > 1
    return [(f"{f.label}: " if several else "") + typeset(str(f)) for v in view.cases for f in v.failures]


def _whiteness(view: StudyView) -> str:
    """Return the result of the test of whiteness, and why a small p need not contradict the verdict."""
    several = len(view.whiteness) > 1
    text = ", ".join(f"{label} " * several + f"p {_equal(probability(p))}" for label, p in view.whiteness)
    if any(p < _DOUBTFUL for _, p in view.whiteness) and view.final.verdict == "adequate":
        text += ". A small p means correlated residuals; process noise makes them, and the verdict accounts for it"
    return text


def _equal(number: str) -> str:
    return number if number.startswith("<") else f"= {number}"


def _equations(fit: Fit, name: str) -> list[Equation]:
    lines = fit.model.equations(single=fit.problem.data[0].record.single)
    return [Equation(line, formula(line, f"{name}{i}")) for i, line in enumerate(lines)]


def _added(view: StudyView) -> list[Added]:
    """Return the added effects."""
    from fitting.effects._latex import latex

    found = []
    for i, effect in enumerate(e for e in view.final.model.effects if e.name in view.added):
        source = latex(effect.expression)
        above, below = (
            Equation(effect.law, formula(source, f"{n}{i}", colour=AFTER)) for n in ("top", "below")
        )
        values = [
            tables.named(k, e)
            for k, e in view.final.estimates.items()
            if k.partition("@")[0].rpartition(".")[0] == effect.name
        ]
        joint = (tables.JOINTS | {"casing": view.body}).get(effect.joint, effect.joint)
        signature = effect.signature.replace("the casing", f"the {view.body}")
        found.append(Added(effect.name, joint, above, below, signature, ", ".join(values)))
    return found
