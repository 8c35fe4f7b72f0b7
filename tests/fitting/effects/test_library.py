"""Every effect of the library against an independent implementation of its law, and against physics."""

import numpy as np
import pytest

from fitting import GENERAL, LIBRARY, LINEAR, REDUCED, Model
from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR, Dynamics
from fitting.effects._effect import RATIO, parse_unit
from fitting.effects._expression import Tape, derivative, symbols
from fitting.effects._library import find


def sgn(x):
    return np.sign(x)


def yielding(v, z, s):
    """Rate of the strain of a contact that slides at the Stribeck curve."""
    curve = 1 + v["r"] * np.exp(-((v["omega_c"] / v["w"]) ** 2))
    return (v["omega_c"] - abs(v["omega_c"]) * z / curve) / s


# name: (joint, law by hand, {symbol: unit}); torques on the body named, angles for cameras.
# v holds t, omega_r, omega_c, D, psi_r, psi_c, T, chirp, strain, deflection, tau, psi, omega and the parameters.
TABLE = {
    "rotor.air.linear": ("rotor", lambda v: -v["a1"] * v["omega_r"], {"a1": "N m s"}),
    "rotor.air.quadratic": ("rotor", lambda v: -v["a2"] * v["omega_r"] * abs(v["omega_r"]), {"a2": "N m s2"}),
    "rotor.air.disk": (
        "rotor",
        lambda v: -v["k"] * abs(v["omega_r"]) ** 1.5 * sgn(v["omega_r"]),
        {"k": "N m s1.5"},
    ),
    "rotor.air.turbulent": (
        "rotor",
        lambda v: -v["k"] * abs(v["omega_r"]) ** 1.8 * sgn(v["omega_r"]),
        {"k": "N m s1.8"},
    ),
    "touchpoint.constant": ("casing", lambda v: -v["b1"] * sgn(v["omega_c"]), {"b1": "N m"}),
    "casing.air.linear": ("casing", lambda v: -v["b2"] * v["omega_c"], {"b2": "N m s"}),
    "casing.air.quadratic": ("casing", lambda v: -v["k"] * v["omega_c"] * abs(v["omega_c"]), {"k": "N m s2"}),
    "casing.air.laminar": (
        "casing",
        lambda v: -v["k"] * abs(v["omega_c"]) ** 1.5 * sgn(v["omega_c"]),
        {"k": "N m s1.5"},
    ),
    "casing.windage": ("casing", lambda v: v["k"] * v["omega_r"] * abs(v["omega_r"]), {"k": "N m s2"}),
    "bearing.constant": ("bearing", lambda v: v["c"] * sgn(v["D"]), {"c": "N m"}),
    "bearing.linear": ("bearing", lambda v: v["d"] * v["D"], {"d": "N m s"}),
    "bearing.quadratic": ("bearing", lambda v: v["e"] * v["D"] * abs(v["D"]), {"e": "N m s2"}),
    "bearing.power": (
        "bearing",
        lambda v: v["f"] * abs(v["D"]) ** v["g"] * sgn(v["D"]),
        {"f": "N m s^g", "g": "1"},
    ),
    "bearing.heating": (
        "factor",
        lambda v: np.exp(-v["k"] * v["T"]),
        {"k": "K-1", "C": "J K-1", "tau_T": "s"},
    ),
    "bearing.load": ("bearing", lambda v: v["k"] * v["omega_r"] ** 2, {"k": "N m s2"}),
    "bearing.load_viscous": ("bearing", lambda v: v["k"] * v["D"] * v["omega_r"] ** 2, {"k": "N m s3"}),
    "bearing.drift": ("factor", lambda v: 1 + v["k"] * v["t"], {"k": "s-1"}),
    "touchpoint.stribeck": (
        "casing",
        lambda v: -v["k"] * np.exp(-abs(v["omega_c"]) / v["w"]) * sgn(v["omega_c"]),
        {"k": "N m", "w": "s-1"},
    ),
    "touchpoint.drift": ("casing", lambda v: -v["k"] * v["t"] * sgn(v["omega_c"]), {"k": "N m s-1"}),
    "touchpoint.load": ("casing", lambda v: -v["k"] * v["omega_r"] ** 2 * sgn(v["omega_c"]), {"k": "N m s2"}),
    "touchpoint.step": (
        "casing",
        lambda v: -v["k"] * (v["t"] >= v["t0"]) * sgn(v["omega_c"]),
        {"k": "N m", "t0": "s"},
    ),
    "casing.unbalance": (
        "casing",
        lambda v: v["k"] * np.sin(v["psi_c"] - v["phi"]),
        {"k": "N m", "phi": "rad"},
    ),
    "casing.asymmetry": (
        "casing",
        lambda v: v["k"] * np.sin(2 * v["psi_c"] - v["phi"]),
        {"k": "N m", "phi": "rad"},
    ),
    "casing.brake.eddy": (
        "casing",
        lambda v: -v["k"] * v["omega_c"] / (1 + (v["omega_c"] / v["w"]) ** 2),
        {"k": "N m s", "w": "s-1"},
    ),
    "casing.seal.cooling": (
        "casing",
        lambda v: -v["k"] * (1 - np.exp(-v["t"] / v["tau_T"])) * sgn(v["omega_c"]),
        {"k": "N m", "tau_T": "s"},
    ),
    "casing.friction.presliding": ("casing", lambda v: -v["k"] * v["strain"], {"k": "N m", "s": "1"}),
    "casing.friction.lugre": (
        "casing",
        lambda v: -v["k"] * (v["bristle"] + v["T"] * yielding(v, v["bristle"], v["s"])),
        {"k": "N m", "s": "1", "r": "1", "w": "s-1", "T": "s"},
    ),
    "casing.friction.gms": (
        "casing",
        lambda v: -v["k"] * (v["a"] * v["element_a"] + (1 - v["a"]) * v["element_b"]),
        {"k": "N m", "a": "1", "s": "1", "q": "1", "r": "1", "w": "s-1"},
    ),
    "casing.friction.starvation": (
        "casing",
        lambda v: -v["k"] * np.exp(-((abs(v["omega_c"]) / v["w"]) ** 1.4)) * sgn(v["omega_c"]),
        {"k": "N m", "w": "s-1"},
    ),
    "casing.spring.linear": ("casing", lambda v: -v["k"] * v["deflection"], {"k": "N m"}),
    "casing.spring.cubic": ("casing", lambda v: -v["k"] * v["deflection"] ** 3, {"k": "N m"}),
    "casing.gravity": ("casing", lambda v: -v["k"] * np.sin(v["deflection"]), {"k": "N m"}),
    "casing.precession": (
        "casing",
        lambda v: v["k"] * np.cos(v["chirp"] + v["phi"]),
        {"k": "N m", "m": "s-2", "phi": "rad"},
    ),
    "external.constant": ("casing", lambda v: v["k"] + 0 * v["t"], {"k": "N m"}),
    "camera.clock": ("camera.rotor", lambda v: v["eps"] * v["t"] * v["omega"], {"eps": "1"}),
    "camera.offset": ("camera.rotor", lambda v: v["dt"] * v["omega"], {"dt": "s"}),
    "camera.centre": (
        "camera.casing",
        lambda v: v["eps"] * np.sin(v["psi"] - v["phi"]),
        {"eps": "rad", "phi": "rad"},
    ),
    "camera.tilt": (
        "camera.casing",
        lambda v: v["eps"] * np.sin(2 * v["psi"] - v["phi"]),
        {"eps": "rad", "phi": "rad"},
    ),
    "camera.shutter": (
        "camera.casing",
        lambda v: -v["k"] * v["omega"] * np.sin(v["psi"] - v["phi"]),
        {"k": "s", "phi": "rad"},
    ),
    "camera.blur": (
        "camera.casing",
        lambda v: v["k"] * v["omega"] ** 2 * np.sin(v["psi"] - v["phi"]),
        {"k": "s2", "phi": "rad"},
    ),
}


# beyond the table: not a law of a body, but a factor of the casing's acceleration
BEYOND = {
    "setup.inertia": ("inertia", lambda v: 1 / (1 + v["eps"]) + 0 * v["t"], {"eps": "1"}),
    "rotor.support": ("rotor", lambda v: -v["k"] * sgn(v["omega_r"]), {"k": "N m"}),
    "contact.rolling": (
        "contact",
        lambda v: (
            v["torque_held"] * (1 - v["c"] * v["inertia_slip"] * abs(v["omega_r"]) / v["T"])
            - v["inertia_slip"] * v["slip"] / v["T"]
        ),
        {"n": "1", "c": "N-1 m-1", "T": "s"},
    ),
    "contact.sliding": (
        "contact",
        lambda v: -v["k"] * np.tanh(v["slip"] / v["w"]),
        {"k": "N m", "n": "1", "w": "s-1"},
    ),
}


EFFECTS = pytest.mark.parametrize("effect", LIBRARY.values(), ids=LIBRARY)


def places(effect, n=200, seed=0):
    """Return random circumstances, both senses of both bodies among them, and positive parameters."""
    rng = np.random.default_rng(seed)
    v = {
        "t": rng.uniform(0, 200, n),
        "omega_r": rng.uniform(-900, 900, n),
        "omega_c": rng.uniform(-200, 200, n),
        "psi_r": rng.uniform(0, 1e4, n),
        "psi_c": rng.uniform(0, 1e4, n),
        "temperature": rng.uniform(0, 30, n),
        "chirp": rng.uniform(0, 500, n),
        "strain": rng.uniform(-1, 1, n),
        **{name: rng.uniform(-1, 1, n) for name in ("bristle", "element_a", "element_b")},
        "deflection": rng.uniform(-2, 2, n),
        "slip": rng.uniform(-20, 20, n),
        "torque_held": rng.uniform(-1, 1, n),
        "inertia_slip": 0.3,
        "tau": rng.uniform(-1e-4, 1e-4, n),
        "psi": rng.uniform(0, 1e4, n),
        "omega": rng.uniform(-200, 200, n),
    }
    v["delta"] = v["D"] = v["omega_r"] - v["omega_c"]
    v["T"] = v["temperature"]
    for p in effect.parameters:
        low, high = max(p.lower, 0.0), min(p.upper, 10.0)
        v[p.symbol] = float(rng.uniform(low + 0.05 * (high - low), high))
    return v


def test_names_are_those_of_the_table():
    assert set(TABLE) <= set(LIBRARY)
    assert all(name == effect.name for name, effect in LIBRARY.items())


def test_models_of_the_paper_have_the_right_effects():
    assert set(LINEAR) == {
        "rotor.air.quadratic",
        "touchpoint.constant",
        "casing.air.linear",
        "bearing.linear",
    }
    assert set(REDUCED) == {*LINEAR, "bearing.power"}
    assert set(GENERAL) == {*REDUCED, "rotor.air.linear", "bearing.constant", "bearing.quadratic"}


@EFFECTS
def test_law_is_the_one_of_the_table(effect):
    joint, by_hand, units = (TABLE | BEYOND)[effect.name]
    assert effect.joint == joint
    assert {p.symbol for p in effect.parameters} == set(units)
    for p in effect.parameters:
        assert parse_unit(p.unit, {"g": 1.2}) == pytest.approx(parse_unit(units[p.symbol], {"g": 1.2}))
    v = places(effect)
    found = np.asarray(Tape([effect.expression])(v)[0]) * np.ones(200)
    np.testing.assert_allclose(found, by_hand(v), rtol=1e-12)


@EFFECTS
def test_declarations_are_consistent(effect):
    effect.check()
    assert effect.kind == ("measurement" if effect.camera or effect.joint == "inertia" else "physical")
    assert effect.per_case >= effect.per_surface
    assert effect.signature
    assert effect.source
    assert set(effect.confused_with) <= set(LIBRARY) - {effect.name}
    # the ratio of a contact is in its slip
    assert {p.symbol for p in effect.parameters} - {RATIO} <= symbols(effect.expression).union(
        *map(symbols, effect.rates)
    )
    for p in effect.parameters:
        assert p.lower < p.upper
        assert p.lower <= p.start <= p.upper
        assert p.meaning
        # the ratio of a contact is found from the speeds
        if p.role == "shape" and p.symbol != RATIO:
            assert p.grid
            assert list(p.grid) == sorted(p.grid)
            assert all(p.relative or p.lower <= v <= p.upper for v in p.grid)
    if effect.breakpoint:
        assert effect.breakpoint in {p.symbol for p in effect.parameters}


def test_per_case_effects_are_those_of_the_table():
    """The touch point and the casing's linear drag, as README and DESIGN state; the surface cannot be predicted."""
    touchpoint = {n for n in LIBRARY if n.startswith("touchpoint.")}
    assert {n for n, e in LIBRARY.items() if e.per_case} == touchpoint | {"casing.air.linear"}
    assert {n for n, e in LIBRARY.items() if e.per_surface} == touchpoint
    names = ("centre", "tilt", "shutter", "blur")
    assert [n for n, e in LIBRARY.items() if e.nuisance] == [f"camera.{name}" for name in names]


@EFFECTS
def test_equivalence_is_mutual(effect):
    assert all(effect.name in LIBRARY[other].equivalent for other in effect.equivalent)


@pytest.mark.slow
def test_a_presliding_contact_dissipates_energy_in_each_cycle():
    """Steady cycles of any amplitude: the strain stays within +-1, and the work over a cycle is a loss."""
    rate = Tape([find("casing.friction.presliding").rate])
    for amplitude in (0.003, 0.3):
        strain, work, h = 0.0, 0.0, 2e-4
        for i in range(20_000):
            omega = amplitude * np.cos(2 * np.pi * i * h)
            strain += h * float(rate({"omega_c": omega, "strain": strain, "s": 0.01})[0])
            work += (i >= 15_000) * h * -strain * omega
            assert abs(strain) <= 1
        assert work < 0


def test_rates_of_states_are_those_of_the_table():
    v = places(find("bearing.heating")) | {"C": 2.0, "tau_T": 30.0}
    heat = Tape([find("bearing.heating").rate])(v)[0]
    np.testing.assert_allclose(heat, v["tau"] * v["delta"] / 2.0 - v["temperature"] / 30.0, rtol=1e-12)
    v = places(find("casing.precession")) | {"m": 700.0}
    np.testing.assert_allclose(Tape([find("casing.precession").rate])(v)[0], 700.0 / v["omega_r"], rtol=1e-12)


# Not friction, so that the law of dissipation does not hold:
# windage is driven by air that the rotor throws (its loss stands in rotor.air); a draught comes from outside;
# unbalance, asymmetry and precession follow an angle and give back what they take, or take it from gravity.
DRIVERS = {"casing.windage", "external.constant", "casing.unbalance", "casing.asymmetry", "casing.precession"}
# They store energy and give it back; the presliding contact keeps a part of it.
ELASTIC = {"casing.spring.linear", "casing.spring.cubic", "casing.gravity", "casing.friction.presliding"}
ELASTIC |= {"casing.friction.lugre", "casing.friction.gms"}


def test_the_strength_of_a_friction_is_not_negative():
    """The change of a friction with time may have either sign."""
    changes = {"touchpoint.step", "touchpoint.drift"}
    names = sorted(n for n in TABLE if not LIBRARY[n].camera and n not in DRIVERS | ELASTIC | changes)
    frictions = [LIBRARY[n] for n in names if LIBRARY[n].joint in {"rotor", "casing", "bearing"}]
    bounds = {(e.name, p.lower, p.upper) for e in frictions for p in e.parameters if p.role == "amplitude"}
    assert {b for b in bounds if b[1:] != (0.0, np.inf)} == set()
    assert ("bearing.power", 0.0, np.inf) in bounds


# k omega_r^2 pushes the casing forward whatever it does: friction only while the rotor is the faster body,
# as it is through every run of this experiment.
FORWARD_ONLY = {"bearing.load"}


@pytest.mark.parametrize(
    "name", sorted(n for n in TABLE if not LIBRARY[n].camera and n not in DRIVERS | ELASTIC)
)
def test_friction_dissipates_energy(name):
    effect = find(name)
    v = places(effect, 4000)
    law = np.asarray(Tape([effect.expression])(v)[0])
    if effect.joint == "factor":
        # it multiplies a friction: that stays one as long as the factor does not change its sign
        assert (law > 0).all()
        return
    if effect.joint == "bearing":
        power = -law * v["omega_r"] + law * v["omega_c"]
    else:
        power = law * v["omega_r" if effect.joint == "rotor" else "omega_c"]
    if name in FORWARD_ONLY:
        power = power[v["D"] > 0]
    assert power.max() <= 1e-15 * np.abs(power).max()
    assert power.min() < 0


@pytest.mark.parametrize("name", sorted(DRIVERS))
def test_driving_torques_can_do_positive_work(name):
    effect = find(name)
    v = places(effect, 4000)
    assert (Tape([effect.expression])(v)[0] * v["omega_c"]).max() > 0


@pytest.mark.parametrize("name", [n for n, e in LIBRARY.items() if e.joint in {"bearing", "factor"}])
def test_bearing_torques_cancel_between_the_bodies(name):
    dynamics = Dynamics(Model.of(dict.fromkeys(("bearing.linear", "bearing.power", name))))
    numbers = dict.fromkeys(dynamics.parameters, 0.7) | {INERTIA_ROTOR: 5.54e-5, INERTIA_CASING: 2.06e-5}
    rng = np.random.default_rng(2)
    y = rng.uniform(1, 300, (50, len(dynamics.states)))
    rate = dynamics.rates(rng.uniform(0, 200, 50), y, numbers)
    momentum = 5.54e-5 * rate[:, 0] + 2.06e-5 * rate[:, 1]
    assert np.abs(momentum).max() < 1e-12 * np.abs(5.54e-5 * rate[:, 0]).max()
    assert np.abs(rate[:, 0]).min() > 0


# heating's strength stands in an exponential: linear for small k T only
@pytest.mark.parametrize("name", sorted(set(TABLE) - {"bearing.heating"}))
def test_amplitude_enters_linearly(name):
    effect = find(name)
    amplitude = next(p.symbol for p in effect.parameters if p.role == "amplitude")
    tape, v = Tape([effect.expression]), places(effect)
    none, one, two = (np.asarray(tape(v | {amplitude: k})[0]) for k in (0.0, 0.4, 0.8))
    np.testing.assert_allclose(two - none, 2 * (one - none), rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(none, 1.0 if effect.joint == "factor" else 0.0, atol=1e-300)


def test_heating_of_zero_strength_has_no_effect():
    effect = find("bearing.heating")
    v = places(effect)
    np.testing.assert_allclose(Tape([effect.expression])(v | {"k": 0.0})[0], 1.0)


@EFFECTS
def test_derivatives_match_differences(effect):
    v = places(effect, 60)
    for name in symbols(effect.expression):
        step = 1e-4 if name.startswith("psi") else 1e-6 * max(1.0, np.abs(v[name]).max())
        tape = Tape([effect.expression])
        rise = np.asarray(tape(v | {name: v[name] + step})[0]) - np.asarray(
            tape(v | {name: v[name] - step})[0]
        )
        exact = np.asarray(Tape([derivative(effect.expression, name)])(v)[0])
        # away from the jumps of sign and heaviside
        far = np.ones(60, dtype=bool)
        for speed in ("omega_r", "omega_c", "delta"):
            far &= np.abs(v[speed]) > 1
        size = np.abs(np.asarray(tape(v)[0])).max() / np.abs(v[name]).max() + np.abs(exact).max()
        np.testing.assert_allclose(
            (rise / (2 * step) * np.ones(60))[far], (exact * np.ones(60))[far], rtol=2e-5, atol=1e-6 * size
        )


@EFFECTS
def test_dynamics_with_the_effect_has_right_derivatives(effect):
    """All derivatives by states and by parameters, of sums, products and states of effects."""
    if effect.camera:
        assert Dynamics(Model((effect,))).parameters == ()
        return
    others = [find(n) for n in REDUCED if n != effect.name]
    dynamics = Dynamics(Model((*others, effect)), angles=True)
    rng = np.random.default_rng(3)
    n = len(dynamics.states)
    typical = {
        "omega_r": 600.0,
        "omega_c": 90.0,
        "temperature": 3.0,
        "chirp": 20.0,
        **dict.fromkeys(("strain", "bristle", "element_a", "element_b"), 0.5),
        "deflection": 0.7,
        "psi_r": 5.0,
        "psi_c": 7.0,
    }
    y = np.array([typical[s] for s in dynamics.states]) * rng.uniform(0.8, 1.2, (20, n))
    t = rng.uniform(1, 100, 20)
    numbers = {k: float(rng.uniform(0.4, 1.2)) for k in dynamics.parameters} | dynamics.constants
    numbers |= {INERTIA_ROTOR: 2.0, INERTIA_CASING: 0.7}
    f, a, b = dynamics.linearised(t, y, numbers)
    np.testing.assert_allclose(f, dynamics.rates(t, y, numbers), rtol=1e-13)
    for i, state in enumerate(dynamics.states):
        step = 1e-5 * typical[state]
        shift = np.zeros(n)
        shift[i] = step
        slope = (dynamics.rates(t, y + shift, numbers) - dynamics.rates(t, y - shift, numbers)) / (2 * step)
        np.testing.assert_allclose(a[..., i], slope, rtol=1e-6, atol=1e-8 * np.abs(f).max() / typical[state])
    for j, key in enumerate(dynamics.parameters):
        more, less = numbers | {key: numbers[key] + 1e-5}, numbers | {key: numbers[key] - 1e-5}
        slope = (dynamics.rates(t, y, more) - dynamics.rates(t, y, less)) / 2e-5
        np.testing.assert_allclose(b[..., j], slope, rtol=1e-6, atol=1e-8 * np.abs(f).max())
