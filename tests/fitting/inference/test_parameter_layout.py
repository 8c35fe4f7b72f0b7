"""The layout of parameters, their short names, the settings of a user, and the record of refits."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from cases import data

from fitting import (
    LINEAR,
    REDUCED,
    EffectError,
    Estimate,
    EstimationError,
    FittingError,
    Input,
    Model,
    Params,
    Record,
    RecordError,
    effect,
    make_record,
)
from fitting import Model as AnyModel
from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR
from fitting.effects._effect import Effect, Parameter
from fitting.effects._expression import Tape
from fitting.effects._user import resolve
from fitting.inference import _parameters
from fitting.inference._parameters import (
    ParameterLayout,
    PowerLaw,
    Sinusoid,
    covers,
    find_power_laws,
    find_sinusoids,
    from_physical,
    from_polar,
    is_power_law,
    to_physical,
    to_polar,
)
from fitting.inference._params import Names, Settings, note, settings_of, shown_name
from fitting.inference._record import Samples
from fitting.inference._ties import chain, follow, parse_tie
from fitting.inference._trace import (
    Refit,
    attempt,
    of_model,
    record_result,
    recorded_map,
    recording,
    with_purpose,
)


@pytest.fixture(scope="module")
def records():
    one = data(seed=0).record
    return [
        Record(label, 5e-5, 2e-5 + i * 1e-6, one.casing, one.rotor)
        for i, label in enumerate(("glass", "steel"))
    ]


def test_one_case_has_plain_names(records):
    layout = ParameterLayout.of(Model.of(LINEAR), records[:1])
    assert set(layout.names) == {
        "rotor.air.quadratic.a2",
        "touchpoint.constant.b1",
        "casing.air.linear.b2",
        "bearing.linear.d",
        "initial.omega_r@glass",
        "initial.omega_c@glass",
    }


def test_surfaces_and_air_of_the_casing_are_free_per_case(records):
    names = ParameterLayout.of(Model.of(LINEAR), records).names
    assert [n for n in names if n.startswith("touchpoint")] == [
        "touchpoint.constant.b1@glass",
        "touchpoint.constant.b1@steel",
    ]
    assert "casing.air.linear.b2@steel" in names
    assert "bearing.linear.d" in names
    assert len(names) == 2 + 2 * 2 + 2 * 2


@pytest.mark.parametrize(
    "share", ["touchpoint", "touchpoint.", "touchpoint.constant", "touchpoint.constant.b1", "b1"]
)
def test_sharing_by_prefix_effect_key_or_symbol(records, share):
    names = ParameterLayout.of(Model.of(LINEAR), records, share=[share]).names
    assert "touchpoint.constant.b1" in names
    assert "casing.air.linear.b2@glass" in names


def test_freeing_per_case(records):
    names = ParameterLayout.of(Model.of(LINEAR), records, per_case=["bearing.linear"]).names
    assert {"bearing.linear.d@glass", "bearing.linear.d@steel"} <= set(names)


def test_each_case_gets_its_own_numbers(records):
    layout = ParameterLayout.of(Model.of(LINEAR), records)
    theta = np.arange(len(layout.names), dtype=float)
    for i, label in enumerate(("glass", "steel")):
        numbers = layout.numbers(theta, i)
        assert numbers["touchpoint.constant.b1"] == layout.index[f"touchpoint.constant.b1@{label}"]
        assert numbers["bearing.linear.d"] == layout.index["bearing.linear.d"]
        assert numbers[INERTIA_ROTOR] == 5e-5
        assert numbers[INERTIA_CASING] == 2e-5 + i * 1e-6
        assert tuple(layout.start(theta, i)) == (
            layout.index[f"initial.omega_r@{label}"],
            layout.index[f"initial.omega_c@{label}"],
        )


def test_unknown_names_are_refused(records):
    for words in (
        {"share": ["touchpoint.rough"]}, {"share": ["touchpoint.const"]}, {"per_case": ["bear"]},
        {"per_case": ["nothing"]},
    ):  # fmt: skip
        with pytest.raises(EffectError, match="is not a parameter of the model"):
            ParameterLayout.of(Model.of(LINEAR), records, **words)


@pytest.mark.parametrize(
    ("per_inertia", "gain", "friction"), [(True, "kg-1 m-2", "s-1"), (False, "1", "N m s")]
)
def test_only_the_gain_of_a_recorded_torque_has_the_unit_of_a_gain(per_inertia, gain, friction):
    """Not the exponent of a law of the torque, which has no unit either."""
    t = np.linspace(0.0, 2.0, 40)
    drive = Input("drive", [0.0, 1.0], [0.0, 3.0], "N m", interpolation="hold")
    record = make_record(
        casing=(t, 5.0 - t, np.full(40, 0.01)), rotor=[], quantity="omega", inputs=[drive], I_rotor=1.0,
        I_casing=1.0, per_inertia=per_inertia, single=True,
    )  # fmt: skip
    model = Model.of(["casing.air.linear"])
    for law in ("casing: k*drive", "casing: q*drive**n"):
        model = model + effect(law, [drive])
    layout = ParameterLayout.of(model, [record])
    names = ("casing: k*drive.k", "casing: q*drive**n.n", "casing.air.linear.b2", "initial.omega_c@case")
    assert [layout.unit(name) for name in names] == [gain, "1", friction, "rad s-1"]


def test_ranges_tighten_bounds_and_never_widen_them(records):
    layout = ParameterLayout.of(
        Model.of(REDUCED),
        records[:1],
        ranges={"bearing.power.g": (0.1, 1.3), "bearing.linear.d": (-1.0, 5e-7)},
    )
    lower, upper = layout.bounds()
    g, d = layout.index["bearing.power.g"], layout.index["bearing.linear.d"]
    assert (lower[g], upper[g]) == (0.3, 1.3)
    assert (lower[d], upper[d]) == (0.0, 5e-7)
    theta = np.full(len(layout.names), 1e-3)
    theta[g], theta[d] = 1.3, 5e-7
    assert layout.at_bound(theta)[[g, d]].all()
    assert layout.at_bound(theta).sum() == 2


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("sqrt(b1*d)", 6.0),
        ("sqrt(touchpoint.constant.b1*bearing.linear.d)", 6.0),
        ("2*linear.d + casing: -k*u.k", 23.0),
        ("casing: -k*u.k*abs(bearing.linear.d - b1)", 25.0),
    ],
)
def test_a_tie_has_functions_and_long_and_short_names(text, value):
    known = {"touchpoint.constant.b1": 4.0, "bearing.linear.d": 9.0, "casing: -k*u.k": 5.0}
    assert Tape([parse_tie(text, list(known))])(known)[0] == pytest.approx(value)


@pytest.mark.parametrize("text", ["2*nothing", "2*bearing.power.f", "sqrt(c)"])
def test_a_tie_to_an_unknown_parameter_is_refused(text):
    with pytest.raises(EffectError, match="there is no parameter"):
        parse_tie(text, ["touchpoint.constant.b1", "bearing.linear.d"])


def test_start_speeds_have_no_bounds(records):
    layout = ParameterLayout.of(Model.of(LINEAR), records[:1])
    assert np.isneginf(layout.bounds()[0][layout.index["initial.omega_c@glass"]])
    assert layout.parameter("initial.omega_r@glass").unit == "rad s-1"


@pytest.mark.parametrize(
    ("name", "physical"),
    [("bearing.linear.d", True), ("bearing.power.f", False), ("bearing.power.g", False)],
)
def test_a_strength_has_a_physical_bound_and_a_range_of_the_fit_is_none(records, name, physical):
    layout = ParameterLayout.of(Model.of(REDUCED), records[:1], ranges={"bearing.power.f": (0.0, 1e-8)})
    assert layout.is_physical_bound(name) == physical


def test_the_choices_of_a_layout_are_what_differs_from_the_usual_one(records):
    model, given = Model.of(LINEAR), {"share": ["touchpoint"], "per_case": ["bearing.linear"]}
    layout = ParameterLayout.of(model, records, **given)
    assert layout.choices == (("touchpoint.constant.b1",), ("bearing.linear.d",))
    assert ParameterLayout.of(model, records).choices == ((), ())
    assert ParameterLayout.of(model, records[:1], **given).choices == ((), ())
    share, per_case = layout.choices
    assert ParameterLayout.of(model, records, share, per_case).names == layout.names


@pytest.mark.parametrize(("slowest", "power"), [(1.0, True), (-1.0, False)])
def test_the_base_of_a_power_law_is_positive_at_every_speed(slowest, power):
    time = np.linspace(0.0, 1.0, 50)
    speeds = np.stack([np.full(50, 300.0), np.linspace(40.0, slowest, 50)], axis=1)
    assert is_power_law(resolve("casing: -k*omega_c**n"), time, speeds) == power


@pytest.mark.parametrize(("distance", "order"), [(0.15, 0.5), (0.07, None)])
def test_an_exponent_is_compared_where_the_base_differs_from_one(distance, order):
    """At most of the speeds by more than a tenth of its logarithm."""
    mechanism = resolve("casing: -k*omega_c**n").mechanism
    speeds = np.stack([np.full(40, 300.0), np.full(40, np.exp(distance))], axis=1)
    known = _parameters._variables(np.linspace(0.0, 1.0, 40), speeds, mechanism)
    found = _parameters._order(resolve("casing: -k*omega_c**n"), resolve("casing: -c*sqrt(omega_c)"), known)
    assert found == (None if order is None else pytest.approx(order))


def test_in_a_rigid_contact_the_rotor_starts_at_the_ratio_times_the_speed_of_the_casing(records):
    model = Model.of(["contact.rolling", "touchpoint.constant", "casing.spring.linear"])
    layout = ParameterLayout.of(model, records[:1])
    theta = np.zeros(len(layout.names))
    given = {"contact.rolling.n": 2.5, "initial.omega_c@glass": 30.0, "initial.deflection@glass": 0.2}
    for name, value in given.items():
        theta[layout.index[name]] = value
    assert layout.start(theta, 0).tolist() == [75.0, 30.0, 0.2]


def test_a_tied_parameter_changes_with_each_of_its_sources(records):
    """b2 = b1^2 d; each case has its own b1 and b2."""
    layout = ParameterLayout.of(Model.of(LINEAR), records, ties={"casing.air.linear.b2": "b1**2*d"})
    theta = np.linspace(1.0, 2.0, len(layout.names))
    slope, followed = chain(theta, layout.tied), follow(theta, layout.tied)
    d = layout.index["bearing.linear.d"]
    for label in ("glass", "steel"):
        b1, b2 = (layout.index[f"{k}@{label}"] for k in ("touchpoint.constant.b1", "casing.air.linear.b2"))
        expected = np.zeros(len(theta))
        expected[[b1, d]] = 2 * theta[b1] * theta[d], theta[b1] ** 2
        np.testing.assert_allclose(slope[b2], expected)
        assert not slope[:, b2].any()
        assert followed[b2] == pytest.approx(theta[b1] ** 2 * theta[d])


def estimate(value=1.0, **more):
    return Estimate(value, 0.1, "s", at_bound=False, **more)


B1, B2, D, A2 = "touchpoint.constant.b1", "casing.air.linear.b2", "bearing.linear.d", "rotor.air.quadratic.a2"


@pytest.fixture(scope="module")
def equal_records():
    t = np.linspace(0.0, 1.0, 20)
    run = Samples(t, 5.0 * t, np.full(20, 1e-3))
    return [Record(label, 5e-5, 2e-5, run, (run,)) for label in ("glass", "steel")]


class TestParams:
    PARAMS = Params(
        {"a.b.k": estimate(1.0), "a.c.k": estimate(2.0), "a.c.m": estimate(3.0), "x.k@one": estimate(4.0)}
    )

    def test_a_unique_end_is_enough(self):
        assert self.PARAMS["m"].value == 3.0
        assert self.PARAMS["b.k"].value == 1.0
        assert self.PARAMS["c.k"].value == 2.0
        assert "m" in self.PARAMS
        for name in ("k", "c", "none", 3):
            assert name not in self.PARAMS
        with pytest.raises(EffectError):
            self.PARAMS["k"]
        assert list(self.PARAMS) == ["a.b.k", "a.c.k", "a.c.m", "x.k@one"]
        assert len(self.PARAMS) == 4
        assert self.PARAMS.valuesdict() == {"a.b.k": 1.0, "a.c.k": 2.0, "a.c.m": 3.0, "x.k@one": 4.0}

    def test_setting_one_changes_no_other(self):
        held = self.PARAMS.set("m", value=9.0, vary=False, max=10)
        assert (held["m"].value, held["m"].vary, held["m"].max) == (9.0, False, 10)
        assert self.PARAMS["m"].value == 3.0
        assert held.changed == {"a.c.m"}
        both = held.set("b.k", value=5)
        assert both.changed == {"a.c.m", "a.b.k"}
        assert both["m"] == held["m"]

    def test_an_expression_ties_and_its_absence_frees(self):
        tied = self.PARAMS.set("m", expr="2*k")
        assert (tied["m"].expr, tied["m"].vary) == ("2*k", False)
        assert tied.set("m", value=4.0)["m"].vary is False
        free = tied.set("m", expr=None)
        assert (free["m"].expr, free["m"].vary) == (None, True)
        held = tied.set("m", expr=None, vary=False)
        assert (held["m"].expr, held["m"].vary) == (None, False)

    @pytest.mark.parametrize(
        "wrong",
        [
            {"speed": 1.0},
            {"value": True},
            {"value": "1"},
            {"value": math.nan},
            {"value": math.inf},
            {"vary": 1},
            {"expr": 2.0},
            {"min": None},
        ],
    )
    def test_wrong_settings_are_refused(self, wrong):
        with pytest.raises(EstimationError):
            self.PARAMS.set("m", **wrong)
        assert self.PARAMS.set("m", value=np.float32(2.0), min=-math.inf, max=math.inf)["m"].value == 2.0

    def test_remarks_say_what_is_not_simply_fitted(self):
        assert note(estimate()) == ""
        assert note(estimate(vary=False)) == " (held)"
        assert note(estimate(vary=False, expr="2*k")) == " (= 2*k)"
        assert note(Estimate(1.0, 0.1, "s", at_bound=True)) == " (at its bound)"

    @pytest.mark.parametrize(("count", "lines"), [(18, 19), (19, 20), (20, 20), (40, 20)])
    def test_a_repr_has_at_most_twenty_lines(self, count, lines):
        shown = repr(Params({f"p{i}": estimate() for i in range(count)})).splitlines()
        assert len(shown) == lines
        if count > 19:
            assert shown[-1].split()[1] == str(count - 18)


class TestSettings:
    def of(self, params, *labels):
        equal_records = [SimpleNamespace(name="", label=x) for x in labels or ("one",)]
        return settings_of(params, Model.of(LINEAR), equal_records)

    def test_a_mapping_holds_starts_bounds_and_ties(self):
        found = self.of(
            {
                "b1": {"value": 2, "vary": False},
                "b2": {"value": 3.0, "min": 1.0},
                "d": {"expr": "2*b2"},
                "a2": {"min": -1.0, "max": 4.0},
            }
        )
        assert found == Settings({B1: 2.0}, {B2: 3.0}, {B2: (1.0, math.inf), A2: (-1.0, 4.0)}, {D: "2*b2"})
        assert self.of({"b2": {"max": 5}}).ranges == {B2: (-math.inf, 5.0)}
        assert self.of({"b2": {"value": 1.0, "vary": True}}) == Settings(start={B2: 1.0})
        assert self.of({"b2": {"min": 2.0, "max": 2.0}}).ranges == {B2: (2.0, 2.0)}
        assert self.of(None) == Settings()

    @pytest.mark.parametrize(
        "wrong",
        [
            3,
            {"b1": 2.0},
            {"b1": {"vary": False}},
            {"b1": {"min": 2.0, "max": 1.0}},
            {"b1": {"min": math.nan}},
        ],
    )
    def test_contradictions_are_refused(self, wrong):
        with pytest.raises(EstimationError):
            self.of(wrong)

    def test_parameters_of_a_fit_keep_bounds_only_where_they_were_changed(self):
        params = Params(
            {B1: estimate(2.0, min=0.0, max=9.0), "other.law.q": estimate(), D: estimate(4.0, vary=False)}
        )
        assert self.of(params) == Settings({D: 4.0}, {B1: 2.0})
        changed = params.set(B1, max=8.0)
        assert self.of(changed) == Settings({D: 4.0}, {B1: 2.0}, {B1: (0.0, 8.0)})
        assert self.of(dict(params)).ranges == {B1: (0.0, 9.0)}
        with pytest.raises(EffectError):
            self.of({"other.law.q": {"value": 1.0}})

    def test_later_settings_take_precedence(self):
        one = Settings({"a": 1.0}, {"b": 2.0}, {"c": (0.0, 1.0)}, {"d": "x"})
        other = Settings({"a": 5.0}, {"e": 6.0})
        assert one.joined(other) == Settings({"a": 5.0}, {"b": 2.0, "e": 6.0}, {"c": (0.0, 1.0)}, {"d": "x"})

    def test_initial_values_need_their_case_only_where_there_are_several(self):
        model = Model.of(LINEAR)

        def names(*labels):
            return Names.of(model, [SimpleNamespace(name="", label=x) for x in labels])

        one, two = names("one"), names("one", "two")
        assert one("initial.omega_c") == "initial.omega_c@one"
        assert two("initial.omega_r@two") == "initial.omega_r@two"
        assert two("b2@one") == f"{B2}@one"
        assert two("b2") == B2
        assert not two.missing("b2")
        for wrong in ("initial.omega_c", "b2@three", "q"):
            assert two.missing(wrong)
        assert one.missing("b2@one")
        with pytest.raises(EffectError):
            one(3)

    def test_a_name_of_a_case_is_shown_where_there_are_several(self):
        assert shown_name("a.k@one", "", 1) == "a.k"
        assert shown_name("a.k@one", "", 2) == "a.k@one"


class TestLayout:
    def test_a_name_covers_key_effect_prefix_and_symbol(self):
        for name in (B1, "touchpoint.constant", "touchpoint", "touchpoint.", "b1"):
            assert covers(name, B1)
        for name in ("touch", "b", "constant", "touchpoint.const", "b2", "constant.b1"):
            assert not covers(name, B1)

    def test_variables_within_rounding_of_a_bound_are_at_it(self, equal_records):
        layout = ParameterLayout.of(Model.of(LINEAR), equal_records[:1], ranges={B1: (1.0, 2.0)})
        i = layout.index[B1]
        for value, at in (
            (1.0, True),
            (1.0 + 5e-10, True),
            (1.0 + 3e-9, False),
            (2.0, True),
            (2.0 - 1e-9, True),
            (2.0 - 5e-9, False),
            (1.5, False),
        ):
            theta = np.ones(len(layout.names))
            theta[i] = value
            assert layout.at_bound(theta).tolist() == [k == i and at for k in range(len(theta))]
        lower, upper = layout.bounds()
        assert (lower[i], upper[i]) == (1.0, 2.0)
        assert (lower[layout.index["initial.omega_c@glass"]], lower[layout.index[D]]) == (-np.inf, 0.0)

    def test_ranges_are_cut_at_the_declared_bounds(self, equal_records):
        layout = ParameterLayout.of(
            Model.of(LINEAR), equal_records[:1], ranges={B1: (-1.0, 2.0), "none": (0.0, 1.0)}
        )
        lower, upper = layout.bounds()
        assert (lower[layout.index[B1]], upper[layout.index[B1]]) == (0.0, 2.0)
        assert not layout.is_physical_bound(B1)
        assert layout.is_physical_bound(D)
        assert not layout.is_physical_bound("initial.omega_c@glass")

    def test_each_case_has_its_own_places(self, equal_records):
        layout = ParameterLayout.of(Model.of(LINEAR), equal_records)
        for case, label in enumerate(("glass", "steel")):
            found = layout.places(case, (B1, D, "initial.omega_c", "none"))
            assert found.tolist() == [
                layout.index[f"{B1}@{label}"],
                layout.index[D],
                layout.index[f"initial.omega_c@{label}"],
                -1,
            ]

    @pytest.mark.parametrize(
        ("given", "pairs"),
        [
            ({}, 1),
            ({"per_case": ["bearing"]}, 2),
            ({"per_case": ["bearing.power"]}, 0),
            ({"per_case": ["bearing.linear"]}, 2),
            ({"per_case": ["bearing.power.f", "bearing.linear"]}, 0),
            ({"ties": {"bearing.linear.d": "2*b2"}, "share": ["b2"]}, 0),
        ],
    )
    def test_a_power_law_is_paired_where_the_cases_have_it_in_common(self, equal_records, given, pairs):
        model = Model.of(["bearing.linear", "bearing.power", "casing.air.linear"])
        layout = ParameterLayout.of(model, equal_records, **given)
        speeds = np.stack([np.linspace(300.0, 200.0, 50), np.linspace(10.0, 5.0, 50)], axis=1)
        rough = [(np.arange(50.0), speeds), (np.arange(50.0), 2 * speeds)]
        found = find_power_laws(layout, rough)
        assert len(found) == pairs
        chosen = given.get("per_case", ())
        own = [f"@{r.label}" if pairs == 2 else "" for r in equal_records]
        power = own if chosen == ["bearing"] else ["", ""]
        for i, law in enumerate(found):
            assert law.d == layout.index[f"bearing.linear.d{own[i]}"]
            assert law.f == layout.index[f"bearing.power.f{power[i]}"]
            assert law.g == layout.index[f"bearing.power.g{power[i]}"]
            assert law.order == 1.0
            median = np.median(speeds[:, 0] - speeds[:, 1])
            assert law.reference == pytest.approx(1.5 * median)

    @pytest.mark.parametrize(
        ("lower", "upper", "start", "order"),
        [
            (0.0, 3.0, 1.4, 1.0),
            (0.0, 3.0, 1.6, 2.0),
            (1.1, 3.0, 1.4, 2.0),  # the law of order 1 is nearer, but the exponent never reaches it
            (0.0, 1.9, 1.6, 1.0),
            (1.0, 1.9, 1.8, 1.0),
            (1.1, 2.0, 1.2, 2.0),
            (1.1, 1.9, 1.5, None),
        ],
    )
    def test_a_power_law_is_paired_with_the_nearest_order_that_its_exponent_reaches(
        self, equal_records, lower, upper, start, order
    ):
        bounds = Parameter("g", "1", "shape", lower, upper, start)
        law = Effect("own", "bearing", "k*abs(delta)**g*sign(delta)", (Parameter("k", "N m s^g"), bounds))
        layout = ParameterLayout.of(
            Model.of(["bearing.quadratic", "bearing.linear"]).with_effect(law), equal_records[:1]
        )
        speeds = np.stack([np.linspace(300.0, 200.0, 50), np.linspace(10.0, 5.0, 50)], axis=1)
        (found,) = find_power_laws(layout, [(np.arange(50.0), speeds)])
        partner = {None: None, 1.0: "bearing.linear.d", 2.0: "bearing.quadratic.e"}[order]
        assert found.d == (None if partner is None else layout.index[partner])
        assert found.order == (order or 1.0)
        assert (found.f, found.g) == (layout.index["own.k"], layout.index["own.g"])

    def test_two_power_laws_are_not_paired_with_the_same_law(self, equal_records):
        laws = [
            Effect(n, "bearing", "k*abs(delta)**g*sign(delta)",
                (Parameter("k", "N m s^g"), Parameter("g", "1", "shape", 0.0, 3.0, 1.2)))
            for n in ("one", "two")
        ]  # fmt: skip
        layout = ParameterLayout.of(
            Model.of(["bearing.linear"]).with_effect(laws[0]).with_effect(laws[1]), equal_records[:1]
        )
        speeds = np.stack([np.linspace(300.0, 200.0, 50), np.linspace(10.0, 5.0, 50)], axis=1)
        found = find_power_laws(layout, [(np.arange(50.0), speeds)])
        assert [v.d for v in found] == [layout.index["bearing.linear.d"], None]

    @pytest.mark.parametrize(
        ("g", "order", "found"),
        [
            (1.0, 1.0, 1.003),
            (1.002, 1.0, 1.003),
            (0.999, 1.0, 0.997),
            (1.004, 1.0, 1.004),
            (2.5, 2.0, 2.5),
            (1.9999, 2.0, 1.997),
        ],
    )
    def test_an_exponent_keeps_its_distance(self, g, order, found):
        assert _parameters._away_from(g, order) == pytest.approx(found, abs=1e-12)

    @pytest.mark.parametrize("held", ["", "d", "f"])
    @pytest.mark.parametrize("order", [1.0, 2.0])
    def test_transformed_variables_are_torque_and_curvature(self, held, order):
        law = PowerLaw(0, 1, 2, 7.0, order, held)
        theta = np.array([0.4, 0.03, 2.6])
        u = from_physical(theta, [law])
        torque, power = 0.4 * 7.0**order + 0.03 * 7.0**2.6, 0.03 * 7.0**2.6
        expected = {
            "": [torque, (2.6 - order) * power, 2.6],
            "d": [0.4, torque, 2.6],
            "f": [torque, 0.03, 2.6],
        }[held]
        assert u == pytest.approx(expected)
        back, slope = to_physical(u, [law])
        assert back == pytest.approx(theta)
        for i in range(3):
            step = 1e-6 * np.eye(3)[i]
            rise = (to_physical(u + step, [law])[0] - to_physical(u - step, [law])[0]) / 2e-6
            assert slope[:, i] == pytest.approx(rise, rel=1e-5, abs=1e-7)


class TestSinusoids:
    def test_strength_and_phase_are_a_vector(self):
        pair = [Sinusoid(2, 0)]
        theta = np.array([2.0, 9.0, 3.0])
        u = from_polar(theta, pair)
        assert u == pytest.approx([3 * math.sin(2.0), 9.0, 3 * math.cos(2.0)])
        back, slope = to_polar(u, pair)
        assert back == pytest.approx(theta)
        for i in range(3):
            step = 1e-6 * np.eye(3)[i]
            rise = (to_polar(u + step, pair)[0] - to_polar(u - step, pair)[0]) / 2e-6
            assert slope[:, i] == pytest.approx(rise, rel=1e-6, abs=1e-9)

    @pytest.mark.parametrize(
        ("given", "count"),
        [
            ({}, 1),
            ({"per_case": ["casing.unbalance"]}, 2),
            ({"ranges": {"K": (0.0, 1.0)}}, 0),
            ({"ranges": {"K": (1e-9, math.inf)}}, 0),
            ({"ranges": {"P": (-1.0, math.inf)}}, 0),
        ],
    )
    def test_only_unbounded_pairs_are_transformed(self, equal_records, given, count):
        model = Model.of(["casing.unbalance"])
        keys = {p.role: f"casing.unbalance.{p.symbol}" for p in model.effects[0].free}
        assert set(keys) == {"amplitude", "phase"}
        names = {"K": keys["amplitude"], "P": keys["phase"]}
        more = {k: {names[n]: v for n, v in x.items()} if k == "ranges" else x for k, x in given.items()}
        layout = ParameterLayout.of(
            model, equal_records, share=() if "per_case" in given else ["casing.unbalance"], **more
        )
        found = find_sinusoids(layout)
        assert len(found) == count
        for w, label in zip(found, ("glass", "steel"), strict=False):
            at = f"@{label}" if count == 2 else ""
            assert w == Sinusoid(layout.index[names["K"] + at], layout.index[names["P"] + at])
            lower, upper = layout.bounds()
            assert _parameters._ends(w, lower, upper) == [np.inf, -np.inf, np.inf]

    def test_a_pair_of_which_one_is_shared_is_not_transformed(self, equal_records):
        model = Model.of(["casing.unbalance"])
        keys = [f"casing.unbalance.{p.symbol}" for p in model.effects[0].free]
        assert (
            find_sinusoids(ParameterLayout.of(model, equal_records, share=keys[:1], per_case=keys[1:])) == ()
        )


class TestTrace:
    RESULT = SimpleNamespace(deviance=3.0, bic=4.0, converged=True)
    MODEL = AnyModel.of(["casing.air.linear"])

    def fail(self):
        raise RecordError("wrong")

    def test_results_and_failures_are_kept_with_their_purpose(self):
        record_result(self.RESULT)
        with recording() as trace:
            record_result(self.RESULT)
            with attempt("a try"), of_model(self.MODEL):
                record_result(self.RESULT)
                self.fail()
            with with_purpose("more"):
                record_result(self.RESULT)
        kept = [(r.purpose, r.effects, r.deviance, r.bic, r.converged, r.failure) for r in trace.refits]
        names = ("casing.air.linear",)
        assert kept[:2] == [("a fit", (), 3.0, 4.0, True, ""), ("a try", names, 3.0, 4.0, True, "")]
        # the failure is recorded once, although two blocks have seen it
        assert (kept[2][:2], kept[2][4:]) == (("a try", names), (False, "wrong"))
        assert math.isnan(kept[2][2])
        assert kept[3] == ("more", (), 3.0, 4.0, True, "")
        assert len(kept) == 4

    def test_two_failures_are_two_entries(self):
        with recording() as trace:
            for _ in range(2):
                with attempt("a try"):
                    self.fail()
        assert [r.failure for r in trace.refits] == ["wrong", "wrong"]

    def test_another_kind_of_error_is_raised(self):
        with recording() as trace:
            with pytest.raises(RecordError), attempt("a try", EffectError):
                self.fail()
            with pytest.raises(FittingError), with_purpose("more"):
                self.fail()
        assert trace.refits == []

    @pytest.mark.parametrize("passed_on", [True, False])
    def test_an_outer_record_has_the_fits_of_an_inner_one_that_are_passed_on(self, passed_on):
        with recording() as outer:
            with recording(passed_on=passed_on) as inner:
                record_result(self.RESULT)
            record_result(self.RESULT)
        assert len(inner.refits) == 1
        assert len(outer.refits) == 1 + passed_on

    def test_fits_of_workers_are_recorded_in_their_order(self):
        def work(common, item):
            with with_purpose(f"{common} {item}"):
                record_result(self.RESULT)
            return 10 * item

        pool = SimpleNamespace(map=lambda f, common, jobs, shared: [f(common, j) for j in jobs])
        with recording() as trace:
            assert recorded_map(pool, work, "job", [3, 1], lambda c: ()) == [30, 10]
        assert [r.purpose for r in trace.refits] == ["job 3", "job 1"]

    def test_an_entry_names_the_change_of_the_model(self):
        entry = Refit("why", ("a", "b"), 1.0, 2.0, True)
        assert entry.sentence(("b", "c")) == "why (+a -c): deviance 1.0, BIC 2.0"
        assert entry.sentence(("a", "b")) == "why (same model): deviance 1.0, BIC 2.0"
        assert Refit("why", ("a",), 1.0, 2.0).sentence(("a",)).endswith("BIC 2.0, not converged")
        assert Refit("why", ("a",), failure="no").sentence(("a",)).endswith(": failed: no")


@pytest.mark.parametrize(
    ("value", "near"),
    [(2.0, True), (2.0 * (1 + 0.9e-9), True), (2.0 * (1 + 1.2e-9), False), (3.0, False), (5.0 * (1 - 0.9e-9), True),
     (5.0 * (1 - 1.2e-9), False), (1.5, True), (5.5, True)],
)  # fmt: skip
def test_a_variable_is_at_a_bound_within_a_billionth(value, near):
    bounds = np.array([2.0]), np.array([5.0])
    found = ParameterLayout.at_bound(SimpleNamespace(bounds=lambda: bounds), np.array([value]))
    assert found.tolist() == [near]
