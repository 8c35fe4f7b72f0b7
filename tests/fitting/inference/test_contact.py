"""Bodies in contact: against the analytic motion with and without slip, and on a real apparatus."""

from pathlib import Path

import numpy as np
import pytest

from fitting import LIBRARY, Effect, Model, Parameter, fit, make_record
from fitting.discovery._select import applicable_effects
from fitting.dynamics._collocation import Mesh, Sampler
from fitting.dynamics._events import solve
from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR, Dynamics
from fitting.dynamics._sensitivities import LinearMotion, sensitivities
from fitting.effects._library import find, of_the_rotor
from fitting.inference._case_data import CaseData

I_WHEEL, I_DRUM, RATIO = 0.1, 2.0, 2.5
ROLLING = ("contact.rolling", "rotor.air.linear", "touchpoint.constant")
NUMBERS = {
    "contact.rolling.n": RATIO, "contact.rolling.c": 0.0, "contact.rolling.T": 0.1, "rotor.air.linear.a1": 4e-3,
    "touchpoint.constant.b1": 0.3, INERTIA_ROTOR: I_WHEEL, INERTIA_CASING: I_DRUM,
}  # fmt: skip


def rolled(t, start=30.0, numbers=NUMBERS):
    """Speed of the drum: one body of inertia I_c + n^2 I_r under friction b1 and drag n^2 a1."""
    n = numbers["contact.rolling.n"]
    inertia, drag = I_DRUM + n**2 * I_WHEEL, n**2 * numbers["rotor.air.linear.a1"]
    held = numbers["touchpoint.constant.b1"] / drag
    return (start + held) * np.exp(-drag * t / inertia) - held


def angle(t, start=30.0):
    fine = np.linspace(0.0, t[-1], 20001)
    speed = rolled(fine, start)
    return np.interp(
        t, fine, np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(fine))])
    )


def path_of(numbers, start, span=60.0):
    dynamics = Dynamics(Model.of(ROLLING))
    first = np.array([numbers["contact.rolling.n"] * start, start])
    mesh = Mesh.uniform(0.0, span, 12).with_breakpoints(0.05 * 2.0 ** np.arange(6))
    return dynamics, solve(dynamics, numbers, first, mesh)


def test_rolling_bodies_keep_the_ratio_of_speeds():
    times = np.linspace(0.5, 60.0, 50)
    _, path = path_of(NUMBERS, 30.0)
    rotor, casing = Sampler(path.mesh, times).value(path.y).T
    np.testing.assert_allclose(casing, rolled(times), rtol=1e-9)
    np.testing.assert_allclose(rotor, RATIO * casing, rtol=1e-9)


def test_friction_that_holds_one_rolling_body_holds_both():
    """At one state, rolling in the first row and held in the second one: no speed changes, whatever a parameter is."""
    dynamics = Dynamics(Model.of(ROLLING))
    given = np.zeros(2), np.full((2, 2), [RATIO, 1.0]), NUMBERS, np.array([1.0, 0.0])
    for found in (dynamics.rates(*given), *dynamics.linearised(*given)):
        assert np.abs(found[0]).min(axis=tuple(range(1, found.ndim - 1))).any()
        assert not found[1].any()


def test_a_torque_on_one_rolling_body_accelerates_both():
    """The linearised motion, by which process noise and further laws act, has the inertia of both."""
    dynamics, path = path_of(NUMBERS, 30.0)
    motion = LinearMotion(path, sensitivities(dynamics, NUMBERS, path).propagator)
    times = np.linspace(0.0, 20.0, 401)
    push = np.full((400, 3, 1), 1e-3)
    drag = RATIO**2 * NUMBERS["rotor.air.linear.a1"]
    inertia = I_DRUM + RATIO**2 * I_WHEEL
    for direction, strength in (((0.0, 1 / I_DRUM), 1.0), ((1 / I_WHEEL, 0.0), RATIO)):
        speed, _ = motion.driven(times, push.shape[1], np.array(direction))(push)
        expected = strength * 1e-3 / drag * (1 - np.exp(-drag * times / inertia))
        np.testing.assert_allclose(speed[1, :, 0], expected, rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(speed[0, :, 0], RATIO * expected, rtol=1e-6, atol=1e-12)


def test_creep_is_a_slip_that_grows_with_the_torque():
    """The contact brings the drum's friction to the wheel: slip / omega_r is c times what it passes on."""
    numbers = NUMBERS | {"contact.rolling.c": 0.02}
    _, path = path_of(numbers, 30.0)
    times = np.linspace(5.0, 55.0, 40)
    rotor, casing = Sampler(path.mesh, times).value(path.y).T
    drag = NUMBERS["rotor.air.linear.a1"] * rotor
    friction = NUMBERS["touchpoint.constant.b1"]
    passed = (drag * I_DRUM - RATIO * friction * I_WHEEL) / (I_DRUM + RATIO**2 * I_WHEEL)
    np.testing.assert_allclose((RATIO * casing - rotor) / rotor, 0.02 * passed, rtol=0.01)


def test_sensitivities_by_the_ratio_and_the_one_initial_speed():
    dynamics, path = path_of(NUMBERS, 30.0)
    found = sensitivities(dynamics, NUMBERS, path)
    times = np.linspace(0.0, 60.0, 20)
    speeds = Sampler(path.mesh, times).value(found.nodes)
    assert speeds.shape[2] == len(dynamics.parameters) + 1

    def at(changed, start):
        p = path_of(NUMBERS | changed, start)[1]
        return Sampler(p.mesh, times).value(p.y)

    shifts = {k: ({k: NUMBERS[k] * 1e-4 or 1e-4}, 0.0) for k in dynamics.parameters} | {"initial": ({}, 1e-3)}
    for j, (shift, start) in enumerate(shifts.values()):
        step = start or next(iter(shift.values()))
        up = at({k: NUMBERS[k] + v for k, v in shift.items()}, 30.0 + start)
        down = at({k: NUMBERS[k] - v for k, v in shift.items()}, 30.0 - start)
        slope = (up - down) / (2 * step)
        np.testing.assert_allclose(speeds[..., j], slope, rtol=2e-4, atol=1e-4 * np.abs(slope).max())


def test_a_sliding_contact_brings_the_rims_to_one_speed():
    """Coulomb friction takes k / I_r from one and gives n k / I_c to the other until the slip is gone."""
    k, start = 0.5, np.array([100.0, 0.0])
    numbers = {
        "contact.sliding.k": k, "contact.sliding.n": RATIO, "contact.sliding.w": 0.5,
        INERTIA_ROTOR: I_WHEEL, INERTIA_CASING: I_DRUM,
    }  # fmt: skip
    dynamics = Dynamics(Model.of(["contact.sliding"]))
    path = solve(dynamics, numbers, start, Mesh.uniform(0.0, 40.0, 400))
    sliding = start[0] / (k / I_WHEEL + RATIO**2 * k / I_DRUM)
    early = np.linspace(0.0, 0.95 * sliding, 10)
    rotor, casing = Sampler(path.mesh, early).value(path.y).T
    np.testing.assert_allclose(rotor, start[0] - k / I_WHEEL * early, rtol=1e-5)
    np.testing.assert_allclose(casing, RATIO * k / I_DRUM * early, rtol=1e-5, atol=1e-6)
    rotor, casing = Sampler(path.mesh, np.array([39.0])).value(path.y)[0]
    # angular momentum n L_r + L_c is kept by the contact
    both = I_WHEEL * start[0] * RATIO / (I_DRUM + RATIO**2 * I_WHEEL)
    assert casing == pytest.approx(both, rel=1e-5)
    assert rotor == pytest.approx(RATIO * both, rel=1e-5)


@pytest.mark.slow
def test_a_fit_finds_ratio_and_losses_of_rolling_bodies():
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 60.0, 0.05)
    turned = angle(t)
    sigma = 2e-3
    record = make_record(
        casing=(t, turned + sigma * rng.standard_normal(len(t)), np.full(len(t), sigma)),
        rotor=[(t, RATIO * turned + 0.7 + sigma * rng.standard_normal(len(t)), np.full(len(t), sigma))],
        I_rotor=I_WHEEL, I_casing=I_DRUM, label="rolling",
    )  # fmt: skip
    found = fit(Model.of(ROLLING), [record])
    assert not any(k.startswith("initial.omega_r") for k in found.estimates)
    for key, true in NUMBERS.items():
        if key in found.estimates and key != "contact.rolling.T":
            e = found.estimates[key]
            assert abs(e.value - true) < 4 * e.stderr or e.at_bound, key
            assert e.stderr < 0.05 * true or true == 0, key
    assert found.verdict == "no_lack_of_fit"


@pytest.mark.slow
@pytest.mark.release
def test_standard_uncertainties_of_a_contact_are_those_of_the_scatter():
    """Pulls over 16 recordings: their rms is 1, with a standard deviation of 0.18 for each parameter."""
    t, sigma = np.arange(0.0, 60.0, 0.05), 2e-3
    turned, pulls = angle(t), []
    for seed in range(16):
        noise = sigma * np.random.default_rng([9, seed]).standard_normal((2, len(t)))
        every = np.full(len(t), sigma)
        made = make_record(
            casing=(t, turned + noise[0], every), rotor=[(t, RATIO * turned + noise[1], every)],
            I_rotor=I_WHEEL, I_casing=I_DRUM, label="rolling",
        )  # fmt: skip
        found = fit(Model.of(ROLLING).with_fixed({"contact.rolling.c": 0.0}), [made]).estimates
        keys = ("contact.rolling.n", "rotor.air.linear.a1", "touchpoint.constant.b1")
        pulls.append([(found[k].value - NUMBERS[k]) / found[k].stderr for k in keys])
    rms = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert (rms > 0.5).all()
    assert (rms < 1.6).all()


def test_the_discovery_proposes_no_contact():
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 60.0, 0.1)
    turned = angle(t)
    noise = rng.standard_normal((2, len(t))) * 2e-3
    sigma = np.full(len(t), 2e-3)
    record = make_record(
        casing=(t, turned + noise[0], sigma), rotor=[(t, RATIO * turned + noise[1], sigma)],
        I_rotor=I_WHEEL, I_casing=I_DRUM, label="rolling",
    )  # fmt: skip
    base = fit(Model.of(["rotor.air.linear", "touchpoint.constant"]), [CaseData.of(record)])
    names = {e.name for e in applicable_effects(base, ())}
    assert names
    assert not names & {n for n, e in LIBRARY.items() if not e.searched}


@pytest.mark.parametrize(
    ("alone", "on_the_rotor"),
    [
        ("casing.air.quadratic", "rotor.air.quadratic"),
        ("casing.air.linear", "rotor.air.linear"),
        ("casing.air.laminar", "rotor.air.disk"),
        ("touchpoint.constant", "rotor.support"),
        ("casing.spring.linear", None),
        ("camera.centre", None),
    ],
)
def test_laws_of_a_single_body_equal_those_of_the_rotor(alone, on_the_rotor):
    found = of_the_rotor(find(alone))
    assert (found and found.name) == on_the_rotor


def test_a_contact_needs_a_ratio():
    lame = Effect("gear", "contact", "-k*slip", (Parameter("k", "N m s"),))
    with pytest.raises(Exception, match="has no ratio n"):
        lame.check()


RIG = Path(__file__).parents[3].parent / "shared" / "real" / "coastdown"


@pytest.mark.slow
@pytest.mark.skipif(not RIG.is_dir(), reason="recordings by others are not there")
def test_a_wheel_on_a_drum_is_fitted():
    """The ratio is that of the counted turns, up to the slip at 575 s, which is 0.4 rad."""
    from gyrotrack import import_case
    from gyrotrack.io.readers._motion_table import ReadOptions, read_names
    from gyrotrack.io.readers._run import Limits

    file = RIG / "contact_left.csv"
    options = [ReadOptions(names=read_names([f"revolutions={k}"])) for k in (3, 5)]
    case = import_case(
        file, [file], I_rotor=0.12, I_casing=14.0, options=options, limits=Limits(start=497.0, stop=570.0)
    )

    def samples(s):
        return s.time, s.angle, s.sigma

    record = make_record(
        casing=samples(case.casing), rotor=[samples(case.rotor)], I_rotor=0.12, I_casing=14.0, label="rig"
    )
    found = fit(Model.of(["contact.rolling", "touchpoint.constant", "casing.air.quadratic"]), [record])
    turned = np.interp(case.casing.time[9:-9], case.rotor.time, case.rotor.angle)
    counted = np.polyfit(case.casing.angle[9:-9], turned, 1)[0]
    ratio = found.estimates["contact.rolling.n"]
    assert ratio.value == pytest.approx(counted, rel=3e-4)
    assert ratio.stderr < 1e-3
