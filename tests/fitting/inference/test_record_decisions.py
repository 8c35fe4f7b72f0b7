"""Records and their rough speeds: cleaning, digests, medians, and curves, with known numbers and against SciPy."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq

from fitting import Case, ErrorMode, Input, Record, RecordError, make_record
from fitting._numbers import SI, WITHOUT_INERTIA
from fitting.effects._mechanism import Mechanism
from fitting.inference import _record
from fitting.inference._case import inward, model_of, outward
from fitting.inference._record import (
    PiecewiseCubics,
    Samples,
    hermite,
    initial_speeds,
    median_width,
    running_median,
    scales_of,
    speeds,
)

T = np.linspace(0.0, 10.0, 101)


def samples(value, t=T, sigma=1e-3, state=0):
    return Samples(t, value, np.full(len(t), sigma), state)


def record(casing=None, rotor=(), **more):
    return Record("x", 2.0, 3.0, casing or samples(4.0 * T), tuple(rotor), **more)


class TestCleaning:
    def clean(self, value, sigma=1e-3, t=T):
        return _record._clean(t, np.full(len(t), value), np.full(len(t), sigma), what="body")

    @pytest.mark.parametrize(
        ("value", "sigma", "valid"),
        [
            (0.9e20, 1e3, True),
            (1.0e20, 1e3, False),
            (1.1e-20, 1e-30, True),
            (0.9e-20, 1e-30, False),
            (0.0, 1e-3, True),
            (0.9e15, 1e-3, True),
            (1.1e15, 1e-3, False),
            (1.0, 1.1e20, False),
        ],
    )
    def test_numbers_of_impossible_size_are_refused(self, value, sigma, valid):
        if valid:
            assert len(self.clean(value, sigma)) == 101
        else:
            with pytest.raises(RecordError, match="units"):
                self.clean(value, sigma)

    def test_unknown_uncertainties_are_the_median_or_a_thousandth(self):
        sigma = np.full(101, np.nan)
        assert (_record._clean(T, T, sigma, what="body").sigma == 1e-3).all()
        sigma[:5] = 1.0, 2.0, 9.0, 0.0, -1.0
        found = _record._clean(T, T, sigma, what="body").sigma
        assert found[:3].tolist() == [1.0, 2.0, 9.0]
        assert (found[3:] == 2.0).all()

    def test_a_stated_error_needs_level_and_time(self):
        assert _record._stated() == (0.0, 0.0, 0.0, 0.0)
        assert _record._stated(1.0, 2.0, 3.0, 4.0) == (1.0, 2.0, 3.0, 4.0)
        assert _record._stated(1.0, 0.0, 3.0) == (0.0, 0.0, 3.0, 0.0)
        assert _record._stated(0.0, 2.0, -3.0, -4.0) == (0.0, 0.0, 0.0, 0.0)

    def test_a_profile_increases_in_time(self):
        assert _record._profile([(0, 1), (2, 0)], stated=True) == ((0.0, 1.0), (2.0, 0.0))
        assert _record._profile([], stated=False) == ()
        for pairs, stated in (
            ([(0, 1)], False),
            ([(0, 1), (0, 1)], True),
            ([(1, 1), (0, 1)], True),
            ([(0, -1)], True),
            ([(0, math.nan)], True),
        ):
            with pytest.raises(RecordError):
                _record._profile(pairs, stated=stated)

    @pytest.mark.parametrize(
        ("where", "change", "words"),
        [
            ("casing", lambda run: run[:2], "the casing is not a triple"),
            ("casing", lambda run: (*run, run[2]), "the casing is not a triple"),
            ("rotor", lambda run: [run, run[:2]], "the rotor window is not a triple"),
            ("rotor", lambda run: [(*run, run[2])], "the rotor window is not a triple"),
            ("rotor", lambda run: 3.0, "the rotor is not a list of windows"),
            ("casing", lambda run: (run[0], run[1][:-1], run[2]), "have the shapes"),
            ("casing", lambda run: tuple(a[:, None] for a in run), "have the shapes"),
            ("casing", lambda run: (run[0], ["a"] * len(T), run[2]), "holds no numbers"),
            ("quantity", lambda run: "torque", "the quantity is 'torque'"),
        ],
    )
    def test_a_run_is_three_arrays_of_the_same_length(self, where, change, words):
        run = (T, 4.0 * T, np.full(len(T), 1e-3))
        given = {"casing": run, "rotor": [], "I_rotor": 1.0, "I_casing": 2.0, "quantity": "angle"}
        make_record(**given)
        with pytest.raises(RecordError, match=words):
            make_record(**given | {where: change(run)})

    @pytest.mark.parametrize(("count", "valid"), [(23, False), (24, True)])
    def test_a_body_needs_24_samples(self, count, valid):
        run = (T[:count], 4.0 * T[:count], np.full(count, 1e-3))
        given = {"casing": run, "rotor": [], "I_rotor": 1.0, "I_casing": 2.0}
        if valid:
            made = make_record(**given, name="disc", per_inertia=True)
            assert (made.body, made.units, made.single) == ("disc", WITHOUT_INERTIA, True)
            assert make_record(**given).units == SI
        else:
            with pytest.raises(RecordError, match="at least 24"):
                make_record(**given)

    def test_starts_and_modes_follow_the_windows_that_are_kept(self):
        def run(count, first=0.0):
            t = first + 0.01 * np.arange(count)
            return t, 100 * t, np.full(count, 1e-3)

        modes = [
            ErrorMode("m", run(9)[0], np.ones(9), [[1.0]], body="rotor", window=w, group=str(w))
            for w in (0, 1, 2)
        ]
        made = make_record(
            casing=(T, T, np.full(101, 1e-3)), rotor=[run(9), run(7, 3.0), run(9, 5.0)], I_rotor=1.0, I_casing=2.0,
            start_sigma=(0.1, 0.2, 0.3), modes=modes, harmonics=(0.01, 0.02, -1.0),
        )  # fmt: skip
        assert len(made.rotor) == 2
        assert made.start_sigma == (0.1, 0.3)
        assert [(m.group, m.window) for m in made.modes] == [("0", 0), ("2", 1)]
        assert [r.harmonic for r in made.rotor] == [0.01, 0.0]

    @pytest.mark.parametrize(("count", "valid"), [(7, False), (8, True)])
    def test_every_run_of_a_chain_is_usable(self, count, valid):
        chain = Mechanism.of(("wheel", "motor"), {"belt": ("motor", "wheel")})
        runs = [(T[:n], 9.0 * T[:n], np.full(n, 1e-3)) for n in (20, count)]
        given = {"casing": (T, T, np.full(101, 1e-3)), "rotor": runs, "I_rotor": 1.0, "I_casing": 2.0}
        if valid:
            assert len(make_record(**given, mechanism=chain, states=[0, 0]).rotor) == 2
        else:
            with pytest.raises(RecordError, match="motor has a run"):
                make_record(**given, mechanism=chain, states=[0, 0])
            assert len(make_record(**given).rotor) == 1

    def test_inputs_have_different_names_and_cover_the_record(self):
        run = (T, 4.0 * T, np.full(101, 1e-3))
        given = {"casing": run, "rotor": [], "I_rotor": 1.0, "I_casing": 2.0}
        u = Input("u", np.array([0.0, 5.0, 10.0]), np.array([0.0, 1.0, 0.0]), "A")
        assert make_record(**given, inputs=[u]).inputs == (u,)
        for wrong in ([u, u], [Input("u", [90.0, 91.0], [0.0, 1.0])], ["u"], 3):
            with pytest.raises(RecordError):
                make_record(**given, inputs=wrong)
        heat = Input("h", np.array([0.0, 10.0]), np.array([0.0, 1.0]), "K")
        held = Input("c", np.array([0.0, 10.0]), np.array([1.0, 1.0]), "A")
        assert make_record(**given, inputs=[u, heat, held]).driving == (u,)


class TestDigest:
    def test_every_stated_number_changes_it(self):
        u = Input("u", T[[0, -1]], np.array([0.0, 1.0]), "A")
        mode = ErrorMode("m", T, np.ones(101), [[1.0]])
        base = record(rotor=[samples(9.0 * T)])
        changes = [
            {"I_rotor": 2.5},
            {"I_casing": 3.5},
            {"quantity": "omega"},
            {"casing": samples(4.1 * T)},
            {"casing": samples(4.0 * T, sigma=2e-3)},
            {"rotor": (samples(9.1 * T),)},
            {"start_sigma": (0.1,)},
            {"correlated": (1.0, 2.0, 0.0, 0.0)},
            {"correlated": (1.0, 2.0, 0.0, 3.0)},
            {"correlated_profile": ((0.0, 1.0),)},
            {"I_rotor_u": 0.1},
            {"I_casing_u": 0.1},
            {"inputs": (u,)},
            {"inputs": (replace(u, u=np.ones(2)),)},
            {"inputs": (replace(u, delay=1.0),)},
            {"rotor": (replace(samples(9.0 * T), harmonic=0.1),)},
            {"modes": (mode,)},
            {"modes": (replace(mode, covariance=np.array([[2.0]])),)},
            {"mechanism": Mechanism.of(("a", "b"), {"j": ("a", "b")})},
        ]
        digests = [replace(base, digest="", **c).digest for c in changes]
        assert len({base.digest, *digests}) == len(changes) + 1

    def test_names_and_unknown_uncertainties_do_not_change_it(self):
        base = record(rotor=[samples(9.0 * T)])
        for change in (
            {"label": "y"},
            {"surface": "glass"},
            {"start_sigma": (0.0,)},
            {"start_sigma": (math.nan,)},
        ):
            assert replace(base, digest="", **change).digest == base.digest
        assert replace(base, digest="known").digest == "known"


class TestBodies:
    def test_a_gyroscope_has_casing_and_rotor(self):
        made = record(rotor=[samples(9.0 * T)], I_casing_u=0.3)
        casing, rotor = made.bodies
        assert (casing.name, casing.state, casing.inertia, casing.relative_u) == (
            "casing",
            1,
            3.0,
            pytest.approx(0.1),
        )
        assert (rotor.name, rotor.state, rotor.inertia, rotor.relative_u) == ("rotor", 0, 2.0, 0.0)
        assert (made.spun.name, made.joints, made.inertias) == ("rotor", ("bearing",), (2.0, 3.0))
        assert record().joints == ()
        assert record().body == "body"
        assert record(name="disc").body == "disc"
        assert not made.unstated_starts
        assert record(start_sigma=(0.1, math.nan)).unstated_starts

    def test_a_chain_has_its_bodies_in_order(self):
        chain = Mechanism.of(
            ("wheel", "motor", "pump"), {"belt": ("motor", "wheel"), "shaft": ("wheel", "pump")}
        )
        made = record(
            rotor=[samples(9.0 * T, state=2), samples(2.0 * T)], mechanism=chain, further=((5.0, 0.5),)
        )
        assert [(b.name, b.state, b.inertia) for b in made.bodies] == [
            ("wheel", 1, 3.0), ("motor", 0, 2.0), ("pump", 2, 5.0),
        ]  # fmt: skip
        assert made.bodies[2].relative_u == pytest.approx(0.1)
        assert made.spun.name == "pump"
        assert made.inertias == (2.0, 3.0, 5.0)
        assert made.largest_speeds == pytest.approx(
            {"omega_motor": 2.0, "omega_wheel": 4.0, "omega_pump": 9.0}
        )

    def test_the_span_covers_all_runs(self):
        assert record(rotor=[samples(T, t=T + 5.0)]).span == (0.0, 15.0)
        assert record(rotor=[samples(T, t=T - 5.0)]).span == (-5.0, 10.0)

    def test_the_largest_speed_is_a_quantile_of_means_over_five_samples(self):
        omega = np.arange(100.0)
        made = record(samples(omega, t=T[:100]), quantity="omega")
        means = omega.reshape(20, 5).mean(axis=1)
        largest = float(np.quantile(means, 0.95))
        assert made.largest_speeds == pytest.approx({"omega_c": largest, "omega_r": largest})
        angle = T[:96] ** 2
        made = record(samples(angle, t=T[:96]))
        rates = np.diff(angle[::5]) / np.diff(T[:96:5])
        assert made.largest_speeds["omega_c"] == pytest.approx(np.quantile(rates, 0.95))

    @pytest.mark.parametrize(("ratio", "moves"), [(2.9, False), (3.1, True)])
    def test_a_body_moves_faster_than_its_noise(self, ratio, moves):
        rotor = samples(np.full(100, 70.0), t=T[:100], sigma=1.0)
        casing = samples(np.full(100, -ratio / math.sqrt(5)), t=T[:100], sigma=1.0)
        made = record(casing, [rotor], quantity="omega")
        assert made.largest_speeds["omega_c"] == pytest.approx(ratio / math.sqrt(5) if moves else 70.0)
        step = T[5] - T[0]
        slow = samples(ratio * math.sqrt(2) / step * T[:96], t=T[:96], sigma=1.0)
        fast = samples(70.0 * T[:96], t=T[:96], sigma=1e-3)
        found = record(slow, [fast]).largest_speeds["omega_c"]
        assert found == pytest.approx(ratio * math.sqrt(2) / step if moves else 70.0)

    def test_scales_are_the_largest_of_all_records(self):
        one = record(samples(4.0 * T), [samples(90.0 * T)])
        other = record(samples(7.0 * T, t=T), [samples(50.0 * T, t=T + 8.0)])
        found, length = scales_of([one, other])
        assert found == pytest.approx({"omega_c": 7.0, "omega_r": 90.0})
        assert length == 18.0


class TestCurves:
    @pytest.mark.parametrize(
        ("count", "width"),
        [(5, 3), (29, 3), (30, 3), (40, 5), (49, 5), (50, 5), (60, 7), (509, 51), (2000, 51)],
    )
    def test_a_median_has_at_most_a_tenth_of_the_samples(self, count, width):
        assert median_width(count) == width
        assert median_width(2000, 11) == 11

    @pytest.mark.parametrize("count", [30, 1500])
    def test_a_running_median_repeats_its_ends(self, count):
        x = np.random.default_rng(0).standard_normal(count)
        padded = np.concatenate([np.full(3, x[0]), x, np.full(3, x[-1])])
        assert running_median(x, 7).tolist() == [np.median(padded[i : i + 7]) for i in range(count)]

    def test_speeds_are_gradients_of_medians_without_their_ends(self):
        t = np.arange(600) * 0.01
        time, omega = speeds(samples(3.0 * t, t=t), "angle")
        assert time.tolist() == t[50:-50].tolist()
        assert omega == pytest.approx(np.full(500, 3.0))
        time, omega = speeds(samples(3.0 * t, t=t), "omega", 5, 10)
        assert time.tolist() == t[10:-10].tolist()
        assert omega == pytest.approx(3.0 * t[10:-10])
        assert len(speeds(samples(3.0 * t[:100], t=t[:100]), "angle")[0]) == 80

    @pytest.mark.parametrize("angle", [True, False])
    def test_pieces_have_speed_and_slope_in_their_middle(self, angle):
        t = np.linspace(0.0, 4.0, 48)
        value = 5.0 + 3.0 * t + 0.5 * t**2 if angle else 3.0 + t
        rows = _record._local(samples(value, t=t), 4, angle)
        pieces = np.array_split(t, 4)
        middle = np.array([p.mean() for p in pieces])
        assert rows[:, 0] == pytest.approx(middle)
        assert rows[:, 1] == pytest.approx(3.0 + middle)
        assert rows[:, 2] == pytest.approx(np.ones(4))
        short = _record._local(samples(value[:2], t=t[:2]), 1, angle)
        assert short[0, 1] == pytest.approx(
            (value[1] - value[0]) / (t[1] - t[0]) if angle else value[:2].mean()
        )
        assert math.isnan(short[0, 2]) is angle

    @pytest.mark.parametrize(("share", "pieces"), [(0.4, 1), (0.49, 1), (0.6, 30), (1.0, 50)])
    def test_a_long_window_is_divided_like_the_run(self, share, pieces):
        t = np.linspace(0.0, 10.0 * share, 1000)
        made = record(samples(T), [samples(t, t=t)])
        assert _record._pieces(made.rotor[0], made, 50, 12) == pieces
        assert _record._pieces(samples(t[::20], t=t[::20]), made, 50, 12) == (1 if share < 0.5 else 4)

    @pytest.mark.parametrize("sense", [1.0, -1.0])
    def test_the_rotor_is_cubic_between_windows_and_straight_beyond(self, sense):
        rows = np.array([[6.0, 60.0, -5.0], [2.0, 100.0, -12.0]]) * [1.0, sense, sense]
        at = np.array([0.0, 3.0, 5.0, 8.0, 17.9, 40.0])
        found = _record._rotor_curve(rows, at) * sense
        cubic = CubicHermiteSpline([2.0, 6.0], [100.0, 60.0], [-12.0, -5.0])
        # it does not fall below a twentieth of the slowest window
        assert found == pytest.approx([124.0, float(cubic(3.0)), float(cubic(5.0)), 50.0, 3.0, 3.0])
        unknown = np.array([[6.0, 60.0, np.nan], [2.0, 100.0, np.nan]]) * [1.0, sense, 1.0]
        assert _record._rotor_curve(unknown, np.array([0.0, 4.0])) * sense == pytest.approx([120.0, 80.0])
        one = np.array([[6.0, 60.0 * sense, np.nan]])
        assert _record._rotor_curve(one, np.array([0.0, 9.0])) * sense == pytest.approx([60.0, 60.0])
        assert _record._rotor_curve(rows[:1], at[:1]) * sense == pytest.approx([90.0])

    def test_initial_speeds_have_the_columns_of_the_state(self):
        t = np.linspace(1.0, 2.0, 60)
        made = record(samples(4.0 * T), [samples(90.0 * t, t=t), samples(90.0 * (t + 7.0), t=t + 7.0)])
        times, found = initial_speeds(made, 20)
        assert times == pytest.approx(np.linspace(0.0, 10.0, 20))
        assert found == pytest.approx(np.tile([90.0, 4.0], (20, 1)))

    def test_a_cubic_and_its_slope_are_those_of_hermite(self):
        rng = np.random.default_rng(1)
        t = np.array([0.0, 1.0, 2.5, 4.0])
        value, slope = rng.standard_normal((4, 2)), rng.standard_normal((4, 2))
        at = np.array([-0.5, 0.0, 0.3, 1.0, 2.0, 4.0, 4.5])
        true = CubicHermiteSpline(t, value, slope)
        assert hermite(t, value, slope, at) == pytest.approx(true(at))
        assert hermite(t, value, slope, at, slopes=True) == pytest.approx(true(at, 1))
        known = np.array([0, 0, 0, 1, 1, 2, 2])
        assert hermite(t, value, slope, at, interval=known) == pytest.approx(true(at))

    def test_pieces_are_least_squares_cubics(self):
        rng = np.random.default_rng(2)
        t = np.sort(rng.random(50))
        y = rng.standard_normal(50)
        found = PiecewiseCubics(t).smooth(y, 3)
        for part in np.array_split(np.arange(50), 3):
            fit = np.polynomial.Polynomial.fit(t[part], y[part], 3)
            assert found[part] == pytest.approx(fit(t[part]))

    @pytest.mark.parametrize(("function", "pieces"), [(lambda x: x**3, 1), (lambda x: np.abs(x - 0.5), 2)])
    def test_bic_chooses_the_number_of_pieces(self, function, pieces):
        t = np.linspace(0.0, 1.0, 200)
        noise = 1e-3 * np.random.default_rng(3).standard_normal(200)
        assert PiecewiseCubics(t).needed(function(t) + noise) == pieces

    def test_a_piece_has_at_least_twelve_samples(self):
        t = np.linspace(0.0, 1.0, 47)
        cubics = PiecewiseCubics(t)
        tried = []
        smooth = cubics.smooth
        cubics.smooth = lambda values, count: tried.append(count) or smooth(values, count)
        cubics.needed(np.sin(30 * t))
        assert tried == [1, 2, 3]


class TestNames:
    @pytest.mark.parametrize(
        ("outer", "inner"),
        [
            ("air.linear", "casing.air.linear"),
            ("wheel.air.linear", "casing.air.linear"),
            ("air.linear.b2", "casing.air.linear.b2"),
            ("support.constant", "touchpoint.constant"),
            ("wheel.support.constant", "touchpoint.constant"),
            ("initial.omega", "initial.omega_c"),
            ("initial.omega@x", "initial.omega_c@x"),
            ("initial.omega_r", "initial.omega_r"),
            ("wheel: -k*omega**3", "casing: -k*omega_c**3"),
            ("casing: -k*omega_c**3", "casing: -k*omega_c**3"),
            ("rotor: -k*omega**3", "rotor: -k*omega**3"),
            ("input.u", "casing.input.u"),
            ("input.u.k", "casing.input.u.k"),
            ("what.ever", "what.ever"),
            ("camera.clock", "camera.clock"),
        ],
    )
    def test_names_of_a_single_body_are_those_of_the_casing(self, outer, inner):
        assert inward(outer, "wheel") == inner
        assert inward(outer, "") == outer

    def test_a_name_is_shown_with_the_body(self):
        assert outward("casing.air.linear", "wheel") == "wheel.air.linear"
        assert outward("initial.omega_c@x", "wheel") == "initial.omega@x"
        assert outward("casing: -k*omega_c", "wheel") == "wheel: -k*omega"
        assert outward("casing.air.linear", "") == "casing.air.linear"
        assert outward("camera.clock", "wheel") == "camera.clock"

    def test_laws_may_be_joined(self):
        case = Case.from_arrays(wheel={"t": T, "omega": 5.0 - 0.1 * T, "u": 0.1})
        assert case.model("air.linear + support.constant").names == (
            "casing.air.linear",
            "touchpoint.constant",
        )
        assert case.model("air.linear", "wheel: -k*(omega + 1)**3").names[0] == "casing.air.linear"
        assert model_of("reduced", case.record).names == case.model("reduced").names
        assert all(e.bodies <= {"casing"} for e in case.model("reduced").effects)


class TestArrays:
    GIVEN = {"t": T, "omega": 5.0 - 0.1 * T, "u": 0.1}  # noqa: RUF012

    def test_numbers_are_those_given(self):
        made = Case.from_arrays(
            wheel={**self.GIVEN, "inertia": 0.3, "inertia_u": 0.02}, label="a", surface="b"
        ).record
        assert (made.I_casing, made.I_casing_u, made.label, made.surface) == (0.3, 0.02, "a", "b")
        assert (made.quantity, made.units, made.name) == ("omega", SI, "wheel")
        assert (made.casing.sigma == 0.1).all()
        free = Case.from_arrays(wheel={"t": T, "angle": T}).record
        assert (free.I_casing, free.units, free.quantity) == (1.0, WITHOUT_INERTIA, "angle")
        assert (free.casing.sigma == 1e-3).all()

    def test_a_gyroscope_has_windows(self):
        rotor = {"t": T[:20], "omega": 90.0 - T[:20], "u": 0.1, "inertia": 0.2}
        casing = {**self.GIVEN, "inertia": 0.3}
        made = Case.from_arrays(casing=casing, rotor=[rotor, {**rotor, "t": T[:20] + 5.0}]).record
        assert (len(made.rotor), made.I_rotor, made.I_casing, made.name) == (2, 0.2, 0.3, "")
        with pytest.raises(RecordError, match="inertia of both"):
            Case.from_arrays(casing=casing, rotor={k: v for k, v in rotor.items() if k != "inertia"})
        with pytest.raises(RecordError, match="no window"):
            Case.from_arrays(casing=casing, rotor=[])

    @pytest.mark.parametrize(
        "change",
        [
            {"inertia": 0.0},
            {"inertia": -1.0},
            {"inertia": math.inf},
            {"inertia": True},
            {"inertia": 1.0, "inertia_u": -0.1},
            {"u": 0.0},
            {"u": -1.0},
            {"u": np.ones(3)},
            {"angle": T},
            {"t": None},
            {"omega": None},
            {"speed": 1},
            {"t": "x"},
            {"modes": 3},
        ],
    )
    def test_wrong_entries_are_refused(self, change):
        with pytest.raises(RecordError):
            Case.from_arrays(wheel={**self.GIVEN, **change})
        Case.from_arrays(wheel={**self.GIVEN, "inertia": 1.0, "inertia_u": None})

    def test_an_error_mode_belongs_to_its_series(self):
        value = 5.0 - 0.1 * T
        value[3] = np.nan
        basis = np.arange(101.0)
        modes = {"tilt": {"basis": basis, "covariance": 4.0}}
        (mode,) = Case.from_arrays(wheel={"t": T, "omega": value, "u": 0.1, "modes": modes}).record.modes
        assert mode.time.tolist() == np.delete(T, 3).tolist()
        assert mode.basis[:, 0].tolist() == np.delete(basis, 3).tolist()
        assert (mode.body, mode.window, mode.group) == ("casing", None, "wheel/tilt/0")
        for wrong in ({"basis": basis}, {"basis": basis, "covariance": 4.0, "more": 1}, 3):
            with pytest.raises(RecordError):
                Case.from_arrays(wheel={**self.GIVEN, "modes": {"tilt": wrong}})


def test_cubics_agree_with_scipy():
    t, v, s = np.array([0.0, 1.5, 2.0, 7.0]), np.array([3.0, 1.0, 2.0, -4.0]), np.array([0.5, -2.0, 1.0, 0.0])
    times = np.linspace(0, 7, 113)
    np.testing.assert_allclose(hermite(t, v, s, times), CubicHermiteSpline(t, v, s)(times), atol=1e-13)


@pytest.mark.parametrize(
    ("share", "samples", "pieces"),
    [(0.6, 1201, 60), (0.6, 361, 30), (0.52, 1201, 52), (0.48, 1201, 1), (0.6, 720, 60), (0.6, 719, 59)],
)
def test_a_window_of_more_than_half_of_the_run_is_divided_like_the_run(share, samples, pieces):
    """A run of 10 s with a hundred points; each piece has at least twelve samples."""
    time = np.linspace(1.0, 1.0 + 10.0 * share, samples)
    window = Samples(time, time, np.ones(samples))
    assert _record._pieces(window, SimpleNamespace(span=(0.0, 10.0)), 100, 12) == pieces


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_the_rotor_continues_at_its_slopes_and_does_not_reverse(sense):
    """Beyond the windows by their slopes, not below a twentieth of its slowest speed."""
    windows = np.array([[20.0, sense * 80.0, sense * -1.0], [10.0, sense * 100.0, sense * -2.0]])
    curve = sense * _record._rotor_curve(windows, np.array([5.0, 10.0, 20.0, 25.0, 500.0]))
    assert curve == pytest.approx([110.0, 100.0, 80.0, 75.0, 4.0])
    single = sense * _record._rotor_curve(windows[1:], np.array([0.0, 10.0, 57.0, 58.0]))
    assert single == pytest.approx([120.0, 100.0, 6.0, 5.0])


def test_an_unknown_slope_is_that_between_the_windows():
    windows = np.array([[10.0, 100.0, np.nan], [20.0, 80.0, np.nan]])
    assert _record._rotor_curve(windows, np.array([5.0, 15.0, 25.0])) == pytest.approx([110.0, 90.0, 70.0])


@pytest.mark.parametrize("is_angle", [True, False])
def test_pieces_have_speed_and_acceleration_at_their_middle(is_angle):
    """A body of 50 rad/s that slows down by 4 rad/s2."""
    time = np.linspace(1.0, 5.0, 41)
    value = 7.0 + 50.0 * time - 2.0 * time**2 if is_angle else 50.0 - 4.0 * time
    found = _record._local(Samples(time, value, np.ones(41)), 3, is_angle)
    middle = np.array([time[p].mean() for p in np.array_split(np.arange(41), 3)])
    assert found == pytest.approx(np.stack([middle, 50.0 - 4.0 * middle, np.full(3, -4.0)], axis=1))


@pytest.mark.parametrize(("gain", "pieces"), [(3.2, 1), (4.8, 2)])
def test_a_further_piece_must_explain_more_than_its_four_coefficients(gain, pieces):
    """A curve with a step: in two pieces the sum of squares decreases by the factor N^(-gain / N)."""
    n = 30
    cubics, noise = PiecewiseCubics(np.linspace(-1.0, 1.0, n)), np.random.default_rng(1).normal(size=n)

    def squares(values, count):
        return np.sum((values - cubics.smooth(values, count)) ** 2)

    step = np.repeat([-1.0, 1.0], n // 2)

    def excess(size):
        values = noise + size * step
        return n * np.log(squares(values, 1) / squares(values, 2)) - gain * np.log(n)

    assert cubics.needed(noise + brentq(excess, 1e-3, 50.0) * step) == pieces


def test_the_largest_speed_of_a_body_at_rest_is_that_of_the_fastest():
    time = np.linspace(0.0, 10.0, 400)
    runs = [(time, speed * time, np.full(400, 1e-3)) for speed in (0.0, 50.0)]
    record = make_record(casing=runs[0], rotor=[runs[1]], I_rotor=1.0, I_casing=1.0)
    assert record.largest_speeds == {"omega_r": pytest.approx(50.0), "omega_c": pytest.approx(50.0)}
