import numpy as np
import pytest
from cases import data
from hypothesis import assume, given
from hypothesis import strategies as st

from fitting import REDUCED, Model, Record
from fitting.effects._user import resolve
from fitting.inference._parameters import (
    ParameterLayout,
    PowerLaw,
    find_power_laws,
    from_physical,
    to_physical,
)

VALLEYS = (PowerLaw(1, 3, 2, 400.0),)
SQUARE = (PowerLaw(1, 3, 2, 90.0, 2.0),)


@given(st.floats(1e-9, 1e-6), st.floats(1e-10, 1e-6), st.floats(0.3, 1.4))
def test_there_and_back(d, f, g):
    assume(abs(g - 1) > 0.01)
    theta = np.array([7.0, d, g, f, -3.0])
    back, _ = to_physical(from_physical(theta, VALLEYS), VALLEYS)
    np.testing.assert_allclose(back, theta, rtol=1e-6, atol=1e-13)


@given(st.floats(0.3, 1.4), st.floats(-1e-4, 1e-4), st.floats(1e-6, 2e-4), st.floats(10, 900))
def test_torque_is_the_one_of_the_formula(g, curvature, at_reference, speed):
    """T1 x + K (x^g - x)/(g - 1) with x = D / 400, and its limit T1 x + K x log x at g = 1."""
    u = np.array([0.0, at_reference, g, curvature, 0.0])
    theta, _ = to_physical(u, VALLEYS)
    torque = theta[1] * speed + theta[3] * speed ** theta[2]
    x = speed / 400.0
    bend = np.expm1((g - 1) * np.log(x)) / (g - 1) if g != 1 else np.log(x)
    # closer to 1 than 0.003 the exponent is held there
    assert torque == pytest.approx(
        at_reference * x + curvature * x * bend, rel=1e-6, abs=2.5e-2 * abs(curvature)
    )


@pytest.mark.parametrize("power_laws", [VALLEYS, SQUARE])
@pytest.mark.parametrize("g", [0.3, 0.7, 0.99, 1.01, 1.2, 1.4, 1.97])
def test_slopes_match_differences(g, power_laws):
    u = np.array([2.0, 1e-4, g, 2e-5, 5.0])
    _, slope = to_physical(u, power_laws)
    for i in range(5):
        step = np.zeros(5)
        step[i] = 1e-6 * max(abs(u[i]), 1e-4)
        rise = (to_physical(u + step, power_laws)[0] - to_physical(u - step, power_laws)[0]) / (2 * step[i])
        np.testing.assert_allclose(slope[:, i], rise, rtol=1e-5, atol=1e-9 * np.abs(slope[:, i]).max())


@pytest.mark.parametrize(("g", "kept"), [(1.002, 1.003), (0.998, 0.997), (1.004, 1.004), (0.996, 0.996)])
def test_an_exponent_keeps_a_distance_of_3e_3_from_that_of_the_other_law(g, kept):
    theta, _ = to_physical(np.array([0.0, 1e-4, g, 2e-5, 0.0]), VALLEYS)
    assert theta[2] == pytest.approx(kept, abs=1e-9)
    assert from_physical(np.array([0.0, 1e-7, g, 1e-7, 0.0]), VALLEYS)[2] == pytest.approx(kept, abs=1e-9)


ALONE = (PowerLaw(None, 3, 2, 400.0),)


@given(st.floats(1e-10, 1e-6), st.floats(0.3, 1.4))
def test_a_power_law_alone_there_and_back(f, g):
    theta = np.array([7.0, 1.0, g, f, -3.0])
    u = from_physical(theta, ALONE)
    assert u[3] == pytest.approx(f * 400.0**g)
    back, slope = to_physical(u, ALONE)
    np.testing.assert_allclose(back, theta, rtol=1e-12)
    for i in (2, 3):
        step = np.zeros(5)
        step[i] = 1e-6 * u[i]
        rise = (to_physical(u + step, ALONE)[0] - to_physical(u - step, ALONE)[0]) / (2 * step[i])
        np.testing.assert_allclose(slope[:, i], rise, rtol=1e-5)


def test_without_power_laws_variables_are_not_transformed():
    theta = np.array([1.0, 2.0])
    np.testing.assert_array_equal(from_physical(theta, ()), theta)
    same, slope = to_physical(theta, ())
    np.testing.assert_array_equal(same, theta)
    np.testing.assert_array_equal(slope, np.eye(2))


def layout_of(*laws, per_case=(), cases=1):
    one = data(seed=0).record
    records = [Record(f"case{i}", 5e-5, 2e-5, one.casing, one.rotor) for i in range(cases)]
    model = Model.of(REDUCED)
    for law in laws:
        model = model.with_effect(resolve(law))
    return ParameterLayout.of(model, records, per_case=per_case)


def found(layout):
    rough = [data(seed=0).initial_speeds] * len(layout.records)
    names = layout.names
    return {(names[v.d], names[v.f], names[v.g]): v for v in find_power_laws(layout, rough)}


BEARING = ("bearing.linear.d", "bearing.power.f", "bearing.power.g")


def test_the_pair_of_bearing_laws_has_a_typical_reference_speed():
    (v,) = found(layout_of()).values()
    _, speeds = data(seed=0).initial_speeds
    assert found(layout_of()).keys() == {BEARING}
    assert v.order == 1.0
    assert v.reference == pytest.approx(np.median(speeds[:, 0] - speeds[:, 1]))


@pytest.mark.parametrize(
    ("law", "partner", "order"),
    [
        ("casing: -k*abs(omega_c)**n*sign(omega_c)", "casing.air.linear.b2", 1.0),
        ("casing: -k*omega_c*abs(omega_c)**n", "casing.air.linear.b2", 0.0),
        ("rotor: -k*abs(omega_r)**n*sign(omega_r)", "rotor.air.quadratic.a2", 2.0),
    ],
)
def test_a_user_power_law_is_paired_with_the_law_of_fixed_power(law, partner, order):
    pairs = found(layout_of(law))
    (mine,) = [(k, v) for k, v in pairs.items() if k != BEARING]
    assert mine[0] == (partner, f"{law}.k", f"{law}.n")
    assert mine[1].order == order


@pytest.mark.parametrize(
    "law", ["casing: -k*omega_c**3", "casing: -k*exp(-abs(omega_c)/w)", "casing: k*tanh(n*omega_r)*omega_c"]
)
def test_other_laws_have_no_pair(law):
    assert found(layout_of(law)).keys() == {BEARING}


def test_pairs_have_variables_of_each_case():
    assert found(layout_of(per_case=["g"], cases=2)) == {}
    assert found(layout_of(per_case=["f", "g"], cases=2)) == {}
    linear = found(layout_of(per_case=["d"], cases=2))
    assert [k[0] for k in linear] == ["bearing.linear.d@case0", "bearing.linear.d@case1"]
    assert {k[1:] for k in linear} == {BEARING[1:]}
    whole = found(layout_of(per_case=["d", "f", "g"], cases=2))
    assert [k for v in whole for k in v] == [f"{k}@case{i}" for i in (0, 1) for k in BEARING]
