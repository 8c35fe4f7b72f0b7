"""The same record with another unit of time or of inertia has the same numbers in these units."""

from functools import lru_cache
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import LIBRARY, Model, fit, make_record
from fitting.discovery._select import rank
from fitting.inference._problem import reference_speed

TIME = np.linspace(0.0, 20.0, 401)
NOISE = 2e-3 * np.random.default_rng(4).standard_normal(len(TIME))


@lru_cache
def fitted(scale=1.0, inertia=1.0):
    """Return the fit of a wheel with dry friction and air drag whose times are multiplied by `scale`."""
    turned = np.log(1 + 20.0 * 0.02 * TIME) / 0.02
    run = TIME * scale, turned + NOISE, np.full(len(TIME), 2e-3)
    record = make_record(casing=run, rotor=[], I_rotor=1.0, I_casing=inertia, label="wheel")
    return fit(Model.of(["casing.air.quadratic"]), [record])


@pytest.mark.parametrize(("scale", "inertia"), [(60.0, 1.0), (1000.0, 1.0), (1.0, 1e-4), (1.0, 1e4)])
def test_a_fit_does_not_depend_on_the_units(scale, inertia):
    here, there = fitted(), fitted(scale, inertia)
    assert there.values["casing.air.quadratic.k"] == pytest.approx(
        inertia * here.values["casing.air.quadratic.k"], rel=2e-6
    )
    assert there.deviance == pytest.approx(here.deviance, rel=1e-6)


@lru_cache
def scores(quantity, scale=1.0):
    """Return the scores of all candidates for a wheel with an undescribed drag, with times multiplied by `scale`."""
    speed = 20.0 / (1 + 20.0 * 0.02 * TIME)
    turned = np.log(1 + 20.0 * 0.02 * TIME) / 0.02
    value, u = (turned + NOISE, 2e-3) if quantity == "angle" else ((speed + 10 * NOISE) / scale, 2e-2 / scale)
    run = TIME * scale, value, np.full(len(TIME), u)
    record = make_record(casing=run, rotor=[], I_rotor=1.0, I_casing=1.0, quantity=quantity, label="wheel")
    found = rank(fit(Model.of(["touchpoint.constant", "casing.air.linear"]), [record]), refitting=False)
    return {c.effect.name: c.score for c in found}


@pytest.mark.parametrize(
    ("quantity", "scale"),
    [
        ("omega", 1000.0),
        *(
            pytest.param(*p, marks=pytest.mark.slow)
            for p in (("angle", 1 / 60), ("omega", 1 / 60), ("angle", 1000.0))
        ),
    ],
)  # fmt: skip
def test_scores_do_not_depend_on_the_unit_of_time(quantity, scale):
    """Trial speeds and times are those of the record; no direction of the noise is that of rounding."""
    here, there = scores(quantity), scores(quantity, scale)
    assert here.keys() == there.keys()
    assert {"casing.brake.eddy", "touchpoint.stribeck", "casing.seal.cooling"} <= here.keys()
    for name, score in here.items():
        assert there[name] == pytest.approx(score, rel=1e-5, abs=1e-5), name


@pytest.mark.parametrize("scale", [1 / 60, 1.0, 1000.0])
def test_bounds_and_trial_values_follow_the_record(scale):
    """A critical speed is 0.001 to 1000 times the largest speed; a cooling time is in lengths of the record."""
    run = TIME * scale, 7.0 * TIME, np.full(len(TIME), 1e-3)
    record = make_record(casing=run, rotor=[], I_rotor=1.0, I_casing=1.0)
    speeds = record.largest_speeds
    assert speeds["omega_c"] == pytest.approx(7.0 / scale)
    assert speeds["omega_r"] == pytest.approx(7.0 / scale)
    by_symbol = {
        p.symbol: p for e in ("casing.brake.eddy", "casing.seal.cooling")
        for p in LIBRARY[e].parameters_at(speeds, 20.0 * scale)
    }  # fmt: skip
    w, tau = by_symbol["w"], by_symbol["tau_T"]
    assert (w.lower, w.upper) == pytest.approx((0.007 / scale, 7000.0 / scale))
    assert w.lower < min(w.grid) < w.start < max(w.grid) < w.upper
    assert tau.grid == pytest.approx([20.0 * scale * x for x in (0.03, 0.1, 0.3, 1.0, 3.0)])
    assert tau.lower < min(tau.grid) < max(tau.grid) < tau.upper
    assert {w.scale, tau.scale} == {""}


def test_the_largest_speed_of_a_noisy_oscillation():
    """The quantile of a sinusoid of 14 samples a period, and of speeds with an outlier."""
    t = np.arange(1400.0)
    swing = 0.5 * np.sin(2 * np.pi * t / 14.0) + 1e-3 * np.random.default_rng(1).standard_normal(1400)
    u = np.full(1400, 1e-3)
    angles = make_record(casing=(t, swing, u), rotor=[], I_rotor=1.0, I_casing=1.0)
    assert 0.5 < angles.largest_speeds["omega_c"] / (0.5 * 2 * np.pi / 14) < 1.0
    speeds = np.where(t == 700, 400.0, 3.0)
    found = make_record(casing=(t, speeds, u), rotor=[], I_rotor=1.0, I_casing=1.0, quantity="omega")
    assert found.largest_speeds["omega_c"] == pytest.approx(3.0)


@pytest.mark.parametrize(("speed", "reference"), [(1e-9, 9e-9), (5.0, 45.0), (0.0, 1.0)])
def test_the_reference_speed_has_no_limit_but_zero(speed, reference):
    speeds = np.full(10, speed)
    data = [SimpleNamespace(initial_speeds=(np.arange(10.0), np.column_stack([10 * speeds, speeds])))]
    assert reference_speed(data) == pytest.approx(reference)


@pytest.mark.parametrize("rate", [1e-6, 0.5, 2.0, 2e5])
def test_a_precession_of_any_rate_is_within_its_bounds(rate):
    """With a limit, a slow rotor gave a chirp of thousands of periods, whose integration took minutes."""
    (m,) = (p for p in LIBRARY["casing.precession"].parameters if p.symbol == "m")
    assert m.lower < rate < m.upper


def still(quantity, speed, sigma):
    """A record of a casing of a constant speed, beside a rotor of 300 rad/s."""
    rng = np.random.default_rng(3)
    t, w = np.arange(0.0, 20.0, 0.01), np.arange(2.0, 4.0, 0.001)
    values = (t, w) if quantity == "angle" else (np.ones_like(t), np.ones_like(w))
    runs = [
        (x, rate * v + s * rng.standard_normal(len(x)), np.full(len(x), s))
        for x, v, rate, s in ((t, values[0], speed, sigma), (w, values[1], 300.0, 1e-3))
    ]
    return make_record(casing=runs[0], rotor=runs[1:], I_rotor=1.0, I_casing=1.0, quantity=quantity)


@pytest.mark.parametrize(
    ("quantity", "speed", "sigma", "expected"),
    [
        ("angle", 0.0, 1e-3, 300.0),  # at rest: that of the rotor
        ("angle", 2.0, 1e-3, 2.0),
        ("omega", 3.0, 2.0, 4.5),  # averages of five samples err by 0.9; their quantile 0.95 is 1.5 higher
        ("omega", 0.0, 2.0, 300.0),
    ],
)
def test_the_largest_speed_is_not_that_of_noise(quantity, speed, sigma, expected):
    found = still(quantity, speed, sigma).largest_speeds
    assert found["omega_c"] == pytest.approx(expected, rel=0.1)
    assert found["omega_r"] == pytest.approx(300.0, rel=1e-2)
