"""Coverage of 95 % intervals: recordings by SciPy with three kinds of noise."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import binom

from fitting import REDUCED, Model, fit, make_record
from fitting.study._preparation import prepared

RECORDINGS = 18
SPAN, WINDOWS = 200.0, (5.0, 70.0, 150.0)
# frames per second of casing and rotor, and the noise of an angle: the second has the information of the first
PAPER, FEWER_FRAMES = (260.0, 1000.0, 1e-3), (65.0, 250.0, 5e-4)
I_R, I_C = 5.54e-5, 2.06e-5
A2, B1, B2, D, F, G = 9.97e-11, 2.88e-6, 8.28e-7, 1.57e-7, 2.2e-8, 1.25
START = (900.0, 5.0)
TORQUE, MEMORY, KNOTS = 1e-7, 1.0, 4001
TRUTH = {
    "rotor.air.quadratic.a2": A2,
    "touchpoint.constant.b1": B1,
    "casing.air.linear.b2": B2,
    "bearing.linear.d": D,
    "bearing.power.f": F,
    "bearing.power.g": G,
}


def torques(rng, count):
    """Return Ornstein-Uhlenbeck processes of rms 1 at the knots, two for each recording."""
    keep = np.exp(-SPAN / (KNOTS - 1) / MEMORY)
    out = rng.standard_normal((KNOTS, 2, count))
    for i in range(1, KNOTS):
        out[i] = keep * out[i - 1] + np.sqrt(1 - keep**2) * out[i]
    return out


def motions(times, push):
    """Return (omega_r, omega_c, psi_r, psi_c) of all recordings at some times, (times, 4, recordings)."""
    step, count = SPAN / (KNOTS - 1), push.shape[2]

    def rates(t, flat):
        wr, wc, _, _ = flat.reshape(4, count)
        i = min(int(t / step), KNOTS - 2)
        casing, bearing = push[i] + (push[i + 1] - push[i]) * (t / step - i)
        diff = wr - wc
        tau = D * diff + F * diff**G + bearing
        return np.concatenate([(-tau - A2 * wr**2) / I_R, (tau - B1 - B2 * wc + casing) / I_C, wr, wc])

    first = np.repeat([*START, 0.0, 0.0], count)
    # steps no longer than what lies between two knots
    longest = step if push.any() else np.inf
    solved = solve_ivp(rates, (0, SPAN), first, "DOP853", times, max_step=longest, rtol=1e-9, atol=1e-6)
    return solved.y.T.reshape(len(times), 4, count)


def recordings(torque, count, cameras):
    """Return records with angle noise, an offset centre, and random torques of this many N m rms."""
    rate, rotor_rate, sigma = cameras
    rng = np.random.default_rng(20)
    casing = np.arange(0, SPAN, 1 / rate)
    windows = [w + np.arange(0, 3, 1 / rotor_rate) for w in WINDOWS]
    every, where = np.unique(np.concatenate([casing, *windows]), return_inverse=True)
    # without a torque the motion of all recordings is the same
    push = torque * torques(rng, count) if torque else np.zeros((KNOTS, 2, 1))
    motion = np.broadcast_to(motions(every, push)[where], (len(where), 4, count))
    parts = np.split(motion, np.cumsum([len(casing), *map(len, windows)])[:-1])
    made = []
    for i in range(count):
        psi = parts[0][:, 3, i]
        psi = psi + 2e-3 * np.sin(psi - rng.uniform(0, 2 * np.pi))
        runs = [
            (casing, psi),
            *((t, p[:, 2, i] + rng.uniform(-9, 9)) for t, p in zip(windows, parts[1:], strict=True)),
        ]
        noisy = [(t, v + sigma * rng.standard_normal(len(t)), np.full(len(t), sigma)) for t, v in runs]
        made.append(make_record(casing=noisy[0], rotor=noisy[1:], I_rotor=I_R, I_casing=I_C))
    return made


def fits(records):
    return [fit(Model.of(REDUCED), [r]) for r in records]


def pulls(found):
    return {
        key: np.array([
            (f.estimates[key].value - true) / f.estimates[key].stderr for f in found if not f.estimates[key].at_bound
        ])
        for key, true in TRUTH.items()
    }  # fmt: skip


@pytest.mark.slow
@pytest.mark.release
def test_intervals_have_the_stated_coverage_and_tests_the_stated_false_alarm_rate():
    """18 recordings. Fails where intervals that should hold 95 % hold 85 %, or are twice as wide as they need be.

    They are a little wide by intention: the correlation time of the torque is taken half its error longer. The smooth
    tests are correlated: small p-values are accurate, large ones are upper bounds.
    """
    found = fits(recordings(TORQUE, RECORDINGS, FEWER_FRAMES))
    seen = pulls(found)
    for key, z in seen.items():
        inside = int(np.sum(np.abs(z) < 1.96))
        assert inside >= binom.ppf(5e-4, len(z), 0.95), key
        assert 0.55 < np.std(z) < 1.35, key  # of 18: +- 0.17
        assert abs(np.mean(z)) < 4 / np.sqrt(len(z)), key
    assert np.mean(np.abs(np.concatenate(list(seen.values()))) < 1.96) > 0.92
    strength = np.median([f.noise[0].pure * np.sqrt(f.noise[0].time / MEMORY) for f in found])
    assert TORQUE / 1.25 < strength < 1.25 * TORQUE
    for name in ("smooth_test", "periodogram_peak"):
        p = np.array([getattr(f, name).p_value for f in found])
        for level in (0.02, 0.1, 0.3):
            assert np.sum(p < level) <= binom.ppf(0.999, len(p), level)
        # and not never
        assert np.sum(p < 0.5) >= 2


@pytest.mark.slow
@pytest.mark.release
def test_intervals_from_smoothed_velocities_have_the_stated_coverage():
    seen = pulls(fits(prepared(r, "velocity") for r in recordings(0.0, 20, PAPER)))
    for key, z in seen.items():
        assert int(np.sum(np.abs(z) < 1.96)) >= binom.ppf(5e-4, len(z), 0.95), key
        assert 0.4 < np.std(z) < 1.45, key  # of 20: +- 0.16
