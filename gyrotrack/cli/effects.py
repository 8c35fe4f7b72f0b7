"""`gyrotrack effects`: the library, its formulas, units, signatures, and what looks alike."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gyrotrack.cli.options import Json
from gyrotrack.cli.output import Output
from gyrotrack.cli.study import EffectsFile, own_effects

if TYPE_CHECKING:
    from fitting.effects import Effect


def command(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="One effect in full.")] = None,
    *,
    effects: EffectsFile = None,
    as_json: Json = False,
) -> None:
    """Show the library of effects: formula, units, signature, what it is confused with.

    Example: gyrotrack effects casing.air.quadratic
    """
    from fitting.effects import LIBRARY, find

    out = Output(as_json=as_json)
    own = {e.name: e for e in own_effects(effects)}
    if name is not None:
        effect = own.get(name) or find(name)
        out.result(_document(effect))
        out.show(_page(effect))
        return
    every = [*LIBRARY.values(), *own.values()]
    out.result({"effects": [_document(e) for e in every]})
    out.show("\n".join(f"{e.name:<22} {_where(e)}: {e.law}" for e in every))


def _document(e: Effect) -> dict[str, Any]:
    from fitting.expression import latex

    return {
        "name": e.name,
        "kind": e.kind,
        "joint": e.joint,
        "law": e.law,
        "latex": latex(e.expression),
        "parameters": [
            {
                "symbol": p.symbol,
                "unit": p.unit,
                "role": p.role,
                "lower": p.lower,
                "upper": p.upper,
                "meaning": p.meaning,
            }
            for p in e.parameters
        ],
        "signature": e.signature,
        "confused_with": list(e.confused_with),
        "source": e.source,
    }


def _where(e: Effect) -> str:
    return {
        "factor": "bearing, factor",
        "inertia": "casing, factor",
        "camera.casing": "casing camera",
        "camera.rotor": "rotor camera",
    }.get(e.joint, e.joint)


def _page(e: Effect) -> str:
    lines = [f"{e.name} ({e.kind})", f"  {_where(e)}: {e.law}"]
    if e.state is not None:
        lines.append(f"  d({e.state.symbol})/dt = {e.state.rate}")
    lines += [f"  {p.symbol:<7}[{p.unit}]  {p.meaning}" for p in e.parameters]
    if e.signature:
        lines += textwrap.wrap(f"  seen as: {e.signature}", 79, subsequent_indent="    ")
    if e.confused_with:
        lines.append(f"  looks like: {', '.join(e.confused_with)}")
    if e.source:
        lines.append(f"  source: {e.source}")
    return "\n".join(lines)
