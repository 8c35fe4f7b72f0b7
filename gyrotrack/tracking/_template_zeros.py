"""Zeros of the angles from a body's texture, one for each template, determined from the angles of the markers.

A template is the mean picture of a body in a batch of frames. The texture gives the angle of the body relative to this
template. Templates are registered to each other, but the picture changes with motion blur and light, so the zero z_b of
a template drifts from batch to batch. The angle of the markers has a fixed zero. In batch b the mean difference m_b of
both angles is

    m_b = z_b + e_b,   z_b = z_(b-1) + w_b,   var e_b = s_b^2 / n_b + x^2 + sum_k A_k^2 |<exp(i k a)>_b|^2 / 2,
    var w_b = q^2 + p^2 (omega_b - omega_(b-1))^2,

a local level model (A. C. Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, Cambridge (1989)).
s_b is the scatter of the differences in the n_b frames, and <>_b is the mean over these frames. x is an error common to
the frames of a batch. The error of a marker has harmonics k of the angle a of the marker, and of the angle relative to
the other body, whose markers it passes. The amplitudes A_k are measured in batches in which the harmonics average out.
If the time between frames is nearly a multiple of the period of a harmonic, the harmonic does not average out, and the
markers contain little information about the zero. The blur of a template depends on the speed omega_b; p = 0 for a
steady body. q, p and x maximise the likelihood, and the zeros are smoothed.

Within a batch the zero is z_b + c_b (omega - omega_b). c_b is the posterior mean of the slope of the differences, with
p as the prior standard deviation, fitted together with the harmonics, whose coefficients have the prior variance A_k^2
/ 2. Without the harmonics, the error of a marker that does not average out would be taken for a slope of the zero. The
zero may also be a curved function of the speed, for example because the first turn of a body at rest is not blurred.
The variance of slow residuals of the fit is therefore added to the variance of z_b, up to the prior variance of the
change within the batch.

The errors of the texture once and twice per turn (centre, oblique view) also differ between templates. Their
differences follow from the markers in the same way (`change_of_harmonics`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from gyrotrack._arrays import Floats, Integers
from gyrotrack._smoothing import median_of, spread

FEWEST_TEMPLATES = 5
"""Smallest number of templates from which the variance of the steps between zeros can be estimated [1]. Chosen: a
smaller number gives a random variance, a larger one ignores the drift in short films."""
_ORDERS = range(1, 13)
"""Orders of the harmonics of the error of a marker [periods per turn]. Chosen: as `_body_angles._HARMONICS`; a smaller
number leaves errors of several equal marks in the zeros."""
_AVERAGED_OUT = 0.2
"""A batch is used for the amplitude of harmonic k if the absolute mean of exp(i k a) in it is at most this value [1].
Chosen: a smaller value uses few batches, a larger one includes the zero in the amplitude."""
_STEADY = 0.01
"""Largest change of speed (rms) of a steady body between batches, divided by the speed [1]. Chosen: a smaller value
fits p to noise, a larger one ignores the change of motion blur."""
_MOTION = 4
"""Degree of the polynomial that describes the angle in a batch [1]. Chosen: a smaller value leaves changes of the
speed, a larger one fits noise."""
_FEWEST_FRAMES = 32
"""Smallest number of frames of a batch whose mean difference is used [frames]. Chosen: with fewer, the variance is
uncertain; with more, the last batch is omitted."""
_FAR = 5.0
"""Smallest difference of an outlier in a batch, in robust standard deviations [1]. Chosen: a smaller value rejects
good frames, a larger one keeps slips."""
_STEPS = np.concatenate([[0.0], np.geomspace(0.1, 50.0, 10)])
"""Trial values of q, and of the product of p and the rms change of speed, both divided by the typical uncertainty of a
mean difference m_b [1]. Chosen: factors of 2; finer steps cost time, a smaller range limits the drift."""
_COMMON = np.concatenate([[0.0], np.geomspace(0.5, 30.0, 6)])
"""Trial values of the common error x, divided by the typical uncertainty of a mean difference m_b [1]. Chosen: factors
of 2.3; finer steps cost time, a smaller range limits the error."""
_VIEW_ORDERS = range(1, 3)
"""Orders of the harmonics that change with the template [periods per turn]. Derived: a displaced centre causes order 1,
an oblique view order 2."""
_FLAT = 1.0
"""Prior precision of the coefficients that change with the template [1/rad^2]. Derived: wide enough to contain no
information; it only prevents a singular matrix in a body at rest."""
_FINEST = 1e-7
"""Lower limit of the scatter of the differences [rad]. Derived: the rounding error of sums in single precision, which
is all that remains in a picture without noise."""


@dataclass(frozen=True)
class TemplateZeros:
    """Zeros of the templates of a film."""

    zero: Floats  # shape (n,); correction added to the angle of the texture in each frame [rad]
    # shape (n,); standard uncertainty of the zero of the template of each frame [rad], 0 where the zero is not known;
    # the frames of a batch share its error
    uncertainty: Floats


def template_zeros(off: Floats, template: Integers, angles: Sequence[Floats]) -> TemplateZeros:
    """Return the zeros of the templates of a body that turns many times.

    `off` (n,) is the angle of the markers minus the angle of the texture [rad], without whole turns; NaN where either
    is not known. `template` (n,) is the number of the template of each frame, from 0, in order. The harmonics of the
    `angles` (n,) [rad] describe the errors of the markers; the first is the angle of the body itself.
    """
    count = int(template.max(initial=-1)) + 1
    batches, used = _batches(off, template, count)
    if len(used) < FEWEST_TEMPLATES:
        known = np.isfinite(off)
        middle = median_of(off[known]) if known.any() else 0.0
        return TemplateZeros(np.full(len(off), middle), np.zeros(len(off)))
    mean = np.array([float(off[batches[b]].mean()) for b in used])
    variance = np.array([float(off[batches[b]].var()) / len(batches[b]) for b in used])
    squares = [_squared_amplitudes(off, a, [batches[b] for b in used], variance) for a in angles]
    for angle, each in zip(angles, squares, strict=True):
        variance = variance + [0.5 * float(each @ _squared_resultants(angle, batches[b])) for b in used]
    change = _changes_of_speed(angles[0], [batches[b] for b in used])
    zero, left, per_speed = _smoothed(mean, variance, np.diff(used).astype(np.float64), change, _COMMON)
    each = np.interp(np.arange(count), used, zero)[template]
    for i, b in enumerate(used if per_speed > 0 else ()):
        part = slice(*np.searchsorted(template, [b, b + 1]))
        within, of_slope = _within(off, angles, squares, batches[b], part, per_speed)
        each[part] += within
        left[i] += of_slope
    return TemplateZeros(each, np.sqrt(np.interp(np.arange(count), used, left))[template])


def change_of_harmonics(off: Floats, template: Integers, angles: Sequence[Floats]) -> tuple[Floats, float]:
    """Return the change of errors once and twice per turn between templates, (n,) [rad], to be added to the texture.

    The second result is the rms standard uncertainty of its coefficients [rad]. A displaced centre and an oblique view
    turn a template in proportion to its moments, which differ between templates. Both angles in `off` contain the
    motion, and the errors of the markers do not depend on the template. The harmonics of `off` therefore show these
    differences. The coefficients of orders 1 and 2 are fitted in each batch and smoothed as the zeros are. Their
    weighted mean over the batches is subtracted, because it may be an error of the markers. The arguments are explained
    in `template_zeros`; the mean of `off` is 0 in each batch.
    """
    count = int(template.max(initial=-1)) + 1
    batches, used = _batches(off, template, count)
    if len(used) < FEWEST_TEMPLATES:
        return np.zeros(len(off)), 0.0
    white = np.array([float(off[batches[b]].var()) / len(batches[b]) for b in used])
    squares = [_squared_amplitudes(off, a, [batches[b] for b in used], white) for a in angles]
    squares[0][: len(_VIEW_ORDERS)] = 0.0
    found = np.array([_coefficients(off, angles, squares, batches[b]) for b in used])
    change = _changes_of_speed(angles[0], [batches[b] for b in used])
    correction, variances = np.zeros(len(off)), []
    turn = np.where(np.isfinite(angles[0]), angles[0], 0.0)
    for (order, wave), (value, variance) in zip(
        product(_VIEW_ORDERS, (np.cos, np.sin)), found.transpose(2, 1, 0), strict=True
    ):
        level, left, _ = _smoothed(value, variance, np.diff(used).astype(np.float64), change, _COMMON[:1])
        level -= np.average(level, weights=1.0 / left)
        variances.append(left.mean())
        correction += np.interp(np.arange(count), used, level)[template] * wave(order * turn)
    return correction, float(np.sqrt(np.mean(variances)))


def _coefficients(
    off: Floats, angles: Sequence[Floats], squares: Sequence[Floats], frames: Integers
) -> Floats:
    """Return coefficients of cos and sin of `_VIEW_ORDERS` in a batch [rad], and their variances [rad^2], (2, 4)."""
    turn = angles[0][frames]
    own = [np.ones(len(frames)), *(wave(k * turn) for k, wave in product(_VIEW_ORDERS, (np.cos, np.sin)))]
    others = _marker_errors(angles, squares, frames)
    basis = np.stack(own + others, axis=1)
    free = basis[:, : len(own)]
    # the noise includes the errors of the marker, which their coefficients may describe only in part
    rest = off[frames] - free @ np.linalg.lstsq(free, off[frames], rcond=None)[0]
    noise = max(float(rest.var()), _FINEST**2)
    prior = np.diag([_FLAT] * len(own) + [1.0] * len(others))
    covariance = np.linalg.inv(basis.T @ basis / noise + prior)
    fitted = covariance @ (basis.T @ off[frames]) / noise
    return np.stack([fitted, np.diag(covariance)])[:, 1 : len(own)]


def _marker_errors(angles: Sequence[Floats], squares: Sequence[Floats], frames: Integers) -> list[Floats]:
    """Return the harmonics of the errors of a marker in some frames [rad]; their coefficients have the variance 1."""
    columns = []
    for angle, each in zip(angles, squares, strict=True):
        turn = angle[frames]
        for order, square in zip(_ORDERS, each, strict=True):
            if square > 0:
                size = math.sqrt(0.5 * square)
                columns += [np.nan_to_num(size * wave(order * turn)) for wave in (np.cos, np.sin)]
    return columns


def scatter_of_templates(off: Floats, template: Integers) -> float:
    """Return the robust standard deviation of the medians of differences (n,) [rad] over the frames of each template.

    The result is 0 for fewer than `FEWEST_TEMPLATES` templates.
    """
    known = np.isfinite(off)
    medians = [median_of(off[known & (template == b)]) for b in np.unique(template[known])]
    return spread(np.array(medians)) if len(medians) >= FEWEST_TEMPLATES else 0.0


def _batches(off: Floats, template: Integers, count: int) -> tuple[list[Integers], list[int]]:
    """Return the frames of each of `count` templates whose differences are used, and the templates with enough frames.

    The numbers of the templates increase with time.
    """
    parts = [slice(*np.searchsorted(template, [b, b + 1])) for b in range(count)]
    batches = [_without_outliers(off, part.start + np.flatnonzero(np.isfinite(off[part]))) for part in parts]
    return batches, [b for b in range(count) if len(batches[b]) >= _FEWEST_FRAMES]


def _without_outliers(off: Floats, frames: Integers) -> Integers:
    if len(frames) < _FEWEST_FRAMES:
        return frames
    apart = off[frames] - median_of(off[frames])
    return frames[np.abs(apart) < _FAR * max(spread(apart), 1e-12)]


def _squared_amplitudes(off: Floats, angle: Floats, batches: Sequence[Integers], white: Floats) -> Floats:
    """Return the mean squared amplitude of each harmonic of an angle in the differences, (orders,) [rad^2].

    Only batches in which a harmonic averages out are used for it; the amplitude is 0 if there are none.
    """
    total = np.zeros(len(_ORDERS))
    for place, order in enumerate(_ORDERS):
        found = []
        for frames, variance in zip(batches, white, strict=True):
            frames = frames[np.isfinite(angle[frames])]
            if len(frames) < _FEWEST_FRAMES:
                continue
            wave = np.exp(-1j * order * angle[frames])
            if abs(complex(wave.mean())) < _AVERAGED_OUT:
                apart = off[frames] - off[frames].mean()
                # white noise of variance s^2 in n frames adds 4 s^2 / n to the square of an amplitude
                found.append(abs(complex(2.0 * np.mean(apart * wave))) ** 2 - 4.0 * float(variance))
        if found:
            total[place] = max(float(np.mean(found)), 0.0)
    return total


def _squared_resultants(angle: Floats, frames: Integers) -> Floats:
    """Return the squared mean resultant length |<exp(i k a)>|^2 of an angle in some frames for each k, (orders,)."""
    frames = frames[np.isfinite(angle[frames])]
    if len(frames) < _FEWEST_FRAMES:
        return np.zeros(len(_ORDERS))
    waves = np.exp(1j * np.outer(_ORDERS, angle[frames]))
    return np.asarray(np.abs(waves.mean(axis=1)) ** 2)


def _changes_of_speed(angle: Floats, batches: Sequence[Integers]) -> Floats:
    """Return squared changes of speed between batches, (batches - 1,) [(rad per frame)^2]; 0 for a steady body."""
    speed = np.array([_mean_rate(angle[frames], frames) for frames in batches])
    change = np.diff(speed) ** 2
    return change if change.mean() >= _STEADY**2 * np.mean(speed**2) else np.zeros_like(change)


def _mean_rate(angle: Floats, frames: Integers) -> float:
    """Return the mean speed in some frames [rad per frame]."""
    return float(angle[-1] - angle[0]) / float(frames[-1] - frames[0])


def _within(
    off: Floats,
    angles: Sequence[Floats],
    squares: Sequence[Floats],
    frames: Integers,
    batch: slice,
    per_speed: float,
) -> tuple[Floats, float]:
    """Return the zero of a template in the frames of its batch, less the zero at the mean speed [rad].

    The second result is the mean variance of this difference over the frames [rad^2]; it includes slow residuals.
    `frames` are the frames whose difference `off` is used, `squares` are the squared amplitudes of the harmonics of
    each angle [rad^2], and `per_speed` is the prior standard deviation of the slope [rad per (rad per frame)].
    """
    middle = 0.5 * (frames[0] + frames[-1])
    motion = np.polynomial.Polynomial.fit(frames - middle, angles[0][frames], _MOTION).deriv()
    faster = motion(frames - middle)
    apart = faster - faster.mean()
    noise = float(off[frames].var())
    if not float(apart @ apart) > 0 or not noise > 0:
        return np.zeros(batch.stop - batch.start), 0.0
    errors = _marker_errors(angles, squares, frames)
    basis = np.stack([np.ones(len(frames)), apart * per_speed, *errors], axis=1)
    # the noise includes the harmonics, which the coefficients may describe only in part
    covariance = np.linalg.inv(basis.T @ basis / noise + np.diag([0.0, 1.0] + [1.0] * len(errors)))
    slope = per_speed * float(covariance[1] @ (basis.T @ off[frames])) / noise
    usual = per_speed**2 * float(np.mean(apart**2))
    rest = off[frames] - basis @ (covariance @ (basis.T @ off[frames]) / noise)
    variance = float(covariance[1, 1]) * usual + min(_slow_variance(rest), usual)
    return np.asarray(slope * (motion(np.arange(batch.start, batch.stop) - middle) - faster.mean())), variance


def _slow_variance(rest: Floats) -> float:
    """Return the variance of the means of `_FEWEST_FRAMES` residuals [rad^2] in excess of that of white noise.

    The white noise is the variance within these groups of the residuals (n,) [rad].
    """
    count = len(rest) // _FEWEST_FRAMES
    groups = rest[: count * _FEWEST_FRAMES].reshape(count, _FEWEST_FRAMES)
    white = float(groups.var(axis=1, ddof=1).mean())
    return max(float(groups.mean(axis=1).var()) - white / _FEWEST_FRAMES, 0.0)


def _smoothed(
    mean: Floats, variance: Floats, gaps: Floats, change: Floats, common: Floats
) -> tuple[Floats, Floats, float]:
    """Return the most likely zeros and their variances, (batches,), and p [rad per (rad per frame)].

    Between batches, (batches - 1,), `gaps` is the distance in batches, and `change` the squared change of speed.
    `common` is the grid of errors x, in units of the typical uncertainty of a mean.
    """
    unit = math.sqrt(median_of(variance))
    usual = float(change.mean())
    change = change / usual if usual > 0 else change
    trials = [
        (q, p, x)
        for q in unit * _STEPS
        for p in unit * _STEPS[:: 1 if usual > 0 else len(_STEPS)]
        for x in unit * common
    ]

    def variances(q: float, p: float, x: float) -> tuple[Floats, Floats]:
        return variance + x**2, q**2 * gaps + p**2 * change

    best = max(trials, key=lambda t: _filtered(mean, *variances(*t))[2])
    error, step = variances(*best)
    level, spread_, _ = _filtered(mean, error, step)
    for b in range(len(mean) - 2, -1, -1):
        # Rauch, Tung and Striebel's smoother
        gain = spread_[b] / (spread_[b] + step[b])
        level[b] += gain * (level[b + 1] - level[b])
        spread_[b] += gain**2 * (spread_[b + 1] - spread_[b] - step[b])
    return level, spread_, best[1] / math.sqrt(usual) if usual > 0 else 0.0


def _filtered(mean: Floats, variance: Floats, step: Floats) -> tuple[Floats, Floats, float]:
    """Return the filtered zeros, their variances, and the log-likelihood, with a diffuse prior of the first zero."""
    level, left = mean.copy(), variance.copy()
    likelihood = 0.0
    for b in range(1, len(mean)):
        before = left[b - 1] + step[b - 1]
        innovation = mean[b] - level[b - 1]
        total = before + variance[b]
        likelihood -= 0.5 * (math.log(total) + innovation**2 / total)
        level[b] = level[b - 1] + before / total * innovation
        left[b] = before * variance[b] / total
    return level, left, likelihood
