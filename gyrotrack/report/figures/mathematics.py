"""Formulas as pictures: LaTeX of the models, drawn by matplotlib's own typesetter."""

from __future__ import annotations

import re
from collections.abc import Sequence

from gyrotrack.report.figures.style import canvas, look, markup

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
    from fitting.expression import latex
    from fitting.expression.nodes import sym

    key, at, label = name.partition("@")
    text = latex(sym(key.rpartition(".")[2]))
    if key.startswith("initial."):
        text = rf"\omega_{{{key[-1]}0}}"
    case = f" ({chr(ord('A') + labels.index(label))})" if at and len(labels) > 1 and label in labels else ""
    return f"${text}${case}"
