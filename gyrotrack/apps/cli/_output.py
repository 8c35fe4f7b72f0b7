"""Output of the commands: results to stdout, messages to stderr; fits, diagnoses and histories as text.

With ``--json`` stdout contains one JSON document and nothing else, also if the command fails. Progress bars are drawn
only if stderr is a terminal and none of ``--json``, ``-q`` and NO_COLOR is set.
"""

from __future__ import annotations

import io
import json
import math
import os
import re
import shlex
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from itertools import pairwise
from time import monotonic
from typing import TYPE_CHECKING, Any

from fitting._numbers import interval, rounded, speed, speed_unit
from gyrotrack._errors import OutputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from rich.console import Console

    from fitting.discovery._select import Candidate
    from fitting.discovery._verdict import Diagnosis
    from fitting.inference._profile import Interval
    from fitting.inference._record import Record
    from fitting.inference._result import Fit
    from fitting.paper._scan import Predicted
    from fitting.study._preparation import CurveBias

# control characters (C0 and C1) except line feed and tab; characters that reorder or hide text; line separators
_COMMANDS = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b\u200e\u200f\u2028\u2029\u202a-\u202e\u2060-\u2069\ufeff]"
)


def printable(text: str) -> str:
    r"""Return `text` with control and direction characters escaped, for example as ``\x1b``.

    Examples
    --------
    >>> printable("a\x1b[31mb")
    'a\\x1b[31mb'
    """
    return _COMMANDS.sub(lambda found: ascii(found[0])[1:-1], text.encode("utf-8", "replace").decode())


_ARGUMENTS: ContextVar[tuple[str, ...]] = ContextVar("arguments", default=())
_RESULT: ContextVar[list[str]] = ContextVar("result")


@contextmanager
def running(arguments: Sequence[str]) -> Iterator[None]:
    """Store the arguments of the command that runs within the context, and print its JSON document at the end.

    After an error, only the document of the error is printed.
    """
    token, result = _ARGUMENTS.set(tuple(arguments)), _RESULT.set([])
    try:
        yield
        _print("".join(_RESULT.get()))
    finally:
        _ARGUMENTS.reset(token)
        _RESULT.reset(result)


def command_line() -> str:
    """Return the command line, quoted for a shell."""
    return shlex.join(["gyrotrack", *_ARGUMENTS.get()])


DONE = 0
FAULT = 1
USAGE = 2
NOT_TRUSTED = 3
INTERRUPTED = 130
HUNG_UP = 129
TERMINATED = 143

Progress = Callable[[int, int | None], None]


@dataclass(frozen=True)
class Output:
    """Output of one command, controlled by ``--json``, ``-q`` and ``-v``."""

    as_json: bool = False
    quiet: bool = False
    verbose: bool = False

    def result(self, document: Mapping[str, Any]) -> None:
        """Print the result as JSON when the command ends; without ``--json`` nothing is printed (see `show`)."""
        if self.as_json:
            _RESULT.get().append(_json(document))

    def show(self, *renderables: Any) -> None:
        """Print the result as text or renderables of rich; with ``--json`` nothing is printed."""
        if not self.as_json:
            text = io.StringIO()
            console = _console(sys.stdout, text)
            for item in renderables:
                console.print(printable(item) if isinstance(item, str) else item)
            _print(text.getvalue())

    def note(self, text: str) -> None:
        """Print a progress message."""
        if not self.quiet:
            _write(text)

    def detail(self, text: str) -> None:
        """Print a message with ``-v`` only."""
        if self.verbose and not self.quiet:
            _write(text)

    def warn(self, text: str) -> None:
        """Print a warning; also with ``-q``."""
        _write(f"warning: {text}", style="yellow")

    @contextmanager
    def progress(self, label: str, unit: str = "") -> Iterator[Progress]:
        """Yield a callback (done, total) that draws a progress bar, or does nothing without a terminal.

        With a `unit` the bar also shows the rate. With ``GYROTRACK_PROGRESS=json`` in the environment the progress is
        written to stderr as JSON lines ``{"progress": {"label", "done", "total"}}``, at most five lines a second. The
        angles of tracked films are written as ``{"angles": {"body", "part", "frame", "angle"}}``.
        """
        if os.environ.get("GYROTRACK_PROGRESS") == "json":
            from gyrotrack.tracking._live_angles import angles_sent_to

            with angles_sent_to(write_angles):
                yield _json_lines(label)
            return
        if self.as_json or self.quiet or not _interactive():
            yield _ignore
            return
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bars

        left = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
        right = (TextColumn("{task.fields[rate]}"), TimeRemainingColumn())
        with Bars(*left, *right, console=_console(sys.stderr), transient=True) as bars:
            task = bars.add_task(label, total=None, rate="")

            def update(done: int, total: int | None) -> None:
                speed = bars.tasks[0].speed
                rate = f"{speed:.0f} {unit}/s" if unit and speed else ""
                bars.update(task, completed=done, total=total, rate=rate)

            yield update


def _json_lines(label: str) -> Progress:
    """Return a callback that writes progress as JSON lines."""
    latest = -math.inf

    def update(done: int, total: int | None) -> None:
        nonlocal latest
        now = monotonic()
        if now - latest >= _INTERVAL or done == total:
            latest = now
            line = {"progress": {"label": label, "done": done, "total": total}}
            sys.stderr.write(json.dumps(line) + "\n")
            sys.stderr.flush()

    return update


_INTERVAL = 0.2  # shortest time between two progress lines [s]


def write_angles(body: str, part: int, frames: NDArray[np.int64], angles: NDArray[np.float64]) -> None:
    """Write angles of frames to stderr as one JSON line. The line is so short that a pipe does not split it.

    Several processes write to the same pipe; see `gyrotrack.tracking._live_angles.Sink`.
    """
    for k in range(0, len(frames), _ANGLES):
        some = slice(k, k + _ANGLES)
        line = {"body": body, "part": part, "frame": frames[some].tolist()}
        sys.stderr.write(json.dumps({"angles": line | {"angle": angles[some].round(5).tolist()}}) + "\n")
        sys.stderr.flush()


_ANGLES = 64  # largest number of angles in a line


def duration(seconds: float) -> str:
    """Return an expected duration as text, rounded as an estimate: "40 s", "3 min" or "1.2 h"."""
    if seconds < 90:
        return f"{max(1, round(seconds))} s"
    return f"{round(seconds / 60)} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _ignore(done: int, total: int | None) -> None:
    del done, total


def _interactive() -> bool:
    return sys.stderr.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def _console(stream: Any, file: Any = None) -> Console:
    """Return a console that formats text for `stream`, and writes the text to this stream or to `file`."""
    from rich.console import Console

    terminal = stream is not None and stream.isatty()
    return Console(
        file=file or stream,
        force_terminal=terminal,
        highlight=False,
        markup=False,
        emoji=False,
        soft_wrap=not terminal,
    )


def _write(text: str, style: str | None = None) -> None:
    text = printable(text)
    if _interactive():
        _console(sys.stderr).print(text, style=style)
    else:
        sys.stderr.write(text + "\n")


def _json(document: Any) -> str:
    """Return one JSON document as text; NaN and infinities become null."""
    from pydantic_core import to_jsonable_python

    plain = to_jsonable_python(document, inf_nan_mode="null", fallback=lambda value: value.tolist())
    return json.dumps(plain, indent=2, allow_nan=False) + "\n"


class StdoutError(OutputError):
    """A result that cannot be printed; its message goes to stderr."""


def _print(text: str) -> None:
    """Write to stdout; after a system error, raise a StdoutError and discard all further output."""
    hint = "Check where the output of the command goes."
    if sys.stdout is None:
        raise StdoutError("The result cannot be printed: stdout is closed.", hint)
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        discard_stdout()
        what = f"The result cannot be printed: {(error.strerror or str(error)).lower()}."
        raise StdoutError(what, hint) from error


def discard_stdout() -> None:
    """Discard the buffered and all later output to stdout: Python would try to write it again at exit."""
    with suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def report_error(code: str, message: str, hint: str, *, as_json: bool) -> None:
    """Print an error: message and hint, or a JSON document if stdout can be written."""
    if as_json:
        document = {"error": {"code": code, "message": message, "hint": hint}}
        with suppress(OSError, StdoutError):
            _print(json.dumps(document, indent=2) + "\n")
            return
    _write(f"error: {message}", style="red")
    if hint:
        _write(f" hint: {hint}")


_BAR = 20
_CANDIDATES = 8


def fit_tables(fit: Fit, fit_id: str, intervals: Mapping[str, Interval] | None = None) -> list[str]:
    """Return a fit as text: verdict, goodness of fit, parameters."""
    from fitting.inference._first_order import first_order, first_order_lines
    from fitting.inference._result import VERDICT_TEXT, merit_lines
    from gyrotrack.apps.cli._parameters import parameter_lines

    lines = [f"fit {fit_id}: {VERDICT_TEXT[fit.verdict]}", "", *merit_lines(fit), ""]
    lines += parameter_lines(fit, intervals)
    if fit.verdict != "not_converged":
        response = first_order_lines(first_order(fit))
        lines += ["", *response] if response else []
    return ["\n".join(lines)]


def bias_tables(fit: Fit, bias: Mapping[str, CurveBias]) -> list[str]:
    """Return the bias of each parameter caused by a generated rotor curve."""
    from gyrotrack.apps.cli._parameters import in_words

    if not bias:
        return []
    lines = ["", "the same model fitted to the rotor windows instead of the generated curve:"]
    for name, b in bias.items():
        value = rounded(b.measured, b.stderr, fit.estimates[name].unit)
        lines += [f"  {in_words(fit, name)}", f"    {value}"]
        lines.append(f"    bias due to the generated curve: {b.errors:.0f} standard errors")
    return ["\n".join(lines)]


def prediction_tables(predicted: Sequence[Predicted]) -> list[str]:
    """Return the cross-validation errors of each case as text, in units of the noise; and of the casing's rate."""
    if not predicted:
        return []
    lines = ["", "each case predicted from a fit of the other cases (touch point and initial rates free):"]
    lines.append(f"{'':<12}{'casing':>10}{'rotor':>10}{'R2 casing':>12}{f'rmse [{speed_unit()}]':>14}")
    lines += [
        f"{p.label[:11]:<12}{p.casing:>10.4g}{p.rotor:>10.4g}{p.r2:>12.6f}{speed(p.rmse):>14.4g}"
        for p in predicted
    ]
    return ["\n".join(lines)]


def diagnosis_tables(d: Diagnosis, fit_id: str) -> list[str]:
    """Return a diagnosis as text: summary, lack of fit, candidate effects."""
    torque, rate = f"torque [{d.fit.torque_unit}]", f"speed [{speed_unit()}]"
    lines = [*_wrapped(d.sentence), "", f"fit {fit_id}, verdict: {_verdict(d)}"]
    if d.failures:
        lines += [
            "",
            "largest unmodelled torques:" if d.verdict == "undecided" else "significant lack of fit:",
            f"  {'case':<10}{'body':<8}{'time [s]':>16}{torque:>16}{rate:>15}{'sigma':>7}",
        ]
        for f in d.failures:
            time = " - ".join(f.times)
            lines.append(
                f"  {f.label[:9]:<10}{f.called:<8}{time:>16}"
                f"{f.residual_torque_Nm:>16.2g}{speed(f.residual_rad_s):>15.2g}{f.size_sigma:>7.0f}"
            )
        lines += _curves(d)
    shown = [c for c in d.candidates if c.score > 0][:_CANDIDATES]
    if shown:
        head = "tested, not established:" if d.verdict == "adequate" else "candidate effects:"
        lines += ["", head, *_candidate_lines(d, shown)]
    if d.next_experiment:
        lines += ["", *_wrapped(f"next experiment: {d.next_experiment}")]
    return ["\n".join(lines)]


_WORDS = 40


def _candidate_lines(d: Diagnosis, shown: Sequence[Candidate]) -> list[str]:
    """Return the candidates as a table: the name in words with its numbers, and the key beneath."""
    from fitting.discovery._select import equivalence_classes

    lines = [
        f"  {'':<{_WORDS}}{'improved':>9}{'':>9}{'false':>9}  indistin-",
        f"  {'effect':<{_WORDS}}{'chi2 by':>9}{'dBIC':>9}{'alarm':>9}  guishable",
    ]
    classes = equivalence_classes(shown)
    for c in shown:
        name = d.fit.name(c.effect)
        *first, last = textwrap.wrap(name.words + " *" * (not c.physical), _WORDS - 1) or [""]
        score, bic = (_fitting(x) if math.isfinite(x) else "-" for x in (c.score, c.delta_bic))
        lines += [f"  {text}" for text in first]
        group = classes.get(c.effect.name, "")
        lines.append(
            f"  {last:<{_WORDS}}{score:>9}{bic:>9}{c.p_value:>9.1g}  {group and f'group {group}'}".rstrip()
        )
        lines += [f"    {name.key}"] if name.key else []
    lines += textwrap.wrap(
        "false alarm: probability, for the whole list of effects.", 79, initial_indent="  "
    )
    if any(not math.isfinite(c.delta_bic) for c in shown):
        lines.append("  dBIC -: not refitted.")
    if not all(c.physical for c in shown):
        lines.append("  * measurement effect")
    return lines


def _fitting(x: float) -> str:
    """Return a score in at most eight characters."""
    return f"{x:.1f}" if abs(x) < 1e5 else f"{x:.1e}"


def _verdict(d: Diagnosis) -> str:
    if d.differs is not None:
        what = (
            f"{len(d.differs.names)} parameters differ" if d.differs.others else f"{d.differs.name} differs"
        )
        return f"no missing effect; {what} between the recordings"
    return d.verdict.replace("_", " ")


def _curves(d: Diagnosis) -> list[str]:
    """Return the unmodelled torque of each case as a sparkline, with marks below the intervals with lack of fit."""
    lines = []
    body = d.fit.problem.data[0].record.body
    # if the verdict is undecided, the intervals are not called a lack of fit: a random torque may explain them
    marked = "largest" if d.verdict == "undecided" else "lack of fit"
    for t in d.torques:
        intervals = [(f.t_start, f.t_stop) for f in d.failures if f.label == t.label and f.body == t.body]
        if t.body != "casing" or not intervals:
            continue
        start, stop = float(t.time[0]), float(t.time[-1])
        first, last = (f"{x:.0f}" for x in (start, stop)) if stop - start > 10 else interval(start, stop)
        torque = f"{t.torque.min():.2g} to {t.torque.max():.2g} {d.fit.torque_unit}"
        label = f", {t.label[:12]}" if len({x.label for x in d.torques}) > 1 else ""
        lines += [
            "",
            f"unmodelled torque on the {body}{label}, {torque}, from {first} s to {last} s:",
            f"  {sparkline(t.torque)}",
            f"  {marks(intervals, start, stop)}".rstrip() + f"  {marked}",
        ]
    return lines


def ladder_tables(steps: Sequence[dict[str, Any]], record: Record) -> list[str]:
    """Return a history of fits as text, one bar per fit; `record` is the record of any case of the fits."""
    from fitting.effects._words import change_name

    lines = [
        f"{'fit':<6}{'rmse':>9} {'misfit':>9} {'predict.':>9} {'BIC':>10} {'dBIC':>9}  {'':<{_BAR}}".rstrip(),
        "",
    ]
    sizes = [max(r["rmse_casing"], 1e-300) for r in steps]
    previous = ""
    for r, size in zip(steps, sizes, strict=True):
        bar = "#" * max(1, round(_BAR * size / max(sizes)))
        words = r.get("words") or change_name(r["added"], record.body)
        added = words or "base"
        if r.get("parent") and r["parent"] != previous:
            added += f"  (from {r['parent']})"
        previous = r["fit_id"]
        lines.append(
            f"{r['fit_id']:<6}{speed(r['rmse_casing']):>9.4g} "
            f"{_formatted(r['misfit'], '.3g'):>9} {r['held_out']:>9.3g} "
            f"{_formatted(r.get('bic'), '.1f'):>10} {r['delta_bic']:>9.1f}  {bar}"
        )
        if left := r.get("torque_left_Nm"):
            added += f"  (unmodelled torque {left:.2g} {record.torque_unit} rms)"
        lines += [f"      {line}" for line in _wrapped(added)]
        lines += [f"        {r['added']}"] if words != r["added"] else []
        if comment := ": ".join(filter(None, (r.get("name"), r.get("note")))):
            lines += [f"      {line}" for line in _wrapped(comment)]
    # the fit of lowest BIC is the reference, because the last fit may have parameters that the data do not justify
    best = min(steps, key=lambda r: r["bic"] if math.isfinite(r.get("bic") or math.nan) else math.inf)
    counted = bool(best.get("samples"))
    noise = best.get("rmse_noise")
    rmse, bic = (
        _formatted(noise if noise is None else speed(noise), ".4g"),
        _formatted(best.get("bic_noise"), ".1f"),
    )
    lines += [
        f"{'noise':<6}{rmse:>9} {1:>9} {1:>9} {bic:>10}  expected for noise alone",
        "",
        f"rmse of the angular rate of the {record.body} [{speed_unit()}]; misfit and prediction",
        "(cross-validation) error in units of the noise" + (";" if counted else ""),
        *(
            [f"{best['samples']} samples, {best['n_eff']:.0f} equivalent independent samples"]
            if counted
            else []
        ),
    ]
    return ["\n".join(lines)]


def _formatted(value: float | None, how: str) -> str:
    return "-" if value is None or math.isnan(value) else format(value, how)


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, 79)


WIDTH = 64
_BLOCKS, _ASCII = "▁▂▃▄▅▆▇█", "_.,-~=+#"


def sparkline(value: NDArray[np.float64], *, width: int = WIDTH) -> str:
    """Return a curve as one line. Each character shows the value farthest from zero in an interval.

    A space shows no value.
    """
    levels = _levels()
    n, parts = len(value), min(width, len(value))
    edges = [n * k // parts for k in range(parts + 1)] if parts else []
    chosen = [
        max(filter(math.isfinite, value[a:b].tolist()), key=abs, default=math.nan) for a, b in pairwise(edges)
    ]
    known = [c for c in chosen if math.isfinite(c)]
    if not known:
        return " " * len(chosen)
    low, span = min(known), (max(known) - min(known)) or 1.0
    return "".join(levels[min(7, int(8 * (c - low) / span))] if math.isfinite(c) else " " for c in chosen)


def marks(intervals: Sequence[tuple[float, float]], start: float, stop: float, *, width: int = WIDTH) -> str:
    """Return a line with ``^`` at intervals within the time from `start` to `stop`."""
    line = [" "] * width
    span = (stop - start) or 1.0
    for a, b in intervals:
        first, last = (int(width * (t - start) / span) for t in (a, b))
        for i in range(max(0, first), min(width - 1, last) + 1):
            line[i] = "^"
    return "".join(line)


def _levels() -> str:
    try:
        _BLOCKS.encode(sys.stdout.encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return _ASCII
    return _BLOCKS
