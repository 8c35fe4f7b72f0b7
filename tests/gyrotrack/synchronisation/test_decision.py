"""Clips are found where they were cut out, with an error that is what is claimed."""

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter

from gyrotrack import SyncError
from gyrotrack.synchronisation._decision import match_clips
from gyrotrack.synchronisation._matching import Curve

STARTS = (3.2, 44.1, 100.3)


def match(casing, clips, cameras=None):
    return match_clips(casing, clips, [f"clip{k}" for k in range(len(clips))], cameras or [0] * len(clips))


def pulls(matches, starts):
    return [(m.start.offset - t) / m.offset_sigma for m, t in zip(matches, starts, strict=True)]


@pytest.mark.slow
def test_three_clips_of_one_camera(motion, make_run):
    run = make_run(motion, np.random.default_rng(1))
    matches = match(run.casing(), run.clips(STARTS))
    for found, start in zip(matches, STARTS, strict=True):
        assert abs(found.start.offset - start) < 5 * found.offset_sigma
        assert abs(found.start.offset - start) < 3e-3 or found.ambiguous
        assert abs(found.start.eps - 2e-5) < 5 * found.rate_sigma
        assert found.common_rate
    assert matches[0].offset_sigma < 1e-4
    assert matches[2].offset_sigma < 2e-3


def test_the_covariance_is_that_of_the_uncertainties_and_ties_start_to_direction(motion, make_run):
    run = make_run(motion, np.random.default_rng(2), 30.0)
    for found in match(run.casing(), run.clips([5.0, 20.0])):
        c = found.covariance
        np.testing.assert_allclose(c, c.T, rtol=1e-6, atol=1e-18)
        assert (np.linalg.eigvalsh(c / np.sqrt(np.outer(np.diag(c), np.diag(c)))) > -1e-9).all()
        wanted = [found.offset_sigma, found.rate_sigma, found.angle_sigma]
        np.testing.assert_allclose(np.sqrt(np.diag(c)), wanted)
        assert abs(c[0, 2]) > 0.5 * np.sqrt(c[0, 0] * c[2, 2])


def test_the_angle_offset_is_the_camera_s_direction(motion, make_run):
    run = make_run(motion, np.random.default_rng(2), 20.0)
    (found,) = match(run.casing(), run.clips([5.0], offset=1.0))
    difference = (found.start.angle - 1.0 + np.pi) % (2 * np.pi) - np.pi
    assert abs(difference) < 5 * found.angle_sigma < 0.05


def test_a_clip_on_the_tail_alone_is_called_ambiguous(motion, make_run):
    """Where the speed falls like an exponential, start and clock rate do the same."""
    run = make_run(motion, np.random.default_rng(3))
    (found,) = match(run.casing(), run.clips([90.0]))
    assert found.offset_sigma > 5e-3
    assert found.ambiguous
    assert abs(found.start.offset - 90.0) < 5 * found.offset_sigma


def test_equal_speeds_on_rise_and_tail_are_distinguished_by_the_slope(motion, make_run):
    casing_speed = motion(np.linspace(0, 135, 1351))[1]
    rise = np.interp(130.0, casing_speed[:400], np.linspace(0, 135, 1351)[:400])
    run = make_run(motion, np.random.default_rng(4))
    (found,) = match(run.casing(), run.clips([rise]))
    assert abs(found.start.offset - rise) < 5 * found.offset_sigma < 3e-3


def test_a_casing_of_constant_speed_says_nothing_of_the_start(make_run):
    def constant(time):
        return np.array([0 * time, 0 * time + 80.0, 80.0 * time, 0 * time])

    run = make_run(constant, np.random.default_rng(5), 40.0)
    (found,) = match(run.casing(), run.clips([15.0]))
    assert found.ambiguous
    assert found.offset_sigma > 0.1


@pytest.mark.slow
def test_a_camera_that_was_turned_between_clips_does_no_harm(motion, make_run):
    run = make_run(motion, np.random.default_rng(6), 30.0)
    starts = (3.0, 9.0, 15.0)
    matches = match(run.casing(), run.clips(starts, offsets=[0.3, 2.9, 5.0]))
    assert max(np.abs(pulls(matches, starts))) < 5
    assert not any(found.common_direction for found in matches)


@pytest.mark.slow
def test_a_camera_that_stood_still_is_recognised_and_helps(motion, make_run):
    run = make_run(motion, np.random.default_rng(7))
    casing, starts = run.casing(), (2.0, 6.0, 11.0, 75.0)
    clips = run.clips(starts)
    together = match(casing, clips)
    assert sum(found.common_direction for found in together) >= 3
    assert max(np.abs(pulls(together, starts))) < 5
    apart = match(casing, clips[:1])
    assert together[0].offset_sigma < apart[0].offset_sigma
    turn = [rival for rival in together[1].rivals if rival.kind == "turn"]
    assert len(turn) == 2
    assert min(rival.delta_chi2 for rival in turn) > 25


def test_clocks_that_differ_are_not_forced_together(motion, make_run):
    run = make_run(motion, np.random.default_rng(8), 20.0)
    casing = run.casing()
    clips = run.clips([3.0], rate=1 + 3e-4) + run.clips([8.0], rate=1 - 3e-4)
    matches = match(casing, clips)
    assert max(np.abs(pulls(matches, (3.0, 8.0)))) < 5
    assert not matches[0].common_rate


@pytest.mark.parametrize(
    ("difference", "common"),
    [pytest.param(0.0, True, marks=pytest.mark.slow), (1.2e-4, True), (3.5e-4, False)],
)
def test_one_camera_has_one_clock_up_to_what_tracking_errors_imitate(motion, make_run, difference, common):
    run = make_run(motion, np.random.default_rng(12), 20.0)
    clips = run.clips([3.0], rate=1 + difference / 2) + run.clips([8.0], rate=1 - difference / 2)
    matches = match(run.casing(), clips)
    assert matches[0].common_rate == common
    if common and difference:
        # the difference shows errors that are not white: all uncertainties contain them
        equal = match(run.casing(), run.clips([3.0, 8.0], rate=1.0))
        assert all(a.offset_sigma > 2 * b.offset_sigma for a, b in zip(matches, equal, strict=True))
        assert matches[0].covariance[0, 0] == pytest.approx(matches[0].offset_sigma ** 2)


def test_clips_of_two_cameras_are_solved_apart(motion, make_run):
    run = make_run(motion, np.random.default_rng(9), 20.0)
    casing = run.casing()
    clips = run.clips([3.0], rate=1 + 3e-4) + run.clips([8.0], rate=1 - 3e-4)
    matches = match(casing, clips, cameras=["a", "b"])
    assert max(np.abs(pulls(matches, (3.0, 8.0)))) < 5


@pytest.mark.slow
def test_a_nominal_frame_rate_that_is_off_by_a_thousandth(motion, make_run):
    run = make_run(motion, np.random.default_rng(10))
    matches = match(run.casing(), run.clips(STARTS, rate=1 + 1e-3))
    assert max(np.abs(pulls(matches, STARTS))) < 5
    assert matches[0].start.eps == pytest.approx(1e-3, abs=5 * matches[0].rate_sigma)


def test_correlated_noise_widens_the_error(motion, make_run):
    run = make_run(motion, np.random.default_rng(11), 20.0)
    casing, clips = run.casing(), run.clips(STARTS[:1])
    rng = np.random.default_rng(12)
    drift = np.convolve(rng.normal(size=1529), np.full(30, 30**-0.5), "valid") * 1e-3
    noisy = dataclasses.replace(clips[0], angle=clips[0].angle + drift)
    clean, drifting = match(casing, clips)[0], match(casing, [noisy])[0]
    assert drifting.offset_sigma > 1.5 * clean.offset_sigma
    assert abs(drifting.start.offset - STARTS[0]) < 5 * drifting.offset_sigma


def test_sigmas_of_the_input_that_are_wrong_do_not_matter(motion, make_run):
    run = make_run(motion, np.random.default_rng(13), 20.0)
    casing, clips = run.casing(), run.clips(STARTS[:1])
    right = match(casing, clips)[0]
    wrong = match(casing.scaled(5.0), [clips[0].scaled(5.0)])[0]
    assert wrong.offset_sigma == pytest.approx(right.offset_sigma, rel=0.2)


@pytest.mark.parametrize(("start", "span"), [(12.0, 32.0), pytest.param(90.0, 200.0, marks=pytest.mark.slow)])
def test_a_clip_of_another_run_is_refused(motion, other_motion, make_run, start, span):
    rng = np.random.default_rng(14)
    casing = make_run(motion, rng, span).casing()
    (foreign,) = make_run(other_motion, rng).clips([start])
    with pytest.raises(SyncError, match="does not belong") as caught:
        match(casing, [foreign])
    assert "clip0" in caught.value.message


def test_a_clip_faster_than_anything_in_the_record_is_refused(motion, make_run):
    run = make_run(motion, np.random.default_rng(15), 20.0)
    (clip,) = run.clips([5.0])
    with pytest.raises(SyncError, match="does not belong"):
        match(run.casing(), [Curve(clip.time, 5 * clip.angle, clip.sigma)])


def test_a_clip_that_turns_the_other_way_is_refused(motion, make_run):
    run = make_run(motion, np.random.default_rng(16), 20.0)
    (clip,) = run.clips([5.0])
    with pytest.raises(SyncError, match="does not belong"):
        match(run.casing(), [Curve(clip.time, -clip.angle, clip.sigma)])


@pytest.mark.parametrize("fixed", [True, False], ids=["still", "turned"])
@pytest.mark.slow
def test_claimed_error_is_the_real_one(motion, make_run, fixed):
    """11 runs of three clips: 68 % within one sigma, none beyond five, and 3 ms or marked."""
    pull, lost = [], []
    for seed in range(11, 22):
        rng = np.random.default_rng(seed)
        run = make_run(motion, rng)
        starts = rng.uniform([1, 25, 65], [20, 60, 125])
        offsets = [1.0] * 3 if fixed else list(rng.uniform(0, 2 * np.pi, 3))
        matches = match(run.casing(), run.clips(starts, offsets=offsets))
        pull += pulls(matches, starts)
        lost += [
            abs(m.start.offset - t) > 3e-3 and not m.ambiguous for m, t in zip(matches, starts, strict=True)
        ]
    assert np.max(np.abs(pull)) < 5
    assert not any(lost)
    within = np.mean(np.abs(pull) < 1)
    assert 0.48 < within < 0.88  # 33 pulls, three of a run share a clock: +- 0.09


@pytest.mark.slow
def test_claimed_error_holds_for_short_records_with_slow_errors_of_tracking(motion, make_run):
    """Errors that last some tenths of a second are no white noise: starts and rates are uncertain by what they do."""
    starts, rates = [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        run = make_run(motion, rng, duration=20.0)
        true = np.sort(rng.uniform(0.5, 16, 3))
        curves = [run.casing(), *run.clips(true, rate=1.0)]
        slow = []
        for curve in curves:
            share = np.exp(-np.median(np.diff(curve.time)) / 0.15)
            steps = rng.normal(0, 0.5e-3 * np.sqrt(1 - share**2), len(curve.time))
            error = lfilter([1], [1, -share], steps)
            slow.append(Curve(curve.time, curve.angle + error, curve.sigma))
        found = match_clips(slow[0], slow[1:], ["a", "b", "c"], [0] * 3)
        starts += [(m.start.offset - s) / m.offset_sigma for m, s in zip(found, true, strict=True)]
        rates.append(found[0].start.eps / found[0].rate_sigma)
    assert 0.4 < np.sqrt(np.mean(np.square(starts))) < 1.6
    assert 0.3 < np.sqrt(np.mean(np.square(rates))) < 1.7
