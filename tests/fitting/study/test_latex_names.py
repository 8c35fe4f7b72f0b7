"""Names of cases as LaTeX text: no commands, and every character is printed."""

import re

import pytest

from fitting.study._scan_tables import _escaped


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
    assert _escaped(name) == latex


def test_special_characters_are_escaped():
    written = _escaped("".join(chr(c) for c in range(32, 127)))
    rest = re.sub(r"\\text[a-z]+\{\}|\\[&%$#_{}]", "", written)
    assert not set(rest) & set("&%$#_{}\\~^<>|")
