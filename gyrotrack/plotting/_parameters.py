"""Typeset formulas and symbols, and the correlation of parameters."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gyrotrack.plotting._study_data import StudyView
from gyrotrack.plotting._style import AFTER, BEFORE, Picture, canvas, markup, plain, style

Array = NDArray[np.float64]
_STRONG = 0.95
_MOST_NUMBERED = 14
_FUNCTION = re.compile(r"([\w})|]) ?(\\(?:operatorname|exp|log|sqrt|sin|cos|tan|tanh|arctan|left\())")


def formula(latex: str, name: str, *, size: float = 15.0, colour: str = "black") -> str:
    """Return a formula as an ``svg`` element whose text alternative is its LaTeX; empty if it cannot be typeset.

    Parameters
    ----------
    latex : str
        Mathematics, without dollar signs.
    name : str
        Prefix of its ids.
    size : float
        Size of the letters [pt].
    colour : str
        Colour of the letters.
    """
    changes = {"figure.constrained_layout.use": False, "figure.facecolor": "none", "mathtext.fontset": "stix"}
    # mathtext sets no space before functions and makes growing bars too small
    text = _FUNCTION.sub(r"\1\\,\2", latex.replace(r"\left|", "|").replace(r"\right|", "|"))
    with style(changes):
        figure = canvas(1, 0.3)
        figure.text(0, 0, f"${text}$", fontsize=size, color=colour)
        try:
            return markup(figure, name, latex, tight=True)
        except ValueError:  # mathtext does not know a command; the page prints the source
            return ""


def symbol(name: str, labels: Sequence[str]) -> str:
    """Return the symbol of a parameter in mathtext, with (A), (B) for the case that it belongs to."""
    from fitting.effects._expression import latex, sym

    key, at, label = name.partition("@")
    text = latex(sym(key.rpartition(".")[2]))
    if key.startswith("initial."):
        text = rf"\omega_{{{key[-1]}0}}"
    case = f" ({chr(ord('A') + labels.index(label))})" if at and len(labels) > 1 and label in labels else ""
    return f"${text}${case}"


def correlations(view: StudyView) -> tuple[list[str], Array]:
    """Return the names of the final model's parameters with a finite standard error, and their correlation matrix."""
    fit = view.final
    variance = np.diag(fit.covariance)
    keep = np.flatnonzero(np.isfinite(variance) & (variance > 0))
    root = np.sqrt(variance[keep])
    matrix = fit.covariance[np.ix_(keep, keep)] / np.outer(root, root)
    return [fit.problem.layout.names[i] for i in keep], np.clip(matrix, -1, 1)


def correlation_picture(view: StudyView, name: str = "correlation") -> Picture | None:
    """Draw the correlation matrix of the final model's parameters; None for fewer than two."""
    from matplotlib.colors import LinearSegmentedColormap

    names, matrix = correlations(view)
    if len(names) < 2:
        return None
    cases = [v.label for v in view.cases]
    symbols = [symbol(n, cases) for n in names]
    labels = [  # equal symbols get the name of their effect
        f"{s} {plain(n.partition('@')[0].rpartition('.')[0].rpartition('.')[2], 12)}"
        if symbols.count(s) > 1
        else s
        for n, s in zip(names, symbols, strict=True)
    ]
    with style({"axes.grid": False}):
        size = min(7.5, 1.6 + 0.5 * len(names))
        figure = canvas(size + 0.9, size)
        ax = figure.subplots()
        colours = LinearSegmentedColormap.from_list("blue-white-vermillion", [AFTER, "#fefefe", BEFORE], N=41)
        image = ax.pcolormesh(matrix, cmap=colours, vmin=-1, vmax=1)
        ax.set_aspect("equal")
        ax.invert_yaxis()
        turned = 45 if any(" " in text for text in labels) else 0
        ax.set_xticks(np.arange(len(names)) + 0.5, labels, rotation=turned)
        ax.set_yticks(np.arange(len(names)) + 0.5, labels)
        ax.tick_params(length=0, labelsize=12 if len(names) < _MOST_NUMBERED else 8)
        ax.spines[:].set_visible(False)
        if len(names) <= _MOST_NUMBERED:
            for i, j in np.ndindex(*matrix.shape):
                if i != j:
                    colour = "#fefefe" if abs(matrix[i, j]) > 0.75 else "#010101"
                    text = f"{round(float(matrix[i, j]), 2) + 0.0:.2f}".replace("-", "−")
                    ax.text(j + 0.5, i + 0.5, text, ha="center", va="center", color=colour, fontsize=8.5)
        bar = figure.colorbar(image, ax=ax, shrink=0.8)
        bar.set_label("correlation [1]")
        if bar.solids is not None:
            bar.solids.set_rasterized(False)
        bar.outline.set_visible(False)
        off = np.abs(matrix - np.eye(len(names)))
        i, j = np.unravel_index(int(np.argmax(off)), off.shape)
        strong = int((np.triu(off, 1) > _STRONG).sum())
        finding = (
            f"Strongest correlation {matrix[i, j]:.4f}".replace("-", "−")
            + f", between {names[i]} and {names[j]}; {strong} pairs exceed {_STRONG}."
        )
        letters = ", ".join(f"({chr(ord('A') + i)}) {label}" for i, label in enumerate(cases))
        caption = (
            "Correlation of the final model's parameters. Pairs near ±1 are degenerate: only a combination of them is "
            "determined. Parameters at a bound are omitted."
            + (f" Cases: {letters}." if len(cases) > 1 else "")
        )
        return Picture(name, markup(figure, name, finding), caption, finding)
