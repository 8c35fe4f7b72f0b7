"""The grammar of laws: units by construction, unique names, finite torques along a motion."""

import numpy as np
import pytest

from fitting import EffectError, read_effects
from fitting.discovery._grammar import description_length, grammar
from fitting.effects._expression import Tape

RANGES = {"omega_r": (300.0, 900.0), "omega_c": (5.0, 160.0), "delta": (250.0, 895.0)}


def whole():
    return grammar(RANGES, 200.0, bodies={"rotor", "casing"}, angles=True)


def test_every_law_is_a_torque_with_at_most_two_shape_constants():
    laws = whole()
    assert len(laws) > 100
    assert len({x.effect.name for x in laws}) == len(laws)
    for x in laws:
        x.effect.check()  # the law comes out in N m
        shapes = [p for p in x.effect.parameters if p.role == "shape"]
        assert len(shapes) <= 2
        assert all(p.lower <= min(p.grid) and max(p.grid) <= p.upper for p in shapes if not p.relative), x
        assert x.effect.amplitude is not None


def test_laws_are_finite_along_a_motion():
    t = np.linspace(0.01, 200, 50)
    motion = {"t": t, "omega_r": np.linspace(900, 300, 50), "omega_c": 5 + 155 * np.sin(t / 70)}
    motion |= {"delta": motion["omega_r"] - motion["omega_c"], "psi_c": 10 * t, "lag": t}
    for x in whole():
        values = motion | {p.symbol: p.start for p in x.effect.parameters} | {"k": 1.0}
        assert np.isfinite(Tape([x.effect.expression])(values)[0]).all(), x.effect.law


def test_the_grammar_of_one_body_contains_laws_of_its_motion_only():
    laws = grammar(RANGES, 200.0, bodies={"casing"}, angles=False)
    assert laws
    assert all(x.effect.bodies <= {"casing"} for x in laws)
    assert not any(x.effect.depends_on_angle for x in laws)


def test_a_longer_formula_has_a_larger_penalty():
    assert description_length(4) == pytest.approx(2 * description_length(2))
    assert description_length(1) == pytest.approx(2 * np.log(4))


def test_a_law_with_a_state_variable_is_read_from_a_file(tmp_path):
    file = tmp_path / "lab.toml"
    file.write_text(
        '[[effect]]\nname = "film"\nbody = "bearing"\nlaw = "k*lag"\nrate = "(delta - lag)/T"\n'
        '[effect.parameters.T]\nunit = "s"\nshape = true\nstart = 10.0\nlower = 1.0\n'
        '[effect.parameters.k]\nunit = "N m s"\n'
    )
    (effect,) = read_effects(file)
    effect.check()
    assert effect.state.symbol == "lag"
    assert effect.state.start == 0
    assert {p.symbol: p.role for p in effect.parameters} == {"T": "shape", "k": "amplitude"}
    file.write_text('[[effect]]\nname = "film"\nbody = "bearing"\nlaw = "k*lag"\n')
    with pytest.raises(EffectError, match="without a state variable"):
        read_effects(file)


def test_the_unit_of_a_power_of_time_is_consistent(tmp_path):
    file = tmp_path / "lab.toml"
    file.write_text(
        '[[effect]]\nname = "wear"\nbody = "casing"\nlaw = "-k*t**n"\n'
        '[effect.parameters.k]\nunit = "N m s^-n"\n[effect.parameters.n]\nshape = true\nstart = 0.5\n'
    )
    (effect,) = read_effects(file)
    assert effect.amplitude.unit == "N m s^-n"
    file.write_text(file.read_text().replace("s^-n", "s^n"))
    with pytest.raises(EffectError, match="has the unit N m s"):
        read_effects(file)


@pytest.mark.parametrize("span", [0.01, 0.6, 1.0, 30.0])
def test_a_record_of_any_length_has_periodic_laws_within_their_bounds(span):
    laws = grammar(RANGES, span, bodies={"rotor", "casing"}, angles=True)
    frequencies = [
        p
        for x in laws
        for p in x.effect.parameters
        if p.role == "shape" and p.unit == "s-1" and "t" in x.variables
    ]
    assert frequencies
    assert all(p.lower <= min(p.grid) <= max(p.grid) <= p.upper for p in frequencies)


@pytest.mark.parametrize("scale", [60.0, 1000.0])
def test_trial_values_follow_the_unit_of_time(scale):
    """The same record with all times multiplied has the same laws, whose times and speeds are multiplied as well."""
    ranges = {name: (low / scale, high / scale) for name, (low, high) in RANGES.items()}
    both = {"bodies": {"rotor", "casing"}, "angles": True}
    here, there = grammar(RANGES, 200.0, **both), grammar(ranges, 200.0 * scale, **both)
    assert [x.effect.name for x in here] == [x.effect.name for x in there]
    factors = {"1": 1.0, "s": scale, "s-1": 1 / scale}
    for a, b in zip(here, there, strict=True):
        for p, q in zip(a.effect.parameters, b.effect.parameters, strict=True):
            if p.role == "shape":
                factor = 1.0 if p.relative else factors[p.unit]
                assert q.grid == pytest.approx([factor * v for v in p.grid], rel=2e-3)
