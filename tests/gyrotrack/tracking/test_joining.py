from dataclasses import replace

import numpy as np
import pytest

from gyrotrack.tracking import _fusion
from gyrotrack.tracking._fusion import join, variance_left, wrapped
from gyrotrack.tracking._marker_tracker import Candidate

N = 1500
MOUNTS = {"blue": 0.0, "white": 2.1, "green": -2.0}
SCATTER = {"blue": 2e-3, "white": 1e-3, "green": 4e-3}


def _scene(seed, bias=0.0, wrong=0.0, share=0.8):
    """Three markers of a rotor at 0.5 rad a frame, each seen in a share of the frames."""
    rng = np.random.default_rng(seed)
    k = np.arange(N)
    truth = 1.0 + 0.5 * k - 2e-5 * k**2
    markers = {}
    for name, mount in MOUNTS.items():
        angle = truth + mount + rng.normal(0, SCATTER[name], N)
        angle = angle + bias * np.cos(4 * (truth + mount))
        good = rng.uniform(size=N) < share
        angle = angle + np.where(rng.uniform(size=N) < wrong, 0.05, 0.0)
        markers[name] = Candidate(
            np.angle(np.exp(1j * angle)), good, np.ones(N, dtype=bool), np.ones(N), np.zeros(N), mount + 0.01
        )
    coarse = truth + 0.01 + rng.normal(0, 0.01, N)
    return truth, coarse, markers


def test_the_angle_is_right_and_so_is_its_uncertainty():
    z = []
    for seed in range(6):
        truth, coarse, markers = _scene(seed)
        body = join(coarse, markers, 1000.0)
        error = body.angle - truth
        error -= np.nanmean(error)
        assert np.nanstd(error) < 1.45e-3  # ideal weights give 1.3e-3
        z.append(error / body.sigma)
    assert np.nanstd(np.concatenate(z)) == pytest.approx(1.0, abs=0.12)


def test_places_on_the_body_are_measured():
    _, coarse, markers = _scene(1)
    body = join(coarse, markers, 1000.0)
    first = body.markers["blue"].mount
    assert body.markers["white"].mount - first == pytest.approx(2.1, abs=3e-4)
    assert body.markers["green"].mount - first == pytest.approx(-2.0, abs=5e-4)


def test_faults_are_left_out():
    truth, coarse, markers = _scene(2, wrong=0.03)
    body = join(coarse, markers, 1000.0)
    error = body.angle - truth
    assert np.nanmax(np.abs(error - np.nanmedian(error))) < 0.02
    assert (np.abs(error - np.nanmedian(error)) > 5 * body.sigma).mean() < 2e-3


def test_position_dependent_errors_are_learnt():
    truth, coarse, markers = _scene(3, bias=6e-3)
    body = join(coarse, markers, 1000.0)
    assert np.nanstd(body.angle - truth) < 1.5e-3


def test_frames_with_no_marker_have_no_angle():
    truth, coarse, markers = _scene(4)
    for name, c in markers.items():
        good = c.good.copy()
        good[700:720] = False
        markers[name] = Candidate(c.angle, good, c.open, c.weak, c.misfit_excess, c.mount)
    body = join(coarse, markers, 1000.0)
    assert np.isnan(body.angle[700:720]).all()
    assert (body.count[700:720] == 0).all()
    error = body.angle - truth
    assert abs(np.nanmean(error[720:]) - np.nanmean(error[:700])) < 1e-3  # no slipped turn


def test_a_slow_oscillation_with_the_turn_is_motion_not_error():
    """A single marker on an unbalanced wheel at 20 rad/s: the swing once a turn is real and must stay."""
    rng = np.random.default_rng(5)
    k = np.arange(1200)
    turn = 0.07 * k
    truth = turn + 8e-3 * np.sin(turn)
    angle = np.angle(np.exp(1j * (truth + rng.normal(0, 1e-3, 1200))))
    always = np.ones(1200, dtype=bool)
    one = Candidate(angle, always, always, np.ones(1200), np.zeros(1200), 0.0)
    body = join(truth + rng.normal(0, 0.01, 1200), {"tape": one}, 300.0)
    swing = np.abs(np.mean((body.angle - turn - np.mean(body.angle - turn)) * np.exp(-1j * turn))) * 2
    assert swing == pytest.approx(8e-3, rel=0.1)


@pytest.mark.parametrize(("speed", "learnt"), [(0.5, True), (0.13, False)])
def test_errors_by_what_passes_are_learnt_only_where_it_passes_fast(speed, learnt):
    """At 430 rad/s relative to the casing a swing with their angle cannot be motion; at 60 rad/s it can."""
    rng = np.random.default_rng(6)
    k = np.arange(1200)
    truth, other = 0.07 * k, 2.0 + speed * k
    angle = truth + 4e-3 * np.cos(3 * (truth - other)) + rng.normal(0, 1e-3, 1200)
    always = np.ones(1200, dtype=bool)
    one = Candidate(np.angle(np.exp(1j * angle)), always, always, np.ones(1200), np.zeros(1200), 0.0)
    coarse = truth + rng.normal(0, 0.01, 1200)
    for above in (True, False):
        error = join(coarse, {"red": one}, 1000.0, other, above=above).angle - truth
        assert bool(np.std(error) < 1.2e-3) == learnt
        assert bool(np.std(error) > 2.5e-3) != learnt


@pytest.mark.slow
def test_markers_that_pass_nearly_in_step_with_the_frames_move_nothing():
    """Six passages a turn, creeping: a curve over their angle could follow any slow motion, or make one."""
    z, slow = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        k = np.arange(240)
        truth, other = 0.077 * k, 0.4 + 1.13 * k
        noise = rng.normal(0, 1e-3, 240)
        for j in range(1, 240):
            noise[j] = 0.6 * noise[j - 1] + 0.8 * noise[j]
        always = np.ones(240, dtype=bool)
        angle = np.angle(np.exp(1j * (truth + noise)))
        one = Candidate(angle, always, always, np.ones(240), np.zeros(240), 0.0)
        body = join(truth + rng.normal(0, 0.01, 240), {"red": one}, 260.0, other, above=True)
        error = body.angle - truth
        error -= np.median(error)
        z.append(error / body.sigma)
        slow.append(
            np.polyval(np.polyfit(k, error, 3), k).std() / np.polyval(np.polyfit(k, noise, 3), k).std()
        )
    assert np.mean(slow) < 1.3
    assert 0.8 < np.concatenate(z).std() < 1.25


def _few_turns(seed, turns=3.4, frames=250, rho=0.0, sizes=(1.3e-3,)):
    """Markers of a slow body: errors of so many rad by place, noise of 0.7 mrad that lasts."""
    rng = np.random.default_rng(seed)
    truth = 1.0 + 2 * np.pi * turns * np.arange(frames) / frames
    order = np.arange(1, 9)
    every = np.ones(frames, dtype=bool)
    markers = {}
    for k, by_place in enumerate(sizes):
        size = rng.normal(size=(2, 8)) / np.sqrt(order)
        size *= by_place * np.sqrt(2) / np.sqrt((size**2).sum())
        place = np.cos(np.outer(truth, order)) @ size[0] + np.sin(np.outer(truth, order)) @ size[1]
        noise = rng.normal(0, 0.7e-3, frames)
        for j in range(1, frames):
            noise[j] = rho * noise[j - 1] + np.sqrt(1 - rho**2) * noise[j]
        angle = np.angle(np.exp(1j * (truth + place + noise)))
        markers[f"marker {k}"] = Candidate(angle, every, every, np.ones(frames), np.zeros(frames), 0.0)
    return truth, join(truth + rng.normal(0, 0.01, frames), markers, 1000.0)


@pytest.mark.parametrize("rho", [0.0, pytest.param(0.5, marks=pytest.mark.slow), 0.7])
def test_errors_that_last_for_some_frames_are_not_taken_for_motion(rho):
    z = []
    for seed in range(20):
        truth, body = _few_turns(seed, rho=rho)
        error = body.angle - truth
        z.append((error - np.median(error)) / body.sigma)
    assert np.std(np.concatenate(z)) == pytest.approx(1.0, abs=0.05)


def test_motion_and_position_dependent_errors_of_two_turns_are_distinguished_as_badly_as_claimed():
    """At the ends of the film, a curve over the angle and a motion can be exchanged; the noise alone says 1.3 there."""
    z, ends = [], []
    for seed in range(16):
        truth, body = _few_turns(seed, turns=2.2, frames=120, sizes=(5e-3,))
        error = body.angle - truth
        z.append((error - np.median(error)) / body.sigma)
        ends.append(np.concatenate([z[-1][:8], z[-1][-8:]]))
    assert np.std(np.concatenate(z)) == pytest.approx(1.0, abs=0.05)
    assert np.std(np.concatenate(ends)) == pytest.approx(1.0, abs=0.12)


def _seen_beside_the_axis(seed, common, own, turns=1.6, frames=150):
    """Three markers, each hidden for a third of every turn, about an axis that is off by so much of their radius."""
    rng = np.random.default_rng(seed)
    truth = 1.0 + 2 * np.pi * turns * np.arange(frames) / frames
    axis = rng.normal(0.0, common, 2)
    markers = {}
    for name, mount in MOUNTS.items():
        e, place = axis + rng.normal(0.0, own, 2), truth + mount
        angle = place + e[1] * np.cos(place) - e[0] * np.sin(place) + rng.normal(0.0, 1e-3, frames)
        good = np.mod(place - 0.5, 2 * np.pi) > 2.1
        markers[name] = Candidate(
            wrapped(angle), good, np.ones(frames, dtype=bool), np.ones(frames), np.zeros(frames), mount
        )
    body = join(truth + rng.normal(0, 0.01, frames), markers, 1000.0, floor=1e-3)
    error = body.angle - truth
    error -= np.nanmedian(error)
    return error, error / body.sigma


@pytest.mark.parametrize(
    ("common", "own"), [(0.0, 0.0), pytest.param(12e-3, 0.5e-3, marks=pytest.mark.slow), (6e-3, 3e-3)]
)
def test_markers_of_a_body_show_together_where_its_axis_is(common, own):
    """In less than two turns: what one marker shows as motion, three show as an axis beside the one assumed."""
    errors, z = zip(*(_seen_beside_the_axis(seed, common, own) for seed in range(8)), strict=True)
    # errors of its own of each marker move the mean of the markers like a motion
    assert np.nanstd(errors) < 1.0e-3 + 0.8 * own  # 13 mrad about the axis assumed, with common = 12 mrad
    assert 0.7 < np.nanstd(z) < 1.25


def test_an_error_that_hardly_changes_along_an_arc_is_a_zero():
    turn = np.linspace(0.0, 2 * np.pi, 200, endpoint=False)
    assert variance_left(turn, range(1, 7)) == pytest.approx(1.0, abs=1e-9)
    short = np.linspace(0.0, 0.2, 200)
    assert variance_left(short, range(1, 2)) == pytest.approx(0.2**2 / 12, rel=0.02)
    assert variance_left(short, range(1, 2), 20) == pytest.approx(0.9, abs=0.01)  # ten independent errors


def test_position_dependent_errors_are_known_only_of_a_body_that_turns_round():
    assert _few_turns(1)[1].place_error == pytest.approx(1.3e-3, rel=0.2)
    assert np.isnan(_few_turns(1, turns=1.5)[1].place_error)


def test_the_marker_with_the_smallest_error_shows_how_large_position_dependent_errors_are():
    assert _few_turns(2, sizes=(6e-3, 1.5e-3, 4e-3))[1].place_error == pytest.approx(1.5e-3, rel=0.3)


def test_frames_that_hardly_show_a_body_have_no_angle():
    sigma = np.full(400, 1e-3)
    sigma[200:] = 8e-3  # a blurred part of the film is as good as its surroundings
    sigma[[0, 1, 150, 300]] = 2e-2, np.nan, 2e-2, 2e-2
    assert np.flatnonzero(_fusion._mostly_hidden(sigma)).tolist() == [0, 150]


def test_an_angle_of_one_marker_that_no_other_frame_confirms_is_left_out():
    """A hand covers the markers in frames 1 to 24; what is taken for a marker in frame 0 cannot be checked."""
    n = 200
    path = 0.1 * np.arange(n) + np.random.default_rng(3).normal(0.0, 1e-3, n)
    seen = np.ones(n, dtype=bool)
    seen[1:25] = False
    coarse = np.where(seen, path, np.nan)
    coarse[0] += 0.3
    one = Candidate(wrapped(coarse), seen, seen, np.ones(n), np.zeros(n), 0.0)
    found = join(coarse, {"red": one}, 260.0)
    assert np.isnan(found.angle[0])
    assert np.isfinite(found.angle[25:]).all()
    both = join(coarse, {"red": one, "blue": replace(one)}, 260.0)
    assert np.isfinite(both.angle[0])
