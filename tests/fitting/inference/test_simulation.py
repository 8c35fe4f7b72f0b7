"""Simulated motions: every effect of the library against an independent integrator."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fitting import LIBRARY, REDUCED, EstimationError, Experiment, Model, SimulationError, simulate
from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR
from fitting.effects._library import typical_of_model
from fitting.inference._simulation import simulate_path

_DURATION = 6.0


# friction with a memory is stiff, and a law of the angle needs many steps
_LONG = {
    "casing.friction.gms", "casing.friction.lugre", "casing.friction.presliding",
    "casing.asymmetry", "casing.unbalance",
}  # fmt: skip


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=pytest.mark.slow) if n in _LONG else n
        for n, e in LIBRARY.items()
        if e.kind == "physical"
    ],
)
@pytest.mark.release
def test_the_motion_with_each_effect_is_that_of_another_integrator(name):
    model = Model([LIBRARY[n] for n in dict.fromkeys((*REDUCED, name))])
    numbers = typical_of_model(
        model.effects, 0.01, duration=_DURATION, speeds={"omega_r": 540.0, "omega_c": 50.0}
    )
    numbers |= {INERTIA_ROTOR: 5.54e-5, INERTIA_CASING: 2.06e-5}
    motion, path = simulate_path(model, numbers, Experiment(duration=_DURATION, omega_casing=50.0))
    reference = solve_ivp(
        lambda t, y: motion.rates(np.array([t]), y[None], numbers)[0],
        (0.0, _DURATION),
        path.edges[0],
        method="Radau" if LIBRARY[name].contact else "LSODA",
        rtol=1e-10,
        atol=1e-9,
        max_step=0.02 if model.angle_dependent or "deflection" in motion.states else np.inf,
    )
    assert path.edges[-1][:2] == pytest.approx(reference.y[:2, -1], rel=1e-6)


@pytest.mark.parametrize(("start", "inside"), [(-0.1, False), (0.0, True), (1.9, True), (2.1, False)])
def test_windows_are_inside_the_recording(start, inside):
    experiment = Experiment(
        duration=5.0, casing_fps=50.0, rotor_fps=50.0, windows=(start,), window_length=3.0
    )

    def record():
        numbers = {"bearing.linear.d": 1e-7}
        return simulate(
            Model.of(["bearing.linear"]), numbers, experiment, inertia_rotor=5e-5, inertia_casing=2e-5
        )

    if not inside:
        with pytest.raises(SimulationError, match="outside"):
            record()
        return
    made = record()
    assert (made.rotor[0].time[0], len(made.rotor[0].time)) == (start, 150)
    assert len(made.casing.time) == 250


def test_the_length_of_a_window_matters_only_with_windows():
    assert Experiment(windows=(), window_length=0.0).windows == ()
    with pytest.raises(EstimationError, match="window_length"):
        Experiment(windows=(1.0,), window_length=0.0)
