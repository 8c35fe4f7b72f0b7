"""Candidate effects and the history of fits."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fitting._numbers import POWERS, scaled, short
from gyrotrack.plotting._study_data import Content, Step
from gyrotrack.plotting._style import (
    AFTER,
    BEFORE,
    BLUE,
    GREEN,
    GREY,
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

    from fitting.discovery._select import Candidate


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
        return picture(name, figure, _candidates_caption(shown, letters), _finding(shown))


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


def _candidates_caption(shown: list[Candidate], letters: dict[str, str]) -> str:
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


# title, unit, attribute
_KINDS = (
    ("rms error, {body}", "rad/s", "rmse"),
    (r"reduced $\chi^2$", "", "reduced_chi2"),
    ("held-out error", "noise", "held_out"),
    ("torque that remains", "N m", "torque_left"),
    ("energy drift", "", "energy_drift"),
    ("change of BIC", "", "delta_bic"),
)
_WORDS = (
    ("rmse", "rms error of the {body}", " rad/s"),
    ("reduced_chi2", "reduced chi-square", ""),
    ("held_out", "held-out error", " times the noise"),
    ("torque_left", "torque that remains", " N m"),
)
_CLEARLY = 0.05


def ladder_picture(content: Content) -> Picture:
    """Draw the ladder."""
    steps = content.steps
    noise = max(s.torque_pure for s in steps)
    best = {"rmse": content.rmse_floor, "reduced_chi2": 1.0, "held_out": 1.0} | (
        {"torque_left": noise} if noise else {}
    )
    with look():
        figure = canvas(WIDTH, 1.5 + 2 * (0.55 + 0.36 * len(steps)))
        axes = figure.subplots(2, 3, sharey=True)
        for ax, kind in zip(axes.flat, _KINDS, strict=True):
            _bars(ax, steps, kind[0].replace("{body}", content.body), *kind[1:], best.get(kind[2]))
        for ax in axes[:, 0]:
            ax.set_yticks(range(len(steps)), [plain(s.change, 30) for s in steps])
        axes[0, 0].invert_yaxis()
        return picture("ladder", figure, _history_caption(content), ladder_finding(content))


def _bars(ax: Axes, steps: tuple[Step, ...], title: str, unit: str, name: str, best: float | None) -> None:
    values = np.array([getattr(s, name) for s in steps], dtype=float)
    sizes = np.where(np.isfinite(values), np.abs(values), 0.0)
    factor, prefix = (
        scaled(float(sizes.max())) if name in {"rmse", "torque_left", "energy_drift"} else (1.0, "")
    )
    values, sizes, best = factor * values, factor * sizes, None if best is None else factor * best
    left = _axis(ax, sizes, best, may_be_wide=name != "delta_bic")
    colours = [BEFORE, *[SKY] * (len(steps) - 2), AFTER] if len(steps) > 1 else [BEFORE]
    ax.barh(np.arange(len(steps)), np.maximum(sizes - left, 0.0), left=left, color=colours, height=0.62)
    if best is not None:
        ax.axvline(best, color="black", linewidth=1, linestyle=(0, (4, 2)))
    for i, value in enumerate(values):
        text = "below the noise" if name == "torque_left" and value == 0 else short(float(value))
        if name == "delta_bic" and i == 0:
            text = "start"
        place = max(sizes[i], left)
        ax.annotate(text, (place, i), xytext=(4, 0), textcoords="offset points", va="center", fontsize=9.5)
    measure = f"{prefix}{unit}" if unit else POWERS[prefix]
    ax.set_title(f"{title} [{measure}]" if measure else title, fontweight="normal")
    ax.grid(visible=False, axis="y")
    ax.tick_params(axis="y", length=0)
    ax.spines["left"].set_color(GREY)


def _axis(
    ax: Axes, sizes: np.ndarray[tuple[int], np.dtype[np.float64]], best: float | None, *, may_be_wide: bool
) -> float:
    """Choose a linear or a logarithmic axis with room for the numbers; return where bars begin."""
    from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

    known = [*sizes[sizes > 0].tolist(), *([best] if best is not None else [])]
    top, bottom = (max(known), min(known)) if known else (1.0, 1.0)
    if not may_be_wide or top < 8 * bottom or len(known) < 2:
        ax.set_xlim(0, 1.5 * top)
        ax.xaxis.set_major_locator(
            MaxNLocator(4) if known else NullLocator()
        )  # no bar: a scale would say nothing
        return 0.0
    decades = np.log10(top / bottom)
    left = bottom * 10 ** (-0.12 * decades)
    ax.set_xscale("log")
    ax.set_xlim(left, top * 10 ** (0.55 * decades))
    ax.xaxis.set_major_locator(LogLocator(numticks=4))
    ax.xaxis.set_minor_locator(NullLocator())
    return float(left)


def _history_caption(content: Content) -> str:
    noise = max(s.torque_pure for s in content.steps)
    floor = (
        f" The data themselves hold a random torque of {short(noise, 2)} N m rms; "
        "a rung takes the torque that remains for noise, so that its chi-square and held-out error may be near 1 "
        "where it fails."
        if noise > 0
        else ""
    )
    return (
        "Every rung is one fit; wide ranges are drawn on a logarithmic scale. The dashed line is as good as "
        f"can be: what the noise alone would leave.{floor} The rms error is that of the speed smoothed as in "
        "the paper, its dashed line what the noise of the angles makes of it; the energy drift has such a floor "
        "too."
    )


def ladder_finding(content: Content) -> str:
    """Return what the ladder says: every kind of error that fell clearly."""
    steps = content.steps
    first, last = steps[0], steps[-1]
    if len(steps) == 1:
        return (
            f"One fit: rms error of the {content.body} {short(first.rmse)} rad/s, reduced chi-square "
            f"{short(first.reduced_chi2)}, held-out error {short(first.held_out)} times the noise."
        )
    said = []
    for name, words, unit in _WORDS:
        before, after = getattr(first, name), getattr(last, name)
        if abs(before - after) > _CLEARLY * abs(before):
            end = "nothing above the noise" if after == 0 else f"{short(after)}{unit}"
            said.append(
                f"the {words.replace('{body}', content.body)} goes from {short(before)}{unit} to {end}"
            )
    return f"With {changes(steps)} " + ("; ".join(said) or "no error changes much") + "."


def changes(steps: tuple[Step, ...]) -> str:
    """Return what was added and dropped after the first rung, in words."""
    said = []
    for step in steps[1:]:
        added, _, dropped = step.change.removeprefix("+").partition(" -")
        said.append(added + (f" (and without {dropped})" if dropped else ""))
    return " and ".join([", ".join(said[:-1]), said[-1]] if len(said) > 1 else said)
