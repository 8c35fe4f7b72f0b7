"""Effects of bodies and cameras that are not in the paper's models are recovered."""

import numpy as np
import pytest
import twobody
from cases import case, fitted, pulls

from fitting import REDUCED, Model, fit, make_record
from fitting.effects._user import resolve

TRUTH = twobody.truth()


# hidden torque; effect to add; true parameters; start values of shapes a step away from the truth
ADDED = {
    "touchpoint.step": (
        twobody.Hidden(jump=(88.3, -2e-6)),
        {"k": 2e-6, "t0": 88.3},
        {"t0": 87.5},
    ),
    "touchpoint.stribeck": (
        twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -8e-6 * np.exp(-abs(wc) / 15.0)),
        {"k": 8e-6, "w": 15.0},
        {"w": 10.0},
    ),
    "casing.air.quadratic": (
        twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -1e-10 * wc * abs(wc)),
        {"k": 1e-10},
        {},
    ),
    "bearing.heating": (
        twobody.Hidden(softening=2e-3, cooling=40.0),
        {"k": 2e-3, "tau_T": 40.0},
        {"tau_T": 30.0},
    ),
    "casing.windage": (
        twobody.Hidden(casing=lambda t, wr, wc, pr, pc: 3e-12 * wr * abs(wr)),
        {"k": 3e-12},
        {},
    ),
}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow) if n == "casing.windage" else n for n in ADDED]
)
@pytest.mark.slow
def test_an_added_effect_is_recovered(name):
    hidden, own, shapes = ADDED[name]
    measured = case({}, 31, "case1", hidden=hidden)
    start = {f"{name}.{k}": v for k, v in shapes.items()}
    result = fit(Model.of((*REDUCED, name)), [measured], start=start)
    true = TRUTH | {f"{name}.{k}": v for k, v in own.items()}
    found = pulls(result, true)
    assert result.verdict == "no_lack_of_fit"
    assert max(map(abs, found.values())) < 4.5, found
    strength = result.estimates[f"{name}.k"]
    assert abs(strength.value) > 5 * strength.stderr


POWER = "casing: -k*abs(omega_c)**n*sign(omega_c)"


@pytest.mark.parametrize(
    ("n", "k", "after"),
    [
        (1.7, 4e-9, True),
        (0.6, 2e-6, False),
        (3.0, 1e-12, False),
        (3.0, 1e-12, True),
    ],
)
@pytest.mark.slow
def test_a_free_power_of_a_users_law_is_found(n, k, after):
    """The law starts at n = 1, where it is the linear drag that the model has already."""
    measured = case(
        {}, 33, "case1", hidden=twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -k * abs(wc) ** n)
    )
    start = {a: e.value for a, e in fit(Model.of(REDUCED), [measured]).estimates.items()} if after else None
    result = fit(Model.of(REDUCED).with_effect(resolve(POWER)), [measured], start=start)
    assert result.verdict == "no_lack_of_fit"
    true = TRUTH | {f"{POWER}.k": k, f"{POWER}.n": n}
    assert max(map(abs, pulls(result, true).values())) < 4
    assert result.estimates[f"{POWER}.n"].stderr < 1e-3


@pytest.mark.slow
def test_a_harmonic_torque_on_the_casing_is_recovered():
    def gravity(t, wr, wc, pr, pc):
        return 1e-5 * np.sin(pc - 1.1)

    motion = twobody.simulate(span=40.0, hidden=twobody.Hidden(casing=gravity), step=0.0025)
    cameras = twobody.Cameras(span=40.0, windows=(5.0, 20.0, 36.0))
    record = make_record(**twobody.film(motion, seed=5, cameras=cameras))
    # the phase counts from the measured angle, which here starts at the motion's own zero
    result = fit(Model.of((*REDUCED, "casing.unbalance")), [record], start={"casing.unbalance.phi": 0.5})
    assert result.verdict == "no_lack_of_fit"
    k, phi = (result.estimates[f"casing.unbalance.{s}"] for s in ("k", "phi"))
    amplitude = k.value * np.exp(1j * phi.value)
    expected = 1e-5 * np.exp(1.1j)
    assert abs(amplitude - expected) < 4 * np.hypot(k.stderr, 1e-5 * phi.stderr)
    assert k.stderr < 1e-6


@pytest.mark.slow
def test_a_slow_clock_of_the_rotor_camera_is_recovered():
    raw = twobody.film(twobody.simulate(), seed=6)
    # the camera's clock runs slow: what it calls t was t (1 + eps), counted from the start of each clip
    motion, eps, rng = twobody.simulate(), 3e-4, np.random.default_rng(9)
    clips = []
    for t, _, sigma in raw["rotor"]:
        angle = motion.at(t[0] + (t - t[0]) * (1 + eps), 0)[0]
        clips.append((t, angle - angle[0] + sigma * rng.standard_normal(len(t)), sigma))
    raw["rotor"] = clips
    result = fit(Model.of((*REDUCED, "camera.clock")), [make_record(**raw)])
    clock = result.estimates["camera.clock.eps"]
    assert result.verdict == "no_lack_of_fit"
    assert abs(clock.value - eps) < 4 * clock.stderr
    assert clock.stderr < 1e-4


@pytest.mark.slow
def test_a_missing_torque_is_a_lack_of_fit_of_the_right_size():
    result = fitted(seed=0, hidden="step")
    assert result.verdict == "lack_of_fit"
    assert 3e-8 < result.torque_noise < 1e-6


BUMP = "casing: -k*exp(-((t - t0)/w)**2)"


@pytest.mark.slow
def test_the_position_of_a_user_peak_is_found():
    """Without initial values of its position and width."""
    true = {"k": 1.5e-6, "t0": 141.0, "w": 9.0}
    hidden = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -1.5e-6 * np.exp(-(((t - 141.0) / 9.0) ** 2)))
    measured = case({}, 31, "case1", hidden=hidden)
    base = fit(Model.of(REDUCED), [measured])
    start = {name: e.value for name, e in base.estimates.items()}
    found = fit(base.model.with_effect(resolve(BUMP)), [measured], start=start)
    assert found.verdict == "no_lack_of_fit"
    for symbol, value in true.items():
        e = found.estimates[f"{BUMP}.{symbol}"]
        assert e.value == pytest.approx(value, abs=4.5 * e.stderr)
        assert e.stderr < 0.2 * value
