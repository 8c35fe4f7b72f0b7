"""Which stretches, which kind of noise and which level are taken, on either side of each threshold."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from linearised import gyroscope
from scipy.optimize import brentq

from fitting import Fit
from fitting._criteria import DEFAULT
from fitting.inference import _angle_noise as angle
from fitting.inference import _noise
from fitting.inference import _problem as problem
from fitting.inference import _process_noise as process
from fitting.inference._compression import compress
from fitting.inference._noise import Noise, TorqueNoise, TorqueResponse, Whitener, remaining_level
from fitting.inference._process_noise import StretchLikelihood, estimate_process_noise, mean_acceleration
from fitting.inference._record import Samples

RNG = np.random.default_rng(0)


class TestTorqueResponse:
    """Of a gyroscope of 12 s, whose small motions are those of its linearised equations."""

    def response(self):
        base = gyroscope()
        return base, TorqueResponse(base.problem.data[0], base.predictions[0].motion)

    def test_a_torque_in_all_cells_is_a_constant_torque(self):
        base, response = self.response()
        assert response.centres == pytest.approx(0.5 * (response.edges[1:] + response.edges[:-1]))
        assert (response.edges[0], response.edges[-1]) == base.problem.data[0].record.span
        up, down = (
            gyroscope(
                (
                    "rotor.air.quadratic",
                    "touchpoint.constant",
                    "casing.air.linear",
                    "bearing.linear",
                    "external.constant",
                ),
                {"external.constant.k": k},
            )
            .predictions[0]
            .rows
            for k in (1e-9, -1e-9)
        )
        exact = ((up - down) / 2e-9)[: len(response.casing)]
        assert response.casing.sum(axis=1) == pytest.approx(exact, rel=1e-3, abs=1e-3 * np.abs(exact).max())

    @pytest.mark.parametrize("time", [0.3, 5.0])
    def test_the_covariance_is_the_sum_over_pairs_of_cells(self, time):
        _, response = self.response()
        lag = np.abs(response.centres[:, None] - response.centres)
        kernel = np.exp(-lag / time)
        both = response.casing, response.casing - response.rotor
        expected = sum(w @ kernel @ w.T for w in both)
        found = response.covariance(time)
        assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()
        whitener = response.whitener(TorqueNoise(2e-7, time))
        m = len(expected)
        root = whitener(np.eye(len(whitener.values)))[:m, :m]
        assert root @ (np.eye(m) + 4e-14 * expected) @ root.T == pytest.approx(np.eye(m), abs=1e-6)
        assert whitener.level == 2e-7

    def test_rows_of_harmonics_respond_to_the_torque_of_their_frequency(self):
        base, response = self.response()
        data = base.problem.data[0]
        square, frequency = data.harmonic_row_responses
        inverse = 1 / data.record.I_casing
        for time in (0.1, 2.0):
            density = 2 * time / (1 + (frequency * time) ** 2)
            # a torque on the casing, and one between the bodies, that both accelerate the casing
            assert response._harmonic_variances(time) == pytest.approx(2 * inverse**2 * square * density)


class TestRemainingLevel:
    def test_rows_at_rest_do_not_set_the_unit(self):
        """Half of the rows hardly respond: the levels are those of the rows that do."""
        values = np.concatenate([np.full(6, 1e-30), np.full(5, 4.0)])
        rows = np.concatenate([np.ones(6), 30.0 * np.ones(5)])
        level, excess = remaining_level(Whitener(np.eye(11), values), rows, np.zeros((11, 0)))
        assert 1 + 4.0 * level**2 == pytest.approx(900.0, rel=0.1)
        expected = 5 * (900.0 - 1.0 - math.log(900.0))
        assert excess == pytest.approx(expected, rel=0.02)

    def test_without_response_there_is_no_level(self):
        assert remaining_level(Whitener(np.eye(3), np.zeros(3)), np.full(3, 9.0), np.zeros((3, 0))) == (
            0.0,
            0.0,
        )

    def test_levels_reach_from_the_most_responsive_row_to_far_above_the_median_one(self):
        levels = _noise._trial_levels(np.array([1e-12, 1e-4, 4.0]))
        assert levels[0] == 0.0
        assert levels[1] == pytest.approx(0.1 / 2.0)
        assert levels[-1] == pytest.approx(3e5 / 1e-2)
        assert np.all(np.diff(np.log10(levels[1:])) == pytest.approx(1 / 8, rel=0.02))

    @pytest.mark.parametrize("level", [1.0, 3.0])
    def test_a_level_that_few_rows_show_is_found(self, level):
        """Of 300 rows 20 respond as to white noise, all others a million times less."""
        values = np.concatenate([np.ones(20), np.full(280, 1e-12)])
        found = []
        for seed in range(40):
            rows = np.random.default_rng(seed).standard_normal(300) * np.sqrt(1 + level**2 * values)
            found.append(remaining_level(Whitener(np.eye(300), values), rows, np.zeros((300, 0)))[0])
        assert np.mean(np.square(found)) == pytest.approx(level**2, rel=0.35)

    def test_free_columns_explain_a_residual(self):
        column = RNG.standard_normal((20, 1))
        whitener = Whitener(np.eye(20), np.ones(20))
        assert remaining_level(whitener, 50.0 * column[:, 0], np.zeros((20, 0)))[0] > 10.0
        assert (
            remaining_level(whitener, 50.0 * column[:, 0], np.column_stack([column, np.zeros(20)]))[0] < 1.0
        )


@pytest.mark.parametrize("joints", [1, 3])
def test_the_torques_of_all_joints_and_of_the_ground_accelerate_the_main_body(monkeypatch, joints):
    """All have the same rms; their sum has that of the acceleration times the moment of inertia."""
    monkeypatch.setattr(
        problem, "TorqueResponse", lambda *_: SimpleNamespace(whitener=lambda noise: (noise.rms, noise.time))
    )
    data = SimpleNamespace(
        process_noise=SimpleNamespace(level=3.0, level_u=0.5, time=0.7),
        record=SimpleNamespace(
            I_casing=2.0, mechanism=SimpleNamespace(main="casing", joints_of=lambda part: joints)
        ),
        casing=SimpleNamespace(scale=1.2),
    )
    found = problem.recording_noise(data, SimpleNamespace(motion=None))
    assert math.sqrt(1 + joints) * found.pure == pytest.approx(6.0)
    assert math.sqrt(1 + joints) * found.pure_u == pytest.approx(1.0)
    assert (found.level, found.time, found.scale) == (found.pure, 0.7, 1.2)
    assert found.whitener == (found.pure, 0.7)


@pytest.mark.parametrize(
    ("cases", "unestablished"),
    [
        ([(True, 1.1)], True),
        ([(True, 0.9)], False),
        ([(False, 1.1)], False),
        ([(True, 1.1), (False, 0.0)], True),
        ([(True, 0.9), (False, 1.1)], False),
    ],
)
def test_one_case_needs_a_random_torque_that_its_recording_may_not_have(cases, unestablished):
    limit = DEFAULT.random_torque_evidence
    noise = [SimpleNamespace(raised=raised, excess=share * limit) for raised, share in cases]
    found = SimpleNamespace(noise=noise, criteria=DEFAULT)
    assert Fit.needs_unestablished_torque(found) is unestablished


def test_a_noise_has_no_excess_unless_it_is_measured():
    found = Noise(1.0, 2.0, 0.1, 3.0, 1.0, Whitener(np.zeros((0, 0)), np.zeros(0)), None)
    assert (found.excess, found.unresolved, found.common, dict(found.about)) == (0.0, 0.0, False, {})
    assert found.at(5.0).level == found.at(5.0).whitener.level == 5.0


def run(n=3000, span=20.0, blocks=8, degree=6, sigma=1e-3):
    t = np.linspace(0.0, span, n)
    white = sigma * np.random.default_rng(1).standard_normal(n)
    return compress(Samples(t, 80.0 * t - t**2 + white, np.full(n, sigma)), degree=degree, blocks=blocks)


class TestStretches:
    def divided(self, monkeypatch, blocks, consistent, rows=7, *, angle=True):
        """Return the blocks of each stretch; `consistent` says whether two stretches are described as one."""
        made = []

        class Likelihood:
            def __init__(self, parts):
                self.parts = list(parts)

            @classmethod
            def of(cls, stretches, covariance):
                return cls([SimpleNamespace(stretch=s) for s in stretches])

            def is_consistent_with(self, finer, times):
                return consistent(self, finer)

        class Stretch:
            def __init__(self, run, part, nuisance, degree, *, angle):
                self.blocks, self.degree = part, degree
                self.projected = np.zeros(1)
                made.append(self)

        monkeypatch.setattr(process, "StretchLikelihood", Likelihood)
        monkeypatch.setattr(process, "Stretch", Stretch)
        monkeypatch.setattr(process, "_process_noise", lambda found, times, typical: (found, times))
        data = SimpleNamespace(
            lift=np.zeros((blocks, rows, rows)),
            samples=SimpleNamespace(time=np.array([1.0, 1.0 + 2.0 * blocks])),
        )
        found, times = estimate_process_noise(
            data, np.zeros((blocks * rows, 0)), np.zeros((0, 0)), angle=angle
        )
        assert times == pytest.approx([1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0, 2.0, 4.0, 6.0])
        return [len(p.stretch.blocks) for p in found.parts], made

    def test_a_long_record_has_six_stretches(self, monkeypatch):
        lengths, made = self.divided(monkeypatch, 24, lambda *_: False)
        assert lengths == [4] * 6
        assert {s.degree for s in made} == {9, 11}  # a third of the rows, at most 11

    def test_the_degree_of_a_long_stretch_is_eleven(self, monkeypatch):
        _, made = self.divided(monkeypatch, 60, lambda coarse, finer: len(coarse.parts) == 6)
        assert {s.degree for s in made if len(s.blocks) == 10} == {11}

    def test_a_speed_has_one_degree_less_than_its_angle(self, monkeypatch):
        _, made = self.divided(monkeypatch, 60, lambda coarse, finer: len(coarse.parts) == 6, angle=False)
        assert {s.degree for s in made if len(s.blocks) == 10} == {10}

    def test_nuisance_functions_that_leave_no_rows_are_left_out(self, monkeypatch):
        made = []

        class Stretch:
            def __init__(self, run, part, nuisance, degree, *, angle):
                self.projected = np.zeros(0 if nuisance.shape[1] else 5)
                made.append((nuisance.shape[1], degree, angle))

        monkeypatch.setattr(process, "Stretch", Stretch)
        monkeypatch.setattr(process.StretchLikelihood, "of", lambda parts, _: SimpleNamespace(parts=parts))
        monkeypatch.setattr(process, "_process_noise", lambda found, times, typical: found)
        data = SimpleNamespace(lift=np.zeros((3, 7, 7)), samples=SimpleNamespace(time=np.array([0.0, 6.0])))
        (part,) = estimate_process_noise(data, np.ones((21, 4)), np.zeros((0, 0)), angle=True).parts
        assert made == [(4, 7, True), (0, 2, True)]
        assert len(part.projected) == 5

    def test_a_short_record_has_stretches_of_four_blocks(self, monkeypatch):
        assert self.divided(monkeypatch, 11, lambda *_: False)[0] == [6, 5]
        assert self.divided(monkeypatch, 3, lambda *_: False)[0] == [3]

    def test_stretches_are_merged_where_one_polynomial_describes_both(self, monkeypatch):
        """Up to 170 rows: 24 blocks of seven rows."""
        assert self.divided(monkeypatch, 24, lambda *_: True)[0] == [24]
        assert self.divided(monkeypatch, 26, lambda *_: True)[0] == [18, 8]
        few = lambda joint, finer: sum(len(p.stretch.blocks) for p in joint.parts) <= 8  # noqa: E731
        assert self.divided(monkeypatch, 24, few)[0] == [8, 8, 8]

    def test_a_motion_that_six_polynomials_do_not_follow_has_more(self, monkeypatch):
        """40 blocks: ten stretches of four, if six are not consistent with them."""
        six = lambda coarse, finer: len(coarse.parts) != 6 and False  # noqa: E731
        assert self.divided(monkeypatch, 40, six)[0] == [4] * 10
        same = lambda coarse, finer: len(coarse.parts) == 6  # noqa: E731
        assert self.divided(monkeypatch, 40, same)[0] == [7, 7, 7, 7, 6, 6]

    @pytest.mark.parametrize(("apart", "consistent"), [(5.9, True), (6.1, False)])
    def test_levels_within_six_of_the_best_are_consistent(self, apart, consistent):
        """The coarse stretches prefer another level than the fine ones."""
        levels = np.arange(121)

        class Given:
            def __init__(self, best, slope):
                self._best, self._slope = best, slope

            def unit(self, time):
                return 1.0

            def __call__(self, time, x):
                return -0.5 * self._slope * np.abs(levels - self._best)

            def _on_levels(self, times):
                return [levels], self(times[0], levels)[None]

        fine, coarse = Given(40, 6.1), Given(50, apart / 10)
        assert StretchLikelihood.is_consistent_with(coarse, fine, np.ones(1)) is consistent

    @pytest.mark.parametrize(
        ("blocks", "degrees"), [(28, [3] * 4 + [3, 3]), (48, [9] * 6), (7, [3]), (8, [3, 3])]
    )
    def test_polynomials_of_an_angle_noise_follow_slow_motion(self, monkeypatch, blocks, degrees):
        """At most six stretches; of eight blocks and more, one degree per block."""
        made = []
        monkeypatch.setattr(angle, "split_into_stretches", process.split_into_stretches)
        monkeypatch.setattr(
            process, "Stretch", lambda run, part, nuisance, degree: made.append((len(part), degree))
        )
        process.split_into_stretches(SimpleNamespace(lift=np.zeros((blocks, 7, 7))), None)
        assert [d for _, d in made] == degrees
        assert sum(n for n, _ in made) == blocks

    def test_one_noisy_stretch_of_three_has_a_separate_level(self):
        """The likelihood of each is a mixture: 95 % at the common level, 5 % at the mean over all levels."""
        values, quiet, loud = np.ones(4), np.full(4, 0.5), np.full(4, 1e3)

        class Part:
            def __init__(self, rows):
                self._rows = rows

            def spectrum(self, time):
                return self._rows, values, 1.0

        level = np.array([0.1])
        single = [process._log_likelihood(r, values, level)[0] for r in (quiet, quiet, loud)]
        two = StretchLikelihood([Part(quiet), Part(loud)])(1.0, level)[0]
        assert two == pytest.approx(single[0] + single[2])
        mean = [
            np.logaddexp.reduce(process._log_likelihood(r, values, process._LEVELS)) - math.log(121)
            for r in (quiet, quiet, loud)
        ]
        three = StretchLikelihood([Part(quiet), Part(quiet), Part(loud)])(1.0, level)[0]
        expected = sum(
            np.logaddexp(math.log(0.95) + s, math.log(0.05) + m) for s, m in zip(single, mean, strict=True)
        )
        assert three == pytest.approx(expected)

    @pytest.mark.parametrize("known", [True, False])
    def test_rows_are_whitened_by_correlated_angle_noise(self, monkeypatch, known):
        """The covariance beyond unit white noise."""
        data = run(blocks=4)
        root = 2.0 * np.eye(len(data.z)) if known else np.zeros((0, 0))
        seen = []
        monkeypatch.setattr(process, "_process_noise", lambda found, times, typical: found)
        original = StretchLikelihood.of.__func__

        def of(cls, stretches, covariance):
            seen.append(covariance)
            return original(cls, stretches, covariance)

        monkeypatch.setattr(StretchLikelihood, "of", classmethod(of))
        found = estimate_process_noise(data, np.zeros((len(data.z), 0)), root, angle=True)
        (part,) = found.parts
        size = len(part.stretch.projected)
        assert part.whitening == pytest.approx(np.eye(size) * (0.5 if known else 1.0))
        assert (seen[0] is None) is not known
        assert not known or seen[0] == pytest.approx(3.0 * np.eye(len(data.z)))


class TestProcessNoise:
    def posterior(self, monkeypatch, density, times, levels):
        monkeypatch.setattr(
            process, "_posterior", lambda likelihood, t, resolution, typical: (levels, density)
        )
        likelihood = SimpleNamespace(unit=lambda time: 1.0)
        return process._process_noise(likelihood, np.array(times), math.inf)

    def test_level_and_time_are_posterior_means(self, monkeypatch):
        levels = np.array([[1.0, 3.0], [2.0, 6.0]])
        density = np.array([[0.2, 0.3], [0.1, 0.4]])
        found = self.posterior(monkeypatch, density, [1.0, 4.0], levels)
        mean = 0.2 + 0.9 + 0.2 + 2.4
        assert found.level == pytest.approx(mean)
        assert found.level_u == pytest.approx(math.sqrt(0.2 + 0.3 * 9 + 0.1 * 4 + 0.4 * 36 - mean**2))
        assert found.time == pytest.approx(2.0)
        assert found.least == 1.0
        squares = np.array([1.0, 9.0, 16.0, 144.0]) / (mean**2 * 2.0)
        assert found.ratios @ found.weights == pytest.approx([0.2, 0.3, 0.1, 0.4] @ squares)

    def test_the_lowest_level_is_a_quantile(self, monkeypatch):
        levels = np.array([[5.0, 1.0, 3.0, 2.0]])
        density = np.array([[0.9981, 0.0005, 0.0009, 0.0005]])
        assert self.posterior(monkeypatch, density, [1.0], levels).least == 2.0

    @pytest.mark.parametrize(("share", "first", "last"), [(1e-3, 1.0, 8.0), (1e-5, 2.0, 8.0)])
    def test_a_narrow_posterior_is_refined(self, monkeypatch, share, first, last):
        """Times 1, 2, ... 128; the probable ones, and one beyond them on each side, are divided anew."""
        asked = []

        def posterior(likelihood, times, resolution, typical):
            asked.append((times, resolution))
            density = np.full((8, 1), 1e-9)
            if len(asked) == 1:
                density[2], density[1] = 1.0, share
            return np.ones((8, 1)), density / density.sum()

        monkeypatch.setattr(process, "_posterior", posterior)
        likelihood = SimpleNamespace(unit=lambda time: 3.0)
        process._process_noise(likelihood, 2.0 ** np.arange(8), math.inf)
        assert len(asked) == 2
        assert asked[1][0] == pytest.approx(np.geomspace(first, last, 8))
        # the resolution remains that of the shortest time: 2 T unit^2
        assert [r for _, r in asked] == [18.0, 18.0]

    def test_a_wide_posterior_is_not_refined(self, monkeypatch):
        asked = []

        def posterior(likelihood, times, resolution, typical):
            asked.append(times)
            return np.ones((8, 1)), np.full((8, 1), 1 / 8)

        monkeypatch.setattr(process, "_posterior", posterior)
        process._process_noise(SimpleNamespace(unit=lambda time: 1.0), 2.0 ** np.arange(8), math.inf)
        assert len(asked) == 1

    def test_the_least_mean_acceleration_is_that_of_the_noise(self):
        """Of a constant speed, twice the angle's uncertainty over the length of a part, per duration."""
        t = np.linspace(0.0, 20.0, 801)
        data = SimpleNamespace(samples=Samples(t, 5.0 * t, np.full(801, 0.03)), lift=np.zeros((8, 1, 1)))
        assert mean_acceleration(data) == pytest.approx(2 * 0.03 / 2.5 / 20.0)
        for count, parts in ((2, 4), (40, 12)):
            data.lift = np.zeros((count, 1, 1))
            data.samples = Samples(t, 5.0 * t + 0.5 * t**2, np.full(801, 1e-9))
            assert mean_acceleration(data) == pytest.approx((parts - 1) / parts, rel=0.02)


class TestAngleNoise:
    """The decisions of the estimate, with the gain of each kind of noise given."""

    def estimated(
        self, monkeypatch, gain, *, credible=True, turns=10.0, marginal=0.0, periodic=None, with_periodic=None
    ):
        """`gain` is that of the exponential noise at its best; 8 blocks of 2.5 s with some turns in each."""
        best = {0: gain, 1: gain if periodic is None else periodic}

        class Stretches(list):
            pass

        stretch = SimpleNamespace(
            projected=np.zeros(1), likelihood=lambda c: 0.0 if c is None else 0.5 * best[int(c[1, 1] > 0)],
            most_likely_level=lambda times: 1.0,
        )  # fmt: skip
        kinds = []
        asked = []
        stretch.most_likely_level = lambda times: asked.append(times) or 1.0

        def of(times, covariances, gain_of):
            kind = int(covariances[0][1, 1] > 0)
            kinds.append((kind, times))
            return angle._Kind(times, covariances, [angle._Peak(2.0, 0.1, best[kind])] * len(times))

        monkeypatch.setattr(angle, "split_into_stretches", lambda run, nuisance: [stretch])
        likelihood = SimpleNamespace(
            of=lambda stretches, c: SimpleNamespace(
                marginal=lambda times: marginal + (0.0 if c is None else 0.5 * best[int(c[1, 1] > 0)])
            )
        )
        monkeypatch.setattr(angle, "StretchLikelihood", likelihood)
        monkeypatch.setattr(angle, "mean_acceleration", lambda run: 2.0 if credible else 0.5)
        monkeypatch.setattr(angle, "_row_covariance_beyond_white", lambda run, t: np.diag([1.0, 0.0]))
        monkeypatch.setattr(
            angle, "_periodic_covariances", lambda run, times: [np.diag([0.0, 1.0])] * len(times)
        )
        monkeypatch.setattr(angle._Kind, "of", classmethod(lambda cls, *args: of(*args)))
        monkeypatch.setattr(angle, "_with_periodic_part", lambda *_: with_periodic)
        t = np.linspace(0.0, 20.0, 100)
        samples = Samples(t, 2 * np.pi * turns * t / 2.5, np.full(100, 1e-3))
        found = angle.estimate_angle_noise(SimpleNamespace(samples=samples, lift=np.zeros((8, 1, 1))), None)
        # correlation times of the process noise, in blocks of 2.5 s
        assert asked == [[0.25, 0.75, 2.5]]
        return found, kinds

    def test_the_uncertainty_of_a_level_is_that_of_a_log_normal_one(self, monkeypatch):
        """Two levels, a standard deviation of 0.1 below and above 2."""
        noise, _ = self.estimated(monkeypatch, 12.0)
        low, high = 2.0 * math.exp(-0.1), 2.0 * math.exp(0.1)
        assert noise.sigma == pytest.approx(math.sqrt((low**2 + high**2) / 2), rel=1e-6)
        assert noise.sigma_u == pytest.approx((high - low) / 2, rel=1e-6)
        assert noise.time == pytest.approx(2.5 * 2.0**-2, rel=1e-6)

    @pytest.mark.parametrize(("gain", "found"), [(8.1, True), (7.9, False)])
    def test_correlated_noise_needs_its_likelihood_ratio(self, monkeypatch, gain, found):
        noise, kinds = self.estimated(monkeypatch, gain)
        assert noise.is_white is not found
        assert noise.gain == pytest.approx(gain)
        assert noise.is_significant is found
        assert [k for k, _ in kinds] == [0]
        assert kinds[0][1] == pytest.approx(2.5 * 2.0 ** np.arange(-5, 2))
        if found:  # the square of a log-normal level of 2 with a relative uncertainty of 0.1
            assert noise.root[0, 0] ** 2 == pytest.approx(1 + 4.0 * math.exp(0.02), rel=1e-6)
            assert noise.root[1, 1] == pytest.approx(1.0)
            assert noise.sigma == pytest.approx(2.0, rel=0.02)

    @pytest.mark.parametrize(("gain", "searched"), [(1.9, False), (2.1, True)])
    def test_a_search_that_promises_nothing_ends_early(self, monkeypatch, gain, searched):
        noise, kinds = self.estimated(monkeypatch, gain)
        assert bool(kinds) is searched
        assert (noise.is_white, noise.gain) == (True, pytest.approx(gain))

    @pytest.mark.parametrize(("marginal", "found"), [(9.9, True), (10.1, False)])
    def test_an_incredible_process_noise_must_be_far_worse(self, monkeypatch, marginal, found):
        """Twice its logarithm less 8 is what angle noise needs: 12 for a gain of 12."""
        noise, _ = self.estimated(monkeypatch, 12.0, credible=False, marginal=marginal)
        assert noise.is_white is not found

    @pytest.mark.parametrize(("gain", "kept"), [(11.9, False), (12.1, True)])
    def test_a_noise_with_a_periodic_part_replaces_an_incredible_process_noise(self, monkeypatch, gain, kept):
        """That one would gain 20; angle noise needs 8 less."""
        both = angle.AngleNoise(sigma=1.0, turn_sigma=2.0, gain=gain)
        noise, _ = self.estimated(
            monkeypatch, 12.0, turns=1.0, credible=False, marginal=10.0, with_periodic=both
        )
        assert (noise is both) is kept

    @pytest.mark.parametrize(
        ("levels", "found"), [((1.0, 1.9), False), ((1.0, 2.1), True), ((2.1, 1.0), True)]
    )
    def test_process_noise_is_credible_below_the_mean_torque_in_all_stretches(
        self, monkeypatch, levels, found
    ):
        """Its likelihood is compared with a gain of 12: 20 with process noise, none without."""
        likelihood = lambda c: 0.0 if c is None else 6.0  # noqa: E731
        stretches = [
            SimpleNamespace(
                projected=np.zeros(1), likelihood=likelihood, most_likely_level=lambda times, x=x: x
            )
            for x in levels
        ]
        monkeypatch.setattr(angle, "split_into_stretches", lambda run, nuisance: stretches)
        monkeypatch.setattr(angle, "mean_acceleration", lambda run: 2.0)
        flat = SimpleNamespace(of=lambda stretches, c: SimpleNamespace(marginal=lambda times: 5.0))
        monkeypatch.setattr(angle, "StretchLikelihood", flat)
        monkeypatch.setattr(angle, "_row_covariance_beyond_white", lambda run, t: 4.0 * np.eye(2))
        t = np.linspace(0.0, 20.0, 100)
        samples = Samples(t, 900.0 * t, np.full(100, 1e-3))
        noise = angle.estimate_angle_noise(SimpleNamespace(samples=samples, lift=np.zeros((8, 1, 1))), None)
        # beside a process noise the angle noise gains nothing; without it, 12 from each of two stretches
        assert noise.gain == pytest.approx(24.0 if found else 0.0)

    @pytest.mark.parametrize(("turns", "periodic"), [(2.9, True), (3.1, False)])
    def test_errors_periodic_in_the_angle_are_tried_in_blocks_of_few_turns(
        self, monkeypatch, turns, periodic
    ):
        _, kinds = self.estimated(monkeypatch, 12.0, turns=turns)
        assert ([k for k, _ in kinds] == [0, 1]) is periodic
        if periodic:
            assert kinds[1][1] == pytest.approx(np.geomspace(2.5, 40.0, 5))

    def test_of_few_turns_both_kinds_are_needed_to_end_early(self, monkeypatch):
        noise, _ = self.estimated(monkeypatch, 1.0, turns=1.0, periodic=0.9)
        assert (noise.is_white, noise.gain) == (True, 1.0)
        noise, _ = self.estimated(monkeypatch, 9.0, turns=1.0, periodic=0.9)
        assert not noise.is_white

    @pytest.mark.parametrize(("gain", "kept"), [(8.1, True), (7.9, False)])
    def test_a_noise_with_a_periodic_part_needs_the_same(self, monkeypatch, gain, kept):
        both = angle.AngleNoise(sigma=1.0, turn_sigma=2.0, gain=gain)
        noise, _ = self.estimated(monkeypatch, 12.0, turns=1.0, with_periodic=both)
        assert (noise is both) is kept
        assert noise.gain == gain
        assert noise.is_white is not kept

    @pytest.mark.parametrize(
        ("gain", "sigma", "significant"), [(8.1, 1.0, True), (7.9, 1.0, False), (99.0, 0.0, False)]
    )
    def test_what_the_data_show(self, gain, sigma, significant):
        assert DEFAULT.correlated_noise == 8.0
        assert angle.AngleNoise(sigma=sigma, gain=gain).is_significant is significant

    def test_the_first_search_tries_three_levels(self, monkeypatch):
        """In units of the white noise of a row: 0.3 x 10^(3 k / 12) for k = 2, 5, 8."""
        tried = []
        stretch = SimpleNamespace(
            projected=np.zeros(1), most_likely_level=lambda times: 1.0,
            likelihood=lambda c: 0.0 if c is None else tried.append(math.sqrt(c[0, 0] / 4.0)) or 0.0,
        )  # fmt: skip
        monkeypatch.setattr(angle, "split_into_stretches", lambda run, nuisance: [stretch])
        monkeypatch.setattr(angle, "mean_acceleration", lambda run: 0.5)
        flat = SimpleNamespace(of=lambda stretches, c: SimpleNamespace(marginal=lambda times: 0.0))
        monkeypatch.setattr(angle, "StretchLikelihood", flat)
        monkeypatch.setattr(angle, "_row_covariance_beyond_white", lambda run, t: 4.0 * np.eye(2))
        t = np.linspace(0.0, 20.0, 100)
        samples = Samples(t, 900.0 * t, np.full(100, 1e-3))
        angle.estimate_angle_noise(SimpleNamespace(samples=samples, lift=np.zeros((8, 1, 1))), None)
        levels = 0.3 * 10 ** (3 * np.array([2, 5, 8]) / 12)
        assert tried == pytest.approx(np.tile(0.5 * levels, 7))


class TestWindowGroups:
    """Means of groups of samples of one window, orthogonal to a polynomial."""

    def groups(self):
        t = 5.0 + np.linspace(0.0, 1.0, 480)
        rng = np.random.default_rng(3)
        samples = Samples(t, 900.0 * t + 1e-3 * rng.standard_normal(480), np.full(480, 1e-3))
        window = SimpleNamespace(samples=samples, lift=np.zeros((1, 5, 5)))
        return t, angle._WindowGroups(window, np.zeros((480, 0)), 1e-9, 1.0)

    @pytest.mark.parametrize("time", [0.004, 0.05])
    def test_the_likelihood_is_that_of_averaged_noise(self, time):
        """The covariance of the means of groups of four samples by direct integration over each group."""
        _, found = self.groups()
        count, width = 120, 1.0 / 120
        assert found.width == pytest.approx(width, rel=1e-6)
        assert found.white == pytest.approx(np.full(count, 1e-6 / 4))
        inner = (np.arange(64) + 0.5) / 64 * width
        lag = np.abs(np.arange(count)[:, None] - np.arange(count)) * width
        kernel = np.zeros((count, count))
        for a in inner:
            for b in inner[::8] + 3.5 * (inner[1] - inner[0]):
                kernel += np.exp(-np.abs(lag + a - b) / time) / 512
        kernel = 0.5 * (kernel + kernel.T)
        complement, white = found._complement, found._whitening
        ratios = np.array([1e-8, 1e-6])
        rows, logs, squares = found.projected, [], []
        for ratio in ratios:
            v = np.eye(len(rows)) + ratio * white @ (complement.T @ kernel @ complement) @ white.T
            logs.append(np.linalg.slogdet(v)[1])
            squares.append(rows @ np.linalg.solve(v, rows))
        determinant, square = found.likelihood_terms(time, ratios)
        assert determinant == pytest.approx(logs, rel=0.01)
        assert square == pytest.approx(squares, rel=0.01)

    def test_the_process_noise_of_the_casing_is_whitened(self):
        """An acceleration of 0.5 rad/s2 over 0.1 s, beside a white noise of twice the stated uncertainty."""
        count, level, time = 6400, 0.5, 0.1
        t = np.linspace(0.0, 1.0, count)
        noise = 2e-3 * np.random.default_rng(4).standard_normal(count)
        window = SimpleNamespace(samples=Samples(t, noise, np.full(count, 1e-3)), lift=np.zeros((1, 5, 5)))
        found = angle._WindowGroups(window, np.zeros((count, 0)), level, time)
        grid = np.linspace(0.0, 1.0, 800)
        since = np.maximum(t.reshape(128, 50).mean(axis=1)[:, None] - grid, 0.0) * (grid[1] - grid[0])
        kernel = since @ (level**2 * np.exp(-np.abs(grid[:, None] - grid) / time)) @ since.T
        expected = found._complement.T @ kernel @ found._complement / 4.0
        whole = np.linalg.inv(found._whitening.T @ found._whitening) - np.eye(len(expected))
        assert np.abs(expected).max() > 0.5
        assert np.linalg.eigvalsh(whole)[-1] == pytest.approx(np.linalg.eigvalsh(expected)[-1], rel=0.15)
        assert whole == pytest.approx(expected, abs=0.15 * np.abs(expected).max())

    def test_a_motion_of_the_fifth_degree_leaves_nothing(self):
        t, _ = self.groups()
        motion = 900.0 * t + 3.0 * (t - 5.5) ** 5
        window = SimpleNamespace(samples=Samples(t, motion, np.full(480, 1e-3)), lift=np.zeros((1, 5, 5)))
        found = angle._WindowGroups(window, np.zeros((480, 0)), 1e-9, 1.0)
        assert np.abs(found.projected).max() < 1e-3
        assert len(found.projected) == 120 - 6


class TestGrid:
    @pytest.mark.parametrize(
        ("place", "width", "ends"),
        [(7, 1, (6, 8)), (0, 1, (0, 1)), (14, 1, (13, 14)), (4, 3, (3, 7)), (4, 6, (3, 10)), (4, 7, None)],
    )
    def test_times_are_refined_where_their_weight_is(self, monkeypatch, place, width, ends):
        """To those next to the ones with a ten thousandth of the largest weight, if these are less than half."""
        times, asked = np.geomspace(1.0, 100.0, 15), []

        def posterior(likelihood, times, resolution, typical):
            asked.append(times)
            density = np.full((15, 4), 1e-9)
            density[place] = 0.2
            density[place : place + width] = np.maximum(density[place : place + width], 0.2 * 2e-4)
            return np.tile(np.geomspace(1.0, 2.0, 4), (15, 1)), density / density.sum()

        monkeypatch.setattr(process, "_posterior", posterior)
        process._process_noise(SimpleNamespace(unit=lambda time: 1.0), times, 1.0)
        assert len(asked) == (1 if ends is None else 2)
        if ends is not None:
            assert asked[1] == pytest.approx(np.geomspace(times[ends[0]], times[ends[1]], 15))


@pytest.mark.parametrize(("pure", "level", "tested"), [(2.0, 3.0, 2.0), (2.0, 0.5, 0.5), (2.0, 0.0, 0.0)])
def test_residuals_are_tested_at_the_smaller_level(pure, level, tested):
    found = Noise(1.0, pure, 0.1, level, 1.0, Whitener(np.zeros((0, 0)), np.zeros(0)), None)
    assert found.tested == tested


@pytest.mark.parametrize(
    ("level", "excess", "needs"), [(1.6, 10.1, True), (1.4, 10.1, False), (1.6, 9.9, False)]
)
def test_fit_names_a_random_torque_beyond_the_recording(level, excess, needs):
    """The lowest level that the recording allows is 1 N m, and a level counts as raised from 1.5 N m on."""
    process = SimpleNamespace(level=4.0, least=2.0)
    noise = Noise(1.0, 2.0, 1.0, level, 1.0, Whitener(np.zeros((0, 0)), np.zeros(0)), process, excess)
    assert noise.least == 1.0
    found = SimpleNamespace(noise=(noise,), criteria=DEFAULT)
    assert Fit.needs_unestablished_torque(found) is needs


@pytest.mark.parametrize(("excess", "found"), [(2.8, True), (2.6, False)])
def test_a_level_needs_evidence(excess, found):
    """A row of response 1 and residual x has the excess x^2 - 1 - ln x^2 at its most likely level."""
    square = brentq(lambda s: s - 1 - math.log(s) - excess, 1.0, 50.0)
    level, measured = remaining_level(
        Whitener(np.eye(1), np.ones(1)), np.array([square**0.5]), np.zeros((1, 0))
    )
    assert measured == pytest.approx(excess, abs=0.05)
    assert (level > 0) is found


def test_a_limited_level_says_nothing_about_what_the_model_needs():
    found = Noise(1.0, 2.0, 0.1, 0.5, 1.0, Whitener(np.zeros((0, 0)), np.zeros(0)), None, limited=True)
    assert found.tested == 2.0
