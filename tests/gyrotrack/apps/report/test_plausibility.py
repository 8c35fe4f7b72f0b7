"""Dissipated energies: sum, sign and uncertainty."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import REDUCED, Model, make_record
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit as fit_model
from gyrotrack.apps.report._tables import CONSERVATIVE, UNPHYSICAL, plausibility_rows

ADDED = "casing.air.quadratic"


def _number(text):
    """Return value and uncertainty of (a ± b) × 10ⁿ or a ± b."""
    raised = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
    text = text.replace("\u2212", "-").replace("(", "").replace(")", "")
    body, _, power = text.partition(" × 10")
    value, _, sigma = body.partition(" ± ")
    factor = 10.0 ** int((power or "⁰").translate(raised).split()[0])
    return float(value) * factor, float(sigma or "nan") * factor


@pytest.fixture(scope="module")
def fit(record_of):
    """The fit of the true model."""
    return fit_model(Model.of([*REDUCED, ADDED]), [CaseData.of(record_of(1))])


@pytest.mark.slow
def test_all_dissipation_is_the_loss_of_kinetic_energy(fit):
    path, record = fit.predictions[0].path, fit.problem.data[0].record
    inertia = np.array([record.I_rotor, record.I_casing])
    kinetic = [0.5 * float(np.sum(inertia * y[:2] ** 2)) for y in (path.y[0, 0], path.y[-1, -1])]
    total = sum(_number(row.energy)[0] for row in plausibility_rows(fit))
    assert total == pytest.approx(kinetic[0] - kinetic[1], rel=1e-2)


@pytest.mark.slow
def test_the_uncertainty_is_that_of_the_amplitude(fit):
    (row,) = [r for r in plausibility_rows(fit) if r.key == ADDED]
    energy, sigma = _number(row.energy)
    k = fit.estimates[f"{ADDED}.k"]
    assert sigma / energy == pytest.approx(k.stderr / k.value, rel=0.3)
    assert row.judgement == "dissipates"


def test_a_negative_friction_is_called_unphysical(fit):
    theta = fit.theta.copy()
    at = fit.problem.layout.names.index(f"{ADDED}.k")
    theta[at] = -theta[at]
    (row,) = [r for r in plausibility_rows(replace(fit, theta=theta)) if r.key == ADDED]
    assert row.is_unphysical
    assert row.judgement == UNPHYSICAL == "negative dissipation: unphysical"
    assert row.energy.startswith(("−", "(−"))
    # within its uncertainty it is not
    covariance = fit.covariance.copy()
    covariance[at, at] = (10 * theta[at]) ** 2
    (row,) = [
        r for r in plausibility_rows(replace(fit, theta=theta, covariance=covariance)) if r.key == ADDED
    ]
    assert row.judgement == "not distinguished from zero"


@pytest.mark.parametrize("quarter", [0.0, pytest.param(0.25, marks=pytest.mark.slow)])
def test_a_spring_stores_energy_and_dissipates_none(quarter):
    """Damping takes all energy, whether the record ends at the equilibrium or at the largest deflection."""
    t = np.arange(0, 20.5 + quarter, 0.02)
    angle = 0.6 * np.exp(-0.02 * t) * np.cos(2 * np.pi * t)
    noise = np.random.default_rng(1).normal(0, 1e-3, len(t))
    record = make_record(
        casing=(t, angle + noise, np.full(len(t), 1e-3)), rotor=[], I_rotor=1, I_casing=1, single=True
    )
    found = fit_model(Model.of(["casing.spring.linear", "casing.air.linear"]), [record])
    spring, drag = plausibility_rows(found)
    assert (spring.judgement, spring.share, spring.is_unphysical) == (CONSERVATIVE, "–", False)
    assert (drag.judgement, drag.share) == ("dissipates", "100.0 %")


class TestRows:
    """Two laws on two bodies: rates of the motion are known, and the energies follow by hand."""

    @pytest.mark.parametrize("cases", [1, 2])
    def test_torques_and_energies_are_those_of_the_motion(self, monkeypatch, cases):
        """Within 4 s, a torque of -2 t on the casing at 3 rad/s takes 48 J; 1 N m on the rotor at 5 rad/s give 20 J."""
        import fitting.dynamics._collocation as collocation
        import fitting.dynamics._model as dynamics

        class Sampler:
            def __init__(self, mesh, time):
                self.time = time

            def value(self, y):
                return np.column_stack([5.0 + 0.0 * self.time, 3.0 + 0.0 * self.time])

        def rates(names):
            def of(time, state, numbers):
                casing = -4.0 * time * numbers["drag.k"] * ("drag" in names)
                rotor = 0.25 * numbers["motor.k"] * ("motor" in names) + 0.0 * time
                return np.column_stack([rotor, casing, time])

            return of

        class Dynamics:
            def __init__(self, model, inputs):
                self.states, self.rates = ("r", "c"), rates(model)

        monkeypatch.setattr(collocation, "Sampler", Sampler)
        monkeypatch.setattr(dynamics, "Dynamics", Dynamics)
        effects = [
            SimpleNamespace(name=n, joint="casing", restoring=False, depends_on_angle=False, parameters=(), inputs=(),
                            expression=None)
            for n in ("drag", "motor")
        ]  # fmt: skip
        monkeypatch.setattr("fitting.effects._expression.symbols", lambda expression: set())
        smooth = SimpleNamespace(
            effects=effects, without=lambda name: tuple(e.name for e in effects if e.name != name)
        )
        layout = SimpleNamespace(
            model=SimpleNamespace(smooth=smooth), names=["drag.k", "motor.k@run", "motor.k@other"],
            numbers=lambda theta, index: {"drag.k": theta[0], "motor.k": theta[1]},
        )  # fmt: skip
        record = SimpleNamespace(
            inertias=(4.0, 0.5), inputs=(), label="run",
            bodies=[SimpleNamespace(state=1), SimpleNamespace(state=0)],
        )  # fmt: skip
        path = SimpleNamespace(mesh=SimpleNamespace(edges=np.array([0.0, 4.0])), states=("r", "c"), y=None)
        case = SimpleNamespace(dynamics=SimpleNamespace(rates=rates(("drag", "motor"))))
        found = SimpleNamespace(
            problem=SimpleNamespace(cases=[case] * cases, data=[SimpleNamespace(record=record)] * cases, layout=layout),
            predictions=[SimpleNamespace(path=path)] * cases, theta=np.array([1.0, 1.0, 9.0]),
            covariance=np.diag([0.01, 0.04, 100.0]), name=lambda e: SimpleNamespace(words=e.name, key=e.name),
        )  # fmt: skip
        rows = plausibility_rows(found)
        assert len(rows) == 2 * cases
        drag, motor = rows[:2]
        assert (drag.case, motor.case) == (("", "") if cases == 1 else ("run", "run"))
        # the casing is last: largest torques 0.5 * 4 * 4 N m, and 4 * 0.25 N m on the rotor
        assert drag.torques == ("0", "8.00")
        assert motor.torques == ("1.00", "0")
        assert _number(drag.energy) == pytest.approx((48.0, 4.8), rel=0.05)
        assert _number(motor.energy) == pytest.approx((-20.0, 4.0), rel=0.02)
        assert (drag.share, motor.share) == ("100.0 %", "−41.7 %")
        assert (drag.judgement, motor.judgement, motor.is_unphysical) == ("dissipates", UNPHYSICAL, True)
