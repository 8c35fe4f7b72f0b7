"""The unmodelled torque on a body that moves while friction holds it in the model."""

import numpy as np
import pytest
from cases import shared

import fitting.discovery._residuals as module
from fitting import Case, fit
from fitting.discovery._residuals import residual_torques

INERTIA, FRICTION, DECAY = 2e-3, 5e-3, 30.0


@shared
def held(quantity, end=40.0):
    """Return a fit of 10 rad/s exp(-t/30 s) with a dry friction that stops the body after 4 s."""
    t = np.linspace(0.0, end, 2000)
    u = 1e-3 if quantity == "angle" else 1e-2
    exact = 10.0 * (DECAY * -np.expm1(-t / DECAY) if quantity == "angle" else np.exp(-t / DECAY))
    noise = np.random.default_rng(1).standard_normal(len(t))
    case = Case.from_arrays(wheel={"t": t, quantity: exact + u * noise, "u": u, "inertia": INERTIA})
    name = "touchpoint.constant.b1"
    return fit(["touchpoint.constant"], case, params={name: {"value": FRICTION, "vary": False}})


@pytest.mark.parametrize("quantity", ["angle", "omega"])
def test_the_torque_is_that_of_the_measured_motion(quantity):
    (curve,) = residual_torques(held(quantity))
    inside = (curve.time > 1.0) & (curve.time < 39.0)
    speed = 10.0 * np.exp(-curve.time / DECAY)
    exact = FRICTION - INERTIA * speed / DECAY
    pulls = ((curve.torque - exact) / curve.sigma)[inside]
    assert np.abs(pulls).max() < 4.5
    assert 0.5 < np.sqrt(np.mean(pulls**2)) < 1.5
    assert curve.omega_c[inside] == pytest.approx(speed[inside], rel=0.01)
    assert (curve.sigma < 1e-3 * FRICTION if quantity == "angle" else curve.sigma < 0.1 * FRICTION).all()


@pytest.mark.parametrize(
    ("speed", "more", "used"),
    [(1.01 * module._MOVES, 1, True), (0.99 * module._MOVES, 1, False), (-1.0, 1, True), (1.0, 0, False)],
)
def test_a_body_that_rests_as_in_the_model_has_a_linear_response(monkeypatch, speed, more, used):
    """The body moves with `speed`, relative to its largest, for 1 % of the record after it rests in the model."""

    def measured(fit, index, times, y, width):
        values = np.where(y[:, 1] == 0, 0.0, 1.0)
        moving = int(module._SHORTEST * len(times)) + more
        values[np.flatnonzero(y[:, 1] == 0)[:moving]] = speed
        return values, np.full(len(times), 7.0), np.ones(len(times))

    monkeypatch.setattr(module, "_of_the_measured_motion", measured)
    (curve,) = residual_torques(held("omega"))
    assert bool((curve.torque == 7.0).all()) is used


def test_a_body_that_never_rests_in_the_model_has_a_linear_response(monkeypatch):
    monkeypatch.setattr(module, "_of_the_measured_motion", None)
    (curve,) = residual_torques(held("omega", end=3.0))
    assert curve.torque.shape == curve.sigma.shape
