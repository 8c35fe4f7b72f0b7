"""Every number of tracking and of fitting states its unit, meaning and origin, and no one escapes."""

import ast
import importlib
import importlib.util
import json
import re
from collections.abc import Mapping
from dataclasses import FrozenInstanceError, fields, is_dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from fitting._settings import ORIGINS, fitting_settings, settings_of
from gyrotrack._tracking_settings import PACKAGES, tracking_settings

ROOT = Path(__file__).parents[1]
fitting_settings, tracking_settings = (
    cache(fitting_settings),
    cache(tracking_settings),
)  # they parse all modules
COLLECTED = {
    "tracking": (tracking_settings, PACKAGES, 500),
    "fitting": (fitting_settings, ("fitting",), 500),
}


@pytest.fixture(scope="module", params=COLLECTED)
def kind(request):
    return request.param


@pytest.fixture(scope="module")
def settings(kind):
    return COLLECTED[kind][0]()


def flat(value):
    """Yield the parts of a value that are neither containers nor arrays; a table of characters is one part."""
    if isinstance(value, Mapping) and all(isinstance(k, str) for k in value):
        value = list(value.values())
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple | range):
        for part in value:
            yield from flat(part)
    else:
        yield value


def numbers(value):
    """Return a number, or several, as an array; None for anything else."""
    parts = list(flat(value))
    known = [isinstance(p, int | float | np.number) and not isinstance(p, bool) for p in parts]
    return np.array(parts, dtype=float) if known and all(known) else None


def assigned(body):
    """Yield the names that a module assigns outside of functions and classes."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            continue
        for part in ast.walk(node):
            if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store):
                yield part.id


def tables(module, body):
    """Yield the names and values of the defaults of dataclasses whose fields all have numbers as defaults."""
    for node in body:
        own = getattr(module, node.name, None) if isinstance(node, ast.ClassDef) else None
        if is_dataclass(own) and all(numbers(f.default) is not None for f in fields(own)):
            yield from ((f"{own.__name__}.{f.name}", numbers(f.default)) for f in fields(own))


def constants(packages):
    """Return the value of every numeric constant of packages by (module, name)."""
    found = {}
    for package in packages:
        for path in sorted((ROOT / package.replace(".", "/")).rglob("*.py")):
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            module = importlib.import_module(name.removesuffix(".__init__"))
            body = ast.parse(path.read_text(encoding="utf-8")).body
            every = [(n, numbers(getattr(module, n, None))) for n in assigned(body)]
            every += tables(module, body)
            found |= {(module.__name__, n): value for n, value in every if value is not None}
    return found


@pytest.mark.slow
def test_no_number_escapes_and_each_value_is_that_of_the_module(kind, settings):
    _, packages, least = COLLECTED[kind]
    expected = constants(packages)
    assert len(expected) > least
    assert [(s.module, s.name) for s in settings] == list(dict.fromkeys((s.module, s.name) for s in settings))
    assert {(s.module, s.name) for s in settings} == set(expected)
    for s in settings:
        np.testing.assert_array_equal(numbers(s.value), expected[s.module, s.name], err_msg=s.name)


def test_each_number_has_unit_meaning_and_origin(settings):
    for s in settings:
        kind, _, reason = s.origin.partition(": ")
        assert kind in ORIGINS, s
        assert min(len(s.unit.strip()), len(reason.strip())) > 0, s
        assert len(s.meaning) > 5, s
        assert s.meaning[0].isupper() or s.meaning[0].isdigit(), s


def test_settings_are_immutable(settings):
    with pytest.raises(FrozenInstanceError):
        settings.settings[0].value = 1.0
    several = next(s.value for s in settings if isinstance(s.value, Mapping))
    with pytest.raises(TypeError):
        several["red"] = 0.0


def test_settings_as_json(settings):
    rows = json.loads(json.dumps(settings.to_json(), allow_nan=False))
    assert [r["name"] for r in rows] == [s.name for s in settings]


def test_settings_of_tracking_as_text_and_as_json():
    settings = tracking_settings()
    text = str(settings)
    straight = (
        "  STRAIGHT = 4 [1]\n    Smallest curvature of a path that determines a hub, in standard uncertainties\n"
        "    chosen: a smaller value gives hubs with an unbounded uncertainty, a larger one refuses short arcs"
    )
    section = text.split("\n\ngyrotrack.tracking._pivot\n")[1].split("\n\n")[0]
    assert straight in section
    assert "red 108, orange 138" in text
    own = {r["name"]: r for r in settings.to_json() if r["module"] == "gyrotrack.tracking._polar"}
    assert own["CHROMA_SHIFT"]["value"] == [0.0, 0.5]
    assert own["CHROMA_SHIFT"]["unit"] == "px"


def test_settings_of_fitting_as_text_and_as_json():
    settings = fitting_settings()
    section = str(settings).split("\n\nfitting._criteria\n")[1].split("\n\n")[0]
    assert section.startswith(
        "  Criteria.significance = 0.03 [1]\n    Family-wise p-value below which a candidate is significant\n"
        "    source: Westfall & Young 1993; "
    )
    rows = {(r["module"], r["name"]): r["value"] for r in settings.to_json()}
    assert len(rows["fitting.inference._process_noise", "_GRID"]) == 32
    assert rows["fitting.inference._case_data", "_OSCILLATION_BLOCKS"][-1] == ["inf", [12, 50, 126]]
    grid = next(s for s in settings if (s.module, s.name) == ("fitting.inference._process_noise", "_GRID"))
    assert grid.value_text == "(0, 0.1, ..., 100000)"


def module_of(folder, text):
    path = folder / "numbers_of_a_test.py"
    path.write_text(text, encoding="utf-8")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


DESCRIBED = '"""Size of a thing [px]. Chosen: a smaller value\nloses it."""\n'


def test_descriptions_are_read_from_the_text_below_a_number(tmp_path):
    text = f"WORDS = ('a', 'b')\nYES = True\nSIZE: float = 2.5\n{DESCRIBED}SIZES = (1, (2, 3))\n{DESCRIBED}"
    one, other = settings_of(module_of(tmp_path, text))
    assert (one.name, one.value, one.value_text, one.unit) == ("SIZE", 2.5, "2.5", "px")
    assert (one.meaning, one.origin) == ("Size of a thing", "chosen: a smaller value loses it")
    assert (other.value, other.value_text) == ((1, (2, 3)), "(1, (2, 3))")


def test_the_fields_of_a_table_are_settings(tmp_path):
    head = "from dataclasses import dataclass\n\n@dataclass\n"
    described = f"{head}class Table:\n    size: float = 2.5\n    {DESCRIBED}"
    (size,) = settings_of(module_of(tmp_path, described))
    assert (size.name, size.value, size.unit) == ("Table.size", 2.5, "px")
    with pytest.raises(LookupError, match=r"numbers_of_a_test\.Table\.size lacks"):
        settings_of(module_of(tmp_path, f"{head}class Table:\n    size: float = 2.5\n"))
    assert not settings_of(module_of(tmp_path, f"{head}class Row:\n    name: str\n    size: float = 2.5\n"))


@pytest.mark.parametrize(
    "below",
    [
        "",
        "# Size of a thing [px]. Chosen: a smaller value loses it.\n",
        '"""Size of a thing. Chosen: a smaller value loses it."""\n',
        '"""Size of a thing [px]. Taken: a smaller value loses it."""\n',
        '"""Size of a thing [px]. Chosen: ."""\n',
        '"""[px]. Chosen: a smaller value loses it."""\n',
        f"OTHER = 'text'\n{DESCRIBED}",
    ],
)
def test_a_number_without_a_description_is_named(tmp_path, below):
    with pytest.raises(LookupError, match=r"numbers_of_a_test\.SIZE lacks its unit, meaning or origin"):
        settings_of(module_of(tmp_path, f"SIZE = 3\n{below}"))
    with pytest.raises(LookupError, match=r"\.SIZE lacks"):
        settings_of(module_of(tmp_path, f"SIZE, B = 3, 4\n{below}"))


def stated(page):
    """Return the value of each number on a page, by module and name."""
    found, module = {}, ""
    for line in page.read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            module = line.removeprefix("## ")
        elif line.startswith("| `"):
            name, value = (c.strip().replace("\\|", "|") for c in re.split(r"(?<!\\)\|", line)[1:3])
            found[module, name.strip("`")] = value
    return found


def test_each_number_has_the_value_of_its_page(kind, settings):
    """A changed number alters results: it is changed on purpose, with its page (`python docs/make_settings.py`)."""
    page = stated(ROOT / "docs" / "reference" / f"{kind}_settings.md")
    made = {(module, s.name): s.value_text for module, own in settings.by_module().items() for s in own}
    changed = {k: (page.get(k), made.get(k)) for k in {*page, *made} if page.get(k) != made.get(k)}
    assert not changed
    assert len(page) > 500
