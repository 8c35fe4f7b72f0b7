"""The unmodelled torque on a body that moves while friction holds it in the model."""

from types import SimpleNamespace

import numpy as np
import pytest
from cases import shared
from scipy.signal import lfilter

import fitting.discovery._residuals as module
from fitting import Case, fit
from fitting.discovery._residuals import residual_torques
from fitting.inference import _speed_residuals as speed_residuals

INERTIA, FRICTION, DECAY = 2e-3, 5e-3, 30.0


def correlated(size, memory):
    """Return noise of variance 1 in which successive values have the correlation `memory`."""
    white = np.random.default_rng(1).standard_normal(size)
    return lfilter([np.sqrt(1 - memory**2)], [1.0, -memory], white)


@shared
def held(quantity, end=40.0, memory=0.0):
    """Return a fit of 10 rad/s exp(-t/30 s) with a dry friction that stops the body after 4 s."""
    t = np.linspace(0.0, end, 600)
    u = 5e-4 if quantity == "angle" else 1e-2
    exact = 10.0 * (DECAY * -np.expm1(-t / DECAY) if quantity == "angle" else np.exp(-t / DECAY))
    noise = correlated(len(t), memory)
    case = Case.from_arrays(wheel={"t": t, quantity: exact + u * noise, "u": u, "inertia": INERTIA})
    name = "touchpoint.constant.b1"
    return fit(["touchpoint.constant"], case, params={name: {"value": FRICTION, "vary": False}})


@pytest.mark.parametrize(("quantity", "memory"), [("angle", 0.0), ("angle", 0.8), ("omega", 0.0)])
def test_the_torque_is_that_of_the_measured_motion(quantity, memory):
    (curve,) = residual_torques(held(quantity, memory=memory))
    inside = (curve.time > 1.0) & (curve.time < 39.0)
    speed = 10.0 * np.exp(-curve.time / DECAY)
    exact = FRICTION - INERTIA * speed / DECAY
    pulls = ((curve.torque - exact) / curve.sigma)[inside]
    assert np.abs(pulls).max() < 4.5
    assert 0.5 < np.sqrt(np.mean(pulls**2)) < 1.25  # 1.36 without the correlation of successive residuals
    assert curve.omega_c[inside] == pytest.approx(speed[inside], rel=0.01)
    assert curve.sigma[inside].max() < (0.1 if quantity == "omega" or memory else 2e-3) * FRICTION


@pytest.mark.parametrize(
    ("speed", "held", "wrong"),
    [
        (1.01 * speed_residuals._MOVES, 9, True),
        (0.99 * speed_residuals._MOVES, 9, False),
        (0.05, 9, True),
        (0.002, 9, False),
        (-1.0, 9, True),
        (1.0, 2, True),
        (1.0, 1, False),
        (1.0, 0, False),
    ],
)
def test_a_model_that_holds_a_moving_body(speed, held, wrong):
    """100 times, the last ones of them held in the model; the speed before is 1."""
    times = np.arange(100.0)
    moving = (times < 100 - held).astype(float)
    speeds = np.column_stack([np.full(100, 50.0), np.where(moving, 1.0, speed)])
    prediction = SimpleNamespace(motion=SimpleNamespace(moving=lambda t: moving[t.astype(int)]))
    problem = SimpleNamespace(data=[SimpleNamespace(initial_speeds=(times, speeds))])
    fitted = SimpleNamespace(problem=problem, predictions=[prediction])
    assert speed_residuals.holds_moving_body(fitted, 0) is wrong


def test_a_body_that_rests_as_in_the_model_has_a_linear_response(monkeypatch):
    monkeypatch.setattr(module, "holds_moving_body", lambda fit, index: False)
    monkeypatch.setattr(module, "_of_the_measured_motion", None)
    (curve,) = residual_torques(held("omega"))
    assert (curve.omega_c == 0).any()


def test_a_body_that_never_rests_in_the_model_has_a_linear_response(monkeypatch):
    monkeypatch.setattr(module, "_of_the_measured_motion", None)
    (curve,) = residual_torques(held("omega", end=3.0))
    assert curve.torque.shape == curve.sigma.shape
