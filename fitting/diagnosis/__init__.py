"""Where a fitted model fails, and in which words to say so."""

from fitting.diagnosis.failures import Failure, find_failures
from fitting.diagnosis.ripple import Ripple, ripples
from fitting.diagnosis.torque import ResidualTorque, residual_torques
from fitting.diagnosis.whiteness import Whiteness, whiteness

__all__ = [
    "Failure",
    "ResidualTorque",
    "Ripple",
    "Whiteness",
    "find_failures",
    "residual_torques",
    "ripples",
    "whiteness",
]
