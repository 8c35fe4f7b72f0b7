"""The grammar of laws: units, unique names, lengths of formulas, trial values, and bounds of a next run."""

import math
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import EffectError, make_record, read_effects
from fitting.discovery import _grammar
from fitting.discovery._grammar import description_length, grammar
from fitting.discovery._next_run import Bounds
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


# symbols of the formula of a speed x with its strength; {s} is the sign of the own speed
OF_SPEED = {
    "k*abs(x)**n{s}": 3, "k*exp(-abs(x)/w){s}": 4, "k*exp(-(x/w)**2){s}": 5, "k*(exp(abs(x)/w) - 1){s}": 5,
    "k*tanh(x/w)": 4, "k*x/(abs(x) + w)": 4, "k*atan(x/w)": 4, "k*x/sqrt(x**2 + w**2)": 6,
    "k*abs(x)**n/(abs(x)**n + w**n){s}": 7, "k*x/(1 + (x/w)**2)": 5, "k*x*exp(-abs(x)/w)": 5,
    "k*log(1 + abs(x)/w){s}": 4, "k*heaviside(x - w)*(x - w)": 5, "k*heaviside(x - w)*(x - w)**2": 6,
    "k*(1 + tanh((x - w)/u))": 6, "k/(1 + ((x - w)/u)**2)": 6, "k*exp(-((x - w)/u)**2)": 6, "k*lag": 4, "k*lag*x": 5,
}  # fmt: skip
OF_TIME = {
    "k*t**n": 3, "k*exp(-t/w){d}": 4, "k/(1 + t/w){d}": 4, "k*log(1 + t/w)": 4, "k*sin(w*t - phi)": 4,
    "k*exp(-t/u)*sin(w*t - phi)": 7, "k*heaviside(t - t0)": 4, "k*heaviside(t - t0)*(t - t0)": 5,
    "k*exp(-((t - t0)/w)**2)": 6,
}  # fmt: skip
ROTOR_TIME = ("k*t**n", "k*exp(-t/w){d}", "k/(1 + t/w){d}", "k*log(1 + t/w)", "k*heaviside(t - t0)")
OWN = {"casing": "omega_c", "bearing": "delta", "rotor": "omega_r"}
SPEEDS = {"casing": ("omega_c", "omega_r"), "bearing": ("delta", "omega_r"), "rotor": ("omega_r",)}
PRODUCTS = {
    "casing": {
        "k*omega_r*omega_c": 4, "k*omega_r**2*omega_c": 5, "k*omega_r*omega_c**2": 5, "k*omega_c*t": 4,
        "k*omega_c*abs(omega_c)*t": 5, "k*omega_r*t": 4, "k*abs(omega_r)**n*omega_c": 5,
        "k*abs(omega_c)**n*omega_r": 5, "k*abs(omega_c)**n*t*sign(omega_c)": 5, "k*exp(-t/w)*omega_r": 5,
    },
    "bearing": {
        "k*delta*omega_c": 4, "k*delta*omega_r": 4, "k*delta*omega_c**2": 5, "k*delta*t": 4, "k*sign(delta)*t": 3,
        "k*delta*abs(delta)*t": 5, "k*abs(delta)**n*omega_c": 5, "k*abs(delta)**n*t*sign(delta)": 5,
    },
    "rotor": {
        "k*omega_r*omega_c": 4, "k*omega_r*abs(omega_r)*omega_c": 5, "k*omega_r*t": 4, "k*omega_r*abs(omega_r)*t": 5,
    },
}  # fmt: skip


def expected():
    """Return the length of each law by body and formula; a formula may occur for two speeds."""
    found = {}
    for body, own in OWN.items():
        for x in SPEEDS[body]:
            for text, n in OF_SPEED.items():
                law = text.replace("exp", "EXP").replace("x", x).replace("EXP", "exp")
                found[body, law.replace("{s}", f"*sign({own})" if x == own else "")] = n
        for text, n in OF_TIME.items():
            if body != "rotor" or text in ROTOR_TIME:
                found[body, text.replace("{d}", "*sign(delta)" if body == "bearing" else "")] = n
        found |= {(body, law): n for law, n in PRODUCTS[body].items()}
        for factor, n in ((own, 5), (f"{own}*abs({own})", 6)):
            found[body, f"k*exp(-t/w)*{factor}"] = n
            found[body, f"k*heaviside(t - t0)*{factor}"] = n
    return found | {("casing", f"k*sin({n}*psi_c - phi)"): 5 for n in (3, 4)}


@cache
def laws(bodies=("rotor", "casing"), angles=True):
    return grammar(RANGES, 200.0, bodies=set(bodies), angles=angles)


def test_each_law_has_the_length_of_its_formula():
    found = {(x.effect.joint, x.effect.law): x.symbols for x in laws()}
    assert found == expected()
    # a relaxation towards either speed has the same formula
    assert len(laws()) == len(found) + 2
    assert sorted(x.effect.law for x in laws() if x.effect.name.endswith("_2"))[:3]


@pytest.mark.parametrize(("symbols", "penalty"), [(1, 4 * math.log(2)), (5, 20 * math.log(2))])
def test_a_symbol_costs_two_bits(symbols, penalty):
    assert _grammar.description_length(symbols) == pytest.approx(penalty)
    law = next(x for x in laws() if x.symbols == 5)
    assert law.description_length == pytest.approx(20 * math.log(2))


@pytest.mark.parametrize(
    ("law", "unit"),
    [
        ("k*abs(omega_c)**n*sign(omega_c)", "N m s^n"), ("k*t**n", "N m s^-n"), ("k*lag*omega_c", "N m s2"),
        ("k*heaviside(t - t0)*(t - t0)", "N m s-1"), ("k*abs(omega_c)**n*t*sign(omega_c)", "N m s-1 s^n"),
        ("k*omega_r**2*omega_c", "N m s3"), ("k*sin(w*t - phi)", "N m"), ("k/(1 + t/w)", "N m"),
        ("k*heaviside(omega_c - w)*(omega_c - w)**2", "N m s2"),
    ],
)  # fmt: skip
def test_the_strength_has_the_unit_of_a_torque(law, unit):
    found = next(x.effect for x in laws() if x.effect.law == law and x.effect.joint == "casing")
    assert found.amplitude.unit == unit
    # the phase of a sinusoid contains its sign
    assert found.amplitude.lower == (0.0 if "phi" in law else -math.inf)


def test_moments_belong_to_a_recording_and_jumps_have_breakpoints():
    for x in laws():
        effect = x.effect
        assert effect.per_case == ("t0" in effect.law)
        jumps = "heaviside(t - t0)" in effect.law and "(t - t0)*(t - t0)" not in effect.law
        assert effect.breakpoint == ("t0" if jumps else "")
        assert (effect.state is not None) == ("lag" in effect.law)


class TestShapes:
    """Of a largest speed of 10 rad/s in a record of 40 s."""

    @pytest.mark.parametrize(
        ("kind", "unit", "lower", "upper", "first", "last", "count"),
        [
            ("exponent", "1", -3.0, 6.0, -1.0, 4.0, 12),
            ("positive exponent", "1", 0.05, 6.0, 0.25, 4.0, 10),
            ("speed", "s-1", 0.03, 300.0, 0.3, 30.0, 13),
            ("wide speed", "s-1", 1.5, 300.0, 2.044, 30.0, 8),
            ("threshold", "s-1", 0.0, 12.0, 0.5, 9.0, 18),
            ("steepness", "1", 0.2, 8.0, 0.5, 3.0, 4),
            ("narrow", "s-1", 0.05, 30.0, 0.3, 5.0, 4),
            ("time", "s", 0.2, 800.0, 0.8, 80.0, 10),
            ("time few", "s", 0.2, 800.0, 4.0, 40.0, 3),
            ("pulse", "s", 0.12, 40.0, 0.8, 4.8, 3),
            ("frequency", "s-1", math.pi / 80, 50.0, math.pi / 40, 25.0, 499),
            ("few frequencies", "s-1", math.pi / 80, 2 * math.pi, math.pi / 40, math.pi, 62),
        ],
    )
    def test_bounds_and_trial_values_follow_speed_and_span(
        self, kind, unit, lower, upper, first, last, count
    ):
        p = _grammar._shape("c", kind, 10.0, 40.0)
        assert (p.symbol, p.unit, p.role, p.relative) == ("c", unit, "shape", False)
        assert (p.lower, p.upper) == (pytest.approx(lower), pytest.approx(upper))
        assert (p.grid[0], p.grid[-1]) == (pytest.approx(first, rel=1e-3), pytest.approx(last, rel=1e-3))
        assert len(p.grid) == count
        assert p.start == p.grid[count // 2]
        assert list(p.grid) == sorted(p.grid)

    @pytest.mark.parametrize(("kind", "step"), [("moment", 1), ("coarse moment", 3)])
    def test_moments_are_shares_of_the_record(self, kind, step):
        p = _grammar._shape("t0", kind, 10.0, 40.0)
        assert (p.unit, p.lower, p.upper, p.relative) == ("s", 0.0, 40.0, True)
        assert p.grid == tuple(float(f"{m:.4g}") for m in _grammar.MOMENTS[::step])

    def test_frequencies_of_a_long_record_are_limited(self, monkeypatch):
        monkeypatch.setattr(_grammar, "_MOST_FREQUENCIES", 100)
        p = _grammar._shape("w", "frequency", 1.0, 40.0)
        assert p.grid == pytest.approx(np.linspace(math.pi / 40, 25.0, 100), rel=1e-3)

    @pytest.mark.parametrize(
        ("low", "high", "positive"),
        [
            (1.1, 100.0, False), (0.9, 100.0, True), (-0.9, 100.0, True), (-100.0, -1.1, False), (-100.0, -0.9, True),
            (-50.0, 100.0, True), (-100.0, 50.0, True),
        ],
    )  # fmt: skip
    def test_negative_powers_need_a_speed_apart_from_zero(self, low, high, positive):
        (form,) = (f for f in _grammar._OF_SPEED if f.name == "power")
        law = _grammar._of_speed(form, "casing", "omega_c", (low, high), 40.0)
        exponent = law.effect.parameters[1]
        assert (min(exponent.grid) > 0) is positive
        speed = _grammar._of_speed(
            _grammar._OF_SPEED[1], "casing", "omega_c", (low, high), 40.0
        ).effect.parameters[1]
        assert speed.upper == pytest.approx(3000.0)
        assert speed.lower == pytest.approx(0.3)


def test_laws_of_a_name_are_numbered():
    names = [x.effect.name for x in laws() if x.effect.name.startswith("law.casing.omega_c.saturation")]
    assert names == ["law.casing.omega_c.saturation"] + [
        f"law.casing.omega_c.saturation_{i}" for i in (2, 3, 4, 5)
    ]
    assert "law.casing.omega_r_t.product" in {x.effect.name for x in laws()}
    assert "law.bearing.t.decay_in_time" in {x.effect.name for x in laws()}


def test_a_body_alone_has_the_laws_of_its_own_motion():
    alone = {x.effect.law for x in laws(bodies=("casing",), angles=False)}
    assert alone == {
        law for (body, law) in expected() if body == "casing" and "omega_r" not in law and "psi" not in law
    }


TIME = np.linspace(0.0, 20.0, 50)
RUN = (TIME, 20.0 - TIME, np.full(50, 0.1))


def fit_of(rotor):
    record = make_record(casing=RUN, rotor=rotor, I_rotor=5e-5, I_casing=2e-5, quantity="omega")
    speeds = np.stack([np.linspace(900.0, 600.0, 50), np.linspace(5.0, 40.0, 50)], axis=1)
    data = SimpleNamespace(initial_speeds=(TIME, speeds), record=record)
    return SimpleNamespace(problem=SimpleNamespace(data=[data]))


def test_the_rotor_is_spun_up_and_the_casing_turns_in_either_sense():
    found = Bounds.of(fit_of([RUN]))
    assert found.omega_rotor == (300.0, 900.0)
    assert found.omega_casing == (-40.0, 40.0)
    assert found.duration == (10.0, 40.0)
    assert found.reversible


def test_a_body_alone_is_spun_up_itself():
    found = Bounds.of(fit_of([]))
    assert found.omega_rotor == (0.0, 0.0)
    assert found.omega_casing == (pytest.approx(40.0 / 3.0), 40.0)
    assert not found.reversible


@pytest.mark.parametrize("span", [0.2, 200.0])
def test_trial_frequencies_end_at_a_phase_of_a_thousand_radians(span):
    """Five radians per second in the 200 s of the paper."""
    assert _grammar._HIGHEST == 200.0 * 5.0
    shape = _grammar._shape("w", "frequency", 100.0, span)
    assert max(shape.grid) == pytest.approx(1000.0 / span, rel=1e-3)
    assert shape.upper == pytest.approx(2000.0 / span)
