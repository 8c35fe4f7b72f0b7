"""Faults of the measurement that the data show without a model, as candidates of a diagnosis: slipped turns."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fitting.discovery._score import Score
from fitting.discovery._select import Candidate
from fitting.effects._effect import Effect, Parameter
from fitting.inference._result import Estimate, Fit
from fitting.inference._slips import Slip

SLIP = Effect(
    "camera.slip", "camera.rotor", "n*omega", (Parameter("n", "1", meaning="whole turns that slipped"),),
    kind="measurement", signature="a step of whole turns between two samples", source="an integer of turns",
    searched=False,
)  # fmt: skip


def slipped(fit: Fit, slips: Sequence[Slip]) -> Candidate:
    """Return slipped turns as a candidate; its score is the chi-square of the steps, in units of the white noise.

    Parameters
    ----------
    fit : Fit
        The fit, whose data are corrected.
    slips : sequence of Slip
        The slips.
    """
    sigma = min(
        r.scale * float(np.median(r.samples.sigma)) for d in fit.problem.data for r in (d.casing, *d.rotor)
    )
    score = sum((2 * math.pi * s.turns / sigma) ** 2 for s in slips) / 2
    none = np.zeros(0)
    screened = Score(SLIP, score, none, ({},), len(slips), 1, absorbed=False, direction=none, null=none)
    bic = len(slips) * math.log(fit.rows) - score
    estimates = {
        f"{SLIP.name}.n@{s.where}, {s.time:.3f} s": Estimate(float(s.turns), 0.0, "1", at_bound=False)
        for s in slips
    }
    return Candidate(SLIP, score, bic, 0.0, math.nan, (), estimates, significant=True, screened=screened)
