"""Every number of tracking, video and synchronisation states its unit, meaning and origin, and no one escapes."""

import ast
import importlib
import importlib.util
import json
from collections.abc import Mapping
from dataclasses import FrozenInstanceError
from pathlib import Path

import numpy as np
import pytest

import gyrotrack
from gyrotrack._tracking_settings import ORIGINS, PACKAGES, settings_of, tracking_settings

ROOT = Path(gyrotrack.__file__).parent


@pytest.fixture(scope="module")
def settings():
    return tracking_settings()


def numbers(value):
    """Return a number, or several, as an array; None for anything else."""
    if isinstance(value, Mapping):
        value = list(value.values())
    try:
        array = np.asarray(value)
    except ValueError:
        return None
    return array if array.size and array.dtype.kind in "iuf" else None


def assigned(body):
    """Yield the names that a module assigns outside of functions and classes."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            continue
        for part in ast.walk(node):
            if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store):
                yield part.id


def constants():
    """Return the value of every numeric constant of the packages by (module, name)."""
    found = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package.partition(".")[2]).rglob("*.py")):
            name = ".".join(["gyrotrack", *path.relative_to(ROOT).with_suffix("").parts])
            module = importlib.import_module(name.removesuffix(".__init__"))
            for constant in assigned(ast.parse(path.read_text(encoding="utf-8")).body):
                value = numbers(getattr(module, constant, None))
                if value is not None:
                    found[module.__name__, constant] = value
    return found


def test_no_number_escapes_and_each_value_is_that_of_the_module(settings):
    expected = constants()
    assert len(expected) > 500
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
    hues = next(s.value for s in settings if s.name == "_HUE_DEGREES")
    with pytest.raises(TypeError):
        hues["red"] = 0.0


def test_settings_as_text_and_as_json(settings):
    text = str(settings)
    straight = (
        "  STRAIGHT = 4 [1]\n    Smallest curvature of a path that determines a hub, in standard uncertainties\n"
        "    chosen: a smaller value gives a hub with an unbounded uncertainty, a larger one refuses short arcs"
    )
    section = text.split("\n\ngyrotrack.tracking._pivot\n")[1].split("\n\n")[0]
    assert straight in section
    assert "red 108, orange 138" in text
    rows = json.loads(json.dumps(settings.to_json(), allow_nan=False))
    assert [r["name"] for r in rows] == [s.name for s in settings]
    own = {r["name"]: r for r in rows if r["module"] == "gyrotrack.tracking._polar"}
    assert own["CHROMA_SHIFT"]["value"] == [0.0, 0.5]
    assert own["CHROMA_SHIFT"]["unit"] == "px"


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
