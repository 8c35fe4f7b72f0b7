"""Fits, diagnoses and histories as text."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from fitting.discovery._verdict import Diagnosis
    from fitting.inference._cross_validation import Predicted
    from fitting.inference._profile import Interval
    from fitting.inference._record import Record
    from fitting.inference._result import Fit
    from fitting.study._paper import CurveBias


_BAR = 20
_CANDIDATES = 8


def fit_tables(fit: Fit, fit_id: str, intervals: Mapping[str, Interval] | None = None) -> list[str]:
    """Return a fit as text: verdict, goodness of fit, parameters."""
    from fitting.inference._result import VERDICT_TEXT, summary_lines
    from fitting.study._serialisation import not_determined_together

    lines = [f"fit {fit_id}: {VERDICT_TEXT[fit.verdict]}", "", *summary_lines(fit)]
    for direction in not_determined_together(fit):
        parts = ", ".join(f"{n} by {100 * w:+.0f} %" for n, w in direction.items())
        lines += _wrapped(f"degenerate parameters: {parts}")
    if intervals:
        lines += ["", "95 % intervals by profile likelihood:"]
        lines += [f"  {n:<32}{_interval(i, fit.estimates[n].unit)}" for n, i in intervals.items()]
    return ["\n".join(lines)]


def _interval(i: Interval, unit: str) -> str:
    if i.lower_open and i.upper_open:
        return "no limit on either side"
    if i.lower_open:
        return f"below {i.upper:.4g} {unit}"
    if i.upper_open:
        return f"above {i.lower:.4g} {unit}"
    return f"{i.lower:.4g} to {i.upper:.4g} {unit}"


def bias_tables(fit: Fit, bias: Mapping[str, CurveBias]) -> list[str]:
    """Return the bias of each parameter caused by a generated rotor curve."""
    from fitting._numbers import rounded

    if not bias:
        return []
    lines = ["", "the same model fitted to the rotor windows instead of the generated curve:"]
    for name, b in bias.items():
        value = rounded(b.measured, b.stderr, fit.estimates[name].unit)
        lines.append(f"  {name:<32}{value}")
        lines.append(f"  {'':<32}bias by the generated curve: {b.errors:.0f} standard errors")
    return ["\n".join(lines)]


def prediction_tables(predicted: Sequence[Predicted]) -> list[str]:
    """Return the cross-validation errors of each case, in units of the noise, and of the casing rate."""
    if not predicted:
        return []
    lines = ["", "each case predicted from a fit of the others (touch point and initial rates free):"]
    lines.append(f"{'':<12}{'casing':>10}{'rotor':>10}{'R2 casing':>12}{'rmse [rad/s]':>14}")
    lines += [
        f"{p.label[:11]:<12}{p.casing:>10.4g}{p.rotor:>10.4g}{p.r2:>12.6f}{p.rmse:>14.4g}" for p in predicted
    ]
    return ["\n".join(lines)]


def diagnosis_tables(d: Diagnosis, fit_id: str) -> list[str]:
    """Return a diagnosis as text: summary, lack of fit, candidate effects."""
    torque = f"torque [{d.fit.torque_unit}]"
    lines = [*_wrapped(d.sentence), "", f"fit {fit_id}, verdict: {d.verdict.replace('_', ' ')}"]
    if d.failures:
        lines += [
            "",
            "significant lack of fit:",
            f"  {'case':<10}{'body':<8}{'time [s]':>16}{torque:>16}{'speed [rad/s]':>15}{'sigma':>7}",
        ]
        for f in d.failures:
            time = f"{f.t_start:.1f} - {f.t_stop:.1f}"
            lines.append(
                f"  {f.label[:9]:<10}{f.called:<8}{time:>16}"
                f"{f.residual_torque_Nm:>16.2g}{f.residual_rad_s:>15.2g}{f.size_sigma:>7.0f}"
            )
        lines += _curves(d)
    shown = [c for c in d.candidates if c.score > 0][:_CANDIDATES]
    if shown:
        head = "tested, not significant:" if d.verdict == "adequate" else "candidate effects:"
        lines += ["", head, f"  {'effect':<28}{'score':>9}{'dBIC':>9}{'p':>9}  class"]
        from fitting.discovery._select import equivalence_classes

        classes = equivalence_classes(shown)
        for c in shown:
            name = c.effect.name[:25] + (" *" if c.effect.kind == "measurement" else "")
            bic = f"{c.delta_bic:.1f}" if math.isfinite(c.delta_bic) else "-"
            lines.append(
                f"  {name:<28}{c.score:>9.1f}{bic:>9}{c.p_value:>9.1g}  {classes.get(c.effect.name, '')}"
            )
        if any(c.effect.kind == "measurement" for c in shown):
            lines.append("  * measurement effect")
    if d.next_experiment:
        lines += ["", *_wrapped(f"next experiment: {d.next_experiment}")]
    return ["\n".join(lines)]


def _curves(d: Diagnosis) -> list[str]:
    """Return the unmodelled torque of each case as a sparkline, with marks below the intervals with lack of fit."""
    lines = []
    body = d.fit.problem.data[0].record.body
    for t in d.torques:
        intervals = [(f.t_start, f.t_stop) for f in d.failures if f.label == t.label and f.body == t.body]
        if t.body != "casing" or not intervals:
            continue
        start, stop = float(t.time[0]), float(t.time[-1])
        torque = f"{t.torque.min():.2g} to {t.torque.max():.2g} {d.fit.torque_unit}"
        label = f", {t.label[:12]}" if len({x.label for x in d.torques}) > 1 else ""
        lines += [
            "",
            f"unmodelled torque on the {body}{label}, {torque}, from {start:.0f} s to {stop:.0f} s:",
            f"  {sparkline(t.torque)}",
            f"  {marks(intervals, start, stop)}".rstrip() + "  lack of fit",
        ]
    return lines


def ladder_tables(steps: Sequence[dict[str, Any]], record: Record) -> list[str]:
    """Return a history of fits as text, one bar per fit; `record` is the record of any of the cases."""
    lines = [
        f"{'fit':<6}{'rmse':>9} {'chi2/n':>9} {'cv error':>9} {'BIC':>10} {'dBIC':>9}  {'':<{_BAR}}".rstrip(),
        "",
    ]
    sizes = [max(r["rmse_casing"], 1e-300) for r in steps]
    previous = ""
    for r, size in zip(steps, sizes, strict=True):
        bar = "#" * max(1, round(_BAR * size / max(sizes)))
        added = r["added"] or "base"
        if r.get("parent") and r["parent"] != previous:
            added += f"  (from {r['parent']})"
        previous = r["fit_id"]
        lines.append(
            f"{r['fit_id']:<6}{r['rmse_casing']:>9.4g} {r['reduced_chi2']:>9.3g} {r['held_out']:>9.3g} "
            f"{_formatted(r.get('bic'), '.1f'):>10} {r['delta_bic']:>9.1f}  {bar}"
        )
        lines.append(
            f"      {added}"
            + (
                f"  (remainder: {r['torque_left_Nm']:.2g} {record.torque_unit})"
                if r.get("torque_left_Nm")
                else ""
            )
        )
        if comment := ": ".join(filter(None, (r.get("name"), r.get("note")))):
            lines += [f"      {line}" for line in _wrapped(comment)]
    last = steps[-1]
    counted = bool(last.get("samples"))
    lines += [
        " ".join(
            (
                f"{'noise':<6}{_formatted(last.get('rmse_noise'), '.4g'):>9} {1:>9} {1:>9}",
                f"{_formatted(last.get('bic_noise'), '.1f'):>10}  expected for noise alone",
            )
        ),
        "",
        f"rmse of the angular rate of the {record.body} [rad/s]; cross-validation error in units",
        "of the noise" + (f"; {last['samples']} samples, effectively {last['n_eff']:.0f}" if counted else ""),
    ]
    return ["\n".join(lines)]


def _formatted(value: float | None, how: str) -> str:
    return "-" if value is None or math.isnan(value) else format(value, how)


def _wrapped(text: str) -> list[str]:
    import textwrap

    return textwrap.wrap(text, 79)


Array = NDArray[np.float64]

WIDTH = 64
_BLOCKS, _ASCII = "▁▂▃▄▅▆▇█", "_.,-~=+#"


def sparkline(value: Array, *, width: int = WIDTH) -> str:
    """Return a curve as one line of characters, each for the value farthest from zero in an interval.

    A space represents an interval without finite values.
    """
    levels = _levels()
    edges = np.linspace(0, len(value), min(width, len(value)) + 1).astype(int)
    chosen = [_farthest(value[a:b]) for a, b in pairwise(edges)]
    known = np.array([c for c in chosen if np.isfinite(c)])
    if not len(known):
        return " " * len(chosen)
    low, span = float(known.min()), float(known.max() - known.min()) or 1.0
    return "".join(levels[min(7, int(8 * (c - low) / span))] if np.isfinite(c) else " " for c in chosen)


def marks(intervals: Sequence[tuple[float, float]], start: float, stop: float, *, width: int = WIDTH) -> str:
    """Return a line with ``^`` at intervals within the time from `start` to `stop`."""
    line = [" "] * width
    span = (stop - start) or 1.0
    for a, b in intervals:
        first, last = (int(width * (t - start) / span) for t in (a, b))
        for i in range(max(0, first), min(width - 1, last) + 1):
            line[i] = "^"
    return "".join(line)


def _farthest(part: Array) -> float:
    known = part[np.isfinite(part)]
    return float(known[np.argmax(np.abs(known))]) if len(known) else float("nan")


def _levels() -> str:
    try:
        _BLOCKS.encode(sys.stdout.encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return _ASCII
    return _BLOCKS
