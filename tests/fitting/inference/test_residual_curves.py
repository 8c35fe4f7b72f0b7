"""Residual speeds and angles of a linear motion, and their uncertainties, by the formulas of least squares."""

from types import SimpleNamespace

import numpy as np
import pytest
from linearised import covariance, gyroscope
from scipy.interpolate import BarycentricInterpolator

from fitting.inference import _angle_residuals as angles
from fitting.inference import _speed_residuals as speeds
from fitting.inference._angle_residuals import AngleResidual, angle_residuals
from fitting.inference._compression import compress
from fitting.inference._record import Samples
from fitting.inference._speed_residuals import (
    CASING,
    ROTOR,
    SpeedMap,
    modelled_speed,
    speed_residuals,
    spread_of_rows,
)

LEVEL = 2e-7


def bent(data):
    """Return the rows of an angle of 1e-3 x^2 of the casing and -2e-3 x^2 of the rotor, x in seconds from 3 s on."""
    casing = 1e-3 * (data.casing.node_times - 3.0) ** 2
    return data.rows(casing, [-2e-3 * (w.node_times - 3.0) ** 2 for w in data.rotor])


@pytest.fixture(scope="module")
def found():
    plain = gyroscope(level=LEVEL)
    return gyroscope(level=LEVEL, residual=[bent(plain.problem.data[0])])


def whole(fit):
    """Covariance of the measured rows, and that of the residual ones C - X (X' C^-1 X)^-1 X', in their own units."""
    data = fit.problem.data[0]
    c = covariance(fit, LEVEL)
    free = np.concatenate([fit.predictions[0].jacobian, data.nuisance], axis=1)
    free = free[:, np.linalg.norm(free, axis=0) > 0]
    free = free / np.linalg.norm(free, axis=0)
    u, s, _ = np.linalg.svd(np.linalg.solve(np.linalg.cholesky(c), free), full_matrices=False)
    basis = np.linalg.cholesky(c) @ u[:, s > 1e-10 * s[0]]
    rest = data.unwhitened(c - basis @ basis.T)
    return data.unwhitened(rest.T)


class TestSpeeds:
    def test_the_residual_of_an_angle_is_its_slope(self, found):
        casing, rotor = speed_residuals(found, 0)
        assert len(casing.time) == 2 * len(found.problem.data[0].casing.operators)
        assert [len(w.time) for w in rotor] == [5 * len(w.operators) for w in found.problem.data[0].rotor]
        # the measured angle is ahead of the model; the mean over a part is the slope in its middle
        assert casing.value == pytest.approx(2e-3 * (casing.time - 3.0), abs=2e-4)
        for window in rotor:
            assert window.value == pytest.approx(-4e-3 * (window.time - 3.0), abs=2e-4)

    def test_parts_divide_the_blocks(self, found):
        data = found.problem.data[0]
        casing, (window, _) = speed_residuals(found, 0)
        for residual, run, parts in ((casing, data.casing, 2), (window, data.rotor[0], 5)):
            where, _ = run.operators[0]
            edges = np.linspace(run.samples.time[where][0], run.samples.time[where][-1], parts + 1)
            assert residual.time[:parts] == pytest.approx(0.5 * (edges[1:] + edges[:-1]))
            assert residual.width[:parts] == pytest.approx(np.diff(edges))

    def test_uncertainties_are_those_of_what_the_fit_leaves(self, found):
        rest, data = whole(found), found.problem.data[0]
        spread = spread_of_rows(found, 0)
        scale = np.abs(rest).max()
        assert spread @ spread.T == pytest.approx(rest, abs=1e-6 * scale)
        casing, rotor = speed_residuals(found, 0)
        first = 0
        for residual, run, parts in zip((casing, *rotor), (data.casing, *data.rotor), (2, 5, 5), strict=True):
            own = rest[first : first + len(run.z), first : first + len(run.z)]
            operator = speeds._slopes(run, parts, is_angle=True)[2]
            expected = np.sqrt(np.diag(operator @ own @ operator.T))
            assert residual.sigma == pytest.approx(expected, rel=1e-4)
            first += len(run.z)

    def test_the_level_of_the_recording_enters(self, found):
        quiet = replace_noise(found, pure=0.0)
        loud = replace_noise(found, level=5 * LEVEL)
        for other, same in ((quiet, False), (loud, True)):
            ratio = speed_residuals(other, 0)[0].sigma / speed_residuals(found, 0)[0].sigma
            assert (ratio == pytest.approx(1.0)) is same
            assert same or ratio.max() < 1.0

    def test_a_parameter_at_its_bound_absorbs_nothing(self, found):
        place = found.problem.layout.index["casing.air.linear.b2"]
        theta = found.theta.copy()
        theta[place] = 0.0
        held = SimpleNamespace(**{**vars(found), "theta": theta})
        ratio = speed_residuals(held, 0)[0].sigma / speed_residuals(found, 0)[0].sigma
        assert ratio.min() > 1 - 1e-6
        assert ratio.max() > 1.0001

    def test_nuisance_columns_are_removed_by_generalised_least_squares(self, found):
        data = found.problem.data[0]
        rows = np.random.default_rng(1).standard_normal(len(data.z))
        c = covariance(found, LEVEL)
        columns = data.nuisance[:, np.linalg.norm(data.nuisance, axis=0) > 0]
        columns = columns / np.linalg.norm(columns, axis=0)
        root = np.linalg.cholesky(c)
        fitted = np.linalg.lstsq(np.linalg.solve(root, columns), np.linalg.solve(root, rows), rcond=1e-10)[0]
        expected = data.unwhitened(rows - columns @ fitted)
        found_rows = SpeedMap(found.problem, found.noise[0], 0).without_nuisance(rows)
        assert found_rows == pytest.approx(expected, abs=1e-6)

    def test_rows_are_those_before_they_were_whitened(self, found):
        """Here by a noise of two standard deviations in all of them."""
        data = found.problem.data[0]

        class Noisy:
            def __getattr__(self, name):
                return getattr(data, name)

            def unwhitened(self, rows):
                return 2.0 * data.unwhitened(rows)

        problem = SimpleNamespace(data=[Noisy()], layout=found.problem.layout)
        noisy = SimpleNamespace(**{**vars(found), "problem": problem})
        assert spread_of_rows(noisy, 0) == pytest.approx(2.0 * spread_of_rows(found, 0))
        for one, other in zip(speed_residuals(noisy, 0)[1], speed_residuals(found, 0)[1], strict=True):
            assert one.value == pytest.approx(2.0 * other.value)
            assert one.sigma == pytest.approx(2.0 * other.sigma)

    @pytest.mark.parametrize(("periods", "parts"), [(0.0, 2), (0.2, 2), (1.0, 8), (4.0, 32)])
    def test_an_oscillation_is_divided_into_eighths_of_a_period(self, found, periods, parts):
        data = found.problem.data[0]
        count = len(data.casing.operators)

        class Oscillating:
            motion = SimpleNamespace(periods=periods * count)

            def __getattr__(self, name):
                return getattr(data, name)

        mapped = SpeedMap(SimpleNamespace(data=[Oscillating()]), found.noise[0], 0)
        assert len(mapped.parts[0][1]) == parts * count
        assert len(mapped.parts[1][1]) == 5 * len(data.rotor[0].operators)

    @pytest.mark.parametrize("is_angle", [True, False])
    def test_the_operator_of_a_curve(self, is_angle):
        """Slopes of a parabola in the middles of parts, or means of a line."""
        run = uneven()
        middles, lengths, operator = speeds._slopes(run, 4, is_angle=is_angle)
        for i, (where, _) in enumerate(run.operators):
            edges = np.linspace(run.samples.time[where][0], run.samples.time[where][-1], 5)
            assert lengths[4 * i : 4 * i + 4] == pytest.approx(np.diff(edges))
            assert middles[4 * i : 4 * i + 4] == pytest.approx(0.5 * (edges[1:] + edges[:-1]))
        curve = run.at_nodes(3.0 * run.node_times**2 if is_angle else 3.0 * run.node_times - 2.0)
        expected = 6.0 * middles if is_angle else 3.0 * middles - 2.0
        assert operator @ curve == pytest.approx(expected, rel=1e-9)


def uneven():
    """Two blocks of a run whose samples are dense at first."""
    t = 1.0 + 4.0 * np.linspace(0.0, 1.0, 400) ** 1.7
    return compress(Samples(t, 0 * t, np.full(400, 1e-2)), degree=4, blocks=2)


def replace_noise(fit, **changes):
    noise = fit.noise[0]
    changed = type(noise)(**{**vars(noise), **changes})
    return SimpleNamespace(**{**vars(fit), "noise": (changed,)})


class TestModelledSpeed:
    def test_its_uncertainty_is_that_of_the_parameters(self):
        """By differences of the motion for slightly different parameters; both bodies."""
        base = gyroscope()
        names = base.problem.layout.names
        step = np.where(np.array(names) == "casing.air.linear.b2", 1e-9, 0.0)
        step[names.index("initial.omega_r@case")] = 1e-3
        time = np.array([4.0, 9.0, 14.0])
        fit = SimpleNamespace(**vars(base), covariance=np.outer(step, step))
        moved = [
            SimpleNamespace(**{**vars(fit), "predictions": base.problem.predict(base.theta + sign * step)})
            for sign in (1, -1)
        ]
        for body, start in ((ROTOR, 300.0), (CASING, 20.0)):
            _, sigma = modelled_speed(fit, 0, body, time)
            up, down = (modelled_speed(f, 0, body, time)[0] for f in moved)
            assert sigma == pytest.approx(np.abs(up - down) / 2, rel=1e-3)
            assert modelled_speed(fit, 0, body, np.array([3.0]))[0] == pytest.approx([start])

    def test_a_parameter_of_no_influence_has_no_variance(self):
        base = gyroscope()
        step = 1e-9 * np.ones(len(base.theta))
        covariance = np.outer(step, step)
        fits = []
        for unknown in (0.0, np.inf):
            covariance[0, 0] = unknown
            fits.append(SimpleNamespace(**vars(base), covariance=covariance.copy()))
        known, other = (modelled_speed(f, 0, CASING, np.array([5.0]))[1] for f in fits)
        assert other == pytest.approx(known)
        assert np.isfinite(other).all()

    def test_the_response_to_a_law_of_the_angle_is_added(self, monkeypatch):
        """Smoothed over some samples as measured speeds are: of a line it is the line."""
        base = gyroscope()
        time = base.problem.data[0].record.casing.time
        response = np.stack([np.full(len(time), 7.0), 2.0 + time])[None]
        monkeypatch.setattr(
            type(base.problem.cases[0]), "response_to_angles", lambda self, prediction, theta: response
        )
        fit = SimpleNamespace(**vars(base), covariance=np.zeros((len(base.theta),) * 2))
        at = np.array([6.0, 10.0])
        found = [modelled_speed(fit, 0, body, at)[0] for body in (ROTOR, CASING)]
        monkeypatch.undo()
        plain = [modelled_speed(fit, 0, body, at)[0] for body in (ROTOR, CASING)]
        assert found[0] - plain[0] == pytest.approx([7.0, 7.0])
        assert found[1] - plain[1] == pytest.approx(2.0 + at, rel=1e-3)


class TestAngles:
    def test_the_residual_is_the_polynomial_through_the_rows(self, found):
        data = found.problem.data[0]
        rows = SpeedMap(found.problem, found.noise[0], 0).without_nuisance(data.z - found.predictions[0].rows)
        rest, first = whole(found), 0
        for residual, run in zip(angle_residuals(found, 0), (data.casing, *data.rotor), strict=True):
            k = run.lift.shape[1]
            for block in {0, len(run.operators) - 1}:
                nodes = run.node_times.reshape(-1, k)[block]
                own = slice(first + block * k, first + (block + 1) * k)
                part = slice(block * 2 * k, (block + 1) * 2 * k)
                t = run.samples.time[run.operators[block][0]]
                assert residual.time[part] == pytest.approx(np.linspace(t[0], t[-1], 2 * k))
                to_angle = BarycentricInterpolator(nodes, np.linalg.inv(run.lift[block]))(residual.time[part])
                assert residual.value[part] == pytest.approx(to_angle @ rows[own], rel=1e-6, abs=1e-9)
                variance = np.diag(to_angle @ rest[own, own] @ to_angle.T)
                assert residual.sigma[part] == pytest.approx(np.sqrt(variance), rel=1e-3)
            first += len(run.z)

    def test_the_operator_returns_the_polynomial_of_each_block(self):
        run = uneven()
        times, operator = angles._values(run)
        for power in range(5):
            assert operator @ run.at_nodes(run.node_times**power) == pytest.approx(times**power)

    def test_it_is_measured_minus_modelled(self, found):
        """A parabola of the angle, apart from its mean, which is the zero of a run."""
        casing, *rotor = angle_residuals(found, 0)
        for residual, size in ((casing, 1e-3), *((r, -2e-3) for r in rotor)):
            expected = size * (residual.time - 3.0) ** 2
            difference = residual.value - expected
            assert np.ptp(difference) < 0.05 * np.ptp(expected)

    def test_its_ends_belong_to_it(self):
        residual = AngleResidual(np.array([1.0, 2.0]), np.array([3.0, 5.0]), np.array([0.1, 0.3]))
        value, sigma = residual.at(np.array([0.999, 1.0, 1.5, 2.0, 2.001]))
        assert value == pytest.approx([np.nan, 3.0, 4.0, 5.0, np.nan], nan_ok=True)
        assert sigma == pytest.approx([np.nan, 0.1, 0.2, 0.3, np.nan], nan_ok=True)
