"""Three bodies on a chain of joints, a wheel on a drum on a motor: fits of recordings that SciPy integrates."""

import numpy as np
import pytest
from cases import shared
from scipy.integrate import solve_ivp

from fitting import (
    Case,
    EffectError,
    EstimationError,
    Experiment,
    Model,
    RecordError,
    SimulationError,
    budget,
    diagnose,
    fit,
    simulate,
)
from fitting.dynamics._collocation import Mesh
from fitting.dynamics._events import solve
from fitting.dynamics._model import Dynamics
from fitting.dynamics._sensitivities import LinearMotion, sensitivities
from fitting.effects._instances import counterparts, laws_of
from fitting.effects._mechanism import GYROSCOPE, Coupling, Mechanism
from fitting.inference import _fit as module

INERTIA = {"motor": 2e-4, "drum": 5e-4, "wheel": 1e-3}
START = {"motor": 300.0, "drum": 200.0, "wheel": 50.0}
TRUTH = {
    "motor.support.constant.b1": 2e-3,
    "drum.air.linear.b2": 4e-5,
    "wheel.air.quadratic.k": 6e-7,
    "belt.linear.d": 2e-4,
    "bearing2.linear.d": 8e-5,
}
MODEL = [key.rpartition(".")[0] for key in TRUTH]
JOINTS = {"belt": ("motor", "drum"), "bearing2": ("drum", "wheel")}
SPAN = 20.0


def rates(_, y):
    """Return the accelerations of motor, drum and wheel, and their speeds."""
    motor, drum, wheel = y[:3]
    belt = TRUTH["belt.linear.d"] * (motor - drum)
    bearing = TRUTH["bearing2.linear.d"] * (drum - wheel)
    return [
        (-belt - TRUTH["motor.support.constant.b1"] * np.sign(motor)) / INERTIA["motor"],
        (belt - bearing - TRUTH["drum.air.linear.b2"] * drum) / INERTIA["drum"],
        (bearing - TRUTH["wheel.air.quadratic.k"] * wheel * abs(wheel)) / INERTIA["wheel"],
        *y[:3],
    ]


def recorded(seed, quantity="omega", count=300):
    """Return a case of all three bodies with white noise of the stated uncertainty."""
    t = np.linspace(0.0, SPAN, count)
    y = solve_ivp(rates, (0.0, SPAN), [*START.values(), 0.0, 0.0, 0.0], t_eval=t, rtol=1e-10, atol=1e-10).y
    values, u = (y[:3], 0.1) if quantity == "omega" else (y[3:], 2e-3)
    noise = np.random.default_rng(seed).standard_normal((3, count))
    bodies = {
        name: {"t": t, quantity: value + u * own, "u": u, "inertia": INERTIA[name]}
        for name, value, own in zip(INERTIA, values, noise, strict=True)
    }
    return Case.from_arrays(**bodies, joints=JOINTS)


def pulls(found):
    """Return deviations from the truth over standard uncertainties, by name without the case."""
    true = TRUTH | {f"initial.omega_{name}": speed for name, speed in START.items()}
    known = {name.partition("@")[0]: e for name, e in found.estimates.items()}
    return {name: (known[name].value - value) / known[name].stderr for name, value in true.items()}


@shared
def fitted(quantity="omega"):
    return fit(MODEL, recorded(1, quantity))


class TestFit:
    @pytest.mark.parametrize("quantity", ["omega", "angle"])
    def test_values_and_uncertainties(self, quantity):
        found = fitted(quantity)
        assert found.verdict == "no_lack_of_fit"
        assert {name.partition("@")[0] for name in found.estimates} == set(pulls(found))
        assert max(map(abs, pulls(found).values())) < 3.5
        for name, value in TRUTH.items():
            assert 0 < found.params[name].stderr < 0.01 * value

    def test_curves_and_report_name_each_body(self):
        found = fitted()
        assert [len(found.eval(body=name)) for name in INERTIA] == [300, 300, 300]
        assert found.eval([0.0], body="wheel") == pytest.approx([50.0], abs=0.2)
        text = found.fit_report()
        for name in (*INERTIA, *JOINTS):
            assert name in text
        assert len(found.cases[0].bodies) == 3
        assert found.energy().drift < 5e-3
        assert found.residual.std() == pytest.approx(1.0, abs=0.1)

    def test_equations_of_motion(self):
        lines = fitted().model.equations()
        assert lines[0].startswith(
            r"I_\mathrm{drum} \dot\omega_\mathrm{drum} = \tau_\mathrm{belt} -\tau_\mathrm{bearing2}"
        )
        assert lines[3] == r"\tau_\mathrm{belt} = d D_\mathrm{belt}"

    def test_uncertainties_of_all_inertias_contribute_to_a_budget(self):
        t = np.linspace(0.0, SPAN, 300)
        y = solve_ivp(rates, (0.0, SPAN), [*START.values(), 0.0, 0.0, 0.0], t_eval=t, rtol=1e-9).y
        bodies = {
            name: {
                "t": t,
                "omega": y[i],
                "u": 0.1,
                "inertia": INERTIA[name],
                "inertia_u": 0.01 * INERTIA[name],
            }
            for i, name in enumerate(INERTIA)
        }
        found = budget(fit(MODEL, Case.from_arrays(**bodies, joints=JOINTS)))
        # torques are proportional to all inertias together
        for name, value in TRUTH.items():
            slopes = {c.source: c.sensitivity for c in found[name].contributions}
            total = sum(slopes[f"inertia.{body}"] * inertia for body, inertia in INERTIA.items())
            assert total == pytest.approx(value, rel=0.02)

    @pytest.mark.parametrize("hold", [True, False])
    def test_settings_by_name(self, hold):
        found = fit(MODEL, recorded(2), params={"belt.linear.d": {"value": 2e-4, "vary": not hold}})
        assert (found.params["belt.linear.d"].value == 2e-4) is hold

    def test_users_write_laws_of_their_bodies(self):
        laws = ["wheel: -c*omega_wheel*abs(omega_wheel)", "bearing2: k*delta", "belt: e*delta_belt"]
        found = fit([*MODEL[:2], *laws], recorded(1))
        assert found.params[f"{laws[0]}.c"].value == pytest.approx(6e-7, rel=0.01)
        assert found.params[f"{laws[1]}.k"].value == pytest.approx(8e-5, rel=0.01)
        assert found.params[f"{laws[2]}.e"].unit == "N m s"

    def test_two_named_bodies_have_the_numbers_of_a_gyroscope(self):
        t = np.linspace(0.0, SPAN, 300)
        y = solve_ivp(rates, (0.0, SPAN), [*START.values(), 0.0, 0.0, 0.0], t_eval=t, rtol=1e-9).y
        noise = np.random.default_rng(5).standard_normal((2, 300))
        slow, fast = (
            {"t": t, "omega": y[i] + 0.1 * own, "u": 0.1, "inertia": inertia}
            for i, own, inertia in ((1, noise[0], 5e-4), (0, noise[1], 2e-4))
        )
        known = fit(
            ["bearing.linear", "casing.air.linear", "rotor.air.linear"],
            Case.from_arrays(casing=slow, rotor=fast),
        )
        named = fit(
            ["belt.linear", "drum.air.linear", "motor.air.linear"],
            Case.from_arrays(drum=slow, motor=fast, joints={"belt": ("motor", "drum")}),
        )
        for one, other in zip(known.estimates.values(), named.estimates.values(), strict=True):
            assert (other.value, other.stderr) == pytest.approx((one.value, one.stderr), rel=1e-6)
        assert named.bic == pytest.approx(known.bic, rel=1e-9)

    @pytest.mark.slow
    @pytest.mark.release
    def test_intervals_cover_the_truth(self):
        """Sixty recordings, of which 95 % are expected to be covered, with three standard deviations."""
        found = np.array([list(pulls(fit(MODEL, recorded(100 + i))).values()) for i in range(60)])
        inside = np.abs(found) < 1.96
        assert 0.92 < inside.mean() < 0.98
        assert inside.mean(axis=0).min() > 0.95 - 3 * np.sqrt(0.95 * 0.05 / 60)


class TestDiagnosis:
    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("hidden", "seed"), [("wheel.air.quadratic", 3), ("drum.air.linear", 4), ("belt.linear", 5)]
    )
    @pytest.mark.release
    def test_a_hidden_law_is_named(self, hidden, seed):
        found = diagnose(fit([name for name in MODEL if name != hidden], recorded(seed)))
        assert (found.verdict, found.form) == ("missing_effect", "exact")
        assert found.candidates[0].effect.name == hidden
        (value,) = found.candidates[0].estimates.values()
        truth = next(v for k, v in TRUTH.items() if k.startswith(hidden))
        assert abs(value.value - truth) < 4 * value.stderr

    @pytest.mark.slow
    def test_a_complete_model_is_adequate(self):
        assert diagnose(fitted()).verdict == "adequate"


CHAIN = Mechanism(
    ("drum", "motor", "wheel"),
    tuple(Coupling(name, first, second) for name, (first, second) in JOINTS.items()),
)


class TestEquations:
    @pytest.mark.parametrize(
        "law", [n for n, e in laws_of(CHAIN).items() if e.joint in {"bearing", "factor"}]
    )
    def test_torques_of_joints_cancel_between_their_bodies(self, law):
        effect = laws_of(CHAIN)[law]
        others = ("belt.linear", "bearing2.quadratic")
        dynamics = Dynamics(Model(tuple(laws_of(CHAIN)[n] for n in dict.fromkeys((*others, law)))))
        inertia = dict(zip(CHAIN.inertias, (5e-4, 2e-4, 1e-3), strict=True))
        y = np.random.default_rng(2).uniform(1, 300, (50, len(dynamics.states)))
        rate = dynamics.rates(np.linspace(0, 20, 50), y, dict.fromkeys(dynamics.parameters, 0.7) | inertia)
        momentum = rate[:, :3] * [*inertia.values()]
        assert np.abs(momentum.sum(axis=1)).max() < 1e-12 * np.abs(momentum).max()
        assert effect.bodies == {*JOINTS[effect.site]}

    def test_every_law_has_the_unit_of_a_torque(self):
        laws = laws_of(CHAIN)
        for effect in laws.values():
            effect.check()
            assert {*effect.equivalent, *effect.confused_with} <= {*laws}
        names = {"drum.air.quadratic", "motor.unbalance", "wheel.support.constant", "belt.power"}
        assert names <= {*laws}
        assert "wheel.unbalance" not in laws  # its angle is not that of the main body

    def test_responses_of_a_stiff_joint(self):
        """A joint equalises two speeds e^-60 within the record: the inverse of Phi has no digit left."""
        model = Model(
            tuple(laws_of(CHAIN)[n] for n in ("belt.linear", "bearing2.linear", "wheel.air.linear"))
        )
        numbers = {"belt.linear.d": 4.5e-4, "bearing2.linear.d": 1e-5, "wheel.air.linear.b2": 2e-5}
        numbers |= dict(zip(CHAIN.inertias, (5e-4, 2e-4, 1e-3), strict=True))
        dynamics = Dynamics(model)
        path = solve(dynamics, numbers, np.array([200.0, 300.0, 50.0]), Mesh.uniform(0.0, SPAN, 12))
        motion = LinearMotion(path, sensitivities(dynamics, numbers, path).propagator)
        matrix = dynamics.tangent(np.zeros(1), np.ones((1, 3)), numbers)[1][0]
        values, vectors = np.linalg.eig(matrix)
        kick = np.array([0.0, 1 / 2e-4, 0.0])
        for start, end in ((0.5, 1.0), (0.5, 19.0), (15.0, 19.0)):
            impulse = motion.impulses(np.array([start]), kick)[0]
            decay = np.exp(values * (end - start))
            exact = (vectors * decay) @ np.linalg.solve(vectors, kick)
            assert motion.fundamental(np.array([end]))[0] @ impulse == pytest.approx(exact.real, rel=1e-6)
            turned = (vectors * np.expm1(values * (end - start)) / values) @ np.linalg.solve(vectors, kick)
            psi = motion.integrated(np.array([start, end]))
            assert (psi[1] - psi[0]) @ impulse == pytest.approx(turned.real, rel=1e-6)


BODY = {"t": np.arange(50.0), "omega": 20.0 - 0.1 * np.arange(50.0), "u": 0.1, "inertia": 1e-3}


class TestRefusals:
    @pytest.mark.parametrize(
        ("bodies", "joints", "message"),
        [
            ({"drum": BODY, "motor": BODY}, {"belt": ("motor", "wheel")}, "belt is between motor and wheel"),
            ({"drum": BODY, "motor": BODY}, {"belt": ("motor", "motor")}, "belt is between motor and motor"),
            ({"drum": BODY, "motor": BODY}, {"drum": ("motor", "drum")}, "same name"),
            ({"drum": BODY, "motor": BODY}, {"bearing": ("motor", "drum")}, "'bearing' cannot be the name"),
            ({"casing": BODY, "motor": BODY}, {"belt": ("motor", "casing")}, "'casing' cannot be the name"),
            ({"drum": BODY, "motor": BODY}, {"belt": "motor"}, "joints is not a mapping"),
            ({"drum": BODY}, {"belt": ("motor", "drum")}, "drum is the only body"),
            (
                {"drum": BODY, "motor": BODY, "wheel": BODY},
                {"belt": ("motor", "drum")},
                "no joint connects wheel",
            ),
            (
                {"drum": BODY, "motor": {k: v for k, v in BODY.items() if k != "inertia"}},
                {"belt": ("motor", "drum")},
                "motor has no inertia",
            ),
        ],
    )
    def test_bodies_without_valid_joints(self, bodies, joints, message):
        with pytest.raises(RecordError, match=message):
            Case.from_arrays(**bodies, joints=joints)

    def test_laws_of_other_bodies(self):
        case = recorded(0)
        with pytest.raises(EffectError, match=r"no effect named 'casing\.air\.linear'"):
            case.model("casing.air.linear")
        with pytest.raises(EffectError, match="'rotor' is an unknown body"):
            case.model("rotor: -k*omega")
        with pytest.raises(EffectError, match="did you mean omega_wheel"):
            case.model("wheel: -k*omega_c")
        with pytest.raises(EstimationError, match="that the recording case does not have"):
            fit(Model.of(["casing.air.linear"]), case)
        with pytest.raises(EffectError, match="laws of different bodies"):
            case.model("belt.linear") + "casing.air.linear"

    def test_dry_friction_of_a_second_body_that_reverses(self):
        reversing = BODY | {"omega": 20.0 - np.arange(50.0)}
        case = Case.from_arrays(drum=BODY, motor=reversing, joints={"belt": ("motor", "drum")})
        with pytest.raises(EstimationError, match="only drum, the first body"):
            fit(["belt.linear", "motor.support.constant"], case)

    @pytest.mark.parametrize("body", ["motor", "wheel"])
    def test_a_plan_and_a_simulation(self, body):
        model = recorded(0).model(f"{body}.air.linear")
        with pytest.raises(EstimationError, match="gyrotrack certify"):
            simulate(model, {}, Experiment(), inertia_rotor=1e-3, inertia_casing=1e-3)


class TestModels:
    def test_each_body_and_joint_has_its_law_of_a_model_of_the_paper(self):
        model = recorded(0).model("linear")
        assert model.names == (
            "drum.air.quadratic", "wheel.air.quadratic", "motor.support.constant", "motor.air.linear",
            "belt.linear", "bearing2.linear",
        )  # fmt: skip
        assert Model.of("linear", CHAIN) == model
        assert Model.of("linear", GYROSCOPE) == Model.of("linear")

    def test_laws_without_a_counterpart_are_left_out(self):
        assert counterparts("casing.spring.linear", CHAIN) == ()
        assert [e.name for e in counterparts("casing.unbalance", CHAIN)] == ["motor.unbalance"]
        assert [e.name for e in counterparts("rotor.air.linear", GYROSCOPE)] == ["rotor.air.linear"]


class TestSinusoid:
    @pytest.mark.parametrize(
        ("names", "site"), [(("drum", "motor"), "drum"), (("casing", "rotor"), "casing")]
    )
    def test_the_law_to_add_names_the_body(self, names, site):
        """A torque of 2 mN m with 6 rad/s on the main body; its residual speed is 2e-3 / (I 6) = 0.67 rad/s."""
        t = np.linspace(0.0, SPAN, 400)
        noise = 0.05 * np.random.default_rng(8).standard_normal((2, len(t)))
        speeds = (
            50 * np.exp(-0.05 * t) + 2e-3 / (5e-4 * 6) * np.sin(6 * t),
            300 * np.exp(-0.05 * t),
        )
        bodies = {
            name: {"t": t, "omega": speed + own, "u": 0.05, "inertia": inertia}
            for name, speed, own, inertia in zip(names, speeds, noise, (5e-4, 2e-4), strict=True)
        }
        joints = None if site == "casing" else {"belt": ("motor", "drum")}
        laws = [f"{name}.air.linear" for name in names]
        peak = fit(laws, Case.from_arrays(**bodies, joints=joints)).periodogram_peak
        assert peak.law.startswith(f"{site}: k*cos(5.98")
        assert peak.rate == pytest.approx(6.0, rel=0.01)
        assert peak.p_value < 1e-6

    @pytest.mark.parametrize(
        ("laws", "named"),
        [
            (["belt.linear", "motor.support.constant"], ""),
            (["belt.linear", "drum.support.constant"], "drum.support.constant"),
            (["belt.constant", "wheel.air.linear"], "belt.constant"),
        ],
    )
    def test_dry_friction_that_may_stop_a_second_body_is_named(self, monkeypatch, laws, named):
        def diverges(*args, **options):
            raise SimulationError("no bounded solution")

        monkeypatch.setattr(module, "_fitted", diverges)
        model = Model(tuple(laws_of(CHAIN)[n] for n in laws))
        with pytest.raises(SimulationError) as caught:
            module.fit(model, [])
        assert (f"({named})" in caught.value.hint) if named else caught.value.hint == ""
        assert ("only motor" in caught.value.hint) is bool(named)
