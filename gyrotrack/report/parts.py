"""What stands in a report, in the order of reading, ready to be laid out as a page or on paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gyrotrack.report.content import Content
from gyrotrack.report.notation import short, typeset
from gyrotrack.report.origin import origin_rows
from gyrotrack.report.sections import section

if TYPE_CHECKING:
    from fitting.estimation import Fit
    from gyrotrack.dataset import Case

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
            section(content, v, i, by_label.get(v.label), tracks.get(v.label), films)
            for i, v in enumerate(content.cases)
        ],
        "boards": [case_board(v, tracks.get(v.label), steps) for v in content.cases],
        "candidates": candidates_picture(content.candidates),
        "candidate_rows": tables.candidate_rows(content),
        "parameters": tables.parameter_rows(content),
        "plausibility": plausibility_rows(content.final),
        "correlation": correlation_picture(content),
        "base_equations": _equations(content.base, "base"),
        "final_equations": _equations(content.final, "final") if content.improved else [],
        "added": _added(content),
        "whiteness": [(label, short(p, 2)) for label, p in content.whiteness],
        "clips": clips,
        "provenance": origin_rows(content.base, provenance),
    }


def outcome(content: Content) -> str:
    """Return what the final model says, in words."""
    from gyrotrack.report.figures.ladder import ladder_finding

    if not content.improved:
        return ladder_finding(content)
    end = {
        "adequate": "What the final model leaves is noise.",
        "misfit": "The final model still misses something: take what was added as a hypothesis.",
        "not converged": "The final fit did not converge: do not trust its numbers.",
    }[content.final.verdict]
    return f"{ladder_finding(content)} {_found(content)} {end}"


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
        law = Equation(effect.law, formula(source, f"added{i}", colour=AFTER))
        found.append((effect.name, law, effect.signature.replace("the casing", f"the {content.body}")))
    return found
