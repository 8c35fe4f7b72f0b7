"""The score test against generalised least squares, its columns against differences, its p-values against formulas."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from linearised import BEGIN, SPAN, covariance, gyroscope, least_squares
from scipy.linalg import block_diag
from scipy.stats import chi2

from fitting import LIBRARY, LINEAR
from fitting._criteria import DEFAULT
from fitting.discovery import _score as module
from fitting.discovery._score import (
    CaseColumns,
    FamilywiseNull,
    NullDistribution,
    Score,
    ScoreContext,
    Trial,
    best_group,
    has_phases,
    rows_of_case,
    score,
    score_of_columns,
    stacked,
)
from fitting.effects._user import resolve
from fitting.inference._multiple_tests import over_many_tests

# effect, strength of the difference, shape constants
LAWS = [
    ("casing.air.quadratic", 1e-9, {}),
    ("bearing.quadratic", 1e-10, {}),
    ("rotor.air.linear", 1e-9, {}),
    ("casing.windage", 1e-10, {}),
    ("touchpoint.stribeck", 1e-6, {"w": 30.0}),
    ("touchpoint.step", 1e-6, {"t0": 5.123}),
    ("touchpoint.step", 1e-6, {"t0": 9.001}),
    ("casing.seal.cooling", 1e-6, {"tau_T": 3.0}),
    ("bearing.heating", 1e-5, {"tau_T": 0.7}),
    ("bearing.drift", 1e-4, {}),
    ("setup.inertia", 1e-4, {}),
    ("casing.precession", 1e-6, {"m": 1000.0}),
]


class TestColumns:
    @pytest.mark.parametrize(("name", "strength", "shape"), LAWS)
    def test_they_are_the_derivatives_of_the_rows_by_the_strength(self, name, strength, shape):
        effect, base = LIBRARY[name], gyroscope()
        (trial,) = CaseColumns(base, 0).trials(effect, [shape])
        assert trial.shape == shape
        key = f"{name}.{effect.amplitude.symbol}"
        held = {f"{name}.{k}": v for k, v in shape.items()}
        for column, phase in zip(trial.columns.T, (0.0, math.pi / 2), strict=False):
            up, down = (
                gyroscope((*LINEAR, name), held | {key: k, f"{name}.phi": phase}).predictions[0].rows
                for k in (strength, -strength)
            )
            exact = (up - down) / (2 * strength)
            assert np.linalg.norm(column - exact) < 2e-3 * np.linalg.norm(exact)
        assert trial.columns.shape[1] == (2 if name == "casing.precession" else 1)

    def test_a_torque_acts_on_its_body_and_in_the_bearing_on_both(self):
        columns = CaseColumns(gyroscope(), 0)
        for name, shares in (
            ("casing.air.quadratic", (0, 1)),
            ("rotor.air.linear", (1, 0)),
            ("bearing.constant", (-1, 1)),
        ):
            unit = columns._units(LIBRARY[name], [{}])
            for torque, share in zip(columns.torque(LIBRARY[name], {}), shares, strict=True):
                assert torque == pytest.approx(share * unit)

    def test_a_delay_of_an_input_is_a_torque_of_the_accelerations_that_it_changes(self):
        columns, asked = CaseColumns(gyroscope(), 0), []
        rates = np.arange(2.0 * len(columns.response.centres)).reshape(-1, 2)
        mechanism = columns.case.dynamics.mechanism
        dynamics = SimpleNamespace(mechanism=mechanism, by_delay=lambda *given: asked.append(given) or rates)
        columns.case = SimpleNamespace(dynamics=dynamics, data=columns.case.data)
        delay = SimpleNamespace(
            joint="input", inputs=(("drive", "N m"),), mechanical=True, depends_on_angle=False
        )
        rotor, casing = columns.torque(delay, {})
        record = columns.case.data.record
        assert rotor == pytest.approx(record.I_rotor * rates[:, :1])
        assert casing == pytest.approx(record.I_casing * rates[:, 1:])
        ((name, times, edges, y, numbers),) = asked
        assert name == "drive"
        assert times == pytest.approx(columns.response.centres)
        assert edges == pytest.approx(columns.response.edges)
        assert y == pytest.approx(columns._states_of_motion)
        assert numbers is columns.numbers
        (trial,) = columns.trials(delay, [{}])
        assert trial.shape == {}
        assert trial.columns == pytest.approx(columns.torque_rows(rotor, casing))

    def test_typical_torques_are_those_of_the_bearing(self):
        """0.2 uN m s times the difference of the speeds."""
        columns = CaseColumns(gyroscope(), 0)
        delta = columns.along_motion("omega_r") - columns.along_motion("omega_c")
        assert columns.typical_torque == pytest.approx(2e-7 * delta)
        assert columns.along_motion("t") == pytest.approx(columns.response.centres)

    def test_the_grid_of_a_changepoint_is_eight_times_finer(self):
        columns, effect = CaseColumns(gyroscope(), 0), LIBRARY["touchpoint.step"]
        (_, moment) = effect.parameters
        grid = columns._grid(effect, moment)
        declared = BEGIN + np.array(moment.grid) * SPAN
        assert grid[::8] == pytest.approx(declared)
        assert len(grid) == 8 * (len(declared) - 1) + 1
        assert np.diff(grid)[:8] == pytest.approx(np.full(8, (declared[1] - declared[0]) / 8))

    def test_the_cell_of_a_changepoint_has_the_mean_of_the_two_sides(self):
        columns, step = CaseColumns(gyroscope(), 0), LIBRARY["touchpoint.step"]
        constant = columns._units(LIBRARY["touchpoint.constant"], [{}])[:, 0]
        low, high = columns.response.edges[[40, 41]]
        for share in (0.2, 0.9):  # of the cell before the changepoint
            unit = columns._units(step, [{"t0": low + share * (high - low)}])[:, 0]
            assert unit[40] == pytest.approx((1 - share) * constant[40], rel=2e-3)
            turned = replace(step, law="-k*heaviside(t0 - t)*sign(omega_c)")
            rest = columns._units(turned, [{"t0": low + share * (high - low)}])[:, 0]
            assert rest == pytest.approx(constant - unit, rel=2e-3, abs=1e-9)

    def test_a_changepoint_outside_of_the_record_is_always_or_never(self):
        columns, step, constant = (
            CaseColumns(gyroscope(), 0),
            LIBRARY["touchpoint.step"],
            LIBRARY["touchpoint.constant"],
        )
        before, after = (columns._units(step, [{"t0": t}])[:, 0] for t in (BEGIN - 1.0, BEGIN + SPAN + 1.0))
        assert before == pytest.approx(columns._units(constant, [{}])[:, 0])
        assert after == pytest.approx(np.zeros(len(after)))

    def test_other_grids_are_as_declared(self):
        columns = CaseColumns(gyroscope(), 0)
        speed = gyroscope().problem.layout.records[0].largest_speeds["omega_c"]
        for name, factor in (("touchpoint.stribeck", speed), ("bearing.heating", SPAN)):
            shape = next(p for p in LIBRARY[name].parameters if p.role == "shape")
            (scaled,) = (p for p in columns.parameters(LIBRARY[name]) if p.role == "shape")
            assert columns._grid(LIBRARY[name], scaled) == pytest.approx(factor * np.array(shape.grid))
            assert scaled.upper == pytest.approx(factor * shape.upper)

    def test_frequencies_are_as_fine_as_the_record_is_long(self):
        """Phases over the record are 1.5 rad apart, and one radian per cell is the largest phase."""
        columns, effect = CaseColumns(gyroscope(), 0), LIBRARY["casing.precession"]
        shape = next(p for p in effect.parameters if p.role == "shape")
        grid = columns._grid(effect, shape)
        phase = columns._states(effect, effect.state, effect.rates[0], {"m": grid})
        steps = np.diff(np.ptp(phase, axis=0))
        assert steps == pytest.approx(np.full(len(steps), steps[0]))
        assert 1.5 <= steps[0] < 1.7
        assert np.abs(np.diff(phase, axis=0)).max() == pytest.approx(1.0)

    def test_a_law_of_an_angle_has_columns_of_its_phases(self):
        columns = CaseColumns(gyroscope(), 0)
        pair = np.ones(7), np.full(7, 2.0)
        columns.case = SimpleNamespace(unit_columns=lambda *_: pair)
        for name, width in (("casing.unbalance", 2), ("camera.clock", 1)):
            (trial,) = columns.trials(LIBRARY[name])
            assert trial.columns.tolist() == [[1.0, 2.0][:width]] * 7
            assert trial.shape == {}

    def test_about_an_equilibrium_it_is_a_torque_of_the_deflection(self):
        columns, unbalance = CaseColumns(gyroscope(), 0), LIBRARY["casing.unbalance"]
        (plain,) = columns.trials(unbalance)
        columns._restoring = True
        deflection = columns._known["deflection"]
        (about,) = columns.trials(unbalance)
        unit = np.stack([np.sin(deflection), -np.cos(deflection)], axis=1)
        expected = columns.torque_rows(np.zeros_like(unit), unit)
        assert about.columns == pytest.approx(expected)
        assert plain.columns != pytest.approx(expected)

    def test_the_torques_of_a_fitted_law_are_those_of_its_phase(self):
        columns, law = CaseColumns(gyroscope(), 0), LIBRARY["casing.precession"]
        columns.numbers = {f"{law.name}.k": 3.0, f"{law.name}.phi": 0.4, f"{law.name}.m": 900.0}
        shape, strengths = columns.fitted(law)
        assert shape == {"m": 900.0}
        assert strengths == pytest.approx([3.0 * math.cos(0.4), 3.0 * math.sin(0.4)])
        heating = LIBRARY["bearing.heating"]
        columns.numbers = {f"{heating.name}.{k}": x for k, x in (("k", 2.0), ("C", 5.0), ("tau_T", 7.0))}
        shape, strengths = columns.fitted(heating)
        assert shape == {"C": 5.0, "tau_T": 7.0}
        assert strengths == pytest.approx([2.0, 0.0])

    def test_a_choice_with_which_a_law_is_singular_is_not_tested(self):
        columns, law = CaseColumns(gyroscope(), 0), resolve("casing: k*(omega_c - w)**0.5")
        speed = columns.along_motion("omega_c")
        middle = float(np.median(speed))
        unit = columns._units(law, [{"w": middle}, {"w": speed.min() - 1.0}])
        assert not unit[:, 0].any()
        assert unit[:, 1] == pytest.approx(np.sqrt(speed - speed.min() + 1.0))

    def test_more_choices_than_are_evaluated_at_once(self):
        columns, law = CaseColumns(gyroscope(), 0), resolve("casing: k*omega_c**w")
        shapes = [{"w": 1.0 + 0.01 * i} for i in range(129)]
        unit = columns._units(law, shapes)
        speed = columns.along_motion("omega_c")[:, None]
        assert unit == pytest.approx(speed ** np.array([s["w"] for s in shapes]))

    def test_the_typical_torque_of_a_body_alone_is_the_net_torque(self):
        columns = CaseColumns(gyroscope(), 0)
        columns.case = SimpleNamespace(
            data=SimpleNamespace(record=SimpleNamespace(spun=SimpleNamespace(role="body")))
        )
        omega_r, omega_c = (columns.along_motion(n) for n in ("omega_r", "omega_c"))
        net = 2e-7 * (omega_r - omega_c) - 1e-5 - 1e-6 * omega_c
        assert columns.typical_torque == pytest.approx(net)


def residual(rows, seed=3):
    return np.random.default_rng(seed).standard_normal(rows) * 2.0


def stood(level, *, raised=False, sign=1.0, **options):
    """Return a base whose residuals are noise and some drag, of a strength of 1e-9 N m s2 and either sign."""
    plain = gyroscope(level=level, **options)
    drag = CaseColumns(plain, 0).trials(LIBRARY["casing.air.quadratic"])[0].columns[:, 0]
    rows = residual(len(drag)) + sign * 1e-8 * drag
    return gyroscope(level=level, raised=raised, residual=[rows], **options)


def free_columns(base):
    return np.concatenate([base.predictions[0].jacobian, base.problem.data[0].nuisance], axis=1)


class TestScore:
    """Of a drag of the casing beside free friction, against two fits by generalised least squares."""

    effect = LIBRARY["casing.air.quadratic"]

    def columns(self, base):
        return CaseColumns(base, 0).trials(self.effect)

    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_score_and_strength_are_those_of_least_squares(self, sign):
        base = stood(1e-7, sign=sign)
        (trial,) = self.columns(base)
        (found,) = score(base, [self.effect], [CaseColumns(base, 0)], DEFAULT, draws=2)
        rows, free, c = (
            base.problem.data[0].z - base.predictions[0].rows,
            free_columns(base),
            covariance(base, 1e-7),
        )
        before, _ = least_squares(free, rows, c)
        after, values = least_squares(np.column_stack([free, trial.columns]), rows, c)
        assert np.sign(values[-1]) == sign
        if sign > 0:
            assert found.score == pytest.approx(before - after, rel=1e-6)
            assert found.gamma[0] == pytest.approx(values[-1], rel=1e-6)
        else:  # friction is not negative
            assert found.score == 0.0
        assert (found.columns, found.trials, found.absorbed) == (1, 1, False)

    def test_the_level_is_profiled_with_and_without_the_effect(self):
        base = stood(1e-6, raised=True)
        (trial,) = self.columns(base)
        rows, free = base.problem.data[0].z - base.predictions[0].rows, free_columns(base)
        levels = 1e-7 * 10 ** np.linspace(0.0, 1.0, 9)

        def least(columns):
            each = []
            for level in levels:
                c = covariance(base, level)
                each.append(least_squares(columns, rows, c)[0] + np.linalg.slogdet(c)[1])
            return min(each)

        expected = least(free) - least(np.column_stack([free, trial.columns]))
        context = ScoreContext(base, 2)
        assert len(context.levels) == 9
        found = best_group(context, self.effect, rows_of_case(context, [trial], 0), context.levels)
        assert found.score == pytest.approx(expected, rel=1e-6)
        assert score_of_columns(context, trial.columns) == pytest.approx(expected, rel=1e-6)
        assert found.shares == (0.0,)  # a raised level is no process noise

    def test_the_share_of_the_process_noise_is_that_of_the_variance(self):
        base = stood(1e-7)
        context = ScoreContext(base, 2)
        found = best_group(context, self.effect, rows_of_case(context, self.columns(base), 0), context.levels)
        assert np.linalg.norm(found.direction) == pytest.approx(1.0)
        # along the principal axes the whitened variance of the process noise is t / (1 + t)
        t = 1e-14 * base.noise[0].whitener.values
        assert found.shares[0] == pytest.approx(found.direction[: len(t)] ** 2 @ (t / (1 + t)))
        assert 0.0 < found.shares[0] < 1.0

    def test_null_scores_are_those_of_white_rows(self):
        base = stood(1e-7)
        context = ScoreContext(base, 400)
        found = best_group(
            context,
            LIBRARY["external.constant"],
            rows_of_case(context, self.columns(base), 0),
            context.levels,
        )
        assert found.null == pytest.approx((found.direction @ context.draws) ** 2)
        assert found.null.mean() == pytest.approx(1.0, abs=0.2)
        friction = best_group(
            context, self.effect, rows_of_case(context, self.columns(base), 0), context.levels
        )
        assert (friction.null == 0).mean() == pytest.approx(0.5, abs=0.1)

    def test_what_the_base_absorbs_has_no_score(self):
        base = stood(1e-7)
        context = ScoreContext(base, 2)
        trials = CaseColumns(base, 0).trials(LIBRARY["external.constant"])
        found = best_group(
            context, LIBRARY["external.constant"], rows_of_case(context, trials, 0), context.levels
        )
        assert found.absorbed
        assert found.score == 0.0

    def test_the_best_of_several_trials_is_taken(self):
        base = stood(1e-7)
        context = ScoreContext(base, 2)
        (right,) = self.columns(base)
        wrong = Trial({"w": 1.0}, residual(len(right.columns), 9)[:, None])
        right = Trial({"w": 2.0}, right.columns)
        found = best_group(
            context, self.effect, rows_of_case(context, [wrong, right], 0), context.levels, null=False
        )
        assert found.shape == ({"w": 2.0},)
        assert found.trials == 2
        assert len(found.null) == 0

    def test_the_change_of_the_base_when_rows_are_added_to_it(self):
        base = stood(1e-7)
        added = residual(len(base.predictions[0].rows), 5)
        rows = base.problem.data[0].z - base.predictions[0].rows - added
        _, values = least_squares(free_columns(base), rows, covariance(base, 1e-7))
        assert ScoreContext(base, 2).base_change(added) == pytest.approx(values[: len(base.theta)], rel=1e-5)

    def test_the_change_of_the_base_is_that_at_the_level_of_the_fit(self):
        base = stood(1e-6, raised=True)
        none = np.zeros(len(base.predictions[0].rows))
        rows = base.problem.data[0].z - base.predictions[0].rows
        _, values = least_squares(free_columns(base), rows, covariance(base, 1e-6))
        assert ScoreContext(base, 2).base_change(none) == pytest.approx(values[: len(base.theta)], rel=1e-5)

    def test_a_parameter_that_the_cases_share_counts_once(self):
        key = "bearing.linear.d"
        plain = gyroscope(cases=("a", "b"), level=1e-7, per_case=(key,))
        rows = [residual(len(p.rows), i) for i, p in enumerate(plain.predictions)]
        base = gyroscope(cases=("a", "b"), level=1e-7, per_case=(key,), residual=rows)
        names = base.problem.layout.names
        own = [i for i, n in enumerate(names) if n.startswith(key)]
        assert len(own) == 2
        jacobian = np.concatenate([p.jacobian for p in base.predictions])
        common = jacobian[:, own].sum(axis=1, keepdims=True)
        nuisance = block_diag(*(d.nuisance for d in base.problem.data))
        columns = np.concatenate([np.delete(jacobian, own, axis=1), common, nuisance], axis=1)
        everything = np.column_stack([columns, np.concatenate(rows)])
        parts, determinant = [], 0.0
        for i, part in enumerate(np.split(everything, [len(rows[0])])):
            root = np.linalg.cholesky(covariance(base, 1e-7, i))
            parts.append(np.linalg.solve(root, part))
            determinant += 2 * np.log(np.diag(root)).sum()
        white = np.concatenate(parts)
        size = np.maximum(np.linalg.norm(white, axis=0), 1e-300)
        found = np.linalg.lstsq(white[:, :-1] / size[:-1], white[:, -1], rcond=1e-12)[0]
        rest = white[:, -1] - white[:, :-1] / size[:-1] @ found
        expected = rest @ rest + determinant
        assert ScoreContext(base, 2, shared=(key,)).levels[0].deviance == pytest.approx(expected)

    def grouped(self, groups, levels, absorbed=(), **options):
        """`levels` are residuals and deviances; the first axis is free in each."""
        basis = np.eye(4)[:, :1]
        made = [module.Level(np.ones(4), basis, np.array(r, dtype=float), d) for r, d in levels]
        context = SimpleNamespace(
            absorbed_by_base=lambda columns: np.isin(np.arange(len(columns)), absorbed),
            rotated=lambda rows: rows, shares=lambda direction: (), fit=SimpleNamespace(noise=()),
            draws=np.array([[0.0], [3.0], [1.0], [0.0]]),
        )  # fmt: skip
        trials = [(({"w": i},), np.array(c, dtype=float)[:, None]) for i, c in enumerate(groups)]
        return best_group(context, self.effect, trials, made, **options)

    def test_a_level_that_describes_the_data_worse_is_not_a_gain(self):
        first, second = ((0, 3, 0, 0), 0.0), ((0, 5, 0, 0), 17.0)
        axis = (0, 2, 0, 0)
        assert self.grouped([axis], [first, second]).score == pytest.approx(9.0)
        assert self.grouped([axis], [first, second]).gamma == pytest.approx([1.5])
        assert self.grouped([axis], [first, (second[0], 15.0)]).score == pytest.approx(10.0)
        assert self.grouped([axis], [first, (second[0], 15.0)]).gamma == pytest.approx([2.5])

    def test_of_groups_of_which_the_base_absorbs_one_the_other_counts(self):
        groups, level = [(0, 1, 0, 0), (0, 0, 1, 0)], ((0, 5, 2, 0), 0.0)
        found = self.grouped(groups, [level], absorbed=[0])
        assert (found.score, found.absorbed, found.shape) == (pytest.approx(4.0), False, ({"w": 1},))
        assert self.grouped(groups, [level], absorbed=[0, 1]).absorbed
        assert not self.grouped(groups, [level]).absorbed
        assert self.grouped(groups, [level]).null == pytest.approx([9.0])

    def test_rows_of_a_torque_and_effects_that_are_left_out(self):
        base = stood(1e-7)
        torque = residual(len(base.predictions[0].rows), 5)
        context = ScoreContext(base, 2, without=["casing.air.linear"], torque_rows=torque)
        place = base.problem.layout.index["casing.air.linear.b2"]
        free = np.delete(free_columns(base), place, axis=1)
        rows = base.problem.data[0].z - base.predictions[0].rows + torque
        c = covariance(base, 1e-7)
        expected = least_squares(free, rows, c)[0] + np.linalg.slogdet(c)[1]
        assert context.levels[0].deviance == pytest.approx(expected)

    @pytest.mark.parametrize(("release", "free"), [(False, False), (True, True)])
    def test_a_parameter_at_its_bound_is_held(self, release, free):
        base = stood(1e-7, values={"casing.air.linear.b2": 0.0})
        place = base.problem.layout.index["casing.air.linear.b2"]
        columns = free_columns(base) if free else np.delete(free_columns(base), place, axis=1)
        rows, c = base.problem.data[0].z - base.predictions[0].rows, covariance(base, 1e-7)
        expected = least_squares(columns, rows, c)[0] + np.linalg.slogdet(c)[1]
        assert ScoreContext(base, 2, release=release).levels[0].deviance == pytest.approx(expected)

    @pytest.mark.parametrize(
        ("least", "level", "share", "expected"),
        [
            (1.0, 100.0, 0.0, 1.0),
            (1.0, 100.0, 0.5, 10.0),
            (1.0, 100.0, 1.0, 100.0),
            (0.0, 100.0, 0.0, 0.1),  # a thousandth of the level
            (2.0, 1.0, 0.5, 1.0),  # the level of the fit is the lowest one
        ],
    )
    def test_levels_are_equally_spaced_in_their_logarithm(self, least, level, share, expected):
        assert module._level_between(least, level, share) == pytest.approx(expected)


class TestStrengths:
    columns = np.random.default_rng(1).standard_normal((9, 4))
    rows = np.random.default_rng(2).standard_normal(9)

    def test_of_single_columns_and_of_pairs(self):
        for width in (1, 2):
            found, gamma = module._solve(self.columns, self.rows, 4 // width, (-np.inf, np.inf))
            for i in range(4 // width):
                part = self.columns[:, i * width : (i + 1) * width]
                exact = np.linalg.lstsq(part, self.rows, rcond=None)[0]
                assert gamma[i] == pytest.approx(exact)
                assert found[i] == pytest.approx(self.rows @ part @ exact)

    @pytest.mark.parametrize(("lower", "upper"), [(0.0, np.inf), (-0.05, 0.05), (-np.inf, 0.0)])
    def test_bounds_limit_the_strength_and_the_score(self, lower, upper):
        found, gamma = module._solve(self.columns, self.rows, 4, (lower, upper))
        exact = self.columns.T @ self.rows / (self.columns**2).sum(axis=0)
        assert (exact > 0).any()
        assert (exact < 0).any()
        limited = np.clip(exact, lower, upper)
        assert gamma[:, 0] == pytest.approx(limited)
        rest = self.rows[:, None] - self.columns * limited
        assert found == pytest.approx(self.rows @ self.rows - (rest**2).sum(axis=0))

    def test_a_column_of_zeros_has_no_score(self):
        found, _ = module._solve(np.zeros((9, 2)), self.rows, 2, (-np.inf, np.inf))
        assert found == pytest.approx([0.0, 0.0])

    def test_bounds_are_those_of_a_strength_without_a_phase(self):
        assert module._bounds(LIBRARY["casing.air.quadratic"]) == (0.0, math.inf)
        assert module._bounds(LIBRARY["setup.inertia"]) == (-0.3, 0.3)
        assert module._bounds(LIBRARY["casing.precession"]) == (-math.inf, math.inf)


def tried(trials, columns, draws=20_001, scale=1.0):
    """A score whose null data are exactly those of the largest of some independent chi-squares."""
    uniform = (np.arange(draws) + 0.5) / draws
    null = chi2(columns).isf(-np.expm1(np.log(uniform) / trials))
    process = SimpleNamespace(ratios=np.array([scale]), weights=np.ones(1))
    none = np.zeros(0)
    return Score(
        LIBRARY["casing.air.quadratic"], 0.0, none, ({},), columns, trials, absorbed=False, direction=none, null=null,
        shares=(1.0,), noise=(SimpleNamespace(process=process),),
    )  # fmt: skip


class TestProbability:
    @pytest.mark.parametrize("columns", [1, 2])
    @pytest.mark.parametrize("trials", [1, 30])
    def test_of_the_largest_of_several_trials(self, trials, columns):
        null = NullDistribution(tried(trials, columns))
        for x in (1.0, 12.0, 30.0):
            single = chi2(columns).sf(x)
            assert null(x)[0] == pytest.approx(-np.expm1(trials * np.log1p(-single)), rel=0.01)
        assert null.of_draws() == pytest.approx((np.arange(20_001)[::-1] + 0.5) / 20_001, abs=0.01)
        assert null(-3.0)[0] == pytest.approx(1.0)

    @pytest.mark.parametrize(("of_median", "of_tail"), [(1, 30), (30, 1), (8, 8)])
    def test_the_number_of_trials_is_that_of_the_middle_or_of_the_tail(self, of_median, of_tail):
        middle = chi2(1).isf(1 - 0.5 ** (1 / of_median))
        tail = max(chi2(1).isf(1 - 0.9 ** (1 / of_tail)), middle)
        share = np.linspace(0.0, 1.0, 1001)
        draws = np.interp(share, [0.0, 0.5, 0.9, 1.0], [0.0, middle, tail, 2 * tail])
        null = NullDistribution(replace(tried(1, 1), null=draws))
        trials = max(of_median, of_tail, math.log(0.9) / math.log1p(-chi2(1).sf(tail)))
        assert null(12.0)[0] == pytest.approx(-np.expm1(trials * np.log1p(-chi2(1).sf(12.0))), rel=0.01)

    def test_at_a_known_noise_the_score_is_not_scaled(self):
        null = NullDistribution(tried(30, 2, scale=4.0))
        assert null.at_one_level(14.0) == pytest.approx(-np.expm1(30 * np.log1p(-chi2(2).sf(14.0))), rel=0.01)

    def test_a_score_with_fewer_strengths(self):
        null = NullDistribution(tried(30, 2))
        assert null.of(12.0, 1)[0] == pytest.approx(-np.expm1(30 * np.log1p(-chi2(1).sf(12.0))), rel=0.01)

    def test_an_error_of_the_noise_scales_the_score(self):
        assert NullDistribution(tried(1, 1, scale=4.0))(12.0)[0] == pytest.approx(chi2(1).sf(3.0), rel=0.01)

    @pytest.mark.parametrize("tests", [1, 25])
    def test_of_the_smallest_of_many_tests(self, tests):
        smallest = -np.expm1(np.log1p(-(np.arange(5001) + 0.5) / 5001) / tests)
        for p in (1e-4, 0.01, 0.2):
            assert over_many_tests(p, smallest) == pytest.approx(-np.expm1(tests * np.log1p(-p)), rel=0.01)

    def test_there_is_at_least_one_test(self):
        assert over_many_tests(0.2, np.full(11, 0.9)) == pytest.approx(0.2)

    def test_independent_candidates_count_separately(self):
        random = np.random.default_rng(4)
        draws = random.random((5, 40_000))
        found = FamilywiseNull([SimpleNamespace(of_draws=lambda u=u: u) for u in draws])(
            np.array([0.01]), np.ones(1)
        )
        assert found == pytest.approx(-math.expm1(5 * math.log1p(-0.01)), rel=0.05)

    def test_equal_candidates_count_once(self):
        family = FamilywiseNull([NullDistribution(tried(1, 1))] * 3)
        assert family(np.array([0.02]), np.ones(1)) == pytest.approx(0.02, rel=0.01)
        # the mean over the possible levels of the noise
        assert family(np.array([0.01, 0.03]), np.array([0.25, 0.75])) == pytest.approx(0.025, rel=0.01)


class TestShapes:
    @pytest.mark.parametrize(
        ("value", "low", "high"),
        [(2.0, 1.0, 4.0), (4.0, 2.0, 8.0), (1.0, 0.3, 2.0), (8.0, 4.0, 8.0 + 7 / 3)],
    )
    def test_the_neighbours_of_a_point_of_a_grid(self, value, low, high):
        """Beyond the ends by the mean step, and not below 0.3 of the value."""
        assert module._neighbours([8.0, 1.0, 4.0, 2.0], value) == pytest.approx((low, high))

    def test_neighbours_of_a_lonely_point(self):
        assert module._neighbours([5.0], 5.0) == (5.0, 5.0)
        assert module._neighbours([5.0, 6.0], 5.0) == (4.0, 6.0)

    def test_rows_of_one_case_are_zero_in_the_others(self):
        context = SimpleNamespace(ends=np.array([0, 2, 5]))
        ((shape, rows),) = rows_of_case(context, [Trial({"w": 1.0}, np.ones((3, 1)))], 1)
        assert shape == ({"w": 1.0},)
        assert rows[:, 0].tolist() == [0, 0, 1, 1, 1]

    def test_cases_are_stacked_or_have_their_own_columns(self):
        trials = [
            [Trial({"w": x}, np.full((2, 1), x)) for x in (1.0, 2.0)],
            [Trial({"w": 3.0}, np.full((1, 1), 3.0))],
        ]
        common, own = stacked(trials, per_case=False), stacked(trials, per_case=True)
        assert [g[0] for g in common] == [({"w": 1.0}, {"w": 3.0}), ({"w": 2.0}, {"w": 3.0})]
        assert common[1][1].tolist() == [[2.0], [2.0], [3.0]]
        assert own[1][1].tolist() == [[2.0, 0.0], [2.0, 0.0], [0.0, 3.0]]

    @pytest.mark.parametrize(
        ("name", "cases", "phases", "per_case"),
        [
            ("casing.precession", 2, True, False),
            ("casing.precession", 1, False, False),
            ("camera.centre", 2, False, False),
            ("touchpoint.step", 2, False, True),
            ("touchpoint.step", 1, False, False),
        ],
    )
    def test_what_may_differ_between_cases(self, name, cases, phases, per_case):
        assert has_phases(LIBRARY[name], cases) is phases
        assert module._is_per_case(LIBRARY[name], cases) is per_case

    @pytest.mark.parametrize(("name", "shared"), [("casing.precession", True), ("touchpoint.step", False)])
    def test_cases_that_share_a_shape_constant_are_tested_at_its_values_in_the_first(self, name, shared):
        asked = []

        def case(shape):
            def trials(effect, choices=None):
                asked.append((effect.name, choices))
                return [Trial(shape, np.zeros((1, 1)))]

            return SimpleNamespace(trials=trials)

        found = module._all_trials(LIBRARY[name], [case({"w": 1.0}), case({"w": 2.0})])
        assert [[t.shape for t in of_case] for of_case in found] == [[{"w": 1.0}], [{"w": 2.0}]]
        assert asked == [(name, None), (name, [{"w": 1.0}] if shared else None)]

    @pytest.mark.parametrize(("margin", "own"), [(0.1, True), (-0.1, False)])
    def test_a_phase_of_each_case_needs_evidence_per_case(self, monkeypatch, margin, own):
        def best(context, effect, groups, levels, *, null=True):
            value = 40.0 + (2 * DEFAULT.own_phase + margin if groups == "own" else 0.0)
            return Score(
                effect,
                value,
                np.zeros(0),
                ({},),
                2,
                1,
                absorbed=False,
                direction=np.zeros(0),
                null=np.zeros(0),
            )

        monkeypatch.setattr(module, "best_group", best)
        monkeypatch.setattr(module, "stacked", lambda trials, *, per_case: "own" if per_case else "common")
        found = module._score(
            SimpleNamespace(levels=[]), LIBRARY["casing.precession"], [[1], [1], [1]], DEFAULT
        )
        assert found.own_phase is own
        assert found.score == (40.0 + 2 * DEFAULT.own_phase + margin if own else 40.0)

    def test_of_two_shape_constants_none_is_refined(self):
        law = resolve("casing: k*exp(-(t/w)**n)")
        assert sum(p.role == "shape" for p in law.parameters) == 2
        scored = replace(tried(1, 1, draws=11), effect=law, shape=({"w": 1.0, "n": 2.0},))
        trial = Trial({"w": 1.0, "n": 2.0}, np.ones((4, 1)))
        assert module._shape_refined(None, scored, [[trial]], [None], DEFAULT) is scored

    @pytest.mark.parametrize(("share", "refined"), [(1.01, True), (0.99, False)])
    def test_shapes_of_promising_candidates_are_refined(self, monkeypatch, share, refined):
        """A score 10 - (w - 2.3)^2 on a grid of 1, 2, 4."""
        tops = {"touchpoint.stribeck": 10.0 * share * DEFAULT.shape_share, "casing.air.quadratic": 10.0}

        def scored(context, effect, trials, criteria, *, null=True, own_phase=None):
            top, (tried,) = tops[effect.name], trials
            values = [top - (t.shape.get("w", 2.3) - 2.3) ** 2 * 1e-3 for t in tried]
            best = int(np.argmax(values))
            return Score(
                effect, values[best], np.zeros(0), (tried[best].shape,), 1, len(tried), absorbed=False,
                direction=np.zeros(0), null=np.full(3, float(null)), own_phase=bool(own_phase),
            )  # fmt: skip

        def trials(effect, choices=None):
            usual = [{"w": w} for w in (1.0, 2.0, 4.0)] if effect.name == "touchpoint.stribeck" else [{}]
            return [Trial(c, np.zeros((1, 1))) for c in (usual if choices is None else choices)]

        monkeypatch.setattr(module, "_score", scored)
        effects = [LIBRARY[n] for n in tops]
        found, _ = score(None, effects, [SimpleNamespace(trials=trials)], DEFAULT, context="given")
        w = found.shape[0]["w"]
        # three rounds of nine points: 3 / 8, 3 / 32, 3 / 128 apart
        assert abs(w - 2.3) < 0.02 if refined else w == 2.0
        assert (found.trials, found.null.tolist()) == (3, [1.0, 1.0, 1.0])


def test_each_case_may_choose_its_own_shape():
    """Two cases whose residuals are two different laws: each law is chosen, and its own part of the score is added."""
    base = gyroscope(cases=("a", "b"), level=1e-7, per_case=("touchpoint", "casing"))
    ends = np.cumsum([0, *(len(p.rows) for p in base.predictions)])
    columns = [CaseColumns(base, i) for i in (0, 1)]
    step = LIBRARY["touchpoint.step"]
    trials = [c.trials(step, [{"t0": t} for t in (6.0, 9.0, 12.0)]) for c in columns]
    rows = [
        residual(len(p.rows), 7 + i) + 3e-5 * trials[i][k].columns[:, 0]
        for i, (p, k) in enumerate(zip(base.predictions, (0, 2), strict=True))
    ]
    base = gyroscope(cases=("a", "b"), level=1e-7, per_case=("touchpoint", "casing"), residual=rows)
    found = module._score(ScoreContext(base, 5), step, trials, DEFAULT)
    assert [s["t0"] for s in found.shape] == [6.0, 12.0]
    assert found.trials == 6
    assert found.gamma == pytest.approx([3e-5, 3e-5], rel=0.1)
    assert len(found.null) == 5
    assert ends[-1] == len(found.direction)


class TestGrids:
    def columns(self, span=(3.0, 13.0), phase=None):
        made = object.__new__(module.CaseColumns)
        made.case = SimpleNamespace(data=SimpleNamespace(record=SimpleNamespace(span=span)))
        made._states = lambda effect, state, rate, at: np.asarray(phase)[:, None]
        return made

    def effect(self, *, jump="", state=None):
        return SimpleNamespace(breakpoint=jump, state=state, rates=[None], parameters=())

    def test_trial_values_are_those_declared(self):
        p = SimpleNamespace(symbol="n", grid=(0.5, 1.5), start=1.0, relative=False)
        assert self.columns()._grid(self.effect(), p).tolist() == [0.5, 1.5]
        p.grid = ()
        assert self.columns()._grid(self.effect(), p).tolist() == [1.0]
        p.grid, p.relative = (0.1, 0.5), True
        assert self.columns()._grid(self.effect(), p).tolist() == [1.0, 5.0]

    def test_moments_of_a_change_are_eight_times_as_dense(self):
        p = SimpleNamespace(symbol="t0", grid=(0.1, 0.2, 0.6), start=0.1, relative=True)
        found = self.columns()._grid(self.effect(jump="t0"), p)
        shares = [*np.linspace(0.1, 0.2, 9), *np.linspace(0.2, 0.6, 9)[1:]]
        assert found == pytest.approx(3.0 + 10.0 * np.array(shares))

    @pytest.mark.parametrize(
        ("steps", "count"),
        [([0.1] * 100, 66), ([0.1] * 50 + [0.2] * 25, 33), ([1e-4] * 30000, 1500), ([2.0], 1)],
    )
    def test_frequencies_are_a_phase_step_apart_up_to_one_radian_per_cell(self, monkeypatch, steps, count):
        monkeypatch.setattr(module, "_phase_symbol", lambda effect: "phi")
        p = SimpleNamespace(symbol="w", grid=(), start=1.0, relative=False)
        found = self.columns(phase=np.cumsum([0.0, *steps]))._grid(self.effect(state=object()), p)
        fastest = 1.0 / max(steps)
        assert found == pytest.approx(np.linspace(fastest / count, fastest, count))
        assert len(found) == min(1500, max(1, int(fastest * sum(steps) / 1.5)))


class TestShapesOfCases:
    """Each case has three trials; the score of one is that of its shape, with those of the other cases free."""

    def chosen(self, monkeypatch, scores, given):
        """`scores` are those of each case alone; `given` those with the chosen trials of the other cases."""
        calls = []

        def best_group(context, effect, groups, levels, *, null):
            case = groups[0][1][0, 0]
            values = scores[int(case)] if levels == "levels" else given(int(case), levels)
            calls.append((int(case), levels, null))
            k = int(np.argmax(values))
            return SimpleNamespace(
                shape=({"n": k},), score=max(values), null=np.array([1.0, 2.0]) * (case + 1)
            )

        monkeypatch.setattr(module, "best_group", best_group)
        monkeypatch.setattr(
            module, "rows_of_case",
            lambda context, trials, i: [((t.shape,), np.array([[float(i), float(t.shape["n"])]])) for t in trials],
        )  # fmt: skip
        context = SimpleNamespace(
            with_free=lambda columns: tuple(map(tuple, columns.reshape(-1, 2).astype(int).tolist()))
        )
        trials = [[SimpleNamespace(shape={"n": k}) for k in range(3)] for _ in scores]
        found, null = module._choose_shapes(context, "effect", trials, "levels", null=True)
        return [t.shape["n"] for t in found], null, calls

    def test_the_best_case_is_chosen_first_and_all_once_more(self, monkeypatch):
        scores = [[5.0, 1.0, 0.0], [0.0, 9.0, 1.0], [0.0, 1.0, 7.0]]

        def given(case, others):
            # beside trial 1 of case 1, the first case has its second trial
            known = dict(others)
            return [0.0, 8.0, 1.0] if case == 0 and known[1] == 1 else scores[case]

        found, null, calls = self.chosen(monkeypatch, scores, given)
        assert found == [1, 1, 2]
        assert null.tolist() == [6.0, 12.0]
        assert [c for c in calls if c[1] == "levels"] == [(i, "levels", True) for i in range(3)]
        assert [(case, set(others)) for case, others, null in calls[3:]] == [
            (2, {(0, 0), (1, 1)}), (0, {(1, 1), (2, 2)}), (1, {(0, 1), (2, 2)}), (2, {(0, 1), (1, 1)}),
            (0, {(1, 1), (2, 2)}),
        ]  # fmt: skip
        assert not any(null for *_, null in calls[3:])

    def test_many_cases_have_their_own_best_trials(self, monkeypatch):
        scores = [[1.0, 0.0, 0.0]] * 5
        found, _, calls = self.chosen(monkeypatch, scores, lambda case, others: [0.0, 0.0, 9.0])
        assert found == [0] * 5
        assert len(calls) == 5
        assert self.chosen(monkeypatch, scores[:4], lambda case, others: [0.0, 0.0, 9.0])[0] == [2] * 4
