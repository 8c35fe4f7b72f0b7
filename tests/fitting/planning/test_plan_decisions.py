"""Limits of a described plan, sets of effects, friction along a motion, and the grammar of laws."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import EstimationError
from fitting._criteria import DEFAULT
from fitting.discovery import _grammar
from fitting.discovery._grammar import description_length, grammar
from fitting.effects._library import find
from fitting.effects._user import resolve
from fitting.planning import _friction, _plan
from fitting.planning._friction import FrictionPlan, Motion, Pair, torque_along
from fitting.planning._plan import read_planned

PLAN = """
model = ["casing.air.linear", "rotor.air.linear"]
[inertia]
rotor = 5e-5
casing = 2e-5
[parameters]
"casing.air.linear.b2" = {b2}
"rotor.air.linear.a1" = 1e-6
[noise]
angle = 1e-3
torque = {torque}
torque_time = 1.0
{runs}
{bounds}
"""
RUN = """
[[run]]
omega_rotor = {rotor}
omega_casing = {casing}
duration = {duration}
casing_fps = {fps}
rotor_fps = {rotor_fps}
windows = [{window}]
window_length = {length}
"""


def read(tmp_path, *runs, b2="1e-6", torque="0.0", bounds=""):
    usual = {
        "rotor": 900.0, "casing": 5.0, "duration": 60.0, "fps": 60.0, "rotor_fps": 250.0, "window": 2.0, "length": 3.0,
    }  # fmt: skip
    text = "".join(RUN.format(**usual | r) for r in runs or ({},))
    path = tmp_path / "plan.toml"
    path.write_text(PLAN.format(runs=text, b2=b2, torque=torque, bounds=bounds))
    return read_planned(path)


class TestDescription:
    @pytest.mark.parametrize(
        ("run", "valid"),
        [
            ({"window": 57.0}, True),
            ({"window": 57.1}, False),
            ({"window": 0.0}, True),
            ({"window": -0.1}, False),
            ({"fps": 1.0}, True),
            ({"fps": 0.99}, False),
            ({"rotor_fps": 2.7}, True),
            ({"rotor_fps": 2.6}, False),
            ({"fps": 166000.0}, True),
            ({"fps": 167000.0}, False),
            ({"rotor_fps": 167000.0}, False),
            ({"rotor": 0.0}, True),
            ({"casing": 0.0}, True),
            ({"rotor": 0.0, "casing": 0.0}, False),
            ({"rotor": -900.0}, True),
            ({"duration": 0.0}, False),
            ({"length": "nan"}, False),
        ],
    )
    def test_runs_have_enough_frames_within_the_recording(self, tmp_path, run, valid):
        if valid:
            (made,) = read(tmp_path, run).experiments
            assert made.sigma == 1e-3
        else:
            with pytest.raises(EstimationError, match=r"plan\.toml"):
                read(tmp_path, run)

    @pytest.mark.parametrize(
        ("b2", "torque", "valid"),
        [
            ("0.0", "0.0", True),
            ("-1e-9", "0.0", False),
            ("nan", "0.0", False),
            ("1e-6", "-1.0", False),
            ("1e-6", "1e-7", True),
        ],
    )
    def test_numbers_are_within_their_bounds(self, tmp_path, b2, torque, valid):
        if valid:
            made = read(tmp_path, b2=b2, torque=torque)
            assert made.numbers["casing.air.linear.b2"] == float(b2)
            assert made.experiments[0].torque_noise == float(torque)
            assert made.inertias == (5e-5, 2e-5)
        else:
            with pytest.raises(EstimationError):
                read(tmp_path, b2=b2, torque=torque)

    def test_bounds_follow_from_all_runs(self, tmp_path):
        made = read(
            tmp_path, {"rotor": -600.0, "casing": -4.0, "duration": 30.0}, {"rotor": 300.0, "casing": 2.0}
        ).bounds
        assert made.omega_rotor == pytest.approx((200.0, 600.0))
        assert made.omega_casing == pytest.approx((-90.0, 90.0))
        assert made.duration == pytest.approx((30.0, 120.0))
        fast = read(tmp_path, {"rotor": 600.0, "casing": -95.0}).bounds
        assert fast.omega_casing == pytest.approx((-95.0, 95.0))

    @pytest.mark.parametrize(
        ("bounds", "valid"),
        [
            ("duration = [3, 9]", True),
            ("duration = [9, 9]", True),
            ("duration = [9, 3]", False),
            ("duration = [0, 3]", False),
            ("touchpoint = [-1, 3]", False),
            ("inertia_casing = [0.0, 3]", False),
            ("omega_casing = [-3, 3]", True),
            ("reversible = true", True),
        ],
    )
    def test_given_bounds_are_ordered_and_positive(self, tmp_path, bounds, valid):
        if valid:
            assert len(read(tmp_path, bounds=f"[bounds]\n{bounds}").given) == 1
        else:
            with pytest.raises(EstimationError, match="bounds"):
                read(tmp_path, bounds=f"[bounds]\n{bounds}")

    def test_recordings_are_simulated_with_their_numbers(self, tmp_path, monkeypatch):
        seen = []
        monkeypatch.setattr(
            "fitting.planning._plan.simulate",
            lambda model, numbers, e, **more: seen.append((e.duration, more)),
        )
        made = read(tmp_path, {}, {"duration": 30.0})
        made._records(0)
        made._records(2)
        assert [(d, m["seed"], m["label"]) for d, m in seen] == [
            (60.0, 1, "run 1"), (30.0, 2, "run 2"), (60.0, 2001, "run 1"), (30.0, 2002, "run 2"),
        ]  # fmt: skip
        assert {(m["inertia_rotor"], m["inertia_casing"]) for _, m in seen} == {(5e-5, 2e-5)}

    @pytest.mark.parametrize("runs", [1, 2])
    def test_a_simulation_is_fitted_from_the_truth_if_it_is_one_run(self, tmp_path, monkeypatch, runs):
        seen = []
        monkeypatch.setattr(_plan, "simulate", lambda *_, seed, **__: seed)
        monkeypatch.setattr(_plan, "fit_model", lambda *given, **more: seen.append((given, more)) or "fit")
        noise = SimpleNamespace(of=lambda record, criteria: SimpleNamespace(process_noise=(record, criteria)))
        monkeypatch.setattr(_plan, "CaseData", noise)
        made = read(tmp_path, *[{}] * runs)
        assert made.fit(3, "criteria") == "fit"
        ((model, records), more) = seen[0]
        assert model is made.model
        assert records == [3001, 3002][:runs]
        truth = {"casing.air.linear.b2": 1e-6, "rotor.air.linear.a1": 1e-6}
        assert more == {"start": truth if runs == 1 else {}, "criteria": "criteria"}
        assert made.process_noise(5, "criteria") == ((5001, "criteria"), (5002, "criteria"))[:runs]


class TestPlan:
    """Four effects, of which one is absorbed and one has no torque; searches and runs are replaced."""

    EFFECTS = tuple(
        SimpleNamespace(effect=SimpleNamespace(name=n), detection_limit=d, torque=t, detection_torque=d * t,
                        absorbed=n == "a",                        indistinguishable_from=())
        for n, d, t in (("a", math.inf, 1.0), ("b", 2.0, math.nan), ("c", 2.0, 3.0), ("d", 4.0, 1.0))
    )  # fmt: skip

    def planned(self, monkeypatch, recordings, **options):
        told = SimpleNamespace(searches=[], limits=[], runs=[], rivals=[], information=[], progress=[])

        class Search:
            default_size = 0.7

            def __init__(self, fit, extra, criteria, *, truth, process):
                told.searches.append((fit, extra, criteria, truth, process))
                self.effects = [e.effect for e in TestPlan.EFFECTS]

            def limits(self, effect, size, *, planned, others):
                told.limits.append((effect.name, size, planned, len(others)))
                return next(e for e in TestPlan.EFFECTS if e.effect is effect)

            def scores(self):
                return {
                    e.name: SimpleNamespace(shape=f"shape {e.name}", threshold=f"limit {e.name}")
                    for e in self.effects
                }

        def next_run(information, alternatives, criteria, bounds, *, evaluations, progress):
            told.runs.append((alternatives, criteria, bounds, evaluations))
            progress(20, evaluations)
            return "next"

        monkeypatch.setattr(_plan, "Search", Search)
        monkeypatch.setattr(
            _plan, "Information", lambda fit, some: told.information.append((fit, some)) or "information"
        )
        monkeypatch.setattr(_plan, "rivals", lambda *given: told.rivals.append(given) or ["rival"])
        monkeypatch.setattr(_plan, "next_run", next_run)
        monkeypatch.setattr(_plan, "_warning", lambda fit, criteria: "warning")
        found = _plan.plan(recordings, ("extra",), progress=lambda *a: told.progress.append(a), **options)
        return found, told

    def test_described_recordings_are_simulated_twice_and_their_noise_ten_times(self, monkeypatch):
        described = SimpleNamespace(
            fit=lambda i, c: f"fit {i} {c}",
            process_noise=lambda i, c: (i, c),
            bounds="bounds",
            numbers={"x": 1.0},
        )
        monkeypatch.setattr(_plan, "read_planned", lambda path: described)
        found, told = self.planned(monkeypatch, "plan.toml", criteria="c")
        noise = [(i, "c") for i in range(2, 10)]
        assert told.searches == [(f"fit {i} c", ("extra",), "c", {"x": 1.0}, noise) for i in (0, 1)]
        assert told.limits == [(n, None, True, 1) for n in "abcd"]
        assert [e.effect.name for e in found.effects] == ["d", "c", "b", "a"]
        assert told.information == [
            ("fit 0 c", [(e.effect, f"shape {e.effect.name}") for e in self.EFFECTS[1:]])
        ]
        assert told.rivals == []
        assert told.runs == [([], "c", "bounds", 60)]
        assert told.progress == [*((k, 64) for k in range(4)), (24, 64)]
        assert (found.planned, found.size, found.next_run, found.warning) == (True, 0.7, "next", "warning")
        again, told = self.planned(monkeypatch, "plan.toml", criteria="c", size=0.2, bounds="given")
        assert again.size == 0.2
        assert told.limits[0] == ("a", 0.2, True, 1)
        assert told.runs[0][2] == "given"

    @pytest.mark.parametrize("size", [0.0, -1.0, math.inf, math.nan])
    def test_a_size_is_positive(self, size):
        with pytest.raises(EstimationError, match="the size of the effect"):
            _plan.plan("absent.toml", size=size)

    @pytest.mark.parametrize(("reversals", "rigid"), [((), None), ((3.0,), None), ((), "contact")])
    def test_measured_recordings_are_compared_with_their_rivals(self, monkeypatch, reversals, rigid):
        class Fit:
            criteria = "own"
            model = SimpleNamespace(refuse_chain=lambda *_: None, rigid_contact=rigid)
            problem = SimpleNamespace(data=[SimpleNamespace(motion=SimpleNamespace(reversals=reversals))])

        fit = Fit()
        monkeypatch.setattr(_plan, "Fit", Fit)
        monkeypatch.setattr(_plan, "Bounds", SimpleNamespace(of=lambda f: ("bounds", f)))
        monkeypatch.setattr(_plan, "measured_with", lambda f, criteria: (f, criteria))
        if reversals or rigid:
            with pytest.raises(EstimationError):
                self.planned(monkeypatch, fit)
            return
        found, told = self.planned(monkeypatch, fit)
        assert told.searches == [((fit, "own"), ("extra",), "own", {}, [])]
        assert told.limits[0] == ("a", None, False, 0)
        assert told.rivals == [("information", [f"limit {n}" for n in "abcd"], "own")]
        assert told.runs == [(["rival"], "own", ("bounds", (fit, "own")), 60)]
        assert (found.planned, found.fit) == (False, (fit, "own"))


class TestClasses:
    def effect(self, name, *others):
        return SimpleNamespace(effect=SimpleNamespace(name=name), indistinguishable_from=others)

    def test_sets_are_connected_and_in_the_order_of_the_effects(self):
        found = [
            self.effect("d", "a"),
            self.effect("b"),
            self.effect("c", "e"),
            self.effect("a", "c"),
            self.effect("e", "c"),
        ]
        assert _plan._classes(found) == (("d", "c", "a", "e"),)
        assert _plan._classes([self.effect("a", "b"), self.effect("b", "a"), self.effect("c")]) == (
            ("a", "b"),
        )
        two = [self.effect("a", "b"), self.effect("c", "d"), self.effect("b", "a"), self.effect("d", "c")]
        assert _plan._classes(two) == (("a", "b"), ("c", "d"))

    @pytest.mark.parametrize(
        ("converged", "fails", "words"),
        [(True, False, ""), (True, True, "lack of fit"), (False, True, "converged")],
    )
    def test_limits_of_a_wrong_model_have_a_warning(self, converged, fails, words):
        found = _plan._warning(SimpleNamespace(converged=converged, fails=lambda criteria: fails), DEFAULT)
        assert words in found
        assert bool(found) is bool(words)


class TestFriction:
    def motion(self, omega):
        time = (np.arange(320) + 0.5) * 1e-2
        return Motion("x", time, omega(time))

    def test_a_function_of_the_speed_is_averaged_over_a_cell(self):
        motion = self.motion(lambda t: 3.0 - 2.0 * t)
        found = torque_along(find("casing.air.linear"), {"b2": 0.5}, motion)
        assert found == pytest.approx((-0.5 * motion.omega).reshape(20, 16).mean(axis=1))
        constant = torque_along(resolve("casing: -k*sign(omega_c)"), {"k": 2.0}, motion)
        assert (constant[0], constant[-1]) == (-2.0, 2.0)

    def test_a_strain_reverses_with_the_motion(self):
        """With constant speeds the strain z follows dz/dx = (1 - sign z) / s exactly."""
        motion = self.motion(lambda t: np.where(t < 1.6, 0.5, -0.5))
        effect = find("casing.friction.presliding")
        found = torque_along(effect, {"k": 1.0, "s": 0.1}, motion)
        t = motion.time
        z = 1 - np.exp(-0.5 * (t - t[0]) / 0.1)
        last = int(np.flatnonzero(t < 1.6)[-1])
        back = (1 + z[last]) * np.exp(-0.5 * (t - t[last] - 0.005) / 0.1) - 1
        expected = -np.where(np.arange(320) <= last, z, back).reshape(20, 16).mean(axis=1)
        assert found == pytest.approx(expected, abs=0.02)
        assert found[-1] == pytest.approx(1.0, abs=0.01)

    def test_trials_contain_grids_typical_values_and_bounds_of_zero(self):
        effect = find("casing.friction.lugre")
        shapes = [p for p in effect.parameters if p.role == "shape"]
        trials = list(_friction._trials(effect))
        for p in shapes:
            values = {v[p.symbol] for v in trials}
            assert values == {*p.grid, p.start, *((0.0,) if p.lower == 0 else ())}
        assert len(trials) == math.prod(
            len({*p.grid, p.start, *((0.0,) if p.lower == 0 else ())}) for p in shapes
        )
        assert all(v["k"] == 1.0 for v in trials)
        assert _friction._typical(effect) == {
            p.symbol: 1.0 if p.role == "amplitude" else p.start for p in effect.parameters
        }

    def test_pairs_are_separated_beyond_the_width(self):
        one = Pair("a", "b", {"recording": 9.9, "reversals": 10.1, "ramp": 0.0})
        other = Pair("a", "c", {"recording": 10.1, "reversals": 0.0, "ramp": 0.0})
        third = Pair("b", "c", {"recording": 0.0, "reversals": 0.0, "ramp": 0.0})
        assert not one.separated("recording", 10.0)
        assert one.separated("reversals", 10.0)
        plan = FrictionPlan(1e-6, "N m", (one, other, third), 10.0, 0.2, 3.0)
        lines = plan.sentences
        assert lines[0].startswith("This recording separates 1 of 3 pairs")
        assert "separates a from b." in lines[1]
        assert lines[2] == "None of these runs separates b from c."
        assert len(lines) == 3
        assert _friction._grouped([one, other, third]) == "a from b, c; b from c"
        assert [p["separated_by"] for p in plan.document()["pairs"]] == [["reversals"], ["recording"], []]

    @pytest.mark.parametrize(("dry", "strength"), [(3e-6, 3e-6), (0.0, None), (None, None)])
    def test_the_strength_is_the_dry_friction_or_a_tenth_of_the_torque(self, dry, strength):
        rates = np.zeros((2, 2, 2))
        rates[..., 1] = [[3.0, 4.0], [-3.0, -4.0]]
        record = SimpleNamespace(I_casing=2e-5)
        case = SimpleNamespace(
            dynamics=SimpleNamespace(rates=lambda t, y, numbers: rates), data=SimpleNamespace(record=record)
        )
        path = SimpleNamespace(mesh=SimpleNamespace(times=None), y=None)
        fit = SimpleNamespace(
            estimates={} if dry is None else {"touchpoint.constant.b1": SimpleNamespace(value=dry)},
            problem=SimpleNamespace(cases=[case], layout=SimpleNamespace(numbers=lambda theta, i: {})),
            predictions=[SimpleNamespace(path=path)],
            theta=None,
        )
        assert _friction._strength(fit) == pytest.approx(strength or 0.1 * math.sqrt(12.5) * 2e-5)
        rates[:] = 0.0
        if strength is None:
            with pytest.raises(EstimationError):
                _friction._strength(fit)


class TestGrammar:
    RANGES = {"omega_r": (300.0, 900.0), "omega_c": (-5.0, 40.0), "delta": (300.0, 800.0)}  # noqa: RUF012

    def test_laws_have_different_names_and_known_shapes(self):
        laws = grammar(self.RANGES, 200.0, bodies={"rotor", "casing"}, angles=True)
        names = [x.effect.name for x in laws]
        assert len(set(names)) == len(names)
        assert sum("harmonic" in n for n in names) == 2
        assert not any(
            "harmonic" in x.effect.name for x in grammar(self.RANGES, 200.0, bodies={"casing"}, angles=False)
        )
        for law in laws:
            assert law.description_length == description_length(law.symbols) > 0
            assert bool(law.effect.breakpoint) is (law.form in {"step in time", "switched drag"})
            assert law.effect.per_case is (
                law.form in {"step in time", "ramp in time", "pulse in time", "switched drag"}
            )
        assert description_length(3) == pytest.approx(12 * math.log(2))

    def test_negative_powers_need_a_speed_away_from_zero(self):
        def lowest(low, high):
            power = _grammar._of_speed(_grammar._OF_SPEED[0], "casing", "omega_c", (low, high), 200.0)
            return min(next(p for p in power.effect.parameters if p.symbol == "n").grid)

        assert lowest(0.41, 40.0) == -1.0
        assert lowest(0.39, 40.0) == 0.25
        assert lowest(-1.0, 40.0) == 0.25
        assert lowest(-40.0, -0.41) == -1.0

    @pytest.mark.parametrize(
        ("kind", "lower", "upper", "first", "last"),
        [
            ("exponent", -3.0, 6.0, -1.0, 4.0),
            ("positive exponent", 0.05, 6.0, 0.25, 4.0),
            ("speed", 0.06, 600.0, 0.6, 60.0),
            ("wide speed", 3.0, 600.0, 0.6 * 100 ** (5 / 12), 60.0),
            ("threshold", 0.0, 24.0, 1.0, 18.0),
            ("steepness", 0.2, 8.0, 0.5, 3.0),
            ("narrow", 0.1, 60.0, 0.6, 10.0),
            ("time", 0.5, 2000.0, 2.0, 200.0),
            ("time few", 0.5, 2000.0, 10.0, 100.0),
            ("moment", 0.0, 100.0, 0.04, 0.96),
            ("coarse moment", 0.0, 100.0, 0.04, 0.94),
            ("pulse", 0.3, 100.0, 2.0, 12.0),
            ("frequency", 0.5 * 0.03142, 20.0, 0.03142, 10.0),
            ("few frequencies", 0.5 * 0.03142, 2 * 1.257, 0.03142, 1.257),
        ],
    )
    def test_shapes_are_in_units_of_the_largest_speed_and_the_length(self, kind, lower, upper, first, last):
        """A largest speed of 20 rad/s in 100 s."""
        p = _grammar._shape("w", kind, 20.0, 100.0)
        assert (p.lower, p.upper) == pytest.approx((lower, upper), rel=1e-3)
        assert p.grid[0] == pytest.approx(first, rel=0.05)
        assert p.grid[-1] == pytest.approx(last, rel=0.05)
        assert p.start == p.grid[len(p.grid) // 2]
        assert p.relative is ("moment" in kind)

    def test_frequencies_are_two_radians_apart(self):
        p = _grammar._shape("w", "frequency", 20.0, 100.0)
        assert len(p.grid) == int(1 + (10.0 - math.pi / 100) * 50)
        assert len(_grammar._shape("w", "few frequencies", 20.0, 100.0).grid) == int(
            1 + 39 * math.pi / 100 * 50
        )

    @pytest.mark.parametrize(
        ("text", "kinds", "unit"),
        [
            ("omega_c**2", (), "N m s2"),
            ("abs(omega_c)**n", ("exponent",), "N m s^n"),
            ("t**n", ("positive exponent",), "N m s^-n"),
            ("omega_c*abs(omega_c)**n", ("exponent",), "N m s s^n"),
            ("tanh(omega_c/w)", ("speed",), "N m"),
            ("lag", ("time",), "N m s"),
        ],
    )
    def test_the_unit_of_a_strength_makes_a_torque(self, text, kinds, unit):
        shapes = [_grammar._shape("n" if "exponent" in k else "w", k, 20.0, 100.0) for k in kinds]
        assert _grammar._unit(text, shapes) == unit

    def test_later_laws_of_a_name_are_numbered(self):
        laws = [_grammar._of_speed(_grammar._OF_SPEED[0], "casing", "omega_c", (1.0, 9.0), 200.0)] * 3
        name = laws[0].effect.name
        assert [x.effect.name for x in _grammar._with_names(laws)] == [name, f"{name}_2", f"{name}_3"]
