"""Correlated angle noise: level and correlation time, none in white noise, and the steps of the estimate."""

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import twobody
from scipy.signal import lfilter

from fitting import Experiment, Model, fit, make_record, simulate
from fitting._criteria import DEFAULT
from fitting.inference import _angle_noise
from fitting.inference._angle_noise import (
    AngleNoise,
    estimate_angle_noise,
    estimate_window_noise,
    stated_error_rows,
)
from fitting.inference._case_data import CaseData
from fitting.inference._compression import compress
from fitting.inference._record import Samples

ROOT = Path(__file__).parents[3]
FILM = ROOT.parent / "shared" / "real" / "bicycle_wheel_300fps.mp4"
MODEL = Model.of("reduced")
TRUTH = {
    "rotor.air.quadratic.a2": 1.2e-10,
    "touchpoint.constant.b1": 2.88e-6,
    "casing.air.linear.b2": 5e-7,
    "bearing.linear.d": 6e-8,
    "bearing.power.f": 2e-6,
    "bearing.power.g": 0.5,
}


def wandering(time, sigma, correlation, seed):
    keep = np.exp(-(time[1] - time[0]) / correlation)
    random = np.random.default_rng(seed)
    kicks = sigma * np.sqrt(1 - keep**2) * random.standard_normal(len(time))
    kicks[0] = sigma * random.standard_normal()
    return lfilter([1.0], [1.0, -keep], kicks)


@cache
def case(sigma=0.0, correlation=0.1, seed=0, torque_noise=0.0):
    experiment = Experiment(duration=100.0, windows=(10.0, 50.0, 90.0), torque_noise=torque_noise)
    record = simulate(
        MODEL, TRUTH, experiment, inertia_rotor=twobody.I_ROTOR, inertia_casing=twobody.I_CASING, seed=seed
    )
    s = record.casing
    added = wandering(s.time, sigma, correlation, seed + 100) if sigma else 0.0
    return CaseData.of(replace(record, casing=Samples(s.time, s.value + added, s.sigma), digest=""))


@pytest.mark.slow
@pytest.mark.parametrize(("sigma", "correlation"), [(3e-3, 0.1), (1e-3, 0.3)])
@pytest.mark.release
def test_level_and_correlation_time_are_estimated(sigma, correlation):
    found = case(sigma, correlation).angle_noise
    # what a level over the root of the time has, is what slow rows see
    expected = sigma**2 * correlation
    assert found.sigma**2 * found.time == pytest.approx(expected, rel=0.8)
    assert found.time == pytest.approx(correlation, rel=0.7)
    assert 0.02 * found.sigma < found.sigma_u < 0.3 * found.sigma


@pytest.mark.slow
@pytest.mark.parametrize("torque_noise", [0.0, 1e-7, 1e-6])
@pytest.mark.release
def test_white_and_process_noise_are_not_correlated_angle_noise(torque_noise):
    assert all(case(seed=seed, torque_noise=torque_noise).angle_noise.sigma == 0 for seed in range(1, 3))


@pytest.mark.slow
def test_noise_of_the_rotors_camera_is_found_in_its_windows():
    """Three windows of one camera: 2 mrad over 0.3 s, told within what 24 rows allow; of white noise little."""
    plain = case()
    assert plain.rotor_angle_noise.sigma < 1e-4  # a tenth of the white noise
    assert not plain.rotor_angle_noise.is_significant
    noisy = [
        Samples(w.time, w.value + wandering(w.time, 2e-3, 0.3, i), w.sigma)
        for i, w in enumerate(plain.record.rotor)
    ]
    data = CaseData.of(replace(plain.record, rotor=tuple(noisy), digest=""))
    found = data.rotor_angle_noise
    assert data.angle_noise.sigma == 0
    assert abs(found.sigma - 2e-3) < 4 * found.sigma_u
    assert 0.05 * found.sigma < found.sigma_u < 0.6 * found.sigma
    assert 0.05 < found.time < 2.0
    assert data.n_effective < plain.n_effective - 0.5 * sum(w.n_effective for w in plain.rotor)
    rows = np.random.default_rng(0).standard_normal((len(data.z), 2))
    np.testing.assert_allclose(data.unwhitened(data.whitened(rows)), rows, atol=1e-9)


@pytest.mark.slow
def test_a_torque_that_changes_within_the_windows_is_not_an_angle_noise():
    """0.2 rad/s2 that decay with 1.5 s, as in the rise: its quartic part is fifty times the noise of its row."""
    experiment = Experiment(duration=40.0, casing_fps=30.0, rotor_fps=400.0, windows=(5.0, 20.0, 35.0))
    plain = simulate(
        MODEL, TRUTH, experiment, inertia_rotor=twobody.I_ROTOR, inertia_casing=twobody.I_CASING, seed=0
    )
    moved = tuple(
        Samples(w.time, w.value + 0.5 * np.exp(-(w.time - w.time[0]) / 1.5), w.sigma) for w in plain.rotor
    )
    found = CaseData.of(replace(plain, rotor=moved, digest="")).rotor_angle_noise
    assert found.sigma < 1e-4


def test_row_covariance_agrees_with_that_of_many_simulated_recordings():
    run, time = case().casing, 0.5
    k = run.lift.shape[1]
    first = run.samples.time[: run.operators[3][0].stop]
    draws = np.stack([wandering(first, 1.0, time, seed) for seed in range(400)], axis=1)
    rows = np.concatenate([op[:k] @ draws[where] for where, op in run.operators[:4]])
    expected = _angle_noise._row_covariance_beyond_white(run, time)[: 4 * k, : 4 * k]
    # the part that counts as white noise already is taken off the diagonal
    slow = np.arange(4 * k) % k < 2
    seen = np.cov(rows)
    assert np.diag(seen)[slow] == pytest.approx(np.diag(expected)[slow], rel=0.3)
    i, j = 0, k
    assert seen[i, j] / np.sqrt(seen[i, i] * seen[j, j]) == pytest.approx(
        expected[i, j] / np.sqrt(expected[i, i] * expected[j, j]), abs=0.15
    )


@pytest.mark.slow
def test_whitening_is_invertible():
    data = case(3e-3, 0.1)
    rows = np.random.default_rng(0).standard_normal((len(data.z), 2))
    assert data.unwhitened(data.whitened(rows)) == pytest.approx(rows, abs=1e-9)
    assert data.whitened(rows[:, 0]) == pytest.approx(data.whitened(rows)[:, 0], abs=1e-12)


@pytest.mark.slow
def test_a_fit_with_correlated_noise_is_adequate_and_its_uncertainties_hold():
    found = fit(MODEL, [case(3e-3, 0.1)])
    assert found.verdict == "no_lack_of_fit"
    quiet = fit(MODEL, [case()])
    for key in TRUTH:
        e = found.estimates[key]
        assert abs(e.value - TRUTH[key]) < 3.5 * e.stderr
        assert e.stderr > quiet.estimates[key].stderr


@pytest.mark.slow
def test_deceleration_of_a_real_wheel_is_fitted():
    """A hand-held film of 1.4 s: the hub moves slowly, which is not a random torque of ten times the friction.

    Least squares with a block bootstrap gives -0.402 +- 0.018 rad/s2, points marked by hand -0.396.
    """
    if not FILM.exists():
        pytest.skip("the film of the wheel is not here")
    from gyrotrack.tracking._extract import extract
    from gyrotrack.tracking._profile import load

    track = extract(FILM, load(ROOT / "docs" / "bicycle.toml")).bodies["rotor"]
    record = make_record(
        casing=(track.time, track.angle, track.sigma), rotor=[], I_rotor=1.0, I_casing=1.0, single=True
    )
    found = fit(Model.of(["touchpoint.constant"]), [record])
    friction = found.estimates["touchpoint.constant.b1"]
    assert 0.012 < friction.stderr < 0.03
    assert friction.value == pytest.approx(0.402, abs=2 * np.hypot(0.018, friction.stderr))
    assert found.verdict == "no_lack_of_fit"
    noise = found.problem.data[0].angle_noise
    assert noise.turn_sigma > 3 * noise.turn_sigma_u
    # one error scale: a claim that is too wide by a factor of two would give 0.25
    assert found.cases[0].chi2_per_row > 0.4


LINES = np.log([0.5, 1.0, 2.0, 4.0])


def curve(best, relative_u, top=20.0):
    """The gain of a noise whose level has a normal distribution in its logarithm; covariance level^2 diag(4, 4)."""

    def gain(covariance):
        level = math.sqrt(covariance[0, 0] / 4.0)
        return top - (math.log(level / best) / relative_u) ** 2

    return gain


class TestLevel:
    def test_the_unit_makes_the_noise_as_large_as_white_noise_in_half_of_the_rows(self):
        assert _angle_noise._unit(np.diag([1.0, 16.0, 4.0])) == pytest.approx(0.5)

    @pytest.mark.parametrize(("best", "relative_u"), [(0.7, 0.1), (3.0, 0.1), (20.0, 0.3)])
    def test_level_and_uncertainty_are_those_of_a_log_normal_distribution(self, best, relative_u):
        found = _angle_noise._peak(4.0 * np.eye(2), curve(best, relative_u))
        assert found.level == pytest.approx(best, rel=1e-6)
        assert found.relative_u == pytest.approx(relative_u, rel=1e-6)
        assert found.gain == pytest.approx(20.0)

    def test_a_gain_that_only_grows_has_no_separate_uncertainty(self):
        found = _angle_noise._peak(np.eye(2), lambda covariance: 0.01 * math.log(covariance[0, 0]) ** 2)
        assert found.relative_u == 1.0

    def test_the_points_of_a_kind(self):
        peaks = [_angle_noise._Peak(1.0, 0.1, 3.0), _angle_noise._Peak(2.0, 0.1, 10.0)]
        kind = _angle_noise._Kind(np.array([0.1, 0.2]), [np.eye(1), 2.0 * np.eye(1)], peaks)
        assert kind.gain == 10.0
        assert [p[:2] for p in kind.points((0.5, 1.0), 6.0)] == [(0.2, 1.0), (0.2, 2.0)]
        assert [p[:2] for p in kind.points((1.0,))] == [(0.1, 1.0), (0.2, 2.0)]


class TestPosterior:
    def test_times_are_weighted_by_their_likelihood_and_the_width_of_their_level(self):
        times = np.exp(np.linspace(-2.0, 2.0, 5))
        gains = 8.0 - (np.log(times) / 0.5) ** 2
        peaks = [_angle_noise._Peak(3.0, u, g) for g, u in zip(gains, (0.2, 0.2, 0.2, 0.2, 0.2), strict=True)]
        fine, levels, relative_u, weights = _angle_noise._fine_posterior(
            _angle_noise._Kind(times, [np.eye(1)] * 5, peaks)
        )
        assert len(fine) == 4 * _angle_noise._FINER + 1
        assert levels == pytest.approx(np.full(len(fine), 3.0))
        assert relative_u == pytest.approx(np.full(len(fine), 0.2))
        assert weights.sum() == pytest.approx(1.0)
        mean = weights @ np.log(fine)
        assert mean == pytest.approx(0.0, abs=1e-9)
        assert np.sqrt(weights @ (np.log(fine) - mean) ** 2) == pytest.approx(0.5, rel=0.02)

    def test_a_level_that_is_hardly_determined_has_weight_and_a_limited_width(self):
        times = np.exp(np.linspace(-1.0, 1.0, 5))
        peaks = [_angle_noise._Peak(1.0, u, 0.0) for u in (0.5, 0.75, 1.0, 1.25, 1.5)]
        _, _, relative_u, weights = _angle_noise._fine_posterior(
            _angle_noise._Kind(times, [np.eye(1)] * 5, peaks)
        )
        assert relative_u.max() == _angle_noise._LARGEST_RELATIVE_U
        assert weights[-1] / weights[0] == pytest.approx(3.0)

    def test_moments_and_roots(self):
        values, weights = np.array([1.0, 3.0]), np.array([0.25, 0.75])
        assert _angle_noise._moments(values, weights) == pytest.approx((2.5, math.sqrt(0.75)))
        root, inverse = _angle_noise._roots(np.array([[2.0, 1.0], [1.0, 2.0]]))
        assert root @ root == pytest.approx(np.array([[2.0, 1.0], [1.0, 2.0]]))
        assert root @ inverse == pytest.approx(np.eye(2))

    def test_level_time_and_rows_of_a_posterior(self):
        found = AngleNoise.of_posterior(
            np.array([1.0, 4.0]), np.array([3.0, 5.0]), np.array([0.5, 0.5]), 30.0, [9.0 * np.eye(1), 4.0 * np.eye(2)]
        )  # fmt: skip
        assert found.sigma == pytest.approx(math.sqrt(17.0))
        assert found.sigma_u == pytest.approx(1.0)
        assert found.time == pytest.approx(2.0)
        assert found.root == pytest.approx(np.diag([3.0, 2.0, 2.0]))
        assert found.inverse == pytest.approx(np.diag([1 / 3, 0.5, 0.5]))
        assert not found.is_white
        assert not AngleNoise(turn_sigma=1e-3).is_white
        assert AngleNoise().is_white

    def test_a_stated_error_adds_to_the_estimated_one(self):
        own = replace(AngleNoise(sigma=1.0), root=2.0 * np.eye(2), inverse=0.5 * np.eye(2))
        rows = np.array([[1.0], [2.0]])
        covariance = 4.0 * np.eye(2) + rows @ rows.T
        found = own.with_stated(rows)
        assert found.root @ found.root == pytest.approx(covariance)
        assert found.inverse @ covariance @ found.inverse == pytest.approx(np.eye(2))
        white = AngleNoise().with_stated(rows)
        assert white.root @ white.root == pytest.approx(np.eye(2) + rows @ rows.T)
        assert own.with_stated(np.zeros((2, 0))) is own

    @pytest.mark.parametrize(("second", "taken"), [(-1.0, False), (1.0, True)])
    def test_a_second_kind_needs_its_own_likelihood_ratio(self, second, taken):
        """One kind acts on the first row, with a gain of 30; the other one on the second row."""
        second = DEFAULT.correlated_noise + second
        first, other = np.diag([1.0, 1e-9]), np.diag([1e-9, 1.0])

        def gain(covariance):
            a, b = covariance[0, 0], covariance[1, 1]
            one = 30.0 - math.log(max(a, 1e-4)) ** 2 if a > 1e-3 else 0.0
            return one + (second - math.log(max(b, 1e-4)) ** 2 if b > 1e-3 else 0.0)

        kinds = [
            _angle_noise._Kind(np.array([t]), [k], [_angle_noise._Peak(1.0, 0.5, g)])
            for t, k, g in ((0.5, first, 30.0), (8.0, other, second))
        ]
        found = _angle_noise._with_periodic_part(*kinds, gain, DEFAULT.correlated_noise)
        assert (found is not None) is taken
        if found is not None:
            assert found.turn_time == pytest.approx(8.0)
            assert found.time == pytest.approx(0.5)
            assert found.turn_sigma == pytest.approx(1.0, rel=0.4)
            assert found.gain == pytest.approx(30.0 + second, abs=0.2)

    @pytest.mark.parametrize(("more", "taken"), [(0.5, True), (-0.5, False)])
    def test_the_more_likely_one_of_two_kinds_needs_no_further_ratio(self, more, taken):
        """Both act on the same row, so that together they gain nothing."""
        one, other = np.diag([1.0, 1e-12]), np.diag([1.0, 1e-6])

        def gain(covariance):
            level = math.log(covariance[0, 0])
            return (30.0 + more if covariance[1, 1] > 1e-7 else 30.0) - level**2

        kinds = [
            _angle_noise._Kind(np.array([t]), [k], [_angle_noise._Peak(1.0, 0.5, g)])
            for t, k, g in ((0.5, one, 30.0), (8.0, other, 30.0 + more))
        ]
        found = _angle_noise._with_periodic_part(*kinds, gain, DEFAULT.correlated_noise)
        assert (found is not None) is taken
        if found is not None:
            levels = np.array([0.5, 0.7, 1.0, 1.4, 2.0])
            weights = np.exp(-0.5 * np.log(levels**2) ** 2)
            both = [(a, b) for a in (0.1, 0.2, 0.4, 0.8) for b in levels]
            of_both = np.exp([-0.5 * math.log(a**2 + b**2) ** 2 for a, b in both])
            # five points of one kind, twenty of two kinds, with equal probabilities
            weight = np.append(weights / 5, of_both / 20)
            weight /= weight.sum()
            turns = np.append(levels, [b for _, b in both])
            mean = weight @ turns
            assert found.turn_sigma == pytest.approx(math.sqrt(weight @ turns**2), rel=1e-3)
            assert found.turn_sigma_u == pytest.approx(math.sqrt(weight @ (turns - mean) ** 2), rel=1e-3)
            assert found.gain == pytest.approx(30.5)

    def test_the_spectrum_is_that_of_an_exponential_covariance(self):
        assert _angle_noise._spectrum(np.array([0.0, 1 / (2 * np.pi * 0.3)]), 0.3) == pytest.approx(
            [1.0, 0.5]
        )


def turning(n=4000, rate=60.0, span=20.0, sigma=1e-3, seed=0):
    """Samples of a body that slows down, with white noise."""
    t = np.linspace(0.0, span, n)
    return t, rate * t - 0.3 * t**2, sigma * np.random.default_rng(seed).standard_normal(n)


def wandering_from_equilibrium(time, level, correlation, seed=1):
    keep = np.exp(-(time[1] - time[0]) / correlation)
    kicks = level * np.sqrt(1 - keep**2) * np.random.default_rng(seed).standard_normal(len(time))
    kicks[0] /= np.sqrt(1 - keep**2)
    return lfilter([1.0], [1.0, -keep], kicks)


class TestEstimate:
    """8 blocks of 2.5 s; a noise of 4 mrad over 0.2 s is several times the white noise of the rows."""

    def found(self, level=0.0, correlation=0.2, rate=60.0, periodic=0.0):
        t, y, white = turning(rate=rate)
        y = y + white + (wandering_from_equilibrium(t, level, correlation) if level else 0.0)
        if periodic:
            a, b = (wandering_from_equilibrium(t, periodic, 8.0, seed=s) for s in (5, 6))
            y = y + a * np.cos(y) + b * np.sin(y)
        run = compress(Samples(t, y, np.full(len(t), 1e-3)), degree=6, blocks=8)
        return estimate_angle_noise(run, np.zeros((len(run.z), 0)))

    def test_white_noise_is_white(self):
        found = self.found()
        assert found.is_white
        assert found.gain < DEFAULT.correlated_noise

    def test_level_and_time_of_correlated_noise_are_found(self):
        found = self.found(4e-3)
        assert found.gain > 3 * DEFAULT.correlated_noise
        assert found.sigma**2 * found.time == pytest.approx(16e-6 * 0.2, rel=1.5)
        assert found.turn_sigma == 0.0

    def test_errors_once_per_turn_of_a_slow_body_are_periodic(self):
        """0.4 turns a second: a block has about a turn."""
        found = self.found(rate=8.0, periodic=4e-3)
        assert found.turn_sigma == pytest.approx(4e-3, rel=0.6)
        assert found.turn_sigma > 2 * found.turn_sigma_u


class TestStatedRows:
    def run(self):
        t, y, white = turning()
        return compress(Samples(t, y + white, np.full(len(t), 1e-3)), degree=6, blocks=8)

    def test_beyond_white_never_exceeds_the_whole_covariance(self):
        """What the white noise contains already is its spectrum in the band where that is measured."""
        run = self.run()
        for time in (0.02, 0.3):
            whole, rest = (
                f(run, time)
                for f in (_angle_noise._row_covariance, _angle_noise._row_covariance_beyond_white)
            )
            less = np.median(np.diag(whole)[6::7]) * np.mean(
                1 / (1 + (np.pi * time / 2.5 * np.arange(7, 7 + _angle_noise.NOISE_ROWS)) ** 2)
            ) * (1 + (np.pi * time / 2.5 * 6) ** 2)  # fmt: skip
            values = np.linalg.eigvalsh(whole - less * np.eye(len(whole)))
            assert np.linalg.eigvalsh(rest) == pytest.approx(np.maximum(values, 0.0), abs=1e-6 * values.max())

    def test_a_negligible_part_of_the_covariance_has_no_columns(self):
        run = self.run()
        wide = stated_error_rows(run, 3e-5, 1.0)
        assert 0 < wide.shape[1] < len(run.z)
        assert stated_error_rows(run, 1e-7, 1.0).shape[1] == 0
        whole = 9e-10 * _angle_noise._row_covariance(run, 1.0)
        assert np.abs(wide @ wide.T - whole).max() <= _angle_noise._NEGLIGIBLE * 1.001


class TestWindows:
    """Two windows of one second of a camera at 400 Hz, whose noise is 2 mrad over 0.05 s."""

    def windows(self, level, seed=2):
        made = []
        for k in range(2):
            t = 10.0 * k + np.arange(0.0, 2.0, 1 / 400)
            rng = np.random.default_rng([seed, k])
            noise = wandering_from_equilibrium(t, level, 0.05, seed=seed + k) if level else 0.0
            y = 900.0 * t - 2.0 * t**2 + noise + 1e-3 * rng.standard_normal(len(t))
            made.append(compress(Samples(t, y, np.full(len(t), 1e-3)), degree=4, blocks=1))
        return made

    def test_the_noise_of_the_camera_is_found(self):
        windows = self.windows(3e-3)
        found = estimate_window_noise(windows, [np.zeros((800, 0))] * 2, 1e-6, 1.0)
        assert found.sigma == pytest.approx(3e-3, rel=0.3)
        assert abs(found.sigma - 3e-3) < 3 * found.sigma_u
        assert found.time == pytest.approx(0.05, rel=0.5)
        assert found.root.shape == (10, 10)
        assert found.root @ found.inverse == pytest.approx(np.eye(10), abs=1e-8)

    def test_the_gain_is_twice_the_logarithm_of_the_likelihood_ratio(self):
        """Of the likelihood with the white noise integrated out, at its maximum over time and level."""
        windows = self.windows(3e-3)
        found = estimate_window_noise(windows, [np.zeros((800, 0))] * 2, 1e-6, 1.0)
        groups = [_angle_noise._WindowGroups(w, np.zeros((800, 0)), 1e-6, 1.0) for w in windows]
        count = sum(len(g.projected) for g in groups)
        ratios = np.median(groups[0].white) * np.geomspace(1.0, 1e4, 60)
        best = -np.inf
        for time in np.geomspace(0.02, 0.2, 12):
            determinant, square = sum(np.array(g.likelihood_terms(time, ratios)) for g in groups)
            best = max(best, float((-determinant - count * np.log(square)).max()))
        white = count * math.log(sum(g.projected @ g.projected for g in groups))
        assert found.gain == pytest.approx(best + white, rel=0.02)

    def test_white_noise_shows_no_correlated_noise(self):
        found = estimate_window_noise(self.windows(0.0), [np.zeros((800, 0))] * 2, 1e-6, 1.0)
        assert not found.is_significant
        assert found.sigma < 3e-4  # a small part of the white noise
        assert found.gain < DEFAULT.correlated_noise

    def test_what_is_free_in_the_windows_is_not_noise(self):
        """A nuisance function of each window, 20 times the noise of a group."""
        windows = self.windows(0.0)
        nuisance = [np.sin(40.0 * w.samples.time)[:, None] for w in windows]
        disturbed = [
            compress(replace(w.samples, value=w.samples.value + 5e-3 * n[:, 0]), degree=4, blocks=1)
            for w, n in zip(windows, nuisance, strict=True)
        ]
        assert not estimate_window_noise(disturbed, nuisance, 1e-6, 1.0).is_significant
        assert estimate_window_noise(disturbed, [n[:, :0] for n in nuisance], 1e-6, 1.0).is_significant

    @pytest.mark.parametrize(("samples", "enough"), [(40, False), (183, False), (184, True)])
    def test_from_forty_free_groups_there_is_an_estimate(self, samples, enough):
        """Groups of four samples, six of which a polynomial of degree five takes."""
        t = np.arange(samples) / 400.0
        y = 900.0 * t + 1e-3 * np.random.default_rng(1).standard_normal(samples)
        run = compress(Samples(t, y, np.full(samples, 1e-3)), degree=2, blocks=1)
        found = estimate_window_noise([run], [np.zeros((samples, 0))], 1e-6, 1.0)
        assert (found.sigma > 0.0) is enough
