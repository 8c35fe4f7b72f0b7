"""Zeros of the templates of a texture, from the angles of the markers, and which of both angles is used."""

from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack.tracking import _body_angles
from gyrotrack.tracking import _template_zeros as module
from gyrotrack.tracking._template_zeros import change_of_harmonics, scatter_of_templates, template_zeros
from gyrotrack.tracking._texture import TextureObservations

BATCH, COUNT = 512, 30
N = BATCH * COUNT
TEMPLATE = np.repeat(np.arange(COUNT), BATCH)
ANGLE = 0.4 * np.arange(N)
SIGMA = 1.5e-3  # of a frame; its mean over a batch has 0.07 mrad


def noise(seed=0):
    return SIGMA * np.random.default_rng(seed).standard_normal(N)


def zeros(off, *angles, template=TEMPLATE):
    found = template_zeros(off, template, angles or (ANGLE,))
    return found.zero[::BATCH], float(np.sqrt(np.mean(found.uncertainty**2)))


def steps(size, seed=1):
    return np.cumsum(size * np.random.default_rng(seed).standard_normal(COUNT))


def test_a_step_between_two_templates_is_followed_at_once():
    true = np.where(np.arange(COUNT) < 11, 0.0, 3e-3)
    found, _ = zeros(true[TEMPLATE] + noise())
    assert np.abs(found - true).max() < 0.5e-3


@pytest.mark.slow
def test_the_uncertainty_is_the_error():
    z = []
    for seed in range(20):
        true = steps(0.2e-3, seed)
        found, u = zeros(true[TEMPLATE] + noise(100 + seed))
        z.append(np.sqrt(np.mean((found - true) ** 2)) / u)
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.15)


def test_equal_zeros_are_averaged():
    """30 batches determine one zero to 0.07 mrad / sqrt(30); as many zeros would have 0.07 mrad each."""
    found, u = zeros(noise())
    assert np.ptp(found) < 0.05e-3
    assert abs(found.mean()) < 0.05e-3
    assert u < 0.035e-3


@pytest.mark.slow
def test_a_zero_is_less_certain_where_few_frames_determine_it():
    """Of the first batch every tenth frame is known; speeds change there, and the zeros with them."""
    rate = np.where(TEMPLATE < 6, 0.1 * (1 + TEMPLATE), 0.7)
    angle, z = np.cumsum(rate), []
    for seed in range(8):
        true = np.concatenate(
            [np.cumsum(np.random.default_rng(seed).normal(0, 1e-3, 7)), np.zeros(COUNT - 7)]
        )
        true[7:] = true[6]
        off = true[TEMPLATE] + noise(seed)
        off[:BATCH][np.arange(BATCH) % 10 > 0] = np.nan
        found = template_zeros(off, TEMPLATE, (angle,))
        u = found.uncertainty[::BATCH]
        assert u[0] > 2 * u[20]
        assert np.ptp(found.uncertainty[:BATCH]) == 0.0
        z.append((found.zero[BATCH // 2] - true[0]) / u[0])
    assert np.std(z) == pytest.approx(1.0, abs=0.3)


def beside_a_neighbour(amplitude, order=3):
    """Return angles beside another body, in step with the frames in batches 12 to 14, and the error they cause."""
    rate = np.where((TEMPLATE >= 12) & (TEMPLATE < 15), 2 * np.pi / order, 1.234 + 0.001 * TEMPLATE)
    relative = 0.3 + np.cumsum(rate)
    return relative, amplitude * np.cos(order * (relative - relative[13 * BATCH]))


def test_a_neighbour_in_step_with_the_frames_is_not_followed():
    """The error of 3 mrad is constant for 1,500 frames; where it is known by what it does elsewhere, it is no zero."""
    relative, error = beside_a_neighbour(3e-3)
    off = error + noise()
    assert np.abs(zeros(off, ANGLE, relative)[0]).max() < 0.4e-3
    assert np.abs(zeros(off, ANGLE)[0]).max() > 1.5e-3


def test_the_amplitude_of_a_harmonic_is_that_of_batches_in_which_it_averages_out():
    """In 12 of 30 batches the third harmonic is constant; it is measured in the others."""
    rate = np.where(TEMPLATE < 12, 2 * np.pi / 3, 1.234 + 0.001 * TEMPLATE)
    angle = np.cumsum(rate)
    off = 4e-3 * np.cos(3 * angle + 0.4) + noise()
    off[TEMPLATE < 12] += 0.02 * np.sin(np.arange(12 * BATCH) / 50)
    batches = list(np.arange(N).reshape(COUNT, BATCH))
    white = np.full(COUNT, SIGMA**2 / BATCH)
    found = module._squared_amplitudes(off[12 * BATCH :], angle[12 * BATCH :], batches[:18], white[:18])
    assert found[2] == pytest.approx(4e-3**2, rel=0.05)
    assert np.delete(found, 2).max() < 0.2 * 4e-3**2  # some orders are in step with the third one
    assert module._squared_amplitudes(off, angle, batches, white)[2] == pytest.approx(found[2], rel=0.05)
    left = np.array([module._squared_resultants(angle, each) for each in batches])
    assert left[:12, 2] == pytest.approx(1.0)
    assert left[12:, 2].max() < 0.01
    assert left[:, 0].max() < 0.01


def test_a_harmonic_in_step_adds_half_its_squared_amplitude_to_the_variance_of_a_mean(monkeypatch):
    given = []

    def smoothed(mean, variance, gaps, change, common):
        given.append(variance)
        return mean, variance, 0.0

    monkeypatch.setattr(module, "_smoothed", smoothed)
    relative, error = beside_a_neighbour(3e-3)
    template_zeros(error + noise(), TEMPLATE, (ANGLE, relative))
    (variance,) = given
    assert variance[12:15] == pytest.approx(0.5 * 3e-3**2, rel=0.1)
    assert np.delete(variance, [12, 13, 14]).max() < 0.02 * 3e-3**2


@pytest.mark.parametrize(("mean", "used"), [(0.19, True), (0.21, False)])
def test_a_harmonic_averages_out_below_a_mean_of_a_fifth(mean, used):
    """The mean of exp(i a) is `mean` if this share of the frames has one angle, and the others are uniform."""
    n = 1000
    turning = round((1.0 - mean) * n)
    angle = np.append(2 * np.pi * np.arange(turning) / turning, np.zeros(n - turning))
    off = 1e-3 * np.cos(angle)
    found = module._squared_amplitudes(off, angle, [np.arange(n)], np.zeros(1))
    assert bool(found[0] > 0) is used


def test_the_amplitude_of_white_noise_is_zero():
    """Its expected square, 4 s^2 / n, is subtracted."""
    angle = np.cumsum(np.full(N, 1.234))
    batches = list(np.arange(N).reshape(COUNT, BATCH))
    off = noise(4)
    raw, found = (
        module._squared_amplitudes(off, angle, batches, np.full(COUNT, share * SIGMA**2 / BATCH))
        for share in (0.0, 1.0)
    )
    assert raw.mean() == pytest.approx(4 * SIGMA**2 / BATCH, rel=0.2)
    assert found.mean() < 0.2 * raw.mean()


def test_the_slope_in_a_batch_is_its_posterior_mean_beside_harmonics(monkeypatch):
    """Compared with the covariance of the differences, in which the constant has a very large variance."""
    rng = np.random.default_rng(3)
    n, per_speed = 200, 0.02
    speed = 0.3 + 0.2 * np.arange(n) / n
    angle, relative = np.cumsum(speed), np.cumsum(2 * np.pi / 3 + 0.1 * (speed - 0.45))
    squares = np.zeros((2, 12))
    squares[0, 0], squares[1, 2] = 1e-3**2, 3e-3**2
    off = 5e-3 + 0.01 * speed + 3e-3 * np.cos(3 * relative) + 1e-3 * rng.standard_normal(n)
    frames = np.delete(np.arange(n), [7, 90])
    found, _ = module._within(off, [angle, relative], list(squares), frames, slice(0, n), per_speed)
    apart = speed[frames] - speed[frames].mean()
    covariance = off[frames].var() * np.eye(len(frames)) + 1.0 + per_speed**2 * np.outer(apart, apart)
    for turn, order, square in ((angle[frames], 1, 1e-3**2), (relative[frames], 3, 3e-3**2)):
        covariance += 0.5 * square * np.cos(order * (turn[:, None] - turn))
    weight = np.linalg.solve(covariance, apart)
    slope = per_speed**2 * weight @ off[frames]
    left = per_speed**2 - per_speed**4 * weight @ apart
    assert found == pytest.approx(slope * (speed - speed[frames].mean()), rel=1e-4, abs=1e-9)
    monkeypatch.setattr(module, "_slow_variance", lambda rest: 0.0)
    _, variance = module._within(off, [angle, relative], list(squares), frames, slice(0, n), per_speed)
    assert variance == pytest.approx(left * np.mean(apart**2), rel=1e-4)
    plain, less = module._within(off, [angle], [np.zeros(12)], frames, slice(0, n), per_speed)
    assert abs(np.ptp(found) / np.ptp(speed) - 0.01) < 0.5 * abs(np.ptp(plain) / np.ptp(speed) - 0.01)
    assert less < variance


def test_frames_in_which_the_other_body_is_unknown_have_no_harmonic():
    """Otherwise its cosine would be a step between these frames and the others, like a slope."""
    n = 200
    speed = 0.3 + 0.2 * np.arange(n) / n
    angle, relative = np.cumsum(speed), np.full(n, np.nan)
    relative[:100] = 2.0 * np.arange(100)
    squares = np.zeros(12)
    squares[0] = 0.1**2
    off = 0.01 * speed + 1e-4 * np.random.default_rng(4).standard_normal(n)
    known, unknown = (
        module._within(off, [angle, each], [np.zeros(12), squares], np.arange(n), slice(0, n), 0.1)[1]
        for each in (np.full(n, np.nan), relative)
    )
    assert unknown == pytest.approx(known, rel=0.3)


def test_passages_in_step_at_the_end_of_a_batch_do_not_tilt_its_zero():
    """The markers err by 4 mrad in the last fifth of the first batch, in which the body speeds up."""
    speed = 0.4 - 0.3 * np.exp(-np.arange(N) / 1500)
    true = 0.005 * (speed - speed.mean())
    rate = 2.0 + 0.0005 * (np.arange(N) - 460.0)
    rate = np.where(np.arange(N) < 3 * BATCH, 2 * np.pi / 3 + rate - 2.0, 1.234)
    relative = np.cumsum(rate)
    off = true + 4e-3 * np.cos(3 * (relative - relative[460])) + noise(6)
    angle = np.cumsum(speed)
    first = slice(0, BATCH)
    errors = []
    for angles in ([angle, relative], [angle]):
        error = template_zeros(off, TEMPLATE, angles).zero[first] - true[first]
        errors.append(float(np.ptp(error)))
    assert errors[0] < 0.6 * errors[1]


class TestSlowDifferences:
    """The differences of a batch vary slowly, with 1 mrad rms, besides white noise of 1 mrad."""

    N = 512

    def within(self, slow, per_speed):
        """Return the variance of the zero [rad^2], and the variance of the speeds [(rad per frame)^2]."""
        speed = 0.3 + 0.2 * np.arange(self.N) / self.N
        rng = np.random.default_rng(5)
        wave = np.sqrt(2.0) * slow * np.sin(2 * np.pi * 3 * np.arange(self.N) / self.N)
        off = wave + 1e-3 * rng.standard_normal(self.N)
        _, variance = module._within(
            off, [np.cumsum(speed)], [np.zeros(12)], np.arange(self.N), slice(0, self.N), per_speed
        )
        return variance, float(speed.var())

    def test_their_variance_is_part_of_that_of_the_zero(self):
        """The means of 32 frames have 0.96 of the variance of a wave of 171 frames."""
        quiet, _ = self.within(0.0, 1.0)
        found, _ = self.within(1e-3, 1.0)
        assert found - quiet == pytest.approx(0.9e-6, rel=0.15)

    def test_they_are_attributed_to_the_zero_up_to_its_change_with_the_speed(self):
        """With 5 mrad per (rad per frame), the zero changes by 0.29 mrad rms."""
        found, spread = self.within(1e-3, 5e-3)
        assert spread * 5e-3**2 == pytest.approx(0.29e-3**2, rel=0.02)
        assert spread * 5e-3**2 < found < 1.5 * spread * 5e-3**2

    @pytest.mark.parametrize("slow", [0.0, 0.5e-3])
    def test_white_noise_has_no_slow_variance(self, slow):
        """A constant in each 32 frames remains, white noise is subtracted, and a last incomplete mean is not used."""
        rng = np.random.default_rng(7)
        level = slow * np.resize([1.0, -1.0], 400)
        found = module._slow_variance(
            np.append(np.repeat(level, 32) + 1e-3 * rng.standard_normal(12800), [1.0] * 31)
        )
        assert found == pytest.approx(slow**2, abs=1e-8)

    def test_less_than_white_noise_is_none(self):
        """Residuals of alternating sign have means of zero."""
        assert module._slow_variance(np.resize([1.0, -1.0], 320)) == 0.0


def test_the_uncertainty_of_a_zero_includes_that_of_its_slope(monkeypatch):
    speed = 0.4 - 0.3 * np.exp(-np.arange(N) / 1500)
    off = 0.03 * speed + noise(5)
    angle = np.cumsum(speed)
    found = {}
    for variance in (0.0, 4e-8):
        monkeypatch.setattr(
            module,
            "_within",
            lambda off, angles, squares, frames, batch, per_speed, v=variance: (
                np.zeros(batch.stop - batch.start),
                v,
            ),
        )
        found[variance] = template_zeros(off, TEMPLATE, [angle]).uncertainty
    assert found[4e-8] ** 2 - found[0.0] ** 2 == pytest.approx(4e-8)


def test_zeros_and_variances_are_those_of_the_whole_linear_model(monkeypatch):
    """Steps w ~ (q^2 gap + p^2 change) and means with variances r: the inverse of the sum of both informations."""
    rng = np.random.default_rng(2)
    mean, variance = rng.normal(0, 1e-3, 7), rng.uniform(0.5, 2.0, 7) * 1e-8
    gaps, change = np.array([1.0, 1.0, 2.0, 1.0, 3.0, 1.0]), rng.uniform(0.1, 2.0, 6)
    monkeypatch.setattr(module, "_STEPS", np.array([1.5]))
    unit = np.sqrt(np.median(variance))
    step = (1.5 * unit) ** 2 * (gaps + change / change.mean())
    r = variance + (0.7 * unit) ** 2
    difference = np.diff(np.eye(7), axis=0)
    covariance = np.linalg.inv(np.diag(1 / r) + difference.T @ np.diag(1 / step) @ difference)
    zero, left, per_speed = module._smoothed(mean, variance, gaps, change, np.array([0.7]))
    assert zero == pytest.approx(covariance @ (mean / r), rel=1e-9)
    assert left == pytest.approx(np.diag(covariance), rel=1e-9)
    assert per_speed == pytest.approx(1.5 * unit / np.sqrt(change.mean()))


def test_a_neighbour_that_is_not_measured_elsewhere_is_not_a_reason_to_doubt():
    relative, _ = beside_a_neighbour(0.0)
    true = np.where((np.arange(COUNT) >= 12) & (np.arange(COUNT) < 15), 3e-3, 0.0)
    found, _ = zeros(true[TEMPLATE] + noise(), ANGLE, relative)
    assert np.abs(found - true).max() < 0.3e-3


@pytest.mark.parametrize(("change", "followed"), [(0.03, True), (0.003, False)])
def test_a_change_of_speed_moves_a_zero(change, followed):
    """In 5 of 30 batches the speed changes, and the zeros with it by 1 mrad: they are followed at these places alone.

    The noise of a batch is as large as the step; without the speeds it would be smoothed away.
    """
    places = np.array([4, 9, 14, 19, 24])
    sense = np.array([1.0, -1.0, 1.0, 1.0, -1.0])
    speeds = 0.4 + 0.4 * change * np.sqrt(COUNT / 5) * np.cumsum(np.bincount(places, sense, COUNT))
    true = 1e-3 * np.cumsum(np.bincount(places, sense, COUNT))
    noisy = 6.0 * noise(3)  # 0.4 mrad in the mean of a batch
    found, _ = zeros(true[TEMPLATE] + noisy, np.cumsum(speeds[TEMPLATE]))
    error = np.sqrt(np.mean((found - true) ** 2))
    assert (error < 0.22e-3) == followed


def test_within_a_batch_the_zero_follows_the_speed():
    """The zero changes by 30 mrad per (rad per frame) while the body speeds up: by 2 mrad within the first batch."""
    speed = 0.4 - 0.3 * np.exp(-np.arange(N) / 1500)
    true = 0.03 * speed
    off = true - true.mean() + noise(5)
    found = template_zeros(off, TEMPLATE, [np.cumsum(speed)]).zero
    error = found - (true - true.mean())
    assert np.ptp(true[:BATCH]) > 2e-3
    assert np.abs(error[:BATCH]).max() < 0.5e-3
    assert np.sqrt(np.mean(error**2)) < 0.12e-3


def test_within_a_batch_of_a_steady_body_the_zero_is_constant():
    found = template_zeros(steps(0.3e-3)[TEMPLATE] + noise(), TEMPLATE, [ANGLE]).zero
    assert np.ptp(found.reshape(COUNT, BATCH), axis=1).max() == 0.0


def test_outliers_and_missing_frames_do_not_count():
    off = steps(0.3e-3)[TEMPLATE] + noise()
    expected, _ = zeros(off)
    off[::50] += 0.2
    off[5 * BATCH : 6 * BATCH - 20] = np.nan  # a batch of 20 frames is too short to be used
    found, _ = zeros(off)
    others = np.arange(COUNT) != 5
    assert np.abs(found - expected)[others].max() < 0.1e-3
    assert found[5] == pytest.approx(0.5 * (found[4] + found[6]))


@pytest.mark.parametrize(("count", "constant"), [(4, True), (5, False)])
def test_few_templates_have_one_zero(count, constant):
    n = count * BATCH
    found = template_zeros((np.arange(count) * 2e-3)[TEMPLATE[:n]] + noise()[:n], TEMPLATE[:n], [ANGLE[:n]])
    assert (np.ptp(found.zero) == 0.0) == constant
    assert (not found.uncertainty.any()) == constant
    assert len(found.uncertainty) == n


def test_the_scatter_is_that_of_the_templates():
    rng = np.random.default_rng(1)
    template = np.repeat(np.arange(200), 8)
    off = (2e-4 * rng.standard_normal(200))[template]
    off[::9] = np.nan
    assert scatter_of_templates(off, template) == pytest.approx(2e-4, rel=0.25)
    assert scatter_of_templates(off[: 4 * 8], template[: 4 * 8]) == 0.0
    assert scatter_of_templates(off[: 5 * 8], template[: 5 * 8]) > 0.0


def test_frames_with_the_same_moments_have_one_template():
    column = np.ones(7)
    angle = np.array([np.nan, 0.0, 0.1, np.nan, 0.2, 0.3, 0.4])
    moment = np.array([0.0, 1.0, 1.0, 0.0, 1.0, 2.0, 2.0])
    seen = TextureObservations(
        angle,
        column,
        column,
        column,
        np.zeros((7, 2)),
        np.stack([moment, 0 * moment], 1),
        np.zeros((7, 2)),
        np.zeros(7),
    )
    assert seen.template.tolist() == [0, 0, 0, 0, 0, 1, 1]


def angles(sigma, error=0.0, seed=0):
    noise = sigma * np.random.default_rng(seed).standard_normal(N)
    return SimpleNamespace(angle=noise + error, sigma=np.full(N, sigma))


# a neighbour that passes once in 130 frames, in step with the frames: 0.5 s at 260 fps
BESIDE = 1e-3 * np.sin(2 * np.pi * np.arange(N) / 130)


@pytest.mark.parametrize(
    ("ring", "error", "better"),
    [
        (0.97e-3, 0.0, True),  # less noise, and no error beside a neighbour
        (1.15e-3, 0.0, False),
        (1.7e-3, BESIDE, True),  # an average of 26 frames errs by 0.3 mrad for 0.7 mrad
        (1.7e-3, 0.2 * BESIDE, False),  # 0.3 mrad for 0.24 mrad
        (2.1e-3, BESIDE, False),  # more than twice the noise
    ],
)
def test_the_angle_whose_averages_err_less_is_used(ring, error, better):
    assert _body_angles._averages_better(angles(ring, seed=1), angles(1e-3, error), 260.0) == better


def test_a_ring_without_angles_is_not_used():
    none = SimpleNamespace(angle=np.full(N, np.nan), sigma=np.full(N, 1e-6))
    assert not _body_angles._averages_better(none, angles(1e-3), 260.0)


@pytest.mark.parametrize(("size", "kept"), [(4.9, True), (5.1, False), (-5.1, False)])
def test_outliers_of_a_batch_are_beyond_five_robust_standard_deviations(size, kept):
    off = np.append(np.tile([-1.0, 0.0, 1.0], 33), size * 1.4826)
    found = module._without_outliers(off, np.arange(100))
    assert (99 in found) is kept
    assert len(found) == 99 + kept


class TestHarmonicsOfTemplates:
    """Errors of a texture with one or two periods per turn, beside markers with white noise of 1.5 mrad."""

    def changed(self, size, order=1, relative=(), error=0.0):
        """Return the correction and the error of the texture, which has an amplitude `size` in each template."""
        wrong = size[TEMPLATE] * np.cos(order * ANGLE + 0.7)
        return change_of_harmonics(noise(3) + error - wrong, TEMPLATE, [ANGLE, *relative])[0], wrong

    @pytest.mark.parametrize("order", [1, 2])
    def test_jumps_of_the_error_are_removed(self, order):
        size = 1.5e-3 * np.random.default_rng(4).standard_normal(COUNT)
        found, wrong = self.changed(size - size.mean(), order)
        left = found + wrong
        left -= 2 * np.mean(left * np.exp(-1j * order * ANGLE)).real * np.cos(order * ANGLE)
        assert left.std() < 0.15e-3
        assert wrong.std() > 0.7e-3

    def test_the_uncertainty_is_the_error_of_the_coefficients(self):
        """Independent templates: 1.5 mrad sqrt(2 / 512) = 0.094 mrad each; equal templates: less by sqrt(30)."""
        size = 1.5e-3 * np.random.default_rng(4).standard_normal(COUNT)
        off = noise(3) - size[TEMPLATE] * (
            np.cos(ANGLE) + np.sin(ANGLE) + np.cos(2 * ANGLE) + np.sin(2 * ANGLE)
        )
        _, sigma = change_of_harmonics(off, TEMPLATE, [ANGLE])
        assert sigma == pytest.approx(1.5e-3 * np.sqrt(2 / BATCH), rel=0.3)
        _, less = change_of_harmonics(noise(3), TEMPLATE, [ANGLE])
        assert less == pytest.approx(1.5e-3 * np.sqrt(2 / N), rel=0.7)

    @pytest.mark.parametrize(("order", "size"), [(1, 2e-3), (2, 2e-3), (3, None)])
    def test_what_templates_have_in_common_stays(self, order, size):
        """A constant error may be that of the markers; the view has no third order."""
        each = np.full(COUNT, size) if size else 2e-3 * np.random.default_rng(5).standard_normal(COUNT)
        found, _ = self.changed(each, order)
        assert found.std() < 0.06e-3

    def test_markers_in_step_do_not_change_a_template(self):
        """In batches 12 to 14, the third harmonic beside another body is in step with the first one of the body."""
        rate = np.where((TEMPLATE >= 12) & (TEMPLATE < 15), (0.4 + 2 * np.pi) / 3, 1.234 + 0.001 * TEMPLATE)
        relative = np.cumsum(rate)
        found, _ = self.changed(np.zeros(COUNT), relative=[relative], error=3e-3 * np.cos(3 * relative))
        alone, _ = self.changed(np.zeros(COUNT), error=3e-3 * np.cos(3 * relative))
        assert found.std() < 0.15e-3
        assert alone.std() > 0.5e-3

    def test_four_templates_are_too_few(self):
        off, use = noise() + 2e-3 * np.cos(ANGLE) * (TEMPLATE == 2), TEMPLATE < 4
        found, sigma = change_of_harmonics(off[use], TEMPLATE[use], [ANGLE[use]])
        assert not found.any()
        assert sigma == 0.0
        use = TEMPLATE < 5
        assert change_of_harmonics(off[use], TEMPLATE[use], [ANGLE[use]])[0].any()

    def test_a_body_at_rest_has_no_harmonics(self):
        found, _ = change_of_harmonics(noise(), TEMPLATE, [np.full(N, 0.3)])
        assert np.abs(found).max() < 1e-3
        assert not change_of_harmonics(np.zeros(N), TEMPLATE, [np.full(N, 0.3)])[0].any()

    def test_a_coefficient_is_that_of_least_squares(self):
        angle = np.linspace(0.0, 9.0, 200)
        basis = np.stack([angle**0, *(f(k * angle) for k in (1, 2) for f in (np.cos, np.sin))], axis=1)
        off = basis @ [0.1e-3, 1e-3, -2e-3, 0.5e-3, 3e-3] + 1e-4 * np.random.default_rng(6).standard_normal(
            200
        )
        value, variance = module._coefficients(off, [angle], [np.zeros(12)], np.arange(200))
        assert value == pytest.approx(np.linalg.lstsq(basis, off, rcond=None)[0][1:], rel=1e-3)
        assert variance == pytest.approx(1e-8 * np.diag(np.linalg.inv(basis.T @ basis))[1:], rel=0.25)
