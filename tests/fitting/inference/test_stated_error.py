"""A slowly varying error of the angle that tracking states."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
import twobody

from fitting import Model, RecordError, fit, make_record
from fitting.inference import _replica
from fitting.inference._angle_noise import AngleNoise, profile_at, stated_error_rows, stated_harmonic_scale
from fitting.inference._case_data import CaseData
from fitting.inference._case_file import read_record
from fitting.inference._compression import compress
from fitting.inference._record import Samples

SIGMA, TIME = 1.5e-4, 2.0
GYROSCOPE = {"a2": 1.97e-10, "b1": 3e-6, "b2": 3.7e-7, "d": 3.2e-8, "f": 4.86e-7, "g": 0.62}


def film(seed=0, stated=(SIGMA, TIME), added=0.0, profile=()):
    motion = twobody.simulate(GYROSCOPE, start=(566.0, 25.0), span=30.0, seed=seed)
    cameras = twobody.Cameras(span=30.0, windows=(2.0, 12.0, 25.0), casing_rate=30.0, rotor_rate=200.0)
    found = twobody.film(motion, seed=seed, cameras=cameras)
    t, y, s = found["casing"]
    rng = np.random.default_rng([seed, 7])
    slow = (
        twobody.ornstein_uhlenbeck(rng, len(t), float(np.median(np.diff(t))), added, TIME) if added else 0.0
    )
    found["casing"] = (t, y + slow, s)
    return make_record(**found, correlated=stated, correlated_profile=profile)


@pytest.fixture(scope="module")
def stated():
    return CaseData.of(film())


def test_its_rows_have_the_covariance_of_the_process(stated):
    """P R P' by hand: the operators of the blocks, and R = s^2 exp(-|t - t'| / T) of all samples."""
    t = stated.record.casing.time
    run = stated.casing
    operators = np.zeros((len(run.z), len(t)))
    k = run.lift.shape[1]
    for i, (where, operator) in enumerate(run.operators):
        operators[i * k : (i + 1) * k, where] = operator[:k]
    expected = operators @ (SIGMA**2 * np.exp(-np.abs(t[:, None] - t) / TIME)) @ operators.T
    rows = stated_error_rows(run, SIGMA, TIME)
    assert rows @ rows.T == pytest.approx(expected, abs=0.02 * expected.max())


def test_whitened_rows_have_less_weight_by_this_covariance(stated):
    white = CaseData.of(film(stated=(0.0, 0.0)))
    assert white.angle_noise.is_white
    assert not len(white.angle_noise.inverse)
    rows = stated_error_rows(stated.casing, SIGMA, TIME)
    whitening = stated.angle_noise.inverse
    assert whitening @ (np.eye(len(rows)) + rows @ rows.T) @ whitening.T == pytest.approx(
        np.eye(len(rows)), abs=1e-6
    )
    assert stated.angle_noise.root @ whitening == pytest.approx(np.eye(len(rows)), abs=1e-8)


@pytest.mark.parametrize("given", [(SIGMA, 0.0), (0.0, TIME), (-SIGMA, TIME), (0.0, 0.0, -SIGMA)])
def test_without_level_or_time_there_is_none(given):
    assert film(stated=given).correlated == (0.0, 0.0, 0.0, 0.0)


def test_errors_once_and_twice_per_turn_belong_to_blocks_of_few_turns():
    """A body that spins up: slow at first, then fast."""
    t = np.arange(0.0, 60.0, 0.01)
    angle = 0.5 * 2.0 * t**2
    samples = Samples(t, angle, np.full(len(t), 1e-3))
    run = compress(samples, degree=7, angle=angle, blocks=30)
    rows = stated_error_rows(run, 0.0, 0.0, SIGMA)
    turns = [np.ptp(angle[where]) / (2 * np.pi) for where, _ in run.operators]
    few = sum(x < 3.0 for x in turns)
    assert 2 <= few < len(turns) / 2
    assert rows.shape == (len(run.z), 4 * few)
    where, operator = run.operators[1]
    expected = SIGMA * operator[:8] @ np.sin(2 * angle[where])
    assert rows[8:16, 4:8] @ np.array([0.0, 0.0, 0.0, 1.0]) == pytest.approx(expected, rel=1e-9, abs=1e-12)
    assert not rows[:8, 4:].any()


def test_a_periodic_error_alone_is_a_stated_error():
    assert film(stated=(0.0, 0.0, SIGMA)).correlated == (0.0, 0.0, SIGMA, 0.0)
    assert film(stated=(0.0, 0.0, SIGMA)).digest != film(stated=(0.0, 0.0)).digest


def test_it_is_a_part_of_the_digest():
    one, other = film(), film(stated=(2 * SIGMA, TIME))
    assert one.digest != other.digest != film(stated=(0.0, 0.0)).digest


def wheel_with(path, **stated):
    """Read a case of one body whose series has these attributes."""
    with h5py.File(path, "w") as file:
        file.attrs.update({"format": "gyrotrack", "format_version": "1.0", "kind": "case", "bodies": "one"})
        file.attrs.update({"I_casing": 1.0, "per_inertia": 1})
        group = file.create_group("casing")
        group["time"] = np.arange(100) / 10
        group["angle"], group["sigma"] = 3.0 * np.arange(100), np.full(100, 1e-3)
        group.attrs.update(stated)
    return read_record(path)


@pytest.mark.parametrize(
    ("stated", "expected"),
    [
        ({}, (0.0, 0.0, 0.0, 0.0)),
        ({"correlated_sigma": SIGMA}, (0.0, 0.0, 0.0, 0.0)),
        ({"correlated_sigma": SIGMA, "correlated_time": np.nan}, (0.0, 0.0, 0.0, 0.0)),
        ({"correlated_sigma": SIGMA, "correlated_time": TIME}, (SIGMA, TIME, 0.0, 0.0)),
        ({"periodic_sigma": 3 * SIGMA, "harmonic_sigma": np.nan}, (0.0, 0.0, 3 * SIGMA, 0.0)),
    ],
)
def test_it_is_read_from_the_casing_of_a_case(tmp_path, stated, expected):
    assert wheel_with(tmp_path / "case.h5", **stated).correlated == expected


@pytest.mark.parametrize(("source", "tracked"), [({}, False), ({"sigma_source": "measured"}, True)])
def test_only_measured_uncertainties_are_those_of_tracking(tmp_path, source, tracked):
    assert wheel_with(tmp_path / "case.h5", **source).tracked is tracked


def test_a_body_without_a_known_inertia_has_torques_per_unit_of_inertia(tmp_path):
    wheel_with(tmp_path / "case.h5")
    with h5py.File(tmp_path / "case.h5", "r+") as file:
        file.attrs["I_casing"] = 3.0
    assert read_record(tmp_path / "case.h5").I_casing == 1.0
    with h5py.File(tmp_path / "case.h5", "r+") as file:
        file.attrs["per_inertia"] = 0
    assert read_record(tmp_path / "case.h5").I_casing == 3.0


PROFILE = ((0.0, 4 * SIGMA), (10.0, SIGMA), (60.0, 2 * SIGMA))


def test_a_profile_is_linear_between_its_times_and_constant_beyond():
    times = np.array([-1.0, 0.0, 5.0, 10.0, 35.0, 60.0, 90.0])
    factors = np.array([4.0, 4.0, 2.5, 1.0, 1.5, 2.0, 2.0])
    assert profile_at(times, 9.0, PROFILE) == pytest.approx(factors * SIGMA)
    assert profile_at(times, 9.0, ()) == pytest.approx(9.0)


@pytest.mark.slow
def test_the_rows_of_a_profile_have_the_covariance_of_the_scaled_process():
    t = np.arange(0.0, 60.0, 0.04)
    run = compress(Samples(t, 0.1 * t, np.full(len(t), 1e-3)), degree=7, blocks=20)
    scaled = stated_error_rows(run, SIGMA, TIME, profile=PROFILE)
    constant = stated_error_rows(run, SIGMA, TIME)
    size = profile_at(t, SIGMA, PROFILE)
    kernel = np.exp(-np.abs(t[:, None] - t) / TIME)
    operator = np.zeros((len(run.z), len(t)))
    k = run.lift.shape[1]
    for i, (where, rows) in enumerate(run.operators):
        operator[i * k : (i + 1) * k, where] = rows[:k]
    expected = (operator * size) @ kernel @ (operator * size).T
    assert scaled @ scaled.T == pytest.approx(expected, abs=2e-3 * np.abs(expected).max())
    assert np.trace(scaled @ scaled.T) > 1.5 * np.trace(constant @ constant.T)
    same = stated_error_rows(run, 9.0, TIME, profile=((0.0, SIGMA), (60.0, SIGMA)))
    assert same @ same.T == pytest.approx(constant @ constant.T, abs=1e-12)


def test_simulated_recordings_have_the_error_of_the_profile():
    data = CaseData.of(film(stated=(SIGMA, TIME), profile=PROFILE))
    time = data.record.casing.time
    drawn = np.array([_replica._stated_error(data, np.random.default_rng(s)) for s in range(200)])
    for at in (time[0], 10.0):
        i = int(np.argmin(np.abs(time - at)))
        assert drawn[:, i].std() == pytest.approx(profile_at(time[[i]], SIGMA, PROFILE)[0], rel=0.15)


def test_a_profile_is_part_of_the_digest_and_of_the_fit():
    constant, other = film(), film(profile=PROFILE)
    assert constant.digest != other.digest
    rows = [CaseData.of(r)._stated_error for r in (constant, other)]
    assert np.linalg.norm(rows[1]) > 1.2 * np.linalg.norm(rows[0])


@pytest.mark.parametrize(
    ("profile", "message"),
    [
        (((0.0, -1e-4),), "negative uncertainty"),
        (((0.0, np.nan),), "not finite"),
        (((1.0, 1e-4), (1.0, 1e-4)), "do not increase"),
        (((0.0, np.inf),), "not finite"),
    ],
)
def test_a_wrong_profile_is_refused(profile, message):
    with pytest.raises(RecordError, match=message):
        film(profile=profile)


def test_a_profile_needs_a_correlation_time():
    with pytest.raises(RecordError, match="no correlation time"):
        film(stated=(SIGMA, 0.0), profile=PROFILE)


def test_a_profile_is_read_from_the_casing_of_a_case(tmp_path):
    slow = {"correlated_sigma": SIGMA, "correlated_time": TIME}
    for given in (np.array(PROFILE), np.array([[0, 1], [2, 3]])):
        found = wheel_with(tmp_path / "case.h5", **slow, correlated_profile=given)
        assert found.correlated_profile == tuple(map(tuple, given.tolist()))
    with pytest.raises(RecordError, match="not a table of pairs"):
        wheel_with(tmp_path / "case.h5", **slow, correlated_profile=np.zeros((2, 3)))


def test_functions_of_the_samples_have_the_rows_of_the_same_functions_at_the_nodes(stated):
    """Rows of smooth functions, whitened by the noise of the casing and by that of the windows."""
    windows = [len(w.z) for w in stated.rotor]
    rng = np.random.default_rng(0)
    root = np.eye(sum(windows)) + 0.3 * np.diag(rng.uniform(0.0, 1.0, sum(windows)))
    noisy = replace(stated)
    noisy.__dict__["angle_noise"] = stated.angle_noise
    noisy.__dict__["rotor_angle_noise"] = AngleNoise(sigma=1e-4, root=root, inverse=np.linalg.inv(root))

    def bend(t):
        return np.asarray(3.0 + 0.2 * t - 0.01 * t**2)[:, None]

    samples = noisy.sample_rows(bend(noisy.casing.samples.time), [bend(w.samples.time) for w in noisy.rotor])
    nodes = noisy.rows(bend(noisy.casing.node_times)[:, 0], [bend(w.node_times)[:, 0] for w in noisy.rotor])
    smooth = noisy.slices["smooth"]
    assert samples[smooth, 0] == pytest.approx(nodes[smooth], rel=1e-6, abs=1e-6 * np.abs(nodes).max())


@pytest.mark.slow
def test_with_a_stated_error_the_uncertainties_are_right():
    name, pulls = "casing.air.linear.b2", []
    for seed in range(6):
        found = fit(Model.of("reduced"), [film(seed, (SIGMA, TIME), SIGMA)]).estimates[name]
        pulls.append((found.value - GYROSCOPE["b2"]) / found.stderr)
    assert 0.3 < np.sqrt(np.mean(np.square(pulls))) < 1.7


def test_harmonic_rows_have_the_variance_of_amplitudes_that_change_from_block_to_block():
    level = 1.5e-3
    data = CaseData.of(film(stated=(0.0, 0.0, 0.0, level)))
    run, k, rng = data.casing, data.casing.lift.shape[1], np.random.default_rng(1)
    psi, rows = run.samples.value, []
    for _ in range(300):
        found = []
        for where, operator in run.operators:
            a = level * rng.standard_normal(4)
            waves = [f(order * psi[where]) for order in (1, 2) for f in (np.cos, np.sin)]
            found.append(operator[k:] @ sum(x * w for x, w in zip(a, waves, strict=True)))
        rows.append(np.concatenate(found))
    expected = np.sqrt(1 + np.mean(np.square(rows), axis=0))
    scale = stated_harmonic_scale(run, level)
    assert scale == pytest.approx(expected, rel=0.2)
    assert scale.max() > 5
    assert stated_harmonic_scale(run, 0.0) == pytest.approx(1.0)


def test_harmonic_rows_are_whitened_by_it_and_the_others_are_not():
    level = 1.5e-3
    with_error, without = (
        replace(CaseData.of(film(stated=(0.0, 0.0, 0.0, x))), noiseless=True) for x in (level, 0.0)
    )
    where = with_error.slices["harmonic"]
    scale = stated_harmonic_scale(with_error.casing, level)
    one = np.random.default_rng(0).standard_normal((len(without.z), 2))
    assert with_error.whitened(one)[where] == pytest.approx(one[where] / scale[:, None])
    assert with_error.whitened(one)[where.stop :] == pytest.approx(one[where.stop :])
    assert with_error.unwhitened(with_error.whitened(one)) == pytest.approx(one)
    assert np.array_equal(without.whitened(one)[where], one[where])
    responses = with_error.harmonic_row_responses[0], without.harmonic_row_responses[0]
    assert responses[0] == pytest.approx(responses[1] / scale**2)


class TestAliases:
    """At 100 frames per second an error of an order is constant where the body turns 100 / order times a second."""

    def run(self, order):
        t = np.arange(1600) / 100
        angle = 2 * np.pi * (100.0 + 0.02) / order * t + 0.3
        return angle, compress(Samples(t, angle, np.full(len(t), 1e-3)), degree=5, blocks=4)

    @pytest.mark.parametrize(("order", "columns"), [(7, 2), (8, 2), (12, 2), (13, 0)])
    @pytest.mark.parametrize(("norm", "kept"), [(0.08, False), (0.12, True), (0.9, True)])
    def test_slow_errors_of_orders_3_to_12_are_stated(self, order, columns, norm, kept):
        angle, run = self.run(order)
        unit = max(
            np.linalg.norm(rows[:6] @ f(order * angle[where]))
            for where, rows in run.operators
            for f in (np.cos, np.sin)
        )
        size = norm / unit
        found = stated_error_rows(run, 0.0, 0.0, harmonic=size)
        if not kept or not columns:
            assert found.shape[1] == 0
            return
        expected = np.zeros_like(found @ found.T)
        for i, (where, rows) in enumerate(run.operators):
            waves = np.stack([np.cos(order * angle[where]), np.sin(order * angle[where])], axis=1)
            part = size * rows[:6] @ waves
            part = part[:, np.linalg.norm(part, axis=0) > 0.1]
            expected[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = part @ part.T
        assert found @ found.T == pytest.approx(expected, abs=1e-3 * norm**2)


class TestWindowsOfTheRotor:
    """Two windows of 16 s at 100 frames per second, with seven frames per turn in the second one."""

    LEVEL = 0.5e-3

    def record(self, harmonics, quantity="angle"):
        t = np.arange(1600) / 100
        u = np.full(len(t), 1e-3)
        whole = np.arange(4000) / 100
        turns = (7.618 * t, (100.0 + 0.02) / 7 * (t + 20.0))
        noise = u * np.random.default_rng(3).standard_normal((2, len(t)))
        windows = [
            (t + start, 2 * np.pi * x + e, u) for start, x, e in zip((0, 20), turns, noise, strict=True)
        ]
        casing = (whole, 5.0 * whole, np.full(len(whole), 1e-3))
        return make_record(
            casing=casing, rotor=windows, I_rotor=5e-5, I_casing=1e-5, harmonics=harmonics, quantity=quantity
        )

    def data(self, *harmonics):
        return replace(CaseData.of(self.record(harmonics)), noiseless=True)

    @pytest.mark.parametrize(
        ("given", "kept"),
        [((), (0.0, 0.0)), ((1e-3, 2e-3), (1e-3, 2e-3)), ((-1e-3, np.nan), (0.0, 0.0))],
    )
    def test_each_window_has_its_own_error(self, given, kept):
        record = self.record(given)
        assert tuple(w.harmonic for w in record.rotor) == kept
        assert (record.digest == self.record(()).digest) == (not any(kept))

    def test_only_the_window_in_step_has_less_weight(self):
        data = self.data(self.LEVEL, self.LEVEL)
        covariance = data.rotor_angle_noise.root @ data.rotor_angle_noise.root
        rows = len(data.rotor[0].z)
        for window, part, beyond in zip(
            data.rotor, (slice(rows), slice(rows, None)), (0.4, 10.0), strict=True
        ):
            stated = stated_error_rows(window, 0.0, 0.0, self.LEVEL, self.LEVEL)
            own = stated @ stated.T
            assert covariance[part, part] == pytest.approx(np.eye(len(own)) + own, rel=1e-6, abs=1e-6)
            assert own.max() < beyond if beyond < 1 else own.max() > beyond
        assert not covariance[:rows, rows:].any()

    def test_few_turns_of_the_rotor_have_it_once_and_twice_per_turn(self):
        t = np.arange(1600) / 100
        slow = 2 * np.pi * 0.4 * t + 1e-3 * np.random.default_rng(3).standard_normal(len(t))
        u = np.full(len(t), 1e-3)
        record = make_record(
            casing=(t, 5.0 * t, u), rotor=[(t, slow, u)], I_rotor=5e-5, I_casing=1e-5, harmonics=[self.LEVEL]
        )
        data = replace(CaseData.of(record), noiseless=True)
        (run,) = data.rotor
        low, high = (stated_error_rows(run, 0.0, 0.0, *x) for x in ((self.LEVEL,), (0.0, self.LEVEL)))
        assert low.size
        covariance = data.rotor_angle_noise.root @ data.rotor_angle_noise.root
        expected = np.eye(len(low)) + low @ low.T + high @ high.T
        assert covariance == pytest.approx(expected, rel=1e-6, abs=1e-6 * expected.max())

    def test_without_an_error_of_an_angle_the_noise_is_white(self):
        assert not len(self.data().rotor_angle_noise.root)
        speeds = CaseData.of(self.record((self.LEVEL, self.LEVEL), "omega"))
        assert not len(speeds.rotor_angle_noise.root)

    def test_simulated_recordings_have_it(self):
        data = self.data(0.0, self.LEVEL)
        run = data.rotor[1]
        drawn = np.array([_replica._harmonics(run, self.LEVEL, np.random.default_rng(s)) for s in range(100)])
        # ten orders above the second one and two below it, each of variance 0.5 + 0.5
        assert drawn.std() == pytest.approx(self.LEVEL * np.sqrt(12.0), rel=0.1)
        assert not _replica._harmonics(run, 0.0, np.random.default_rng(0)).any()

    def test_it_is_read_from_the_rotor_of_a_case(self, tmp_path):
        with h5py.File(tmp_path / "case.h5", "w") as file:
            file.attrs.update({"format": "gyrotrack", "format_version": "1.0", "kind": "case"})
            file.attrs.update({"I_casing": 1e-5, "I_rotor": 5e-5})
            for name, count, stated in (("casing", 400, 1e-3), ("rotor", 200, 3e-3)):
                group = file.create_group(name)
                group["time"] = np.arange(count) / 10
                group["angle"], group["sigma"] = 3.0 * np.arange(count), np.full(count, 1e-3)
                group.attrs["harmonic_sigma"] = stated
            file["rotor/window"] = np.repeat([0, 1], 100)
        record = read_record(tmp_path / "case.h5")
        assert [w.harmonic for w in record.rotor] == [3e-3, 3e-3]
        assert record.correlated[3] == 1e-3
