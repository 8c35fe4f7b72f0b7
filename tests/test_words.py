"""Messages and pages use the vocabulary of the glossary: no term that it replaces, no option that does not exist."""

import ast
import re
from functools import cache
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
# wordings of the glossary's left columns that must not be on any screen, and what to write instead
SENTENCES = {
    r"what would mend it": "candidate effects",
    r"one bar a fit|a bar a rung": "one bar per fit",
    r"as good as can be": "noise limit",
    r"run in circles": "corrupt string heap",
    r"times do not grow": "not strictly increasing",
    r"no friction does that": "negative dissipation",
    r"What it goes about|Say more on the way|Of all noise": "Centre of rotation, Verbose output, Random seed",
    r"wrong with which": "fewer co-rotating",
    r"From a place that": "if the hub is displaced by",
    r"raised if the supposed": "raised when",
    r"it errs as if": "its error behaves as if",
    r"Times this share": "multiplied by this factor",
    r"motion that is told": "motion that triggers a warning",
    r"as if the camera shakes": "suggesting camera shake",
    r"looks? alike after": "looks the same when rotated by",
    r"lamp lights alike": "taken at the same flicker phase",
    r"nothing coloured turns": "no coloured region rotates",
    r"Tell which": "return a mask of",
    r"should know": "warnings",
    r"its own learnt": "a template averaged from this film",
    r"The rest is sought|solved in vain": "look for the stop",
    r"than the torque that it shows": "for a useful upper limit",
    r"residuals pull": "the fit prefers X outside its bounds",
    r"range that has no physical reason": "an arbitrary bound",
    r"whose different values in the recordings explain": "whose per-recording values explain",
    r"need not be exact": "do not prove the form",
    r"refitted at any score": "always refitted",
    r"goes with neither": "is not supported with",
    r"the line that says so": "a confirmation line",
    r"the regular end": "Ctrl-C quits",
    r"Of a blank disc": "a blank disc cannot be tracked",
    r"no deviation smaller than its torque": "any law of similar size",
    r"(?<![Tt]here )is no (?:column|body|parameter|rotation)\b": "is not a parameter",
    r"effectively \d|effectively \{": "equivalent independent samples",
    r"\(remainder: ": "unmodelled torque, rms",
    r"\brate - 1\b(?!\))": "clock error [ppm]",
    r"added law": "difference, final minus base model",
    r"\bartefacts?\b": "measurement effect",
    r"other initial values": "same fit",
    r"Save this fit in the ledger": "Keep this fit",
    r"energy drift": "energy balance error",
    r"in the rise|in the tail": "while speeding up, while slowing down",
    r"cv error": "prediction error / noise",
    r"Missing effect:": "Missing:",
    r"its rotation explains": "tracking quality",
    r"class A\b": "indistinguishable group A",
    r"library does not have": "another law",
    r"another reading of|Another reading": "an alternative interpretation",
}
SENTENCE = re.compile("|".join(f"(?:{k})" for k in SENTENCES))
KEYS = {"rung"}  # of stored JSON documents
# names that a module must not have: what a stranger cannot read
NAMES = re.compile(
    r"account|any_law|asked|beside|boards|body_watch|breaks|chance|common|cover|departures|evenness|"
    r"first_search|floor|following|freed|guard|heap|helpers|intact|lack|late_starts|layout|look|"
    r"marker_watch|memento|notes|objection|oddity|pace|plain|polish|repeating|rippling|rough_speeds|"
    r"rounding|seal|sense|sharpening|sightings|slant|spool|stage|surroundings|task|unattended|utils|waves|"
    r"wish|wording"
)


@cache
def _messages(path):
    """Return the string literals of a module with their lines, without docstrings."""
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    docstrings = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    return [
        (node.lineno, node.value)
        for node in nodes
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


# pages of the report and the workbench, and what draws on them
SCREENS = sorted(
    p
    for kind in ("jinja", "typ", "js")
    for p in (ROOT / "gyrotrack").rglob(f"*.{kind}")
    if "vendor" not in p.parts
)


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_messages_have_no_wording_that_the_glossary_replaces(path):
    found = [f"line {line}: {m[0]!r}" for line, text in _messages(path) if (m := SENTENCE.search(text))]
    assert not found, found


@pytest.mark.parametrize("path", [*SCREENS, *PAGES], ids=lambda p: str(p.relative_to(ROOT)))
def test_screens_and_pages_have_no_wording_that_the_glossary_replaces(path):
    lines = path.read_text(encoding="utf-8").splitlines()
    found = [f"line {n}: {m[0]!r}" for n, line in enumerate(lines, 1) if (m := SENTENCE.search(line))]
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
