"""What the README and the documents show must exist: every command, every option, every link."""

import ast
import re
import shlex
import sys
from pathlib import Path

import pytest

from gyrotrack.apps.cli._app import COMMANDS
from gyrotrack.apps.cli._settings import load

ROOT = Path(__file__).parents[1]
PAGES = [
    ROOT / "README.md",
    ROOT / "CHANGELOG.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").rglob("*.md")),
]
ENTRIES = {entry.name: entry for entry in COMMANDS}
LANGUAGES = {"sh", "console", "text", "python", "toml", "json"}


def blocks(path):
    """Return the fenced blocks of a page as (language, text)."""
    return re.findall(r"^```(\w*)\n(.*?)^```$", path.read_text(encoding="utf-8"), re.S | re.M)


def commands(path):
    """Return every command of the program that a page shows to be typed."""
    found = []
    for language, text in blocks(path):
        text = re.sub(r"\\\n *", " ", text)
        for line in text.splitlines():
            typed = line.removeprefix("$ ") if language == "console" else line
            if (language == "sh" or line.startswith("$ ")) and re.match(r"(\S*/)?gyrotrack\b", typed):
                found.append(typed)
    return found


SHOWN = sorted({command for page in PAGES for command in commands(page)})


def test_the_quick_start_is_two_lines():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert text.count("## Quick start\n") == 1
    section = text.split("## Quick start\n", 1)[1].split("\n## ", 1)[0]
    first, second = re.findall(r"```sh\n(.*?)\n```", section, re.S)
    assert "\n" not in first + second
    assert first.endswith("gyrotrack demo")
    assert first.startswith("python3 -m venv .venv && ")
    assert second.endswith("pytest -n 2")
    assert section.count("```") == 4


def test_enough_is_shown():
    verbs = {shlex.split(c)[1] for c in SHOWN}
    assert {"extract", "sync", "import", "fit", "diagnose", "improve", "ladder", "report"} <= verbs


@pytest.mark.parametrize("command", SHOWN)
def test_a_command_that_is_shown_parses(command):
    words = shlex.split(command.split(" | ")[0], comments=True)[1:]
    if words[0].startswith("-"):
        assert words[0] in {"--help", "--version"}
        return
    assert words[0] in ENTRIES, f"there is no command {words[0]}"
    parser = load(ENTRIES[words[0]])
    # raises when an option is unknown, a number is no number, or something required is missing
    parser.make_context(words[0], words[1:], resilient_parsing=False)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_lead_somewhere(page):
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.S | re.M)
    for target in re.findall(r"\]\(([^)#\s]+)", text):
        if not target.startswith(("http", "mailto")):
            assert (page.parent / target).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_blocks_say_their_language(page):
    assert {language for language, _ in blocks(page)} <= LANGUAGES


def test_python_in_the_pages_is_python():
    shown = [text for page in PAGES for language, text in blocks(page) if language == "python"]
    assert shown
    for text in shown:
        compile(text, "README.md", "exec")


@pytest.mark.slow
def test_the_libraries_that_fitting_imports_are_named():
    """Those of the sentences after "`fitting` needs no films", and no others."""
    found = set()
    for path in (ROOT / "fitting").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
            found |= {name.partition(".")[0] for name in names}
    found -= {"fitting", *sys.stdlib_module_names}
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    sentence = re.search(r"`fitting` needs no films\. It imports (.*?)\.\n\n", text, re.DOTALL)[1]
    assert found == set(re.findall(rf"\b(?:{'|'.join(found)}|\w+(?=, |, and ))\b", sentence.lower()))
