"""Robust losses: against SciPy on a problem of plain arrays, and uncertainties with outliers."""

import numpy as np
import pytest
import twobody
from cases import pulls
from oscillators import motion
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from fitting import LINEAR, REDUCED, EstimationError, Model, fit, make_record
from fitting.inference._fit import cauchy, huber, robust_fit

TRUTH = twobody.truth()


# the information of 260 and 1000 frames per second with 1 mrad
FEWER_FRAMES = {"casing_rate": 65.0, "rotor_rate": 250.0, "sigma": 5e-4}


def spoiled(seed, share=0.05, size=30.0, par=twobody.PAPER, **cameras):
    """A film of which some angles (or speeds) are wrong by much more than the noise."""
    span = cameras.get("span", 200.0)
    set_up = twobody.Cameras(**cameras)
    raw = twobody.film(twobody.simulate(par, seed=seed, span=span), seed=seed, cameras=set_up)
    rng = np.random.default_rng(seed)
    for run in (raw["casing"], *raw["rotor"]):
        bad = rng.random(len(run[0])) < share
        run[1][bad] += size * set_up.sigma * rng.standard_normal(bad.sum())
    return raw


@pytest.mark.parametrize("psi", [huber, cauchy])
def test_the_slope_of_psi_is_its_derivative(psi):
    x = np.array([-9.0, -1.2, -0.3, 0.0, 0.5, 1.3, 2.0, 30.0])
    rise = (psi(x + 1e-6)[0] - psi(x - 1e-6)[0]) / 2e-6
    np.testing.assert_allclose(psi(x)[1], rise, atol=1e-6)


@pytest.mark.parametrize(
    ("loss", "tuning"), [("huber", 1.345), pytest.param("cauchy", 2.385, marks=pytest.mark.slow)]
)
def test_the_robust_minimum_agrees_with_scipy(loss, tuning):
    """Speeds, the linear model, SciPy's integrator and SciPy's robust least squares with the same scales."""
    linear = {**twobody.PAPER, "f": 0.0, "d": 2.5e-7}
    cameras = {
        "quantity": "omega", "sigma": 0.05, "span": 30.0, "windows": (2.0, 25.0), "window_length": 1.0,
        "casing_rate": 60.0, "rotor_rate": 300.0,
    }  # fmt: skip
    raw = spoiled(3, share=0.1, par=linear, **cameras)
    found = robust_fit(Model.of(LINEAR), [make_record(**raw)], loss)
    runs = [(*raw["casing"], 1), *((*r, 0) for r in raw["rotor"])]
    keys = list(found.estimates)
    best = np.array([found.estimates[k].value for k in keys])

    def residuals(u):
        a2, b1, b2, d, start_r, start_c = u * best

        def rates(t, y):
            tau = d * (y[0] - y[1])
            return [(-tau - a2 * y[0] ** 2) / twobody.I_ROTOR, (tau - b1 - b2 * y[1]) / twobody.I_CASING]

        path = solve_ivp(
            rates, (0, 30), [start_r, start_c], "DOP853", rtol=1e-8, atol=1e-8, dense_output=True
        ).sol
        return [(path(t)[body] - value) / sigma for t, value, sigma, body in runs]

    # the scale of each run is measured about the fit
    scales = [1.4826 * np.median(np.abs(r)) for r in residuals(np.ones(6))]

    def scaled(u):
        return np.concatenate([r / s for r, s in zip(residuals(u), scales, strict=True)])

    start = 1 + 0.01 * np.array([1, -1, 1, 1, 0.1, -0.1])
    scipys = least_squares(scaled, start, loss=loss, f_scale=tuning, xtol=1e-8, ftol=1e-9, gtol=1e-8)
    stderr = np.array([found.estimates[k].stderr for k in keys])
    assert np.abs((scipys.x - 1) * best / stderr).max() < 0.05


@pytest.mark.slow
@pytest.mark.release
def test_outliers_cost_little():
    """One sample in twenty is wrong by thirty sigma: least squares loses a factor of six, a robust loss a tenth."""
    raw = spoiled(0, **FEWER_FRAMES)
    plain = fit(Model.of(REDUCED), [make_record(**raw)])
    robust = robust_fit(Model.of(REDUCED), [make_record(**raw)], "cauchy")
    clean = fit(Model.of(REDUCED), [make_record(**spoiled(0, share=0.0, **FEWER_FRAMES))])
    key = "casing.air.linear.b2"
    assert plain.estimates[key].stderr > 5 * clean.estimates[key].stderr
    assert robust.estimates[key].stderr < 1.25 * clean.estimates[key].stderr
    assert max(map(abs, pulls(robust, TRUTH).values())) < 4
    assert 0.95 < robust.reduced_chi2 < 1.05
    # the record is still the one that was measured
    assert robust.problem.data[0].record.digest == plain.problem.data[0].record.digest


@pytest.mark.slow
@pytest.mark.release
def test_uncertainties_are_valid_with_outliers():
    """4 recordings x 8 parameters, of which about two are independent: rms pull 1 +- 0.25, less where noise of the
    windows is allowed that these data do not have."""
    found = [
        robust_fit(Model.of(REDUCED), [make_record(**spoiled(70 + s, **FEWER_FRAMES))], "huber")
        for s in range(4)
    ]
    table = np.array([list(pulls(f, TRUTH).values()) for f in found])
    assert 0.5 < np.sqrt(np.mean(table**2)) < 1.4
    assert np.mean(np.abs(table) < 1.96) > 0.85


@pytest.mark.slow
def test_linear_is_least_squares():
    raw = spoiled(1, share=0.0, span=20.0, windows=(2.0, 15.0))
    plain, same = (
        fit(Model.of(LINEAR), [make_record(**raw)]),
        robust_fit(Model.of(LINEAR), [make_record(**raw)]),
    )
    assert [e.value for e in plain.estimates.values()] == [e.value for e in same.estimates.values()]


def test_unsupported_robust_fits_are_refused():
    raw = spoiled(1, share=0.0, span=20.0, windows=(2.0, 15.0))
    with pytest.raises(EstimationError, match="no loss named"):
        robust_fit(Model.of(LINEAR), [make_record(**raw)], "l1")
    with pytest.raises(EstimationError, match="laws of an angle"):
        robust_fit(Model.of((*LINEAR, "casing.unbalance")), [make_record(**raw)], "huber")


@pytest.mark.slow
def test_a_robust_fit_of_an_angle_that_oscillates_resists_outliers():
    """An imported angle has no nuisance functions of a camera."""
    t, angle, _ = motion(lambda _, x, v: -4.0 * x - 0.05 * v, (1.0, 0.0), 30.0, rate=20.0)
    chance = np.random.default_rng(3)
    noisy = angle + 1e-3 * chance.standard_normal(len(t)) + 0.05 * (chance.random(len(t)) < 0.05)
    samples = t, noisy, np.full(len(t), 1e-3)
    body = make_record(casing=samples, rotor=[], I_rotor=1.0, I_casing=1.0, label="x", single=True)
    model = Model.of(("casing.air.linear", "casing.spring.linear"))
    robust = robust_fit(model, [body], "huber").estimates["casing.air.linear.b2"].value - 0.05
    assert abs(robust) < 2e-4
