"""Docstrings, comments, messages, pages and names of tests are in plain English: subject, verb, object.

Each entry of `PATTERNS` is a construction that has to be read twice, with what to write instead. Texts in which it is
right are in `EXCEPTIONS`, each with its reason. `python tests/test_english.py [FILE...]` prints the findings.
"""

import ast
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MODULES = sorted(p for package in ("gyrotrack", "fitting") for p in (ROOT / package).rglob("*.py"))
TESTS = sorted(p for p in (ROOT / "tests").rglob("*.py") if p != Path(__file__))
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md")),
    *sorted(p for kind in ("*.md", "*.rst") for p in (ROOT / "docs").rglob(kind)),
]

_ONE = r"(?:a|an|the|two|several|all|each|one|such|many|some)"
PATTERNS = {
    r"so many": "the number itself, or its name",
    r"that which|those which": "a noun",
    r"(?:, |computed |serves )as (?:that|those) of": "like those of: name what is compared",
    r"in place of": "instead of",
    r"(?:is|are|was|were|be|been) told|told from": "is reported; distinguished from",
    r"tells? (?:that|which|whether|how|of)": "return, state, show",
    r"(?:cannot|can|could) tell": "distinguish",
    r"should know": "warning",
    r"(?<!there )(?:is|are|was|were) no (?!longer|more|less|better|different|sign)\w+": "is not a",
    r"(?:goes?|turns?|moves?) (?:with |to )?neither": "is not supported with; is stationary",
    r"(?:marker|markers|hub|camera|body|value)s? errs?": "has an error of",
    r"looks? alike|alike (?:parts|markers|frames)|lights? alike": "the same, equal, similar",
    r"(?:an?|no) (?:\w+ )?\w+ of (?:its|their) own": "its own, a separate",
    r"a matter of (?!course|taste)": "decided by",
    r"in vain": "needlessly",
    r"its (?:own )?learnt": "averaged from this film",
    r"from which \w+ and \w+ follow": "for",
    r"the same of": "the same for",
    r"times of (?:its|their) own": "its own times",
    r"if with|whose different": "a clause with a verb",
    r"(?:is|are) wrong with which|with which (?:fewer|more|less) of": "the one with fewer",
    r"with whose": "two sentences",
    r"asked for": "requested, required, from the option",
    r"says? so": "reports it",
    r"the regular end": "the usual way to end",
    r"another reading": "an alternative interpretation",
    r"in the course of": "during",
    r"at any score": "always",
    r"pulls? .{1,40} beyond": "prefers a value outside",
    r"no (?:physical )?reason to": "needs no",
    r"such as": "for example, like",
    r"(?:is|are|than|out|by|fits|counts|shows) rounding(?! (?:errors?|of|up|down|to))": "rounding error",
    r"(?:but|keeps|tests) rounding(?! (?:errors?|of|up|down|to))": "rounding error",
    r"(?:derivatives?|Jacobian|gradient) by (?!(?:the |an? )?(?:finite|chain|central))": "with respect to",
    r"from which on": "the smallest ... for which",
    r"(?:larger|smaller|lower|higher|difference|mean) of both": "of the two",
    r"repeat with the place": "position-dependent error",
    r"excepted": "excluded",
    r"torques? of (?:the|an) angle": "angle-dependent torque",
    r"write for example": "write, for example, ...",
    r"some (?:\d+|ten|hundred|thousand)": "about, a few hundred, several thousand",
    r"probability to": "probability of",
    r"twice too \w+": "twice as ... as necessary",
    r"(?:None|empty) also if": "the result is also ... if",
    r"over the (?:length|duration|extent|radius)(?: of (?:a|the) \w+)?(?= \[1\])": "divided by",
    r"errors? by place": "position-dependent error",
    r"at most(?= \[\w)": "largest number of, largest",
    r"(?:None|empty) if hardly": "the condition as a number",
    r"(?:body|law|rotation|edge|drift|stop|hub|step) is (?:first )?searched(?! for)": "searched for",
    r"tilted by [^.;]{1,30} against": "relative to",
    r"read ``": "parse assignments like",
    r"beside (?:a random|an? exponential|periodic noise|the sigma)": "in addition to",
    r"(?:decides?|probability of such(?: \w+){1,3}) by (?:noise|chance)": "with fewer, noise decides; caused by",
    r"inertia over (?:linear |quadratic )?\w+": "divided by",
    r"Measured: [a-z][^.;:]{2,90}: (?=\d)": "Measured: the value, then for what",
    r"(?<=[.;:] )from \w+ or more": "with eight or more",
    r"on (?:that|those) of the \w+'s": "relative to the noun",
    r"errors? says? (?:that|why|what|whether)": "is raised if, states",
    r"mend\w*|excus\w*|guess\w*|swings?|swung|nobody|torn|twins?": "correct, absorb, initial value, oscillate",
}
# the first words of a sentence that is turned round: "Of a blank disc no rotation is measurable"
INVERTED = re.compile(
    rf"(?:^|[.;:!?] )(?:Of|From|About) {_ONE} [^.,;:]{{3,60}} (?:is|are|has|have|was|were|needs?|counts?|gives?) "
)
COMMENT = re.compile(r"(?:^ *|  )#+(.*)")  # the formatter puts two spaces before a comment beside code
DEFINED = re.compile(r"\s*(?:async def|def|class) ([Tt]est\w*)")
PATTERN = re.compile(rf"\b(?:{'|'.join(PATTERNS)})\b", re.IGNORECASE)

# file: {text: reason}
EXCEPTIONS: dict[str, dict[str, str]] = {
    "gyrotrack/apps/cli/_tracking.py": {"asked for": "the same value, replaced on the screen"},
    "fitting/dynamics/_events.py": {"`guess` is a solution": "the name of an argument"},
    "gyrotrack/io/_tracker_project.py": {
        "no times of its own": "a plain sentence: the project contains none"
    },
}


def texts_of(path):
    """Return (line, text) of each docstring, message and comment of a module, or of each line of a page."""
    source = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        return [(n, line) for n, line in enumerate(source.splitlines(), 1)]
    found = [
        (node.lineno, node.value)
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]
    last = 0
    for line, code in enumerate(source.splitlines(), 1):
        if comment := COMMENT.search(code):
            text = comment[1].lstrip(": ")
            if last and line == last + 1 and code.lstrip().startswith("#"):
                found[-1] = (found[-1][0], f"{found[-1][1]} {text}")
            else:
                found.append((line, text))
            last = line
    return found


def names_of(path):
    """Return (line, words) of the tests of a file, functions and classes."""
    lines = enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
    names = ((line, m[1]) for line, text in lines if (m := DEFINED.match(text)))
    return [(line, re.sub(r"_|(?<=[a-z])(?=[A-Z])", " ", name)) for line, name in names]


def findings(texts, allowed=()):
    """Return the constructions in texts, with their lines."""
    found = []
    for line, text in texts:
        flat = " ".join(text.split())
        if any(part in flat for part in allowed):
            continue
        found += [
            f"line {line}: {flat[max(m.start() - 40, 0) : m.end() + 20]!r}"
            for pattern in (PATTERN, INVERTED)
            if (m := pattern.search(flat))
        ]
    return found


def _name(path):
    return path.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("path", [*MODULES, *PAGES], ids=_name)
def test_texts_are_plain_english(path):
    found = findings(texts_of(path), EXCEPTIONS.get(_name(path), ()))
    assert not found, found


def test_sentences_of_pages_do_not_begin_with_a_block_of_code():
    """A paragraph after a block of code has its own subject: "The command prints", not "prints"."""
    begins = re.compile(r"^```\n\n([a-z][^\n]*)", re.MULTILINE)
    found = {_name(page): begins.findall(page.read_text(encoding="utf-8")) for page in PAGES}
    assert not any(found.values()), {name: lines for name, lines in found.items() if lines}


def test_names_of_tests_are_plain_english():
    found = {_name(path): findings(names_of(path), EXCEPTIONS.get(_name(path), ())) for path in TESTS}
    assert not any(found.values()), {name: f for name, f in found.items() if f}


def test_exceptions_are_needed():
    """Each exception has a reason, and its text still exists."""
    for name, parts in EXCEPTIONS.items():
        path = ROOT / name
        texts = names_of(path) if path in TESTS else texts_of(path)
        flat = [" ".join(text.split()) for _, text in texts]
        assert all(reason and any(part in text for text in flat) for part, reason in parts.items()), name


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("Return at most so many bands.", True),
        ("Return at most `most` bands.", False),
        ("A body that turns in place of one at rest.", True),
        ("A body that turns instead of one at rest.", False),
        ("A column of rows is no clock.", True),
        ("There is no clock.", False),
        ("Of a blank disc no rotation is measurable.", True),
        ("The rotation of a blank disc is not measurable.", False),
        ("Two films cannot be told from each other.", True),
        ("a time constant of its own", True),
        ("its own time constant", False),
        ("A smaller value projects out rounding.", True),
        ("A smaller value projects out rounding errors.", False),
        ("The Jacobian by the free variables.", True),
        ("The derivatives with respect to the free variables.", False),
        ("It takes some ten fits.", True),
        ("Some tests find ten fits.", False),
        ("The larger of both counts.", True),
        ("The probability to detect an effect.", True),
        ("Fits of an end at most [1].", True),
        ("Read ``k=1``.", True),
        ("The derivatives by a finite difference.", False),
        ("Correlation time over the length of the record [1].", True),
        ("Correlation time, divided by the length of the record [1].", False),
        ("Zero where these explain all but rounding.", True),
        ("Chosen: fewer decide by noise.", True),
        ("Probability of such a remainder by noise.", True),
        ("Probability that noise causes such a remainder.", False),
        ("Moment of inertia over linear drag.", True),
        ("Measured: drawn films: 0.06 px.", True),
        ("Measured: 0.06 px in drawn films.", False),
        ("A table. From eight or more runs, steps are found.", True),
        ("A mean is computed from two or more runs.", False),
        ("The clock on that of the casing's camera.", True),
    ],
)
def test_the_linter_itself(text, found):
    assert bool(findings([(1, text)])) is found


if __name__ == "__main__":
    for file in [Path(name).resolve() for name in sys.argv[1:]] or [*MODULES, *PAGES, *TESTS]:
        shown = names_of(file) if file in TESTS else texts_of(file)
        for line in findings(shown, EXCEPTIONS.get(_name(file), ())):
            sys.stdout.write(f"{_name(file)}: {line}\n")
