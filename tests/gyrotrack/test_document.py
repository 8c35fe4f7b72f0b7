"""Every fault of a file in TOML is named, with its line and key."""

import tomllib

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from gyrotrack import ConfigurationError, Profile, ProfileError
from gyrotrack._toml import line_of, read_document
from gyrotrack.tracking._profile import load

TEXT = """\
name = "x"           # 1
centre = "orbitt"

[[marker]]
name = "a"
colour = "green"
body = "rotor"

[[ marker ]]         # 9
"name" = "b c"
shade = 3
colour = "gren"
body = "rotor"
"""


def test_all_faults_at_once_with_their_lines(tmp_path):
    path = tmp_path / "p.toml"
    path.write_text(TEXT)
    with pytest.raises(ProfileError) as caught:
        load(path)
    said = caught.value.message
    for place in (
        "line 2, centre: ",
        "line 10, marker[2].name: ",
        "line 11, marker[2].shade: ",
        "line 12, marker[2].colour: ",
    ):
        assert place in said


@pytest.mark.parametrize(
    ("location", "line"),
    [
        (("a",), 1),
        (("t", "b"), 3),
        (("t", "u", "c"), 5),
        (("l", 0, "d"), 7),
        (("l", 1, "d"), 9),
        (("l", 1, "m", 0, "e"), 11),
        (("l", 1, "missing"), 8),
        (("nowhere",), None),
    ],
)
def test_lines(location, line):
    text = "a = 1\n[t]\nb = 2\n[t.u]\nc = 3\n[[l]]\nd = 4\n[[l]]\nd = 5\n[[l.m]]\ne = 6\n"
    assert line_of(text, location) == line


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"name = ", "is not valid TOML"),
        (b"\xff\xfe\x00", "cannot be read as a text file"),
        (b"a = " + b"[" * 5000, "is not valid TOML"),
        (b"#" * (2**20 + 1), "too large to be a profile"),
        (b"__proto__ = 1\n" * 1, "marker: field required"),
    ],
)
def test_what_is_not_a_document(tmp_path, content, words):
    path = tmp_path / "p.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigurationError, match=words.replace("[", r"\[")):
        read_document(path, Profile, what="profile")


def test_what_is_not_there(tmp_path):
    with pytest.raises(ConfigurationError, match="There is no profile"):
        read_document(tmp_path / "no.toml", Profile, what="profile")
    with pytest.raises(ConfigurationError, match="not a regular file"):
        read_document(tmp_path, Profile, what="profile")


_KEYS = st.from_regex(r"[a-z][a-z0-9_-]{0,6}", fullmatch=True)
_VALUES = st.recursive(
    st.integers(-9, 9) | st.booleans(),
    lambda inner: (
        st.dictionaries(_KEYS, inner, max_size=3)
        | st.lists(st.dictionaries(_KEYS, inner, min_size=1, max_size=2), min_size=1, max_size=2)
    ),
    max_leaves=8,
)


def _toml(table, path=()):
    lines = [f"{k} = {str(v).lower()}" for k, v in table.items() if not isinstance(v, dict | list)]
    for k, v in table.items():
        if isinstance(v, dict):
            lines += [f"[{'.'.join((*path, k))}]", *_toml(v, (*path, k))]
        elif isinstance(v, list):
            for one in v:
                lines += [f"[[{'.'.join((*path, k))}]]", *_toml(one, (*path, k))]
    return lines


def _leaves(value, path=()):
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    if not isinstance(value, dict | list):
        yield path, value
    for key, inner in items:
        yield from _leaves(inner, (*path, key))


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@example({"a": [{"a": 0, "b": [{"a": 0}]}, {"a": {}, "b": [{"a": 0}]}]})
@example({"a": [{"a": 0, "b": [{"a": 0}]}, {"a": {}, "b": {"a": 0}}]})
@given(st.dictionaries(_KEYS, _VALUES, max_size=4))
def test_the_line_found_holds_the_key(table):
    lines = _toml(table)
    text = "\n".join(lines)
    assert tomllib.loads(text) == table
    for location, value in _leaves(table):
        assert lines[line_of(text, location) - 1] == f"{location[-1]} = {str(value).lower()}"
