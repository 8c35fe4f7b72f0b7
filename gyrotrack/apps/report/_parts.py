"""The sections of a report in reading order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitting._numbers import probability, typeset
from fitting._workers import WorkerPool
from gyrotrack.apps.report._plausibility import origin_rows
from gyrotrack.plotting._study_data import CaseView, Content
from gyrotrack.plotting._style import Picture

if TYPE_CHECKING:
    from fitting.inference._result import Fit
    from gyrotrack.apps.report._frames import Sheet
    from gyrotrack.io._records import Case
    from gyrotrack.plotting._tracking import Tracks


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


def section(
    view: CaseView,
    index: int,
    changes: tuple[str, ...],
    heading: str,
    case: Case | None,
    tracks: Tracks | None,
    films: Sequence[Path],
) -> Section:
    """Return the figures of the case at `index`; those of tracking and films if there is a `case` with its clips.

    `changes` are the names of the ladder's rungs.
    """
    from gyrotrack.apps.report._frames import contact_sheets
    from gyrotrack.plotting._motion import casing_picture, misfit_picture, rotor_picture
    from gyrotrack.plotting._parameters import energy_picture
    from gyrotrack.plotting._torque import torque_picture

    stretches = [(f.t_start, f.t_stop) for f in view.failures]
    return Section(
        heading=heading,
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
    from gyrotrack.plotting._tracking import centre_picture, sigma_picture, sync_picture

    if tracks is None:
        return ()
    return (
        sigma_picture(tracks, view, f"sigma{index}"),
        centre_picture(tracks, view, f"centre{index}"),
        sync_picture(tracks, f"sync{index}"),
    )


_DOUBTFUL = 0.01
_VERDICTS = {
    "adequate": ("good", "✓", "The model is adequate"),
    "missing_effect": ("found", "✚", "A missing effect was found"),
    "unexplained": ("open", "!", "An unexplained torque remains"),
}


@dataclass(frozen=True)
class Equation:
    """One line of a model: drawn, and as text if it could not be."""

    latex: str
    svg: str


@dataclass(frozen=True)
class Added:
    """An effect that was added: where it acts, its law (as two drawings), what tells it from others, what was found."""

    name: str
    joint: str
    above: Equation
    below: Equation
    signature: str
    values: str


def report_parts(
    content: Content,
    recordings: Sequence[Case],
    films: Sequence[Path],
    provenance: Mapping[str, str],
    workers: WorkerPool,
) -> dict[str, Any]:
    """Return everything that stands in a report, ready to be laid out; `workers` draw some figures."""
    from gyrotrack.apps.report import _tables as tables
    from gyrotrack.apps.report._dashboard import case_board
    from gyrotrack.apps.report._plausibility import plausibility_rows
    from gyrotrack.plotting._discovery import candidates_picture, ladder_picture
    from gyrotrack.plotting._parameters import correlation_picture
    from gyrotrack.plotting._tracking import tracks_of

    clips = [row for case in recordings for row in tables.clip_rows(case.recordings, case.placements)]
    by_label = {case.label: case for case in recordings}
    tracks = {label: tracks_of(case) for label, case in by_label.items()}
    steps = tuple(s.change for s in content.steps)
    several = len(content.cases) > 1
    cases = [
        (v, i, steps, v.label if several else "", by_label.get(v.label), tracks.get(v.label), films)
        for i, v in enumerate(content.cases)
    ]
    here = len(cases) // 2
    later = [workers.submit(section, *case) for case in cases[here:]]
    correlation = workers.submit(correlation_picture, content)
    candidate_rows = workers.submit(tables.candidate_rows, content)
    parts: dict[str, Any] = {
        "content": content,
        "title": ", ".join(v.label for v in content.cases),
        "verdict": _headline(content),
        "sentence": typeset(content.sentence),
        "outcome": outcome(content),
        "failures": _failures(content),
        "ladder": ladder_picture(content),
        "sections": [section(*case) for case in cases[:here]],
        "boards": [case_board(v, tracks.get(v.label), steps) for v in content.cases],
        "candidates": candidates_picture(content.candidates),
        "tried": "Effects that were tried, and are not needed"
        if content.verdict == "adequate" and not content.improved
        else "What would mend the base model",
        "parameters": tables.parameter_rows(content),
        "plausibility": plausibility_rows(content.final),
        "base_equations": _equations(content.base, "base"),
        "final_equations": _equations(content.final, "final") if content.improved else [],
        "added": _added(content),
        "whiteness": _whiteness(content),
        "clips": clips,
        "provenance": origin_rows(content.base, provenance),
    }
    parts["sections"] += [task.result() for task in later]
    parts["correlation"], parts["candidate_rows"] = correlation.result(), candidate_rows.result()
    return parts


def outcome(content: Content) -> str:
    """Return what the final model says, in words."""
    from gyrotrack.plotting._discovery import ladder_finding

    if not content.improved:
        return ladder_finding(content)
    end = {
        "adequate": "What the final model leaves is noise.",
        "misfit": "The final model still misses something: take what was added as a hypothesis.",
        "not converged": "The final fit did not converge: do not trust its numbers.",
    }[content.final.verdict]
    return f"{ladder_finding(content)} {end}"


def _headline(content: Content) -> tuple[str, str, str]:
    """Return the kind of verdict, its sign, and the verdict in words, with the effects that are missing."""
    kind, sign, words = _VERDICTS[content.verdict]
    if content.verdict != "missing_effect":
        return kind, sign, words
    best = next((c for c in content.candidates if c.significant), None)
    names = content.added or ((best.effect.name,) if best is not None else ())
    rivals = {c.effect.name: c.indistinguishable_from for c in content.candidates}
    told = [f"one of {', '.join((n, *rivals[n]))}" if rivals.get(n) else n for n in names]
    return kind, sign, f"{words}: {' and '.join(told)}" if told else words


def _whiteness(content: Content) -> str:
    """Return what the test of whiteness says, and what a small p means where the verdict is noise all the same."""
    several = len(content.whiteness) > 1
    text = ", ".join(f"{label} " * several + f"p {_equal(probability(p))}" for label, p in content.whiteness)
    small = any(p < _DOUBTFUL for _, p in content.whiteness) and content.final.verdict == "adequate"
    return text + (
        ". A small p here means that neighbours are alike, as a random torque makes them; the verdict allows for that"
        if small
        else ""
    )


def _equal(number: str) -> str:
    return number if number.startswith("<") else f"= {number}"


def _failures(content: Content) -> list[str]:
    return [
        (f"{f.label}: " if len(content.cases) > 1 else "") + typeset(str(f))
        for v in content.cases
        for f in v.failures
    ]


def _equations(fit: Fit, name: str) -> list[Equation]:
    from gyrotrack.plotting._parameters import formula

    lines = fit.model.equations(single=fit.problem.data[0].record.single)
    return [Equation(line, formula(line, f"{name}{i}")) for i, line in enumerate(lines)]


def _added(content: Content) -> list[Added]:
    """Return the effects that were added."""
    from fitting.effects._latex import latex
    from gyrotrack.apps.report._tables import JOINTS, named
    from gyrotrack.plotting._parameters import formula
    from gyrotrack.plotting._style import AFTER

    found = []
    for i, effect in enumerate(e for e in content.final.model.effects if e.name in content.added):
        source = latex(effect.expression)
        above, below = (
            Equation(effect.law, formula(source, f"{n}{i}", colour=AFTER)) for n in ("top", "below")
        )
        values = [
            named(k, e)
            for k, e in content.final.estimates.items()
            if k.partition("@")[0].rpartition(".")[0] == effect.name
        ]
        joint = (JOINTS | {"casing": content.body}).get(effect.joint, effect.joint)
        seen = effect.signature.replace("the casing", f"the {content.body}")
        found.append(Added(effect.name, joint, above, below, seen, ", ".join(values)))
    return found
