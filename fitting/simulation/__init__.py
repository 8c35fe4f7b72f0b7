"""Integration of the equations of motion with exact sensitivities, by Gauss collocation on intervals."""

from fitting.simulation.mesh import Mesh, Path, Sampler
from fitting.simulation.motion import solve
from fitting.simulation.sensitivity import Sensitivity, respond, sensitivities

__all__ = ["Mesh", "Path", "Sampler", "Sensitivity", "respond", "sensitivities", "solve"]
