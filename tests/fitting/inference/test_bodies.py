"""The bodies of a recording are data: laws, joints, units and words follow from them."""

import copy
import math

import numpy as np
import pytest

from fitting import LIBRARY, Model, RecordError, make_record
from fitting._numbers import SI, WITHOUT_INERTIA, Units, scaled
from fitting.effects._effect import bodies_of
from fitting.inference._case_data import CaseData
from fitting.inference._parameters import START_CASING, START_ROTOR, ParameterLayout

TIME = np.linspace(0.0, 10.0, 50)
RUN = (TIME, 20.0 - TIME, np.full(50, 0.1))


def record(windows=(), **more):
    return make_record(casing=RUN, rotor=list(windows), I_rotor=5e-5, I_casing=2e-5, quantity="omega", **more)


class TestBodies:
    def test_a_rotor_in_its_casing(self):
        found = record([RUN, RUN], I_rotor_u=1e-6)
        assert [(b.name, b.role, b.part, b.state, len(b.series)) for b in found.bodies] == [
            ("casing", "casing", "casing", 1, 1), ("rotor", "rotor", "rotor", 0, 2)
        ]  # fmt: skip
        assert (found.parts, found.joints) == ({"rotor", "casing"}, ("bearing",))
        assert found.spun.name == "rotor"
        assert [b.relative_u for b in found.bodies] == [0.0, pytest.approx(0.02)]

    @pytest.mark.parametrize(("given", "name"), [("wheel", "wheel"), ("", "body")])
    def test_a_body_alone(self, given, name):
        found = record(name=given)
        (body,) = found.bodies
        assert (body.name, body.role, body.part, body.state) == (name, "body", "casing", 1)
        assert (found.parts, found.joints, found.spun) == ({"casing"}, (), body)
        assert f"I_{name} 2e-05 kg m2" in repr(found)

    def test_without_an_inertia_torques_are_accelerations(self):
        found = record(per_inertia=True)
        assert (found.units, found.torque_unit, found.per_inertia) == (WITHOUT_INERTIA, "rad/s2", True)
        assert "torques are per unit of inertia" in repr(found)
        assert (record().units, record().torque_unit, record().per_inertia) == (SI, "N m", False)

    def test_units_of_a_joint_fit_are_the_same_for_copies(self):
        several = copy.deepcopy([WITHOUT_INERTIA, SI])
        assert Units.common(several) == SI
        assert Units.common(several[:1]) == WITHOUT_INERTIA

    def test_the_ratio_of_inertias_has_the_errors_of_both(self):
        data = CaseData.of(record([RUN], I_rotor_u=1e-6, I_casing_u=2e-7)).with_free_inertia(free=True)
        assert np.sqrt(np.ravel(data.prior.covariance)) == pytest.approx([np.hypot(0.02, 0.01)])

    def test_a_rotor_without_usable_samples_is_not_a_body_alone(self):
        nothing = (TIME, np.full(50, math.nan), TIME)
        with pytest.raises(RecordError, match="no rotor window"):
            record([nothing])
        assert record([]).rotor == ()

    def test_initial_values_of_bodies_that_are_absent(self):
        layouts = [
            ParameterLayout(Model.of(["casing.air.linear"]), (r,), ()) for r in (record(), record([RUN]))
        ]
        assert [x.absent for x in layouts] == [(START_ROTOR,), ()]
        assert START_CASING not in layouts[0].absent


class TestLaws:
    @pytest.mark.parametrize(
        ("joint", "variables", "bodies"),
        [
            ("casing", ("omega_c", "t"), {"casing"}),
            ("casing", ("omega_r",), {"casing", "rotor"}),
            ("rotor", ("omega_r",), {"rotor"}),
            ("casing", ("delta",), {"casing", "rotor"}),
            ("bearing", ("t",), {"casing", "rotor"}),
            ("camera.casing", ("psi",), {"casing"}),
            ("camera.rotor", ("psi",), {"rotor"}),
            ("input", (), set()),
        ],
    )
    def test_bodies_on_which_a_law_acts_or_depends(self, joint, variables, bodies):
        assert bodies_of(joint, variables) == bodies

    def test_a_case_has_the_laws_of_its_bodies(self):
        whole = Model(tuple(LIBRARY.values()))
        assert whole.of_bodies({"rotor", "casing"}) == whole
        names = whole.of_bodies({"casing"}).names
        assert {"casing.air.quadratic", "touchpoint.constant", "casing.spring.linear"} <= {*names}
        assert not {"rotor.air.linear", "bearing.linear", "casing.windage", "setup.inertia"} & {*names}

    def test_equations_of_the_bodies_of_a_case(self):
        model = Model.of(["casing.air.linear", "bearing.linear"])
        assert len(model.equations()) == 3
        (line,) = model.equations({"casing"})
        assert line.startswith(r"I_c \dot\omega_c = ")
        assert r"\tau" not in line


class TestUnits:
    def test_constants_of_laws(self):
        assert (SI.of("N m s"), WITHOUT_INERTIA.of("N m s")) == ("N m s", "s-1")
        assert (SI.gain, WITHOUT_INERTIA.gain) == ("1", "kg-1 m-2")

    def test_a_joint_fit_has_si_units_if_any_case_has_them(self):
        assert Units.common([WITHOUT_INERTIA, WITHOUT_INERTIA]) is WITHOUT_INERTIA
        assert Units.common([WITHOUT_INERTIA, SI]) is SI

    @pytest.mark.parametrize(("unit", "units"), [("N m", SI), ("rad/s2", WITHOUT_INERTIA), ("unknown", SI)])
    def test_units_by_that_of_the_torque(self, unit, units):
        assert Units.by_torque(unit) is units

    def test_accelerations_have_no_prefix(self):
        assert scaled(3e-6, SI.prefixes) == (1e6, "µ")
        assert scaled(3e-6, WITHOUT_INERTIA.prefixes) == (1.0, "")
