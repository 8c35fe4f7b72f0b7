"""The measurements of one case as rows of the least-squares problem.

An error dt of the start time of a camera causes an error psi'(t) dt of its angles. Apart from the free phase of the
window, this error is c dt with c = alpha (t - mean t), where alpha is the acceleration of the rotor. If the speed is
measured, c = alpha. If the start has the standard uncertainty s, the otherwise white rows of a window have the
covariance 1 + s^2 c c'. The symmetric inverse root A of this covariance whitens the rows. It changes only the
direction u:

    A = 1 - (1 - 1 / sqrt(1 + |s c|^2)) u u',   u = c / |c|.

Rows are in units of the measurement noise: first the polynomial rows of the casing, then of each rotor window, then the
harmonic rows of the casing. Nuisance parameters are always fitted. They are the initial angle of the casing, the phase
of each rotor window, and a constant centre offset, tilt, rolling shutter and motion blur of the camera of the casing.
For an oscillation with measured speeds, the bias of the gyroscope is also a nuisance parameter.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from fitting._criteria import DEFAULT, NOISE, Criteria
from fitting.dynamics._collocation import Path, Sampler
from fitting.dynamics._sensitivities import angles
from fitting.effects._library import NUISANCE
from fitting.effects._mechanism import MAIN
from fitting.inference._angle_noise import (
    AngleNoise,
    estimate_angle_noise,
    estimate_window_noise,
    stated_error_rows,
    stated_harmonic_scale,
)
from fitting.inference._compression import (
    BLOCKS,
    CASING_DEGREE,
    NOISE_ROWS,
    ROTOR_DEGREE,
    Compressed,
    compress,
    cuts_at_steps,
    integrated,
    responses_to_harmonics,
    responses_to_inputs,
)
from fitting.inference._error_modes import mode_columns
from fitting.inference._linear_algebra import block_diagonal, orthonormal
from fitting.inference._oscillation import ROTATION, Motion, Oscillation, motion_of
from fitting.inference._prior import Prior
from fitting.inference._process_noise import (
    FLAT_PRIOR_SIGMA,
    ProcessNoise,
    estimate_process_noise,
    mean_acceleration,
)
from fitting.inference._record import WIDTH, PiecewiseCubics, Record, Samples, initial_speeds, speeds
from fitting.inference._slips import Slip, as_measured, without_slips
from fitting.inference._spectral_lines import (
    SpectralLine,
    line_rows,
    p_value_of_response,
    spectral_lines,
)


@dataclass(frozen=True)
class StartTimeNoise:
    """Whitens the rows of rotor windows with uncertain starts.

    `parts` contain, for each window, its rows, the unit vector u and |s c|.
    """

    parts: tuple[tuple[slice, Array, float], ...]

    @classmethod
    def of(
        cls, windows: Sequence[Compressed], sigma: Sequence[float], first: int, *, angle: bool
    ) -> StartTimeNoise:
        """Return the whitening for windows whose rows begin at `first`, with the uncertainty of each start [s]."""
        parts = []
        for window, s in zip(windows, sigma, strict=False):
            rows = slice(first, first + len(window.z))
            first = rows.stop
            c = start_response(window, angle=angle)
            size = float(np.linalg.norm(c))
            if s > 0 and size > 0:
                parts.append((rows, c / size, s * size))
        return cls(tuple(parts))

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the covariance of the rows."""
        return sum(math.log1p(size**2) for *_, size in self.parts)

    def whitened(self, rows: Array) -> Array:
        """Return A rows."""
        return self._scaled(rows, [1 / np.hypot(1.0, size) for *_, size in self.parts])

    def unwhitened(self, rows: Array) -> Array:
        """Return the rows before they were whitened."""
        return self._scaled(rows, [float(np.hypot(1.0, size)) for *_, size in self.parts])

    def _scaled(self, rows: Array, factors: Sequence[float]) -> Array:
        if not self.parts:
            return rows
        rows = rows.copy()
        for (where, u, _), factor in zip(self.parts, factors, strict=True):
            along = u @ rows[where]
            rows[where] += (factor - 1) * (u * along if rows.ndim == 1 else np.outer(u, along))
        return rows


def start_response(window: Compressed, *, angle: bool) -> Array:
    """Return the response of a window's rows to an error of its start, per second, apart from its free phase.

    Per second of the error, an angle changes by the speed, and a speed changes by the acceleration.
    """
    rate = rate_of_change(window.samples, window.node_times, degree=4 if angle else 3)
    return window.at_nodes(rate - rate.mean() if angle else rate)


def rate_of_change(samples: Samples, times: Array, *, degree: int) -> Array:
    """Return the derivative at times of a polynomial fitted to samples; few samples reduce its degree."""
    # with as many coefficients as samples, the polynomial would follow the noise
    degree = min(degree, (len(samples) - 1) // 2)
    if degree < 1:
        return np.zeros(len(times))
    curve = Polynomial.fit(samples.time, samples.value, degree)
    return np.asarray(curve.deriv()(times))


Array = NDArray[np.float64]

# relative error of I_casing/I_rotor, a parameter of the library
INERTIA_RATIO = "setup.inertia.eps"
_GENERATED_BLOCKS = 20
"""Number of blocks of a generated curve [1]. Chosen: the curve is smooth; a smaller number does not resolve its start,
a larger one costs time."""
_SHORT_WINDOW = 0.25
"""A window of the rotor is a single block if its length, as a share of the casing's record, is below this value [1].
Chosen: the rotor hardly slows down within such a window; a smaller value divides windows needlessly, a larger one
averages changing speeds."""
_WINDOW_BLOCKS = 20
"""Number of blocks of a window of the rotor, if the window is as long as the record of the casing [1]. Chosen: a
smaller number does not resolve the deceleration; with a larger one, each block has few samples."""
_WINDOW_ROWS = 8
"""Smallest number of rows of a rotor window from which correlated noise is estimated [rows]. Chosen: a smaller number
does not separate motion and noise; with a larger one, short windows have no estimate."""
_PERIOD_SAMPLES = 24
"""Smallest number of samples of a block of an oscillation [samples]. Chosen: with a smaller number, no samples remain
for the noise; a larger one gives blocks of several periods at low frame rates."""
_DRIVEN_POINTS = 1000
"""Largest number of approximate speeds that are computed for a driven body, as initial values [1]. Chosen: with fewer,
the response to the input is blurred; with more, each speed is noisy."""
_DRIVEN_SAMPLES = 6
"""Smallest number of samples from which one approximate speed of a driven body is computed [samples]. Chosen: with
fewer, each speed is noisy; with more, the response to the input is blurred."""
_RISE = 0.1
"""Smallest rise of the speed of a driven body, relative to its largest speed [1]. Chosen: a smaller value mistakes
noise for a drive, a larger one overlooks weak drives."""
_INDEPENDENT = 1e-6
"""Smallest relative singular value of independent responses to inputs [1]. Chosen: a smaller value keeps rounding
errors, a larger one drops weak responses."""
SPEED_BLOCKS = 30
"""Number of blocks of a record of smoothed speeds [1]. Chosen: blocks must be long compared with the smoothing; with
more blocks, their noise is correlated; with fewer, they do not resolve the motion."""
SPEED_NOISE_ROWS = 28
"""Number of further polynomials of a block of speeds, which measure the noise [1]. Chosen: twice the number for angles,
because the rows must resolve the smoothing of the speeds; a smaller number understates the noise, a larger one costs
time."""


class Block(NamedTuple):
    """Blocks of an oscillation: length [periods], highest power of the model, lowest power of the noise rows."""

    width: float
    degree: int
    first_noise_row: int


class OscillationBlocks(NamedTuple):
    """The blocks of records with at most `periods` periods.

    Over a block of half width h [rad], cos(x) is almost a polynomial of a degree slightly above h. Its coefficients are
    the Bessel functions J_n(h), which fall steeply beyond n = h. In short records the model includes the third
    harmonic, in long records only the fundamental; in both cases the noise is measured beyond the third harmonic.
    """

    periods: float
    block: Block


_OSCILLATION_BLOCKS = (
    OscillationBlocks(48, Block(1, 15, 16)),
    OscillationBlocks(200, Block(4, 24, 50)),
    OscillationBlocks(math.inf, Block(12, 50, 126)),
)
"""Blocks of an oscillation: largest number of periods in the record, then the `Block` [1]. Chosen: longer records have
longer blocks, which limits the number of rows; still longer blocks need higher degrees, shorter blocks cost time."""


def blocks_of_window(window: Samples, casing: Samples) -> int:
    """Return the number of blocks of a window of the rotor: one if the rotor hardly slows down within it.

    The number depends on the ratio of the lengths of window and casing record, not on the unit of time.
    """
    share = float(np.ptp(window.time)) / max(float(np.ptp(casing.time)), 1e-300)
    return 1 if share < _SHORT_WINDOW else min(round(_WINDOW_BLOCKS * share), BLOCKS)


def _beyond_noise(modes: Array, samples: Samples) -> Array:
    """Return the combinations of error modes that exceed the white noise of all samples at one standard deviation."""
    u, s, _ = np.linalg.svd(modes / samples.sigma[:, None], full_matrices=False)
    return np.asarray(u[:, s > 1.0] * samples.sigma[:, None])


@dataclass(frozen=True, repr=False)
class CaseData:
    """A record, projected once and used for every model.

    `rotor` are the windows of the rotor or, in a chain, the runs of all bodies except the main body (see `Record`).
    `noiseless` states that the values were computed for a planned run: no noise is estimated from them. `free_inertia`
    states that the ratio of the moments of inertia is a parameter of the model, with a prior from their stated
    uncertainties. `slips` are slips of whole turns in the measured angles; record and rows contain the corrected
    angles. The noise depends on `criteria`.
    """

    record: Record
    casing: Compressed
    rotor: tuple[Compressed, ...]
    motion: Motion = ROTATION
    noiseless: bool = False
    free_inertia: bool = False
    slips: tuple[Slip, ...] = ()
    criteria: Criteria = DEFAULT

    def __repr__(self) -> str:
        return f"CaseData, {len(self.casing.operators)} blocks of {self.record!r}"

    @classmethod
    def of(cls, record: Record, criteria: Criteria = DEFAULT) -> CaseData:
        """Project a record after correcting slips of whole turns."""
        record, slips = without_slips(record, criteria)
        angle = record.quantity == "angle"
        driving = record.driving
        modes, of_windows = mode_columns(record.modes, record.casing.time, [w.time for w in record.rotor])
        motion = motion_of(record)
        if motion.is_smooth:
            time = record.casing.time
            casing = compress(
                record.casing,
                degree=CASING_DEGREE,
                angle=None if driving and _reverses(record) else _turning_angle(record),
                blocks=BLOCKS if angle or driving else SPEED_BLOCKS,
                cuts=cuts_at_steps(time, driving) if driving else None,
                driven=responses_to_inputs(time, driving, angle=angle) if driving else None,
                modes=modes,
            )
        else:
            width, degree, first_noise_row = next(
                b for b in _OSCILLATION_BLOCKS if motion.periods <= b.periods
            ).block
            blocks = max(1, round(motion.periods / width))
            most = len(record.casing) // (2 * blocks)
            casing = compress(
                record.casing,
                degree=min(degree, max(3, most)),
                blocks=blocks,
                samples_per_block=_PERIOD_SAMPLES,
                first_noise_row=min(first_noise_row, most),
                modes=modes,
            )
        rotor = tuple(
            compress(
                w,
                degree=min(ROTOR_DEGREE, (len(w) - 1) // 2),
                blocks=_GENERATED_BLOCKS if record.generated else blocks_of_window(w, record.casing),
                noisy=not record.generated,
                noise_rows=NOISE_ROWS if angle else SPEED_NOISE_ROWS,
                modes=own,
            )
            for w, own in zip(record.rotor, of_windows, strict=True)
        )
        return cls(record, casing, rotor, motion, slips=slips, criteria=criteria)

    @property
    def oscillation(self) -> Oscillation | None:
        """The oscillation of the body; None if it turns in one sense."""
        return self.motion if isinstance(self.motion, Oscillation) else None

    def with_criteria(self, criteria: Criteria) -> CaseData:
        """Return the same measured data with other criteria of the noise."""
        if self.has_noise_of(criteria):
            return self._of_same_samples(criteria=criteria)
        made = CaseData.of(as_measured(self.record, self.slips), criteria)
        return replace(made, noiseless=self.noiseless, free_inertia=self.free_inertia)

    def has_noise_of(self, criteria: Criteria) -> bool:
        """Return whether the noise of this recording is the same with other criteria (see `NOISE`)."""
        return all(getattr(criteria, name) == getattr(self.criteria, name) for name in NOISE)

    def with_start_u(self, u: float) -> CaseData:
        """Return the same data with this standard uncertainty [s] of every start without a stated uncertainty."""
        start_sigma = tuple(u if math.isnan(s) else s for s in self.record.start_sigma)
        return self._of_same_samples(record=replace(self.record, start_sigma=start_sigma))

    def with_inertia(self, rotor: float, casing: float, further: Sequence[float] = ()) -> CaseData:
        """Return the same data with other moments of inertia [kg m2]; `further` is for the later bodies of a chain."""
        later = tuple((x, u) for x, (_, u) in zip(further, self.record.further, strict=True))
        return self._of_same_samples(
            record=replace(self.record, I_rotor=rotor, I_casing=casing, further=later)
        )

    def with_free_inertia(self, *, free: bool) -> CaseData:
        """Return the same data for a model with a free, or with a fixed, ratio of the moments of inertia."""
        return self if self.free_inertia == free else self._of_same_samples(free_inertia=free)

    def _of_same_samples(self, **changes: Any) -> CaseData:
        """Return the data with other fields; noise and motion that depend only on the samples are reused."""
        changed = replace(self, **changes)
        kept = _OF_THE_SAMPLES
        if changed.record.I_casing * self.record.I_rotor != self.record.I_casing * changed.record.I_rotor:
            kept = kept - _OF_THE_INERTIA_RATIO
        changed.__dict__.update({k: v for k, v in self.__dict__.items() if k in kept})
        return changed

    def start_columns(self) -> Iterator[tuple[int, Array]]:
        """Yield window and rows of the response to a start error, per second, for starts of unstated uncertainty."""
        first = self.slices["rotor"].start
        for i, (window, s) in enumerate(zip(self.rotor, self.record.start_sigma, strict=False)):
            rows = np.zeros(len(self.z))
            part = start_response(window, angle=self.is_angle)
            rows[first : first + len(part)] = part
            first += len(part)
            if math.isnan(s):
                yield i, self.with_white_angles(rows)

    def with_prior(self, prior: Prior | None) -> CaseData:
        """Return the same data with this prior of the parameters."""
        if prior == self.record.prior:
            return self
        return self._of_same_samples(record=replace(self.record, prior=prior))

    @cached_property
    def prior(self) -> Prior | None:
        """The prior of parameters from another study, and of the ratio of the moments of inertia if it is free."""
        given, (main, *others) = self.record.prior, self.record.bodies
        u = sum(math.hypot(main.relative_u, other.relative_u) for other in others)
        if not self.free_inertia or u == 0 or (given and INERTIA_RATIO in given.names):
            return given
        stated = Prior((INERTIA_RATIO,), (0.0,), ((u**2,),), "moments of inertia")
        return stated if given is None else given.joined(stated)

    @property
    def is_angle(self) -> bool:
        """Whether angles were measured (and not speeds)."""
        return self.record.quantity == "angle"

    @cached_property
    def measured_angle(self) -> Array | None:
        """The angle of the casing [rad], measured or integrated; None if the speeds do not determine the angle.

        The error of an integrated angle is a random walk. If the model has a lack of fit, this error is far smaller
        than the error of the modelled angle.
        """
        return _turning_angle(self.record) if self.is_angle or self.motion.is_smooth else None

    @cached_property
    def angle_cubics(self) -> PiecewiseCubics:
        """Piecewise cubics for smoothing functions at the times of the casing's samples."""
        return PiecewiseCubics(self.record.casing.time)

    @cached_property
    def largest_torque(self) -> float:
        """Largest net torque on a body in the recording [N m], from its mean accelerations over short parts.

        The parts are fiftieths of a run, or sixteenths of the period of an oscillation.
        """
        record, found = self.record, [0.0]
        inertias = [record.I_casing, *(record.inertias[run.samples.state] for run in self.rotor)]
        for inertia, run in zip(inertias, (self.casing, *self.rotor), strict=True):
            samples = run.samples
            if len(samples) > 1:
                part = min(float(np.ptp(samples.time)) / _RUN_PARTS, self.motion.period / _PERIOD_PARTS)
                time = np.arange(samples.time[0], samples.time[-1], part)
                value = np.interp(time, samples.time, samples.value)
                speed = np.gradient(value, time) if self.is_angle else value
                found.append(inertia * float(np.abs(np.gradient(speed, time)).max()))
        return max(found)

    @cached_property
    def harmonic_responses(self) -> Array:
        """Rows of the responses to torques of the first two harmonics of the angle, (rows, columns).

        A torque that is periodic in the angle is not random. Therefore these functions are free when the level of
        process noise or angle noise is estimated.
        """
        return self.casing_rows(self._harmonic_functions)

    @cached_property
    def _harmonic_functions(self) -> Array:
        """The functions of `harmonic_responses` at the samples, (samples, columns)."""
        psi = self.measured_angle
        if psi is None or not self.motion.is_smooth:
            return np.zeros((len(self.record.casing), 0))
        speeds, angles = responses_to_harmonics(self.record.casing.time, psi)
        if not self.is_angle:
            return speeds
        return angles if self._shows_periodic_torque(angles) else angles[:, :0]

    def _shows_periodic_torque(self, responses: Array) -> bool:
        """Return whether the angle contains the response to an angle-dependent torque, in addition to camera harmonics.

        The amplitude of such a response decreases with the square of the speed. The harmonics of a camera are constant
        or increase with the speed.
        """
        camera = self.casing.at_samples(camera_columns(self.casing.samples))[1]
        p_value = p_value_of_response(self.casing, self._camera_rows, camera, responses)
        return p_value < self.criteria.periodic_torque

    @cached_property
    def harmonic_row_responses(self) -> tuple[Array, Array]:
        """For each row of a harmonic: integral of the squared response to an acceleration, and frequency [rad/s].

        A random acceleration of the spectral density S, constant near this frequency, gives the row the variance S
        times the integral. In a block with few turns, the correlation with the polynomial rows is neglected; its
        coefficient is up to 0.4.
        """
        psi = self.measured_angle
        if psi is None or not len(self.casing.harmonic):
            return np.zeros(len(self.casing.harmonic)), np.zeros(len(self.casing.harmonic))
        responses, frequencies = [], []
        k = self.casing.lift.shape[1]
        for where, operator in self.casing.operators:
            t, rows = self.casing.samples.time[where], operator[k:]
            # after an impulse of acceleration, the change of the speed is constant, and the change of the angle
            # increases with time
            later = np.cumsum(rows[:, ::-1], axis=1)[:, ::-1]
            if self.is_angle:
                later = np.cumsum((rows * (t - t[0]))[:, ::-1], axis=1)[:, ::-1] - later * (t - t[0])
            responses.append(later**2 @ np.gradient(t))
            frequencies.append(np.repeat([1.0, 2.0], 2) * abs(np.ptp(psi[where]) / np.ptp(t)))
        scale = self._harmonic_scale if len(self._harmonic_scale) else 1.0
        return np.concatenate(responses) / scale**2, np.concatenate(frequencies)

    @cached_property
    def node_times(self) -> Array:
        """Times at which a smooth model is needed [s], casing first, then each window."""
        return np.concatenate([self.casing.node_times, *(w.node_times for w in self.rotor)])

    @cached_property
    def _times_of_bodies(self) -> tuple[tuple[int, list[int], Array], ...]:
        """For each body, its index in the state, the indices of its runs, and the node times of all these runs."""
        runs = {MAIN: [0]}
        for i, run in enumerate(self.rotor, 1):
            runs.setdefault(run.samples.state, []).append(i)
        times = [self.casing.node_times, *(w.node_times for w in self.rotor)]
        return tuple((state, own, np.concatenate([times[i] for i in own])) for state, own in runs.items())

    @cached_property
    def z(self) -> Array:
        """The measured rows."""
        return self.whitened(
            np.concatenate([self.casing.z, *(w.z for w in self.rotor), self._tail(self.casing.harmonic)])
        )

    @property
    def prior_rows(self) -> int:
        """Number of rows of the prior; they are the last rows, and their measured values are zero."""
        prior = self.prior
        return 0 if prior is None else len(prior.names)

    @cached_property
    def row_count(self) -> int:
        """Number of rows without the rows of harmonics that polynomials of the block represent, which are zero."""
        return len(self.z) - int((~self.casing.harmonic_exists).sum())

    def _tail(self, harmonic: Array) -> Array:
        """Return the rows after the polynomial rows: rows of harmonics, and zeros for the priors."""
        count = self.prior_rows + self._nuisance_priors
        return np.concatenate([harmonic, np.zeros((count, *harmonic.shape[1:]))]) if count else harmonic

    @cached_property
    def _camera_prior(self) -> Array:
        """Standard deviations of the prior of the camera's nuisance functions, in units of `camera_columns`.

        They allow a centre offset up to a third of the radius, a tilt up to 0.6 rad, a shutter time up to a frame, and,
        on film, 5 mrad due to motion blur. Empty if these functions are not fitted.
        """
        if not self.is_angle or not (self.motion.is_smooth or self.record.tracked):
            return np.zeros(0)
        samples = self.casing.samples
        frame = float(np.median(np.diff(samples.time)))
        return np.repeat([_CENTRE, _TILT, 0.5 * frame * largest_speed(samples), _BLUR], 2)

    @property
    def _nuisance_priors(self) -> int:
        """Number of nuisance parameters with a prior: amplitudes of error modes, then amplitudes of the camera."""
        return int(self.mode_columns[0].shape[1]) + len(self._camera_prior)

    @cached_property
    def mode_columns(self) -> tuple[Array, list[Array]]:
        """The error modes at the samples of the casing and of each window, at one standard deviation."""
        times = [w.samples.time for w in self.rotor]
        return mode_columns(self.record.modes, self.casing.samples.time, times)

    @property
    def has_camera_prior(self) -> bool:
        """Whether the nuisance functions of the camera, with their prior, are fitted."""
        return len(self._camera_prior) > 0

    @cached_property
    def angle_noise(self) -> AngleNoise:
        """Correlated angle noise of the casing; white if none is significant, or if speeds were measured.

        Angle noise differs from the motion by its higher frequencies. In an oscillation these frequencies overlap, so
        its angle noise is assumed to be white.
        """
        noise = self._correlated_noise
        known = AngleNoise() if self._excess_angle_noise(noise, (self.casing,)) else noise
        return known.with_stated(self._stated_error)

    @cached_property
    def _correlated_noise(self) -> AngleNoise:
        if not self.is_angle or not self.motion.is_smooth or self.noiseless:
            return AngleNoise()
        return estimate_angle_noise(self.casing, self._nuisance_rows, self.criteria)

    @cached_property
    def rotor_angle_noise(self) -> AngleNoise:
        """Correlated angle noise of the rotor's windows, with the harmonics that tracking states.

        It is white if none is significant, or if it exceeds its limit.
        """
        noise = self._correlated_rotor_noise
        known = AngleNoise() if self._excess_angle_noise(noise, self.rotor) else noise
        if not self.is_angle or self.record.generated:
            return known
        errors = [(w, w.samples.harmonic) for w in self.rotor]
        rows = [stated_error_rows(w, 0.0, 0.0, periodic=h, harmonic=h) for w, h in errors]
        return known.with_stated(block_diagonal(rows))

    def _excess_angle_noise(self, noise: AngleNoise, runs: Sequence[Compressed]) -> float:
        """Return the ratio of correlated to white noise if it exceeds `Criteria.angle_noise_ratio`, else zero."""
        white = [run.scale * float(np.median(run.samples.sigma)) for run in runs]
        ratio = max(noise.sigma, noise.turn_sigma) / min(white, default=math.inf)
        return ratio if ratio > self.criteria.angle_noise_ratio else 0.0

    @cached_property
    def findings(self) -> tuple[str, ...]:
        """Errors of the measurement that the data show without a model, as sentences: slipped turns, excessive noise.

        Noise above its limit is not added to the covariance, because it would explain every lack of fit.
        """
        found = [
            f"{slip.sentence[0].upper()}{slip.sentence[1:]}; the fit corrects it." for slip in self.slips
        ]
        for body, noise, runs in (
            (self.record.body, self._correlated_noise, (self.casing,)),
            (
                " and the ".join(b.name for b in self.record.bodies[1:]),
                self._correlated_rotor_noise,
                self.rotor,
            ),
        ):
            ratio = self._excess_angle_noise(noise, runs)
            if ratio:
                size = max(noise.sigma, noise.turn_sigma)
                found.append(
                    f"The angles of the {body} deviate from a smooth motion by {1e3 * size:.2g} mrad, {ratio:.0f} "
                    "times their white noise: check the tracking and the clock."
                )
        return tuple(found)

    @cached_property
    def _correlated_rotor_noise(self) -> AngleNoise:
        record = self.record
        if (
            not self.is_angle
            or not self.rotor
            or self.noiseless
            or record.generated
            or min(len(w.z) for w in self.rotor) < _WINDOW_ROWS
        ):
            return AngleNoise()
        # random torques act on the rotor only in its joints, but on the casing also from the ground
        mechanism, process = record.mechanism, self.process_noise
        torques = math.sqrt(1 + mechanism.joints_of(mechanism.main))
        levels = {
            b.state: record.I_casing
            / b.inertia
            / torques
            * math.sqrt(mechanism.joints_of(b.part))
            * process.level
            for b in record.bodies[1:]
        }
        level = np.array([levels[run.state] for run in record.rotor]) if record.is_chain else levels[0]
        nuisance = [
            np.concatenate([camera_columns(w.samples), _beyond_noise(modes, w.samples)], axis=1)
            for w, modes in zip(self.rotor, self.mode_columns[1], strict=True)
        ]
        return estimate_window_noise(self.rotor, nuisance, level, process.time)

    @cached_property
    def process_noise(self) -> ProcessNoise:
        """Random acceleration of the casing, independent of any model and moment of inertia."""
        motion = self.casing.at_samples(self.motion.harmonics(len(self.casing.samples)))[0]
        free = np.concatenate([self._nuisance_rows, FLAT_PRIOR_SIGMA * motion], axis=1)
        if not self.is_angle:
            bias = self.casing.at_nodes(self.motion.offsets(len(self.casing.node_times)))
            free = np.concatenate([free, FLAT_PRIOR_SIGMA * bias], axis=1)
        # the acceleration of an oscillation is mainly due to its restoring torque
        known = self.is_angle and self.motion.is_smooth
        typical = mean_acceleration(self.casing) if known else math.inf
        return estimate_process_noise(
            self.casing, free, self.angle_noise.root, angle=self.is_angle, typical=typical
        )

    @cached_property
    def spectral_lines(self) -> tuple[SpectralLine, ...]:
        """Sinusoidal torques that are not treated as noise; none for an oscillation.

        A camera may have systematic errors at some frequencies. Therefore a line in filmed angles that is smaller than
        the noise of one angle is treated as noise.
        """
        if not self.motion.is_smooth:
            return ()
        least = float(np.median(self.record.casing.sigma)) if self.record.tracked else 0.0
        found = spectral_lines(self.casing, self._camera_rows, self.criteria)
        return tuple(line for line in found if line.amplitude > least)

    @cached_property
    def _nuisance_rows(self) -> Array:
        """Polynomial rows of the camera's nuisance functions, and of the responses to lines and to harmonics."""
        lines = line_rows(self.casing, [line.rate for line in self.spectral_lines])
        harmonics = self.casing.at_samples(self._harmonic_functions)[0]
        free = np.concatenate([lines, harmonics, self._driven_rows], axis=1)
        return np.concatenate([self._camera_rows, FLAT_PRIOR_SIGMA * free, self._stated_error], axis=1)

    @cached_property
    def _driven_rows(self) -> Array:
        """Polynomial rows of the responses to the recorded inputs, which are not noise; independent columns."""
        driving = self.record.driving
        if not driving:
            return np.zeros((len(self.casing.z), 0))
        responses = responses_to_inputs(self.casing.samples.time, driving, angle=self.is_angle)
        return orthonormal(self.casing.at_samples(responses)[0], _INDEPENDENT)

    @cached_property
    def _stated_error(self) -> Array:
        """Polynomial rows of the slowly varying error that tracking states, at one standard deviation."""
        if not any(self.record.correlated) or not self.is_angle or not self.motion.is_smooth:
            return np.zeros((len(self.casing.z), 0))
        return stated_error_rows(self.casing, *self.record.correlated, profile=self.record.correlated_profile)

    @cached_property
    def camera_columns(self) -> Array:
        """The camera's nuisance functions at the samples, (samples, 8)."""
        columns = camera_columns(self.casing.samples, blurred=self.record.tracked)
        return self.motion.beyond_motion(columns, self.casing.samples.value)

    @cached_property
    def _camera_rows(self) -> Array:
        """Polynomial rows of error modes and camera, at one standard deviation of their prior."""
        rows = [self.casing.at_samples(self.mode_columns[0])[0]]
        if len(self._camera_prior):
            rows.append(self.casing.at_samples(self.camera_columns)[0] * self._camera_prior)
        elif self.record.gradients:
            rows.append(FLAT_PRIOR_SIGMA * self.casing.at_samples(_gradients(self.casing.samples))[0])
        return np.concatenate(rows, axis=1)

    def whitened(self, rows: Array) -> Array:
        """Return rows with white measurement noise of variance 1.

        The given rows are in units of the white noise of the frames.
        """
        return self.with_white_angles(self.start_time_noise.whitened(rows))

    def with_white_angles(self, rows: Array) -> Array:
        """Return rows whitened by the correlated angle noise alone."""
        inverse = 1 / self._harmonic_scale
        return self._transformed(rows, self.angle_noise.inverse, self.rotor_angle_noise.inverse, inverse)

    def unwhitened(self, rows: Array) -> Array:
        """Return the rows before they were `whitened`."""
        rows = self._transformed(
            rows, self.angle_noise.root, self.rotor_angle_noise.root, self._harmonic_scale
        )
        return self.start_time_noise.unwhitened(rows)

    def _transformed(self, rows: Array, casing: Array, rotor: Array, harmonic: Array) -> Array:
        first, last = self.slices["rotor"].start, self.slices["rotor"].stop
        end = self.slices["harmonic"].stop
        parts = [
            casing @ rows[:first] if len(casing) else rows[:first],
            rotor @ rows[first:last] if len(rotor) else rows[first:last],
            (rows[last:end].T * harmonic).T if len(harmonic) else rows[last:end],
        ]
        changed = len(casing) or len(rotor) or len(harmonic)
        return np.concatenate([*parts, rows[end:]]) if changed else rows

    @cached_property
    def _harmonic_scale(self) -> Array:
        """Standard deviation of the rows of harmonics due to the stated error of the angle; empty without an error."""
        stated = self.record.correlated[3]
        if stated == 0 or not self.is_angle or not self.motion.is_smooth:
            return np.zeros(0)
        return stated_harmonic_scale(self.casing, stated)

    @cached_property
    def start_time_noise(self) -> StartTimeNoise:
        """The effect of the uncertain starts of the rotor's windows on the rows."""
        return StartTimeNoise.of(self.rotor, self.record.start_sigma, len(self.casing.z), angle=self.is_angle)

    @cached_property
    def slices(self) -> dict[str, slice]:
        """The rows of the casing, the other runs ("rotor"), the harmonics and the priors of nuisance parameters."""
        a = len(self.casing.z)
        b = a + sum(len(w.z) for w in self.rotor)
        return {
            "casing": slice(0, a),
            "rotor": slice(a, b),
            "harmonic": slice(b, b + len(self.casing.harmonic)),
            "nuisance_prior": slice(
                b + len(self.casing.harmonic), b + len(self.casing.harmonic) + self._nuisance_priors
            ),
            "smooth": slice(0, b),
        }

    @cached_property
    def initial_speeds(self) -> tuple[Array, Array]:
        """Times and approximate speeds of the bodies, (times, bodies)."""
        if self.record.driving:
            # the approximate speeds are dense, because the response to a step is a small part of a record
            return initial_speeds(self.record, _DRIVEN_POINTS, _DRIVEN_SAMPLES)
        return initial_speeds(self.record, *self.motion.rough)

    @cached_property
    def driven(self) -> bool:
        """Whether a varying input was recorded and the speed increases, which friction cannot cause.

        If there are two bodies, the rotor decides, because the bearing drives the casing.
        """
        if not self.record.driving:
            return False
        speed = np.abs(self.initial_speeds[1][:, self.record.spun.state])
        rise = speed - np.minimum.accumulate(speed)
        return bool(rise.max() > _RISE * speed.max())

    @cached_property
    def speeds(self) -> dict[str, tuple[Array, Array]]:
        """Times and angular velocities of each body, smoothed as in the paper, for figures of merit."""
        record = self.record
        found = {}
        for body in record.bodies:
            parts = [speeds(run, record.quantity, self.smoothing_width) for run in body.series]
            found[body.part] = np.concatenate([t for t, _ in parts]), np.concatenate([v for _, v in parts])
        return found

    @property
    def smoothing_width(self) -> int:
        """Number of points of the running median of `speeds`: 51 as in the paper, at most a sixteenth of a period."""
        most = self.motion.samples_per_period(len(self.record.casing)) / _PERIOD_PARTS
        return min(WIDTH, max(1, int(min(most, WIDTH))) | 1)

    @property
    def n_effective(self) -> float:
        """Number of samples, reduced by their correlation: N / (1 + 2 a^2 T / (sigma^2 dt)) for a slow function."""
        casing = self.casing.n_effective / _correlation(self.casing, self.angle_noise)
        return casing + sum(w.n_effective / _correlation(w, self.rotor_angle_noise) for w in self.rotor)

    @property
    def rest(self) -> tuple[float, int]:
        """Chi-square of the samples orthogonal to all rows, and its degrees of freedom."""
        parts = (self.casing, *self.rotor)
        return sum(p.rest for p in parts), sum(p.rest_dof for p in parts)

    @cached_property
    def nuisance(self) -> Array:
        """Columns of the nuisance parameters, which are always fitted, (rows, columns).

        These are the initial angles of casing and windows, the error modes, and the camera.
        """
        columns = []
        prior = self.slices["nuisance_prior"].start
        modes = self.sample_rows(*self.mode_columns)
        k = modes.shape[1]
        modes[prior : prior + k] = np.eye(k)
        if self.is_angle:
            nodes = len(self.casing.node_times)
            columns.append(self.rows(np.ones(nodes), [np.zeros(len(w.node_times)) for w in self.rotor]))
            for i in range(len(self.rotor)):
                ones = [np.full(len(w.node_times), float(i == j)) for j, w in enumerate(self.rotor)]
                columns.append(self.rows(np.zeros(nodes), ones))
        columns += list(modes.T)
        if self.is_angle:
            if len(self._camera_prior):
                camera = self.casing_rows(self.camera_columns)
                first = prior + k
                camera[first : first + len(self._camera_prior)] = np.diag(1 / self._camera_prior)
                columns += list(camera.T)
        elif self.record.gradients:
            # during the first slow turns, camera errors vary as slowly as the effects of torques
            columns += list(self.casing_rows(_gradients(self.casing.samples)).T)
        else:
            # the zero-rate output of a gyroscope sensor is free; an error of its scale is not distinguishable from
            # larger deflections
            offsets = self.motion.offsets(len(self.casing.node_times))
            columns += [self.rows(offset, []) for offset in offsets.T]
        return np.stack(columns, axis=1) if columns else np.zeros((len(self.z), 0))

    def rows(self, casing: Array, rotor: Sequence[Array]) -> Array:
        """Return the rows of a smooth function given at the nodes of the casing and of each window."""
        return self.whitened(self._rows(casing, rotor))

    def _rows(self, casing: Array, rotor: Sequence[Array]) -> Array:
        parts = [
            self.casing.at_nodes(casing),
            *(w.at_nodes(v) for w, v in zip(self.rotor, rotor, strict=True)),
        ]
        tail = self._tail(np.zeros((len(self.casing.harmonic), *casing.shape[1:])))
        return np.concatenate([*parts, tail])

    def casing_rows(self, values: Array) -> Array:
        """Return the rows of any function given at the samples of the casing (samples, columns)."""
        return self.sample_rows(values, [np.zeros((len(w.samples), values.shape[1])) for w in self.rotor])

    def sample_rows(self, casing: Array, rotor: Sequence[Array]) -> Array:
        """Return the rows of any function given at the samples of the casing and of each window (samples, columns)."""
        polynomial, harmonic = self.casing.at_samples(casing)
        windows = [w.at_samples(values)[0] for w, values in zip(self.rotor, rotor, strict=True)]
        return self.whitened(np.concatenate([polynomial, *windows, self._tail(harmonic)]))

    def observe(self, path: Path, nodes: Array | None = None) -> Array:
        """Return the rows of a solution, or of the derivatives of its states (intervals, nodes, states, columns)."""
        found: dict[int, Array] = {}
        runs = (self.casing, *self.rotor)
        for state, own, times in self._times_of_bodies:
            ends = np.cumsum([len(runs[i].node_times) for i in own])[:-1]
            values = self._observed(path.mesh.sampler(times), path, state, nodes)
            found |= dict(zip(own, np.split(values, ends), strict=True))
        rows = self._rows(found[0], [found[i] for i in range(1, len(runs))])
        return self.whitened(self._projected_by_samples(path, nodes, rows))

    def _observed(self, sampler: Sampler, path: Path, state: int, nodes: Array | None) -> Array:
        if nodes is None:
            if self.is_angle:
                return sampler.integral(*path.angle(path.states[state]))
            return sampler.value(path.y[..., state])
        return angles(sampler, path, state, nodes) if self.is_angle else sampler.value(nodes[:, :, state])

    def _projected_by_samples(self, path: Path, nodes: Array | None, rows: Array) -> Array:
        """Replace the rows of blocks in which the motion is not a polynomial (a kink, or many harmonics)."""
        # such blocks occur in an oscillation, which has many harmonics, and after a step of an input
        everywhere = not self.motion.is_smooth or bool(self.record.driving)
        if not path.kinks and not everywhere:
            return rows
        first = 0
        for state, run in ((MAIN, self.casing), *((w.samples.state, w) for w in self.rotor)):
            k = run.lift.shape[1]
            whole = (
                self._observed(Sampler(path.mesh, run.samples.time), path, state, nodes)
                if everywhere
                else None
            )
            harmonic = self.slices["harmonic"].start
            for i, (where, operator) in enumerate(run.operators):
                t = run.samples.time[where]
                if whole is not None or any(t[0] < time < t[-1] for time in path.kinks):
                    observed = (
                        self._observed(Sampler(path.mesh, t), path, state, nodes)
                        if whole is None
                        else whole[where]
                    )
                    projected = operator @ observed
                    rows[first + i * k : first + (i + 1) * k] = projected[:k]
                    # harmonic rows are orthogonal to polynomials only; this motion is not a polynomial, so its
                    # projections on the harmonics do not vanish
                    rows[harmonic : harmonic + len(operator) - k] = projected[k:]
                harmonic += len(operator) - k
            first += len(run.z)
        return rows


# properties that depend only on the samples
_OF_THE_SAMPLES = frozenset({
    "_correlated_noise", "_correlated_rotor_noise", "angle_noise", "rotor_angle_noise", "findings", "process_noise",
    "mode_columns", "spectral_lines", "measured_angle", "camera_columns", "harmonic_row_responses", "initial_speeds",
    "speeds",
})  # fmt: skip
# properties of the samples that also depend on the share of the random torque on the rotor
_OF_THE_INERTIA_RATIO = frozenset({"_correlated_rotor_noise", "rotor_angle_noise", "findings"})


def with_prior(data: Sequence[CaseData], prior: Prior | None) -> tuple[CaseData, ...]:
    """Return the cases of a joint fit with a prior of their parameters."""
    return tuple(d.with_prior(prior) for d in data)


def with_free_inertia(data: Sequence[CaseData], names: Sequence[str]) -> list[CaseData]:
    """Return the cases for a model with effects of these names, with the prior of a free ratio of inertia."""
    free = INERTIA_RATIO.rpartition(".")[0] in names
    return [d.with_free_inertia(free=free) for d in data]


def _correlation(run: Compressed, noise: AngleNoise) -> float:
    """Return the spectral density of the angle noise at low frequencies, divided by the density of the white noise."""
    samples = run.samples
    if noise.is_white or len(samples.time) < 2:
        return 1.0
    white = (run.scale * float(np.median(samples.sigma))) ** 2 * float(np.median(np.diff(samples.time)))
    turn = float(np.ptp(samples.value) / np.ptp(samples.time)) * noise.turn_time
    return (
        1 + 2 * (noise.sigma**2 * noise.time + noise.turn_sigma**2 * noise.turn_time / (1 + turn**2)) / white
    )


def _reverses(record: Record) -> bool:
    """Return whether the net rotation of a reversing body is less than the share `_ONE_SENSE` of its path."""
    value = record.casing.value
    way = np.diff(value) if record.quantity == "angle" else value[1:] * np.diff(record.casing.time)
    path = float(np.abs(way).sum())
    return abs(float(way.sum())) < _ONE_SENSE * path


_ONE_SENSE = 0.9
"""The harmonics of the angle of a driven body are tested if the ratio of its net rotation to its path is at least this
value [1]. Chosen: a smaller value tests bodies that turn back and forth, a larger one omits bodies that reverse
slightly."""


def _turning_angle(record: Record) -> Array | None:
    """Return the angle for harmonics: measured, or integrated from speeds that are sampled densely enough."""
    if record.quantity == "angle":
        return record.casing.value
    psi = integrated(record.casing.time, record.casing.value)
    resolved = float(np.median(np.abs(np.diff(psi)))) < _LONGEST_STEP
    return psi if resolved and not record.gradients else None


def _gradients(speeds: Samples) -> Array:
    """Return the time derivatives of `camera_columns`, with the angle integrated from the speeds."""
    angle = Samples(speeds.time, integrated(speeds.time, speeds.value), speeds.sigma)
    return np.asarray(np.gradient(camera_columns(angle), speeds.time, axis=0))


CAMERA_COLUMNS = {name: (2 * i, 2 * i + 1) for i, name in enumerate(NUISANCE)}
"""Columns of `camera_columns` that belong to each nuisance effect [1]. Derived: a cosine and a sine of each, in the
order of the library."""
_SMOOTHED = 25
"""Number of samples between the knots of the curve for an approximate speed [samples]. Chosen: a smaller number follows
noise, a larger one blurs the motion."""
_RUN_PARTS = 50
"""Number of parts of a run over which accelerations are averaged for the largest torque [1]. Chosen: a smaller number
understates the torque, a larger one follows noise."""
_PERIOD_PARTS = 16
"""Number of parts of a period of an oscillation over which accelerations are averaged for the largest torque [1].
Chosen: a smaller number understates the torque, a larger one follows noise."""
_CENTRE = 0.15
"""Prior standard deviation of the displacement of a centre, relative to the radius [1]. Chosen: tracked films have
once-per-turn errors of 0.5 to 5 mrad; a smaller value gives biased results for displaced hubs, a larger one absorbs
slow motion."""
_TILT = 0.05
"""Prior standard deviation of the second harmonic of a tilt [rad]. Chosen: it corresponds to a tilt of 26 degrees; a
smaller value gives biased results for oblique films, a larger one absorbs slow motion."""
_BLUR = 5e-3
"""Prior standard deviation of the change of the first harmonic due to motion blur at the largest speed [rad]. Chosen:
the upper end of the once-per-turn errors of tracked films; a smaller value gives biased results for blurred films, a
larger one absorbs slow motion."""
_LONGEST_STEP = 1.0
"""Speeds are integrated to an angle only if the angle changes by at most this value between samples [rad]. Chosen: with
a larger value, harmonics of the angle are not resolved; a smaller one excludes slow sensors."""
_ROUNDING = 1e-7
"""Smallest range of a harmonic of the angle that is more than rounding error [1]. Chosen: a smaller value fits rounding
errors, a larger one drops slowly turning bodies."""


def camera_columns(samples: Samples, *, blurred: bool = False) -> Array:
    """Return the functions of the angle for the nuisance parameters of a camera, (n, 8).

    The columns are cos and sin of the angle, cos and sin of twice the angle, and cos and sin of the angle multiplied by
    the speed and by its square. The speed is in units of the largest speed. Columns are zero if a harmonic has the same
    value in all samples. An example is a pulse once per turn: it contains no information on harmonics of the angle, and
    the sines at the pulses are only rounding errors, which increase with the angle. Only frames are `blurred` by the
    motion; for other samples, the last two columns are zeros.
    """
    psi = samples.value
    knots, speed = _rough_speeds(samples)
    omega = np.interp(samples.time, samples.time[knots], speed) / np.abs(speed).max()
    once, twice = (np.stack([np.cos(m * psi), np.sin(m * psi)], axis=1) for m in (1, 2))
    for pair in (once, twice):
        pair *= (np.abs(pair).max(axis=0) > _ROUNDING) & (np.ptp(pair, axis=0).max() > _ROUNDING)
    blur = omega[:, None] ** 2 * once * blurred
    return np.concatenate([once, twice, omega[:, None] * once, blur], axis=1)


def largest_speed(samples: Samples) -> float:
    """Return the speed by which the columns of the rolling shutter are divided [rad/s]."""
    return float(np.abs(_rough_speeds(samples)[1]).max())


def _rough_speeds(samples: Samples) -> tuple[NDArray[np.int_], Array]:
    width = min(_SMOOTHED, len(samples.value) // 4)
    knots = np.arange(0, len(samples.value), width)
    return knots, np.gradient(samples.value[knots], samples.time[knots])
