"""Correlated angle noise of the casing: level and correlation time, and none in white noise."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import twobody
from scipy.signal import lfilter

from fitting import Experiment, Model, fit, make_record, simulate
from fitting.inference import _angle_noise
from fitting.inference._case_data import CaseData
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
