"""Messages and pages use the vocabulary of the glossary: no term that it replaces, no option that does not exist."""

import ast
import re
from pathlib import Path

import pytest

from gyrotrack.apps.cli._app import COMMANDS, app
from gyrotrack.apps.cli._settings import load

ROOT = Path(__file__).parents[1]
MODULES = sorted(p for package in ("gyrotrack", "fitting") for p in (ROOT / package).rglob("*.py"))
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
# term: what to write instead
REPLACED = {
    r"excus\w*": "absorb, account for",
    r"lend\w*|lent": "share",
    r"mend\w*": "candidate effect, correct",
    r"swing\w*|swung": "oscillation, sinusoidal torque",
    r"rungs?": "step, fit",
    r"sightings?": "observation",
    r"oddit\w+": "variance inflation",
    r"mementos?": "checkpoint",
    r"told apart|tell apart": "distinguish",
    r"(?:is|are|was) told": "is given",
    r"what is left|left over": "residual, remainder",
    r"held out(?! \()": "cross-validation error",
    r"time stamps?": "timestamp",
    r"guess\w*": "initial value",
    r"memor(?:ises?|ised)": "store",
    r"lies on its bound|on its bound|at the edge": "active bound",
    r"torn": "dominated",
    r"misses something": "significant lack of fit",
    r"nobody|somebody": "the subject itself",
    r"speaks? of": "contains, needs",
    r"(?<!there )is no (?:column|body|number|table|file|model)": "is not a",
    r"look-alikes?|twins?": "equivalence class",
    r"go(?:es)? about": "centre",
    r"objections?": "lack of fit",
    r"in reach": "above the detection limit",
    r"start values?": "initial value",
    r"ripples": "harmonic, residual",
    r"(?:a|one|the) ripple": "harmonic",
    r"not determined together": "degenerate",
    r"swallow\w*": "absorb",
    r"slant": "view correction",
}
PATTERN = re.compile(rf"\b(?:{'|'.join(REPLACED)})\b", re.IGNORECASE)
KEYS = {"rung"}  # of stored JSON documents
# names that a module must not have: what a stranger cannot read
NAMES = re.compile(
    r"account|any_law|asked|beside|boards|body_watch|breaks|chance|common|cover|departures|evenness|"
    r"first_search|floor|following|freed|guard|heap|helpers|intact|lack|late_starts|layout|look|"
    r"marker_watch|memento|notes|objection|oddity|pace|plain|polish|repeating|rippling|rough_speeds|"
    r"rounding|seal|sense|sharpening|sightings|slant|spool|stage|surroundings|task|unattended|utils|waves|"
    r"wish|wording"
)


def _messages(path):
    """Return the string literals of a module with their lines, without docstrings."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    return [
        (node.lineno, node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings
    ]


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_messages_use_the_terms_of_the_glossary(path):
    found = [
        f"line {line}: {match[0]!r}"
        for line, text in _messages(path)
        if text not in KEYS and (match := PATTERN.search(text))
    ]
    assert not found, found


@pytest.mark.parametrize("path", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_pages_use_the_terms_of_the_glossary(path):
    lines = path.read_text(encoding="utf-8").splitlines()
    found = [f"line {n}: {m[0]!r}" for n, line in enumerate(lines, 1) if (m := PATTERN.search(line))]
    assert not found, found


def test_names_of_modules_are_those_of_the_glossary():
    """A module is private, and named by its content."""
    assert not [p.stem for p in MODULES if NAMES.fullmatch(p.stem.strip("_"))]
    assert all(p.stem.startswith("_") for p in MODULES)


def test_pages_name_options_that_exist():
    known = {
        "--group",
        "--extra-index-url",
        "--rm",
        "--tls-ca-file",
        "--protocol",
        "--check",
        "--cov",
        "--resolution",
    }
    known |= {o for entry in COMMANDS for p in load(entry).params for o in (*p.opts, *p.secondary_opts)}
    known |= {o for p in __import__("typer").main.get_command(app).params for o in p.opts} | {"--help"}
    for path in PAGES:
        text = path.read_text(encoding="utf-8")
        stated = set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", text))
        assert stated <= known, (path.name, stated - known)
