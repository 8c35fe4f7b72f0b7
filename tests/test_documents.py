"""Pages that are made from the program must be as the program would make them now."""

import ast
import importlib.util
import re
from pathlib import Path

import h5py
import pytest

from fitting._errors import FittingError
from fitting.effects._library import LIBRARY
from gyrotrack._errors import GyrotrackError
from gyrotrack.apps.cli import _app as app

DOCS = Path(__file__).parents[1] / "docs"


def maker(name):
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["make_command_line", "make_effects", "make_format"])
def test_a_made_page_is_up_to_date(name):
    module = maker(name)
    assert module.TARGET.read_text(encoding="utf-8") == module.page(), f"run python docs/{name}.py"


def test_no_effect_is_left_out():
    rows = (DOCS / "effects.md").read_text(encoding="utf-8").splitlines()
    for name in LIBRARY:
        assert sum(row.startswith(f"| {name} | `") for row in rows) == 1, name


def test_the_tables_of_the_format_are_those_of_a_real_file(tmp_path):
    """What `simulate` writes has exactly the datasets, units and dimensions that the page lists."""
    path = tmp_path / "case.h5"
    words = ["simulate", "-o", path, "--duration", "12", "--window-length", "1"]
    assert app.run([str(w) for w in words]) == 0
    text = (DOCS / "format.md").read_text(encoding="utf-8")
    with h5py.File(path) as file:
        for group, title in (("casing", "### `/casing` of a case"), ("rotor", "### `/rotor` of a case")):
            section = text.split(title, 1)[1].split("###", 1)[0].split("| attribute |")[0]
            rows = [
                [c.strip() for c in r.split("|")[1:-1]] for r in section.splitlines() if r.startswith("| ")
            ]
            listed = {r[0]: (r[2], r[3]) for r in rows if r[0] != "dataset"}
            held = {n: (d.dtype.str[1:], d.attrs["units"]) for n, d in file[group].items()}
            assert held == listed
        for name in (
            "format",
            "format_version",
            "kind",
            "software_version",
            "created",
            "command",
            "settings",
        ):
            assert name in file.attrs
            assert f"{name}" in text


def _all_below(root):
    return [root, *(deeper for child in root.__subclasses__() for deeper in _all_below(child))]


def test_troubleshooting_leaves_no_class_of_errors_out():
    text = (DOCS / "troubleshooting.md").read_text(encoding="utf-8")
    headings = "\n".join(line for line in text.splitlines() if line.startswith("## "))
    for error in (*_all_below(GyrotrackError)[1:], *_all_below(FittingError)[1:]):
        assert f"`{error.code}`" in headings, error


def test_troubleshooting_quotes_what_the_program_says():
    """Each message in the first column of a table stands in the code (N and ... stand for anything)."""
    root = DOCS.parent
    code = "\n".join(
        p.read_text(encoding="utf-8") for d in ("gyrotrack", "fitting") for p in (root / d).rglob("*.py")
    )
    code = re.sub(r'"\s*\n\s*f?"', "", code)  # strings that go on in the next line
    code = re.sub(r"\{[^{}]*\}", "...", code)
    quoted = 0
    for row in (DOCS / "troubleshooting.md").read_text(encoding="utf-8").splitlines():
        cell = row.split("|")[1].strip() if row.startswith("| ") else ""
        if cell in {"", "you read"}:
            continue
        for piece in re.split(r";|\.\.\.|\bN\b|\bM\b|:", cell):
            assert piece.strip() in code, piece
            quoted += 1
    assert quoted > 50


def _pieces(cell):
    """Return the messages of a cell, each as the words between what stands for anything."""
    for message in cell.split(";"):
        yield [p.strip() for p in re.split(r"\.\.\.|\bN\b|\bM\b|:", message) if p.strip()]


def _own_words(node):
    """Return the text of a message with gaps, or None if it is not written where it is raised."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(v.value if isinstance(v, ast.Constant) else "..." for v in node.values)
    if isinstance(node, ast.BinOp):
        return f"{_own_words(node.left) or '...'}{_own_words(node.right) or '...'}"
    if isinstance(node, ast.IfExp):
        return f"{_own_words(node.body) or '...'}{_own_words(node.orelse) or '...'}"
    return None


def test_troubleshooting_knows_every_message():
    """Each error that is raised with words of its own has a row; those that pass another's words on need none."""
    errors = {e.__name__ for root in (GyrotrackError, FittingError) for e in _all_below(root)}
    rows = (DOCS / "troubleshooting.md").read_text(encoding="utf-8").splitlines()
    cells = [r.split("|")[1].strip() for r in rows if r.startswith("| ")]
    known = [p for c in cells if c != "you read" for p in _pieces(c) if len("".join(p)) >= 8]
    missing, seen = [], 0
    for path in (p for d in ("gyrotrack", "fitting") for p in sorted((DOCS.parent / d).rglob("*.py"))):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.args):
                continue
            words = _own_words(node.args[0]) if node.func.id in errors else None
            if words is None or len(re.sub(r"[^a-z]", "", words)) < 10:
                continue
            seen += 1
            if not any(all(piece in words for piece in pieces) for pieces in known):
                missing.append(f"{path.name}:{node.lineno}: {words}")
    assert not missing
    assert seen > 200
