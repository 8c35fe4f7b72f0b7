"""Figures of merit against their definitions and closed formulas; the distribution of the lack-of-fit test."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import twobody
from cases import fitted
from scipy.stats import chi2

from fitting import REDUCED, Model, fit, make_record
from fitting._criteria import DEFAULT
from fitting.dynamics._collocation import Mesh
from fitting.inference import _budget, _metrics
from fitting.inference._budget import propagated
from fitting.inference._case_data import CaseData
from fitting.inference._metrics import (
    BodyMetrics,
    CaseMetrics,
    EnergyBalance,
    chi2_per_row,
    energy_balance,
    median_noise,
    smoothing_noise,
)
from fitting.inference._noise import tail_probability
from fitting.inference._problem import Projection
from fitting.inference._process_noise import ProcessNoise
from fitting.inference._record import Samples


def parts(result, level):
    """Return the case, its noise, its prediction, and the well determined directions of the fit."""
    problem = result.problem
    data, p = problem.data[0], result.predictions[0]
    project = Projection(data, result.noise[0].whitener.at(level))
    columns = project.whitener(np.concatenate([data.nuisance, p.jacobian], axis=1))
    size = np.linalg.norm(columns, axis=0)
    u, s, _ = np.linalg.svd(columns[:, size > 0] / size[size > 0], full_matrices=False)
    used = u[:, s > 1e-4]
    residual = project.whitener(p.rows - data.z)
    return data, project, used, residual - used @ (used.T @ residual)


# a random torque of 1e-9 N m already correlates the rows, of 1e-10 N m those of the rotor, whose windows have noise of
# their own; more would be beyond the digits of this plain algebra
@pytest.mark.slow
@pytest.mark.parametrize(
    ("body", "level"), [("rotor", 0.0), ("rotor", 1e-10), ("casing", 0.0), ("casing", 1e-9)]
)
def test_cross_validation_error_is_that_of_a_fit_without_the_fold(level, body):
    """Least squares on the other rows, prediction of the fold with its covariance, computed explicitly."""
    data, project, used, residual = parts(fitted(seed=0, ou=1e-7, few=True), level)
    n = len(data.z)
    root = project.whitener(np.eye(n))  # C^-1/2
    back = np.linalg.inv(root)
    covariance, columns = back @ back, back @ used  # the same columns, orthonormal once they are whitened
    y = back @ residual  # what the columns explain has no part in it: start angles of 1e5 rad are gone
    folds = _metrics._casing_folds(data) if body == "casing" else _metrics._rotor_folds(data)
    for fold in folds[1:2]:
        rest = np.setdiff1d(np.arange(n), fold)
        inverse = np.linalg.inv(covariance[np.ix_(rest, rest)])
        x = columns[rest]
        known, directions = np.linalg.eigh(x.T @ inverse @ x)
        # what only the fold determines (the phase of its window) is left wide open
        normal = (directions / np.maximum(known, 1e-11)) @ directions.T
        beta = normal @ (x.T @ (inverse @ y[rest]))
        gain = covariance[np.ix_(fold, rest)] @ inverse
        error = y[fold] - columns[fold] @ beta - gain @ (y[rest] - x @ beta)
        spread = columns[fold] - gain @ x
        variance = covariance[np.ix_(fold, fold)] - gain @ covariance[np.ix_(rest, fold)]
        values, vectors = np.linalg.eigh(variance + spread @ normal @ spread.T)
        seen = vectors.T @ error
        keep = values < 1e10
        assert (body == "rotor") <= (~keep).sum() <= 2
        expected = float(np.sum(seen[keep] ** 2 / values[keep]))
        found = _metrics._error(project, used, project.whitener(residual), fold)
        assert found == pytest.approx(expected, rel=2e-3)


@pytest.mark.slow
def test_cross_validation_error_is_one_for_the_right_model_only():
    right, wrong = fitted(seed=0), fitted(seed=0, hidden="step")
    assert right.cases[0].casing.held_out == pytest.approx(1.0, abs=0.04)
    assert wrong.cases[0].casing.held_out > 2
    assert wrong.held_out_of_first_casing == wrong.cases[0].casing.held_out


def test_folds_contain_every_row_once():
    data = fitted(seed=0, few=True).problem.data[0]
    rows = np.concatenate([*_metrics._casing_folds(data), *_metrics._rotor_folds(data)])
    assert sorted(rows.tolist()) == list(range(data.slices["harmonic"].stop))  # and no prior


def test_energy_balance_of_the_right_model_is_constant():
    result = fitted(seed=0)
    balance = energy_balance(result.problem.cases[0], result.theta, result.predictions[0].path)
    start = 0.5 * (twobody.I_ROTOR * 900**2 + twobody.I_CASING * 5**2)
    assert balance.energy[0] == pytest.approx(start, rel=5e-3)
    assert balance.drift < 2e-4
    assert balance.drift == pytest.approx(np.max(np.abs(balance.energy / balance.energy[0] - 1)))


def test_energy_balance_agrees_with_the_formula_of_the_paper():
    """K + integral of [tau D + a2 w_r^3 + (b1 + b2 w_c) w_c] dt is constant: every term is a loss."""
    motion, p = twobody.simulate(), twobody.PAPER
    wr, wc = motion.speed.T
    diff = wr - wc
    tau = p["d"] * diff + p["f"] * diff ** p["g"]
    power = tau * diff + p["a2"] * wr**3 + (p["b1"] + p["b2"] * wc) * wc
    step = motion.time[1]
    lost = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * step)])
    total = 0.5 * (twobody.I_ROTOR * wr**2 + twobody.I_CASING * wc**2) + lost
    assert np.abs(total / total[0] - 1).max() < 1e-6


@pytest.mark.slow
def test_a_missing_torque_makes_the_energy_balance_drift():
    right, wrong = (fitted(seed=0, hidden=h, few=True) for h in ("nothing", "step"))
    assert wrong.cases[0].energy_drift > 1.5 * right.cases[0].energy_drift


RNG = np.random.default_rng(12)
ABSENT = BodyMetrics(*[math.nan] * 4)


class TestCaseMetrics:
    def made(self, per_row, rows, *, rotor=ABSENT, further=()):
        body = BodyMetrics(0.9, 1.0, 1.0, 1.0)
        return CaseMetrics("x", body, rotor, 0.0, per_row, rows, further)

    @pytest.mark.parametrize(
        ("per_row", "rows", "fails"),
        [(1.39, 10000, False), (1.41, 10000, True), (3.5, 12, False), (4.0, 12, True), (0.5, 10000, False)],
    )
    def test_chi_square_must_be_large_and_improbable(self, per_row, rows, fails):
        assert self.made(per_row, rows).fails(DEFAULT) is fails
        assert bool(per_row > 1.4 and chi2.sf(per_row * rows, rows) < 1e-5) is fails

    def test_absent_bodies_have_no_metrics(self):
        body = BodyMetrics(0.8, 2.0, 1.0, 1.0)
        assert len(self.made(1.0, 9).bodies) == 1
        assert self.made(1.0, 9, rotor=body, further=(body, ABSENT)).bodies[1:] == (body, body)
        assert self.made(4.0, 9).misfit == 2.0

    @pytest.mark.parametrize(("count", "columns", "rows"), [(10, 3, 7), (3, 3, 1), (2, 3, 1)])
    def test_rows_are_those_beside_the_nuisance_columns(self, count, columns, rows):
        project = SimpleNamespace(basis=np.zeros((9, columns)))
        data = SimpleNamespace(row_count=count)
        assert chi2_per_row(data, project, np.array([1.0, -2.0])) == (pytest.approx(5.0 / rows), rows)

    def test_the_drift_is_the_largest_change_of_either_sign(self):
        assert EnergyBalance(None, None, np.array([0.0, 0.1, -0.3])).drift == 0.3


class TestLackOfFit:
    def blocks(self, cases, absorbed=False):
        slow = [RNG.standard_normal((9, 3)) for _ in range(cases)]
        free = [RNG.standard_normal((9, 2)) for _ in range(cases)]
        if absorbed:
            free = [f * [1.0, 0.0] for f in free]
        return slow, free, [RNG.standard_normal(9) for _ in range(cases)]

    @pytest.mark.parametrize("cases", [1, 2, 6])
    @pytest.mark.parametrize("absorbed", [False, True])
    def test_both_ways_give_the_fall_of_chi_square(self, cases, absorbed):
        slow, free, residual = self.blocks(cases, absorbed)
        b, r = np.concatenate(free), np.concatenate(residual)
        whole = np.zeros((9 * cases, 3 * cases))
        for i, s in enumerate(slow):
            whole[9 * i : 9 * i + 9, 3 * i : 3 * i + 3] = s

        def rest(columns):
            return float(np.sum((r - columns @ np.linalg.lstsq(columns, r, rcond=None)[0]) ** 2))

        expected = rest(b) - rest(np.concatenate([b, whole], axis=1))
        for found, dof in (
            _metrics._together(slow, free, residual),
            _metrics._case_by_case(slow, free, residual),
        ):
            assert found == pytest.approx(expected, rel=1e-6)
            assert dof == 3 * cases

    def test_torques_of_the_model_are_not_tested(self):
        slow, free, residual = self.blocks(2)
        free = [np.column_stack([f, s[:, 0]]) for f, s in zip(free, slow, strict=True)]
        assert _metrics._together(slow, free, residual)[1] == 5
        assert _metrics._case_by_case(slow, free, residual)[1] == 5


class TestNoise:
    def test_a_median_of_steep_gradients_is_the_middle_one(self):
        """With a cut-off far above the noise, each gradient has its own variance, and neighbours cancel it."""
        assert float(median_noise(np.array([5.0]))[0]) == pytest.approx(0.0, abs=1e-3)
        low, lowest = median_noise(np.array([0.02, 0.001]))
        assert low == lowest
        # with a cut-off far below the noise it is the median of correlated signs: pi / 2 (1 - 4 / pi asin(1 / 2))
        assert low == pytest.approx(math.pi / 2 * (1 - 4 / math.pi * math.asin(0.5)), rel=0.05)

    def test_it_is_the_error_of_the_smoothed_speed(self, monkeypatch):
        t = np.linspace(0.0, 10.0, 4000)
        rng = np.random.default_rng(0)
        sigma = np.full(4000, 2.0)
        data = SimpleNamespace(
            record=SimpleNamespace(
                casing=Samples(t, 3 * t + 0.6 * rng.standard_normal(4000), sigma), quantity="x"
            ),
            smoothing_width=5,
        )
        monkeypatch.setattr(_metrics, "_model_at", lambda data, path, state, times: 3 * times)
        monkeypatch.setattr(_metrics, "speeds", lambda run, quantity, width: (run.time, run.value))
        assert smoothing_noise(data, None) == pytest.approx(0.6, rel=0.04)


class TestFolds:
    def data(self, chain):
        casing = SimpleNamespace(lift=np.zeros((7, 2, 4)), harmonic=np.zeros(7))
        runs = [
            SimpleNamespace(z=np.zeros(n), samples=SimpleNamespace(state=s), lift=np.zeros((3, 1, 1)))
            for n, s in ((3, 0), (3, 2), (3, 0))
        ]
        mechanism = SimpleNamespace(main="wheel", bodies=("motor", "wheel", "pump"))
        record = SimpleNamespace(mechanism=mechanism, is_chain=chain)
        slices = {"harmonic": slice(23, 30), "rotor": slice(14, 23)}
        return SimpleNamespace(record=record, casing=casing, rotor=runs, slices=slices)

    def test_the_casing_has_six_intervals_with_their_harmonics(self):
        (name, runs, folds), *_ = _metrics._folds(self.data(chain=False))
        assert (name, len(runs), len(folds)) == ("wheel", 1, 6)
        assert folds[0].tolist() == [0, 1, 2, 3, 23, 24]
        assert folds[5].tolist() == [12, 13, 29]

    def test_a_window_is_a_fold_and_in_a_chain_each_part_of_it(self):
        _, motor, pump = _metrics._folds(self.data(chain=False))
        assert [f.tolist() for f in motor[2]] == [[14, 15, 16], [20, 21, 22]]
        assert (pump[0], [f.tolist() for f in pump[2]]) == ("pump", [[17, 18, 19]])
        _, motor, pump = _metrics._folds(self.data(chain=True))
        assert [f.tolist() for f in pump[2]] == [[17], [18], [19]]
        assert len(motor[2]) == 6


class TestEnergy:
    """A casing of 2 kg m2 that slows down at 0.5 rad/s2 from a speed, beside a rotor of 3 kg m2 at rest."""

    def case(self, first, decay=0.5, inputs=False):
        t = np.linspace(0.0, 4.0, 200)
        omega = first - 0.5 * t
        mesh = Mesh.uniform(0.0, 4.0, 4)
        y = np.stack([0 * mesh.times, first - 0.5 * mesh.times], axis=-1)
        dynamics = SimpleNamespace(
            mechanism=SimpleNamespace(main="casing", inertias=("r", "c")),
            states=("omega_r", "omega_c"),
            rates=lambda t, y, numbers: np.stack([0 * t, -decay + 0 * t], axis=1),
        )
        smooth = SimpleNamespace(effects=[SimpleNamespace(inputs=inputs)])
        smooth.with_only = lambda effects: list(effects)
        layout = SimpleNamespace(
            numbers=lambda theta, case: {"r": 3.0, "c": 2.0}, model=SimpleNamespace(smooth=smooth)
        )
        made = SimpleNamespace(
            dynamics=dynamics, layout=layout, case=0, data=SimpleNamespace(speeds={"casing": (t, omega)})
        )
        return made, SimpleNamespace(mesh=mesh, y=y)

    def test_the_right_torque_keeps_kinetic_energy_and_losses(self):
        found = energy_balance(*self.fit(5.0))
        assert found.energy == pytest.approx(np.full(200, 25.0), rel=1e-6)
        assert found.drift < 1e-6
        assert (found.time[0], found.time[-1], len(found.time)) == (0.0, 4.0, 200)

    def fit(self, *given, **more):
        case, path = self.case(*given, **more)
        return case, None, path

    def test_a_missing_torque_is_a_change_of_the_initial_energy(self):
        found = energy_balance(*self.fit(5.0, 0.25))
        # half of the loss of 25 - 9 J is missing
        assert found.change[-1] == pytest.approx(-8.0 / 25.0, rel=1e-3)

    @pytest.mark.parametrize(("first", "scale"), [(0.6, 1.96), (0.4, 2.56), (0.7, 1.69)])
    def test_after_a_turning_point_the_largest_energy_counts(self, first, scale):
        """The energies at the ends are first^2 and (first - 2)^2; a tenth of the largest decides."""
        found = energy_balance(*self.fit(first, 0.0))
        last = (first - 2.0) ** 2
        unit = first**2 if first**2 > 0.1 * last else last
        assert unit == pytest.approx(scale if first**2 <= 0.1 * last else first**2)
        assert found.change[-1] == pytest.approx((last - first**2) / unit, rel=1e-6)

    def test_of_a_driven_body_the_losses_count(self, monkeypatch):
        def rest(effects):
            assert effects == []
            return SimpleNamespace(
                states=("omega_r", "omega_c"),
                rates=lambda t, y, numbers: np.stack([0 * t, -5.0 + 0 * t], axis=1),
            )

        monkeypatch.setattr(_metrics, "Dynamics", rest)
        found = energy_balance(*self.fit(5.0, 0.25, inputs=True))
        # the friction of 10 N m takes 10 x 16 J
        assert found.change[-1] == pytest.approx(-8.0 / 160.0, rel=1e-3)


class TestBudget:
    def test_inputs_of_a_polynomial_are_propagated_with_their_interaction(self):
        """4 + 3 x + 2 y + 5 x y with the uncertainties 0.1 and 0.2."""
        node = np.array([-math.sqrt(3), 0.0, math.sqrt(3)])
        x, y = np.meshgrid(0.1 * node, 0.2 * node, indexing="ij")
        found = propagated((4 + 3 * x + 2 * y + 5 * x * y)[..., None], [("x", 0.1), ("y", 0.2)])
        assert found["x"][0] == pytest.approx([0.3])
        assert found["y"][0] == pytest.approx([0.4])
        assert found["x x y"][0] == pytest.approx([0.1])
        assert (found["x"][1], found["y"][1], found["x x y"][1]) == (
            pytest.approx([3.0]),
            pytest.approx([2.0]),
            None,
        )
        (alone,) = propagated((7.0 + 3 * 0.1 * node + (0.1 * node) ** 2)[:, None], [("x", 0.1)]).items()
        assert alone[0] == "x"
        assert alone[1][0] == pytest.approx([math.sqrt(0.09 + 2 * 0.01**2)])
        assert alone[1][1] == pytest.approx([3.0])

    def fit(self, *records, prior=()):
        data = [SimpleNamespace(prior=SimpleNamespace(names=prior) if prior else None)]
        return SimpleNamespace(problem=SimpleNamespace(layout=SimpleNamespace(records=records), data=data))

    def record(self, label, rotor, casing):
        bodies = [
            SimpleNamespace(part=part, inertia=value, inertia_u=u)
            for part, (value, u) in (("casing", casing), ("rotor", rotor))
        ]
        return SimpleNamespace(label=label, bodies=bodies)

    def test_equal_moments_of_inertia_are_one_input(self):
        one = self.record("a", (2.0, 0.1), (3.0, math.nan))
        other = self.record("b", (2.0, 0.1), (4.0, 0.2))
        assert list(_budget._inertias(self.fit(one))) == [("inertia.rotor", "rotor", 2.0, 0.1)]
        assert list(_budget._inertias(self.fit(one, other))) == [
            ("inertia.rotor", "rotor", 2.0, 0.1),
            ("inertia.casing@b", "casing", 4.0, 0.2),
        ]
        certain = self.record("c", (2.0, 0.0), (3.0, 0.3))
        assert list(_budget._inertias(self.fit(certain))) == [("inertia.casing", "casing", 3.0, 0.3)]
        known = self.record("d", (2.0, 0.1), (3.0, 0.3))
        assert [i[1] for i in _budget._inertias(self.fit(known))] == ["rotor", "casing"]
        assert [i[1] for i in _budget._inertias(self.fit(known, prior=(_budget.INERTIA_RATIO,)))] == ["rotor"]

    def test_a_sensitivity_is_that_of_least_squares(self):
        j, change = RNG.standard_normal((6, 2)), RNG.standard_normal(6)
        made = object.__new__(_budget._Linearised)
        made.fit = SimpleNamespace(theta=np.zeros(2), predictions=[SimpleNamespace(jacobian=j)])
        made.problem = SimpleNamespace(projections=[lambda x: 2.0 * x])
        made.covariance = np.linalg.inv(4.0 * j.T @ j)
        # larger modelled rows are compensated by a change of the parameters
        assert made.sensitivity([change]) == pytest.approx(-np.linalg.lstsq(j, change, rcond=None)[0])

    @pytest.mark.parametrize(("count", "sizes"), [(0, []), (1, [1]), (2, [2]), (3, [1, 1, 1])])
    def test_two_moments_of_inertia_are_propagated_together(self, monkeypatch, count, sizes):
        inputs = [(f"i{k}", "rotor", float(k + 1), 0.1) for k in range(count)]
        moved = []
        monkeypatch.setattr(_budget, "_inertias", lambda fit: iter(inputs))
        monkeypatch.setattr(
            _budget, "_refitted", lambda fit, m: moved.append(m) or np.array([sum(m.values())])
        )
        found = _budget._inertia_contributions(SimpleNamespace(theta=np.zeros(1)))
        assert len(moved) == sum(3**n for n in sizes)
        assert {len(m) for m in moved} == set(sizes)
        for name, *_ in inputs:
            assert found[name][0] == pytest.approx([0.1])
            assert found[name][1] == pytest.approx([1.0])
        assert ("i0 x i1" in found) is (count == 2)


class TestCrossValidation:
    """Two runs of a rotor and one of a casing: 12 blocks of three rows, and a harmonic row of each block."""

    BLOCKS, WINDOWS = 12, (4, 6)
    ROWS = 12 * 4 + sum(WINDOWS)

    def data(self, chain=False):
        lift = SimpleNamespace(shape=(self.BLOCKS, 3, 9))
        casing = SimpleNamespace(lift=lift, harmonic=np.zeros(self.BLOCKS), rest=7.0, n_effective=55.0)
        windows = [
            SimpleNamespace(
                z=np.zeros(n), lift=np.zeros(n), rest=n / 2, n_effective=2.0 * n,
                samples=SimpleNamespace(state=0),
            )
            for n in self.WINDOWS
        ]  # fmt: skip
        mechanism = SimpleNamespace(main="casing", bodies=("rotor", "casing", "wheel"))
        record = SimpleNamespace(mechanism=mechanism, is_chain=chain)
        slices = {"rotor": slice(36, 46), "harmonic": slice(46, 58)}
        return SimpleNamespace(
            casing=casing, rotor=windows, slices=slices, record=record, z=RNG.standard_normal(self.ROWS)
        )

    def folds(self, chain):
        blocks = np.arange(12).reshape(6, 2)
        casing = [np.concatenate([*(np.arange(3) + 3 * b for b in pair), 46 + pair]) for pair in blocks]
        rows = [np.arange(36, 40), np.arange(40, 46)]
        if chain:
            rows = [np.array([k]) for k in range(36, 46)]
        return {"casing": casing, "rotor": rows}

    @pytest.mark.parametrize("chain", [False, True])
    def test_the_error_is_that_of_rows_predicted_from_all_others(self, chain):
        data = self.data(chain)
        scale = RNG.uniform(0.5, 2.0, self.ROWS)  # 1 / noise of the rows
        white = lambda rows: (rows.T * scale).T  # noqa: E731
        nuisance, jacobian = RNG.standard_normal((self.ROWS, 2)), RNG.standard_normal((self.ROWS, 3))
        jacobian[:, 1] = 0.0  # a parameter without influence
        basis = np.linalg.qr(white(nuisance))[0]

        class Project:
            whitener = staticmethod(white)

            def __init__(self):
                self.basis = basis

            def __call__(self, rows):
                rows = white(rows)
                return rows - basis @ (basis.T @ rows)

        prediction = SimpleNamespace(columns=jacobian, rows=RNG.standard_normal(self.ROWS))
        found = _metrics.held_out(data, Project(), prediction)
        y = data.z - prediction.rows
        x, sigma = np.concatenate([nuisance, jacobian[:, [0, 2]]], axis=1), 1 / scale
        rest = {"casing": (7.0, 55.0), "rotor": (5.0, 20.0)}
        for body, folds in self.folds(chain).items():
            total, samples = rest[body]
            for fold in folds:
                others = np.setdiff1d(np.arange(self.ROWS), fold)
                weighted = x[others] / sigma[others, None]
                beta = np.linalg.lstsq(weighted, y[others] / sigma[others], rcond=None)[0]
                error = y[fold] - x[fold] @ beta
                spread = x[fold] @ np.linalg.inv(weighted.T @ weighted) @ x[fold].T
                total += error @ np.linalg.solve(np.diag(sigma[fold] ** 2) + spread, error)
            assert found[body] == pytest.approx(np.sqrt(total / samples))
        assert set(found) == {"casing", "rotor"}
        assert set(_metrics.held_out(data, Project(), prediction, ["rotor"])) == {"rotor"}


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_tail_probability_agrees_with_draws_of_an_uncertain_level(share):
    """Chi-square of 5 normal variables, a share of their variance scaled by a random factor."""
    rng = np.random.default_rng(0)
    ratios, weights = np.array([0.3, 1.0, 2.5]), np.array([0.3, 0.5, 0.2])
    noise = SimpleNamespace(process=ProcessNoise(1.0, 0.5, 1.0, 0.1, ratios, weights))
    scale = 1 - share + share * rng.choice(ratios, 200_000, p=weights)
    drawn = scale * rng.chisquare(5, 200_000)
    for p in (0.5, 1e-1, 1e-2):
        found = float(tail_probability(np.quantile(drawn, 1 - p), 5, [noise], [share]))
        assert found == pytest.approx(p, rel=0.08)


def test_chi_square_of_slow_torques_is_the_fall_beyond_the_parameters_of_the_fit():
    """Two cases with common parameters: the fall from the fit alone to a fit with the slow torques of each case."""
    rng = np.random.default_rng(3)
    free = [rng.normal(size=(12, 2)) for _ in range(2)]
    slow = [np.column_stack([rng.normal(size=12), f[:, 0]]) for f in free]
    slow[1] = slow[1][:, 1:]
    residual = [rng.normal(size=12) for _ in range(2)]
    common, r = np.concatenate(free), np.concatenate(residual)
    tested = np.zeros((24, 3))
    tested[:12, :2], tested[12:, 2:] = slow

    def chi2(columns):
        return float(np.sum((r - columns @ np.linalg.lstsq(columns, r)[0]) ** 2))

    # the sum of the first parameter's columns in both cases is in the fit already
    assert _metrics._together(slow, free, residual) == (
        pytest.approx(chi2(common) - chi2(np.hstack([common, tested]))),
        2,
    )


def found(hidden, seed, model=REDUCED):
    motion = twobody.simulate(hidden=hidden, ou=1e-7, seed=seed)
    return fit(Model.of(model), [CaseData.of(make_record(**twobody.film(motion, seed)))])


@pytest.mark.slow
@pytest.mark.release
def test_lack_of_fit_of_noise_has_the_expected_distribution():
    lacks = [found(twobody.Hidden(), seed).lack_of_fit for seed in range(4)]
    chi2, dof = sum(x.chi2 for x in lacks), sum(x.dof for x in lacks)
    assert abs(chi2 - dof) < 5 * math.sqrt(2 * dof)
    assert min(x.p_value for x in lacks) > 1e-5


@pytest.mark.slow
def test_a_law_of_the_wrong_shape_has_a_lack_of_fit():
    """A drag at one speed only, hidden; a step of the friction is the best that the library has."""
    hidden = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -2e-6 * np.exp(-(((wc - 110) / 12) ** 2)))
    fitted = found(hidden, 1, (*REDUCED, "touchpoint.step"))
    assert fitted.lack_of_fit.p_value < 1e-3
    assert fitted.verdict == "lack_of_fit"


@pytest.mark.parametrize(
    ("error", "r2", "rmse"),
    [
        ([0.0, 0.0, 0.0, 0.0], 1.0, 0.0),
        ([1.0, -1.0, 1.0, -1.0], 0.8, 1.0),
        ([3.0, 1.0, -1.0, -3.0], 0.0, math.sqrt(5.0)),  # as poor as the mean speed
        ([6.0, 2.0, -2.0, -6.0], -3.0, math.sqrt(20.0)),
    ],
)
def test_the_share_of_explained_speed_is_about_its_mean(monkeypatch, error, r2, rmse):
    """Speeds of 97 to 103 rad/s: a sum of squares of 20 about the mean."""
    y = np.array([103.0, 101.0, 99.0, 97.0])
    monkeypatch.setattr(_metrics, "_smoothed_model", lambda *_: y - error)
    case = SimpleNamespace(data=SimpleNamespace(speeds={"casing": (None, y)}))
    found = _metrics._speed_quality(case, None, None, SimpleNamespace(part="casing"))
    assert found == pytest.approx((r2, rmse))


def test_a_constant_speed_has_no_share(monkeypatch):
    y = np.full(4, 100.0)
    monkeypatch.setattr(_metrics, "_smoothed_model", lambda *_: y - 2.0)
    case = SimpleNamespace(data=SimpleNamespace(speeds={"casing": (None, y)}))
    assert _metrics._speed_quality(case, None, None, SimpleNamespace(part="casing")) == (0.0, 2.0)
