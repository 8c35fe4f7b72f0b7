"""Projections, bounds, ties, error modes and first-order responses; process noise of several recordings."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import twobody

from fitting import (
    REDUCED,
    EffectError,
    ErrorMode,
    ExpressionError,
    Model,
    RecordError,
    SimulationError,
    fit,
    make_record,
)
from fitting.effects._expression import Tape
from fitting.effects._mechanism import GYROSCOPE
from fitting.inference import _case_file, _problem
from fitting.inference._case_data import CaseData
from fitting.inference._error_modes import checked_modes, mode_columns, of_windows
from fitting.inference._parameters import PowerLaw, Sinusoid
from fitting.inference._problem import Problem, Projection, typical_speed
from fitting.inference._ties import Follower, chain, find_key, follow, followers, parse_tie, resolved

RNG = np.random.default_rng(6)


class TestProjection:
    WEIGHTS = np.array([1.0, 2.0, 0.5, 4.0, 1.0])

    def made(self, nuisance):
        data = SimpleNamespace(nuisance=nuisance)
        return Projection(data, lambda rows: (self.WEIGHTS * rows.T).T)

    def test_rows_are_whitened_and_orthogonal_to_the_nuisance_columns(self):
        nuisance = RNG.standard_normal((5, 2))
        rows = RNG.standard_normal(5)
        white = self.WEIGHTS[:, None] * nuisance
        expected = self.WEIGHTS * rows
        expected = expected - white @ np.linalg.lstsq(white, expected, rcond=None)[0]
        project = self.made(nuisance)
        assert project(rows) == pytest.approx(expected)
        assert project.unexplained(rows[:, None])[:, 0] == pytest.approx(expected)

    def test_what_the_nuisance_explains_is_zero(self):
        nuisance = RNG.standard_normal((5, 2))
        columns = np.column_stack([nuisance @ [1.0, 2.0], RNG.standard_normal(5)])
        found = self.made(nuisance).unexplained(columns)
        assert (found[:, 0] == 0).all()
        assert np.linalg.norm(found[:, 1]) > 0.1

    def test_few_rows_have_the_sums_of_all(self):
        columns, z = RNG.standard_normal((5, 2)), RNG.standard_normal(5)
        prediction = SimpleNamespace(rows=np.zeros(5), columns=columns, places=np.array([2, 0]), count=3)
        data = SimpleNamespace(z=z, nuisance=np.zeros((5, 0)), row_count=5)
        problem = Problem(None, (data, data), (), (self.made(np.zeros((5, 0))),) * 2, ())
        r, j = problem.residuals([prediction, prediction])
        assert len(r) == 6
        white, deviation = self.WEIGHTS[:, None] * columns, -self.WEIGHTS * z
        assert r @ r == pytest.approx(2 * deviation @ deviation)
        assert (j.T @ r)[[2, 0]] == pytest.approx(2 * white.T @ deviation)
        assert (j[:, 1] == 0).all()
        assert (j.T @ j)[np.ix_([2, 0], [2, 0])] == pytest.approx(2 * white.T @ white)
        prediction.rows = np.full(5, 1e200)
        with pytest.raises(SimulationError):
            problem.residuals([prediction, prediction])
        fewer = Problem(
            None, (data, data), (), (self.made(RNG.standard_normal((5, 2))), self.made(np.zeros((5, 1)))), ()
        )
        assert fewer.rows == 10 - 2

    @pytest.mark.parametrize(
        ("law", "lower", "upper"),
        [
            (PowerLaw(0, 1, 2, 5.0), (-np.inf, -np.inf, 2.0), (np.inf, np.inf, 9.0)),
            (PowerLaw(None, 1, 2, 5.0), (0.0, 0.0, 2.0), (7.0, np.inf, 9.0)),
            (PowerLaw(0, 1, 2, 5.0, held="d"), (0.0, -np.inf, 2.0), (7.0, np.inf, 9.0)),
            (PowerLaw(0, 1, 2, 5.0, held="f"), (-np.inf, 1.0, 2.0), (np.inf, 8.0, 9.0)),
        ],
    )
    def test_combined_variables_have_no_bounds(self, monkeypatch, law, lower, upper):
        monkeypatch.setattr(_problem, "find_sinusoids", lambda layout: ())
        problem = Problem(None, (), (), (), (law,))
        given = np.array([0.0, 1.0, 2.0]), np.array([7.0, 8.0, 9.0])
        found = problem.transformed_bounds(*given)
        assert found[0].tolist() == list(lower)
        assert found[1].tolist() == list(upper)
        assert given[0].tolist() == [0.0, 1.0, 2.0]

    def test_a_signed_power_law_and_a_strength_with_a_phase_have_no_bounds(self, monkeypatch):
        monkeypatch.setattr(_problem, "find_sinusoids", lambda layout: (Sinusoid(0, 3),))
        problem = Problem(None, (), (), (), (PowerLaw(None, 1, 2, 5.0),))
        lower, upper = problem.transformed_bounds(
            np.array([0.0, -1.0, 2.0, -4.0]), np.array([7.0, 8.0, 9.0, 4.0])
        )
        assert lower.tolist() == [-np.inf, -np.inf, 2.0, -4.0]
        assert upper.tolist() == [np.inf, np.inf, 9.0, 4.0]

    def test_the_typical_speed_of_a_joint_is_the_mean_of_medians(self):
        one = np.array([[9.0, 4.0], [1.0, 4.0], [5.0, 4.0]])
        other = np.array([[20.0, 0.0]])
        joint = GYROSCOPE.couplings[0]
        assert typical_speed([one, other], GYROSCOPE, joint) == pytest.approx((3.0 + 20.0) / 2)
        assert typical_speed([0 * one], GYROSCOPE, joint) == 1.0


class TestTies:
    KEYS = ("a.b.k", "a.c.k", "a.c.m@x", "casing: -q*omega_c**3.q")

    def test_a_name_is_the_end_of_one_key(self):
        assert find_key("b.k", self.KEYS) == "a.b.k"
        assert find_key("m", self.KEYS) == "a.c.m@x"
        assert find_key("a.c.k", self.KEYS) == "a.c.k"
        for wrong in ("k", "c", "x", ".k"):
            with pytest.raises(EffectError):
                find_key(wrong, self.KEYS)

    def test_an_expression_has_the_values_of_its_parameters(self):
        keys = ("a.b.k", "a.c.m", "casing: -q*omega_c**3.q")
        tree = parse_tie("2*a.b.k + sqrt(m) - casing: -q*omega_c**3.q", keys)
        values = {"a.b.k": 3.0, "a.c.m": 16.0, "casing: -q*omega_c**3.q": 1.0}
        assert Tape([tree])(values)[0] == pytest.approx(9.0)
        for wrong in ("2*none", 3):
            with pytest.raises(EffectError):
                parse_tie(wrong, keys)

    def test_chains_of_expressions_are_resolved_and_circles_are_not(self):
        keys = ("a.x", "a.y", "a.z")
        found = resolved({"x": "2*y", "y": "z + 1"}, keys, ("a.c",))
        assert Tape([found["a.x"]])({"a.z": 4.0})[0] == pytest.approx(10.0)
        assert Tape([resolved({"x": "3*c"}, keys, ("a.c",))["a.x"]])({"a.c": 2.0})[0] == pytest.approx(6.0)
        for circle in ({"x": "x + 1"}, {"x": "2*y", "y": "x"}, {"x": "y", "y": "z", "z": "x"}):
            with pytest.raises(EffectError, match="circular"):
                resolved(circle, keys, ())

    def test_each_case_follows_its_own_sources(self):
        trees = resolved({"x": "y*z*c"}, ("a.x", "a.y", "a.z"), ("a.c",))
        index = {"a.x@1": 0, "a.x@2": 1, "a.y@1": 2, "a.y@2": 3, "a.z": 4}
        tied = followers(trees, index, {"a.c": 10.0})
        theta = np.array([0.0, 0.0, 2.0, 3.0, 5.0])
        assert follow(theta, tied).tolist() == [100.0, 150.0, 2.0, 3.0, 5.0]
        assert theta[0] == 0.0
        slope = chain(theta, tied)
        expected = np.eye(5)
        expected[0] = [0, 0, 50.0, 0, 20.0]
        expected[1] = [0, 0, 0, 50.0, 30.0]
        assert slope == pytest.approx(expected)
        with pytest.raises(EffectError, match="one value for all"):
            followers(trees, {"a.x": 0, "a.y@1": 1, "a.z": 2}, {"a.c": 1.0})
        broken = Follower(0, Tape([parse_tie("1/y", ("y",))]), (("y", 1),), {})
        with pytest.raises(ExpressionError), np.errstate(all="ignore"):
            follow(np.array([1.0, 0.0]), [broken])


class TestModes:
    T = np.array([0.0, 1.0, 2.0])

    def mode(self, **more):
        given = {"name": "m", "time": self.T, "basis": np.array([[1.0], [2.0], [4.0]]), "covariance": [[9.0]]}
        return ErrorMode(**given | more)

    def test_columns_have_one_standard_deviation(self):
        shared = self.mode(group="g")
        rotor = self.mode(body="rotor", window=1, group="g", basis=np.array([1.0, 1.0, 1.0]))
        own = self.mode(name="n", covariance=np.array([[4.0]]))
        casing, windows = mode_columns([shared, rotor, own], self.T, [self.T, self.T])
        assert casing @ casing.T == pytest.approx(13.0 * np.outer([1.0, 2.0, 4.0], [1.0, 2.0, 4.0]))
        assert (windows[0] == 0).all()
        assert windows[1] @ casing.T == pytest.approx(9.0 * np.outer([1.0, 1.0, 1.0], [1.0, 2.0, 4.0]))
        every = self.mode(body="rotor")
        casing, windows = mode_columns([every], self.T, [self.T, self.T[:1]])
        assert (casing == 0).all()
        assert np.abs(windows[0][:, 0]) == pytest.approx([3.0, 6.0, 12.0])
        assert np.abs(windows[1][:, 0]) == pytest.approx([3.0])

    def test_two_amplitudes_have_their_covariance(self):
        basis, covariance = RNG.standard_normal((3, 2)), np.array([[4.0, 1e-3], [1e-3, 1e-6]])
        mode = self.mode(basis=basis, covariance=covariance)
        casing, _ = mode_columns([mode], self.T, [])
        assert casing @ casing.T == pytest.approx(basis @ covariance @ basis.T)
        assert mode.standard_uncertainty() == pytest.approx(np.sqrt(np.diag(basis @ covariance @ basis.T)))
        assert mode.key == "casing/m"
        assert mode.at(np.array([-1.0, 0.5, 3.0])) == pytest.approx(
            np.array([[0, 0], 0.5 * (basis[0] + basis[1]), [0, 0]])
        )
        slope = np.gradient(basis, self.T, axis=0)
        assert mode.rates().basis == pytest.approx(slope)

    def test_windows_that_are_kept_have_new_numbers(self):
        modes = [self.mode(body="rotor", window=w, group=str(w)) for w in (0, 1, 2, 3)] + [self.mode()]
        found = of_windows(modes, [False, True, False, True])
        assert [(m.group, m.window) for m in found] == [("1", 0), ("3", 1), ("", None)]

    def test_a_group_has_one_covariance(self):
        one, other = self.mode(group="g"), self.mode(group="g", covariance=[[9.1]])
        assert checked_modes([one, self.mode(group="g", name="n")])[0] is one
        for wrong in ([one, other], "x", [3]):
            with pytest.raises(RecordError):
                checked_modes(wrong)


class TestCaseFile:
    def test_starts_of_windows_are_those_of_the_cameras_or_of_the_case(self):
        rotor = SimpleNamespace(segment=np.array([0, 0, 2, 2, 5]))

        def sigma(start_u, stated):
            return _case_file._start_sigma(
                SimpleNamespace(start_u=start_u, attributes={"start_u": stated}), rotor
            )

        assert sigma({"rotor_0": 0.1, "rotor_5": -1.0}, 9.0) == [0.1, 0.0, 0.0]
        assert sigma({}, 0.5) == [0.5, 0.5, 0.5]
        assert sigma({}, 0.0) == [0.0, 0.0, 0.0]
        for unknown in (math.nan, -1.0, math.inf):
            assert all(math.isnan(s) for s in sigma({}, unknown))
        masks = _case_file._windows(rotor)
        assert [m.tolist() for m in masks][1] == [False, False, True, True, False]
        assert len(masks) == 3
        assert len(_case_file._windows(SimpleNamespace(segment=np.zeros(0)))) == 1

    def test_uncertainties_of_an_input_are_all_given_or_none(self, tmp_path):
        values = {"time": [0.0, 1.0], "value": [1.0, 2.0]}
        assert _case_file._input(tmp_path, "u", u=np.array([np.nan, np.nan]), **values).u is None
        assert _case_file._input(tmp_path, "u", u=np.array([0.1, 0.2]), **values).u.tolist() == [0.1, 0.2]
        with pytest.raises(RecordError, match="lacks some"):
            _case_file._input(tmp_path, "u", u=np.array([0.1, np.nan]), **values)

    def test_modes_have_the_measured_samples_of_their_window(self):
        stored = SimpleNamespace(
            name="m", basis=np.arange(5.0)[:, None], covariance=[[1.0]], group="g", origin="axis"
        )
        series = SimpleNamespace(
            time=np.array([0.0, 1.0, 2.0, np.nan, 4.0]),
            value=np.array([0.0, np.nan, 2.0, 3.0, 4.0]),
            modes=[stored],
        )
        windows = {
            0: np.array([True, True, True, True, False]),
            3: np.array([False, False, False, False, True]),
        }
        first, second = _case_file._modes(series, "rotor", windows)
        assert (first.window, first.time.tolist(), first.basis[:, 0].tolist()) == (0, [0.0, 2.0], [0.0, 2.0])
        assert (second.window, second.time.tolist(), second.origin) == (3, [4.0], "axis")


class TestFirstNoise:
    """A body of inertia 3 with accelerations of 2, 4 and 6 rad/s2, from 100 s to 140 s; the main body has 1 rad/s2."""

    @pytest.fixture
    def problem(self, monkeypatch):
        made = []

        class Response:
            def __init__(self, data, motion):
                made.append((data, motion))

            def whitener(self, noise):
                return ("whitener", noise.rms, noise.time)

        monkeypatch.setattr(_problem, "TorqueResponse", Response)
        rates = np.stack([[2.0, -4.0, 6.0], [1.0, 1.0, 1.0]], axis=1)
        record = SimpleNamespace(span=(100.0, 140.0), inertias=(3.0, 7.0))
        data = SimpleNamespace(record=record, casing=SimpleNamespace(scale=1.4), process_noise="process")
        dynamics = SimpleNamespace(rates=lambda times, y, numbers: rates)
        path = SimpleNamespace(mesh=SimpleNamespace(times=None), y=None)
        return SimpleNamespace(
            cases=[SimpleNamespace(data=data, dynamics=dynamics, case=0)],
            predict=lambda theta: [SimpleNamespace(path=path, motion="motion")],
            layout=SimpleNamespace(numbers=lambda theta, case: {}),
        )

    def test_it_is_a_hundredth_of_the_median_torque_for_a_two_hundredth_of_the_record(self, problem):
        (noise,) = _problem.first_noise(problem, np.zeros(1))
        level, time = 0.01 * 3.0 * 4.0, 40.0 / 200
        assert noise.level == pytest.approx(level)
        assert noise.whitener == ("whitener", pytest.approx(level), pytest.approx(time))
        assert (noise.time, noise.scale, noise.process) == (pytest.approx(time), 1.4, "process")

    @pytest.mark.parametrize(("level", "raised"), [(0.1, 0.12), (0.2, 0.2)])
    def test_a_known_noise_is_raised_to_it(self, problem, level, raised):
        known = SimpleNamespace(level=level, at=lambda x: x)
        assert _problem.raised_noise(problem, np.zeros(1), [known]) == (pytest.approx(raised),)


LEVEL = 1e-8


def recorded(label, seed, level, sigma, start):
    motion = twobody.simulate(start=start, ou=level, ou_time=0.4, seed=seed, span=100.0)
    cameras = twobody.Cameras(100.0, windows=(5.0, 40.0, 80.0), sigma=sigma)
    return CaseData.of(make_record(**{**twobody.film(motion, seed, cameras), "label": label}))


@pytest.fixture(scope="module")
def quiet_camera():
    return recorded("quiet", 1, LEVEL, 2e-4, (900.0, 5.0))


@pytest.mark.slow
def test_process_noise_is_estimated_with_a_noisy_camera(quiet_camera):
    found = fit(Model.of(REDUCED), [quiet_camera, recorded("loud", 3, LEVEL, 1e-2, (700.0, 12.0))])
    assert found.verdict == "no_lack_of_fit"
    assert [n.pure for n in found.noise] == pytest.approx([LEVEL] * 2, rel=0.5)


@pytest.mark.slow
def test_a_recording_that_excludes_process_noise_has_a_low_level(quiet_camera):
    found = fit(Model.of(REDUCED), [quiet_camera, recorded("still", 3, 0.0, 1e-3, (700.0, 12.0))])
    assert found.verdict == "no_lack_of_fit"
    assert found.noise[0].pure == pytest.approx(LEVEL, rel=0.5)
    assert found.noise[1].pure < 0.3 * LEVEL


@pytest.mark.parametrize(("common", "driven"), [(True, False), (False, False), (False, True)])
def test_recordings_with_a_common_level_keep_it(monkeypatch, common, driven):
    """Of a driven body the level is at most the lowest one that the recording allows, which limits it."""

    class Level(SimpleNamespace):
        def at(self, level):
            return Level(**(vars(self) | {"level": level}))

    noise = [
        Level(pure=1e-9, level=0.0, least=2e-8, whitener=None, excess=0.0, common=common) for _ in range(2)
    ]
    levels = iter([(3e-8, 5.0), (1e-8, 6.0)])
    monkeypatch.setattr(_problem, "remaining_level", lambda *_: next(levels))
    monkeypatch.setattr(_problem, "_rows_at_rest", lambda *_: np.zeros((3, 0)))
    monkeypatch.setattr(_problem, "replace", lambda n, **changed: Level(**(vars(n) | changed)))
    none = np.zeros((3, 0))
    data = SimpleNamespace(
        nuisance=none, harmonic_responses=none, z=np.zeros(3), largest_torque=1.0, driven=driven
    )
    prediction = SimpleNamespace(columns=none, places=np.zeros(0, dtype=int), rows=np.zeros(3))
    layout = SimpleNamespace(
        at_bound=lambda _: np.zeros(0, dtype=bool), model=SimpleNamespace(restoring=False)
    )
    problem = SimpleNamespace(data=[data] * 2, layout=layout, predict=lambda _: [prediction] * 2)
    found = _problem.refine_level(problem, np.zeros(0), noise)
    assert [n.level for n in found] == [2e-8 if driven else 3e-8, 3e-8 if common else 1e-8]
    assert [n.limited for n in found] == [driven] * 2
    assert [n.excess for n in found] == [5.0, 6.0]
    assert [n.common for n in found] == [common] * 2


@pytest.mark.parametrize(
    ("alone", "joint", "common"),
    [
        ((29, 1), (31, 1), True),
        ((31, 1), (31, 1), False),
        ((29, 1), (29, 1), False),
        ((1, 31), (31, 1), False),
    ],
)
def test_a_recording_is_given_up_only_if_the_model_does_not_describe_it_alone(
    monkeypatch, alone, joint, common
):
    """Ratios of the random torque to that of the recording: of each fit alone, and in the joint fit."""
    from fitting.inference import _fit

    class Level(SimpleNamespace):
        def at(self, level):
            return Level(**(vars(self) | {"level": level}))

    def of(ratio):
        return Level(pure=1.0, level=float(ratio), common=False)

    fits = iter([SimpleNamespace(noise=[of(r)], labels=("a",), estimates={}) for r in alone])
    solution = SimpleNamespace(theta=np.zeros(1))
    noise = tuple(of(r) for r in joint)
    monkeypatch.setattr(_fit, "fit", lambda *_, **__: next(fits))
    monkeypatch.setattr(_fit, "search_with_noise", lambda *_, **__: (solution, noise))
    monkeypatch.setattr(_fit, "initial_values", lambda *_: np.zeros(1))
    monkeypatch.setattr(_fit, "_deviance", lambda *_: 0.0)
    monkeypatch.setattr(_problem, "replace", lambda n, **changed: Level(**(vars(n) | changed)))
    problem = SimpleNamespace(data=[None, None], layout=SimpleNamespace(model=None, names=()))
    _, found = _fit._from_separate_fits(problem, solution, noise, quick=False)
    assert [n.common for n in found] == [common] * 2
    assert [n.level for n in found] == ([31.0, 31.0] if common else [float(r) for r in joint])


@pytest.mark.parametrize(
    ("restoring", "gross", "driven", "largest", "level"),
    [
        (False, True, False, 1.0, 3e-8),
        (True, False, False, 1.0, 3e-8),
        (True, True, False, 1.0, 7e-9),
        (True, True, True, 1.0, 7e-9),
        (False, False, True, 1.0, 2e-8),
        (False, False, False, 1e-8, 1e-8),
        (False, False, False, 0.0, 3e-8),
        (False, False, True, 1e-8, 1e-8),
    ],
)
def test_the_level_of_the_residuals_has_its_limits(monkeypatch, restoring, gross, driven, largest, level):
    """Of 3e-8 N m; that of the recording is 7e-9, its least plausible one 2e-8."""

    class Level(SimpleNamespace):
        def at(self, level):
            return Level(**(vars(self) | {"level": level}))

    monkeypatch.setattr(_problem, "remaining_level", lambda whitener, residual, columns: (3e-8, 4.0))
    monkeypatch.setattr(_problem, "fails_grossly", lambda *_: gross)
    monkeypatch.setattr(_problem, "free_columns", lambda data, p, moving: None)
    monkeypatch.setattr(_problem, "replace", lambda n, **changed: Level(**(vars(n) | changed)))
    data = SimpleNamespace(z=np.zeros(3), largest_torque=largest, driven=driven)
    prediction = SimpleNamespace(rows=np.zeros(3))
    layout = SimpleNamespace(
        at_bound=lambda _: np.zeros(0, dtype=bool), model=SimpleNamespace(restoring=restoring)
    )
    problem = SimpleNamespace(data=[data], layout=layout, predict=lambda _: [prediction])
    noise = [Level(level=1.0, pure=7e-9, least=2e-8, whitener=None, common=False)]
    (found,) = _problem.refine_level(problem, np.zeros(0), noise)
    assert (found.level, found.excess, found.limited) == (level, 4.0, driven)


@pytest.mark.parametrize(("share", "gross"), [(0.98, False), (1.02, True)])
@pytest.mark.parametrize("time", [0.3, 2.0])
def test_a_torque_that_makes_the_phase_random_is_a_gross_misfit(monkeypatch, share, gross, time):
    """An oscillation of 1.5 s and 0.2 rad over 40 periods, with an inertia of 3e-4 kg m2."""
    w = 2 * np.pi / 1.5
    criteria = SimpleNamespace(gross_misfit=0.7)
    density = lambda s: 2 * (s / 3e-4) ** 2 * time / (1 + (w * time) ** 2)  # noqa: E731
    unit = np.sqrt(density(1.0) * 60.0 / 2) / (0.2 * w)
    level = share * 0.7 / unit
    monkeypatch.setattr(_problem, "remaining_level", lambda whitener, residual, columns: (level, 0.0))
    motion = SimpleNamespace(
        period=1.5, periods=40, slow_motion=SimpleNamespace(amplitude=np.array([0.2, -0.2]))
    )
    none = np.zeros((2, 0))
    data = SimpleNamespace(
        motion=motion, nuisance=none, z=np.zeros(2), criteria=criteria, record=SimpleNamespace(I_casing=3e-4)
    )
    prediction = SimpleNamespace(columns=none, rows=np.zeros(2))
    noise = SimpleNamespace(whitener=None, time=time)
    assert _problem.fails_grossly(data, prediction, noise) is gross
    motion.slow_motion = None
    assert not _problem.fails_grossly(data, prediction, noise)
