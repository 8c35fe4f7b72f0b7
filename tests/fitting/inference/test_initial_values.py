"""Initial values against exact motions and averaged equations, and the choice of shape constants on a grid."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import oscillators
import pytest
from linearised import BEGIN, SPAN, VALUES, gyroscope
from scipy.integrate import solve_ivp

from fitting import LIBRARY, LINEAR, REDUCED, EstimationError, Model, Parameter, SimulationError
from fitting.dynamics._collocation import Sampler
from fitting.effects._user import resolve
from fitting.inference import _initial_values
from fitting.inference._averaging import averaged
from fitting.inference._initial_values import (
    equation_error,
    initial_shapes,
    initial_values,
    start_values,
    unknown_shapes,
)
from fitting.inference._oscillation import SlowMotion
from fitting.inference._parameters import ParameterLayout
from fitting.inference._record import Samples

TIME = np.linspace(BEGIN, BEGIN + SPAN, 1500)
SPEEDS = {"omega_c": 150.0, "omega_r": 900.0}


def moved(names=LINEAR, values=None, **options):
    """Return times and exact speeds of both bodies of the first case."""
    fit = gyroscope(names, values, **options)
    (path, *_) = (p.path for p in fit.predictions)
    return TIME, Sampler(path.mesh, TIME).value(path.y)[:, :2]


def started(
    names, rough, *, prior=None, reference=250.0, cases=("case",), per_case=(), deflections=None, searched=()
):
    """Return the initial values by name."""
    records = [
        SimpleNamespace(
            label=c,
            span=(BEGIN, BEGIN + SPAN),
            I_rotor=5.5e-5,
            I_casing=2e-5,
            inputs=(),
            largest_speeds=SPEEDS,
        )
        for c in cases
    ]
    layout = ParameterLayout.of(
        Model.of(names) if isinstance(names, tuple) else names, records, per_case=per_case
    )
    still = [np.zeros(len(t)) for t, _ in rough] if deflections is None else deflections
    theta = start_values(layout, reference, rough, still, prior, searched)
    return dict(zip(layout.names, theta.tolist(), strict=True))


class TestStrengths:
    def test_laws_of_the_exact_motion_are_recovered(self):
        found = started(LINEAR, [moved()])
        for key, value in VALUES.items():
            assert found[key] == pytest.approx(value, rel=2e-3)
        assert found["initial.omega_r@case"] == pytest.approx(300.0)
        assert found["initial.omega_c@case"] == pytest.approx(20.0)

    @pytest.mark.parametrize("searched", [True, False])
    def test_a_law_whose_shape_will_be_searched_starts_without_strength(self, searched):
        """Errors of the first speeds otherwise give a large strength to a law that acts at the lowest speeds only."""
        time, speeds = moved()
        # the law is noticeable in the last second, where both speeds are too low
        speeds = speeds - 5.0 * np.exp((time - time[-1]) / 0.5)[:, None]
        law = LIBRARY["touchpoint.stribeck"]
        found = started((*LINEAR, law.name), [(time, speeds)], searched=[law] if searched else [])
        assert (found["touchpoint.stribeck.k"] == 0.0) is searched
        without = started(LINEAR, [(time, speeds)])
        same = [math.isclose(found[k], v, rel_tol=1e-9) for k, v in without.items()]
        assert all(same) is searched

    @pytest.mark.parametrize("given", [None, {"touchpoint.stribeck.w": 20.0}])
    def test_a_shape_that_is_given_is_not_searched(self, given, monkeypatch):
        shape = "touchpoint.stribeck.w"
        fit = gyroscope((*LINEAR, "touchpoint.stribeck"), {shape: 20.0, "touchpoint.stribeck.k": 1e-6})
        sought = []

        def regress(layout, parts, old=_initial_values._regress):
            sought.extend(layout.names[i] for places, *_ in parts for i in places)
            return old(layout, parts)

        monkeypatch.setattr(_initial_values, "_regress", regress)
        initial_values(fit.problem, given)
        assert ("touchpoint.stribeck.k@case" in sought or "touchpoint.stribeck.k" in sought) is (
            given is not None
        )
        assert len(sought) == 4 + (given is not None)

    @pytest.mark.parametrize("fixed", ["bearing.linear.d", "casing.air.linear.b2", "touchpoint.constant.b1"])
    def test_a_law_of_fixed_strength_is_part_of_the_motion(self, fixed):
        model = Model.of(LINEAR).with_fixed({fixed: VALUES[fixed]})
        found = started(model, [moved()])
        assert fixed not in found
        for key, value in VALUES.items():
            if key in found:
                assert found[key] == pytest.approx(value, rel=2e-3)

    @pytest.mark.parametrize(
        ("name", "key", "value"),
        [
            ("casing.air.quadratic", "k", 4e-8),
            ("casing.windage", "k", 2e-10),
            ("bearing.quadratic", "e", 3e-10),
            ("touchpoint.drift", "k", -4e-7),
        ],
    )
    def test_a_further_law_is_recovered_with_its_sign(self, name, key, value):
        names = (*LINEAR, name)
        found = started(names, [moved(names, {f"{name}.{key}": value})])
        assert found[f"{name}.{key}"] == pytest.approx(value, rel=0.01)

    def test_friction_is_not_negative(self):
        """The motion has a torque that drives the casing; the dry friction is at its bound."""
        names = ("rotor.air.quadratic", "external.constant", "casing.air.linear", "bearing.linear")
        rough = [moved(names, {"external.constant.k": 3e-5})]
        assert started(names, rough)["external.constant.k"] == pytest.approx(3e-5, rel=5e-3)
        found = started(LINEAR, rough)
        assert found["touchpoint.constant.b1"] == 0.0

    @pytest.mark.parametrize("scale", [1.0, 1e3])
    def test_a_bearing_without_a_torque_starts_with_a_share_of_what_stops_the_rotor(self, scale):
        """The casing is at rest, so nothing is said of the bearing; 4 rad/s2 would stop the rotor in 50 s."""
        times = np.linspace(0.0, 50.0 * scale, 200)
        rough = [(times, np.column_stack([np.linspace(200.0, 100.0, 200), np.zeros(200)]) / scale)]
        names = ("rotor.air.quadratic", "bearing.linear", "bearing.power")
        known = {"bearing.linear.d": 0.0}
        found = started(names, rough, prior=known, reference=150.0 / scale)
        torque = 1e-5 * 5.5e-5 * 4.0 / scale**2
        assert found["bearing.linear.d"] == pytest.approx(0.9 * torque * scale / 150.0)
        power = found["bearing.power.f"] * (150.0 / scale) ** found["bearing.power.g"]
        assert power == pytest.approx(0.1 * torque)

    def test_known_parameters_are_held(self):
        known = {"bearing.linear.d": 3e-7, "touchpoint.constant.b1": 2e-5}
        found = started(LINEAR, [moved(values=known)], prior=known)
        for key, value in (VALUES | known).items():
            assert found[key] == pytest.approx(value, rel=2e-3)
        wrong = started(LINEAR, [moved()], prior={"bearing.linear.d": 1e-7})
        assert wrong["bearing.linear.d"] == 1e-7
        assert wrong["touchpoint.constant.b1"] < 0.5e-5  # less friction beside less drive

    def test_a_power_law_beside_the_linear_one_has_a_tenth_of_its_torque(self):
        found = started(REDUCED, [moved()], reference=200.0)
        torque = VALUES["bearing.linear.d"] * 200.0
        assert found["bearing.linear.d"] * 200.0 == pytest.approx(0.9 * torque, rel=5e-3)
        g = found["bearing.power.g"]
        assert g == LIBRARY["bearing.power"].parameters[1].start
        assert found["bearing.power.f"] * 200.0**g == pytest.approx(0.1 * torque, rel=5e-3)

    def test_a_power_law_alone_is_a_strength_like_others(self):
        names = ("rotor.air.quadratic", "touchpoint.constant", "casing.air.linear", "bearing.power")
        found = started(names, [moved(names, {"bearing.power.f": 6e-8, "bearing.power.g": 1.2})])
        assert found["bearing.power.g"] == 1.2
        assert found["bearing.power.f"] == pytest.approx(6e-8, rel=5e-3)

    def test_cases_have_their_own_friction_and_a_common_bearing(self):
        cases = ("a", "b")
        rough = [
            moved(values={"touchpoint.constant.b1": 1e-5}),
            moved(values={"touchpoint.constant.b1": 3e-5, "casing.air.linear.b2": 2e-6}),
        ]
        found = started(LINEAR, rough, cases=cases)
        assert found["touchpoint.constant.b1@a"] == pytest.approx(1e-5, rel=5e-3)
        assert found["touchpoint.constant.b1@b"] == pytest.approx(3e-5, rel=5e-3)
        assert found["casing.air.linear.b2@b"] == pytest.approx(2e-6, rel=5e-3)
        assert found["bearing.linear.d"] == pytest.approx(2e-7, rel=5e-3)

    def test_other_parameters_have_their_declared_values(self):
        found = started((*LINEAR, "touchpoint.step", "touchpoint.stribeck"), [moved()])
        grid = next(p.grid for p in LIBRARY["touchpoint.step"].parameters if p.symbol == "t0")
        assert found["touchpoint.step.t0"] == pytest.approx(BEGIN + SPAN * grid[len(grid) // 2])
        assert found["touchpoint.stribeck.w"] == pytest.approx(0.03 * 150.0)

    @pytest.mark.parametrize(("ratio", "slope"), [(2.0, 0.0), (-0.5, 0.0)])
    def test_the_ratio_of_a_contact_is_that_of_the_speeds(self, ratio, slope):
        speed = 30.0 * np.exp(-TIME / 20.0)
        found = started(
            ("contact.rolling", "casing.air.linear"), [(TIME, np.column_stack([ratio * speed, speed]))]
        )
        assert found["contact.rolling.n"] == pytest.approx(ratio)
        # (I_c + n^2 I_r) dw/dt = -b2 w
        total = 2e-5 + ratio**2 * 5.5e-5
        assert found["casing.air.linear.b2"] == pytest.approx(total / 20.0, rel=1e-3)

    def test_a_law_that_is_singular_along_the_motion_is_refused(self):
        law = resolve("casing: -k/(omega_c - omega_c)")
        with pytest.raises(EstimationError, match="no finite value"):
            started(Model.of(LINEAR).with_effect(law), [moved()])

    @pytest.mark.parametrize(("stiffness", "offset"), [(4e-4, 0.0), (1e-3, 0.0), (1e-3, 0.01)])
    def test_the_stiffness_of_a_spring(self, stiffness, offset):
        """I w' = -k x - b w; an equilibrium that is not zero changes the stiffness little."""
        rate, decay = math.sqrt(stiffness / 2e-5), 0.05
        since = TIME - BEGIN
        envelope = np.exp(-decay * since)
        damped = math.sqrt(rate**2 - decay**2)
        x = envelope * np.cos(damped * since)
        speed = envelope * (-decay * np.cos(damped * since) - damped * np.sin(damped * since))
        rough = [(TIME, np.column_stack([np.zeros(len(TIME)), speed]))]
        found = started(("casing.spring.linear", "casing.air.linear"), rough, deflections=[x + offset])
        assert found["casing.spring.linear.k"] == pytest.approx(stiffness, rel=5e-3)
        if not offset:
            assert found["casing.air.linear.b2"] == pytest.approx(2 * decay * 2e-5, rel=0.01)
        assert found["initial.deflection@case"] == pytest.approx(1.0 + offset)


class TestSamples:
    def test_rest_is_left_out(self):
        """The longest interval above a hundredth of the largest speed."""
        speed = np.array([0.0, 0.5, 5.0, 9.0, 0.05, 100.0, -50.0, 1.01, 0.99, 2.0])
        assert _initial_values._longest_motion(speed).tolist() == [False] * 5 + [True] * 3 + [False] * 2
        assert _initial_values._longest_motion(np.zeros(4)).all()
        assert _initial_values._longest_motion(np.ones(3)).all()

    def test_the_ratio_of_speeds_is_that_of_the_end_unless_rigid(self):
        casing = np.linspace(10.0, 5.0, 100)
        rotor = np.where(np.arange(100) < 80, 9.0, 2.0) * casing
        speeds = np.column_stack([rotor, casing])
        assert _initial_values._ratio(speeds, rigid=False) == pytest.approx(2.0)
        assert _initial_values._ratio(speeds, rigid=True) == pytest.approx(9.0)
        casing[::2] = 0.01
        assert _initial_values._ratio(np.column_stack([rotor, casing]), rigid=False) == pytest.approx(2.0)
        assert _initial_values._ratio(np.zeros((40, 2)), rigid=True) == 1.0

    def test_periods_begin_where_the_deflection_passes_upwards(self):
        x = np.array([1.0, -1.0, -2.0, 0.0, 1.0, 2.0, -1.0, 3.0])
        assert _initial_values._periods(x).tolist() == [0, 0, 0, 0, 1, 1, 1, 2]

    def test_means_of_groups(self):
        columns = np.array([[1.0, 5.0], [3.0, 7.0], [10.0, 0.0]])
        assert _initial_values._means(np.array([0, 0, 1]), columns).tolist() == [
            [2.0, 6.0],
            [2.0, 6.0],
            [10.0, 0.0],
        ]

    @pytest.mark.parametrize(("count", "size"), [(2.0, 50), (0.1, 24), (30.0, 500)])
    def test_the_first_periods_of_a_record(self, count, size):
        t = np.arange(500) * 0.04
        run = Samples(t + 3.0, np.sin(t), np.ones(500))
        record = SimpleNamespace(casing=run)
        data = SimpleNamespace(record=record, motion=SimpleNamespace(period=1.0, periods=20.0))
        made = []
        patched = lambda record, *, casing, digest: made.append(digest) or SimpleNamespace(casing=casing)  # noqa: E731
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(_initial_values, "replace", patched)
            found = _initial_values._first_periods(data, count)
        assert len(found.casing) == size
        assert found.casing.time[0] == 3.0
        assert made == ([] if size == 500 else [""])
        data.motion = oscillators.stub()
        assert _initial_values._first_periods(data, count) is record


class TestEquationError:
    def data(self, names, values):
        rough = moved(names, values)
        return self.with_speeds(rough)

    def with_speeds(self, rough):
        record = SimpleNamespace(
            label="case",
            span=(BEGIN, BEGIN + SPAN),
            I_rotor=5.5e-5,
            I_casing=2e-5,
            inputs=(),
            largest_speeds=SPEEDS,
        )
        return [SimpleNamespace(record=record, initial_speeds=rough, motion=oscillators.stub())]

    def test_it_vanishes_for_the_right_laws_only(self):
        names, drag = (*LINEAR, "casing.air.quadratic"), {"casing.air.quadratic.k": 2e-7}
        right = equation_error(Model.of(names), self.data(names, drag))
        wrong = equation_error(Model.of(LINEAR), self.data(names, drag))
        without = equation_error(Model.of(["rotor.air.quadratic"]), self.data(names, drag))
        assert right < 1e-6
        assert 1e-3 < wrong < without < 1.0

    def test_without_laws_that_act_it_is_one(self):
        """A strength of zero leaves all of the change of the speeds."""
        t = np.linspace(BEGIN, BEGIN + SPAN, 300)
        rough = (t, np.column_stack([100.0 + t, np.full(300, 0.0) + t]))
        data = self.with_speeds(rough)
        assert equation_error(Model.of(["casing.air.linear"]), data) == pytest.approx(1.0)


class TestGivenValues:
    def test_the_given_ones_replace_those_of_the_data(self, monkeypatch):
        fit = gyroscope()
        usual = initial_values(fit.problem, None)
        index = fit.problem.layout.index
        found = initial_values(fit.problem, {"bearing.linear.d": 5e-7, "unknown.k": 3.0})
        assert found[index["bearing.linear.d"]] == 5e-7
        others = [i for n, i in index.items() if n != "bearing.linear.d"]
        assert found[others] == pytest.approx(usual[others])
        monkeypatch.setattr(_initial_values, "start_values", None)  # not asked for where all are given
        everything = {n: float(i) for n, i in index.items()}
        assert initial_values(fit.problem, everything).tolist() == list(range(len(index)))

    @pytest.mark.parametrize(
        ("known", "kept", "zero"),
        [
            ({"initial.omega_c@run": 2.0, "casing.air.linear.b2": 7.0}, False, False),
            (
                {"initial.omega_c@run": 2.0, "initial.deflection@run": 0.3, "casing.air.linear.b2": 7.0},
                True,
                True,
            ),
            ({"casing.air.linear.b2": 7.0}, True, False),
        ],
    )
    def test_values_of_a_model_that_does_not_oscillate_are_discarded(self, monkeypatch, known, kept, zero):
        """A spring: those of a model with a deflection are kept, and new strengths start at zero."""
        names = ("casing.spring.linear", "casing.air.linear")
        record = SimpleNamespace(
            label="run", span=(0.0, 1.0), I_rotor=1.0, I_casing=1.0, largest_speeds=SPEEDS
        )
        layout = ParameterLayout.of(Model.of(names), [record])
        problem = SimpleNamespace(
            layout=layout, data=[SimpleNamespace(initial_speeds=([], []), prior=None)], reference=1.0
        )
        monkeypatch.setattr(_initial_values, "_deflection", lambda *_: None)
        monkeypatch.setattr(_initial_values, "start_values", lambda *_: np.full(len(layout.names), 9.0))
        monkeypatch.setattr(_initial_values, "averaged", lambda *_: None)
        monkeypatch.setattr(_initial_values, "_period_by_period", lambda problem, theta: theta + 1.0)
        found = dict(zip(layout.names, initial_values(problem, known), strict=True))
        assert found["casing.air.linear.b2"] == (7.0 if kept else 10.0)
        assert found["casing.spring.linear.k"] == (0.0 if zero else 9.0 if kept else 10.0)

    @pytest.mark.parametrize(
        "known", [("omega_c@a",), ("omega_c@a", "deflection@a"), ("omega_c@a", "deflection@b")]
    )
    def test_one_deflection_of_several_runs_is_enough(self, monkeypatch, known):
        given = {f"initial.{k}": 0.5 for k in known} | {"casing.air.linear.b2": 7.0}
        records = [
            SimpleNamespace(label=c, span=(0.0, 1.0), I_rotor=1.0, I_casing=1.0, largest_speeds=SPEEDS)
            for c in "ab"
        ]
        layout = ParameterLayout.of(Model.of(("casing.spring.linear", "casing.air.linear")), records)
        data = SimpleNamespace(initial_speeds=([], []), prior=None)
        problem = SimpleNamespace(layout=layout, data=[data] * 2, reference=1.0)
        monkeypatch.setattr(_initial_values, "_deflection", lambda *_: None)
        monkeypatch.setattr(_initial_values, "start_values", lambda *_: np.full(len(layout.names), 9.0))
        monkeypatch.setattr(_initial_values, "averaged", lambda *_: None)
        monkeypatch.setattr(_initial_values, "_period_by_period", lambda problem, theta: theta + 1.0)
        found = dict(zip(layout.names, initial_values(problem, given), strict=True))
        assert (0.5 in found.values()) is (len(known) == 2)

    @pytest.mark.parametrize(("error", "taken"), [(0.9, "averaged"), (1.1, "periods"), (None, "periods")])
    def test_averaged_equations_are_taken_where_they_follow_the_phase(self, monkeypatch, error, taken):
        record = SimpleNamespace(
            label="run", span=(0.0, 1.0), I_rotor=1.0, I_casing=1.0, largest_speeds=SPEEDS
        )
        layout = ParameterLayout.of(Model.of(("casing.spring.linear",)), [record])
        problem = SimpleNamespace(
            layout=layout, data=[SimpleNamespace(initial_speeds=([], []), prior=None)], reference=1.0
        )
        count = len(layout.names)
        slow = (
            None
            if error is None
            else SimpleNamespace(
                phase_error=error * _initial_values.LARGEST_PHASE_ERROR, theta=np.full(count, 5.0)
            )
        )
        monkeypatch.setattr(_initial_values, "_deflection", lambda *_: None)
        monkeypatch.setattr(_initial_values, "start_values", lambda *_: np.zeros(count))
        monkeypatch.setattr(_initial_values, "averaged", lambda *_: slow)
        monkeypatch.setattr(_initial_values, "_period_by_period", lambda problem, theta: np.full(count, 8.0))
        assert set(initial_values(problem, None)) == {5.0 if taken == "averaged" else 8.0}

    def test_the_number_of_periods_is_doubled(self, monkeypatch):
        counts = []
        monkeypatch.setattr(_initial_values, "_first_periods", lambda data, count: counts.append(count))
        monkeypatch.setattr(
            _initial_values, "CaseData", SimpleNamespace(of=lambda r, _: SimpleNamespace(record=r))
        )
        monkeypatch.setattr(_initial_values, "Problem", SimpleNamespace(of=lambda layout, data: None))
        monkeypatch.setattr(_initial_values, "replace", lambda layout, records: layout)
        monkeypatch.setattr(
            _initial_values, "search", lambda part, theta, **_: SimpleNamespace(theta=theta + 1)
        )
        data = [SimpleNamespace(motion=SimpleNamespace(periods=p), criteria=None) for p in (9.0, 17.0)]
        found = _initial_values._period_by_period(SimpleNamespace(layout=None, data=data), np.zeros(1))
        assert counts[::2] == [2.0, 4.0, 8.0, 16.0]
        assert found.tolist() == [4.0]


class TestShapes:
    @pytest.mark.parametrize(
        ("name", "searched"),
        [
            ("touchpoint.step", True),
            ("touchpoint.stribeck", True),
            ("bearing.heating", True),
            ("bearing.power", False),  # it has transformed variables
            ("casing.precession", False),
            ("casing.air.quadratic", False),
            ("contact.sliding", False),
        ],
    )
    def test_which_laws_need_a_search(self, name, searched):
        record = SimpleNamespace(label="case", span=(BEGIN, BEGIN + SPAN))
        layout = ParameterLayout.of(Model.of(dict.fromkeys((*LINEAR, name))), [record])
        assert [e.name for e in unknown_shapes(layout, None)] == ([name] if searched else [])
        if searched:
            shape = next(p.symbol for p in LIBRARY[name].parameters if p.role == "shape")
            assert unknown_shapes(layout, {f"{name}.{shape}@case": 1.0}) == []
            assert len(unknown_shapes(layout, {f"{name}.k": 1.0})) == 1

    def test_a_bearing_law_alone_needs_none(self):
        law = resolve("bearing: k*abs(delta)**n*sign(delta)")
        record = SimpleNamespace(label="case", span=(BEGIN, BEGIN + SPAN))
        for names, searched in ((("casing.air.linear",), False), (("bearing.linear",), True)):
            layout = ParameterLayout.of(Model.of(names).with_effect(law), [record])
            assert bool(unknown_shapes(layout, None)) is searched

    def grid(self, effect):
        record = SimpleNamespace(span=(2.0, 2.0 + SPAN), largest_speeds=SPEEDS)
        data = [SimpleNamespace(initial_speeds=moved())]
        problem = SimpleNamespace(layout=SimpleNamespace(records=[record]), data=data)
        return list(_initial_values._grid(problem, effect))

    def test_shapes_are_tried_as_declared(self):
        assert self.grid(LIBRARY["touchpoint.stribeck"]) == [
            {"w": pytest.approx(150.0 * w)} for w in (0.007, 0.013, 0.033, 0.08, 0.2, 0.6)
        ]
        times = [c["tau_T"] for c in self.grid(LIBRARY["bearing.heating"])]
        assert times == pytest.approx([SPAN * x for x in (0.05, 0.15, 0.4, 1.2, 4.0)])
        steps = [c["t0"] for c in self.grid(LIBRARY["touchpoint.step"])]
        declared = next(p.grid for p in LIBRARY["touchpoint.step"].parameters if p.symbol == "t0")
        assert steps == pytest.approx([2.0 + SPAN * x for x in declared])
        lonely = replace(LIBRARY["touchpoint.stribeck"], parameters=(
            Parameter("k", "N m"), Parameter("w", "s-1", "shape", 0.1, 9.0, 4.0),
        ))  # fmt: skip
        assert self.grid(lonely) == [{"w": 4.0}]

    def test_exponents_of_a_users_power_law(self):
        law = resolve("casing: -k*abs(omega_c)**n*sign(omega_c)")
        tried = [c["n"] for c in self.grid(law)]
        (shape,) = (p for p in law.parameters if p.symbol == "n")
        every = (0.25, 0.5, 0.75, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0)
        assert tried == [v for v in every if shape.lower <= v <= shape.upper]
        assert len(tried) > 3

    def test_the_number_of_trials_is_limited(self):
        both = replace(LIBRARY["touchpoint.stribeck"], parameters=(
            Parameter("k", "N m"),
            Parameter("w", "s-1", "shape", grid=tuple(np.linspace(1.0, 2.0, 10))),
            Parameter("v", "s-1", "shape", grid=tuple(np.linspace(1.0, 2.0, 10))),
        ))  # fmt: skip
        assert len(self.grid(both)) == 80

    def stepped(self, strength=0.0, *, lower=0.0, upper=np.inf, jacobian=None, residual=None):
        j = np.array([[1.0, 2.0], [0.0, 1.0], [1.0, 1.0]]) if jacobian is None else jacobian
        r = np.array([1.0, -3.0, 0.5]) if residual is None else residual
        layout = SimpleNamespace(bounds=lambda: (np.array([-np.inf, lower]), np.array([np.inf, upper])))
        problem = SimpleNamespace(layout=layout, residuals=lambda predictions: (r, j))
        return r, j, _initial_values._stepped(problem, np.array([5.0, strength]), [], np.array([1]))

    def test_one_step_of_all_variables_gives_the_strength(self):
        r, j, (cost, end) = self.stepped()
        step = np.linalg.lstsq(j, -r, rcond=None)[0]
        assert step[1] > 0
        assert end == pytest.approx([5.0, step[1]])  # the others stay
        assert cost == pytest.approx(np.sum((r + j @ step) ** 2))

    @pytest.mark.parametrize(
        "change",
        [
            {"lower": 1e9},
            {"upper": 0.1},
            {"jacobian": np.array([[1.0, 0.0], [0.0, 0.0], [1.0, 0.0]])},  # no response to the law
            {"jacobian": np.array([[np.inf, 1.0], [0.0, 1.0], [1.0, 1.0]])},
        ],
    )
    def test_a_step_beyond_the_bounds_or_without_response_is_none(self, change):
        assert self.stepped(**change)[2] is None

    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_bounds_of_the_strength(self, sign):
        r, _, (_, end) = self.stepped(lower=-np.inf, residual=sign * np.array([1.0, -3.0, 0.5]))
        below, above = end[1] - 1e-6, end[1] + 1e-6
        for lower, upper, possible in (
            (below, np.inf, True),
            (above, np.inf, False),
            (-np.inf, above, True),
            (-np.inf, below, False),
        ):
            found = self.stepped(lower=lower, upper=upper, residual=r)[2]
            assert (found is not None) is possible

    def test_a_variable_without_response_does_not_move(self):
        _, _, (_, end) = self.stepped(jacobian=np.array([[0.0, 2.0], [0.0, 1.0], [0.0, 1.0]]))
        assert end[0] == 5.0

    def problem(self, levels):
        """Two shapes, and the deviance of each at each level of the noise."""
        layout = SimpleNamespace(
            records=[1], places=lambda i, keys: np.array([0 if k.endswith(".k") else 1 for k in keys])
        )

        def predict(theta):
            if theta[1] == 3.0:
                raise SimulationError("it diverges", "")
            return theta[1]

        problem = SimpleNamespace(layout=layout, predict=predict)
        problem.with_noise = lambda noise: SimpleNamespace(noise=noise, level=noise[0].level, **vars(problem))
        return problem

    def test_shape_and_level_of_the_least_deviance_are_chosen(self, monkeypatch):
        class Level(SimpleNamespace):
            def at(self, level):
                determinant = SimpleNamespace(log_determinant=10 * level)
                return Level(level=level, least=self.least, whitener=determinant)

        tried = []

        def stepped(trial, begin, predictions, places):
            tried.append(trial.level)
            return (abs(begin[1] - 2.0) * 30 + 1 / trial.level, begin + np.array([trial.level, 0.0]))

        monkeypatch.setattr(_initial_values, "_grid", lambda *_: iter([{"w": w} for w in (1.0, 2.0, 3.0)]))
        monkeypatch.setattr(_initial_values, "_stepped", stepped)
        noise = [Level(level=1.0, least=0.05)]
        found, theta = initial_shapes(
            self.problem(None),
            np.array([7.0, 9.0]),
            [LIBRARY["touchpoint.stribeck"]],
            fitted=True,
            noise=noise,
        )
        # 10 s + 1 / s is least at 0.3 of the trial levels, and no level is below 0.05
        assert theta.tolist() == [0.3, 2.0]
        assert found.level == 0.3
        assert tried[::2] == pytest.approx([1.0, 0.3, 0.1, 0.05, 0.05, 0.05])
        tried.clear()
        noise = [Level(level=10.0, least=0.0)]
        initial_shapes(
            self.problem(None),
            np.array([7.0, 9.0]),
            [LIBRARY["touchpoint.stribeck"]],
            fitted=True,
            noise=noise,
        )
        assert tried[::2] == pytest.approx([10.0, 3.0, 1.0, 0.3, 0.1, 0.01])

    def test_without_a_possible_step_nothing_changes(self, monkeypatch):
        class Level(SimpleNamespace):
            def at(self, level):
                return Level(level=level, least=self.least, whitener=SimpleNamespace(log_determinant=0.0))

        monkeypatch.setattr(_initial_values, "_grid", lambda *_: iter([{"w": 1.0}]))
        monkeypatch.setattr(_initial_values, "_stepped", lambda *_: None)
        noise = [Level(level=1.0, least=0.05)]
        found, theta = initial_shapes(
            self.problem(None),
            np.array([7.0, 9.0]),
            [LIBRARY["touchpoint.stribeck"]],
            fitted=True,
            noise=noise,
        )
        assert (theta.tolist(), found.level) == ([0.0, 9.0], 1.0)


SPRING, DRY, VISCOUS, QUADRATIC = (
    "casing.spring.linear.k", "touchpoint.constant.b1", "casing.air.linear.b2", "casing.air.quadratic.k",
)  # fmt: skip
RATE = 3.5


def slow_motion(dry, linear, quadratic, *, begin=2.0, span=60.0, phase=0.4):
    """Return amplitude and phase of an oscillation of 3.5 rad/s that these frictions damp, by averaging."""
    time = np.linspace(begin + 0.5, begin + span, 60)
    fall = lambda t, a: -linear * a / 2 - 2 * dry / (np.pi * RATE) - 4 * quadratic * RATE * a**2 / (3 * np.pi)  # noqa: E731
    a = solve_ivp(fall, (time[0], time[-1]), [1.2], t_eval=time, rtol=1e-10, atol=1e-12).y[0]
    return SlowMotion(time, a, RATE * (time - begin) + phase)


def fitted(frictions, *, noise=0.0, errors=None, begin=2.0):
    values = dict.fromkeys((DRY, VISCOUS, QUADRATIC), 0.0) | frictions
    slow = slow_motion(*values.values(), begin=begin)
    if noise:
        rng = np.random.default_rng(1)
        slow = SlowMotion(
            slow.time,
            slow.amplitude + noise * rng.standard_normal(60),
            slow.phase + 2 * noise / slow.amplitude * slow.amplitude.max() * rng.standard_normal(60),
        )
    t = np.linspace(begin, begin + 60.0, 400)
    record = oscillators.record(t, np.cos(t), 1e-3, 0)
    data = SimpleNamespace(motion=SimpleNamespace(slow_motion=slow), record=record)
    model = Model.of(tuple(n.rpartition(".")[0] for n in (SPRING, *frictions)))
    layout = ParameterLayout.of(model, [record])
    theta = np.ones(len(layout.names))
    found = averaged(layout, [data], theta, _initial_values._strengths, _initial_values._regress, errors)
    assert (theta == 1.0).all()
    return dict(zip(layout.names, found.theta, strict=True)), found, slow


class TestAveraged:
    @pytest.mark.parametrize(
        "frictions",
        [
            {VISCOUS: 0.05},
            {DRY: 0.02},
            {QUADRATIC: 0.03},
            {DRY: 0.02, VISCOUS: 0.01},
            {VISCOUS: 0.02, QUADRATIC: 0.01},
        ],
    )
    def test_strengths_are_those_that_damp_the_motion(self, frictions):
        values, found, slow = fitted(frictions)
        for name, value in frictions.items():
            assert values[name] == pytest.approx(value, rel=0.01), name
        # the curvature of the amplitude lowers the frequency by a millionth
        assert values[SPRING] == pytest.approx(RATE**2, rel=1e-3)
        assert found.phase_error < 1e-3
        # the first sample is half a second before the first amplitude
        a = slow.amplitude[0] - 0.5 * np.gradient(slow.amplitude, slow.time)[0]
        (omega,) = (v for k, v in values.items() if k.startswith("initial.omega_c"))
        (deflection,) = (v for k, v in values.items() if k.startswith("initial.deflection"))
        assert deflection == pytest.approx(a * math.cos(0.4), rel=2e-3)
        assert omega == pytest.approx(-a * RATE * math.sin(0.4), rel=2e-3)
        assert next(v for k, v in values.items() if k.startswith("initial.omega_r")) == 0.0

    def test_errors_follow_from_the_residuals_or_are_given(self):
        """A phase has the error of the deflection divided by the amplitude; here it is twice that of the amplitude."""
        _, found, slow = fitted({VISCOUS: 0.05}, noise=1e-3)
        relative = slow.amplitude / slow.amplitude.max()
        ((keys, design, rest),), (scale,) = found.rows, found.scales
        amplitude, phase = scale.reshape(2, -1)
        assert amplitude == pytest.approx(np.full(60, amplitude[0]))
        assert amplitude[0] == pytest.approx(1e-3, rel=0.3)
        assert phase * relative == pytest.approx(np.full(60, found.phase_error))
        assert 1.3e-3 < found.phase_error < 3e-3
        assert design.shape == (120, len(keys))
        rest = rest.reshape(2, -1)
        assert np.mean(rest**2, axis=1) == pytest.approx([1.0, 1.0])
        # neither the initial amplitude nor the initial phase counts
        assert rest[0].sum() == pytest.approx(0.0, abs=1e-6)
        assert rest[1] @ relative == pytest.approx(0.0, abs=1e-6)
        for column in design.T.reshape(len(keys), 2, -1):
            assert column[0].sum() == pytest.approx(0.0, abs=1e-6 * np.abs(column).max())
            assert column[1] @ relative == pytest.approx(0.0, abs=1e-6 * np.abs(column).max())
        given = [np.full(120, 0.5)]
        _, again, _ = fitted({VISCOUS: 0.05}, noise=1e-3, errors=given)
        assert again.scales[0] is given[0]
        assert again.rows[0][2].reshape(2, -1)[0] == pytest.approx(
            rest[0] * amplitude / 0.5, rel=0.2, abs=2e-4
        )

    def test_a_motion_of_few_periods_has_no_averages(self):
        record = oscillators.record(np.linspace(0.0, 9.0, 99), np.zeros(99), 1e-3, 0)
        data = SimpleNamespace(motion=SimpleNamespace(slow_motion=None), record=record)
        model = Model.of(("casing.spring.linear",))
        layout = ParameterLayout.of(model, [record])
        assert averaged(layout, [data], np.zeros(len(layout.names)), None, None) is None
        assert _initial_values.averaged_fit(model, [data]) is None


@pytest.mark.parametrize(("best", "found"), [(0.0, 0.0), (0.011, 0.0112), (0.5, 0.477), (3.0, 1.0)])
def test_a_dead_time_is_that_of_the_best_regression(monkeypatch, best, found):
    """Two recordings at intervals of 0.01 and 0.02 s, of 5 and 10 s; the error of the first one is 9 times as large."""
    layout = SimpleNamespace(places=lambda case, keys: np.array([{"T": 0, "k": 1}[k] for k in keys]))
    monkeypatch.setattr(_initial_values, "_dead_times", lambda layout: ["T"])

    def equations(layout, case, times, speeds, deflection, trial):
        off = (trial[0] - best) * (3.0 if case == 0 else 1.0)
        return ["k"], np.array([[1.0], [1.0]]), np.array([2.0 + off, 2.0 - off])

    monkeypatch.setattr(_initial_values, "_equations", equations)
    monkeypatch.setattr(_initial_values, "_regress", lambda layout, parts: (np.array([1]), np.array([2.0])))
    rough = [(np.arange(0.0, 5.0, 0.01), None), (np.arange(0.0, 10.005, 0.02), None)]
    theta = _initial_values._with_dead_times(layout, rough, ("d1", "d2"), np.array([7.0, 5.0]))
    grid = np.array([0.0, *np.geomspace(0.01, 1.0, 40)])
    assert theta[0] == pytest.approx(grid[np.argmin(np.abs(grid - best))])
    assert theta[0] == pytest.approx(found, rel=0.06)
    assert theta[1] == 5.0


@pytest.mark.parametrize(
    ("periods", "counts"), [((2.0,), []), ((2.1,), [2]), ((9.0, 3.0), [2, 4, 8]), ((8.0,), [2, 4])]
)
def test_an_oscillation_is_searched_through_doubled_numbers_of_periods(monkeypatch, periods, counts):
    searched = []

    def search(problem, theta, *, quick, max_iterations):
        assert (quick, max_iterations) == (True, 60)
        searched.append((problem, theta))
        if len(searched) == 2:
            raise EstimationError("no minimum")
        return SimpleNamespace(theta=theta + 1)

    monkeypatch.setattr(_initial_values, "search", search)
    monkeypatch.setattr(
        _initial_values, "_first_periods", lambda d, count: SimpleNamespace(of=(d.motion.periods, count))
    )
    monkeypatch.setattr(
        _initial_values.CaseData,
        "of",
        lambda record, criteria: SimpleNamespace(record=record, criteria=criteria),
    )
    monkeypatch.setattr(_initial_values.Problem, "of", lambda layout, data: [d.record.of for d in data])
    monkeypatch.setattr(_initial_values, "replace", lambda layout, records: None)
    data = [SimpleNamespace(motion=SimpleNamespace(periods=p), criteria="c") for p in periods]
    theta = _initial_values._period_by_period(SimpleNamespace(layout=None, data=data), 10)
    assert [p for p, _ in searched] == [[(p, c) for p in periods] for c in counts]
    assert theta == 10 + len(counts) - (len(counts) > 1)
    # a search that fails leaves the values of the one before
    assert [t for _, t in searched] == [10, 11, 11][: len(counts)]


@pytest.mark.parametrize("target", [(3.0, 4.0, 0.0), (0.0, 0.0, 0.0)])
def test_the_error_of_the_equations_is_the_share_that_the_strengths_leave(monkeypatch, target):
    """Of two recordings, the second with twice the change of the speeds; the strength is half of that needed."""
    layout = SimpleNamespace(places=lambda case, keys: [0])
    monkeypatch.setattr(_initial_values.ParameterLayout, "of", lambda model, records: layout)
    monkeypatch.setattr(_initial_values, "reference_speed", lambda data, mechanism: 1.0)
    monkeypatch.setattr(_initial_values, "start_values", lambda *_: np.array([0.5]))
    monkeypatch.setattr(
        _initial_values, "_equations",
        lambda layout, case, times, speeds, deflection, theta: (
            ["k"],
            (case + 1.0) * np.array([*target[:2], 0.0])[:, None],
            (case + 1.0) * np.array([*target[:2], 5.0 * any(target)]),
        ),
    )  # fmt: skip
    motion = SimpleNamespace(time=np.array([0.0, 1.0]), deflection=np.array([0.0, 1.0]))
    data = [SimpleNamespace(record=None, initial_speeds=(np.zeros(3), np.zeros((3, 2))), motion=motion)] * 2
    model = SimpleNamespace(restoring=False, mechanism=None)
    # half of 5 and all of 5 are left, of 5 and 5
    expected = math.sqrt((2.5**2 + 25.0) / 50.0) if any(target) else 0.0
    assert _initial_values.equation_error(model, data) == pytest.approx(expected)
    monkeypatch.setattr(_initial_values, "averaged_fit", lambda model, data: SimpleNamespace(phase_error=0.3))
    assert _initial_values.equation_error(model, data) == pytest.approx(expected)
    model.restoring = True
    assert _initial_values.equation_error(model, data) == 0.3


@pytest.mark.parametrize(
    ("laws", "fixed", "dead", "expected"),
    [
        (("linear.d", "constant.c"), (), (), ("linear.d", "constant.c")),
        (("linear.d", "power.f", "power.g"), (), (), ("linear.d",)),  # both are nearly alike
        (("linear.d", "power.f"), ("power.g",), (), ("linear.d", "power.f")),  # a known exponent
        (("constant.c", "power.f", "power.g"), (), (), ("constant.c", "power.f")),
        (("power.f", "power.g"), (), (), ("power.f",)),
        (("constant.c", "heating.k", "heating.tau_T"), (), (), ("constant.c",)),
        (("heating.k", "heating.tau_T"), (), (), ("heating.k",)),  # the only strength
        (("linear.d", "constant.c"), (), ("constant.c",), ("linear.d",)),
        (("linear.d", "power.g"), (), (), ("linear.d",)),
    ],
)
def test_strengths_of_the_regression_are_not_collinear(monkeypatch, laws, fixed, dead, expected):
    """Names of laws of a bearing; exponents and times are no strengths."""
    roles = {f"bearing.{k}": "shape" if k in {"power.g", "heating.tau_T"} else "amplitude" for k in laws}
    layout = SimpleNamespace(
        model=SimpleNamespace(
            parameters={k: SimpleNamespace(role=r) for k, r in roles.items()},
            mechanism=SimpleNamespace(couplings=[SimpleNamespace(name="bearing")]),
        )
    )
    assert not {f"bearing.{k}" for k in fixed} & set(roles)
    monkeypatch.setattr(_initial_values, "_dead_times", lambda layout: [f"bearing.{k}" for k in dead])
    found = _initial_values._strengths(layout, list(roles))
    assert found == [f"bearing.{k}" for k in expected]


def test_dead_times_are_free_parameters_of_inputs():
    def effect(name, joint):
        return SimpleNamespace(name=name, joint=joint, free=[SimpleNamespace(symbol="T")])

    model = SimpleNamespace(effects=[effect("a", "input"), effect("b", "bearing"), effect("c", "input")])
    assert _initial_values._dead_times(SimpleNamespace(model=model)) == ["a.T", "c.T"]


def test_periods_begin_at_passages_upwards():
    deflection = np.array([1.0, -1.0, 0.0, 2.0, 1.0, -1.0, 1.0, -3.0])
    groups = _initial_values._periods(deflection)
    assert groups.tolist() == [0, 0, 0, 1, 1, 1, 2, 2]
    columns = np.array([[0.0, 3, 6, 1, 2, 6, 4, 8], np.arange(8.0)]).T
    assert _initial_values._means(groups, columns) == pytest.approx(
        np.array([[3.0] * 3 + [3.0] * 3 + [6.0] * 2, [1.0] * 3 + [4.0] * 3 + [6.5] * 2]).T
    )
