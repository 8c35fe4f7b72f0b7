"""Units: laws whose unit is not that of a torque are refused."""

import pytest

from fitting import ExpressionError
from fitting.effects._effect import dimension, format_unit, parse_unit
from fitting.effects._expression import parse

UNITS = {
    "omega": "s-1",
    "t": "s",
    "k": "N m s2",
    "w": "s-1",
    "g": "1",
    "f": "N m s^g",
    "T": "K",
    "phi": "rad",
}


def of(text, g=1.3):
    units = {name: parse_unit(unit, {"g": g}) for name, unit in UNITS.items()}
    return dimension(parse(text), units, {"g": g})


@pytest.mark.parametrize(
    ("unit", "expected"),
    [
        ("N m", (1, 2, -2, 0, 0, 0)),
        ("kg m2 s-2", (1, 2, -2, 0, 0, 0)),
        ("J", (1, 2, -2, 0, 0, 0)),
        ("N m s1.5", (1, 2, -0.5, 0, 0, 0)),
        ("J K-1", (1, 2, -2, -1, 0, 0)),
        ("N m A-1", (1, 2, -2, 0, -1, 0)),
        ("N m V-1", (1, 2, -2, 0, 0, -1)),
        ("s^-1", (0, 0, -1, 0, 0, 0)),
        ("rad s-1", (0, 0, -1, 0, 0, 0)),
        ("1", (0, 0, 0, 0, 0, 0)),
        ("", (0, 0, 0, 0, 0, 0)),
    ],
)
def test_units_are_read(unit, expected):
    assert parse_unit(unit) == pytest.approx(expected)


@pytest.mark.parametrize(
    "unit", ["ft", "N*m", "m/s", "s^q", "s--1", "N m s^", "°", "kg.m", "s1.2.3", "__import__"]
)
def test_invalid_units_are_refused(unit):
    with pytest.raises(ExpressionError):
        parse_unit(unit)


@pytest.mark.parametrize(
    "unit",
    ["N m", "N m s", "N m s2", "N m s1.5", "s-1", "K-1", "1", "m", "kg", "N m K-1", "N m A-1", "N m V-1"],
)
def test_units_are_formatted_and_parsed_back(unit):
    assert parse_unit(format_unit(parse_unit(unit))) == pytest.approx(parse_unit(unit))


@pytest.mark.parametrize(
    "text",
    [
        "k*omega*abs(omega)",
        "k*omega**2*sign(omega)",
        "f*abs(omega)**g*sign(omega)",
        "k*omega**2*exp(-abs(omega)/w)",
        "k*omega**2*sin(omega*t - phi)",
        "k*w**2*heaviside(t - 3*t)",
        "k*sqrt(omega**4)",
        "f*abs(omega)**(g - 1)*omega",
        "k*omega*tanh(omega/w)/t",
    ],
)
def test_laws_with_the_unit_of_a_torque_are_accepted(text):
    assert of(text) == pytest.approx(parse_unit("N m"))


@pytest.mark.parametrize(
    "text", ["k*omega", "k*omega**3", "k*omega*t*omega", "k*omega**2*T", "f*abs(omega)*sign(omega)"]
)
def test_laws_with_another_unit_are_refused(text):
    assert of(text) != pytest.approx(parse_unit("N m"))


@pytest.mark.parametrize(
    "text",
    [
        "omega + t",
        "k*omega + 1",
        "exp(omega)",
        "sin(t)",
        "log(k)",
        "omega**t",
        "2**omega",
        "tanh(T)",
        "cos(k*omega)",
    ],
)
def test_inconsistent_units_are_refused(text):
    with pytest.raises(ExpressionError):
        of(text)


def test_the_sentence_names_both_units():
    with pytest.raises(ExpressionError, match="s-1 and s"):
        of("omega + t")
    with pytest.raises(ExpressionError, match="the argument of exp has the unit s-1"):
        of("exp(omega)")
