"""Formulas: parsed safely, differentiated exactly, evaluated with NumPy, printed as LaTeX.

The same small language writes the library of effects and the laws that users type. Nothing here ever
runs text as code: the text is parsed by `ast`, held against an allow-list, and evaluated by walking a tape.
"""

from fitting.expression.derivative import derivative
from fitting.expression.latex import latex
from fitting.expression.nodes import Expr, symbols
from fitting.expression.parsing import parse
from fitting.expression.tape import Tape

__all__ = ["Expr", "Tape", "derivative", "latex", "parse", "symbols"]
