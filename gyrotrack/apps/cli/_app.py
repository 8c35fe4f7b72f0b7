"""The program `gyrotrack`: its commands, and error handling.

A new command is one line in `COMMANDS` and a function ``<name>_command(...) -> int | None`` in a module of this folder.
The function parses, calls one library function, prints through `_output.Output`, and returns the exit code (None is 0).
"""

from __future__ import annotations

import errno
import os
import re
import signal
import sys
import traceback
import warnings
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext, suppress
from contextvars import ContextVar
from pathlib import Path
from types import FrameType
from typing import Annotated, Any

import typer
from typer.main import get_command

from gyrotrack.apps.cli._output import (
    DONE,
    FAULT,
    INTERRUPTED,
    USAGE,
    StdoutError,
    discard_stdout,
    report_error,
    running,
)
from gyrotrack.apps.cli._settings import Entry, Settings, find, lazy_group, read
from gyrotrack.io._command_end import marking

_DATA = "From films to data"
_PHYSICS = "From data to physics"
_ORACLE = "Tests with known answers"

COMMANDS = (
    Entry("profile", "_tracking", _DATA, "Find the markers of a film and write a profile."),
    Entry("extract", "_tracking", _DATA, "Track the markers in a film: angles with uncertainties."),
    Entry("import", "_data", _DATA, "Make a case from tables of angles, rates or points."),
    Entry("spindown", "_tracking", _DATA, "Measure one rotating body: film or table to report."),
    Entry("sync", "_tracking", _DATA, "Synchronise the clips of one experiment."),
    Entry("batch", "_batch", _DATA, "Track, fit and report many cases, unattended."),
    Entry("config", "_batch", _DATA, "Show the settings in use and their origin."),
    Entry("export", "_data", _DATA, "Export the data as CSV, Parquet or netCDF."),
    Entry("info", "_data", _DATA, "Show the contents of a file and check its integrity."),
    Entry("fit", "_fitting", _PHYSICS, "Fit a model: parameters, uncertainties, goodness of fit."),
    Entry("scan", "_fitting", _PHYSICS, "Fit every combination of the paper's terms; print its tables."),
    Entry("diagnose", "_fitting", _PHYSICS, "Locate the lack of fit and rank the missing effects."),
    Entry("improve", "_fitting", _PHYSICS, "Add effects until the residuals are consistent with noise."),
    Entry("laws", "_discovery", _PHYSICS, "Find the law of an unmodelled torque, as a set of formulas."),
    Entry("plan", "_discovery", _PHYSICS, "Compute detection limits, upper limits and the best next run."),
    Entry("budget", "_fitting", _PHYSICS, "Uncertainty budget of every parameter (GUM)."),
    Entry("certify", "_certify", _PHYSICS, "Test an answer on simulated recordings: false alarms, coverage."),
    Entry(
        "compare", "_compare", _PHYSICS, "Compare fits of runs: differences, spread, drifts, outlying runs."
    ),
    Entry("ladder", "_fitting", _PHYSICS, "List the fits of a case: one bar per fit."),
    Entry("report", "_presentation", _PHYSICS, "Write a report: one HTML page or a PDF."),
    Entry("figures", "_presentation", _PHYSICS, "Draw the paper's figures and tables of a study."),
    Entry("view", "_presentation", _PHYSICS, "Open the workbench: from films to the missing effect."),
    Entry("effects", "_fitting", _PHYSICS, "Show the library of effects."),
    Entry("demo", "_simulation", _ORACLE, "Run the whole analysis of the sample clips."),
    Entry("simulate", "_simulation", _ORACLE, "Simulate a case with chosen effects, as data or films."),
    Entry("reveal", "_simulation", _ORACLE, "Open a sealed challenge and score the answer."),
)

app = typer.Typer(
    name="gyrotrack",
    cls=lazy_group(COMMANDS),
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)


def _print_version(requested: bool) -> None:  # noqa: FBT001 - the signature of an option's callback
    if requested:
        from gyrotrack._versions import versions

        typer.echo("\n".join(f"{name} {number}" for name, number in versions().items()))
        raise typer.Exit(DONE)


@app.callback(no_args_is_help=True)
def root(
    *,
    _version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the versions.")
    ] = False,
    _config: Annotated[
        Path | None, typer.Option("--config", metavar="FILE", help="Settings file; see `gyrotrack config`.")
    ] = None,
    _rpm: Annotated[
        bool, typer.Option("--rpm", help="Print speeds in revolutions per minute; JSON stays in rad/s.")
    ] = False,
    _debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an internal error.")] = False,
) -> None:
    """From films of a spinning gyroscope to the physics that its model is missing."""


def main(last: list[Callable[[], None]]) -> None:
    """Run the program with the arguments of the command line, and exit with its exit code.

    Functions in `last` are called when the process ends, after everything else.
    """
    with suppress(OSError):
        # no file may get the descriptor of a closed standard stream
        while os.open(os.devnull, os.O_RDWR) <= _STDERR:
            pass
    if sys.stderr is None:
        sys.stderr = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 - open until the process ends
    prepare_process()
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")  # the terminal may not support every character
    code, marks = FAULT, ExitStack()

    def end() -> None:
        """End immediately.

        Remove the marks of new outputs first, because they are needed only if the process is killed.
        """
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError, AttributeError):
                stream.flush()
        marks.close()
        os._exit(code)  # otherwise Python needs a few tenths of a second to clear its modules

    last.append(end)
    marks.enter_context(marking())
    code = run(sys.argv[1:])
    sys.exit(code)


_STDERR = 2


def prepare_process() -> None:
    """Configure this process and its child processes: threads, search path, home, SIGTERM."""
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # the matrices are small and many, so that threads do not save time
    # no process imports modules from the working folder, whose content is not trusted
    os.environ["PYTHONSAFEPATH"] = "1"
    root = Path(__file__).parents[3]
    if root.name not in {"site-packages", "dist-packages"}:  # child processes must find the source checkout
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(root), os.environ.get("PYTHONPATH"))))
    if os.path.expanduser("~").startswith("~"):  # noqa: PTH111 - Path.home() raises: no $HOME and an unknown user
        os.environ["HOME"] = (
            # libraries need a home folder; this is the usual name of the folder for users without a home
            "/nonexistent"
        )
    catch_sigterm()


_TERMINATED: list[int] = []


def catch_sigterm() -> None:
    """Handle SIGTERM and a closed terminal like Ctrl-C: remove unfinished outputs; the exit code is 143 or 129."""

    def end(number: int, frame: FrameType | None) -> None:
        _TERMINATED.append(number)
        # code that defers or forwards Ctrl-C (writing a file, the workbench) must handle SIGTERM in the same way
        interrupt = signal.getsignal(signal.SIGINT)
        if callable(interrupt):
            interrupt(signal.SIGINT, frame)
        else:
            raise KeyboardInterrupt

    with suppress(ValueError):  # signals can be handled only in the main thread
        signal.signal(signal.SIGTERM, end)
        hangup = getattr(signal, "SIGHUP", None)
        # `nohup` ignores this signal, and so does the program
        if hangup is not None and signal.getsignal(hangup) == signal.SIG_DFL:
            signal.signal(hangup, end)


def _interrupted(*, as_json: bool) -> int:
    """Report an interrupt and return the exit code: 130 for Ctrl-C, 128 plus the number of another signal."""
    with suppress(OSError):  # a closed terminal cannot be written to
        report_error("interrupted", "Interrupted.", "", as_json=as_json)
    return 128 + _TERMINATED[0] if _TERMINATED else INTERRUPTED


def run(arguments: Sequence[str]) -> int:
    """Run the program with `arguments` and return its exit code; all exceptions are handled."""
    args, debug = _without("--debug", list(arguments))
    args, rpm = _without("--rpm", args)
    as_json = "--json" in _options(args)
    try:
        with warnings.catch_warnings(), marking(), running(arguments), _speeds(rpm=rpm and not as_json):
            if not debug:
                warnings.simplefilter("ignore")
            code = _with_settings(args)
    except KeyboardInterrupt:
        return _interrupted(as_json=as_json)
    except BrokenPipeError:  # the reader of stdout has ended, as in `gyrotrack ... | head`
        discard_stdout()
        return FAULT
    except StdoutError as error:
        return _report(error, as_json=False)
    except Exception as error:  # no traceback is shown to a user
        if debug:
            traceback.print_exc()
        return _report(error, as_json=as_json)
    return code if isinstance(code, int) else DONE


_SETTINGS: ContextVar[Settings] = ContextVar("settings")


def settings_in_use() -> Settings:
    """Return the settings of the running command."""
    return _SETTINGS.get()


def _with_settings(args: list[str]) -> Any:
    """Run the command with the settings file, if there is one, as its defaults."""
    path, trusted = find(_config_option(args))
    settings = read(path, COMMANDS, trusted=trusted)
    token = _SETTINGS.set(settings)
    try:
        code = get_command(app)(
            args=args, prog_name="gyrotrack", standalone_mode=False, default_map=settings.values
        )
    finally:
        _SETTINGS.reset(token)
    if code == INTERRUPTED:  # typer turns a KeyboardInterrupt into this code
        raise KeyboardInterrupt
    return code


def _config_option(args: list[str]) -> Path | None:
    """Return the value of ``--config``, which comes before the command."""
    for i, word in enumerate(args):
        if word == "--config" and i + 1 < len(args):
            return Path(args[i + 1])
        if word.startswith("--config="):
            return Path(word.partition("=")[2])
        if not word.startswith("-"):
            return None
    return None


def _report(error: Exception, *, as_json: bool) -> int:
    """Report an error in one sentence and return its exit code."""
    if hasattr(error, "format_message"):  # a usage error of typer
        return _report_usage(error, as_json=as_json)
    if isinstance(error, typer.Abort):
        return _interrupted(as_json=as_json)
    # the errors of both packages have a code, a message and a hint
    if all(isinstance(getattr(error, name, None), str) for name in ("code", "message", "hint")):
        stated: Any = error
        report_error(stated.code, stated.message, stated.hint, as_json=as_json)
        return int(getattr(stated, "exit_code", FAULT))
    if (shortage := _exhausted_resource(error)) is not None:
        report_error(*shortage, as_json=as_json)
        return FAULT
    if (refused := _refused_file(error)) is not None:
        report_error("file", refused, "Check the name, its folder and the permissions.", as_json=as_json)
        return FAULT
    if type(error).__name__ == "LinAlgError":  # an error of numpy, which is imported only where needed
        what = f"A numerical computation failed: {str(error).rstrip('.').lower()}."
        report_error(
            "numerical",
            what,
            "Check the data for outliers, their units and their uncertainties.",
            as_json=as_json,
        )
        return FAULT
    place = traceback.extract_tb(error.__traceback__)[-1]
    what = f"{type(error).__name__}: {error}".splitlines()[0].rstrip(".")
    message = f"Internal error in {os.path.basename(place.filename)} line {place.lineno}: {what}."  # noqa: PTH119
    hint = "This is a bug: run the command with --debug and report the traceback."
    report_error("bug", message, hint, as_json=as_json)
    return FAULT


def _refused_file(error: Exception) -> str | None:
    """Return the reason why the system refuses a file, as a sentence; None for another error."""
    # an error that pathlib raises before Python 3.13
    if isinstance(error, RuntimeError) and str(error).startswith("Symlink loop"):
        return f"{str(error)[:_LONGEST_NAME].rstrip('.')}."
    if not isinstance(error, OSError) or not error.strerror:
        return None
    name = error.filename
    what = os.fsdecode(name) if isinstance(name, str | bytes) else "A file" if name is None else str(name)
    return f"{what[:_LONGEST_NAME]} cannot be used: {error.strerror[0].lower()}{error.strerror[1:]}."


_LONGEST_NAME = 200  # number of characters shown of the name of a file

# code, message, hint
_LIMIT = "Raise the limit (`ulimit -{}`), or close other programs."
_SHORTER = "Close other programs, raise the memory limit, or process a shorter film."
_MEMORY = ("memory", "There is not enough memory.", _SHORTER)
_PROCESSES = ("processes", "No further process or thread can be started.", _LIMIT.format("u"))
_FILES = ("files", "No further file can be opened.", _LIMIT.format("n"))
_DISK = ("disk", "The disk is full or the quota is reached.", "Free some space and run the command again.")
_WORKER = (
    "processes",
    "A worker process could not be started, or was ended by the system.",
    "Raise the limits of memory and processes (`ulimit -v`, `ulimit -u`).",
)

# libraries report exhausted resources in many ways: MemoryError, OSError with an errno, RuntimeError("can't start new
# thread"), cv2.error, an ImportError of a shared library that cannot be mapped, a broken process pool
_BY_NUMBER = {
    errno.ENOMEM: _MEMORY,
    errno.EAGAIN: _PROCESSES,
    **dict.fromkeys((errno.EMFILE, errno.ENFILE), _FILES),
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT, errno.EFBIG), _DISK),
}
_BY_TEXT = {
    "can't (start|create) new thread|pthread_create failed": _PROCESSES,
    "too many open files": _FILES,
    "(cannot|unable to) allocate|failed to map segment|(out of|insufficient) memory|bad[_ ]alloc|memory allocation": (
        _MEMORY
    ),
    "process pool|resource temporarily unavailable": _WORKER,
}


def _exhausted_resource(error: BaseException | None) -> tuple[str, str, str] | None:
    """Return code, message and hint if an error, or one of its causes, means that a resource is exhausted."""
    for _ in range(10):
        if error is None:
            return None
        if isinstance(error, MemoryError):
            return _MEMORY
        if isinstance(error, OSError) and error.errno in _BY_NUMBER:
            return _BY_NUMBER[error.errno]
        text = f"{type(error).__name__} {error}".lower()
        for words, answer in _BY_TEXT.items():
            if re.search(words, text):
                return answer
        error = error.__cause__ or error.__context__
    return None


def _report_usage(error: Any, *, as_json: bool) -> int:
    context: Any = getattr(error, "ctx", None)
    if type(error).__name__ == "NoArgsIsHelpError":
        sys.stderr.write(context.get_help() + "\n")
        return USAGE
    path = context.command_path if context is not None else "gyrotrack"
    report_error("usage", str(error.format_message()), f"See `{path} --help`.", as_json=as_json)
    return USAGE


def _options(args: list[str]) -> list[str]:
    return args[: args.index("--")] if "--" in args else args


def _without(word: str, args: list[str]) -> tuple[list[str], bool]:
    """Remove an option of the program, which may be anywhere before ``--``; also return whether it was given."""
    head = _options(args)
    return [a for a in head if a != word] + args[len(head) :], word in head


def _speeds(*, rpm: bool) -> AbstractContextManager[None]:
    """Return the context in which speeds are printed in rpm, or in rad/s."""
    if not rpm:
        return nullcontext()
    from fitting._numbers import speeds_in

    return speeds_in("rpm")
