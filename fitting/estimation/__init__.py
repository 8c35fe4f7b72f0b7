"""Fitting: starts that need no guess, a least-squares solver, the fit itself, and its figures of merit."""

from fitting.estimation.fit import fit
from fitting.estimation.outcome import Estimate, Fit

__all__ = ["Estimate", "Fit", "fit"]
