"""Simulated motions: every effect of the library against an independent integrator."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR, Model
from fitting.effects._library import LIBRARY, REDUCED, typical_of_model
from fitting.inference._simulation import Experiment, simulate_path

_DURATION = 6.0


@pytest.mark.parametrize("name", [n for n, e in LIBRARY.items() if e.kind == "physical"])
def test_the_motion_with_each_effect_is_that_of_another_integrator(name):
    model = Model([LIBRARY[n] for n in dict.fromkeys((*REDUCED, name))])
    numbers = typical_of_model(
        model.effects, 0.01, duration=_DURATION, speeds={"omega_r": 540.0, "omega_c": 100.0}
    )
    numbers |= {INERTIA_ROTOR: 5.54e-5, INERTIA_CASING: 2.06e-5}
    motion, path = simulate_path(model, numbers, Experiment(duration=_DURATION, omega_casing=50.0))
    reference = solve_ivp(
        lambda t, y: motion.rates(np.array([t]), y[None], numbers)[0],
        (0.0, _DURATION),
        path.edges[0],
        method="Radau" if name == "casing.friction.presliding" else "LSODA",
        rtol=1e-10,
        atol=1e-9,
        max_step=0.02 if model.angle_dependent or "deflection" in motion.states else np.inf,
    )
    assert path.edges[-1][:2] == pytest.approx(reference.y[:2, -1], rel=1e-6)
