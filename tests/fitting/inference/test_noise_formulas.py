"""Formulas of the noise of a case and of a recording, compared with direct evaluations of their definitions."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import solve
from scipy.stats import chi2 as chi_square
from scipy.stats import multivariate_normal, norm

from fitting.inference import _noise as noise
from fitting.inference import _process_noise as process
from fitting.inference import _result
from fitting.inference._compression import compress
from fitting.inference._noise import (
    Whitener,
    possible_scales,
    remaining_level,
    tail_probability,
    unresolved_level,
)
from fitting.inference._process_noise import StretchLikelihood, estimate_process_noise, mean_acceleration
from fitting.inference._record import Samples

RNG = np.random.default_rng(0)
ROWS = 6
RESPONSE = RNG.standard_normal((ROWS - 1, ROWS - 1))
KERNEL = RESPONSE @ RESPONSE.T
VALUES, VECTORS = np.linalg.eigh(KERNEL)
WHITENER = Whitener(VECTORS, VALUES, 0.0)
RESIDUAL = RNG.standard_normal(ROWS)
FREE = RNG.standard_normal((ROWS, 2))


def covariance(level):
    """1 + level^2 K; the last row does not respond to a torque."""
    whole = np.eye(ROWS)
    whole[:-1, :-1] += level**2 * KERNEL
    return whole


def restricted_deviance(level):
    """-2 log of the restricted likelihood, by its textbook formula; columns of unit length."""
    c = covariance(level)
    x = FREE / np.linalg.norm(FREE, axis=0)
    inner = x.T @ solve(c, x)
    fitted = np.linalg.solve(inner, x.T @ solve(c, RESIDUAL))
    rest = RESIDUAL - x @ fitted
    return np.linalg.slogdet(c)[1] + np.linalg.slogdet(inner)[1] + rest @ solve(c, rest)


class TestWhitener:
    def test_rows_have_unit_covariance(self):
        found = WHITENER.at(0.7)(np.eye(ROWS))
        assert found @ covariance(0.7) @ found.T == pytest.approx(np.eye(ROWS))
        assert WHITENER.at(0.7)(RESIDUAL) == pytest.approx(found @ RESIDUAL)
        assert WHITENER.at(0.0)(RESIDUAL) is RESIDUAL
        assert WHITENER.at(0.7).log_determinant == pytest.approx(np.linalg.slogdet(covariance(0.7))[1])

    def test_white_rows_become_those_of_the_noise(self):
        root = WHITENER.at(0.7).coloured(np.eye(ROWS))
        assert root @ root.T == pytest.approx(covariance(0.7))
        assert WHITENER.at(0.7)(root) == pytest.approx(np.eye(ROWS))
        assert WHITENER.at(0.7).coloured(RESIDUAL) == pytest.approx(root @ RESIDUAL)

    def test_the_share_of_the_torque_is_that_of_the_variance(self):
        white = WHITENER.at(0.7)
        direction = white(FREE[:, :1])
        direction /= np.linalg.norm(direction)
        shaped = np.zeros((ROWS, ROWS))
        shaped[:-1, :-1] = 0.49 * KERNEL
        root = white(np.eye(ROWS))
        expected = float((direction.T @ root @ shaped @ root.T @ direction)[0, 0])
        assert white.share(direction) == pytest.approx(expected)
        assert WHITENER.at(0.0).share(direction) == pytest.approx(0.0)

    def test_the_deviance_is_that_of_the_restricted_likelihood(self):
        rotated, values = noise._rotated(WHITENER, RESIDUAL, FREE)
        differences = [
            noise._deviance(rotated, 1 + s**2 * values) - noise._deviance(rotated, 1 + 0 * values)
            for s in (0.3, 2.0)
        ]
        expected = [restricted_deviance(s) - restricted_deviance(0.0) for s in (0.3, 2.0)]
        assert differences == pytest.approx(expected)


class TestLevels:
    @pytest.mark.parametrize("size", [0.1, 3.0, 10.0])
    def test_the_most_likely_level(self, size):
        residual = np.append(size * RESPONSE @ np.array([1.0, -1.0, 0.5, 2.0, -0.3]), 0.5)
        level, excess = remaining_level(WHITENER, residual, FREE[:, :0])
        trial = np.append(0.0, np.geomspace(0.01, 100.0, 300))
        found = np.array([-2 * multivariate_normal(cov=covariance(s)).logpdf(residual) for s in trial])
        best = trial[found.argmin()]
        if best == 0.0:
            assert (level, excess) == (0.0, 0.0)
        else:
            assert level == pytest.approx(best, rel=0.04)
            assert excess == pytest.approx(found[0] - found.min(), rel=0.05)

    @pytest.mark.parametrize("expected", [0.2, 1.0])
    def test_an_unresolved_level_is_the_posterior_mean(self, expected):
        """No torque or one of a half-normal prior, with equal probabilities."""
        residual = 0.8 * RESIDUAL

        def likelihood(s):
            return multivariate_normal(cov=covariance(s)).pdf(residual)

        def weighted(power):
            return quad(
                lambda s: s**power * likelihood(s) * 2 * norm(scale=expected).pdf(s), 0, 4 * expected
            )[0]

        root = np.sqrt(weighted(2) / (likelihood(0.0) + weighted(0)))
        assert unresolved_level(WHITENER, residual, FREE[:, :0], expected) == pytest.approx(root, rel=0.08)
        assert unresolved_level(WHITENER, residual, FREE[:, :0], 0.0) == 0.0

    def test_without_information_the_unresolved_level_is_that_of_its_prior(self):
        """The mean square of half a normal distribution is its variance, with a probability of a half."""
        deaf = Whitener(VECTORS, 1e-9 * VALUES, 0.0)
        found = unresolved_level(deaf, 0.8 * RESIDUAL, FREE, 1.0)
        assert found == pytest.approx(1.0 / np.sqrt(2.0), rel=0.03)

    @pytest.mark.parametrize(
        ("excess", "white", "level"),
        [(5.9, False, 3.0 / np.sqrt(2.0)), (6.1, False, 0.0), (5.9, True, 0.0)],
    )
    def test_correlated_deviations_of_an_angle_may_be_those_of_a_torque(self, excess, white, level):
        """Residuals without information leave the prior, whose width is the level of the recording."""
        deaf = Whitener(VECTORS, 1e-9 * VALUES, 0.0)
        data = SimpleNamespace(
            angle_noise=SimpleNamespace(is_white=white), nuisance=FREE[:, 1:], z=0.8 * RESIDUAL
        )
        fitted = SimpleNamespace(columns=FREE[:, :1], places=np.array([0]), rows=np.zeros(ROWS))
        known = noise.Noise(
            1.0, pure=3.0, pure_u=1.0, level=0.2, time=1.0, whitener=deaf, process=None, excess=excess
        )
        problem = SimpleNamespace(data=[data])
        (found,) = _result._with_unresolved(problem, [fitted], [known], np.zeros(1, dtype=bool))
        assert found.unresolved == pytest.approx(level, rel=0.03)

    def test_a_parameter_at_its_bound_does_not_absorb_a_torque(self):
        residual = 2.0 * np.append(RESPONSE[:, 0], 0.0)
        data = SimpleNamespace(angle_noise=SimpleNamespace(is_white=False), nuisance=FREE[:, :0], z=residual)
        known = noise.Noise(1.0, pure=3.0, pure_u=1.0, level=0.0, time=1.0, whitener=WHITENER, process=None)
        levels = []
        for columns, held in ((residual[:, None], True), (residual[:, None], False), (FREE[:, :0], False)):
            places = np.arange(columns.shape[1])
            fitted = SimpleNamespace(columns=columns, places=places, rows=np.zeros(ROWS))
            problem = SimpleNamespace(data=[data])
            (found,) = _result._with_unresolved(problem, [fitted], [known], np.array([held]))
            levels.append(found.unresolved)
        assert levels[0] == pytest.approx(levels[2])
        assert levels[1] < 0.9 * levels[0]

    def test_the_peak_of_a_parabola_in_the_logarithm(self):
        levels = np.append(0.0, np.geomspace(0.01, 100.0, 30))
        likelihood = np.append(-50.0, -((np.log(levels[1:] / 1.7)) ** 2))
        assert noise._peak(levels, likelihood) == pytest.approx(1.7)
        assert noise._peak(levels, -levels) == 0.0
        assert noise._peak(levels, levels) == levels[-1]

    def test_slow_rows_respond_as_well(self):
        """Three rows without a residual and six of 3e4, whose response is 1e-15 of the largest one.

        D = 3 ln s^2 + 6 (ln v + 9e8 / v) with v = 1e-15 s^2 is least at v = 6e8.
        """
        values = np.append(np.ones(3), np.full(6, 1e-15))
        residual = np.append(np.zeros(3), np.full(6, 3e4))
        level, _ = remaining_level(Whitener(np.eye(9), values), residual, np.zeros((9, 0)))
        assert 1e-15 * level**2 == pytest.approx(6e8, rel=0.05)

    @pytest.mark.parametrize(("level", "raised"), [(1.4, False), (1.6, True)])
    def test_half_more_than_the_lowest_level_is_raised(self, level, raised):
        recorded = SimpleNamespace(level=2.0, least=0.5)
        found = noise.Noise(
            1.0, pure=4.0, pure_u=1.0, level=level, time=1.0, whitener=WHITENER, process=recorded
        )
        assert found.least == 1.0
        assert found.raised is raised
        assert found.with_unresolved.level == level
        assert noise.replace(found, unresolved=3.0).with_unresolved.level == 3.0
        assert noise.replace(found, unresolved=3.0).with_unresolved.whitener.level == 3.0


class TestTails:
    def cases(self):
        ratios = (np.array([0.5, 2.0]), np.array([1.0]))
        weights = (np.array([0.25, 0.75]), np.array([1.0]))
        return [
            SimpleNamespace(process=SimpleNamespace(ratios=r, weights=w))
            for r, w in zip(ratios, weights, strict=True)
        ]

    def test_an_uncertain_noise_scales_its_share_of_the_variance(self):
        scales, weights = possible_scales(self.cases(), [0.4, 0.9])
        assert scales == pytest.approx([0.6 + 0.4 * 0.5, 0.6 + 0.4 * 2.0, 1.0])
        assert weights == pytest.approx([0.125, 0.375, 0.5])
        expected = sum(w * chi_square(3).sf(7.0 / s) for s, w in zip(scales, weights, strict=True))
        assert tail_probability(7.0, 3, self.cases(), [0.4, 0.9]) == pytest.approx(expected)
        assert tail_probability(7.0, 3, [], []) == pytest.approx(chi_square(3).sf(7.0))
        assert tail_probability(-1.0, 3, [], []) == 1.0

    @pytest.mark.parametrize(("chi2", "dof"), [(3.0, 4), (9.0, 4), (60.0, 20), (200.0, 20)])
    def test_the_factor_of_a_variance_is_a_posterior_mean(self, chi2, dof):
        """Factor 1, or an inverse factor that is uniform between 0 and 1, with equal probabilities."""
        density = lambda f: f * chi_square(dof).pdf(chi2 * f)  # noqa: E731 - of chi2 at the variance 1 / f
        mass = quad(density, 0, 1)[0]
        mean = quad(lambda f: density(f) / f, 0, 1)[0]
        one = chi_square(dof).pdf(chi2)
        assert noise.variance_factor(chi2, dof) == pytest.approx((one + mean) / (one + mass), rel=1e-6)

    def test_decaying_sums(self):
        w = RNG.standard_normal((5, 2))
        weights = np.triu(0.7 ** np.maximum(np.arange(5) - np.arange(5)[:, None], 0))
        assert noise.decaying_sums(w, 0.7) == pytest.approx(weights @ w)


def run(level=0.0, correlation=0.3, *, angle=True, seed=1, n=3000, span=20.0):
    """A body that slows down by 2 rad/s2, with a random acceleration [rad/s2]."""
    t = np.linspace(0.0, span, n)
    step, rng = t[1], np.random.default_rng(seed)
    keep = np.exp(-step / correlation)
    random = np.zeros(n)
    for k in range(1, n):
        random[k] = keep * random[k - 1] + level * np.sqrt(1 - keep**2) * rng.standard_normal()
    speed = 80.0 - 2.0 * t + np.cumsum(random) * step
    sigma = 1e-3 if angle else 1e-2
    value = (np.cumsum(speed) * step if angle else speed) + sigma * rng.standard_normal(n)
    return compress(Samples(t, value, np.full(n, sigma)), degree=6, blocks=8)


class TestProcessNoise:
    def test_the_mean_acceleration(self):
        assert mean_acceleration(run()) == pytest.approx(2.0 * 7 / 8, rel=0.02)  # of eight parts
        assert mean_acceleration(run(span=40.0)) == pytest.approx(2.0 * 7 / 8, rel=0.02)

    @pytest.mark.parametrize("angle", [True, False])
    def test_the_level_of_a_random_acceleration_is_estimated(self, angle):
        data = run(0.5, angle=angle)
        found = estimate_process_noise(data, np.zeros((len(data.z), 0)), np.zeros((0, 0)), angle=angle)
        assert found.level**2 * found.time == pytest.approx(0.25 * 0.3, rel=1.5)
        assert abs(found.level - 0.5) < 4 * found.level_u
        assert 0.0 < found.least < found.level
        assert found.weights.sum() == pytest.approx(1.0)
        assert 0.5 < found.weights @ found.ratios < 2.0

    @pytest.mark.parametrize("angle", [True, False])
    def test_without_one_it_is_a_part_of_the_resolution(self, angle):
        data = run(angle=angle)
        found = estimate_process_noise(data, np.zeros((len(data.z), 0)), np.zeros((0, 0)), angle=angle)
        parts = StretchLikelihood.of(
            [process.Stretch(data, np.arange(4), np.zeros((len(data.z), 0)), 11, angle=angle)], None
        )
        assert found.level < parts.unit(found.time)

    def test_the_response_to_a_random_acceleration_is_its_integral(self):
        """Of rows that are orthogonal to a parabola, by direct integration of the covariance at the nodes."""
        for angle in (True, False):
            data = run(angle=angle)
            stretch = process.Stretch(data, np.arange(2), np.zeros((len(data.z), 0)), 3, angle=angle)
            covariance, unit = stretch.torque_covariance(0.5)
            assert np.median(np.diag(covariance)) == pytest.approx(1.0)
            k = data.lift.shape[1]
            nodes = data.node_times[: 2 * k]
            grid = np.linspace(nodes.min(), nodes.max(), 1500)
            step = grid[1] - grid[0]
            since = np.maximum(nodes[:, None] - grid, 0.0) if angle else (nodes[:, None] > grid).astype(float)
            of_nodes = since @ np.exp(-np.abs(grid[:, None] - grid) / 0.5) @ since.T * step**2
            lift = np.zeros((2 * k, 2 * k))
            for b in range(2):
                lift[b * k : (b + 1) * k, b * k : (b + 1) * k] = data.lift[b]
            rows = stretch._complement.T @ lift
            expected = rows @ of_nodes @ rows.T
            assert 1 / unit**2 == pytest.approx(np.median(np.diag(expected)), rel=0.15)
            assert covariance / unit**2 == pytest.approx(expected, abs=0.1 * expected.max())

    def test_the_prior_of_a_level_is_half_a_student_distribution(self):
        """In the logarithm of the level; its scale is the root of resolution / (2 T), or the typical acceleration."""
        levels = np.geomspace(1e-4, 1e5, 4000)
        for resolution, time, typical, scale in (
            (0.08, 1.0, np.inf, 0.2),
            (0.08, 1.0, 0.1, 0.1),
            (0.08, 0.25, np.inf, 0.4),
        ):
            density = np.exp(process._log_prior(levels, time, resolution, typical))
            x = levels / scale
            assert density == pytest.approx(x / (1 + x**2 / 3) ** 2)

    def test_bins_keep_means_and_weights(self):
        values, weights = RNG.lognormal(size=500), RNG.uniform(size=500)
        mean, total = process._binned(values, weights)
        assert total.sum() == pytest.approx(1.0)
        assert mean @ total == pytest.approx(values @ weights / weights.sum())
        assert len(mean) <= 60
        assert (np.diff(mean) > 0).all()

    def test_the_likelihood_beside_correlated_angle_noise(self):
        """That of a normal distribution, but for the determinant of the angle noise, which all levels share."""
        data = run(0.5)
        mixed = np.random.default_rng(3).standard_normal((len(data.z),) * 2) / 5.0
        stretch = process.Stretch(data, np.arange(2), np.zeros((len(data.z), 0)), 3)
        angle = (mixed @ mixed.T)[np.ix_(stretch.rows, stretch.rows)]
        angle = np.eye(len(stretch.projected)) + stretch._complement.T @ angle @ stretch._complement
        r, (kernel, unit) = stretch.projected, stretch.torque_covariance(0.3)
        found = StretchLikelihood.of([stretch], mixed @ mixed.T)(0.3, np.array([0.5, 3.0]) * unit)
        expected = [multivariate_normal(cov=angle + s**2 * kernel).logpdf(r) for s in (0.5, 3.0)]
        shared = 0.5 * len(r) * np.log(2 * np.pi) + 0.5 * np.linalg.slogdet(angle)[1]
        assert found == pytest.approx(np.array(expected) + shared)

    def test_the_unit_is_that_of_the_median_stretch(self):
        parts = [
            SimpleNamespace(stretch=SimpleNamespace(torque_covariance=lambda time, u=u: (None, u * time)))
            for u in (1.0, 7.0, 2.0)
        ]
        assert StretchLikelihood(parts).unit(3.0) == 6.0

    def test_shares_of_the_most_likely_process_noise_whiten_a_stretch(self):
        data = run(0.5)
        stretch = process.Stretch(data, np.arange(2), np.zeros((len(data.z), 0)), 3)
        kernel, unit = stretch.torque_covariance(0.3)
        level, r = stretch.most_likely_level([0.3]) / unit, stretch.projected
        for share, (whitening, deviance) in zip(
            (0.5, 1.0), stretch.whitenings_at([0.3], (0.5, 1.0)), strict=True
        ):
            covariance = np.eye(len(r)) + (share * level) ** 2 * kernel
            assert whitening @ covariance @ whitening.T == pytest.approx(np.eye(len(r)), abs=1e-6)
            expected = np.linalg.slogdet(covariance)[1] + r @ solve(covariance, r)
            assert deviance == pytest.approx(expected, rel=1e-6)

    def test_the_mean_acceleration_of_a_motion_that_speeds_up_and_slows_down(self):
        """The mean speeds of ten parts of 2 s are 6, 8 ... 14, 14 ... 6 rad/s: 16 rad/s of change in 20 s."""
        t = np.linspace(0.0, 20.0, 801)
        angle = 5.0 * t + np.where(t < 10.0, 0.5 * t**2, 20.0 * t - 0.5 * t**2 - 100.0)
        data = SimpleNamespace(samples=Samples(t, angle, np.full(801, 1e-9)), lift=np.zeros((10, 1, 1)))
        assert mean_acceleration(data) == pytest.approx(16.0 / 20.0, rel=0.02)

    def test_an_improbable_level_has_its_part_of_the_mean(self):
        """One of 1e-10 at 1e12 adds 100; one of 1e-30 is left out, whatever it is."""
        mean, total = process._binned(np.array([1.0, 2.0, 1e12, 1e40]), np.array([0.5, 0.5, 1e-10, 1e-30]))
        assert mean @ total == pytest.approx(101.5)
        assert mean.max() == pytest.approx(1e12)

    @pytest.mark.parametrize("columns", [2, 300])
    def test_nuisance_functions_are_marginalised_with_their_prior(self, columns):
        """Few or more than the rows, by the textbook formula of generalised least squares."""
        data = run(0.5)
        nuisance = np.random.default_rng(5).standard_normal((len(data.z), columns)) * 0.3
        stretch = process.Stretch(data, np.arange(2), nuisance, 3)
        nodes = data.node_times.reshape(-1, data.lift.shape[1])[:2]
        x = 2 * (nodes - nodes.min()) / np.ptp(nodes) - 1
        powers = np.polynomial.legendre.legvander(x.ravel(), 3).reshape(*x.shape, -1)
        polynomial = (data.lift[:2] @ powers).reshape(len(stretch.rows), -1)
        seen = nuisance[stretch.rows]
        weight = np.linalg.inv(np.eye(len(seen)) + seen @ seen.T)
        fitted = np.linalg.solve(polynomial.T @ weight @ polynomial, polynomial.T @ weight)
        expected = weight - weight @ polynomial @ fitted
        assert stretch._complement @ stretch._complement.T == pytest.approx(expected, abs=1e-8)

    def test_the_likelihood_of_a_stretch(self):
        data = run(0.5)
        stretch = process.Stretch(data, np.arange(2), np.zeros((len(data.z), 0)), 3)
        r, (kernel, unit) = stretch.projected, stretch.torque_covariance(0.3)
        (found,) = StretchLikelihood.of([stretch], None)(0.3, np.array([2.0 * unit]))
        expected = multivariate_normal(cov=np.eye(len(r)) + 4.0 * kernel, allow_singular=True).logpdf(r)
        assert found == pytest.approx(expected + 0.5 * len(r) * np.log(2 * np.pi))
        assert stretch.likelihood(None) == pytest.approx(-0.5 * r @ r)
        more = 3.0 * np.eye(len(data.z))
        assert stretch.likelihood(more) == pytest.approx(-0.5 * r @ r / 4.0 - len(r) * np.log(2.0))
        levels = process._GRID[1:] * unit
        likely = [
            multivariate_normal(cov=np.eye(len(r)) + (s / unit) ** 2 * kernel, allow_singular=True).logpdf(r)
            for s in levels
        ]
        assert stretch.most_likely_level([0.3]) == pytest.approx(levels[int(np.argmax(likely))])


class TestImpulses:
    """A free body of inertia 0.5 under a torque of 1 N m in one cell of time, [0, 1], [1, 2] or [2, 3]."""

    TIMES = np.array([0.25, 0.75, 1.0, 2.6])

    def response(self, *, angle, moving=1.0):
        class Motion:
            def impulses(self, centres, direction):
                return np.tile(direction, (len(centres), 1))

            def integrated(self, times):
                return times[:, None, None] * np.eye(2)

            def fundamental(self, times):
                return np.tile(np.eye(2), (len(times), 1, 1))

            def accelerations(self, direction):
                return direction

            def moving(self, times):
                return np.full(len(times), moving)

        data = SimpleNamespace(
            is_angle=angle,
            casing=SimpleNamespace(node_times=self.TIMES),
            rotor=(SimpleNamespace(node_times=self.TIMES),),
            rows=lambda casing, rotor: np.concatenate([casing, *rotor]),
        )
        rows = noise._impulses(data, Motion(), np.arange(4.0), np.array([0.0, 2.0]))
        assert not rows[len(self.TIMES) :].any()
        return rows[: len(self.TIMES)]

    @pytest.mark.parametrize("angle", [True, False])
    def test_in_a_cell_the_torque_acts_since_its_beginning(self, angle):
        since = np.clip(self.TIMES[:, None] - np.arange(3.0), 0.0, 1.0)
        later = np.maximum(self.TIMES[:, None] - np.arange(1.0, 4.0), 0.0)
        expected = 2.0 * (0.5 * since**2 + since * later if angle else since)
        assert self.response(angle=angle) == pytest.approx(expected)

    def test_a_casing_at_rest_does_not_respond_in_the_cell(self):
        """What it does later is that of the motion."""
        found = self.response(angle=True, moving=0.0)
        assert found[[0, 1, 2, 3], [0, 0, 1, 2]] == pytest.approx(0.0)
        assert found[3, 0] == pytest.approx(2.0 * 2.1)

    def test_rows_of_harmonics_respond_to_both_torques_of_coupled_bodies(self):
        """The casing takes three tenths of the rotor's torque over its inertia: of the bearing, with the other sign."""
        coupled = SimpleNamespace(accelerations=lambda d: np.array([d[0], d[1] + 0.3 * d[0]]))
        square, frequency = np.array([2.0, 5.0]), np.array([3.0, 7.0])
        response = SimpleNamespace(
            data=SimpleNamespace(
                record=SimpleNamespace(I_casing=0.5, I_rotor=0.25), harmonic_row_responses=(square, frequency)
            ),
            _motion=coupled,
        )
        density = 2 * 0.4 / (1 + (0.4 * frequency) ** 2)
        expected = (2.0**2 + (2.0 - 0.3 * 4.0) ** 2) * square * density
        assert noise.TorqueResponse._harmonic_variances(response, 0.4) == pytest.approx(expected)
