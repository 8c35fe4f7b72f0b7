"""The contract of the command line: what goes where, which exit code, and no traceback."""

import ast
import importlib
import inspect
import json
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

import gyrotrack
from gyrotrack import DatasetError
from gyrotrack.apps.cli._app import COMMANDS, run
from gyrotrack.apps.cli._output import Output, running
from gyrotrack.apps.cli._settings import Entry, function_of, lazy_group, load


@pytest.fixture
def failing(monkeypatch):
    """Make `gyrotrack info` raise what the test wants."""

    def make(error):
        def raise_it(*args, **kwargs):
            raise error

        monkeypatch.setattr("gyrotrack.io._contents.inspect_file", raise_it)

    return make


class FittingError(Exception):
    """Stands for the errors of the fitting package, which share no ancestor with ours."""

    code = "fit"
    exit_code = 1
    message = "The fit has no data."
    hint = "Give it some."


def test_help_lists_every_command_and_imports_nothing_heavy():
    start = time.process_time()
    code = (
        "import sys; from gyrotrack.apps.cli._app import run; run(['--help']); "
        "heavy = {'numpy', 'scipy', 'h5py', 'cv2', 'av', 'matplotlib', 'pydantic', 'rich'}; "
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
    for entry in COMMANDS:
        assert f"  {entry.name} " in done.stdout
    assert max(len(line) for line in done.stdout.splitlines()) <= 80
    assert time.process_time() - start < 5


@pytest.mark.parametrize("entry", COMMANDS, ids=lambda entry: entry.name)
def test_every_command_exists_and_explains_itself(entry, capsys):
    assert entry.help.split()[0].rstrip(".,:") == inspect.getdoc(function_of(entry)).split()[0].rstrip(".,:")
    assert run([entry.name, "--help"]) == 0
    said = capsys.readouterr()
    assert "--json" in said.out
    assert said.err == ""


def test_only_the_command_line_knows_typer_and_rich():
    for path in Path(gyrotrack.__file__).parent.rglob("*.py"):
        if "cli" in path.parts:
            continue
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)) if re.search(r"\b(typer|rich|click)\b", text) else ():
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not {name.partition(".")[0] for name in names} & {"typer", "rich", "click"}, path


def test_version(capsys):
    assert run(["--version"]) == 0
    assert capsys.readouterr().out.splitlines()[0] == f"gyrotrack {gyrotrack.__version__}"


def test_nothing_asked_is_wrong_usage_with_help(capsys):
    assert run([]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert "Usage: gyrotrack" in said.err


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (["ifno", "x"], "Did you mean 'info'?"),
        (["info"], "Missing argument"),
        (["info", "x", "--colour"], "No such option"),
        (["info", "x", "y"], "unexpected extra argument"),
        (["--nothing"], "No such option"),
    ],
)
def test_wrong_usage(arguments, match, capsys):
    assert run(arguments) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert match in said.err
    assert said.err.startswith("error: ")
    assert " hint: See `gyrotrack" in said.err
    assert run([*arguments, "--json"]) == 2
    said = capsys.readouterr()
    assert said.err == ""
    error = json.loads(said.out)["error"]
    assert error["code"] == "usage"
    assert match in error["message"]


@pytest.mark.parametrize("error", [DatasetError("It is bad.", "Mend it."), FittingError()])
def test_told_errors(failing, error, capsys):
    failing(error)
    assert run(["info", "x"]) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err == f"error: {error.message}\n hint: {error.hint}\n"
    assert run(["info", "--json", "x"]) == 1
    said = capsys.readouterr()
    assert json.loads(said.out) == {
        "error": {"code": error.code, "message": error.message, "hint": error.hint}
    }


def test_a_bug_is_one_sentence_and_debug_shows_the_traceback(failing, capsys):
    failing(ZeroDivisionError("division by zero"))
    assert run(["info", "x"]) == 1
    said = capsys.readouterr().err
    assert "Traceback" not in said
    assert "Internal error" in said
    assert "--debug" in said
    for arguments in (["--debug", "info", "x"], ["info", "x", "--debug"]):
        assert run(arguments) == 1
        assert "Traceback" in capsys.readouterr().err


def test_a_bug_under_json_is_json(failing, capsys):
    failing(ZeroDivisionError("division by zero"))
    assert run(["info", "x", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["error"]["code"] == "bug"


def test_interrupted(failing, capsys):
    failing(KeyboardInterrupt())
    assert run(["info", "x"]) == 130
    assert capsys.readouterr().err == "error: Interrupted.\n"


def test_out_of_memory(failing, capsys):
    failing(MemoryError())
    assert run(["info", "x"]) == 1
    assert "not enough memory" in capsys.readouterr().err


def test_a_reader_that_leaves_early_is_not_an_error():
    code = "from gyrotrack.apps.cli._start import main; main()"
    command = [sys.executable, "-c", code, "--help"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        assert process.stderr.read() == b""


def test_a_command_can_say_not_to_be_trusted(monkeypatch):
    module = importlib.import_module("gyrotrack.apps.cli._data")
    monkeypatch.setattr(module, "info_command", lambda: 3)
    assert run(["info"]) == 3


def test_adding_a_command_is_one_line():
    entry = Entry("info", "_data", "Section", "Line.")
    group = lazy_group((entry,))
    assert group.__mro__[1].__name__ == "TyperGroup"
    assert load(entry).name == "info"


class TestOutput:
    def test_data_and_messages_part(self, capsys):
        out = Output()
        out.show("the result")
        out.note("on the way")
        out.detail("a detail")
        out.warn("careful")
        out.result({"a": 1})
        said = capsys.readouterr()
        assert said.out == "the result\n"
        assert said.err == "on the way\nwarning: careful\n"

    def test_quiet_and_verbose(self, capsys):
        Output(quiet=True).note("no")
        Output(quiet=True).warn("careful")
        Output(verbose=True).detail("a detail")
        assert capsys.readouterr().err == "warning: careful\na detail\n"

    def test_json_is_one_document_with_null_for_what_is_not_finite(self, capsys):
        np = pytest.importorskip("numpy")
        out = Output(as_json=True)
        with running(()):
            out.show("not printed")
            out.result(
                {"a": np.float64("nan"), "b": np.arange(3), "c": Path("x"), "d": (float("inf"), np.int64(2))}
            )
        said = capsys.readouterr().out
        assert json.loads(said) == {"a": None, "b": [0, 1, 2], "c": "x", "d": [None, 2]}

    def test_brackets_and_colons_are_printed_as_they_are(self, capsys):
        Output().show("t [s] [/] :smile: [bold]x")
        assert capsys.readouterr().out == "t [s] [/] :smile: [bold]x\n"

    def test_no_bar_without_a_terminal(self, capsys):
        with Output().progress("work") as progress:
            progress(1, 2)
        assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("command", "defaults"),
    [
        ("import", {"likelihood": 0.6, "surface": "", "keep_all": False, "start_u": None}),
        ("spindown", {"likelihood": 0.6, "keep_all": False, "label": ""}),
        ("extract", {"times": "auto", "workers": None, "resume": False}),
        ("fit", {"loss": "linear", "rotor": "windows", "joint": False, "hold_out": False}),
        (
            "simulate",
            {"strength": 0.01, "omega_rotor": 900.0, "omega_casing": 5.0, "duration": 200.0, "window_length": 3.0,
             "casing_fps": 260.0, "rotor_fps": 1000.0, "sigma": 1e-3, "torque_noise": 0.0, "torque_time": 1.0,
             "centre_offset": 0.0, "seed": 0},
        ),
        ("batch", {"until": "report", "model": "reduced", "timeout": 7200.0, "improve": False}),
        ("certify", {"n": None, "film": False, "seed": 0}),
    ],
)  # fmt: skip
def test_defaults_of_options_are_those_of_the_manual(command, defaults):
    """The help and the page of the command line show these values; a change alters results."""
    import inspect

    from gyrotrack.apps.cli._app import COMMANDS
    from gyrotrack.apps.cli._settings import function_of

    (entry,) = [c for c in COMMANDS if c.name == command]
    found = inspect.signature(function_of(entry)).parameters
    assert {k: found[k].default for k in defaults} == defaults
