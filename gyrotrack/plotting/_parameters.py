"""Correlations, energy balance, and typeset formulas."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fitting._numbers import POWERS, scaled, short
from gyrotrack.plotting._study_data import CaseView, Content, correlations
from gyrotrack.plotting._style import (
    AFTER,
    BEFORE,
    GREEN,
    PURPLE,
    SKY,
    WIDTH,
    Picture,
    canvas,
    failing,
    legend,
    look,
    markup,
    picture,
    plain,
    thin,
    zero,
)

_FUNCTION = re.compile(r"([\w})|]) ?(\\(?:operatorname|exp|log|sqrt|sin|cos|tan|tanh|left\())")


def formula(latex: str, name: str, *, size: float = 15.0, colour: str = "black") -> str:
    """Return a formula as an ``svg`` element; empty if it cannot be drawn.

    Its text alternative is its LaTeX.

    Parameters
    ----------
    latex : str
        Mathematics, without dollar signs.
    name : str
        Start of its ids.
    size : float
        Size of the letters [pt].
    colour : str
        Colour of the ink.
    """
    with look(
        {"figure.constrained_layout.use": False, "figure.facecolor": "none", "mathtext.fontset": "stix"}
    ):
        figure = canvas(1, 0.3)
        figure.text(0, 0, f"${_spaced(latex)}$", fontsize=size, color=colour)
        try:
            return markup(figure, name, latex, tight=True)
        except ValueError:  # the typesetter does not know a command; the page then prints the source
            return ""


def _spaced(latex: str) -> str:
    # the typesetter sets no space before functions, and grown bars too small
    latex = latex.replace(r"\left|", "|").replace(r"\right|", "|")
    return _FUNCTION.sub(r"\1\\,\2", latex)


def symbol(name: str, labels: Sequence[str]) -> str:
    """Return the symbol of a parameter for an axis: its letter, and (A), (B) for the case it belongs to."""
    from fitting.effects._expression import sym
    from fitting.effects._latex import latex

    key, at, label = name.partition("@")
    text = latex(sym(key.rpartition(".")[2]))
    if key.startswith("initial."):
        text = rf"\omega_{{{key[-1]}0}}"
    case = f" ({chr(ord('A') + labels.index(label))})" if at and len(labels) > 1 and label in labels else ""
    return f"${text}${case}"


Array = NDArray[np.float64]
_STRONG = 0.95
_MOST_POINTS = 1200


def correlation_picture(content: Content, name: str = "correlation") -> Picture | None:
    """Draw the correlation matrix of the final model's parameters; None for fewer than two."""
    from matplotlib.colors import LinearSegmentedColormap

    names, matrix = correlations(content.final)
    if len(names) < 2:
        return None
    cases = [v.label for v in content.cases]
    labels = _labels(names, cases)
    turned = 45 if any(" " in text for text in labels) else 0
    with look({"axes.grid": False}):
        size = min(7.5, 1.6 + 0.5 * len(names))
        figure = canvas(size + 0.9, size)
        ax = figure.subplots()
        colours = LinearSegmentedColormap.from_list("blue-white-vermillion", [AFTER, "#ffffff", BEFORE], N=41)
        image = ax.pcolormesh(matrix, cmap=colours, vmin=-1, vmax=1)
        ax.set_aspect("equal")
        ax.invert_yaxis()
        ax.set_xticks(np.arange(len(names)) + 0.5, labels, rotation=turned)
        ax.set_yticks(np.arange(len(names)) + 0.5, labels)
        ax.tick_params(length=0, labelsize=12 if len(names) < 14 else 8)
        ax.spines[:].set_visible(False)
        if len(names) <= 14:
            for i, j in np.ndindex(*matrix.shape):
                if i != j:
                    colour = "white" if abs(matrix[i, j]) > 0.75 else "black"
                    text = _two_digits(float(matrix[i, j]))
                    ax.text(j + 0.5, i + 0.5, text, ha="center", va="center", color=colour, fontsize=8.5)
        bar = figure.colorbar(image, ax=ax, shrink=0.8)
        bar.set_label("correlation [1]")
        if bar.solids is not None:
            bar.solids.set_rasterized(False)
        bar.outline.set_visible(False)
        return picture(name, figure, _correlation_caption(cases), _strongest(names, matrix))


def _labels(names: list[str], cases: list[str]) -> list[str]:
    """Return the symbols; where two effects have the same, with the name of the effect."""
    symbols = [symbol(n, cases) for n in names]
    return [
        f"{s} {plain(n.partition('@')[0].rpartition('.')[0].rpartition('.')[2], 12)}"
        if symbols.count(s) > 1
        else s
        for n, s in zip(names, symbols, strict=True)
    ]


def _two_digits(value: float) -> str:
    return f"{round(value, 2) + 0.0:.2f}".replace("-", "−")


def _correlation_caption(cases: list[str]) -> str:
    letters = ", ".join(f"({chr(ord('A') + i)}) {label}" for i, label in enumerate(cases))
    return (
        "Correlation of the final model's parameters. Pairs near ±1 are determined in combination only: "
        "one can stand in for the other. "
        "Parameters on a bound are left out." + (f" Cases: {letters}." if len(cases) > 1 else "")
    )


def _strongest(names: list[str], matrix: Array) -> str:
    off = np.abs(matrix - np.eye(len(names)))
    i, j = np.unravel_index(int(np.argmax(off)), off.shape)
    strong = int((np.triu(off, 1) > _STRONG).sum())
    return (
        f"The strongest correlation is {matrix[i, j]:.4f}".replace("-", "−")
        + f", between {names[i]} and {names[j]}; {strong} pairs exceed 0.95."
    )


def energy_picture(view: CaseView, steps: tuple[str, ...], name: str) -> Picture:
    """Draw the energy balance for each rung."""
    largest = max(c.drift for c in view.energy)
    factor, prefix = scaled(largest)
    exponent = POWERS[prefix] or "1"
    middle = [GREEN, PURPLE, SKY, "#555555", "#999999"]
    colours = [BEFORE, *[middle[i % len(middle)] for i in range(len(view.energy) - 2)], AFTER]
    with look():
        figure = canvas(WIDTH, 3.2)
        ax = figure.subplots()
        for curve, step, colour in zip(view.energy, steps, colours, strict=False):
            exact, mean = (thin(c.time, factor * c.value, _MOST_POINTS) for c in (curve.exact, curve.mean))
            ax.plot(*exact, color=colour, linewidth=0.4, alpha=0.4)
            ax.plot(*mean, color=colour, linewidth=1.8, label=plain(step))
        failing(ax, view, "casing")
        zero(ax)
        ax.set_xlabel("time [s]")
        ax.set_ylabel(f"energy balance, drift [{exponent}]")
        ax.margins(x=0.01)
        legend(ax)
        return picture(
            name,
            figure,
            f"Kinetic energy plus everything that friction has taken must stay what it was. The {view.body}'s "
            "measured speed enters, so that a model that misses a torque drifts; "
            "the pale jitter is the noise of the measured speed, the line its running mean.",
            energy_finding(view),
        )


def energy_finding(view: CaseView) -> str:
    """Return how far the balance drifts."""
    drifts = [c.drift for c in view.energy]
    text = f"The balance drifts by at most {short(drifts[0])} with the base model"
    if len(drifts) > 1:
        text += f" and {short(drifts[-1])} with the final model"
    return f"{text}, relative."
