"""Recorded inputs: their values between samples, and the motion that they drive, against closed forms."""

import numpy as np
import pytest

from fitting import Input, Model, RecordError, effect
from fitting.dynamics._collocation import Mesh, Sampler
from fitting.dynamics._events import solve
from fitting.dynamics._inputs import MOST_CHANGES
from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR, Dynamics
from fitting.dynamics._sensitivities import sensitivities

K, C, J = 3.0, 0.8, 0.25
TAU = J / C
TIMES = np.linspace(0.0, 6.0, 601)


def solved(given, times=TIMES, *, delay=None, dry=0.0, start=0.0, law="casing: k*u"):
    names = ["casing.air.linear", *(["touchpoint.constant"] if dry else [])]
    model = Model.of(names) + effect(law, [given])
    numbers = {"casing.air.linear.b2": C, f"{law}.k": K, "touchpoint.constant.b1": dry}
    if delay is not None:
        model = model + effect("input.u.delay", [given])
        numbers["input.u.delay.T"] = delay
    numbers |= {INERTIA_ROTOR: 1.0, INERTIA_CASING: J}
    dynamics = Dynamics(model, inputs=[given])
    path = solve(dynamics, numbers, np.array([0.0, start]), Mesh.uniform(times[0], times[-1], 12))
    return dynamics, numbers, path, Sampler(path.mesh, times).value(path.y)[:, 1]


def test_a_held_input_keeps_its_last_value_and_is_continuous_to_the_right():
    held = Input("u", [1.0, 2.0, 4.0], [5.0, 7.0, -1.0], interpolation="hold")
    at = [0.0, 1.0, 1.999, 2.0, np.nextafter(4.0, 0), 4.0, 9.0]
    assert held(at) == pytest.approx([5, 5, 5, 7, 7, -1, -1])
    assert held.integral(np.array([1.0, 3.0, 5.0])) == pytest.approx([0.0, 12.0, 18.0])
    assert held.changes(0, 9) == pytest.approx([2.0, 4.0])
    assert held.slope(at) == pytest.approx(0.0)


def test_a_linear_input_is_interpolated_and_its_kinks_are_where_the_slope_changes():
    ramp = Input("u", [0.0, 1.0, 2.0, 3.0], [0.0, 2.0, 4.0, 4.0])
    assert ramp([0.5, 2.5]) == pytest.approx([1.0, 4.0])
    assert ramp.slope([0.5, 1.0, 2.5, 3.5]) == pytest.approx([2.0, 2.0, 0.0, 0.0])
    assert ramp.integral(np.array([0.0, 2.0])) == pytest.approx([0.0, 4.0])
    assert ramp.changes(-1, 9) == pytest.approx([0.0, 2.0])  # at 1 and 3 the slope is the same
    assert ramp.means(np.array([0.0, 1.0, 3.0])) == pytest.approx([1.0, 3.5])


@pytest.mark.parametrize(("size", "kinks"), [(0.9e-7, 0), (1.1e-7, 1)])
def test_a_change_of_the_slope_in_the_eighth_digit_is_rounding_error(size, kinks):
    time = np.linspace(0.0, 1.0, 11)
    value = 3.0 * time + 3.0 * size * np.maximum(time - 0.5, 0.0) / 0.1
    assert len(Input("u", time, value).changes(0.05, 0.95)) == kinks


@pytest.mark.parametrize("kind", ["hold", "linear"])
def test_a_delay_shifts_the_input(kind):
    given = Input("u", [0.0, 1.0, 2.0], [0.0, 2.0, 1.0], interpolation=kind)
    late = Input("u", [0.0, 1.0, 2.0], [0.0, 2.0, 1.0], interpolation=kind, delay=0.3)
    t = np.linspace(0.0, 4.0, 77)
    assert late(t + 0.3) == pytest.approx(given(t))
    assert given(t + 0.3, 0.3) == pytest.approx(given(t))
    assert late.changes(0, 9) == pytest.approx(given.changes(-1, 9) + 0.3)


@pytest.mark.parametrize(("count", "same"), [(MOST_CHANGES + 2, True), (MOST_CHANGES + 3, False)])
def test_an_input_with_too_many_changes_is_averaged_with_the_same_impulse(count, same):
    random = np.random.default_rng(1)
    given = Input("u", np.linspace(0.0, 1.0, count), random.standard_normal(count), interpolation="hold")
    few = given.followed(0.0, 1.0)
    assert (few is given) is same
    ends = np.array([0.0, 1.0])
    assert few.integral(ends) == pytest.approx(given.integral(ends), abs=1e-12)
    assert len(few.changes(0.0, 1.0)) <= MOST_CHANGES


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("omega_c", [0, 1], [0, 1]), "another meaning"),
        (("sign", [0, 1], [0, 1]), "another meaning"),
        (("a b", [0, 1], [0, 1]), "letters, digits"),
        (("u", [0, 1], [0, 1, 2]), "shape"),
        (("u", [1, 0], [0, 1]), "strictly increasing"),
        (("u", [0, 1], [0, np.nan]), "not finite"),
        (("u", ["a", "b"], [0, 1]), "no numbers"),
        (("u", [0, 1], [0, 1], "ft"), "not a unit"),
        (("u", [0, 1], [0, 1], "A", [0.1, -0.1]), "negative"),
        (("u", [0, 1], [0, 1], "A", None, "cubic"), "interpolation"),
    ],
)
def test_a_wrong_input_is_refused_in_one_sentence(arguments, words):
    with pytest.raises(RecordError) as caught:
        Input(*arguments)
    assert words in f"{caught.value.message} {caught.value.hint}"


def test_an_input_may_have_the_name_of_a_variable_that_users_do_not_write():
    assert Input("temperature", [0.0], [293.0], "K").symbol == "input.temperature"


def test_the_response_to_a_step_is_the_closed_form():
    *_, omega = solved(Input("u", [0.0, 1.0], [0.0, 2.0], interpolation="hold"))
    since = np.maximum(TIMES - 1.0, 0.0)
    assert omega == pytest.approx(2.0 * K / C * (1 - np.exp(-since / TAU)), rel=1e-8, abs=1e-8)


def test_the_response_to_a_ramp_is_the_closed_form():
    *_, omega = solved(Input("u", [0.0, 1.0, 3.0], [0.0, 0.0, 4.0]))
    since = np.clip(TIMES - 1.0, 0.0, 2.0)
    rising = 2.0 * K / C * (since - TAU * (1 - np.exp(-since / TAU)))
    after = np.maximum(TIMES - 3.0, 0.0)
    expected = 4.0 * K / C + (rising - 4.0 * K / C) * np.exp(-after / TAU)
    assert omega == pytest.approx(np.where(TIMES > 3.0, expected, rising), rel=1e-8, abs=1e-8)


def sampled_sinusoid(rate, count):
    t = np.linspace(0.0, 6.0, count)
    return Input("u", t, np.sin(rate * t))


def test_the_response_to_a_sampled_sinusoid_is_that_to_its_straight_pieces():
    # u = a + b s between samples: omega = (omega_0 - p) exp(-s / tau) + p + q s, q = K b / C, p = K a / C - q tau
    given = sampled_sinusoid(4.0, 601)
    *_, omega = solved(given)
    expected = np.zeros(601)
    for i, h in enumerate(np.diff(given.time)):
        q = K / C * (given.value[i + 1] - given.value[i]) / h
        p = K / C * given.value[i] - q * TAU
        expected[i + 1] = (expected[i] - p) * np.exp(-h / TAU) + p + q * h
    assert omega == pytest.approx(expected, rel=1e-8, abs=1e-8)


def test_the_response_to_a_sinusoid_is_that_of_a_low_pass():
    rate = 4.0
    *_, omega = solved(sampled_sinusoid(rate, 1801))
    x = rate * TAU
    gain = K / C / (1 + x**2)
    expected = gain * (np.sin(rate * TIMES) - x * np.cos(rate * TIMES) + x * np.exp(-TIMES / TAU))
    bound = K / C * (rate * 6.0 / 1800) ** 2 / 8  # of the straight pieces
    assert np.abs(omega - expected).max() < bound


@pytest.mark.parametrize("size", [0.9, 1.1])
def test_dry_friction_holds_a_body_until_the_input_exceeds_it(size):
    dry = K * 1.0
    *_, omega = solved(Input("u", [0.0, 2.0], [0.0, size], interpolation="hold"), dry=dry)
    since = np.maximum(TIMES - 2.0, 0.0)
    expected = max(K * size - dry, 0.0) / C * (1 - np.exp(-since / TAU))
    assert omega == pytest.approx(expected, rel=1e-8, abs=1e-9)


def test_spin_up_and_coast_down_with_dry_friction_are_one_motion():
    dry, on, off = 0.4, 0.5, 3.0
    *_, omega = solved(Input("u", [0.0, on, off], [0.0, 1.0, 0.0], interpolation="hold"), dry=dry)
    up = (K - dry) / C * (1 - np.exp(-(np.clip(TIMES, on, off) - on) / TAU))
    top = (K - dry) / C * (1 - np.exp(-(off - on) / TAU))
    down = (top + dry / C) * np.exp(-np.maximum(TIMES - off, 0.0) / TAU) - dry / C
    assert omega == pytest.approx(np.where(off < TIMES, np.maximum(down, 0.0), up), rel=1e-7, abs=1e-8)


@pytest.mark.parametrize("kind", ["hold", "linear"])
def test_a_dead_time_delays_the_response_and_its_derivative_is_exact(kind):
    given = Input("u", [0.0, 1.0, 2.5], [0.0, 2.0, 0.5], interpolation=kind)
    dynamics, numbers, path, late = solved(given, delay=0.2)
    *_, shifted = solved(Input("u", given.time + 0.2, given.value, interpolation=kind))
    assert late == pytest.approx(shifted, rel=1e-8, abs=1e-9)
    at = np.array([0.9, 1.7, 2.4, 3.3, 5.0])
    nodes = sensitivities(dynamics, numbers, path).nodes
    own = Sampler(path.mesh, at).value(nodes)[:, 1, dynamics.parameters.index("input.u.delay.T")]
    h = 1e-5
    ends = [solved(given, at_times, delay=0.2 + s)[3] for s in (h, -h) for at_times in [np.r_[0.0, at, 6.0]]]
    assert own == pytest.approx((ends[0] - ends[1])[1:-1] / (2 * h), rel=1e-5, abs=1e-7)


def test_a_product_with_the_sense_of_motion_is_friction_in_proportion_to_an_input():
    load = Input("u", [0.0, 1.0], [0.05, 0.6], interpolation="hold")
    *_, omega = solved(load, start=9.0, law="casing: -k*u*sign(omega_c)")
    before = (9.0 + 0.05 * K / C) * np.exp(-TIMES / TAU) - 0.05 * K / C
    at_one = (9.0 + 0.05 * K / C) * np.exp(-1.0 / TAU) - 0.05 * K / C
    after = (at_one + 0.6 * K / C) * np.exp(-(TIMES - 1.0) / TAU) - 0.6 * K / C
    expected = np.where(TIMES < 1.0, before, np.maximum(after, 0.0))
    moving = 1.0 + TAU * np.log(1 + at_one * C / (0.6 * K)) > TIMES
    assert omega[moving] == pytest.approx(expected[moving], rel=1e-8, abs=1e-8)
    assert omega[~moving] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("second", "of_first_order"), [("casing", True), ("rotor", False)])
def test_a_response_is_of_first_order_if_every_input_drives_the_body(second, of_first_order):
    inputs = [Input(name, [0.0, 1.0], [0.0, 2.0], interpolation="hold") for name in "uv"]
    laws = [effect(law, inputs) for law in ("casing: k*u", f"{second}: k*v")]
    model = Model.of(["casing.air.linear"]) + laws[0] + laws[1]
    assert (Dynamics(model, inputs=inputs).first_order is not None) is of_first_order
