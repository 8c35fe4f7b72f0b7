"""Fits of driven bodies: constants with their uncertainties, laws of inputs, and what is refused."""

import numpy as np
import pytest

from fitting import (
    LIBRARY,
    EffectError,
    EstimationError,
    Experiment,
    Input,
    Model,
    RecordError,
    budget,
    diagnose,
    effect,
    first_order,
    fit,
    make_record,
    simulate,
)
from fitting._criteria import DEFAULT
from fitting.discovery._refine import fit_from_scratch, scores_mislead
from fitting.discovery._score import CaseColumns, score
from fitting.discovery._select import applicable_effects, needed_drives
from fitting.inference import _result
from fitting.inference._case_data import CaseData
from fitting.inference._compression import cuts_at_steps, responses_to_inputs
from fitting.inference._fit import fit as search

TIME = np.arange(0.0, 4.0, 0.01)
TAU, GAIN, NOISE = 0.2, 6.0, 0.014
STEPS = Input("voltage", [0.0, 0.5, 2.5], [0.0, 3.0, 1.0], "V", interpolation="hold")


def response(tau=TAU, gain=GAIN, delay=0.0):
    omega, final, start = np.zeros(len(TIME)), 0.0, 0.0
    for begin, value in zip([0.5 + delay, 2.5 + delay], [3.0, 1.0], strict=True):
        here = begin <= TIME
        final = gain * value
        start = 0.0 if begin < 2 else gain * 3.0 * (1 - np.exp(-2.0 / tau))
        omega[here] = final + (start - final) * np.exp(-(TIME[here] - begin) / tau)
    return omega


def record(omega=None, *, inputs=(STEPS,), seed=1, angle=False, **more):
    random = np.random.default_rng(seed)
    value = response() if omega is None else omega
    if angle:
        value = np.concatenate([[0.0], np.cumsum(0.5 * (value[1:] + value[:-1]) * np.diff(TIME))])
    value = value + NOISE * random.standard_normal(len(TIME))
    given = {"I_rotor": 1.0, "I_casing": 1.0, "per_inertia": True, "single": True, **more}
    run = (TIME, value, np.full(len(TIME), NOISE))
    return make_record(casing=run, rotor=[], quantity="angle" if angle else "omega", inputs=inputs, **given)


def model(inputs, *names, law="casing: k*voltage"):
    found = Model.of(["casing.air.linear"]) + effect(law, inputs)
    for name in names:
        found = found + effect(name, inputs)
    return found


@pytest.mark.parametrize("angle", [False, True])
def test_time_constant_and_gain_of_a_driven_body(angle):
    data = record(angle=angle)
    found = fit(model(data.inputs), data)
    (one,) = first_order(found)
    assert abs(one.time_constant.value - TAU) < 3 * one.time_constant.stderr < 0.1 * TAU
    gain = one.gains["voltage"]
    assert abs(gain.value - GAIN) < 3 * gain.stderr < 0.05 * GAIN
    assert (one.time_constant.unit, gain.unit) == ("s", "rad s-1 V-1")
    assert found.verdict == "no_lack_of_fit"


@pytest.mark.slow
def test_the_uncertainty_of_a_time_constant_is_that_of_repeated_records():
    pulls = []
    for seed in range(12):
        data = record(seed=seed)
        (one,) = first_order(fit(model(data.inputs), data))
        pulls.append((one.time_constant.value - TAU) / one.time_constant.stderr)
    assert 0.5 < np.sqrt(np.mean(np.square(pulls))) < 1.6


def test_time_constant_and_gain_follow_from_the_parameters():
    data = record(per_inertia=False, I_casing=0.25)
    found = fit(model(data.inputs), data)
    (one,) = first_order(found)
    c, k = (found.estimates[n].value for n in ("casing.air.linear.b2", "casing: k*voltage.k"))
    assert one.time_constant.value == pytest.approx(0.25 / c)
    assert one.gains["voltage"].value == pytest.approx(k / c)
    # by the law of propagation, with the covariance of c and k
    names = found.problem.layout.names
    i, j = names.index("casing.air.linear.b2"), names.index("casing: k*voltage.k")
    v = found.covariance
    assert one.time_constant.stderr == pytest.approx(0.25 / c**2 * np.sqrt(v[i, i]))
    relative = v[j, j] / k**2 + v[i, i] / c**2 - 2 * v[i, j] / (k * c)
    assert one.gains["voltage"].stderr == pytest.approx(k / c * np.sqrt(relative))
    assert found.estimates["casing: k*voltage.k"].unit == "N m V-1"


def test_a_dead_time_is_fitted():
    data = record(response(delay=0.03))
    found = fit(model(data.inputs, "input.voltage.delay"), data)
    (one,) = first_order(found)
    delay = one.delays["voltage"]
    assert abs(delay.value - 0.03) < 3 * delay.stderr < 0.01
    assert abs(one.time_constant.value - TAU) < 3 * one.time_constant.stderr


@pytest.mark.parametrize("law", ["casing: -k*omega_c*abs(omega_c)", "casing: -k*omega_c*voltage"])
def test_a_response_that_is_not_linear_has_no_constants(law):
    data = record()
    found = fit(model(data.inputs) + effect(law, data.inputs), data)
    assert first_order(found) == ()


def test_a_body_without_an_input_has_no_constants():
    data = record(10 * np.exp(-TIME), inputs=())
    assert first_order(fit(Model.of(["casing.air.linear"]), data)) == ()
    with pytest.raises(EstimationError, match="not a Fit"):
        first_order(data)


@pytest.mark.parametrize(
    ("law", "unit"),
    [
        ("casing: k*voltage", "N m V-1"),
        ("casing: k*voltage**2", "N m V-2"),
        ("casing: -k*voltage*omega_c", "N m s V-1"),
        ("casing: k*voltage*sign(omega_c)", "N m V-1"),
        ("casing.input.voltage", "N m V-1"),
    ],
)
def test_the_unit_of_a_strength_follows_from_that_of_the_input(law, unit):
    assert effect(law, [STEPS]).amplitude.unit == unit
    assert effect(law, {"voltage": "V"}) == effect(law, [STEPS])


def test_the_strength_of_a_torque_input_is_a_number_or_per_unit_of_inertia():
    torque = Input("torque", [0.0, 0.5], [0.0, 1.0], "N m", interpolation="hold")
    law = effect("casing: k*torque", [torque])
    assert law.amplitude.unit == "1"
    data = record(inputs=(torque,))
    found = fit(Model.of(["casing.air.linear"]) + law, data)
    assert found.estimates["casing: k*torque.k"].unit == "kg-1 m-2"
    assert found.estimates["casing.air.linear.b2"].unit == "s-1"


@pytest.mark.parametrize(
    ("law", "inputs", "words"),
    [
        ("casing: k*current", [STEPS], "Recorded inputs: voltage."),
        ("casing: k*current", [], "The recording has no input."),
        ("casing: k*current*omega_c", [STEPS], "occur as a product only"),
        ("casing.input.current", [STEPS], "needs the input current. Recorded inputs: voltage."),
        ("input.current.delay", [], "needs the input current. The recording has no input."),
        ("casing: k*voltags", [STEPS], "did you mean voltage?"),
    ],
)
def test_a_law_of_an_unknown_input_is_refused_in_one_sentence(law, inputs, words):
    with pytest.raises(EffectError) as caught:
        effect(law, inputs)
    assert words in caught.value.message


def test_a_record_without_the_input_of_a_law_is_refused():
    with pytest.raises(EstimationError, match="needs the input voltage of case; it has none"):
        fit(model([STEPS]), record(inputs=()))
    other = Input("voltage", [0.0, 0.5], [0.0, 1.0], "A", interpolation="hold")
    with pytest.raises(EstimationError, match="in the unit V, but the record has it in A"):
        fit(model([STEPS]), record(inputs=(other,)))
    with pytest.raises(EstimationError, match="no law of the model depends on voltage"):
        fit(Model.of(["casing.air.linear"]) + effect("input.voltage.delay", [STEPS]), record())


@pytest.mark.parametrize(("last", "covers"), [(4.5, True), (3.0, False)])
def test_a_linear_input_covers_the_record(last, covers):
    given = Input("u", np.linspace(0.0, last, 50), np.zeros(50))
    if covers:
        assert record(inputs=(given,)).inputs == (given,)
        return
    with pytest.raises(RecordError, match=r"is known from 0 to 3 s, the motion from 0 to 3\.99 s"):
        record(inputs=(given,))


def test_inputs_are_part_of_the_digest_and_their_names_differ():
    other = Input("voltage", [0.0, 0.5], [0.0, 3.0], "V", interpolation="hold")
    assert len({record().digest, record(inputs=()).digest, record(inputs=(other,)).digest}) == 3
    with pytest.raises(RecordError, match="several inputs named voltage"):
        record(inputs=(STEPS, other))
    with pytest.raises(RecordError, match="an input is not an Input"):
        record(inputs=("voltage",))


@pytest.mark.parametrize(
    "wrong", [{"casing": TIME}, {"casing": (TIME, TIME)}, {"rotor": 3}, {"quantity": "rpm"}]
)
def test_wrong_arguments_of_a_record_are_refused_in_one_sentence(wrong):
    right = {"casing": (TIME, TIME, TIME), "rotor": [], "I_rotor": 1.0, "I_casing": 1.0, "single": True}
    with pytest.raises(RecordError):
        make_record(**(right | wrong))


def test_blocks_begin_at_the_steps_of_an_input():
    data = CaseData.of(record())
    starts = {int(where.start) for where, _ in data.casing.operators}
    assert {50, 250} <= starts
    assert {70, 110} <= starts  # short blocks after a step
    assert cuts_at_steps(TIME, [STEPS]).tolist() == [50, 70, 110, 250, 270, 310]


@pytest.mark.parametrize(("steps", "found"), [(12, True), (13, False)])
def test_an_input_that_changes_too_often_divides_no_block(steps, found):
    at = np.linspace(0.2, 3.8, steps)
    given = Input("u", np.r_[0.0, at], np.arange(steps + 1) % 2, interpolation="hold")
    assert bool(len(cuts_at_steps(TIME, [given]))) is found


def test_noise_is_that_beside_the_response_to_an_input():
    random = np.random.default_rng(3)
    often = Input("u", TIME[::4], random.choice([-1.0, 1.0], len(TIME[::4])), "V", interpolation="hold")
    from scipy.signal import lfilter

    a = np.exp(-0.01 / 0.05)
    u = often(TIME)
    omega = np.asarray(lfilter([0.0, 1 - a], [1.0, -a], u - u[0])) + u[0]
    data = CaseData.of(record(omega, inputs=(often,)))
    assert data.casing.scale == pytest.approx(1.0, abs=0.25)
    columns = responses_to_inputs(TIME, [often], angle=False)
    columns = np.column_stack([columns, np.ones(len(TIME))])
    rest = omega - columns @ np.linalg.lstsq(columns, omega, rcond=None)[0]
    assert np.std(rest) < 0.02 * np.std(omega)


def test_a_driven_body_that_reverses_does_not_oscillate():
    there_and_back = Input("u", np.arange(0.0, 4.0, 0.5), [1.0, -1.0] * 4, "V", interpolation="hold")
    omega, y, a = np.zeros(len(TIME)), 0.0, np.exp(-0.01 / TAU)
    for i, u in enumerate(there_and_back(TIME)):
        omega[i] = y
        y = a * y + (1 - a) * GAIN * u
    assert CaseData.of(record(omega, inputs=())).oscillation is not None
    data = CaseData.of(record(omega, inputs=(there_and_back,)))
    assert data.oscillation is None
    found = fit(model(data.record.inputs, law="casing: k*u"), data)
    (one,) = first_order(found)
    assert abs(one.time_constant.value - TAU) < 3 * one.time_constant.stderr


@pytest.mark.parametrize(("share", "needed"), [(1.0, True), (0.6, True), (0.2, False), (0.0, False)])
def test_a_recorded_drive_is_needed_where_it_explains_the_motion(share, needed):
    # with no share of the drive the body coasts, and the input has nothing to do with it
    omega = share * response() + (1 - share) * 10 * np.exp(-TIME)
    data = record(omega)
    base = fit(Model.of(["casing.air.linear"]), data)
    effects = applicable_effects(base, ())
    assert {e.name for e in effects if e.inputs} == {"casing.input.voltage"}
    assert needed_drives(base, effects) == ({"casing.input.voltage"} if needed else set())


QUADRATIC = 0.042


@pytest.fixture(scope="module")
def quadratic():
    """One step, dw/dt = k u - c w - q w^2 with the closed form w = a tanh(...): a score about 40 % too much drag."""
    k, c, q, u, noise = 60.0, 14.0, QUADRATIC, 24.0, 2e-3
    time, half = np.arange(0.0, 7.0, 0.008), c / (2 * q)
    rate = np.sqrt((0.5 * c) ** 2 + k * u * q)
    phase = rate * np.maximum(time - 0.7, 0.0) + np.arctanh(half * q / rate)
    # the integral of (rate / q) tanh(phase) - half, from the step on
    angle = (np.log(np.cosh(phase)) - np.log(np.cosh(phase[0]))) / q - half * np.maximum(time - 0.7, 0.0)
    angle = angle + noise * np.random.default_rng(1).standard_normal(len(time))
    step = Input("voltage", [0.0, 0.7], [0.0, u], "V", interpolation="hold")
    run, unit = (time, angle, np.full(len(time), noise)), {"per_inertia": True, "single": True}
    data = make_record(casing=run, rotor=[], inputs=[step], I_rotor=1, I_casing=1, **unit)
    return fit(model(data.inputs), data)


def test_a_quadratic_drag_beside_a_drive_is_fitted_from_scratch_because_its_score_has_the_wrong_sign(
    quadratic,
):
    assert scores_mislead(quadratic, DEFAULT)
    (screened,) = score(quadratic, [LIBRARY["casing.air.quadratic"]], [CaseColumns(quadratic, 0)], DEFAULT)
    assert screened.score == 0
    found = fit_from_scratch(quadratic, LIBRARY["casing.air.quadratic"])
    strength = found.estimates["casing.air.quadratic.k"]
    assert abs(strength.value - QUADRATIC) < 4 * strength.stderr
    assert found.bic < quadratic.bic - DEFAULT.evidence
    assert not scores_mislead(found, DEFAULT)


@pytest.mark.slow
def test_a_quadratic_drag_beside_a_drive_is_the_missing_effect(quadratic):
    found = diagnose(quadratic)
    first = found.candidates[0]
    assert first.effect.name == "casing.air.quadratic"
    (strength,) = first.estimates.values()
    assert abs(strength.value - QUADRATIC) < 4 * strength.stderr
    assert first.screened.score == 0
    lines = repr(found).splitlines()
    assert lines[0].startswith("diagnosis: missing_effect")
    assert len(lines) <= 20
    assert max(map(len, lines)) <= 120


def test_a_law_that_the_model_has_under_another_name_is_not_a_candidate():
    data = record()
    found = fit(model(data.inputs, law="casing: b*voltage"), data)
    names = {e.name for e in applicable_effects(found, ()) if e.inputs}
    assert names == {"input.voltage.delay"}


def test_a_calibration_of_an_input_is_one_of_its_torque_constant():
    # a voltmeter that errs by 1 % changes k by 1 %, and nothing else
    calibrated = Input(STEPS.name, STEPS.time, STEPS.value, "V", 0.01 * STEPS.value, "hold")
    data = record(inputs=(calibrated,))
    found = fit(model(data.inputs), data)
    parts = {k: {c.source: c.u for c in b.contributions} for k, b in budget(found).items()}
    k = found.estimates["casing: k*voltage.k"].value
    assert parts["casing: k*voltage.k"]["calibration of voltage"] == pytest.approx(0.01 * k, rel=0.02)
    c = found.estimates["casing.air.linear.b2"]
    assert parts["casing.air.linear.b2"].get("calibration of voltage", 0.0) < 1e-3 * c.value
    exact = budget(fit(model([STEPS]), record())).values()
    assert "calibration of voltage" not in {x.source for b in exact for x in b.contributions}


def test_a_changepoint_is_a_candidate_only_beside_the_dead_time_of_an_input():
    # a torque that sets in after a step of the input imitates its dead time
    data = record()
    for names, tried in ((), False), (("input.voltage.delay",), True):
        found = fit(model(data.inputs, *names), data)
        assert ("touchpoint.step" in {e.name for e in applicable_effects(found, ())}) is tried


@pytest.mark.slow
def test_results_print_themselves_within_a_screen():
    windows = [(TIME[k : k + 40], TIME[k : k + 40], np.ones(40)) for k in range(0, 400, 40)]
    many = [Input(f"u{k}", [0.0, 1.0], [0.0, 1.0], interpolation="hold") for k in range(9)]
    two = make_record(
        casing=(TIME, TIME, np.ones(len(TIME))), rotor=windows, I_rotor=1, I_casing=2, inputs=many
    )
    data = record()
    found = fit(model(data.inputs), data)
    answer = diagnose(found)
    for shown in (two, data, found, answer, answer.candidates[0], CaseData.of(two), STEPS):
        lines = repr(shown).splitlines()
        assert len(lines) <= 20
        assert max(map(len, lines)) <= 120
    assert "Input 'voltage': 0 to 3 V" in repr(data)
    assert "4 more windows" in repr(two)
    assert repr(answer).startswith("diagnosis: adequate")


@pytest.mark.parametrize(("rise", "driven"), [(0.8, False), (1.2, True)])
def test_a_body_with_an_input_is_driven_if_it_becomes_faster(rise, driven):
    # the rise of the speed is a tenth of the largest one, times 0.8 and 1.2
    omega = np.where(TIME < 2.0, 10.0 - 2.0 * TIME, 6.0 + 0.5 * rise * (TIME - 2.0))
    assert CaseData.of(record(omega)).driven is driven
    assert not CaseData.of(record(omega, inputs=())).driven


@pytest.mark.slow
def test_a_rotor_that_a_current_drives_in_its_casing():
    current = Input("current", [0.0, 4.0, 12.0], [0.0, 0.5, 0.1], "A", interpolation="hold")
    law = effect("rotor.input.current", [current])
    world = Model.of("linear") + law
    truth = {
        "rotor.air.quadratic.a2": 1e-10,
        "touchpoint.constant.b1": 2.9e-6,
        "casing.air.linear.b2": 8e-7,
        "bearing.linear.d": 2e-7,
        "rotor.input.current.k": 2e-3,
    }
    run = Experiment(duration=20.0, windows=(1.0, 5.0, 10.0, 16.0), casing_fps=100.0, rotor_fps=200.0)
    data = simulate(
        world, truth, run, inertia_rotor=5.54e-5, inertia_casing=2.06e-5, inputs=[current], seed=2
    )
    found = fit(world, data)
    k = found.estimates["rotor.input.current.k"]
    assert abs(k.value - 2e-3) < 4 * k.stderr < 0.02 * 2e-3
    assert k.unit == "N m A-1"
    names = {e.name for e in applicable_effects(fit(Model.of("linear"), data), ()) if e.inputs}
    assert names == {f"{body}.input.current" for body in ("rotor", "casing", "bearing")}


@pytest.mark.parametrize(
    ("arguments", "words"), [((3,), "not an effect"), (("casing: k*u", 5), "holds no inputs")]
)
def test_wrong_arguments_of_an_effect_are_refused_in_one_sentence(arguments, words):
    with pytest.raises(EffectError, match=words):
        effect(*arguments)


@pytest.mark.slow
def test_inputs_that_not_all_recordings_have_are_not_candidates():
    records = [record(label="a"), record(label="b", inputs=(), seed=2)]
    found = search(Model.of(["casing.air.linear"]), records, quick=True)
    assert not any(e.inputs for e in applicable_effects(found, ()))
    both = search(Model.of(["casing.air.linear"]), [record(label="a"), record(label="b", seed=2)], quick=True)
    assert [e.name for e in applicable_effects(both, ()) if e.inputs] == ["casing.input.voltage"]


@pytest.mark.parametrize(("drag", "wider"), [(0.0, False), (0.02, True)])
def test_the_uncertainty_of_a_model_that_is_not_exact_contains_its_slow_residuals(monkeypatch, drag, wider):
    # a quadratic drag that the model lacks; without it the residuals are white
    omega, y, h = np.zeros(len(TIME)), 0.0, 0.01 / 50
    for i, u in enumerate(STEPS(TIME)):
        omega[i] = y
        for _ in range(50):
            y += h * ((GAIN * u - y) / TAU - drag * y * abs(y) / TAU)
    data = CaseData.of(record(omega))
    found = fit(model(data.record.inputs), data)
    monkeypatch.setattr(_result, "_INEXACT", np.inf)
    (one,), (plain,) = first_order(found), first_order(fit(model(data.record.inputs), data))
    ratio = one.time_constant.stderr / plain.time_constant.stderr
    assert (ratio > 1.5) is wider
    assert one.time_constant.value == pytest.approx(plain.time_constant.value)
    if not wider:
        assert ratio == pytest.approx(1.0)
