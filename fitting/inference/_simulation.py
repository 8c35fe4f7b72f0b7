"""Simulated recordings: a model integrated exactly, sampled as the cameras do, with noise.

The smooth torques are integrated exactly. A random torque is small; its effect is computed from the motion linearised
about this solution.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fitting._arguments import FINITE, NOT_NEGATIVE, POSITIVE, require
from fitting._errors import SimulationError
from fitting.dynamics._collocation import Mesh, Path, Sampler
from fitting.dynamics._events import solve
from fitting.dynamics._inputs import Input
from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR, Dynamics, Model
from fitting.dynamics._sensitivities import LinearMotion, sensitivities
from fitting.inference._record import Record, Samples

Array = NDArray[np.float64]

_PER_TURN = 0.5
"""Largest number of turns per interval of the mesh, for a law of the casing's angle [1]. Chosen: a larger value does
not resolve a turn, a smaller one costs time."""
_FIRST_INTERVAL = 1e-6
"""First interval of a mesh for a boundary layer at the start, divided by the duration [1]. Chosen: a larger value does
not resolve fast transients, a smaller one costs intervals."""
_GRADED = 60
"""Number of intervals of a mesh for a boundary layer at the start [1]. Chosen: with fewer, the length of the intervals
increases too fast; with more, the solution takes longer."""
_NOISE_STEP = 0.02
"""Step of a simulated random torque [s]. Chosen: short compared with its default correlation time of 1 s; a larger
value makes it a sequence of steps, a smaller one costs time."""


@dataclass(frozen=True)
class Experiment:
    """Initial speeds, cameras and noise of a simulated run."""

    omega_rotor: float = 900.0
    """Speed of the rotor at the start [rad/s]. Chosen: a fast rotor at the scale of the paper; with a smaller value,
    the casing receives less energy; a larger one needs a faster camera."""
    omega_casing: float = 5.0
    """Speed of the casing at the start [rad/s]. Chosen: the casing has just been released; a smaller value starts near
    rest, a larger one shows less of the acceleration."""
    duration: float = 200.0
    """Length of the casing's recording [s]. Chosen: both bodies slow down within this time; a shorter one determines
    the laws less precisely, a longer one adds a body at rest."""
    casing_fps: float = 260.0
    """Frame rate of the casing's camera [s-1]. Chosen: a casing of up to 160 rad/s turns by a tenth of a turn per
    frame; a smaller value aliases fast bodies, a larger one needs more light."""
    rotor_fps: float = 1000.0
    """Frame rate of the rotor's camera [s-1]. Chosen: a rotor of 900 rad/s turns by a seventh of a turn per frame; a
    smaller value aliases fast bodies, a larger one needs more light."""
    windows: tuple[float, ...] = field(default=(5.0, 70.0, 150.0))
    """Starts of the rotor clips [s]. Chosen: at the start, in the middle and near the end of the run; a smaller number
    determines the rotor's drag poorly, a larger one needs more films."""
    window_length: float = 3.0
    """Length of each rotor clip [s]. Chosen: a shorter one determines the speed less precisely, a longer one makes
    larger films."""
    sigma: float = 1e-3
    """Noise of each angle [rad]. Chosen: the order of magnitude of tracked films; with a smaller value, effects are
    visible that films do not show; a larger one hides effects."""
    torque_noise: float = 0.0
    """Rms random torque on the casing and in the bearing [N m]. Chosen: none by default; a larger value raises
    detection limits."""
    torque_time: float = 1.0
    """Correlation time of the random torque [s]. Chosen: with a shorter time, the torque is white noise for the blocks;
    with a longer time, it is a trend."""
    centre_offset: float = 0.0
    """Once-a-turn error of the casing's angle [rad]. Chosen: none by default; a larger value tests the nuisance
    functions."""

    def __post_init__(self) -> None:
        require("windows", self.windows, FINITE.several)
        of_rotor = ("rotor_fps", "window_length") if len(self.windows) else ()
        for name in ("duration", "casing_fps", *of_rotor, "sigma", "torque_time"):
            require(name, getattr(self, name), NOT_NEGATIVE if name == "sigma" else POSITIVE)
        for name in ("omega_rotor", "omega_casing", "torque_noise", "centre_offset"):
            require(name, getattr(self, name), FINITE)


def simulate_path(
    model: Model, numbers: Mapping[str, float], experiment: Experiment, inputs: Sequence[Input] = ()
) -> tuple[Dynamics, Path]:
    """Integrate a model over the length of an experiment, with the inputs of its laws."""
    angles = bool(model.angle_dependent)
    dynamics = Dynamics(model, angles=angles, inputs=inputs)
    smooth = Dynamics(model.smooth, inputs=inputs)
    # the initial deflection of a casing with a restoring torque is zero
    deflection = (0.0,) * (dynamics.free_starts - 2)
    states = (experiment.omega_rotor, experiment.omega_casing, *deflection, *dynamics.start)
    first = np.array([*states, *((0.0, 0.0) if angles else ())])
    path = _smooth_path(smooth, numbers, first[: len(smooth.states)], experiment.duration)
    if angles:
        turns = float(np.ptp(path.angle("omega_c")[0])) / (2 * np.pi)
        mesh = Mesh.uniform(0.0, experiment.duration, int(20 + turns / _PER_TURN))
        path = solve(dynamics, numbers, first, mesh)
    return dynamics, path


def _smooth_path(dynamics: Dynamics, numbers: Mapping[str, float], first: Array, duration: float) -> Path:
    try:
        return solve(dynamics, numbers, first, Mesh.uniform(0.0, duration, 12))
    except SimulationError:
        # a state that relaxes fast at the start, for example the slip of a contact, has a boundary layer there
        graded = duration * np.geomspace(_FIRST_INTERVAL, 1.0, _GRADED)
        return solve(dynamics, numbers, first, Mesh(np.concatenate([[0.0], graded])))


def simulate(
    model: Model,
    numbers: Mapping[str, float],
    experiment: Experiment,
    *,
    inertia_rotor: float,
    inertia_casing: float,
    seed: int = 0,
    label: str = "simulated",
    inputs: Sequence[Input] = (),
) -> Record:
    """Return a recording of a model.

    Parameters
    ----------
    model : Model
        Physical effects.
    numbers : mapping of str to float
        Its parameters by key.
    experiment : Experiment
        How the run is filmed.
    inertia_rotor, inertia_casing : float
        Moments of inertia [kg m2].
    seed : int
        Random seed of all noise.
    label : str
        Name of the case.
    inputs : sequence of Input
        Recorded inputs on which its laws depend.

    Returns
    -------
    Record
        Angles with noise; each rotor window starts at an arbitrary phase.

    Raises
    ------
    SimulationError
        As for `simulate_path`; or if a window is outside the recording.
    """
    model.refuse_chain("a simulation", "gyrotrack certify, or fitting.certify, simulates replicas of a fit")
    random = np.random.default_rng(seed)
    values = {**model.constants, **numbers, INERTIA_ROTOR: inertia_rotor, INERTIA_CASING: inertia_casing}
    missing = [k for k in model.parameters if k not in values]
    if missing:
        raise SimulationError(f"no value of {missing[0]} is given", f"needed: {', '.join(model.parameters)}")
    if any(w < 0 or w + experiment.window_length > experiment.duration for w in experiment.windows):
        raise SimulationError("a rotor window is outside the recording", "move it or record for longer")
    dynamics, path = simulate_path(model, values, experiment, inputs)
    # torques periodic in the angle hardly change the response to a random torque, so the response of the smooth motion
    # is used
    smooth = (
        simulate_path(model.smooth, values, experiment, inputs) if model.angle_dependent else (dynamics, path)
    )
    random_angle = _RandomTorque(*smooth, values, experiment, random)
    time = np.arange(0.0, experiment.duration, 1 / experiment.casing_fps)
    psi = _angle(path, "omega_c", time) + random_angle(time, 1)
    psi = psi + experiment.centre_offset * np.sin(psi - 0.7)
    casing = _noisy(time, psi, experiment.sigma, random)
    rotor = []
    for start in experiment.windows:
        t = start + np.arange(0.0, experiment.window_length, 1 / experiment.rotor_fps)
        psi = _angle(path, "omega_r", t) + random_angle(t, 0)
        rotor.append(_noisy(t, psi - psi[0] + random.uniform(0, 2 * np.pi), experiment.sigma, random))
    return Record(label, inertia_rotor, inertia_casing, casing, tuple(rotor), inputs=tuple(inputs))


def _angle(path: Path, state: str, time: Array) -> Array:
    return Sampler(path.mesh, time).integral(*path.angle(state))


def _noisy(time: Array, angle: Array, sigma: float, random: np.random.Generator) -> Samples:
    value = angle + sigma * random.standard_normal(len(time))
    return Samples(time, value, np.full(len(time), max(sigma, 1e-9)))


class _RandomTorque:
    """The change of an angle by Ornstein-Uhlenbeck torques on the casing and in the bearing."""

    def __init__(
        self,
        dynamics: Dynamics,
        path: Path,
        values: Mapping[str, float],
        experiment: Experiment,
        random: np.random.Generator,
    ) -> None:
        self._quiet = experiment.torque_noise == 0
        if self._quiet:
            return
        self._times = np.arange(0.0, experiment.duration + _NOISE_STEP, _NOISE_STEP)
        self._times[-1] = min(self._times[-1], path.mesh.edges[-1])
        self._motion = LinearMotion(path, sensitivities(dynamics, values, path).propagator)
        inverse = 1 / values[INERTIA_ROTOR], 1 / values[INERTIA_CASING]
        self._parts = [
            (_ornstein_uhlenbeck(len(self._times) - 1, experiment, random), np.array(direction))
            for direction in ((0.0, inverse[1]), (-inverse[0], inverse[1]))
        ]

    def __call__(self, time: Array, state: int) -> Array:
        if self._quiet:
            return np.zeros(len(time))
        total = np.zeros(len(self._times))
        for torque, direction in self._parts:
            total += self._motion.driven(self._times, 1, direction)(torque[:, None, None])[1][state, :, 0]
        from scipy.interpolate import CubicSpline

        return np.asarray(CubicSpline(self._times, total)(time))


def _ornstein_uhlenbeck(n: int, experiment: Experiment, random: np.random.Generator) -> Array:
    from scipy.signal import lfilter

    decay = float(np.exp(-_NOISE_STEP / experiment.torque_time))
    increments = random.standard_normal(n) * experiment.torque_noise * np.sqrt(1 - decay**2)
    increments[0] = random.standard_normal() * experiment.torque_noise
    return np.asarray(lfilter([1.0], [1.0, -decay], increments))
