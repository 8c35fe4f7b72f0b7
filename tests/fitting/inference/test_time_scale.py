"""Results do not depend on the units of time and inertia: a gyroscope that spins down slowly, or is light."""

from dataclasses import replace

import numpy as np
import pytest

from fitting import REDUCED, Experiment, Model, fit, simulate
from fitting.inference._case_data import CaseData, blocks_of_window
from fitting.inference._record import Samples

NUMBERS = {
    "rotor.air.quadratic.a2": 9.97e-11, "touchpoint.constant.b1": 2.88e-6, "casing.air.linear.b2": 8.28e-7,
    "bearing.linear.d": 1.57e-7, "bearing.power.f": 1.26e-8, "bearing.power.g": 1.32,
}  # fmt: skip
RUN = Experiment(duration=40.0, casing_fps=30.0, rotor_fps=100.0, windows=(3.0, 18.0, 34.0), sigma=1e-3)


def samples(duration, n=100):
    t = np.linspace(0.0, duration, n)
    return Samples(t, t, np.full(n, 1e-3))


@pytest.mark.parametrize("scale", [1.0, 1000.0])
@pytest.mark.parametrize(("share", "blocks"), [(0.05, 1), (0.249, 1), (0.251, 5), (1.0, 20), (4.0, 60)])
def test_a_window_shorter_than_a_quarter_of_the_record_is_one_block(scale, share, blocks):
    assert blocks_of_window(samples(60.0 * share * scale), samples(60.0 * scale)) == blocks


def test_a_slower_and_lighter_gyroscope_has_the_same_deviance():
    record = simulate(Model.of(REDUCED), NUMBERS, RUN, inertia_rotor=5.54e-5, inertia_casing=2.06e-5, seed=1)
    fits = []
    for scale, inertia in ((1.0, 1.0), (1000.0, 1e-4)):
        casing, *windows = (Samples(w.time * scale, w.value, w.sigma) for w in (record.casing, *record.rotor))
        light = {"I_rotor": 5.54e-5 * inertia, "I_casing": 2.06e-5 * inertia}
        slower = replace(record, casing=casing, rotor=tuple(windows), digest="", **light)
        found = fit(Model.of(REDUCED), [CaseData.of(slower)])
        fits.append((found, found.estimates["touchpoint.constant.b1"].value * scale**2 / inertia))
    (usual, b1), (slow, dry) = fits
    assert slow.rows == usual.rows
    assert slow.deviance == pytest.approx(usual.deviance, abs=0.05)
    assert dry == pytest.approx(b1, rel=1e-3)
