"""Every effect has a name in words, a symbol and a key; those of a single body speak of this body."""

from dataclasses import replace

import pytest

from fitting import LIBRARY, EffectName, effect, effect_name
from fitting._numbers import SI, WITHOUT_INERTIA
from fitting.effects._library import SLIP, START, find, shortened
from fitting.effects._words import change_name, of_body, symbol_meanings

EFFECTS = [*LIBRARY.values(), START, SLIP]


@pytest.mark.parametrize("known", EFFECTS, ids=lambda e: e.name)
def test_every_effect_has_words_a_symbol_and_its_key(known):
    found = effect_name(known.name)
    assert found.key == known.name
    assert found.words
    assert "." not in found.words
    assert found.symbol
    assert str(found) == f"{found.words} ({known.name})"


def test_words_are_different():
    assert len({e.words for e in EFFECTS}) == len(EFFECTS)


@pytest.mark.parametrize(
    "known", [e for e in LIBRARY.values() if e.bodies <= {"casing"}], ids=lambda e: e.name
)
def test_of_a_single_body_the_words_speak_of_it(known):
    found = effect_name(known.name, "wheel")
    assert "casing" not in str(found)
    assert "touch" not in str(found)
    assert find(found.key) is known


@pytest.mark.parametrize(
    ("key", "body", "name"),
    [
        ("casing.air.linear", "casing", EffectName("casing.air.linear", "linear air drag of the casing", "b₂")),
        ("touchpoint.constant", "disc", EffectName("support.constant", "dry friction of the disc's support", "b₁")),
        ("bearing.power.g", "casing", EffectName("bearing.power.g", "g of the power-law friction of the bearing", "g")),
        ("initial.omega_c@a", "wheel", EffectName("initial.omega_c", "initial speed of the wheel", "ω_c0")),
        ("casing: -k*omega_c**3", "casing", EffectName("", "law -k*omega_c**3 on the casing", "")),
        ("input.u.delay", "casing", EffectName("input.u.delay", "dead time of the input u", "T")),
        ("bearing.input.u", "casing", EffectName(
            "bearing.input.u", "torque between the bodies proportional to u", "k")),
        ("a torque that changes slowly", "casing", EffectName("", "a torque that changes slowly", "")),
        ("cooking: x", "casing", EffectName("", "cooking: x", "")),
    ],
)  # fmt: skip
def test_the_name_of_any_key(key, body, name):
    assert effect_name(key, body) == name


def test_a_law_of_the_user_has_its_own_words():
    own = replace(effect("casing: -k*omega_c**3"), name="lab.cubic", words="cubic drag of the casing")
    assert str(effect_name("lab.cubic", effects=[own])) == "cubic drag of the casing (lab.cubic)"
    assert effect_name("lab.cubic.k", "wheel", [own]).words == "k of the cubic drag of the wheel"
    assert effect_name("lab.cubic").words == "lab.cubic"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("+casing.air.linear -bearing.linear", "+ linear air drag of the casing − viscous friction of the bearing"),
        ("+casing: -k*omega_c**3 -bearing.constant", "+ law -k*omega_c**3 on the casing − dry friction of the bearing"),
        ("+casing.air.quadratic.n", "+ n of the quadratic air drag of the casing"),
        ("reduced", "reduced"),
        ("", ""),
    ],
)  # fmt: skip
def test_a_change_of_the_model_in_words(change, words):
    assert change_name(change) == words


def test_keys_are_shortened_for_a_single_body_only_where_they_can_be_found():
    assert [shortened(k) for k in ("casing.gravity", "touchpoint.step", "camera.tilt")] == [
        "gravity", "support.step", "camera.tilt",
    ]  # fmt: skip
    assert (
        of_body("casing: -k*omega_c of the casing's rim", "wheel") == "casing: -k*omega_c of the wheel's rim"
    )


def test_symbols_of_a_formula_are_defined():
    found = dict(symbol_meanings([LIBRARY["bearing.heating"], LIBRARY["casing.air.quadratic"]], "casing"))
    assert found["D"] == "ω_r − ω_c"
    assert found["T"].endswith("dT/dt = τ_cr D/C - T/τ_T")
    assert found["ω_c"] == "angular velocity of the casing"
    assert found["C"].endswith("[J K⁻¹]")
    for known in LIBRARY.values():
        assert all(meaning.strip() for _, meaning in symbol_meanings([known]))


@pytest.mark.parametrize(("units", "unit"), [(SI, "[N m s⁻¹]"), (WITHOUT_INERTIA, "[rad/s³]")])
def test_units_without_an_inertia_are_those_of_an_acceleration(units, unit):
    found = dict(symbol_meanings([LIBRARY["touchpoint.drift"]], "wheel", units))
    assert found["k"].endswith(unit)
