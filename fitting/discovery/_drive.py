"""An unrecorded drive: a rise of the speed that the fitted model does not contain.

Friction only slows a body that nothing drives. Process noise describes any motion, so that the residuals of a driven
motion may be consistent with noise although the model has no drive; strengths of friction laws then have no meaning.
The measured and the modelled motion are therefore compared: the mean speed in parts of the recording, each at least one
turn long, because the speed may vary within each turn without a drive.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.effects._mechanism import MAIN
from fitting.inference._case_data import CaseData
from fitting.inference._record import Samples
from fitting.inference._result import Fit
from fitting.inference._sampled import predicted_samples

Array = NDArray[np.float64]

_PARTS = 24
"""Largest number of parts of each run of samples [1]. Chosen: fewer parts average over a drive and the coast-down after
it, more parts have noisier speeds."""
_LEAST_RISE = 0.1
"""Smallest rise of the mean speed that shows a drive, relative to the largest mean speed [1]. Chosen: a smaller value
mistakes errors of the centre for a drive, a larger one overlooks weak drives."""
_SIGNIFICANT = 5.0
"""Smallest rise of the mean speed in units of its standard uncertainty [1]. Chosen: the largest of 300 differences of
noise is near 3; a larger value overlooks drives in noisy data."""
_MODELLED = 0.5
"""Share of the measured rise above which the model contains it [1]. Chosen: a smaller value accepts a model that
describes little of the drive, a larger one doubts a model with a small error."""


class _MeanSpeed(NamedTuple):
    """Mean speeds of the parts of a recording in time order, measured and modelled; each has the shape (parts,)."""

    time: Array
    measured: Array
    u: Array
    modelled: Array


def unrecorded_drive(fit: Fit) -> str:
    """Return a sentence about a rise of the speed that no torque of the model causes; empty if there is none.

    Oscillations, and recordings with a varying input, are not examined: their speed rises without an unknown drive.
    """
    for case, data in enumerate(fit.problem.data):
        if data.record.driving or not data.motion.is_smooth or fit.model.restoring:
            continue
        found = _mean_speeds(data, case, fit)
        speed, modelled = np.abs(found.measured), np.abs(found.modelled)
        lowest = np.minimum.accumulate(speed)
        end = int(np.argmax(speed - lowest))
        start = int(np.argmin(speed[: end + 1]))
        rise = float(speed[end] - speed[start])
        u = math.hypot(found.u[start], found.u[end])
        in_model = float(modelled[end] - modelled[start])
        if rise > max(_LEAST_RISE * speed.max(), _SIGNIFICANT * u) and in_model < _MODELLED * rise:
            return (
                f"The speed of the {data.record.spun.name} rises by {rise:.3g} rad/s from {found.time[start]:.3g} s to "
                f"{found.time[end]:.3g} s; no torque of the model causes this rise. Record the drive as an input "
                "(`import --input`), or import only the coast-down (--from, --to)."
            )
    return ""


def _mean_speeds(data: CaseData, case: int, fit: Fit) -> _MeanSpeed:
    record = data.record
    state = record.spun.state
    measured = (record.casing, *record.rotor)
    parts = [
        _of_run(samples, np.asarray(model), is_angle=data.is_angle)
        for i, (samples, model) in enumerate(zip(measured, predicted_samples(data, case, fit), strict=True))
        if (samples.state if i else MAIN) == state
    ]
    order = np.argsort(np.concatenate([p.time for p in parts]))
    return _MeanSpeed(*(np.concatenate(column)[order] for column in zip(*parts, strict=True)))


def _of_run(samples: Samples, model: Array, *, is_angle: bool) -> _MeanSpeed:
    """Return the mean speeds of one run of samples; their uncertainties follow from independent noise."""
    t, value, sigma = samples.time, samples.value, samples.sigma
    turns = abs(value[-1] - value[0]) / (2 * math.pi) if is_angle else math.inf
    count = max(int(min(_PARTS, turns, len(t) // 2)), 1)
    edges = np.linspace(0, len(t), count + 1).astype(int)
    first, last = edges[:-1], edges[1:] - 1
    middle = (t[first] + t[last]) / 2
    if is_angle:
        length = t[last] - t[first]
        u = np.hypot(sigma[first], sigma[last]) / length
        return _MeanSpeed(
            middle, (value[last] - value[first]) / length, u, (model[last] - model[first]) / length
        )
    n = np.diff(edges)
    means = [np.add.reduceat(v, first) / n for v in (value, model)]
    return _MeanSpeed(middle, means[0], np.sqrt(np.add.reduceat(sigma**2, first)) / n, means[1])
