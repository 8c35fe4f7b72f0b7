"""Commands laws and plan."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fitting._numbers import rounded, speed, speed_unit
from fitting._workers import WorkerPool
from gyrotrack._errors import UsageError
from gyrotrack.apps._study import open_study, with_ledgers
from gyrotrack.apps.cli import _settings as shared
from gyrotrack.apps.cli._output import DONE, FAULT, NOT_TRUSTED
from gyrotrack.apps.cli._settings import option

if TYPE_CHECKING:
    from fitting.comparison._comparison import Comparison
    from fitting.discovery._dependence import Dependence
    from fitting.discovery._next_run import Bounds
    from fitting.discovery._power import EffectLimits
    from fitting.law_search._laws import Law, Laws
    from fitting.planning._plan import Plan

_SHOWN = 8
_MIN_P = 1e-300


def laws_command(
    cases: shared.CaseFiles,
    *,
    beyond_library: Annotated[
        bool,
        option("--beyond-library", "Search for formulas even if an effect of the library explains the data."),
    ] = False,
    save_law: Annotated[
        tuple[str, Path] | None,
        option("--save-law NAME FILE", "Save a law under a name in a TOML file of effects."),
    ] = None,
    law: Annotated[
        int | None, option("--law N", "Number of the law for --save-law in the table; by default 1.", min=1)
    ] = None,
    picture: shared.Picture = None,
    effects: shared.EffectsFile = None,
    start: shared.From = None,
    ledger: shared.LedgerFile = None,
    force: shared.Force = False,
    out: shared.Out,
) -> int:
    """Find the law of an unmodelled torque: its variables, and formulas that describe it.

    Several cases are searched jointly. Formulas are generated from a grammar, fitted, and ranked; the result is the set
    of all formulas that the data cannot distinguish. An effect of the library that explains the data is listed first.

    Example: gyrotrack laws case1.h5 case2.h5 --save-law lab.saturation my_lab.toml
    """
    from fitting.law_search._documents import check_name, laws_document
    from fitting.law_search._documents import save_law as save
    from fitting.law_search._laws import laws

    check_picture(picture, force=force, reads=with_ledgers(cases, ledger, effects))
    if save_law is not None:
        check_name(*save_law)
    elif law is not None:
        raise UsageError("--law chooses the law that --save-law saves.", "Add --save-law NAME FILE.")
    study = open_study(cases, ledger)
    with WorkerPool() as workers, out.progress("searching for laws") as progress:
        progress(0, None)
        fit, fit_id = study.base(start)
        own = shared.own_effects(effects, study.mechanism)
        entry = study.entry(fit_id)
        known = entry.diagnosis(fit, own) if entry is not None else None
        found = laws(
            fit, own, diagnosis=known, beyond_library=beyond_library, workers=workers, progress=progress
        )
        if known is None and found.diagnosis is not None:
            study.keep_diagnosis(fit_id, found.diagnosis, own)
    written = drawn(found, picture, force=force)
    out.result(laws_document(found, fit_id))
    out.show(_laws_table(found, fit_id), *written)
    if save_law is None:
        return DONE
    (name, path), law = save_law, law or 1
    if law > len(found.laws):
        many = f"there are {len(found.laws)} laws" if found.laws else "no law was found"
        out.warn(f"Law number {law} was not saved: {many}.")
        return FAULT
    source = f"gyrotrack laws on {', '.join(fit.labels)} (fit {fit_id})"
    save(found.laws[law - 1], name, path, source)
    out.show(f"saved: {name} in {path}; add it with --effects {path} --add {name}")
    return DONE


def check_picture(picture: Path | None, *, force: bool, reads: Sequence[Path | None]) -> None:
    """Raise an error if the format of a picture is unknown, or if the picture would replace a file."""
    from gyrotrack.io._atomic import refuse_existing

    if picture is None:
        return
    if picture.suffix.lower() not in (".png", ".svg", ".pdf"):
        what = f"Unknown picture format: {picture}."
        raise UsageError(what, "Use a name that ends in one of: .png, .svg, .pdf.")
    refuse_existing(picture, force=force, reads=reads)


def drawn(found: Laws | Plan | Comparison, picture: Path | None, *, force: bool) -> list[str]:
    """Draw a result if a picture is requested, and return a confirmation line."""
    if picture is None:
        return []
    from gyrotrack.plotting._results import write_picture

    write_picture(found, picture, force=force)
    return [f"written: {picture}"]


def _laws_table(found: Laws, fit_id: str) -> str:
    """Return the result as text: summary, variables of the torque, laws, and where the laws differ."""
    lines = [*textwrap.wrap(found.sentence, 79), "", f"fit {fit_id}, verdict: {found.verdict}"]
    lines += _dependences(found.depends_on)
    torques = found.torques
    letters = {x.formula: chr(ord("a") + i % 26) for i, group in enumerate(torques) for x in group}
    unit, body = found.fit.torque_unit, found.fit.problem.data[0].record.body
    if found.laws:
        lines += [
            "",
            f"laws ({found.trials} candidates tried); the data cannot distinguish the laws with a letter,",
        ]
        lines.append("and laws with the same letter give the same torque along the recorded motion")
        lines.append(f"   {'':<3}{'dBIC':>10}{'rank':>8}{'p':>9}{'torque':>12}")
        for number, x in enumerate(found.laws[:_SHOWN], 1):
            lines += _law(number, x, found.laws[0], letters.get(x.formula, " "))
    if len(torques) > 1:
        best = torques[0][0]
        firsts = {group[0].formula for group in torques[1:]}
        lines += ["", f"where they differ from {best.formula}:"]
        for d in (d for d in best.differences if d.formula in firsts):
            lines.append(f"  {d.formula}")
            lines.append(
                f"      at most {d.torque_Nm:.1g} {unit} in {d.label}, {d.t_start:.3g} s to {d.t_stop:.3g} s, {body} "
                f"{speed(d.omega_c[0]):.3g} to {speed(d.omega_c[1]):.3g} {speed_unit()}"
            )
    if found.next_experiment:
        lines += ["", *textwrap.wrap(f"next experiment: {found.next_experiment}", 79)]
    return "\n".join(lines)


def _dependences(depends_on: tuple[Dependence, ...]) -> list[str]:
    lines = ["", "the unmodelled torque as a smooth function of:"]
    lines.append(f"  {'variable':<20}{'torque':<10}{'explains':>9}{'p':>9}")
    for d in depends_on[:_SHOWN]:
        share = f"{100 * d.explained:.1f} %"
        lines.append(f"  {d.variable.replace('*', ', '):<20}{d.body:<10}{share:>9}{_p(d.p_value):>9}")
    return lines


def _law(number: int, x: Law, best: Law, letter: str) -> list[str]:
    worse = x.penalised - best.penalised
    lines = [f"{letter} {number:>2} {x.formula}  ({x.form})"]
    lines.append(
        f"   {'':<3}{x.delta_bic:>10.1f}{'best' if worse == 0 else f'+{worse:.1f}':>8}{_p(x.p_value):>9}"
        f"{x.torque_rms_Nm:>8.2g} {x.fit.torque_unit}"
    )
    values = [
        f"{k.rpartition('.')[2]} = {rounded(e.value, e.stderr, e.unit)}" for k, e in x.estimates.items()
    ]
    return lines + textwrap.wrap(", ".join(values), 79, initial_indent="      ", subsequent_indent="      ")


def _p(p: float) -> str:
    return "<1e-300" if p < _MIN_P else f"{p:.1g}"


_WIDTH = 100
_BOUNDED = ("omega_rotor", "omega_casing", "duration", "inertia_casing", "touchpoint")


def plan_command(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            metavar="CASE.h5...|PLAN.toml",
            help="Case files, made by `sync` or `import`; or a description of planned recordings.",
        ),
    ],
    *,
    size: Annotated[
        float | None,
        option(
            "--size T",
            "Rms torque of an effect [N m] for which power and number of runs are computed; by default 1 "
            "% of the rms bearing torque.",
        ),
    ] = None,
    bound: Annotated[
        list[str] | None,
        option(
            "--bound KEY=LOW,HIGH",
            "Limits of possible runs: omega_rotor, omega_casing [rad/s], duration [s], inertia_casing, "
            "touchpoint (ratios); for example --bound omega_casing=0,60.",
        ),
    ] = None,
    picture: shared.Picture = None,
    effects: shared.EffectsFile = None,
    friction: shared.Friction = False,
    start: shared.From = None,
    ledger: shared.LedgerFile = None,
    force: shared.Force = False,
    out: shared.Out,
) -> int:
    """Compute the detection limit and the upper limit of every effect, the runs needed, and the best next run.

    A description of recordings is a TOML file; see the guide "Plan an experiment". With --friction the command also
    shows which friction laws of a contact the recording separates, and which laws a recording with reversals or a slow
    ramp would separate.

    Example: gyrotrack plan case1.h5 case2.h5 --picture plan.png
    """
    from fitting.discovery._next_run import Bounds
    from fitting.planning._documents import plan_document
    from fitting.planning._friction import friction_plan
    from fitting.planning._plan import plan, read_planned
    from gyrotrack.io._atomic import refuse_special

    described = [p for p in recordings if p.suffix.lower() == ".toml"]
    if described and len(recordings) > 1:
        what = "A description of recordings cannot be combined with other files."
        raise UsageError(what, "Give one PLAN.toml, or case files.")
    if described and (start is not None or ledger is not None):
        what = "--from and --ledger need case files; a description of recordings has no fits."
        raise UsageError(what, "Omit them.")
    if size is not None and not (0 < size < math.inf):
        what = f"--size {size:g} is not a positive torque."
        raise UsageError(what, "Give an rms torque in N m: --size 1e-6.")
    changes = _bounds(bound or ())
    check_picture(picture, force=force, reads=with_ledgers(recordings, ledger, effects))
    own = shared.own_effects(effects, friction=friction)
    with out.progress("planning") as progress:
        progress(0, None)
        if described:
            refuse_special(described[0])
            usual: Bounds | None = read_planned(described[0]).bounds if changes else None
            subject: Any = described[0]
        else:
            fit, _ = open_study(recordings, ledger).base(start)
            usual, subject = (Bounds.of(fit) if changes else None), fit
        bounds = replace(usual, **changes) if usual is not None else None
        found = plan(subject, own, size=size, bounds=bounds, progress=progress)
        laws = friction_plan(found.fit) if friction else None
    written = drawn(found, picture, force=force)
    more = {} if laws is None else {"friction": laws.document()}
    out.result(plan_document(found) | more | ({"picture": picture} if picture is not None else {}))
    lines = [] if laws is None else ["", "friction laws of a contact:"]
    for sentence in [] if laws is None else laws.sentences:
        lines += _indented(sentence)
    out.show(_plan_table(found), *lines, *written)
    return DONE if found.fit.converged else NOT_TRUSTED


def _bounds(given: Sequence[str]) -> dict[str, Any]:
    """Parse bounds like ``omega_casing=-60,60``."""
    found: dict[str, Any] = {}
    for text in given:
        key, _, pair = text.partition("=")
        words = pair.split(",")
        try:
            low, high = (float(w) for w in words)
        except ValueError:
            low, high = math.nan, math.nan
        if key not in _BOUNDED:
            what = f"--bound {text[:40]!r}: unknown quantity."
            raise UsageError(what, f"Quantities: {', '.join(_BOUNDED)}.")
        if not -math.inf < low <= high < math.inf:
            what = f"--bound {text[:40]!r} is not a pair of increasing numbers."
            raise UsageError(what, "Write --bound omega_casing=-60,60.")
        if key in {"duration", "inertia_casing", "touchpoint"} and low <= 0:
            raise UsageError(f"--bound {text[:40]!r} is not positive.", "Write --bound duration=100,400.")
        found[key] = (low, high)
    return found


def _plan_table(found: Plan) -> str:
    """Return a plan as text: limits of every effect, equivalence classes, the next run."""
    runs, unit = len(found.fit.labels), found.fit.torque_unit
    subject = "planned recording" if found.planned else "recording"
    lines = []
    if found.warning:
        lines += [*textwrap.wrap(f"warning: {found.warning}", _WIDTH), ""]
    lines += textwrap.wrap(
        f"Sensitivity of the {subject}{'s' if runs > 1 else ''} ({', '.join(found.fit.labels)}): detection limit "
        f"(power 90 % at the false-alarm rate of the search) and upper limit (95 %"
        f"{', expected' if found.planned else ''}), as rms torques along the motion; power and number of "
        f"runs for an effect of {found.size:.2g} {unit}.",
        _WIDTH,
    )
    lines += [
        "",
        f"  {'effect':<28}{'detection limit':>18}{f'{unit} rms':>12}{'upper limit':>13}{'power':>8}{'runs':>8}",
    ]
    for e in found.effects:
        name = found.fit.name(e.effect)
        lines += [f"  {name.words}", _row(e, name.key)]
    if any(not e.effect.mechanical for e in found.effects):
        lines.append("  * measurement effect, no torque")
    if any(math.isnan(e.upper_limit) for e in found.effects):
        lines.append("  found: significant in these recordings, no upper limit; run `gyrotrack diagnose`")
    absorbed = [str(found.fit.name(e.effect)) for e in found.effects if e.absorbed]
    if absorbed:
        lines += _indented(f"absorbed by the model, no limit: {'; '.join(absorbed)}")
    if found.classes:
        lines += ["", "indistinguishable near these limits:"]
        for c in found.classes:
            lines += _indented("; ".join(str(found.fit.name(n)) for n in c))
    if found.next_run is not None:
        lines += ["", *textwrap.wrap(f"next run: {found.next_run.sentence}", _WIDTH)]
        body = found.fit.problem.data[0].record.body
        lines += textwrap.wrap(_limits_of_run(found.next_run.bounds, body), _WIDTH)
    return "\n".join(lines)


def _indented(text: str) -> list[str]:
    return textwrap.wrap(text, _WIDTH, initial_indent="  ", subsequent_indent="    ")


def _row(e: EffectLimits, key: str) -> str:
    star = "" if e.effect.mechanical else " *"
    if e.absorbed:
        return f"  {key + star:<28}{'-':>18}{'-':>12}{'-':>13}{'-':>8}{'-':>8}"
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
    return f"  {key + star:<28}{limit:>18}{torque:>12}{upper:>13}{power:>8}{runs:>8}"


def _limits_of_run(b: Bounds, body: str) -> str:
    """Return the limits of the next run as a sentence."""

    def speeds(ends: tuple[float, float]) -> str:
        return f"{speed(ends[0]):.0f} to {speed(ends[1]):.0f} {speed_unit()}"

    parts = []
    if b.omega_rotor[1] > 0:
        parts.append(
            f"rotor {speeds(b.omega_rotor)}" + (" in both senses of rotation" if b.reversible else "")
        )
    parts.append(f"{body} {speeds(b.omega_casing)}")
    parts.append(f"duration {b.duration[0]:.0f} to {b.duration[1]:.0f} s")
    if b.inertia_casing[1] > 1:
        parts.append(f"inertia of the {body} up to {b.inertia_casing[1]:g} times the present value")
    if b.touchpoint[0] != 1 or b.touchpoint[1] != 1:
        where = "at the touch point" if body == "casing" else "of its support"
        parts.append(
            f"friction {where} {b.touchpoint[0]:.2g} to {b.touchpoint[1]:.2g} times the present value"
        )
    return f"Limits of the next run: {', '.join(parts)} (change them with --bound)."
