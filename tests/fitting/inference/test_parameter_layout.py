import numpy as np
import pytest
from cases import data

from fitting import LINEAR, REDUCED, EffectError, Input, Model, Record, effect, make_record
from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR
from fitting.effects._expression import Tape
from fitting.effects._user import resolve
from fitting.inference import _parameters
from fitting.inference._parameters import ParameterLayout, is_power_law
from fitting.inference._ties import chain, follow, parse_tie


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
