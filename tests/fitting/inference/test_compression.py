"""Compression keeps differences of chi-square and the noise."""

from functools import cache

import numpy as np
import pytest
import twobody

from fitting import make_record
from fitting.inference import _compression
from fitting.inference._compression import (
    CASING_DEGREE,
    ROTOR_DEGREE,
    compress,
    independent_harmonics,
    responses_to_harmonics,
)
from fitting.inference._record import Samples

SIGMA = 1e-3


@pytest.fixture(scope="module")
def motion():
    return twobody.simulate()


@pytest.fixture(scope="module")
def record(motion):
    return make_record(**twobody.film(motion, seed=5))


@cache
def motion_of(key, share):
    return twobody.simulate({**twobody.PAPER, key: twobody.PAPER[key] * (1 + share)})


def full(samples, values):
    return float(np.sum(((samples.value - values) / samples.sigma) ** 2))


def reduced(compressed, values_at_nodes):
    """Return chi-square of the projected samples, in units of the sigma that came with them."""
    return compressed.scale**2 * float(np.sum((compressed.z - compressed.at_nodes(values_at_nodes)) ** 2))


# from a fraction of a standard error to a model that is plainly wrong
SHARES = [1e-5, 1e-3, 0.1]


@pytest.mark.parametrize("share", SHARES)
@pytest.mark.parametrize("body", [0, 1], ids=["rotor", "casing"])
@pytest.mark.parametrize("key", ["d", "b1"])
def test_compression_keeps_the_difference_of_two_models(motion, record, share, body, key):
    other = motion_of(key, share)
    samples = record.casing if body == 1 else record.rotor[1]
    degree = CASING_DEGREE if body == 1 else ROTOR_DEGREE
    compressed = compress(
        samples, degree=degree, angle=samples.value if body == 1 else None, blocks=60 if body == 1 else 1
    )
    shift = samples.value[0] - motion.at(samples.time, body)[0][0]

    def chi2(m):
        return (
            full(samples, shift + m.at(samples.time, body)[0]),
            reduced(compressed, shift + m.at(compressed.node_times, body)[0]),
        )

    (true_0, short_0), (true_1, short_1) = chi2(motion), chi2(other)
    expected, found = true_1 - true_0, short_1 - short_0
    assert abs(found - expected) < max(1e-3, 1e-4 * abs(expected))


def test_compression_keeps_a_few_hundred_rows(record):
    compressed = compress(record.casing, degree=CASING_DEGREE, angle=record.casing.value)
    assert len(record.casing) == 52_000
    blocks = len(compressed.lift)
    assert 60 < blocks <= 72
    assert (len(compressed.z), len(compressed.harmonic)) == (8 * blocks, 4 * blocks)


def test_blocks_are_short_where_the_casing_is_slow(record):
    """The response to a harmonic of the angle is proportional to 1 / omega^2: the speed of a block varies little."""
    compressed = compress(record.casing, degree=CASING_DEGREE, angle=record.casing.value)
    for where, _ in compressed.operators:
        t, psi = record.casing.time[where], record.casing.value[where]
        third = len(t) // 3
        begin = (psi[third] - psi[0]) / (t[third] - t[0])
        end = (psi[-1] - psi[-third - 1]) / (t[-1] - t[-third - 1])
        assert max(begin, end) / min(begin, end) < 2.0


def test_compressed_residuals_are_white_with_unit_variance(motion, record):
    compressed = compress(record.casing, degree=CASING_DEGREE, angle=record.casing.value)
    noise = compressed.z - compressed.at_nodes(motion.at(compressed.node_times, 1)[0])
    # 480 numbers: standard deviation 1 +- 0.032
    assert np.std(noise) == pytest.approx(1.0, abs=0.11)
    assert np.std(compressed.harmonic) == pytest.approx(1.0, abs=0.15)
    assert abs(np.mean(noise[1:] * noise[:-1])) < 0.16


def test_a_law_given_sample_by_sample_projects_like_one_given_at_the_nodes(motion, record):
    compressed = compress(record.casing, degree=CASING_DEGREE, angle=record.casing.value)
    at_samples = motion.at(record.casing.time, 1)[0][:, None]
    polynomial, harmonic = compressed.at_samples(at_samples)
    # the polynomials of seventh degree describe the motion within 2 % of a standard error of a row
    np.testing.assert_allclose(
        polynomial[:, 0], compressed.at_nodes(motion.at(compressed.node_times, 1)[0]), atol=2e-2
    )
    assert np.abs(harmonic).max() < 2e-2


def test_harmonics_of_the_angle_are_in_their_rows(motion, record):
    """An offset centre of 5e-3 rad shows in the harmonic rows with its whole weight."""
    compressed = compress(record.casing, degree=CASING_DEGREE, angle=record.casing.value)
    psi = record.casing.value
    wave = 5e-3 * np.sin(psi - 0.7)
    _, harmonic = compressed.at_samples(wave[:, None])
    weight = float(np.sum(harmonic**2)) * compressed.scale**2
    # rows that seem restless weigh a little less, even by chance: up to a quarter
    assert 0.75 < weight / float(np.sum((wave / SIGMA) ** 2)) < 1.02


def noisy(motion, noise, seed=0):
    t = np.arange(0, 200, 1 / 260)
    rng = np.random.default_rng(seed)
    return Samples(t, motion.at(t, 1)[0] + noise(rng, len(t)), np.full(len(t), SIGMA))


@pytest.mark.parametrize(("factor", "seed"), [(0.5, 0), (1.0, 1), (20.0, 2)])
def test_level_of_white_noise_is_found(motion, factor, seed):
    samples = noisy(motion, lambda rng, n: factor * SIGMA * rng.standard_normal(n), seed)
    compressed = compress(samples, degree=CASING_DEGREE, angle=samples.value)
    # 840 rows measure it: +- 2.4 % for Gaussian rows, a little more for the robust estimate
    assert compressed.scale == pytest.approx(factor, rel=0.09)
    assert compressed.n_effective == pytest.approx(len(samples), rel=0.15)
    assert compressed.rest / compressed.rest_dof == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(("noise", "scale"), [(0.0, 30e-10), (1e-9, 30e-10), (1e-7, 1e-7)])
def test_the_noise_of_a_computed_table_is_the_error_of_the_integration(noise, scale):
    """Angles up to 30 rad without noise differ from a model by rounding, which is no white noise."""
    t = np.arange(480) / 120
    angle = 48 * (1 - np.exp(-t / 4))
    angle *= 30 / angle.max()
    sigma, found = np.full(len(t), 1e-6), []
    for seed in range(8):  # the scale of one has a standard deviation of 9 %
        noisy = angle + noise * np.random.default_rng(seed).standard_normal(len(t))
        found.append(compress(Samples(t, noisy, sigma), degree=CASING_DEGREE, angle=noisy).scale)
    assert 1e-6 * np.mean(found) == pytest.approx(scale, rel=0.1)


# rho = 0.9 is slow enough to fall off within the rows that measure the noise: a fifth of it is missed
@pytest.mark.parametrize(("rho", "share", "seed"), [(0.5, 0.1, 0), (0.7, 0.1, 1), (0.9, 0.25, 2)])
def test_correlated_noise_reduces_the_effective_number_of_samples(motion, rho, share, seed):
    """AR(1) noise has (1 + rho) / (1 - rho) times its variance at the slow end, where models live."""

    def ar1(rng, n):
        kicks = SIGMA * np.sqrt(1 - rho**2) * rng.standard_normal(n)
        out, last = np.empty(n), SIGMA * rng.standard_normal()
        for i in range(n):
            last = rho * last + kicks[i]
            out[i] = last
        return out

    samples = noisy(motion, ar1, seed)
    compressed = compress(samples, degree=CASING_DEGREE, angle=samples.value)
    expected = (1 + rho) / (1 - rho)
    assert compressed.scale == pytest.approx(np.sqrt(expected), rel=share)
    assert 52_000 / compressed.n_effective == pytest.approx(expected, rel=2 * share)


def test_outliers_do_not_change_the_noise_level(motion):
    def noise(rng, n):
        white = SIGMA * rng.standard_normal(n)
        white[rng.integers(0, n, 5)] += 0.05
        return white

    samples = noisy(motion, noise)
    compressed = compress(samples, degree=CASING_DEGREE, angle=samples.value)
    assert compressed.scale < 1.6


def test_uneven_times_and_sigmas_are_respected(motion):
    """Lost frames and markers of different quality: the projection is by the actual times and weights."""
    rng = np.random.default_rng(8)
    t = np.arange(0, 200, 1 / 260)
    t = t[(rng.random(len(t)) > 0.2) & ~((t > 60) & (t < 63))]
    sigma = SIGMA * rng.uniform(0.5, 3, len(t))
    samples = Samples(t, motion.at(t, 1)[0] + sigma * rng.standard_normal(len(t)), sigma)
    compressed = compress(samples, degree=CASING_DEGREE, angle=samples.value)
    assert compressed.scale == pytest.approx(1.0, rel=0.09)
    other = twobody.simulate({**twobody.PAPER, "b2": twobody.PAPER["b2"] * 1.0003})
    expected = full(samples, other.at(t, 1)[0]) - full(samples, motion.at(t, 1)[0])
    nodes = compressed.node_times
    found = reduced(compressed, other.at(nodes, 1)[0]) - reduced(compressed, motion.at(nodes, 1)[0])
    assert found == pytest.approx(expected, rel=1e-4, abs=1e-3)


@pytest.mark.parametrize("n", [60, 61, 150, 700])
def test_short_runs_are_compressed_too(motion, n):
    t = np.arange(n) / 260
    rng = np.random.default_rng(n)
    samples = Samples(t, motion.at(t, 1)[0] + SIGMA * rng.standard_normal(n), np.full(n, SIGMA))
    compressed = compress(samples, degree=CASING_DEGREE, angle=samples.value)
    assert np.isfinite(compressed.z).all()
    assert 0.4 < compressed.scale < 2.2


def test_harmonics_that_are_nearly_polynomials_do_not_bias_the_noise():
    """A turn less 0.2 rad from frame to frame: the harmonics in the frames are those of a slow motion."""
    t = np.arange(600) / 30
    angle = (2 * np.pi * 30 - 7.0) * t
    variances = []
    for seed in range(30):
        noise = 3e-3 * np.random.default_rng(seed).standard_normal(len(t))
        samples = Samples(t, angle + noise, np.full(len(t), 3e-3))
        variances.append(compress(samples, degree=CASING_DEGREE, angle=samples.value).scale ** 2)
    assert np.mean(variances) == pytest.approx(1.0, abs=3 * np.std(variances) / np.sqrt(30))


@pytest.mark.parametrize(("share", "kept"), [(0.19, False), (0.21, True)])
def test_a_harmonic_needs_a_fifth_of_its_amplitude_beside_the_polynomials(share, kept):
    """Over whole turns the part of cos y orthogonal to sqrt(1 - s^2) cos y + s cos 5y has the amplitude s."""
    y = np.linspace(0.0, 6 * np.pi, 600, endpoint=False)
    alike = np.sqrt(1 - share**2) * np.cos(y) + share * np.cos(5 * y)
    found = independent_harmonics(y, np.stack([np.ones_like(y), alike], axis=1))
    waves = np.stack([kept * np.cos(y), np.sin(y), np.cos(2 * y), np.sin(2 * y)], axis=1)
    assert found == pytest.approx(waves)


@pytest.mark.parametrize("per_turn", [1, 2])
def test_errors_of_the_times_of_pulses_are_not_harmonics(per_turn):
    """The angle of a pulse is exact, so its harmonics are constant; those of a smooth angle would be the errors."""
    rng = np.random.default_rng(4)
    angle = 2 * np.pi * np.arange(600) / per_turn
    time = angle / 40.0
    scatter = 0.2 * (time[1] - time[0])
    samples = Samples(time + scatter * rng.standard_normal(600), angle, np.full(600, 40.0 * scatter))
    compressed = compress(samples, degree=CASING_DEGREE, angle=angle, blocks=4)
    chi2 = np.sum(compressed.harmonic**2) + compressed.rest
    # 2400 / 4 samples without 8 polynomials a block
    assert chi2 / compressed.rest_dof == pytest.approx(1, abs=0.3)


@pytest.mark.parametrize("turns", [0.0, 3e-3, 1.0, 40.0])
def test_responses_to_harmonics_of_a_steady_turn_are_known_integrals(turns):
    t = np.linspace(0.0, 2.0, 400)
    rate = 2 * np.pi * turns / 2.0
    speeds, angles = responses_to_harmonics(t, 0.3 + rate * t)
    for m in (1, 2):
        w = m * rate
        fine = np.linspace(0.0, 2.0, 400_001)
        wave = np.exp(1j * (m * 0.3 + w * fine))
        speed = np.concatenate([[0.0], np.cumsum(0.5 * (wave[1:] + wave[:-1]) * np.diff(fine))])
        angle = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(fine))])
        for k, part in enumerate((np.real, np.imag)):
            expected = np.interp(t, fine, part(speed))
            assert speeds[:, 2 * m - 2 + k] == pytest.approx(expected - expected.mean(), abs=1e-7)
            line = np.polynomial.Polynomial.fit(t, np.interp(t, fine, part(angle)), 1)
            assert angles[:, 2 * m - 2 + k] == pytest.approx(
                np.interp(t, fine, part(angle)) - line(t), abs=1e-7
            )


def test_responses_to_harmonics_need_no_memory_for_turns_between_samples():
    t = 1e6 * np.arange(300.0)
    speeds, angles = responses_to_harmonics(t, 10.0 * t)  # five hundred million turns
    assert speeds.shape == angles.shape == (300, 4)
    assert np.abs(speeds).max() < 1.0


@pytest.mark.parametrize("stretch", [1.0, 60.0, 1000.0, 0.02])
def test_blocks_are_cut_alike_at_every_time_scale(stretch):
    """A casing that starts at a twentieth of its largest speed: its blocks are divided where it is slow."""
    time = np.arange(0, 60, 1 / 60)
    angles = np.cumsum(160 * np.minimum(1, 0.05 + time / 10)) / 60
    edges = np.arange(0, len(time) + 1, 600)
    assert np.array_equal(
        _compression._cut_where_slow(stretch * time, angles, edges),
        _compression._cut_where_slow(time, angles, edges),
    )
    assert len(_compression._cut_where_slow(stretch * time, angles, edges)) > len(edges)


@pytest.mark.parametrize(("slowest", "cut"), [(0.0032, True), (0.0028, False)])
def test_a_record_that_comes_to_rest_is_not_cut(slowest, cut):
    """Speeds below 0.3 % of the largest count as rest."""
    speed = np.geomspace(1.0, slowest, 40)
    angles = np.concatenate([[0.0], np.cumsum(np.repeat(speed, 60))])[:-1]
    edges = np.array([0, 1200, len(angles)])
    found = _compression._cut_where_slow(np.arange(len(angles)) * 1.0, angles, edges)
    assert (len(found) > len(edges)) is cut


@pytest.mark.parametrize("bins", [1, 5, 40])
def test_samples_of_a_block_are_summed_in_groups_of_equal_number(bins):
    t = np.arange(200) ** 1.1 / 100
    run = compress(Samples(t, 3.0 * t, np.full(200, SIGMA)), degree=3, angle=None, blocks=1)
    ((where, operator),) = run.operators
    ((middle, grouped),) = run.operators_of_bins(bins)
    assert middle == pytest.approx(t[where].reshape(bins, -1).mean(axis=1))
    expected = operator[: run.lift.shape[1]].reshape(-1, bins, 200 // bins).sum(axis=2)
    assert grouped == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize(("first", "skipped"), [(None, 0), (4, 0), (5, 1), (7, 3), (2, 0)])
def test_noise_rows_begin_at_the_given_power(monkeypatch, first, skipped):
    """After a cubic, the next power is the fourth."""
    asked = []

    class EndError(Exception):
        pass

    def block(samples, where, degree, noise_rows, skip, *_):
        asked.append((degree, noise_rows, skip))
        raise EndError

    monkeypatch.setattr(_compression, "_block", block)
    t = np.arange(400) / 100.0
    with pytest.raises(EndError):
        compress(Samples(t, t, np.full(400, 1e-3)), degree=3, noise_rows=2, first_noise_row=first)
    assert asked == [(3, 2, skipped)]
