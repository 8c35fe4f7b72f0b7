"""New recordings of a fit, against the errors that they must contain."""

from copy import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import chi2, kstest

from fitting import REDUCED, EstimationError, Experiment, Model, make_record, simulate
from fitting.inference import _replica
from fitting.inference._angle_noise import AngleNoise
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit
from fitting.inference._record import Samples
from fitting.inference._replica import replica
from fitting.inference._sampled import FittedMotion

BASE = Model.of(REDUCED).of_bodies({"casing"})


def motion(found):
    """Return what a fit expects at the samples of its first case."""
    return FittedMotion(found, 0, found.problem.data[0])


@pytest.fixture(scope="module")
def speeds():
    """Return a fit of measured speeds: I dw/dt = -b1 - b2 w, by SciPy, with white noise of 0.035 rad/s."""
    t = np.arange(0, 60, 0.1)
    w = solve_ivp(
        lambda _, w: -(2e-4 + 3e-5 * w) / 2e-3, (0, 60), [80.0], t_eval=t, rtol=1e-10, atol=1e-10
    ).y[0]
    noise = np.random.default_rng(0).normal(0, 0.035, len(t))
    record = make_record(
        casing=(t, w + noise, np.full(len(t), 0.035)),
        rotor=[],
        I_rotor=2e-3,
        I_casing=2e-3,
        quantity="omega",
        single=True,
    )
    return fit(BASE, [record])


@pytest.fixture(scope="module")
def gyroscope():
    """Two bodies for 30 s, with a clock error of the rotor's camera of 2e-3 and an unbalance in the model."""
    model = Model.of([*REDUCED, "casing.unbalance", "camera.clock"])
    numbers = {
        "rotor.air.quadratic.a2": 1.1e-10, "touchpoint.constant.b1": 2.9e-6, "casing.air.linear.b2": 8.3e-7,
        "bearing.linear.d": 1.6e-7, "bearing.power.f": 1.3e-8, "bearing.power.g": 1.3,
        "casing.unbalance.k": 3e-6, "casing.unbalance.phi": 0.7,
    }  # fmt: skip
    physical = Model.of([*REDUCED, "casing.unbalance"])
    run = Experiment(
        duration=30.0, windows=(2.0, 14.0, 25.0), window_length=2.0, casing_fps=30, rotor_fps=150
    )
    record = simulate(physical, numbers, run, inertia_rotor=5.54e-5, inertia_casing=2.06e-5, seed=3)
    windows = tuple(Samples(w.time, w.value + 2e-3 * (w.value - w.value[0]), w.sigma) for w in record.rotor)
    return fit(model, [replace(record, rotor=windows, digest="")])


def test_a_seed_determines_the_recording(speeds):
    one, same, other = (replica(speeds, s)[0] for s in (1, 1, 2))
    assert np.array_equal(one.casing.value, same.casing.value)
    assert not np.array_equal(one.casing.value, other.casing.value)


def test_times_uncertainties_and_label_are_those_of_the_original(speeds):
    old, new = speeds.problem.data[0].record, replica(speeds, 0)[0]
    assert np.array_equal(new.casing.time, old.casing.time)
    assert np.array_equal(new.casing.sigma, old.casing.sigma)
    assert (new.label, new.I_casing, new.quantity) == (old.label, old.I_casing, old.quantity)
    assert new.digest != old.digest


def test_white_noise_has_the_level_of_the_recording(speeds):
    old, new = speeds.problem.data[0].record, replica(speeds, 4)[0]
    path = speeds.predictions[0].path
    deviation = motion(speeds).expected(old.casing.time, rotor=False) - new.casing.value
    assert path.states[1] == "omega_c"
    scale = speeds.problem.data[0].casing.scale
    # successive differences hold the white noise alone
    measured = np.std(np.diff(deviation)) / np.sqrt(2) / old.casing.sigma[0]
    assert measured == pytest.approx(scale, rel=0.06)


def test_an_analysis_of_replicas_returns_the_values_of_the_fit(speeds):
    pulls = []
    for seed in range(6):
        again = fit(BASE, replica(speeds, seed))
        pulls += [(again.estimates[k].value - e.value) / again.estimates[k].stderr
                  for k, e in speeds.estimates.items() if again.estimates[k].stderr > 0]  # fmt: skip
    assert 0.6 < np.sqrt(np.mean(np.square(pulls))) < 1.5


def test_laws_of_an_angle_and_camera_effects_are_in_the_values(gyroscope):
    data, p = gyroscope.problem.data[0], gyroscope.predictions[0]
    values = motion(gyroscope).values()
    rows = data.sample_rows(values[0][:, None], [v[:, None] for v in values[1:]])[:, 0]
    # up to the nuisance columns, which are in the values, the rows are those that the fit predicts
    size = np.linalg.norm(data.nuisance, axis=0)
    free, deviation = data.nuisance[:, size > 0] / size[size > 0], rows - p.rows
    left = deviation - free @ np.linalg.lstsq(free, deviation, rcond=1e-9)[0]
    kept = slice(0, data.slices["nuisance_prior"].start)
    assert (
        np.abs(left[kept]).max() < 0.1
    )  # of the noise of a row; without the unbalance or the clock it is above 300
    bare = replace(gyroscope, model=gyroscope.model.without("casing.unbalance"))
    without = motion(bare).values()
    assert np.abs(values[0] - without[0]).max() > 3e-3


@pytest.mark.parametrize(("time", "step"), [(0.3, 0.01), (2.0, 0.5)])
def test_ornstein_uhlenbeck_process(time, step):
    random = np.random.default_rng(5)
    t = np.arange(0, 4000 * step, step)
    x = np.array([_replica._ornstein_uhlenbeck(t[:400], time, random) for _ in range(300)])
    assert np.std(x[:, 0]) == pytest.approx(1, abs=0.13)
    assert np.std(x[:, -1]) == pytest.approx(1, abs=0.13)
    lag = 20
    assert np.mean(x[:, 100] * x[:, 100 + lag]) == pytest.approx(np.exp(-lag * step / time), abs=0.2)


@pytest.mark.parametrize("bodies", ["speeds", "gyroscope"])
def test_random_torque_has_the_variance_of_the_whitener(request, bodies):
    """Rows of the response to a random torque, whitened with the covariance of the fit, are white."""
    found = request.getfixturevalue(bodies)
    noise, level = found.noise[0], 1e-2
    loud = replace(found, noise=(noise.at(level),))
    data, moved = found.problem.data[0], motion(loud)
    whitener = noise.whitener.at(level)
    random = np.random.default_rng(0)
    size = len(whitener.vectors)
    large = np.argsort(whitener.values[:size])[-5:]
    total = []
    for _ in range(40):
        casing, *rotor = _replica._random_torque(moved, random)
        rows = data.sample_rows(casing[:, None], [r[:, None] for r in rotor])[:, 0]
        rotated = whitener.rotated(rows)[:size]
        total.append(np.sum(rotated[large] ** 2 / (level**2 * whitener.values[large])))
    assert 0.7 < np.mean(total) / 5 < 1.4
    assert kstest(total, chi2(5).cdf).pvalue > 1e-3


@pytest.mark.parametrize("body", [0, 1])
def test_random_torque_acts_on_the_casing_and_between_the_bodies(gyroscope, monkeypatch, body):
    """A constant torque of 1 uN m: the first accelerates the casing, the second the casing and brakes the rotor."""
    drawn = iter([float(body == 0), float(body == 1)])
    monkeypatch.setattr(_replica, "_ornstein_uhlenbeck", lambda t, *_: np.full(len(t), next(drawn)))
    noise = gyroscope.noise[0].at(1e-6)
    moved = motion(replace(gyroscope, noise=(replace(noise, unresolved=0.0),)))
    casing, first, *_ = _replica._random_torque(moved, np.random.default_rng(0))
    record = gyroscope.problem.data[0].record
    # the friction of a second changes the angle of the casing by some per cent
    early = record.casing.time < 1.0
    expected = 0.5 * 1e-6 / record.I_casing * record.casing.time[early] ** 2
    assert casing[early][-1] == pytest.approx(expected[-1], rel=0.1)
    end = record.rotor[0].time[-1]
    braked = -0.5 * 1e-6 / record.I_rotor * end**2
    assert first[-1] == pytest.approx(braked, rel=0.2) if body else abs(first[-1]) < 0.2 * abs(braked)


def test_starts_of_windows_move_their_angles_by_speed_times_uncertainty(gyroscope):
    data = gyroscope.problem.data[0]
    shifts = []
    for u in (2e-3, 0.0, np.nan):
        stated = replace(data, record=replace(data.record, start_sigma=(u,) * 3))
        found = replace(gyroscope, noise=(replace(gyroscope.noise[0].at(0.0), unresolved=0.0),))
        moved = FittedMotion(found, 0, stated)
        known = moved.values()[1]
        shifts.append(
            [
                np.mean(_replica._recording(moved, np.random.default_rng(s)).rotor[0].value - known)
                for s in range(15 if u > 0.0 else 2)
            ]
        )
    speed = np.ptp(known) / np.ptp(data.record.rotor[0].time)
    assert np.std(shifts[0]) == pytest.approx(2e-3 * abs(speed), rel=0.4)
    assert np.std(shifts[1]) < 1e-3 * abs(speed) * 2e-1
    assert np.std(shifts[2]) < 1e-3 * abs(speed) * 2e-1


def test_each_run_has_the_slow_errors_of_its_camera(gyroscope, monkeypatch):
    data, drawn = copy(gyroscope.problem.data[0]), []
    vars(data).update(angle_noise=AngleNoise(1e-3, time=1.0), rotor_angle_noise=AngleNoise(2e-3, time=2.0))

    def slow_error(run, noise, random):
        drawn.append((run, noise.sigma))
        return np.full(len(run), noise.sigma * 1e3)

    found = []
    for error in (lambda run, *_: np.zeros(len(run)), slow_error):
        monkeypatch.setattr(_replica, "_slow_error", error)
        found.append(_replica._recording(FittedMotion(gyroscope, 0, data), np.random.default_rng(0)))
    plain, shifted = found
    record = data.record
    assert [s for _, s in drawn] == [1e-3] + [2e-3] * len(record.rotor)
    assert all(a is b for (a, _), b in zip(drawn, (record.casing, *record.rotor), strict=True))
    np.testing.assert_allclose(shifted.casing.value - plain.casing.value, 1.0)
    for a, b in zip(shifted.rotor, plain.rotor, strict=True):
        np.testing.assert_allclose(a.value - b.value, 2.0)


def test_white_noise_of_each_camera_has_the_level_of_its_recording(gyroscope):
    """Successive differences contain twice its variance."""
    moved = motion(gyroscope)
    data = moved.data
    scales = (2.0, 3.0, 5.0)
    loud = replace(data, rotor=tuple(replace(w, scale=s) for w, s in zip(data.rotor, scales, strict=True)))
    (new,) = [_replica._recording(FittedMotion(gyroscope, 0, loud), np.random.default_rng(4))]
    for window, known, scale in zip(new.rotor, moved.values()[1:], scales, strict=True):
        measured = np.std(np.diff(window.value - known)) / np.sqrt(2) / window.sigma[0]
        assert measured == pytest.approx(scale, rel=0.2)


def test_random_torque_includes_what_the_residuals_do_not_exclude(gyroscope):
    noise = gyroscope.noise[0]
    known, unknown = (
        _replica._random_torque(motion(replace(gyroscope, noise=(n,))), np.random.default_rng(0))
        for n in (replace(noise.at(1e-6), unresolved=0.0), replace(noise.at(1e-8), unresolved=1e-6))
    )
    assert np.abs(known[0]).max() > 0.1
    for a, b in zip(known, unknown, strict=True):
        np.testing.assert_allclose(b, a)


@pytest.mark.parametrize("body", ["slow", "turn"])
def test_the_level_of_correlated_noise_is_uncertain(monkeypatch, body):
    """Levels of 3 +- 4 mrad have an rms of 5 mrad; here the noise has the value 1 throughout."""
    monkeypatch.setattr(_replica, "_ornstein_uhlenbeck", lambda t, *_: np.ones(len(t)))
    run = Samples(np.zeros(1), np.array([0.0]), np.ones(1))
    levels = {"slow": {"sigma": 3e-3, "sigma_u": 4e-3}, "turn": {"turn_sigma": 3e-3, "turn_sigma_u": 4e-3}}
    random = np.random.default_rng(1)
    drawn = [_replica._slow_error(run, AngleNoise(**levels[body]), random)[0] for _ in range(4000)]
    assert np.sqrt(np.mean(np.square(drawn))) == pytest.approx(5e-3, rel=0.05)


def test_no_random_torque_where_the_recording_has_none(speeds):
    silent = replace(speeds, noise=(speeds.noise[0].at(0.0),))
    (change,) = _replica._random_torque(motion(silent), np.random.default_rng(0))
    assert not change.any()


@pytest.mark.parametrize("body", ["slow", "turn"])
def test_correlated_angle_noise_has_its_level(body):
    run = Samples(np.linspace(0, 500, 20001), np.linspace(0, 4000, 20001), np.full(20001, 1e-3))
    levels = {"slow": {"sigma": 2e-3, "time": 0.5}, "turn": {"turn_sigma": 2e-3, "turn_time": 0.5}}[body]
    error = _replica._slow_error(run, AngleNoise(**levels), np.random.default_rng(1))
    assert np.std(error) == pytest.approx(2e-3, rel=0.1)
    assert not _replica._slow_error(run, AngleNoise(), np.random.default_rng(1)).any()


@pytest.mark.parametrize(
    ("stated", "expected"),
    [
        ((2e-3, 0.5, 0.0, 0.0), 2e-3),
        ((0.0, 0.0, 2e-3, 0.0), 2e-3 * np.sqrt(2)),  # two orders in each block
        ((0.0, 0.0, 0.0, 1e-3), 1e-3 * np.sqrt(10)),  # ten orders
        ((0.0, 0.0, 0.0, 0.0), 0.0),
    ],
)
def test_stated_errors_have_their_level(stated, expected):
    t = np.arange(0, 400, 0.02)
    record = make_record(
        casing=(t, 0.3 * t, np.full(len(t), 1e-3)),
        rotor=[],
        single=True,
        I_rotor=1,
        I_casing=1,
        correlated=stated,
    )
    data = CaseData.of(record)
    error = [_replica._stated_error(data, np.random.default_rng(s)) for s in range(4)]
    assert np.std(error) == pytest.approx(expected, rel=0.25)


@pytest.mark.parametrize(("rate", "few"), [(0.3, True), (60.0, False)])
def test_errors_that_repeat_with_the_turn_are_in_blocks_of_few_turns(rate, few):
    """In blocks of many turns they average out."""
    t = np.arange(0, 100, 0.02)
    run = (t, rate * t, np.full(len(t), 1e-3))
    data = CaseData.of(
        make_record(
            casing=run, rotor=[], single=True, I_rotor=1, I_casing=1, correlated=(0.0, 0.0, 2e-3, 0.0)
        )
    )
    assert _replica._stated_error(data, np.random.default_rng(0)).any() == few


def test_stated_inertias_move_the_values_by_their_uncertainty(speeds):
    """A wheel that is lighter by 1 % decelerates faster by 1 %; the record keeps the stated value."""
    record = speeds.problem.data[0].record
    uncertain = replace(record, I_casing_u=0.01 * record.I_casing)
    found = fit(BASE, [uncertain])
    uncertain = motion(found)
    fall = np.ptp(uncertain.expected(record.casing.time, rotor=False))
    changes = [
        np.abs(_replica._other_inertias(uncertain, np.random.default_rng(s))[0]).max() / fall
        for s in range(60)
    ]
    known = motion(speeds)
    assert not _replica._other_inertias(known, np.random.default_rng(0))[0].any()
    assert np.sqrt(np.mean(np.square(changes))) == pytest.approx(0.005, rel=0.4)
    assert replica(found, 0)[0].I_casing == record.I_casing


def test_curves_made_from_data_are_refused(speeds):
    data = speeds.problem.data[0]
    made = replace(data, record=replace(data.record, gradients=True))
    curve = replace(speeds, problem=replace(speeds.problem, data=(made,)))
    with pytest.raises(EstimationError, match="only measured values"):
        replica(curve, 0)


def test_residuals_contain_neither_laws_of_an_angle_nor_errors_of_the_camera(gyroscope):
    """Without them the residuals of a window would be 1 rad, by the clock of the rotor's camera."""
    count = len(gyroscope.problem.data[0].record.casing)
    own, rotor = np.split(gyroscope.residual, [count])
    assert np.sqrt(np.mean(own**2)) == pytest.approx(1.0, abs=0.05)
    assert np.sqrt(np.mean(rotor**2)) == pytest.approx(1.0, abs=0.05)


def test_modelled_speeds_contain_laws_of_an_angle(gyroscope):
    """The initial speed of the fit is that with the law: the smooth path alone misses its mean effect."""
    case, (prediction,) = gyroscope.problem.cases[0], gyroscope.predictions
    response = case.response_to_angles(prediction, gyroscope.theta)
    assert response.shape == (2, 2, len(case.data.record.casing))
    assert gyroscope.cases[0].casing.rmse < 1.05 * gyroscope.rmse_noise
    t = case.data.record.casing.time
    path = motion(gyroscope).expected(t, rotor=False)
    speed, _ = gyroscope.modelled_speed(0, 1, t)
    evaluated = gyroscope.eval(quantity="omega")
    np.testing.assert_allclose(np.gradient(path + response[1, 1], t)[1:-1], evaluated[1:-1], atol=2e-3)
    assert np.abs(np.gradient(path, t)[1:-1] - evaluated[1:-1]).max() > 0.02
    # its running median has no part that repeats with the turn while the casing is fast
    fast = evaluated > 0.8 * evaluated.max()
    shown, whole = (np.diff((v - evaluated + response[0, 1])[fast]) for v in (speed, evaluated))
    assert np.std(shown) < 0.1 * np.std(whole)


def test_the_windows_of_the_rotor_have_harmonics_of_their_stated_size(gyroscope):
    """Of 12 orders, each with a cosine and a sine of 0.05 rad: a variance of 12 * 0.05^2."""
    data = gyroscope.problem.data[0]
    rotor = tuple(
        replace(w, samples=replace(w.samples, harmonic=h))
        for w, h in zip(data.rotor, (0.05, 0.0, 0.0), strict=True)
    )
    plain, wavy = (
        _replica._recording(FittedMotion(gyroscope, 0, d), np.random.default_rng(0))
        for d in (data, replace(data, rotor=rotor))
    )
    added = [b.value - a.value for a, b in zip(plain.rotor, wavy.rotor, strict=True)]
    assert added[0].std() == pytest.approx(0.05 * np.sqrt(12.0), rel=0.4)
    assert not np.any([a.any() for a in added[1:]])


@pytest.mark.parametrize("smooth", [True, False])
def test_a_stated_error_is_in_the_angles_of_a_smooth_motion_only(gyroscope, monkeypatch, smooth):
    data = copy(gyroscope.problem.data[0])
    vars(data).update(motion=SimpleNamespace(is_smooth=smooth))
    found = []
    for error in (0.0, 1.0):
        monkeypatch.setattr(_replica, "_stated_error", lambda *_, error=error: error)
        found.append(_replica._recording(FittedMotion(gyroscope, 0, data), np.random.default_rng(0)))
    np.testing.assert_allclose(found[1].casing.value - found[0].casing.value, float(smooth))


def test_other_inertias_of_a_case_leave_the_speeds_of_other_cases():
    """Of two wheels with starts of 80 and 40 rad/s; an inertia of 1 % changes none of them by more than 1 rad/s."""
    t = np.arange(0, 20, 0.1)
    noise = np.random.default_rng(0).normal(0, 0.035, len(t))
    records = [
        make_record(
            casing=(t, start - 0.3 * t + noise, np.full(len(t), 0.035)), rotor=[], I_rotor=2e-3,
            I_casing=2e-3, I_casing_u=2e-5, quantity="omega", single=True, label=label,
        )
        for label, start in (("a", 80.0), ("b", 40.0))
    ]  # fmt: skip
    found = fit(Model.of(["touchpoint.constant"]), records)
    for case, data in enumerate(found.problem.data):
        (change,) = _replica._other_inertias(FittedMotion(found, case, data), np.random.default_rng(1))
        assert 1e-4 < np.abs(change).max() < 1.0
