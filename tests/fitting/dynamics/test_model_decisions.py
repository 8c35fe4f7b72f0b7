"""Rates and derivatives of the equations of motion, written a second time by hand for each kind of effect."""

import math

import numpy as np
import pytest

from fitting import EffectError, EstimationError, Input, Model
from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR, Dynamics, read_model
from fitting.effects._expression import Tape
from fitting.effects._library import find
from fitting.effects._mechanism import GYROSCOPE, Mechanism
from fitting.effects._user import resolve

I_R, I_C = 3.0, 2.0
INERTIAS = {INERTIA_ROTOR: I_R, INERTIA_CASING: I_C}
Y = np.array([[9.0, 4.0], [5.0, -2.0], [1.0, 3.0]])
TIMES = np.array([0.0, 1.0, 2.0])


def key(name, symbol=None):
    effect = find(name)
    return f"{name}.{symbol or effect.parameters[0].symbol}"


def numbers(**values):
    return INERTIAS | {k.replace("__", "."): v for k, v in values.items()}


def checked(dynamics, y, values, sense=None):
    """Compare the derivatives of the rates with central differences; return the rates."""
    t = np.linspace(0.3, 0.7, len(y))
    f, a, b = dynamics.linearised(t, y, values, sense)
    assert dynamics.rates(t, y, values, sense) == pytest.approx(f)
    tangent = dynamics.tangent(t, y, values, sense)
    assert tangent[0] == pytest.approx(f)
    assert tangent[1] == pytest.approx(a)
    sense = np.sign(y[:, 1]) if sense is None else sense
    for j in range(y.shape[1]):
        step = 1e-6 * np.eye(y.shape[1])[j]
        rise = (
            dynamics.rates(t, y + step, values, sense) - dynamics.rates(t, y - step, values, sense)
        ) / 2e-6
        assert a[..., j] == pytest.approx(rise, rel=1e-5, abs=1e-6)
    for j, name in enumerate(dynamics.parameters):
        up, down = values | {name: values[name] + 1e-6}, values | {name: values[name] - 1e-6}
        rise = (dynamics.rates(t, y, up, sense) - dynamics.rates(t, y, down, sense)) / 2e-6
        assert b[..., j] == pytest.approx(rise, rel=1e-5, abs=1e-6)
    return f


class TestRates:
    def test_joint_and_body_torques_accelerate_by_the_inertia(self):
        model = Model.of(["bearing.linear", "casing.air.linear", "rotor.air.quadratic"])
        d, b2, a2 = 0.5, 0.7, 0.2
        values = INERTIAS | {"bearing.linear.d": d, "casing.air.linear.b2": b2, "rotor.air.quadratic.a2": a2}
        f = checked(Dynamics(model), Y, values)
        wr, wc = Y.T
        assert f[:, 0] == pytest.approx((-d * (wr - wc) - a2 * wr**2) / I_R)
        assert f[:, 1] == pytest.approx((d * (wr - wc) - b2 * wc) / I_C)

    def test_dry_friction_holds_a_casing_at_rest(self):
        model = Model.of(["touchpoint.constant", "bearing.linear"])
        values = INERTIAS | {"touchpoint.constant.b1": 0.6, "bearing.linear.d": 0.5}
        dynamics = Dynamics(model)
        assert dynamics.dry
        assert not Dynamics(Model.of(["bearing.linear"])).dry
        sense = np.array([1.0, -1.0, 0.0])
        f = checked(dynamics, Y, values, sense)
        wr, wc = Y.T
        assert f[:, 1] == pytest.approx(np.abs(sense) * (0.5 * (wr - wc) - 0.6 * sense) / I_C)
        assert f[:, 0] == pytest.approx(-0.5 * (wr - wc) / I_R)
        # without a given sense, it is that of the speed
        assert dynamics.rates(TIMES, Y, values)[:, 1] == pytest.approx(
            (0.5 * (wr - wc) - 0.6 * np.sign(wc)) / I_C
        )

    def test_a_factor_multiplies_the_torque_of_the_joint(self):
        model = Model.of(["bearing.linear", "bearing.drift", "casing.air.linear"])
        values = INERTIAS | {"bearing.linear.d": 0.5, "bearing.drift.k": 0.3, "casing.air.linear.b2": 0.7}
        dynamics = Dynamics(model)
        checked(dynamics, Y, values)
        f = dynamics.rates(TIMES, Y, values)
        wr, wc = Y.T
        tau = 0.5 * (wr - wc) * (1 + 0.3 * TIMES)
        assert f[:, 0] == pytest.approx(-tau / I_R)
        assert f[:, 1] == pytest.approx((tau - 0.7 * wc) / I_C)

    def test_a_wrong_inertia_scales_all_torques_on_the_casing(self):
        model = Model.of(["bearing.linear", "casing.air.linear", "setup.inertia"])
        values = INERTIAS | {"bearing.linear.d": 0.5, "casing.air.linear.b2": 0.7, "setup.inertia.eps": 0.25}
        f = checked(Dynamics(model), Y, values)
        wr, wc = Y.T
        assert f[:, 1] == pytest.approx((0.5 * (wr - wc) - 0.7 * wc) / (1.25 * I_C))
        assert f[:, 0] == pytest.approx(-0.5 * (wr - wc) / I_R)

    def test_sliding_contact_drives_both_bodies_by_the_slip(self):
        model = Model.of(["contact.sliding", "casing.air.linear"])
        symbols = {p.symbol for p in find("contact.sliding").parameters}
        values = INERTIAS | {"casing.air.linear.b2": 0.7}
        values |= {f"contact.sliding.{s}": {"n": 2.5, "k": 0.4, "w": 3.0}.get(s, 1.0) for s in symbols}
        f = checked(Dynamics(model), Y, values)
        wr, wc = Y.T
        torque = -0.4 * np.tanh((wr - 2.5 * wc) / 3.0)
        assert f[:, 0] == pytest.approx(torque / I_R)
        assert f[:, 1] == pytest.approx((-0.7 * wc - 2.5 * torque) / I_C)

    def test_without_slip_the_bodies_move_as_one(self):
        """In the ratio n, the torque on the casing accelerates I_c + n^2 I_r; the slip decays with the time T."""
        model = Model.of(["contact.rolling", "casing.air.linear"])
        dynamics = Dynamics(model)
        n = 2.5
        values = INERTIAS | model.constants | {"casing.air.linear.b2": 0.7, "contact.rolling.n": n}
        values |= {"contact.rolling.c": 0.0}
        assert (dynamics.ratio, dynamics.relaxation) == ("contact.rolling.n", "contact.rolling.T")
        y = np.array([[n * 4.0, 4.0], [n * 2.0, 2.0]])
        f = dynamics.rates(np.zeros(2), y, values)
        expected = -0.7 * y[:, 1] / (I_C + n**2 * I_R)
        assert f[:, 1] == pytest.approx(expected)
        assert f[:, 0] == pytest.approx(n * expected)
        matrix = dynamics.constraint(values)
        free = np.array([1.5 / I_R, 0.4 / I_C])
        whole = (0.4 + n * 1.5) / (I_C + n**2 * I_R)
        assert matrix @ free == pytest.approx([n * whole, whole])
        assert Dynamics(Model.of(["casing.air.linear"])).constraint(INERTIAS) is None
        relaxed = dynamics.rates(np.zeros(2), y + np.array([[0.1, 0.0], [0.0, 0.0]]), values)[0] - f[0]
        slip_rate = relaxed[0] - n * relaxed[1]
        assert slip_rate == pytest.approx(-0.1 / values["contact.rolling.T"], rel=1e-3)

    def test_dry_friction_holds_both_of_two_bodies_without_slip(self):
        model = Model.of(["contact.rolling", "casing.air.linear", "touchpoint.constant"])
        dynamics = Dynamics(model)
        values = INERTIAS | model.constants | {"casing.air.linear.b2": 0.7, "touchpoint.constant.b1": 0.2}
        values |= {"contact.rolling.n": 2.5, "contact.rolling.c": 0.0}
        y = np.array([[10.0, 4.0], [5.0, 2.0]])
        moving = np.array([0.0, 1.0])
        f, a, b = dynamics.linearised(np.zeros(2), y, values, moving)
        for found in (f, a, b):
            assert not found[0].any()
            assert (np.abs(found[1]).reshape(2, -1).max(axis=1) > 0).all()
        assert dynamics.rates(np.zeros(2), y, values, moving) == pytest.approx(f)
        assert dynamics.tangent(np.zeros(2), y, values, moving)[1] == pytest.approx(a)

    def test_a_spring_follows_the_deflection(self):
        model = Model.of(["casing.spring.linear", "bearing.linear"])
        (strength,) = (k for k in model.free if k.startswith("casing.spring"))
        dynamics = Dynamics(model)
        assert dynamics.states == ("omega_r", "omega_c", "deflection")
        assert dynamics.free_starts == 3
        y = np.array([[9.0, 4.0, 0.3], [5.0, -2.0, -0.2]])
        values = INERTIAS | {strength: 1.7, "bearing.linear.d": 0.5}
        f = checked(dynamics, y, values)
        assert f[:, 1] == pytest.approx((0.5 * (y[:, 0] - y[:, 1]) - 1.7 * y[:, 2]) / I_C)
        assert f[:, 2] == pytest.approx(y[:, 1])

    def test_a_temperature_follows_the_power_of_the_bearing(self):
        model = Model.of(["bearing.linear", "bearing.heating"])
        dynamics = Dynamics(model)
        y = np.concatenate([Y, [[0.1], [0.2], [0.3]]], axis=1)
        values = INERTIAS | model.constants | dict.fromkeys(model.free, 0.3) | {"bearing.linear.d": 0.5}
        f = checked(dynamics, y, values)
        tau = 0.5 * (y[:, 0] - y[:, 1]) * np.exp(-0.3 * y[:, 2])
        assert f[:, 0] == pytest.approx(-tau / I_R)
        assert dynamics.start == (find("bearing.heating").state.start,)

    def test_angles_are_integrals_of_the_speeds(self):
        model = Model.of(["casing.unbalance", "bearing.linear"])
        dynamics = Dynamics(model, angles=True)
        assert dynamics.states == ("omega_r", "omega_c", "psi_r", "psi_c")
        y = np.concatenate([Y, [[0.1, 0.7], [0.2, 1.9], [0.3, 2.5]]], axis=1)
        values = INERTIAS | {"casing.unbalance.k": 0.4, "casing.unbalance.phi": 0.3, "bearing.linear.d": 0.5}
        f = checked(dynamics, y, values)
        assert f[:, 2:] == pytest.approx(Y)
        law = Tape([find("casing.unbalance").expression])({"k": 0.4, "phi": 0.3, "psi_c": y[:, 3]})[0]
        assert f[:, 1] == pytest.approx((0.5 * (y[:, 0] - y[:, 1]) + law) / I_C)

    def test_a_chain_has_the_torques_of_all_its_joints(self):
        chain = Mechanism.of(
            ("wheel", "motor", "pump"), {"belt": ("motor", "wheel"), "shaft": ("wheel", "pump")}
        )
        model = Model.of(["bearing.linear", "casing.air.linear"], chain)
        assert set(model.free) == {"belt.linear.d", "shaft.linear.d", "wheel.air.linear.b2"}
        values = {"inertia.motor": 2.0, "inertia.wheel": 3.0, "inertia.pump": 5.0}
        values |= {"belt.linear.d": 0.5, "shaft.linear.d": 0.2, "wheel.air.linear.b2": 0.7}
        y = np.array([[9.0, 4.0, 1.0], [5.0, 2.0, 7.0]])
        f = checked(Dynamics(model), y, values)
        belt, shaft = 0.5 * (y[:, 0] - y[:, 1]), 0.2 * (y[:, 1] - y[:, 2])
        assert f[:, 0] == pytest.approx(-belt / 2.0)
        assert f[:, 1] == pytest.approx((belt - shaft - 0.7 * y[:, 1]) / 3.0)
        assert f[:, 2] == pytest.approx(shaft / 5.0)
        with pytest.raises(EstimationError):
            model.refuse_chain("a plan", "do this")
        Model.of(["bearing.linear"]).refuse_chain("a plan", "do this")


class TestInputs:
    U = Input("u", np.array([0.0, 1.0, 3.0]), np.array([0.0, 2.0, -2.0]), "A")

    def made(self, *laws):
        effects = [resolve(law, {"u": "A"}) for law in laws]
        return Dynamics(Model(tuple(effects)), inputs=[self.U, Input("other", [0.0, 1.0], [0.0, 1.0])])

    def test_an_input_drives_its_body_at_each_time(self):
        dynamics = self.made("casing: k*u", "casing: -c*omega_c")
        values = INERTIAS | {"casing: k*u.k": 0.3, "casing: -c*omega_c.c": 0.7}
        t = np.array([0.5, 2.0, 4.0])
        assert [i.name for i in dynamics.inputs] == ["u"]
        f = dynamics.rates(t, Y, values)
        assert f[:, 1] == pytest.approx((0.3 * np.array([1.0, 0.0, -2.0]) - 0.7 * Y[:, 1]) / I_C)
        by = dynamics.by_input(self.U, t, Y, values)
        assert by == pytest.approx(np.tile([0.0, 0.3 / I_C], (3, 1)))
        assert dynamics.changes(0.0, 9.0, values) == (1.0, 3.0)
        assert dynamics.changes(1.0, 3.0, values) == ()
        decay, slopes = dynamics.first_order
        assert Tape([decay, slopes["u"]])(values) == pytest.approx([0.7 / I_C, 0.3 / I_C])

    @pytest.mark.parametrize(
        ("laws", "linear"),
        [
            (("casing: k*u", "casing: -c*omega_c"), True),
            (("casing: k*u", "casing: -c*omega_c", "casing: -b*sign(omega_c)"), True),
            (("casing: k*u",), False),
            (("casing: -c*omega_c",), False),
            (("casing: k*u", "casing: -c*omega_c**3"), False),
            (("casing: k*u*omega_c", "casing: -c*omega_c"), False),
            (("casing: k*u**2", "casing: -c*omega_c"), False),
            (("casing: k*u*t", "casing: -c*omega_c"), False),
            (("casing: k*u", "casing: -c*omega_c", "bearing: d*delta"), False),
        ],
    )
    def test_a_response_is_of_first_order_if_it_is_linear_and_alone(self, laws, linear):
        assert (self.made(*laws).first_order is not None) is linear

    @pytest.mark.parametrize("held", [False, True])
    def test_a_dead_time_shifts_the_input(self, held):
        law = resolve("casing: k*u", {"u": "A"})
        delay = resolve("input.u.delay", {"u": "A"})
        u = Input("u", self.U.time, self.U.value, "A", interpolation="hold" if held else "linear")
        dynamics = Dynamics(Model((law, delay)), inputs=[u])
        name = f"{delay.name}.{delay.parameters[0].symbol}"
        values = INERTIAS | {"casing: k*u.k": 0.3, name: 0.25}
        t = np.array([0.75, 1.25, 3.25])
        assert dynamics.rates(t, Y, values)[:, 1] == pytest.approx(0.3 * u(t - 0.25) / I_C)
        assert dynamics.changes(0.0, 9.0, values) == ((1.25, 3.25) if held else (0.25, 1.25, 3.25))
        breaks = dynamics.moving_breaks(0.0, 9.0, values)
        assert breaks == ({name: [1.25, 3.25]} if held else {})
        edges = np.array([0.5, 1.0, 1.5, 4.0])
        slope = np.diff(u(edges - 0.25)) / np.diff(edges)
        found = dynamics.by_delay("u", t, edges, Y, values)
        assert found[:, 1] == pytest.approx(-0.3 / I_C * slope)
        assert (found[:, 0] == 0).all()
        if not held:
            _, _, b = dynamics.linearised(np.array([0.75, 2.0, 4.0]), Y, values)
            column = b[:, 1, dynamics.parameters.index(name)]
            assert column == pytest.approx(-0.3 / I_C * np.array([2.0, -2.0, 0.0]))


class TestModel:
    def test_a_model_of_other_bodies_keeps_the_laws_between_them(self):
        model = Model.of(["bearing.linear", "casing.air.linear", "rotor.air.linear"])
        assert model.of_bodies({"casing"}).names == ("casing.air.linear",)
        assert model.of_bodies({"casing", "rotor"}) == model
        assert (model - "bearing.linear").names == ("casing.air.linear", "rotor.air.linear")
        assert (model - "bearing.linear" + "bearing.linear").names[-1] == "bearing.linear"

    def test_a_held_parameter_is_named_by_key_or_symbol(self):
        model = Model.of(["bearing.power", "casing.air.linear"])
        held = model.with_fixed({"g": 1.2})
        assert held.constants == {"bearing.power.g": 1.2}
        assert held.free == ("bearing.power.f", "casing.air.linear.b2")
        assert model.with_fixed({"casing.air.linear.b2": 2}).constants == {"casing.air.linear.b2": 2.0}
        for wrong in ({"q": 1.0}, {"bearing.power": 1.0}, {"g": math.inf}):
            with pytest.raises(EffectError):
                model.with_fixed(wrong)
        twice = Model.of(["casing.unbalance", "casing.asymmetry"])
        with pytest.raises(EffectError, match="several"):
            twice.with_fixed({"k": 1.0})

    def test_without_a_spring_the_angle_is_not_a_state(self):
        model = Model.of(["casing.unbalance", "casing.air.linear", "camera.clock"])
        assert [e.name for e in model.angle_dependent] == ["casing.unbalance"]
        assert model.smooth.names == ("casing.air.linear",)
        assert not model.restoring
        assert [e.name for e in model.measurement] == ["camera.clock"]
        swinging = Model.of(["casing.spring.linear", "casing.air.linear"])
        assert swinging.restoring
        assert swinging.angle_dependent == ()
        assert swinging.rigid_contact is None
        assert Model.of(["contact.rolling"]).rigid_contact.name == "contact.rolling"
        assert Model.of(["contact.sliding"]).rigid_contact is None

    def test_a_changepoint_is_a_moving_break_if_it_is_free(self):
        model = Model.of(["touchpoint.step", "casing.air.linear"])
        values = INERTIAS | dict.fromkeys(model.free, 3.0)
        assert Dynamics(model).moving_breaks(0.0, 9.0, values) == {"touchpoint.step.t0": [3.0]}
        assert Dynamics(model.with_fixed({"t0": 3.0})).moving_breaks(0.0, 9.0, values) == {}

    def test_a_model_is_read_with_laws_of_the_file(self, tmp_path):
        path = tmp_path / "m.toml"
        path.write_text('effects = ["casing.air.linear", "casing: -q*omega_c**3"]\n')
        assert read_model(path).names == ("casing.air.linear", "casing: -q*omega_c**3")
        own = resolve("casing: -z*omega_c**5")
        path.write_text(f'effects = ["{own.name}"]\n')
        assert read_model(path, [own]).effects[0] is own
        for text in (
            "effects = []\n",
            'effects = "casing.air.linear"\n',
            "effects = [1]\n",
            'effects = [1, "casing.air.linear"]\n',
        ):
            path.write_text(text)
            with pytest.raises(EffectError):
                read_model(path)
        assert read_model.__defaults__[-1] is GYROSCOPE

    def test_equations_contain_each_torque_once_per_body(self):
        model = Model.of(["bearing.linear", "casing.air.linear", "rotor.air.linear"])
        rotor, casing, joint = model.equations()
        assert rotor.startswith(r"I_r \dot\omega_r = -\tau_{cr} -")
        assert casing.startswith(r"I_c \dot\omega_c = \tau_{cr} -")
        assert joint.startswith(r"\tau_{cr} = ")
        (single,) = model.of_bodies({"casing"}).equations({"casing"})
        assert single.startswith(r"I_c \dot\omega_c = -")
        idle = Model.of(["casing.air.linear"]).equations()
        assert idle[0] == r"I_r \dot\omega_r = -\tau_{cr}"
        assert idle[2] == r"\tau_{cr} = 0"
