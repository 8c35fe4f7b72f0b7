"""`gyrotrack plan`: what recordings can show, and what to record next."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gyrotrack._errors import UsageError
from gyrotrack.apps._study import open_study
from gyrotrack.apps.cli._options import EffectsFile, Force, From, Json, LedgerFile, Quiet, own_effects
from gyrotrack.apps.cli._output import DONE, NOT_TRUSTED, Output

if TYPE_CHECKING:
    from fitting.discovery._next_run import Bounds
    from fitting.discovery._plan import Plan
    from fitting.discovery._power import EffectLimits

_WIDTH = 100
_PAIRS = ("omega_rotor", "omega_casing", "duration", "inertia_casing", "touchpoint")


def plan_command(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            metavar="CASE.h5...|PLAN.toml",
            help="Case files, made by `sync` or `import`; or a description of recordings to be made.",
        ),
    ],
    *,
    size: Annotated[
        float | None,
        typer.Option(
            "--size",
            metavar="T",
            help="Size of an effect, an rms torque in N m, for power and runs needed; "
            "by default 1 % of the rms bearing torque.",
        ),
    ] = None,
    bound: Annotated[
        list[str] | None,
        typer.Option(
            "--bound",
            metavar="KEY=LOW,HIGH",
            help="Possible runs: omega_rotor, omega_casing (rad/s), duration (s), inertia_casing, touchpoint (ratios), "
            "as --bound omega_casing=0,60.",
        ),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option("--picture", metavar="FILE", help="Also draw limits, power and the run (.png, .svg)."),
    ] = None,
    effects: EffectsFile = None,
    start: From = None,
    ledger: LedgerFile = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Compute detection and upper limit of every effect, the runs needed, and the best next run.

    A description of recordings is a TOML file; the guide plan-an-experiment has one.

    Example: gyrotrack plan case1.h5 case2.h5 --picture plan.png
    """
    from fitting.discovery._next_run import Bounds
    from fitting.discovery._plan import plan
    from fitting.study._serialisation import plan_document
    from gyrotrack.io._atomic import refuse_existing, refuse_special

    described = [p for p in recordings if p.suffix.lower() == ".toml"]
    if described and len(recordings) > 1:
        raise UsageError("A description stands alone.", "Give one PLAN.toml, or case files.")
    if described and (start is not None or ledger is not None):
        raise UsageError(
            "--from and --ledger belong to case files; a description has no fits.", "Leave them out."
        )
    if size is not None and not (0 < size < math.inf):
        raise UsageError(f"--size {size:g} is no torque.", "Give a positive rms torque in N m: --size 1e-6.")
    changes = _bounds(bound or ())
    if picture is not None:
        if picture.suffix.lower() not in {".png", ".svg"}:
            raise UsageError(f"Unknown picture format: {picture}.", "Use a name that ends in .png or .svg.")
        refuse_existing(picture, force=force)
    out = Output(as_json=as_json, quiet=quiet)
    own = own_effects(effects)
    with out.progress("planning") as progress:
        progress(0, None)
        if described:
            from fitting.discovery._planned_recordings import read_planned

            refuse_special(described[0])
            usual: Bounds | None = read_planned(described[0]).bounds if changes else None
            subject: Any = described[0]
        else:
            fit, _ = open_study(recordings, ledger).base(start)
            usual, subject = (Bounds.of(fit) if changes else None), fit
        bounds = replace(usual, **changes) if usual is not None else None
        found = plan(subject, own, size=size, bounds=bounds, progress=progress)
    if picture is not None:
        from gyrotrack.plotting._plan import write_plan_picture

        write_plan_picture(found, picture, force=force)
    out.result(plan_document(found) | ({"picture": picture} if picture is not None else {}))
    out.show(plan_table(found), *([f"written: {picture}"] if picture is not None else []))
    return DONE if found.fit.converged else NOT_TRUSTED


def _bounds(given: Sequence[str]) -> dict[str, Any]:
    """Read ``omega_casing=-60,60``."""
    found: dict[str, Any] = {}
    for text in given:
        key, _, pair = text.partition("=")
        words = pair.split(",")
        try:
            low, high = (float(w) for w in words)
        except ValueError:
            low, high = math.nan, math.nan
        if key not in _PAIRS:
            raise UsageError(
                f"--bound {text[:40]!r}: unknown quantity.", f"It is one of: {', '.join(_PAIRS)}."
            )
        if not -math.inf < low <= high < math.inf:
            raise UsageError(
                f"--bound {text[:40]!r} is no pair of numbers.", "Write --bound omega_casing=-60,60."
            )
        if key in {"duration", "inertia_casing", "touchpoint"} and low <= 0:
            raise UsageError(f"--bound {text[:40]!r} is not positive.", "Write --bound duration=100,400.")
        found[key] = (low, high)
    return found


def plan_table(found: Plan) -> str:
    """Return a plan as lines: limits of every effect, classes, the next run."""
    runs, unit = len(found.fit.labels), found.fit.torque_unit
    of = "the planned recording" if found.planned else "the recording"
    lines = []
    if found.warning:
        lines += [*textwrap.wrap(f"warning: {found.warning}", _WIDTH), ""]
    lines += textwrap.wrap(
        f"What {of}{'s' if runs > 1 else ''} ({', '.join(found.fit.labels)}) can show: detection limit (power 90 % at "
        f"the false-alarm rate of the search) and upper limit (95 %{', expected' if found.planned else ''}), as rms "
        f"torques along the motion; power and number of runs for an effect of {found.size:.2g} {unit}.",
        _WIDTH,
    )
    lines += [
        "",
        f"  {'effect':<28}{'detection limit':>18}{f'{unit} rms':>12}{'upper limit':>13}{'power':>8}{'runs':>8}",
    ]
    lines += [_row(e) for e in found.effects]
    if any(not e.effect.mechanical for e in found.effects):
        lines.append("  * effect of the measurement, not physics: no torque")
    if any(math.isnan(e.upper_limit) for e in found.effects):
        lines.append("  'found': significant in these recordings, no upper limit; run `gyrotrack diagnose`")
    absorbed = [e.effect.name for e in found.effects if e.absorbed]
    if absorbed:
        lines += textwrap.wrap(
            f"absorbed by the model, no limit: {', '.join(absorbed)}",
            _WIDTH,
            initial_indent="  ",
            subsequent_indent="    ",
        )
    if found.classes:
        lines += ["", "indistinguishable near these limits:"]
        for c in found.classes:
            lines += textwrap.wrap(", ".join(c), _WIDTH, initial_indent="  ", subsequent_indent="    ")
    if found.next_run is not None:
        lines += ["", *textwrap.wrap(f"next run: {found.next_run.sentence}", _WIDTH)]
        lines += textwrap.wrap(_possible(found.next_run.bounds), _WIDTH)
    return "\n".join(lines)


def _row(e: EffectLimits) -> str:
    star = "" if e.effect.mechanical else " *"
    if e.absorbed:
        return f"  {e.effect.name + star:<28}{'-':>18}{'-':>12}{'-':>13}{'-':>8}{'-':>8}"
    limit = f"{e.strength} = {e.detection_limit:.2g}"
    torque = f"{e.detection_torque:.1e}" if math.isfinite(e.detection_torque) else "-"
    upper = "found" if math.isnan(e.upper_limit) else f"{e.upper_torque:.1e}" if e.effect.mechanical else "-"
    power = f"{100 * e.power:.0f} %" if math.isfinite(e.power) else "-"
    runs = (
        "-"
        if math.isnan(e.runs_needed)
        else ">10000"
        if math.isinf(e.runs_needed)
        else f"{e.runs_needed:.0f}"
    )
    return f"  {e.effect.name + star:<28}{limit:>18}{torque:>12}{upper:>13}{power:>8}{runs:>8}"


def _possible(b: Bounds) -> str:
    """Return the bounds of the proposed run in words."""
    parts = []
    if b.omega_rotor[1] > 0:
        parts.append(
            f"rotor {b.omega_rotor[0]:.0f} to {b.omega_rotor[1]:.0f} rad/s"
            + (" in either sense" if b.reversible else "")
        )
    parts.append(f"casing {b.omega_casing[0]:.0f} to {b.omega_casing[1]:.0f} rad/s")
    parts.append(f"duration {b.duration[0]:.0f} to {b.duration[1]:.0f} s")
    if b.inertia_casing[1] > 1:
        parts.append(f"inertia of the casing up to {b.inertia_casing[1]:g} times the present one")
    if b.touchpoint[0] != 1 or b.touchpoint[1] != 1:
        parts.append(
            f"friction at the touch point {b.touchpoint[0]:.2g} to {b.touchpoint[1]:.2g} times the present one"
        )
    return f"Taken as possible: {', '.join(parts)} (change with --bound)."
