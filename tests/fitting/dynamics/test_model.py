import numpy as np
import pytest

from fitting import LIBRARY, REDUCED, EffectError, Model
from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR, Dynamics
from fitting.effects._library import find
from fitting.effects._user import resolve


def test_a_model_is_its_effects():
    model = Model.of(REDUCED)
    assert model.names == REDUCED
    bigger = model.with_effect(find("bearing.heating"))
    assert bigger.names == (*REDUCED, "bearing.heating")
    assert bigger.without("bearing.heating") == model
    assert model == Model.of(REDUCED)


def test_an_effect_is_in_a_model_once():
    with pytest.raises(EffectError, match="twice"):
        Model.of(["bearing.linear", "bearing.linear"])
    with pytest.raises(EffectError, match="twice"):
        Model.of(REDUCED).with_effect(find("bearing.power"))
    with pytest.raises(EffectError, match="is not in the model") as caught:
        Model.of(REDUCED).without("bearing.heating")
    assert "bearing.linear" in caught.value.hint


def test_parameters_by_key():
    model = Model.of((*REDUCED, "bearing.heating", "camera.clock"))
    assert model.parameters["bearing.power.g"].upper == 1.4
    assert "bearing.heating.C" not in model.free
    assert model.constants == {"bearing.heating.C": 1.0}
    assert model.smooth.names == (*REDUCED, "bearing.heating")
    assert [e.name for e in model.measurement] == ["camera.clock"]
    assert [e.name for e in Model.of(["casing.unbalance", "casing.precession"]).angle_dependent] == [
        "casing.unbalance"
    ]


def test_states_and_parameters_of_the_dynamics():
    dynamics = Dynamics(
        Model.of(("bearing.linear", "bearing.heating", "casing.precession", "touchpoint.step"))
    )
    assert dynamics.states == ("omega_r", "omega_c", "temperature", "chirp")
    assert dynamics.breakpoints == ("touchpoint.step.t0",)
    assert "camera.clock.eps" not in dynamics.parameters
    assert Dynamics(Model.of(["bearing.linear"]), angles=True).states[-2:] == ("psi_r", "psi_c")


def test_user_laws_are_part_of_the_model():
    model = Model((find("bearing.linear"), resolve("casing: -q*omega_c**3")))
    key = "casing: -q*omega_c**3.q"
    assert model.free == ("bearing.linear.d", key)
    numbers = {"bearing.linear.d": 0.0, key: 2.0, INERTIA_ROTOR: 1.0, INERTIA_CASING: 4.0}
    rate = Dynamics(model).rates(np.zeros(1), np.array([[900.0, 3.0]]), numbers)
    np.testing.assert_allclose(rate, [[0.0, -2.0 * 27 / 4]])


def test_effects_with_the_same_symbol_do_not_mix():
    twins = [
        n for n, e in LIBRARY.items() if any(p.symbol == "k" for p in e.parameters) and e.joint == "casing"
    ]
    model = Model.of(twins[:6])
    dynamics = Dynamics(model)
    numbers = {k: 0.0 if k.endswith(".k") else 1.0 for k in dynamics.parameters}
    numbers |= {INERTIA_ROTOR: 1.0, INERTIA_CASING: 1.0}
    y = np.array([[500.0, 40.0, *([0.0] * (len(dynamics.states) - 2))]])
    assert dynamics.rates(np.ones(1), y, numbers)[0, 1] == 0
    one = {f"{twins[0]}.k": 1.0}
    alone = Dynamics(Model.of(twins[:1])).rates(np.ones(1), y[:, :2], numbers | one)
    assert dynamics.rates(np.ones(1), y, numbers | one)[0, 1] == alone[0, 1] != 0


def test_held_parameters_are_constants():
    model = Model.of(REDUCED).with_fixed({"g": 0.7, "touchpoint.constant.b1": 3e-6})
    assert model.constants == {"bearing.power.g": 0.7, "touchpoint.constant.b1": 3e-6}
    assert not {"bearing.power.g", "touchpoint.constant.b1"} & set(model.free)
    assert Model.of(REDUCED).with_fixed({}) == Model.of(REDUCED)


@pytest.mark.parametrize(
    ("held", "message"),
    [({"q": 1.0}, "no parameter"), ({"g": float("nan")}, "cannot be held"), ({"k": 1.0}, "several")],
)
def test_invalid_held_parameters_are_refused(held, message):
    model = Model.of((*REDUCED, "casing.air.quadratic", "casing.windage"))
    with pytest.raises(EffectError, match=message):
        model.with_fixed(held)
