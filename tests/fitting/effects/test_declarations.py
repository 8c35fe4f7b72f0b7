"""Declarations of effects: errors, and derived properties."""

import math

import pytest

from fitting import Effect, EffectError, ExpressionError, Parameter
from fitting.effects._effect import State
from fitting.effects._library import find


def test_an_unknown_name_is_answered_with_similar_ones():
    with pytest.raises(EffectError, match=r"no effect named 'bearing\.heat'") as caught:
        find("bearing.heat")
    assert "bearing.heating" in caught.value.hint
    with pytest.raises(EffectError) as caught:
        find("zzzzzzzz")
    assert "gyrotrack effects" in caught.value.hint


@pytest.mark.parametrize(
    ("law", "parameters", "message"),
    [
        ("-k*omega_c", (Parameter("k", "N m s2"),), "has the unit N m s, not N m"),
        ("-k*omega_x", (Parameter("k", "N m s"),), "omega_x"),
        ("-k*q*omega_c", (Parameter("k", "N m s"),), "undeclared names: q"),
    ],
)
def test_wrong_laws_are_refused(law, parameters, message):
    with pytest.raises(EffectError, match=message):
        Effect("x", "casing", law, parameters).check()


def test_sums_of_unlike_quantities_are_refused():
    effect = Effect("x", "casing", "-k*(omega_c + t)", (Parameter("k", "N m s"),))
    with pytest.raises(ExpressionError, match="unlike"):
        effect.check()


def test_phase_and_amplitude_are_distinguished():
    assert find("casing.unbalance").amplitude.symbol == "k"
    assert find("casing.unbalance").depends_on_angle
    assert not find("casing.precession").depends_on_angle
    assert [p.symbol for p in find("bearing.heating").free] == ["k", "tau_T"]
    two = Effect("x", "casing", "-k*omega_c - q", (Parameter("k", "N m s"), Parameter("q", "N m")))
    assert two.amplitude is None


def test_a_separate_state_is_checked_for_unknown_names():
    effect = Effect(
        "x", "factor", "exp(-k*temperature)", (Parameter("k", "K-1"),), state=State("temperature", "q*tau")
    )
    with pytest.raises(EffectError, match="q"):
        effect.check()


def test_bounds_of_the_paper():
    g = next(p for p in find("bearing.power").parameters if p.symbol == "g")
    assert (g.lower, g.upper) == (0.3, 1.4)
    assert math.isinf(next(iter(find("bearing.linear").parameters)).upper)
