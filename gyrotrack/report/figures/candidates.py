"""What would mend the base model: a bar a candidate, classes that cannot be told apart in brackets."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fitting.typesetting import short
from gyrotrack.report.figures.style import (
    BLUE,
    GREEN,
    ORANGE,
    PALE,
    PURPLE,
    SKY,
    WIDTH,
    Picture,
    canvas,
    look,
    picture,
    plain,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from fitting.discovery import Candidate

_MOST = 12
_CLASSES = (GREEN, ORANGE, PURPLE, SKY)


def candidates_picture(candidates: tuple[Candidate, ...], name: str = "candidates") -> Picture | None:
    """Draw the scores; None if nothing scores."""
    shown = [c for c in candidates if c.score > 0][:_MOST]
    if not shown:
        return None
    letters = classes(shown)
    with look():
        figure = canvas(WIDTH, 1.0 + 0.36 * len(shown))
        ax = figure.subplots()
        scores = np.sqrt([c.score for c in shown])
        colours = [_colour(c, letters) for c in shown]
        best = {shown[0].effect.name, *shown[0].indistinguishable_from}
        colours = [
            BLUE if c.effect.name in best and c.significant else k
            for c, k in zip(shown, colours, strict=True)
        ]
        hatches = ["" if c.physical else "////" for c in shown]
        ax.barh(np.arange(len(shown)), scores, color=colours, hatch=hatches, edgecolor="white", height=0.66)
        ax.set_xlim(0, 1.42 * float(scores.max()))
        for i, c in enumerate(shown):
            ax.annotate(
                _note(c), (scores[i], i), xytext=(4, 0), textcoords="offset points", va="center", fontsize=9
            )
        ax.set_yticks(range(len(shown)), [plain(c.effect.name) for c in shown])
        ax.grid(visible=False, axis="y")
        ax.tick_params(axis="y", length=0)
        ax.invert_yaxis()
        ax.set_xlabel(r"$\sqrt{\mathrm{score}}$ [standard deviations]")
        _brackets(ax, shown, letters)
        return picture(name, figure, _caption(shown, letters), _finding(shown))


def classes(candidates: list[Candidate]) -> dict[str, str]:
    """Return the letter of the class of each candidate that has equals."""
    letters: dict[str, str] = {}
    for c in candidates:
        if c.indistinguishable_from and c.effect.name not in letters:
            letter = chr(ord("A") + len(set(letters.values())))
            for name in (c.effect.name, *c.indistinguishable_from):
                letters.setdefault(name, letter)
    return letters


def _colour(c: Candidate, letters: dict[str, str]) -> str:
    if not c.significant:
        return PALE
    letter = letters.get(c.effect.name)
    return _CLASSES[(ord(letter) - ord("A")) % len(_CLASSES)] if letter else "#777777"


def _note(c: Candidate) -> str:
    text = f"score {short(c.score)}"
    if np.isfinite(c.delta_bic):
        text += rf"   $\Delta$BIC {short(c.delta_bic)}"
    return text if c.significant else text + "   not significant"


def _brackets(ax: Axes, shown: list[Candidate], letters: dict[str, str]) -> None:
    names = [c.effect.name for c in shown]
    for depth, letter in enumerate(sorted(set(letters.values()))):
        rows = [i for i, n in enumerate(names) if letters.get(n) == letter]
        if len(rows) < 2:
            continue
        x = 0.985 - 0.03 * depth
        line = [x - 0.012, x, x, x - 0.012], [rows[0] - 0.3, rows[0] - 0.3, rows[-1] + 0.3, rows[-1] + 0.3]
        ax.plot(*line, color="black", linewidth=1.2, transform=ax.get_yaxis_transform(), clip_on=False)
        ax.text(
            x + 0.006,
            (rows[0] + rows[-1]) / 2,
            letter,
            transform=ax.get_yaxis_transform(),
            va="center",
            fontweight="bold",
            fontsize=10,
        )


def _caption(shown: list[Candidate], letters: dict[str, str]) -> str:
    text = (
        "The score is the fall of the base model's deviance when the candidate is added (after a refit "
        "where BIC is given, else predicted); its root is about the number of standard deviations. Pale: "
        "not significant."
    )
    if letters:
        text += " A bracket and one colour: a class that this data cannot tell apart."
    if any(not c.physical for c in shown):
        text += " Hatched: an artefact of the measurement, not physics."
    return text


def _finding(shown: list[Candidate]) -> str:
    best = shown[0]
    if not best.significant:
        return "No candidate is significant."
    text = f"{best.effect.name} scores best with {short(best.score)}"
    if best.indistinguishable_from:
        text += f" and cannot be told from {', '.join(best.indistinguishable_from)}"
    rest = [c for c in shown[1:] if c.effect.name not in best.indistinguishable_from]
    return text + (f"; next comes {rest[0].effect.name} with {short(rest[0].score)}." if rest else ".")
