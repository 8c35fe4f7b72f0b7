"""Names of cases in tables: short and different; as LaTeX text without commands, every character printed."""

import re

import pytest

from fitting.paper import _tables


@pytest.mark.parametrize(
    ("name", "latex"),
    [
        ("a_b & 50% #1 $x$", r"a\_b \& 50\% \#1 \$x\$"),
        (r"{y} \z ~^", r"\{y\} \textbackslash{}z \textasciitilde{}\textasciicircum{}"),
        (
            "<script>alert(1)</script>",
            r"\textless{}script\textgreater{}alert(1)\textless{}/script\textgreater{}",
        ),
        ("a|b", r"a\textbar{}b"),
    ],
)
def test_names_are_text(name, latex):
    assert _tables._escaped(name) == latex


def test_special_characters_are_escaped():
    written = _tables._escaped("".join(chr(c) for c in range(32, 127)))
    rest = re.sub(r"\\text[a-z]+\{\}|\\[&%$#_{}]", "", written)
    assert not set(rest) & set("&%$#_{}\\~^<>|")


@pytest.mark.parametrize(
    ("labels", "names"),
    [
        (["steel", "teflon 12"], ["steel", "teflon "]),
        (["joint_p1", "joint_p2"], ["…int_p1", "…int_p2"]),
        (["table1a", "table1b"], ["table1a", "table1b"]),
        (["2026-01-a-by-hand", "2026-01-b-by-hand"], ["case 1", "case 2"]),
    ],
)
def test_long_labels_are_shortened_to_different_names(labels, names):
    assert _tables._short_names(labels) == dict(zip(labels, names, strict=True))
