"""LaTeX of formulas: read back by the mathematics parser of Matplotlib, and compared where form matters."""

import re

import pytest

from fitting import GENERAL, LIBRARY, Model
from fitting.effects._expression import latex, parse

BACKTICKED = re.compile(
    r"\\(?!omega|psi|varphi|varepsilon|tau|chi|left|right|frac|sqrt|mathrm|operatorname|times|dot|sin|cos|exp|log|tanh|arctan)[A-Za-z]+"
)


@pytest.fixture(scope="module")
def reader():
    mathtext = pytest.importorskip("matplotlib.mathtext")
    return mathtext.MathTextParser("path")


def sound(text, reader):
    assert text.count("{") == text.count("}")
    depth = 0
    for sign in text:
        depth += (sign == "{") - (sign == "}")
        assert depth >= 0
    assert text.count(r"\left") == text.count(r"\right")
    assert BACKTICKED.search(text) is None, "an unknown command"
    assert "--" not in text.replace(" ", "")
    assert "+-" not in text.replace(" ", "")
    reader.parse(f"${text}$")


@pytest.mark.parametrize("effect", LIBRARY.values(), ids=LIBRARY)
def test_every_law_of_the_library_is_readable(effect, reader):
    sound(latex(effect.expression), reader)
    if effect.rate is not None:
        sound(latex(effect.rate), reader)


def test_equations_of_the_general_model_are_readable(reader):
    rotor, casing, tau = Model.of((*GENERAL, "bearing.heating", "bearing.drift")).equations()
    for line in (rotor, casing, tau):
        sound(line, reader)
    assert rotor == r"I_r \dot\omega_r = -\tau_{cr} -a_{2} \omega_r \left|\omega_r\right| -a_{1} \omega_r"
    assert casing.startswith(r"I_c \dot\omega_c = \tau_{cr} -b_{1}")
    assert r"d D + f \left|D\right|^{g}" in tau
    assert r"\exp\left(-k T\right)" in tau


def test_a_model_without_bearing_still_prints():
    assert Model.of(["casing.air.linear"]).equations()[2] == r"\tau_{cr} = 0"
    assert Model.of(["casing.air.linear"]).equations({"casing"}) == (r"I_c \dot\omega_c = -b_{2} \omega_c",)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("-k*omega_c**3", r"-k \omega_c^{3}"),
        ("a1*omega_r", r"a_{1} \omega_r"),
        ("x/y", r"\frac{x}{y}"),
        ("1/x", r"\frac{1}{x}"),
        ("(x + y)*z", r"\left(x + y\right) z"),
        ("x - y", "x -y"),
        ("x*(-y)", "-x y"),
        ("(x + y)**2", r"\left(x + y\right)^{2}"),
        ("(x*y)**2", r"\left(x y\right)^{2}"),
        ("x**(y + 1)", "x^{y + 1}"),
        ("2.5e-7*x", r"2.5 \times 10^{-7} x"),
        ("sqrt(x)", r"\sqrt{x}"),
        ("abs(x)", r"\left|x\right|"),
        ("sign(x)", r"\operatorname{sgn}\left(x\right)"),
        ("heaviside(t - t0)", r"H\left(t -t_{0}\right)"),
        ("delta*temperature", "D T"),
        ("k_air*x", r"k_{\mathrm{air}} x"),
    ],
)
def test_form(text, expected, reader):
    assert latex(parse(text)) == expected
    sound(expected, reader)


@pytest.mark.parametrize(
    "text",
    [
        "-(x + y)",
        "z - (x + y)",
        "x*-(y + 1)",
        "(x + y)/(x - y)",
        "sin(-x)",
        "x**-2",
        "x/(y*z)",
        "(x/y)**2",
        "(-x)**2",
    ],
)
def test_signs_and_fractions_keep_their_meaning(text, reader):
    """Read the LaTeX back by hand-written rules and compare the values."""
    printed = latex(parse(text))
    sound(printed, reader)
    plain = printed.replace(r"\left", "").replace(r"\right", "").replace(r"\sin", "sin")
    while r"\frac" in plain:
        plain = re.sub(r"\\frac\{([^{}]*)\}\{([^{}]*)\}", r"((\1)/(\2))", plain)
    plain = re.sub(r"\^\{([^{}]*)\}", r"**(\1)", plain)
    plain = re.sub(r"(?<=[xyz)]) (?=[xyz(])", "*", plain)
    from fitting.effects._expression import Tape

    place = {"x": 1.3, "y": 0.4, "z": 2.2}
    assert Tape([parse(plain)])(place)[0] == pytest.approx(Tape([parse(text)])(place)[0])
