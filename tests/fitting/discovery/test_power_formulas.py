"""Limits and power of the search against closed forms: normal integrals, least squares, bounds on one parameter."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from linearised import covariance, gyroscope, least_squares
from scipy.stats import ncx2, norm

from fitting import LIBRARY, Criteria, Estimate
from fitting._criteria import DEFAULT
from fitting.discovery import _power as module
from fitting.discovery._power import (
    EffectLimits,
    Search,
    ShiftedToBound,
    delta_of_power,
    largest_hidden,
    upper_limit,
)
from fitting.discovery._score import CaseColumns, ScoreContext

DRAG, LAMINAR = LIBRARY["casing.air.quadratic"], LIBRARY["casing.air.laminar"]
RNG = np.random.default_rng(4)
ONE_SIDED = norm.ppf(0.95)


class TestResponses:
    columns = RNG.standard_normal((30, 4))

    def made(self, columns, width, absorbed=(), effect=DRAG):
        return module._Responses.of(
            columns, width, np.isin(np.arange(columns.shape[1] // width), absorbed), effect
        )

    def test_a_single_column_has_its_length_as_noncentrality(self):
        found = self.made(self.columns, 1)
        assert found.root == pytest.approx(np.linalg.norm(self.columns, axis=0))
        assert found.basis == pytest.approx(self.columns / found.root)
        assert found.direction(2) == pytest.approx(found.basis[:, 2])

    def test_a_pair_has_the_rms_over_its_phases(self):
        found = self.made(self.columns, 2, effect=LIBRARY["casing.precession"])
        for i in range(2):
            part = slice(2 * i, 2 * i + 2)
            phases = np.linspace(0, 2 * np.pi, 100, endpoint=False)
            lengths = np.linalg.norm(
                self.columns[:, part] @ np.stack([np.cos(phases), np.sin(phases)]), axis=0
            )
            assert found.root[i] == pytest.approx(np.sqrt(np.mean(lengths**2)))
            own = found.basis[:, part]
            assert own.T @ own == pytest.approx(np.eye(2))
            assert own @ (own.T @ self.columns[:, part]) == pytest.approx(self.columns[:, part])
            assert np.linalg.norm(found.direction(i)) == pytest.approx(1.0)

    def test_what_the_base_absorbs_has_no_response(self):
        found = self.made(self.columns, 1, absorbed=[1])
        assert found.root[1] == 0.0
        assert not found.basis[:, 1].any()
        assert found.direction(1) == pytest.approx(np.zeros(30))

    @pytest.mark.parametrize(("apart", "directions"), [(1e-4, 1), (1e-2, 2)])
    def test_a_pair_of_nearly_equal_columns_has_one_direction(self, apart, directions):
        """Directions whose squared response is less than 1e-6 of the other are none."""
        pair = self.columns[:, :1] * [1.0, 2.0] + apart * self.columns[:, 1:3]
        found = self.made(pair, 2, effect=LIBRARY["casing.precession"])
        assert (np.linalg.norm(found.basis, axis=0) > 0.5).sum() == directions

    @pytest.mark.parametrize(("square", "directions"), [(3e-7, 1), (3e-6, 2)])
    def test_a_direction_with_a_millionth_of_the_response_is_none(self, square, directions):
        pair = np.eye(30)[:, :2] * [5.0, 5.0 * math.sqrt(square)]
        found = self.made(pair, 2, effect=LIBRARY["casing.precession"])
        assert np.count_nonzero(np.linalg.norm(found.basis, axis=0)) == directions

    @pytest.mark.parametrize(
        ("effect", "width", "one_sided"),
        [("casing.air.quadratic", 1, True), ("external.constant", 1, False), ("casing.precession", 2, False)],
    )
    def test_scores_of_a_friction_are_of_positive_estimates(self, effect, width, one_sided):
        found = self.made(self.columns, width, effect=LIBRARY[effect])
        assert found.one_sided is one_sided
        projections = np.array([[1.0, -2.0], [-3.0, 4.0], [2.0, 0.0], [0.0, -1.0]])
        scores = found.scores(projections)
        if width == 2:
            assert scores.tolist() == [[10.0, 20.0], [4.0, 1.0]]
        elif one_sided:
            assert scores.tolist() == [[1.0, 0.0], [0.0, 16.0], [4.0, 0.0], [0.0, 0.0]]
        else:
            assert scores.tolist() == [[1.0, 4.0], [9.0, 16.0], [4.0, 0.0], [0.0, 1.0]]

    def test_the_best_scores_of_several_cases_add_up(self):
        parts = tuple(self.made(self.columns[:, i : i + 2], 1) for i in (0, 2))
        test = module._Test(parts, np.zeros((4, 2)), np.array([5.0, 9.0, 6.0]))
        assert test.threshold == 6.0
        assert test.basis.shape == (30, 4)
        assert test.best(np.array([[1.0], [2.0], [3.0], [-4.0]])) == pytest.approx([4.0 + 9.0])


def bounds(free, noise, lower, upper):
    free = np.asarray(free, dtype=float)
    return ShiftedToBound(
        free, np.linalg.pinv(free), np.asarray(noise, dtype=float), np.array([lower, upper])
    )


class TestShiftedToBound:
    def test_the_parameter_furthest_beyond_its_bound_is_held(self):
        """Two parameters with standard errors 1 and 1/2, at distances of 1 from their bounds."""
        free = np.diag([1.0, 2.0])
        shifted = bounds(free, np.zeros((2, 1)), [-1.0, -1.0], [1.0, 1.0])
        for response, held in (
            ((0.9, 0.0), -1),
            ((1.1, 0.0), 1),  # the upper bound of the first one
            ((-1.1, 0.0), 0),
            ((0.0, 2.2), 3),
            ((0.0, -2.2), 2),
            ((1.5, 2.8), 3),  # 0.4 beyond, of an error of 0.5: further than 0.5 of an error of 1
            ((1.9, 2.8), 1),
        ):
            assert shifted.held(np.array(response), np.array([1.0])).tolist() == [[held]]
        assert shifted.held(np.array([0.6, 0.0]), np.array([1.0, 2.0])).tolist() == [[-1], [1]]

    def test_noise_moves_the_parameters_as_well(self):
        shifted = bounds(np.eye(1), [[0.5, -0.5]], [-1.0], [1.0])
        assert shifted.held(np.array([0.7]), np.array([1.0])).tolist() == [[1, -1]]

    def test_the_shift_is_that_to_the_bound(self):
        shifted = bounds(np.diag([1.0, 2.0]), np.zeros((2, 1)), [-1.0, -3.0], [2.0, 5.0])
        assert [shifted.shift(k).tolist() for k in range(4)] == [[-1, 0], [2, 0], [0, -6], [0, 10]]

    def test_distances_and_noise_of_a_fit(self):
        base = gyroscope(level=1e-7)
        context = ScoreContext(base, 5)
        truth = {"touchpoint.constant.b1": 3e-5}
        found = ShiftedToBound.of(base, context, context.levels[-1], 4, truth)
        assert found.distance.shape == (2, 6)
        assert found.distance[0, :4] == pytest.approx([-1e-9, -3e-5, -1e-6, -2e-7])
        assert np.isinf(found.distance[1]).all()
        assert np.isinf(found.distance[0, 4:]).all()
        c = covariance(base, 1e-7)
        root = np.linalg.cholesky(c)
        free = np.concatenate([base.predictions[0].jacobian, base.problem.data[0].nuisance], axis=1)
        white = np.linalg.solve(root, free)
        size = np.linalg.norm(white, axis=0)
        size[size == 0] = 1.0
        inner = np.linalg.pinv((white / size).T @ (white / size)) / np.outer(size, size)
        errors = np.sqrt((found.inverse**2).sum(axis=1))
        assert errors == pytest.approx(np.sqrt(np.diag(inner))[:6], rel=1e-4)
        assert found.noise == pytest.approx(found.inverse @ context.draws[:, :4])

    @pytest.mark.parametrize(
        ("distance", "unit"), [(0.2, 1.0), (0.7, 1.0), (10.0, 1.0), (0.2, 50.0), (0.7, 0.02)]
    )
    def test_the_upper_limit_with_a_parameter_within_its_bounds(self, distance, unit):
        """Response and parameter have a cosine of 0.8: beyond the bound the parameter absorbs no more of the effect."""
        free, response = np.array([[unit], [0.0], [0.0]]), np.array([0.8, 0.6, 0.0])
        data = np.array([0.1, 0.3, 0.5])
        shifted = bounds(free, [[0.0]], [-distance / unit], [np.inf])
        without = 0.3 / 0.6 + ONE_SIDED / 0.6
        found = shifted.largest_strength(response, data, without, one_sided=True)
        grid = np.linspace(0.0, without, 4001)
        values = np.minimum(0.1 - 0.8 * grid + distance, 0.0) ** 2 + (0.3 - 0.6 * grid) ** 2
        above = np.flatnonzero((values > values.min() + ONE_SIDED**2) & (grid > grid[values.argmin()]))
        expected = grid[above[0]] if len(above) else without
        assert found == pytest.approx(expected, rel=3e-3)
        if distance == 10.0:
            assert found == without

    def test_a_strength_of_either_sign_has_the_larger_limit(self):
        free, response = np.array([[1.0], [0.0]]), np.array([0.8, 0.6])
        shifted = bounds(free, [[0.0]], [-0.2], [np.inf])
        both, one = (
            shifted.largest_strength(response, np.zeros(2), 3.0, one_sided=one) for one in (False, True)
        )
        assert one < 2.5
        assert both == 3.0  # with the opposite sign the parameter moves away from its bound

    def test_a_basis_without_a_parameter(self):
        free = RNG.standard_normal((6, 3))
        basis = bounds(free, np.zeros((3, 1)), [0.0] * 3, [1.0] * 3).basis_without(1)
        assert basis.shape == (6, 2)
        assert basis @ (basis.T @ free[:, [0, 2]]) == pytest.approx(free[:, [0, 2]])


@pytest.fixture(scope="module")
def base():
    rows = np.random.default_rng(8).standard_normal(len(gyroscope().predictions[0].rows))
    found = gyroscope(level=1e-7, residual=[rows])
    found.fails = lambda criteria: False
    return found


@pytest.fixture(scope="module")
def search(base):
    """The search for two laws of drag."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "applicable_effects", lambda *_: [DRAG, LAMINAR])
        return Search(base, draws=800)


def stderr(base, effect):
    """Return strength and standard error by generalised least squares."""
    (trial,) = CaseColumns(base, 0).trials(effect)
    free = np.concatenate([base.predictions[0].jacobian, base.problem.data[0].nuisance], axis=1)
    root = np.linalg.cholesky(covariance(base, 1e-7))
    white = np.linalg.solve(root, np.column_stack([free, trial.columns]))
    size = np.linalg.norm(white, axis=0)
    size[size == 0] = 1.0
    basis = np.linalg.svd(white[:, :-1] / size[:-1], full_matrices=False)
    kept = basis[0][:, basis[1] > 1e-10 * basis[1][0]]
    own = white[:, -1] - kept @ (kept.T @ white[:, -1])
    _, values = least_squares(np.column_stack([free, trial.columns]), residuals(base), covariance(base, 1e-7))
    return values[-1], 1 / np.linalg.norm(own)


def residuals(base):
    return base.problem.data[0].z - base.predictions[0].rows


def rms_speed(base, power):
    columns = CaseColumns(base, 0)
    return math.sqrt(np.mean(np.abs(columns.along_motion("omega_c")) ** (2 * power)))


class TestLimits:
    def test_standard_error_torque_and_upper_limit(self, base, search):
        for effect, power in ((DRAG, 2.0), (LAMINAR, 1.5)):
            found = search.limits(effect)
            value, error = stderr(base, effect)
            assert found.stderr == pytest.approx(error, rel=1e-4)
            assert found.torque == pytest.approx(rms_speed(base, power))
            assert found.upper_limit <= (max(value / error, 0.0) + ONE_SIDED) * error * (1 + 1e-4)
            assert found.upper_torque == pytest.approx(found.upper_limit * found.torque)
            assert (found.strength, found.absorbed) == ("k", False)
            planned = search.limits(effect, planned=True)
            assert planned.upper_limit <= ONE_SIDED * error * (1 + 1e-4)

    def test_the_power_is_a_normal_integral(self, search):
        """A friction is found if its estimate exceeds the root of the threshold, or another candidate's does."""
        found = search.limits(DRAG)
        threshold = max(t.threshold for t in search._tests[DRAG.name])
        curve = found.curve
        far = curve[:, 0] > 3.0
        alone = norm.sf(math.sqrt(threshold) - curve[:, 0])
        assert (curve[far, 1] > alone[far] - 0.05).all()
        assert (curve[far, 1] < norm.sf(math.sqrt(threshold) - curve[far, 0] - 0.6) + 0.1).all()
        assert found.detection_limit / found.stderr == pytest.approx(delta_of_power(curve))
        assert found.detection_torque == pytest.approx(found.detection_limit * found.torque)
        assert found.detection_range == pytest.approx((found.detection_torque,) * 2)

    def test_the_threshold_is_significant_in_the_list_and_has_evidence(self, base, search):
        least = DEFAULT.evidence + math.log(base.problem.rows)
        assert search._tests[DRAG.name][0].threshold >= least
        # two alike frictions: between one and two independent candidates at 3 %
        strict = norm.isf(DEFAULT.significance / 2) ** 2
        assert search._tests[DRAG.name][0].threshold >= min(strict, least) * 0.8

    def test_a_size_is_a_hundredth_of_the_torque_of_the_bearing(self, base, search):
        columns = CaseColumns(base, 0)
        delta = columns.along_motion("omega_r") - columns.along_motion("omega_c")
        typical = 2e-7 * math.sqrt(np.mean(delta**2))
        assert search.typical_torque == pytest.approx(typical)
        assert search.default_size == pytest.approx(0.01 * typical)
        found = search.limits(DRAG)
        assert found.size == pytest.approx(0.01 * typical / found.torque)
        asked = search.limits(DRAG, 3.0 * found.stderr * found.torque)
        assert asked.power == pytest.approx(np.interp(3.0, *asked.curve.T))
        assert asked.size == pytest.approx(3.0 * found.stderr)

    @pytest.mark.parametrize(("share", "runs"), [(1.01, 1), (0.5, 4), (0.2, 25)])
    def test_runs_add_their_squared_noncentralities(self, search, share, runs):
        """BIC asks for the logarithm of the number of runs in addition."""
        needed = 4.0
        found = search._runs(DRAG, share * needed, needed)
        assert found >= runs
        assert found * (share * needed) ** 2 >= needed**2 + math.log(found)
        assert found == 1 or (found - 1) * (share * needed) ** 2 < needed**2 + math.log(found - 1)
        assert search._runs(DRAG, 0.0, needed) == math.inf
        assert search._runs(DRAG, 1.0, math.inf) == math.inf

    @pytest.mark.parametrize("margin", [0.9, 1.1])
    def test_laws_whose_deviance_differs_by_less_than_the_width_are_indistinguishable(self, search, margin):
        a, b = (search._common[e.name].direction(0) for e in (DRAG, LAMINAR))
        apart = 1.0 - float(a @ b) ** 2
        delta = math.sqrt(margin * DEFAULT.equivalence_width / apart)
        assert search._indistinguishable(DRAG, 0, delta) == (("casing.air.laminar",) if margin < 1 else ())

    def test_a_significant_effect_has_no_upper_limit(self, base, search):
        strong = (
            residuals(base) + 100 * stderr(base, DRAG)[1] * CaseColumns(base, 0).trials(DRAG)[0].columns[:, 0]
        )
        other = gyroscope(level=1e-7, residual=[strong])
        other.fails = lambda criteria: False
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(module, "applicable_effects", lambda *_: [DRAG])
            found = Search(other, draws=50)
        assert math.isnan(found.limits(DRAG).upper_limit)
        assert not math.isnan(found.limits(DRAG, planned=True).upper_limit)
        scored = found.scores()[DRAG.name]
        assert scored.score > scored.threshold
        value, error = stderr(other, DRAG)
        assert scored.score == pytest.approx((value / error) ** 2, rel=1e-4)

    def test_an_absorbed_effect_has_no_limits(self, base, monkeypatch):
        monkeypatch.setattr(module, "applicable_effects", lambda *_: [LIBRARY["external.constant"]])
        found = Search(base, draws=20).limits(LIBRARY["external.constant"])
        assert found.absorbed
        assert found.stderr == found.detection_limit == found.upper_limit == found.runs_needed == math.inf
        assert math.isnan(found.power)


class TestLargestHidden:
    def test_limits_are_ordered_and_limited(self, base, monkeypatch):
        torques = {
            "a": 3.0,
            "b": 9.0,
            "c": 1.0,
            "d": 20.0,
            "e": 4.0,
            "f": 5.0,
            "g": 2.0,
            "camera": 8.0,
            "nan": math.nan,
            "absorbed": math.nan,
            "total": 10.0,
        }

        class Known:
            typical_torque = 10.0
            effects = tuple(
                SimpleNamespace(name=n, kind="measurement" if n == "camera" else "physical") for n in torques
            )

            def __init__(self, fit, extra, criteria, *, draws):
                assert draws == 1

            def limits(self, effect):
                limit = torques[effect.name] / 2.0
                return EffectLimits(
                    effect,
                    "k",
                    "N m",
                    {},
                    math.inf if effect.name == "absorbed" else 1.0,
                    2.0,
                    1.0,
                    (1.0, 1.0),
                    limit,
                    0.5,
                    1.0,
                    1.0,
                    (),
                    np.zeros((0, 2)),
                )

        monkeypatch.setattr(module, "Search", Known)
        found = largest_hidden(base, (), DEFAULT)
        assert [(u.effect, u.torque_Nm) for u in found.limits] == [
            ("b", 9.0), ("f", 5.0), ("e", 4.0), ("a", 3.0), ("g", 2.0),
        ]  # fmt: skip
        assert found.limits[0].upper_limit == 4.5
        # above or at the torque of the bearing, or absorbed by the model; a significant effect ("nan") is not hidden
        assert found.without_limit == ("d", "absorbed", "total")
        # a refit may have a larger limit, |k| + 1.64 se; here of two cases
        values = {
            "a.k@1": (-1.0, 1.0), "a.k@2": (-0.2, 2.0), "a.phi": (9.0, 1.0), "b.k": (4.0, 0.1),
            "f.k": (3.0, math.nan), "absorbed.k": (1.0, 1.0),
        }  # fmt: skip
        estimates = {k: Estimate(*v, "N m", at_bound=False) for k, v in values.items()}
        tried = [
            SimpleNamespace(effect=e, fit=None if e.name == "e" else SimpleNamespace(estimates=estimates))
            for e in (*Known.effects, SimpleNamespace(name="other"))
        ]
        found = largest_hidden(base, (), DEFAULT, tried)
        assert [(u.effect, u.torque_Nm) for u in found.limits] == [
            ("b", 9.0), ("a", pytest.approx(2 * (0.2 + 1.6448536 * 2.0))), ("f", 5.0), ("e", 4.0), ("g", 2.0),
        ]  # fmt: skip
        assert found.without_limit == ("d", "absorbed", "total")


class TestCurves:
    def test_between_two_points_the_power_is_a_normal_integral(self):
        delta = np.array([0.0, 2.0, 4.0, 6.0, 8.0])
        curve = np.stack([delta, norm.cdf(delta - 4.3)], axis=1)
        for power in (0.5, 0.9, 0.95):
            assert delta_of_power(curve, power) == pytest.approx(4.3 + norm.ppf(power), rel=1e-6)

    @pytest.mark.parametrize(
        ("powers", "expected"),
        [((0.0, 0.5, 0.899), math.inf), ((0.95, 0.96, 0.97), math.inf), ((0.0, 0.95, 0.2), True)],
    )
    def test_a_power_that_is_not_reached_within_the_curve(self, powers, expected):
        found = delta_of_power(np.stack([np.array([0.0, 1.0, 2.0]), np.array(powers)], axis=1))
        assert found == expected if expected == math.inf else 0.5 < found < 1.0

    @pytest.mark.parametrize("score", [0.1, 9.0])
    def test_an_amplitude_with_a_phase_has_a_noncentral_chi_square(self, score):
        limit = upper_limit(np.array([math.sqrt(score), 0.0]), one_sided=False)
        # not less than for the median of the score without an effect
        assert ncx2(2, limit**2).cdf(max(score, 2 * math.log(2.0))) == pytest.approx(0.05, rel=1e-6)

    @pytest.mark.parametrize(
        ("p", "one_sided", "limit"),
        [(2.0, False, 2.0), (-2.0, False, 2.0), (2.0, True, 2.0), (-2.0, True, 0.0)],
    )
    def test_a_strength_without_a_phase(self, p, one_sided, limit):
        assert upper_limit(np.array([p]), one_sided=one_sided) == pytest.approx(limit + ONE_SIDED, rel=1e-6)

    @pytest.mark.parametrize("factor", [1.0, 2.0])
    def test_the_smallest_significant_score(self, factor):
        null = lambda score: np.array([norm.sf(math.sqrt(score))])  # noqa: E731 - a one-sided test
        null.weights = np.ones(1)
        found = module._smallest_score(null, lambda p, weights: float(p @ weights), factor, 0.03)
        assert found == pytest.approx(norm.isf(0.03 / factor) ** 2, rel=1e-6)

    def test_a_large_score_may_be_needed(self):
        null = lambda score: np.array([math.exp(-score / 300.0)])  # noqa: E731 - a heavy tail
        null.weights = np.ones(1)
        found = module._smallest_score(null, lambda p, weights: float(p @ weights), 1.0, 0.03)
        assert found == pytest.approx(-300.0 * math.log(0.03), rel=1e-4)

    def test_the_shape_with_the_median_limit(self):
        root = np.array([1.0, 0.0, 4.0, 2.0])
        torque = np.array([3.0, 1.0, 4.0, 8.0])
        # torques of unit noncentrality: 3, infinite, 1, 4
        assert module._median_shape(root, torque) == (0, (1.0, 4.0))
        assert module._median_shape(root, np.full(4, np.nan)) == (3, (0.25, 1.0))
        assert module._median_shape(np.zeros(2), np.ones(2)) == (0, (np.inf, np.inf))

    def test_the_profile_of_a_strength_without_other_parameters(self):
        """(x - k)^2 exceeds its minimum by 1.64^2 at x + 1.64; for a negative x, from k = 0 on."""
        free, bound = np.zeros((2, 1)), np.array([[-1.0], [1.0]])
        for x in (0.7, -0.5):
            response, data = np.array([1.0, 0.0]), np.array([x, 0.3])
            expected = x + ONE_SIDED if x > 0 else math.sqrt(x**2 + ONE_SIDED**2) + x
            assert module._profile_limit(free, response, data, bound, 5.0) == pytest.approx(
                expected, rel=2e-3
            )
        assert module._profile_limit(free, response, data, bound, 0.4) == 0.4


def test_the_score_of_a_law_is_that_of_its_best_shape(base, monkeypatch):
    """A brake whose torque is largest at some critical speed."""
    brake = LIBRARY["casing.brake.eddy"]
    monkeypatch.setattr(module, "applicable_effects", lambda *_: [brake])
    columns = CaseColumns(base, 0).trials(brake, [{"w": 10.0}])[0].columns[:, 0]
    strong = gyroscope(level=1e-7, residual=[residuals(base) + columns / np.linalg.norm(columns) * 300.0])
    strong.fails = lambda criteria: False
    found = Search(strong, draws=20)
    scored = found.scores()[brake.name]
    each = found._common[brake.name].scores(
        found._common[brake.name].basis.T @ found._level.residual[:, None]
    )
    assert scored.score == each.max() > 1.1 * each.min()
    assert scored.shape == found._trials[brake.name][0][int(each.argmax())].shape


def test_stricter_criteria_raise_the_thresholds(base, search, monkeypatch):
    monkeypatch.setattr(module, "applicable_effects", lambda *_: [DRAG, LAMINAR])
    strict = Search(base, criteria=Criteria(evidence=40.0), draws=50)
    assert strict._tests[DRAG.name][0].threshold == pytest.approx(40.0 + math.log(base.problem.rows))


def test_the_power_for_an_amplitude_with_a_phase_is_that_of_a_noncentral_chi_square(base, monkeypatch):
    """Of the middle phase, whose noncentrality is nearly that of the rms over all phases."""
    law = LIBRARY["casing.precession"]
    law = replace(
        law, parameters=tuple(replace(p, grid=(900.0,)) if p.symbol == "m" else p for p in law.parameters)
    )
    monkeypatch.setattr(module, "applicable_effects", lambda *_: [law])
    monkeypatch.setattr(CaseColumns, "_grid", lambda self, effect, p: np.array([900.0]))
    found = Search(base, draws=600)
    (test,) = found._tests[law.name]
    root = found._common[law.name].root[0]
    powers = found.power(law, 0, np.array([0.0, 4.0, 5.0, 7.0]) / root)
    sine, cosine = found._whitened(found._stacked(law)[:1]).T
    free = found._level.basis
    middle = (sine + cosine) / math.sqrt(2.0)
    size = np.linalg.norm(middle - free @ (free.T @ middle)) / root
    expected = [ncx2(2, max(size * d, 1e-9) ** 2).sf(test.threshold) for d in (0.0, 4.0, 5.0, 7.0)]
    assert powers == pytest.approx(expected, abs=0.07)
    # all cases have one strength: there is one group
    assert found.power(law, 3, np.array([4.0, 7.0]) / root) == pytest.approx(powers[[1, 3]], abs=0.07)
    assert found._tests[law.name][0].parts[0].width == 2


STEP = LIBRARY["touchpoint.step"]


def axis(*places, rows=4, width=1, one_sided=True):
    """Responses along some axes of the rows, in groups of a width."""
    basis = np.eye(rows)[:, list(places)]
    return module._Responses(basis, np.ones(len(places) // width), width, one_sided)


def bare(**attributes):
    """A search whose parts are given."""
    made = Search.__new__(Search)
    vars(made).update({"criteria": DEFAULT} | attributes)
    return made


def test_the_cases_share_the_shapes_of_the_first():
    class Case(SimpleNamespace):
        def trials(self, effect, choices=None):
            return [SimpleNamespace(shape=x, of=self.own) for x in choices or self.own]

    first, second = [{"t0": 1.0}, {"t0": 2.0}], [{"t0": 7.0}, {"t0": 8.0}, {"t0": 9.0}]
    found = bare(cases=[Case(own=first), Case(own=second)])._all_trials(STEP)
    assert [[t.shape for t in case] for case in found] == [first, first]
    assert [case[0].of for case in found] == [first, second]


class TestThresholds:
    def test_a_law_of_each_case_is_also_tested_with_a_common_strength(self, monkeypatch):
        """Its p-value counts twice; BIC counts the parameters of each case."""
        family, asked = [], []
        monkeypatch.setattr(module, "FamilywiseNull", lambda nulls: family.extend(nulls) or "family")

        def smallest(null, of, factor, significance):
            assert (of, significance) == ("family", DEFAULT.significance)
            asked.append((*null, factor))
            return {1: 3.0, 2: 50.0}[null[1]] if null[2] else 3.0

        monkeypatch.setattr(module, "_smallest_score", smallest)
        fit = SimpleNamespace(
            problem=SimpleNamespace(rows=100, data=[SimpleNamespace(record=SimpleNamespace(tracked=False))])
        )
        search = bare(
            effects=[STEP, DRAG], cases=["a", "b"], fit=fit,
            _context=SimpleNamespace(draws=np.zeros((4, 6))),
            _stacked=lambda e: [], _of_case=lambda e, i: [], _responses=lambda e, groups, free: axis(0),
            _nulls=lambda e, test, columns: [(e.name, columns, i) for i in (0, 1)],
        )  # fmt: skip
        tests = search._calibrated(np.zeros((4, 0)))
        assert family == [(STEP.name, 2, 0), (DRAG.name, 1, 0)]
        assert {(name, columns, factor) for name, columns, _, factor in asked} == {
            (STEP.name, 2, 1.0), (STEP.name, 1, 2.0), (DRAG.name, 1, 1.0),
        }  # fmt: skip
        own, common = tests[STEP.name]
        assert (len(own.parts), len(common.parts)) == (2, 1)
        per_parameter = math.log(100)
        assert own.thresholds == pytest.approx([2.0 + 2 * 2 * per_parameter, 50.0])
        assert common.thresholds == pytest.approx([2.0 + 2 * per_parameter] * 2)
        assert tests[DRAG.name][0].thresholds == pytest.approx([2.0 + per_parameter] * 2)
        search.cases = ["a"]
        assert len(search._calibrated(np.zeros((4, 0)))[STEP.name]) == 1

    def test_the_scores_of_a_fit_that_fails_are_at_the_noise_of_the_recording(self, monkeypatch):
        raised = gyroscope(level=1e-6, raised=True, residual=[np.zeros(len(gyroscope().predictions[0].rows))])
        monkeypatch.setattr(module, "applicable_effects", lambda *_: [DRAG])
        for wrong, place in ((True, 0), (False, -1)):
            raised.fails = lambda criteria, wrong=wrong: wrong
            search = Search(raised, draws=1)
            assert search._level is search._context.levels[place]
            assert search._tests == {}


class TestPower:
    """One response along the first axis, without noise: a strength k has the score k^2."""

    DRAWS = 4

    def power(self, strengths, held=None, thresholds=(4.0, 9.0)):
        test = module._Test((axis(0),), np.zeros((1, self.DRAWS)), np.array(thresholds))
        shifts = {1: np.array([1.0, 0, 0, 0]), 5: np.array([2.0, 0, 0, 0])}
        asked = []

        def with_held(parameter):
            asked.append(parameter)
            return {DRAG.name: [test]}

        none = np.full((len(strengths), self.DRAWS), -1)
        search = bare(
            _common={DRAG.name: axis(0)}, _draws=self.DRAWS, _noises=[None] * len(thresholds),
            _tests={DRAG.name: [test]}, _stacked=lambda e: [None], _whitened=lambda groups: np.eye(4)[:, :1],
            _bounds=SimpleNamespace(
                held=lambda raw, k: none.copy() if held is None else np.array(held), shift=shifts.get
            ),
            _tests_with_held=with_held,
        )  # fmt: skip
        return search.power(DRAG, 0, np.array(strengths)).tolist(), asked

    def test_each_estimate_of_the_noise_has_its_threshold(self):
        assert self.power([1.0, 2.5, 3.5])[0] == [0.0, 0.5, 1.0]

    def test_a_parameter_at_its_bound_takes_its_shift_from_the_response(self):
        free, first, third = [-1] * 4, [1] * 4, [5] * 4
        found, asked = self.power([2.5, 3.5, 3.5], [free, first, third])
        assert found == [0.5, 0.5, 0.0]
        assert asked == [0, 2]

    def test_a_parameter_that_is_rarely_at_its_bound_is_neglected(self):
        """One of twelve data sets is less than half of those of one strength of three; two are not."""
        free = [-1] * 4
        assert self.power([1.0, 1.0, 3.5], [free, free, [-1, -1, -1, 5]]) == ([0.0, 0.0, 1.0], [])
        assert self.power([1.0, 1.0, 3.5], [free, free, [-1, -1, 5, 5]]) == ([0.0, 0.0, 0.5], [2])


class TestOneEffect:
    """Limits of one effect whose response to a unit strength has a noncentrality of 2 and an rms torque of 5 N m."""

    def limits(self, power, *, others=(), size=10.0, upper=3.0, **options):
        asked = {}

        def searched(function):
            def powers(effect, group, strengths):
                assert strengths == pytest.approx(module._DELTAS / 2.0)
                return function(module._DELTAS)

            return bare(power=powers)

        def upper_of(effect, group, *, planned):
            asked["planned"] = planned
            return upper

        def runs(effect, delta, needed):
            asked["runs"] = delta, needed
            return 7.0

        def alike(effect, group, at):
            asked["at"] = at
            return ("other",)

        responses = module._Responses(np.eye(4)[:, :1], np.array([2.0]), 1, True)
        trial = SimpleNamespace(shape={"w": 1.0})
        search = searched(power)
        vars(search).update(
            _common={DRAG.name: responses}, _unit_torques=lambda e: np.array([5.0]),
            _trials={DRAG.name: [[trial]]},
            _tests={DRAG.name: [SimpleNamespace(threshold=x) for x in (16.0, 9.0)]},
            fit=SimpleNamespace(units=SimpleNamespace(of=lambda unit: unit)), _upper=upper_of, _runs=runs,
            _indistinguishable=alike,
        )  # fmt: skip
        return search.limits(DRAG, size, others=[searched(o) for o in others], **options), asked

    def test_limits_are_noncentralities_over_that_of_a_unit_strength(self):
        found, asked = self.limits(lambda d: norm.cdf(d - 5.0))
        needed = 5.0 + norm.ppf(0.9)
        assert found.detection_limit == pytest.approx(needed / 2, rel=1e-4)
        assert found.detection_range == pytest.approx((needed / 2 * 5.0,) * 2, rel=1e-4)
        assert (found.stderr, found.upper_limit, found.torque) == (0.5, 1.5, 5.0)
        # 10 N m are a strength of 2 and a noncentrality of 4
        assert found.size == 2.0
        assert found.power == pytest.approx(norm.cdf(-1.0), abs=0.01)
        assert asked["runs"] == (4.0, pytest.approx(needed, rel=1e-4))
        assert (found.runs_needed, found.indistinguishable_from) == (7.0, ("other",))

    @pytest.mark.parametrize(
        ("centre", "size", "at"),
        [
            (5.0, 10.0, 5.0 + norm.ppf(0.9)),
            (5.0, 40.0, 16.0),
            (1.0, 1.0, 3.0 + norm.ppf(0.9)),  # the score of 9 is seen with 90 % probability
        ],
    )
    def test_rivals_are_those_at_the_largest_strength_in_question(self, centre, size, at):
        _, asked = self.limits(lambda d: norm.cdf(d - centre), size=size)
        assert asked["at"] == pytest.approx(at, rel=1e-3)

    def test_the_power_is_the_mean_over_estimates_of_the_noise(self):
        found, _ = self.limits(lambda d: norm.cdf(d - 3.0), others=[lambda d: norm.cdf(d - 6.0)])
        expected = 0.5 * (norm.cdf(found.curve[:, 0] - 3.0) + norm.cdf(found.curve[:, 0] - 6.0))
        assert found.curve[:, 1] == pytest.approx(expected)

    def test_what_would_be_detected_is_excluded(self):
        """A parameter at its bound makes a noncentrality of 0.83 visible with 95 % probability."""
        found, _ = self.limits(lambda d: norm.cdf(5.0 * (d - 0.5)))
        assert found.upper_limit == pytest.approx((0.5 + norm.ppf(0.95) / 5.0) / 2, rel=1e-3)
        found, _ = self.limits(lambda d: norm.cdf(5.0 * (d - 0.5)), upper=math.nan)
        assert math.isnan(found.upper_limit)
        found, _ = self.limits(lambda d: norm.cdf(5.0 * (d - 1.5)))
        assert found.upper_limit == 1.5

    @pytest.mark.parametrize("planned", [True, False])
    def test_limits_of_planned_recordings_are_expected_ones(self, planned):
        _, asked = self.limits(lambda d: norm.cdf(d - 5.0), planned=planned)
        assert asked["planned"] is planned


class TestUpper:
    """Two shapes along the first and the second axis; the residuals are 1.5 along the second one."""

    def upper(self, responses, *, planned=False, threshold=9.0, group=1):
        asked = []

        def largest(response, data, limit, *, one_sided):
            asked.append((response.tolist(), data.tolist(), limit, one_sided))
            return 77.0

        test = module._Test((responses,), np.zeros((2, 1)), np.array([threshold]))
        search = bare(
            _common={DRAG.name: responses}, _tests={DRAG.name: [test]},
            _level=SimpleNamespace(residual=np.array([0.5, 1.5, 0.0, 0.0])),
            _bounds=SimpleNamespace(largest_strength=largest), _stacked=lambda e: ["first", "second"],
            _whitened=lambda groups: np.eye(4)[:, [["first", "second"].index(g) for g in groups]] * 3.0,
        )  # fmt: skip
        return search._upper(DRAG, group, planned=planned), asked

    def test_it_is_that_of_the_shape_within_the_bounds_of_the_model(self):
        found, ((response, data, limit, one_sided),) = self.upper(axis(0, 1))
        assert (found, one_sided) == (77.0, True)
        assert limit == pytest.approx(1.5 + ONE_SIDED)
        assert (response, data) == ([0.0, 3.0, 0.0, 0.0], [0.5, 1.5, 0.0, 0.0])
        _, ((_, _, limit, _),) = self.upper(axis(0, 1), group=0)
        assert limit == pytest.approx(0.5 + ONE_SIDED)

    def test_of_planned_recordings_the_residuals_are_zero(self):
        _, ((_, data, limit, _),) = self.upper(axis(0, 1), planned=True, threshold=-1.0)
        assert (data, limit) == ([0.0] * 4, pytest.approx(ONE_SIDED))

    @pytest.mark.parametrize(("threshold", "significant"), [(2.2, True), (2.3, False)])
    def test_of_a_significant_effect_there_is_none(self, threshold, significant):
        assert math.isnan(self.upper(axis(0, 1), threshold=threshold)[0]) is significant

    def test_of_an_amplitude_with_a_phase_it_has_no_bounds(self):
        found, asked = self.upper(axis(0, 1, width=2, one_sided=False), group=0)
        assert asked == []
        assert ncx2(2, found**2).cdf(2.5) == pytest.approx(0.05, rel=1e-6)


class TestTorqueOfUnitStrength:
    def test_it_is_the_rms_over_the_cases_on_the_body_with_more_of_it(self):
        torques = [(np.array([1.0, 3.0]), np.array([2.0, 2.0])), (np.array([5.0, 0.0]), np.zeros(2))]
        cases = [SimpleNamespace(torque=lambda e, shape, t=t: t) for t in torques]
        trial = SimpleNamespace(shape={})
        search = bare(cases=cases, _trials={e.name: [[trial]] for e in (DRAG, LIBRARY["camera.clock"])})
        assert search._unit_torques(DRAG) == pytest.approx([math.sqrt((5.0 + 12.5) / 2)])
        assert np.isnan(search._unit_torques(LIBRARY["camera.clock"])).all()
        search._trials["casing.unbalance"] = [[trial] * 2]
        assert search._unit_torques(LIBRARY["casing.unbalance"]) == pytest.approx([math.sqrt(0.5)] * 2)

    def test_runs_are_counted_with_those_of_the_recordings(self):
        """Two recordings together have half of the noncentrality: eight runs, and the logarithm of four for BIC."""
        found = bare(cases=["a", "b"])._runs(DRAG, 2.0, 4.0)
        assert found / 2 * 4.0 >= 16.0 + math.log(found / 2) > (found - 1) / 2 * 4.0 - 0.2
        assert found == 9.0

    @pytest.mark.parametrize(("needed", "runs"), [(90.0, 8110.0), (101.0, math.inf)])
    def test_more_than_ten_thousand_runs_are_not_counted(self, needed, runs):
        assert bare(cases=["a"])._runs(DRAG, 1.0, needed) == runs


def test_the_score_of_a_law_is_beside_its_smallest_threshold():
    responses = axis(0, 1)
    trials = [SimpleNamespace(shape={"w": x}) for x in (1.0, 2.0)]
    search = bare(
        effects=[DRAG], _common={DRAG.name: responses}, _trials={DRAG.name: [trials]},
        _level=SimpleNamespace(residual=np.array([1.5, 2.0, 0.0, 0.0])),
        _tests={DRAG.name: [SimpleNamespace(threshold=x) for x in (16.0, 9.0)]},
    )  # fmt: skip
    assert search.scores() == {DRAG.name: (4.0, {"w": 2.0}, 9.0)}


class TestAlike:
    """Whether a strength of one effect is separable from another one, with 100 rows."""

    def alike(self, own, other, delta, *, free=(1, 1)):
        effects = [SimpleNamespace(name=n, free=[None] * k) for n, k in zip("ab", free, strict=True)]
        search = bare(
            effects=effects, _common={"a": own, "b": other},
            fit=SimpleNamespace(problem=SimpleNamespace(rows=100)),
        )  # fmt: skip
        return search._indistinguishable(effects[0], 0, delta) == ("b",)

    def opposite(self, one_sided):
        return module._Responses(-np.eye(4)[:, :1], np.ones(1), 1, one_sided)

    def test_an_effect_of_either_sign_is_compared_with_both(self):
        assert self.alike(axis(0, one_sided=False), self.opposite(True), 9.0)
        assert self.alike(axis(0), self.opposite(False), 9.0)
        assert not self.alike(axis(0), self.opposite(True), 9.0)

    @pytest.mark.parametrize(
        ("free", "budget"),
        [((1, 1), 10.0), ((1, 2), 10.0 - math.log(100)), ((2, 1), 10.0 + math.log(100))],
    )
    def test_parameters_count_as_in_bic(self, free, budget):
        """Responses with a cosine of 0.6, one of two shapes of the other effect: 0.64 of the score remains."""
        basis = np.stack([np.eye(4)[2], [0.6, 0.8, 0.0, 0.0]], axis=1)
        other = module._Responses(basis, np.ones(2), 1, True)
        for margin, alike in ((0.99, True), (1.01, False)):
            delta = math.sqrt(margin * budget / 0.64)
            assert self.alike(axis(0), other, delta, free=free) is alike


@pytest.mark.parametrize("size", [None, 0.3])
def test_a_size_is_a_torque(size):
    class Typical(Search):
        typical_torque = 20.0

    search = Typical.__new__(Typical)
    assert search._size(5.0, size) == pytest.approx(0.04 if size is None else 0.06)
    assert math.isnan(search._size(0.0, size))


def test_a_power_that_falls_again_counts_where_it_is_reached_first():
    delta = np.array([0.0, 1.0, 2.0, 3.0])
    curve = np.stack([delta, [0.1, 0.95, 0.2, 0.99]], axis=1)
    assert 0.0 < delta_of_power(curve, 0.9) < 1.0
    falling = np.stack([delta, [0.2, 0.85, 0.5, 0.95]], axis=1)
    # between 2 and 3 the power rises from the 0.85 that were reached before
    share = (norm.ppf(0.9) - norm.ppf(0.85)) / (norm.ppf(0.95) - norm.ppf(0.85))
    assert delta_of_power(falling, 0.9) == pytest.approx(2.0 + share)


@pytest.mark.parametrize(
    ("values", "shape", "absorbed", "limit"),
    [
        ({"a.k": (-3.0, 1.0)}, {}, False, 3.0 + ONE_SIDED),
        ({"a.k@x": (1.0, 0.5), "a.k@y": (-2.0, 0.25)}, {}, False, 2.0 + 0.25 * ONE_SIDED),
        ({"a.k": (0.5, 0.1)}, {}, False, 2.0),
        ({"a.k": (9.0, math.nan)}, {}, False, 2.0),
        ({"a.kk": (9.0, 1.0)}, {}, False, 2.0),
        ({"a.k": (9.0, 1.0)}, {"n": 1.0}, False, 2.0),
        ({"a.k": (9.0, 1.0)}, {}, True, 2.0),
    ],
)
def test_an_upper_limit_is_at_least_that_of_the_refit(monkeypatch, values, shape, absorbed, limit):
    monkeypatch.setattr(module, "replace", lambda old, upper_limit: SimpleNamespace(upper_limit=upper_limit))
    limits = SimpleNamespace(
        effect=SimpleNamespace(name="a"), strength="k", shape=shape, absorbed=absorbed, upper_limit=2.0
    )
    refit = SimpleNamespace(
        estimates={n: Estimate(v, u, "1", at_bound=False) for n, (v, u) in values.items()}
    )
    assert module._at_least_of_refit(limits, refit).upper_limit == pytest.approx(limit)
    assert module._at_least_of_refit(limits, None) is limits
