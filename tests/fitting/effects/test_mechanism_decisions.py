"""Bodies and joints of a mechanism, and the laws of the library written for them."""

import numpy as np
import pytest

from fitting import LIBRARY, EffectError
from fitting.effects._instances import counterparts, find_law, in_words, law_of_main, laws_of
from fitting.effects._mechanism import GYROSCOPE, Coupling, Mechanism, renamed

CHAIN = Mechanism.of(("wheel", "motor", "pump"), {"belt": ("motor", "wheel"), "shaft": ("wheel", "pump")})


class TestMechanism:
    def test_the_main_body_is_the_second_of_the_state(self):
        assert CHAIN.bodies == ("motor", "wheel", "pump")
        assert (CHAIN.main, CHAIN.main_angle) == ("wheel", "psi_wheel")
        assert CHAIN.speeds == ("omega_motor", "omega_wheel", "omega_pump")
        assert CHAIN.inertias == ("inertia.motor", "inertia.wheel", "inertia.pump")
        assert (GYROSCOPE.main, GYROSCOPE.speeds) == ("casing", ("omega_r", "omega_c"))
        assert [s for s, _ in CHAIN.sites] == ["wheel", "motor", "pump", "belt", "shaft"]
        assert dict(CHAIN.sites)["belt"] == "delta_belt"
        assert dict(GYROSCOPE.sites) == {"casing": "omega_c", "rotor": "omega_r", "bearing": "delta"}

    def test_joints_are_counted_by_body(self):
        assert [CHAIN.joints_of(b) for b in ("motor", "wheel", "pump", "other")] == [1, 2, 1, 0]
        assert set(CHAIN.joints) == {"belt", "shaft"}

    def test_a_joint_brakes_its_first_body_and_drives_the_second(self):
        assert CHAIN.shares("belt") == (-1.0, 1.0, 0.0)
        assert CHAIN.shares("shaft") == (0.0, -1.0, 1.0)
        assert CHAIN.shares("pump") == (0.0, 0.0, 1.0)
        assert GYROSCOPE.shares("bearing") == (-1.0, 1.0)
        assert GYROSCOPE.shares("casing") == (0.0, 1.0)

    def test_the_speed_of_a_joint_is_that_of_the_first_body_less_the_second(self):
        motion = CHAIN.motion([np.array([5.0]), np.array([2.0]), np.array([0.5])])
        assert {k: float(v[0]) for k, v in motion.items()} == {
            "omega_motor": 5.0, "omega_wheel": 2.0, "omega_pump": 0.5, "delta_belt": 3.0, "delta_shaft": 1.5,
        }  # fmt: skip
        assert float(GYROSCOPE.motion([np.array([9.0]), np.array([4.0])])["delta"][0]) == 5.0

    def test_symbols_have_units_and_bodies(self):
        units = CHAIN.variables
        assert (units["omega_pump"], units["delta_belt"], units["psi_motor"]) == ("s-1", "s-1", "1")
        assert (units["tau_shaft"], GYROSCOPE.variables["tau"]) == ("N m", "N m")
        bodies = CHAIN.bodies_by_symbol
        assert bodies["psi_pump"] == bodies["pump"] == bodies["omega_pump"] == {"pump"}
        assert bodies["tau_belt"] == bodies["belt"] == bodies["delta_belt"] == {"motor", "wheel"}

    def test_short_names_are_those_of_the_site(self):
        assert CHAIN.short_names("pump") == {"omega": "omega_pump", "psi": "psi_pump"}
        assert CHAIN.short_names("belt") == {"delta": "delta_belt"}
        assert GYROSCOPE.short_names("casing") == {}

    def test_only_whole_symbols_are_renamed(self):
        assert renamed("a*ab + b2*sin(a)", {"a": "x", "b2": "a"}) == "x*ab + a*sin(x)"


class TestLaws:
    LAWS = laws_of(CHAIN)

    def test_each_body_and_joint_has_its_laws(self):
        drag = {n for n in self.LAWS if n.endswith(".air.quadratic")}
        assert drag == {"wheel.air.quadratic", "motor.air.quadratic", "pump.air.quadratic"}
        assert {n for n in self.LAWS if n.endswith("belt.linear")} == {"belt.linear"}
        for name, effect in self.LAWS.items():
            assert effect.name == name
            assert effect.mechanism == CHAIN
            assert effect.place == name.split(".")[0]
            assert not effect.restoring
            assert set(effect.equivalent) | set(effect.confused_with) <= set(self.LAWS)
        assert laws_of(GYROSCOPE) is LIBRARY

    def test_laws_of_the_angle_are_those_of_the_main_body(self):
        of_angle = {e.place for e in self.LAWS.values() if e.depends_on_angle}
        assert of_angle == {"wheel"}

    def test_a_law_is_written_with_the_symbols_of_its_place(self):
        assert self.LAWS["pump.support.constant"].law == LIBRARY["touchpoint.constant"].law.replace(
            "omega_c", "omega_pump"
        )
        assert self.LAWS["belt.linear"].law == LIBRARY["bearing.linear"].law.replace("delta", "delta_belt")
        assert self.LAWS["pump.air.linear"].pattern == "casing.air.linear"
        with_state = next(e for e in self.LAWS.values() if e.place == "pump" and e.state is not None)
        assert with_state.state.symbol.endswith("_pump")
        assert "omega_c" not in with_state.state.rate

    def test_a_law_of_the_main_body_is_found_by_its_pattern(self):
        assert law_of_main("casing.air.linear", CHAIN).name == "wheel.air.linear"
        assert law_of_main("touchpoint.constant", CHAIN).name == "wheel.support.constant"
        assert law_of_main("touchpoint.constant", GYROSCOPE) is LIBRARY["touchpoint.constant"]

    @pytest.mark.parametrize(
        ("name", "found"),
        [
            ("casing.air.linear", ["wheel.air.linear"]),
            ("rotor.air.linear", ["motor.air.linear", "pump.air.linear"]),
            ("bearing.linear", ["belt.linear", "shaft.linear"]),
            ("touchpoint.constant", ["wheel.support.constant"]),
        ],
    )
    def test_roles_of_a_gyroscope_correspond_to_bodies(self, name, found):
        assert [e.name for e in counterparts(name, CHAIN)] == found
        assert [e.name for e in counterparts(name, GYROSCOPE)] == [name]

    def test_an_unknown_law_is_refused(self):
        assert find_law("pump.air.linear", CHAIN).site == "pump"
        assert find_law("casing.air.linear", GYROSCOPE).name == "casing.air.linear"
        for name, mechanism in (("casing.air.linear", CHAIN), ("pump.air.linear", GYROSCOPE)):
            with pytest.raises(EffectError):
                find_law(name, mechanism)

    def test_words_name_the_place(self):
        assert (
            in_words("friction at the touch point of the casing", "pump")
            == "friction of the pump's support of the pump"
        )
        assert in_words("the bearing, not bearings", "belt") == "the belt, not bearings"

    def test_a_joint_has_the_symbols_of_a_bearing_only_in_a_gyroscope(self):
        assert (Coupling("bearing", "a", "b").delta, Coupling("bearing", "a", "b").tau) == ("delta", "tau")
        assert (Coupling("x", "a", "b").delta, Coupling("x", "a", "b").tau) == ("delta_x", "tau_x")
