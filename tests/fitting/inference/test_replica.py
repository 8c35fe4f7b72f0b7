"""New recordings of a fit, against the errors that they must contain, and their parts with known random numbers."""

from copy import copy
from dataclasses import replace
from types import SimpleNamespace

import linearised
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import chi2, kstest

from fitting import REDUCED, EstimationError, Experiment, Model, make_record, simulate
from fitting.dynamics._collocation import Sampler
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


T = np.linspace(0.0, 4.0, 41)


class Drawn:
    """Random numbers: those of a list, then ones."""

    def __init__(self, *values):
        self.values = list(values)

    def standard_normal(self, size=None):
        count = 1 if size is None else int(np.prod(size))
        found = np.array([self.values.pop(0) if self.values else 1.0 for _ in range(count)])
        return float(found[0]) if size is None else found.reshape(size)

    def normal(self, mean, u):
        return mean + u * self.standard_normal()


def samples(t=T, value=None, sigma=0.5, **more):
    return Samples(t, np.zeros(len(t)) if value is None else value, np.full(len(t), sigma), **more)


@pytest.fixture
def process(monkeypatch):
    """A process of random numbers that is 1 plus its correlation time at all times."""
    monkeypatch.setattr(
        _replica, "_ornstein_uhlenbeck", lambda times, time, random: np.full(len(times), 1.0 + time)
    )


class TestSlowError:
    def test_each_part_has_its_level_time_and_shape(self, process):
        run = samples(value=3.0 * T)
        found = _replica._slow_error(run, AngleNoise(2.0, 0.5, 3.0), Drawn(1.0))
        assert found == pytest.approx(np.full(41, 2.5 * 4.0))
        found = _replica._slow_error(
            run, AngleNoise(turn_sigma=3.0, turn_sigma_u=0.2, turn_time=1.0), Drawn(-2.0)
        )
        assert found == pytest.approx(2.6 * 2.0 * (np.cos(3 * T) + np.sin(3 * T)))
        both = AngleNoise(2.0, 0.5, 3.0, turn_sigma=3.0, turn_sigma_u=0.2, turn_time=1.0)
        assert _replica._slow_error(run, both, Drawn(1.0, -2.0)) == pytest.approx(10.0 + found)

    def test_a_level_below_zero_is_that_above_it(self, process):
        found = _replica._slow_error(samples(), AngleNoise(2.0, 1.0, 3.0), Drawn(-5.0))
        assert found == pytest.approx(np.full(41, 12.0))
        turning = AngleNoise(turn_sigma=2.0, turn_sigma_u=1.0, turn_time=3.0)
        assert _replica._slow_error(samples(), turning, Drawn(-5.0)) == pytest.approx(np.full(41, 12.0))

    def test_white_noise_has_none(self):
        assert not _replica._slow_error(samples(), AngleNoise(), Drawn()).any()


class TestStatedError:
    def data(self, correlated, profile=(), value=None):
        run = samples(value=value)
        record = SimpleNamespace(casing=run, correlated=correlated, correlated_profile=profile)
        return SimpleNamespace(
            record=record, casing=SimpleNamespace(samples=run, operators=[(slice(0, 41), None)])
        )

    def test_its_size_is_constant_or_follows_its_profile(self, process):
        known = self.data((0.5, 2.0, 0.0, 0.0))
        assert _replica._stated_error(known, Drawn()) == pytest.approx(np.full(41, 1.5))
        grows = self.data((0.5, 2.0, 0.0, 0.0), ((0.0, 1.0), (4.0, 3.0)))
        assert _replica._stated_error(grows, Drawn()) == pytest.approx(3.0 * (1.0 + 0.5 * T))

    def test_a_periodic_part_alone_has_the_first_two_orders(self, process):
        known = self.data((0.0, 2.0, 0.3, 0.0), value=2.0 * T)
        found = _replica._stated_error(known, Drawn(1.0, 0.0, 0.0, 1.0))
        psi = 2.0 * T
        # orders from 3 on have the harmonic amplitude, zero, whatever is drawn
        orders = list(dict.fromkeys([*_replica.HARMONICS, 1, 2]))
        drawn = [1.0, 0.0, 0.0, 1.0] + [1.0] * 40
        expected = sum(
            0.3 * (order <= 2) * (drawn[2 * i] * np.cos(order * psi) + drawn[2 * i + 1] * np.sin(order * psi))
            for i, order in enumerate(orders)
        )
        assert found == pytest.approx(expected)


class TestHarmonics:
    """Of a block of 9 rad and one of 30 rad; three turns are 18.8 rad."""

    VALUE = np.concatenate([np.linspace(0.0, 9.0, 20), np.linspace(9.0, 39.0, 21)])

    def run(self):
        blocks = [(slice(0, 20), None), (slice(20, 41), None)]
        return SimpleNamespace(samples=samples(value=self.VALUE), operators=blocks)

    @pytest.mark.parametrize(("block", "periodic"), [(slice(0, 20), 0.4), (slice(20, 41), 0.0)])
    def test_slow_blocks_have_a_larger_first_and_second_order(self, block, periodic):
        found = _replica._harmonics(self.run(), 0.3, Drawn(), 0.4)
        psi = self.VALUE[block]
        size = dict.fromkeys(range(3, 13), 0.3) | dict.fromkeys((1, 2), np.hypot(0.3, periodic))
        expected = sum(a * (np.cos(n * psi) + np.sin(n * psi)) for n, a in size.items())
        assert found[block] == pytest.approx(expected)

    def test_without_any_amplitude_nothing_is_drawn(self):
        random = Drawn(5.0)
        assert not _replica._harmonics(self.run(), 0.0, random).any()
        assert random.values == [5.0]
        assert _replica._harmonics(self.run(), 0.1, random).any()

    def test_blocks_are_independent(self):
        random = Drawn(*[0.0] * 24, *[2.0] * 24)
        found = _replica._harmonics(self.run(), 0.1, random)
        assert not found[:20].any()
        assert np.abs(found[20:]).max() > 0.5


class Motion:
    """Expected values of 10 t for the casing and 100 t for a rotor's window."""

    def __init__(self, data):
        self.data = data

    def values(self):
        record = self.data.record
        return [10.0 * record.casing.time, *(100.0 * w.time for w in record.rotor)]

    def expected_of(self, state, times, path=None):
        return (100.0, 10.0)[state] * times


class TestRecording:
    @pytest.fixture
    def parts(self, monkeypatch):
        """Changes by other inertias, the random torque, and slow, stated and harmonic errors."""
        monkeypatch.setattr(_replica, "_other_inertias", lambda motion, random: [1.0, 2.0])
        monkeypatch.setattr(_replica, "_random_torque", lambda motion, random: [10.0, 20.0])
        monkeypatch.setattr(_replica, "_slow_error", lambda run, noise, random: noise)
        monkeypatch.setattr(_replica, "_stated_error", lambda data, random: 1000.0)
        monkeypatch.setattr(_replica, "_harmonics", lambda run, harmonic, random: harmonic)

    def recording(self, *, angle=True, smooth=True, start=(0.25,), modes=0.0):
        casing, window = samples(sigma=0.5), samples(T[:11], sigma=0.2, harmonic=7e4)
        record = linearised.data().record
        record = replace(record, casing=casing, rotor=(window,), start_sigma=start, digest="abc")
        data = SimpleNamespace(
            record=record, is_angle=angle, motion=SimpleNamespace(is_smooth=smooth),
            casing=SimpleNamespace(scale=2.0, samples=casing), rotor=[SimpleNamespace(scale=3.0, samples=window)],
            angle_noise=100.0, rotor_angle_noise=200.0,
            mode_columns=(np.full((41, 2), modes), [np.full((11, 2), 2 * modes)]),
        )  # fmt: skip
        made = _replica._recording(Motion(data), Drawn())
        assert made.digest != "abc"
        assert made.label == record.label
        assert (made.casing.time == T).all()
        assert (made.casing.sigma == 0.5).all()
        return made.casing.value - 10.0 * T, made.rotor[0].value - 100.0 * T[:11]

    def test_of_angles_of_a_smooth_motion(self, parts):
        casing, window = self.recording()
        # white noise, inertia and torque, slow error, stated error
        assert casing == pytest.approx(np.full(41, 2.0 * 0.5 + 11.0 + 100.0 + 1000.0))
        # and 0.25 s at 100 rad/s
        assert window == pytest.approx(np.full(11, 3.0 * 0.2 + 22.0 + 200.0 + 25.0 + 7e4))

    def test_of_an_oscillation(self, parts):
        casing, window = self.recording(smooth=False)
        assert casing == pytest.approx(np.full(41, 112.0))
        assert window == pytest.approx(np.full(11, 247.6))

    def test_of_speeds(self, parts):
        casing, window = self.recording(angle=False)
        assert casing == pytest.approx(np.full(41, 12.0))
        assert window == pytest.approx(np.full(11, 47.6))

    @pytest.mark.parametrize("start", [(), (0.0,), (np.nan,)])
    def test_of_known_or_unstated_starts(self, parts, start):
        casing, window = self.recording(start=start)
        assert casing == pytest.approx(np.full(41, 1112.0))
        assert window == pytest.approx(np.full(11, 222.6 + 7e4))

    def test_error_modes_of_all_runs_have_the_same_amplitudes(self, parts):
        casing, window = self.recording(modes=0.125)
        assert casing == pytest.approx(np.full(41, 1112.25))
        assert window == pytest.approx(np.full(11, 247.6 + 7e4 + 0.5))


@pytest.mark.parametrize(
    ("generated", "gradients", "refused"),
    [(False, False, False), (True, False, True), (False, True, True), (True, True, True)],
)
def test_curves_made_from_data_are_not_measured(monkeypatch, generated, gradients, refused):
    monkeypatch.setattr(_replica, "_recording", lambda motion, random: motion.case)
    record = SimpleNamespace(generated=generated, gradients=gradients, label="run")
    usual = SimpleNamespace(generated=False, gradients=False, label="other")
    data = [SimpleNamespace(record=r) for r in (usual, record)]
    fit = SimpleNamespace(problem=SimpleNamespace(data=data))
    if refused:
        with pytest.raises(EstimationError, match="run: only measured"):
            _replica.replica(fit, 1)
    else:
        assert _replica.replica(fit, 1) == [0, 1]


def test_the_motion_of_a_repetition_has_no_errors_of_a_measurement(monkeypatch):
    """It is that of the fit, beginning at the measured zero, with all changes that a random error causes."""
    base = linearised.gyroscope()
    data = base.problem.data[0]
    path = base.predictions[0].path
    casing = data.record.casing
    own = Sampler(path.mesh, casing.time).integral(*path.angle("omega_c"))
    shifted = replace(data, record=replace(data.record, casing=replace(casing, value=own + 0.7), digest=""))
    times = np.linspace(4.0, 14.0, 30)
    seen = []

    def change(size):
        def of(motion, random):
            runs = (motion.data.record.casing, *motion.data.record.rotor)
            seen.append([r.time.tolist() == times.tolist() for r in runs])
            return [np.full(30, size), np.full(30, 2 * size)]

        return of

    monkeypatch.setattr(_replica, "_other_inertias", change(0.01))
    monkeypatch.setattr(_replica, "_random_torque", change(0.1))
    effect = object()
    monkeypatch.setattr(
        _replica.FittedMotion, "angle_response",
        lambda self, law, zero: [np.full(30, zero + (law is effect)), np.full(30, 100.0)],
    )  # fmt: skip
    fit = SimpleNamespace(
        problem=SimpleNamespace(data=[shifted]), predictions=base.predictions, theta=base.theta,
        model=SimpleNamespace(angle_dependent=(effect,)), noise=None,
    )  # fmt: skip
    found = _replica.motion_of(fit, 0, times, 3)
    expected = [Sampler(path.mesh, times).integral(*path.angle(s)) for s in ("omega_c", "omega_r")]
    assert found[0] == pytest.approx(expected[0] + 0.7 + 0.11 + 1.7, abs=1e-6)
    assert found[1] == pytest.approx(expected[1] + 0.22 + 100.0, abs=1e-6)
    assert seen == [[True, True]] * 2


class TestRandomTorque:
    @pytest.mark.parametrize(
        ("time", "cells"), [(10.0, 400), (0.15, 400), (0.1, 600), (0.002, 30000), (0.001, 40000)]
    )
    def test_a_correlation_time_has_five_cells(self, monkeypatch, time, cells):
        """Of a record of 12 s, between 400 and 40000."""
        lengths = []

        def process(times, correlation, random):
            lengths.append((len(times), correlation, times[0]))
            raise EstimationError("enough")

        monkeypatch.setattr(_replica, "_ornstein_uhlenbeck", process)
        known = SimpleNamespace(level=1e-6, time=time)
        record = linearised.data().record
        motion = SimpleNamespace(
            fit=SimpleNamespace(noise=[SimpleNamespace(with_unresolved=known)]), case=0,
            data=SimpleNamespace(record=record),
        )  # fmt: skip
        with pytest.raises(EstimationError):
            _replica._random_torque(motion, None)
        assert lengths == [(cells, time, 3.0)]

    @pytest.mark.parametrize("level", [0.0, np.nan])
    def test_without_a_level_there_is_none(self, level):
        record = linearised.data().record
        noise = [SimpleNamespace(with_unresolved=SimpleNamespace(level=level, time=1.0))]
        motion = SimpleNamespace(
            fit=SimpleNamespace(noise=noise), case=0, data=SimpleNamespace(record=record)
        )
        found = _replica._random_torque(motion, None)
        assert [len(f) for f in found] == [600, 100, 100]
        assert not any(f.any() for f in found)


def test_an_inertia_that_is_heavier_slows_down_less():
    """Drawn at one standard uncertainty above the stated value; the torques are those of the fit."""
    base = linearised.gyroscope(["casing.air.linear", "rotor.air.linear"], {"rotor.air.linear.a1": 2e-6})
    data = base.problem.data[0]
    record = replace(data.record, I_casing_u=2e-7, I_rotor_u=0.0, digest="")
    motion = _replica.FittedMotion(base, 0, replace(data, record=record))
    casing, *windows = _replica._other_inertias(motion, Drawn())
    t = record.casing.time - 3.0
    omega, rate = 20.0, 1e-6 / 2e-5

    def angle(rate):
        return omega * (1 - np.exp(-rate * t)) / rate

    assert casing == pytest.approx(angle(rate / 1.01) - angle(rate), abs=1e-5)
    assert all(np.abs(w).max() < 1e-6 for w in windows)
    lighter = _replica._other_inertias(motion, Drawn(-1.0))[0]
    assert lighter == pytest.approx(angle(rate / 0.99) - angle(rate), abs=1e-5)
    known = _replica.FittedMotion(base, 0, replace(data, record=replace(record, I_casing_u=0.0)))
    assert not any(c.any() for c in _replica._other_inertias(known, Drawn()))
