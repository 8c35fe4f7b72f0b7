"""Association: one coarse, unwrapped angle per frame.

The input is a score over all angles in each frame, which is large where the markers of the body match the picture. A
search over several frames, called a lock, determines angle and angular rate. Each later frame is searched only near the
predicted angle, so that no other object of the same colour is tracked. When the body is lost, the motion is
extrapolated until a new lock is found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gyrotrack._arrays import Bools, Floats
from gyrotrack._smoothing import median_of

MEMORY = 128
"""Number of recent angles in the fit [frames]. Chosen: a smaller number gives a noisy prediction, a larger one includes
motion that a parabola does not describe."""
FEWEST = 16
"""Smallest number of recent angles for a prediction [frames]. Chosen: more than twice the 7 parameters; a smaller
number predicts badly, a larger one delays the fast search."""
LONGEST_USE = 130
"""Number of frames after which the fit is repeated [frames]. Chosen: about `MEMORY`; a larger number extrapolates too
far, a smaller one costs time."""
LEAST_SCATTER = 1.5e-3
"""Lower limit of the scatter of a coarse angle [rad]. Chosen: a smaller value rejects good angles of quiet films, a
larger one widens the search."""
VIEW_ERROR = 0.05
"""Prior standard deviation of the harmonics of orders 1 and 2 of an oblique view [rad]. Chosen: t^2 / 4 for a tilt t of
0.45 rad; a smaller value ignores tilts, a larger one fits noise."""


class Prediction:
    """Prediction of the angle of a body from its last angles, for a smooth motion seen by an oblique camera.

    The angle at frame x is a + b x + c x^2 + d cos psi + e sin psi + f cos 2 psi + g sin 2 psi, where psi = a + b x + c
    x^2. The matrix X contains these functions at the known frames, and the vector v contains them at the predicted
    frame. s is the scatter about the fit, and P is s^2 times the prior precision of d to g. The standard uncertainty is
    s sqrt(v' (X'X + P)^-1 v).
    """

    def __init__(self) -> None:
        self._frame: Floats = np.zeros(0)
        self._angle: Floats = np.zeros(0)
        self._origin: float | None = None
        self._scale = self._base = self._scatter = 1.0
        self._even: Floats = np.zeros(3)
        self._solution: Floats = np.zeros(7)
        self._inverse: Floats = np.eye(7)

    def add(self, frame: Floats, angle: Floats, seen: Bools) -> None:
        """Add the unwrapped angles of the frames in which the body was seen."""
        self._frame = np.concatenate([self._frame, frame[seen]])[-MEMORY:]
        self._angle = np.concatenate([self._angle, angle[seen]])[-MEMORY:]

    def reset(self) -> None:
        """Discard all angles, after a loss."""
        self._frame, self._angle, self._origin = self._frame[:0], self._angle[:0], None

    def at(self, frame: Floats) -> tuple[Floats, float] | None:
        """Return the predicted angles at some frames, and their largest uncertainty [rad]; None for few angles."""
        if len(self._frame) < FEWEST:
            return None
        if self._origin is None or frame[-1] - self._origin > LONGEST_USE:
            self._fit()
        rows = self._rows(frame)
        spread = np.sqrt(((rows @ self._inverse) * rows).sum(axis=1).max())
        return self._base + rows @ self._solution, self._scatter * float(spread)

    def _fit(self) -> None:
        self._origin, self._base = float(self._frame[-1]), float(self._angle[-1])
        self._scale = float(self._frame[-1] - self._frame[0])
        angle = self._angle - self._base
        self._even, _, _ = _robust(self._parabola(self._frame), angle, np.zeros(3))
        prior = np.array([0.0] * 3 + [1.0 / VIEW_ERROR**2] * 4)
        self._solution, self._inverse, self._scatter = _robust(self._rows(self._frame), angle, prior)

    def _parabola(self, frame: Floats) -> Floats:
        x = (frame - (self._origin or 0)) / self._scale
        return np.stack([np.ones_like(x), x, x * x], axis=1)

    def _rows(self, frame: Floats) -> Floats:
        rows = self._parabola(frame)
        psi = self._base + rows @ self._even
        return np.column_stack([rows, np.cos(psi), np.sin(psi), np.cos(2.0 * psi), np.sin(2.0 * psi)])


def _robust(rows: Floats, value: Floats, prior: Floats) -> tuple[Floats, Floats, float]:
    """Fit a linear model without outliers: coefficients, inverse of the normal matrix, scatter."""
    weight = np.ones(len(value))
    scatter = VIEW_ERROR
    for _ in range(3):
        weighted = rows * weight[:, None]
        inverse = np.linalg.inv(weighted.T @ rows + np.diag(prior) * scatter**2)
        solution = inverse @ (weighted.T @ value)
        left = np.abs(value - rows @ solution)
        before, scatter = scatter, max(1.4826 * median_of(left), LEAST_SCATTER)
        last, weight = weight, (left < 3.0 * scatter).astype(np.float64)
        if np.array_equal(weight, last) and (scatter == before or not prior.any()):
            break
    return solution, np.asarray(inverse, dtype=np.float64), scatter


LOCK_FRAMES = 24
"""Number of frames that are scored together until a body is found [frames]. Chosen: a smaller number locks to other
objects, a larger one needs a uniform speed for longer."""
LONGEST_COAST = 40
"""Number of frames without the body after which its prediction is no longer trusted [frames]. Chosen: a smaller number
loses turns behind an obstacle, a larger one follows a wrong motion."""
REACH = 0.35
"""Half width of the search window about a prediction [rad]. Chosen: a smaller value loses bodies that change their
speed, a larger one finds other objects."""


@dataclass(frozen=True)
class Motion:
    """Motion of a body: unwrapped angle [rad], step [rad / frame], frames since it was last seen."""

    angle: float
    step: float
    missed: int = 0


def find_lock(
    score: Floats, threshold: float, hint: float = 0.0, place: Floats | None = None
) -> tuple[int, Motion] | None:
    """Find the first run of frames in which the angle of the largest `score` (n, columns) advances steadily.

    The step w maximises |sum exp(i (theta_k - w k))| over all w in (-pi, pi]; frames in which another object is
    brighter only reduce the sum. A lock requires that 70 % of the frames above the threshold are in phase. Among steps
    that differ by whole turns, the step nearest to `hint` [rad / frame] is chosen. `place` (n,) are times in frame
    periods.
    """
    columns = score.shape[1]
    best = np.argmax(score, axis=1)
    seen = score[np.arange(len(score)), best] > threshold
    angle = 2.0 * np.pi * best / columns
    when = np.arange(len(score), dtype=np.float64) if place is None else place
    for start in range(0, max(len(score) - 5, 1), 6):
        chunk = slice(start, min(start + LOCK_FRAMES, len(score)))
        use = np.flatnonzero(seen[chunk])
        if len(use) < min(6, max(len(score) // 2, 3)):
            continue
        motion = _even_advance(angle[chunk][use], when[chunk][use] - when[start], hint)
        if motion is not None:
            return start, motion
    return None


_IN_PHASE = 0.25
"""Largest deviation from a uniform advance of an angle that is in phase with this advance [rad]. Chosen: a smaller
value rejects noisy angles, a larger one accepts random angles."""
_LOCKED = 0.7
"""Smallest share of the angles in phase with a uniform advance [1]. Chosen: a smaller value locks to other objects, a
larger one fails with occlusions."""


def _even_advance(angle: Floats, frame: Floats, hint: float) -> Motion | None:
    span = int(frame[-1]) + 1

    def power(steps: Floats) -> Floats:
        phase = angle - np.outer(steps, frame)
        return np.asarray(np.hypot(np.cos(phase).sum(axis=1), np.sin(phase).sum(axis=1)))

    even = bool(
        (frame == np.rint(frame)).all()
    )  # steps that differ by a turn are equivalent at whole frames only
    steps = np.linspace(-np.pi, np.pi, 16 * span, endpoint=False) + (0.0 if even else hint)
    step, width = float(steps[np.argmax(power(steps))]), float(steps[1] - steps[0])
    for _ in range(3):
        steps = step + np.linspace(-width, width, 21)
        step, width = float(steps[np.argmax(power(steps))]), 0.1 * width
    if even:
        step += 2.0 * np.pi * round((hint - step) / (2.0 * np.pi))
    start = float(np.angle(np.mean(np.exp(1j * (angle - step * frame)))))
    off = np.abs(np.angle(np.exp(1j * (angle - (start + step * frame)))))
    if np.mean(off < _IN_PHASE) < _LOCKED:
        return None
    return Motion(start, step)


def follow(
    score: Floats, motion: Motion, threshold: float, advance: Floats | None = None
) -> tuple[Floats, Bools, Motion]:
    """Track a body through frames with a `score` (n, columns); `motion` is its predicted motion at frame 0.

    `advance` (n,) is the number of frame periods of the camera from the previous frame to each frame. It is more than 1
    after missing frames, 0 for a repeated frame, and not an integer if the rate varied. The results are the unwrapped
    angles (n,) [rad], a mask of the frames in which the body was seen, and the prediction for frame n. After
    `LONGEST_COAST` frames without the body the angles are NaN.
    """
    count, columns = score.shape
    scale = columns / (2.0 * np.pi)
    angle = np.full(count, np.nan)
    seen = np.zeros(count, dtype=np.bool_)
    for k in range(count):
        if motion.missed > LONGEST_COAST:
            break
        reach = int(np.ceil((REACH + 0.01 * motion.missed) * scale))
        middle = round(motion.angle * scale)
        window = score[k].take(np.arange(middle - reach, middle + reach + 1), mode="wrap")
        top = int(window.argmax())
        if window[top] > threshold and 0 < top < 2 * reach:
            place = (middle - reach + top + _vertex(window[top - 1], window[top], window[top + 1])) / scale
            motion = _corrected(motion, place)
            angle[k], seen[k] = place, True
        else:
            angle[k] = motion.angle
            motion = replace(motion, missed=motion.missed + 1)
        frames = 1.0 if advance is None else float(advance[k])
        motion = replace(motion, angle=motion.angle + frames * motion.step)
    return angle, seen, motion


def _corrected(motion: Motion, place: float) -> Motion:
    """Update a prediction by an observation (alpha-beta filter)."""
    error = place - motion.angle
    return Motion(motion.angle + 0.6 * error, motion.step + 0.12 * error / (1 + motion.missed), 0)


def _vertex(left: float, middle: float, right: float) -> float:
    """Return the offset of the vertex of the parabola through three neighbouring values."""
    bend = left - 2.0 * middle + right
    return 0.0 if bend >= 0.0 else float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5))


def net_turn(angle: Floats) -> float:
    """Return the difference of the last and the first known value of an unwrapped angle with gaps (NaN)."""
    known = angle[np.isfinite(angle)]
    return float(known[-1] - known[0]) if len(known) > 1 else 0.0


SENSE_TURN = 0.5
"""Smallest net turn that determines the sense of rotation [rad]. Chosen: a smaller value takes drift for a rotation, a
larger one ignores short films."""


def find_rotation_sense(turns: dict[str, float], given: int | None) -> int:
    """Return the factor (+1 or -1) that makes the angles increase: `given`, or the sign of the `turns` as seen [rad].

    The turn of the casing is used first, because the casing never turns by half a turn between frames, then the turn of
    the rotor. The default is clockwise, as in the films of the paper (V. Tanrıverdi and A. Erbasan, arXiv:2605.06700).
    """
    if given is not None:
        return given
    for name in ("casing", "rotor"):
        if abs(turns.get(name, 0.0)) > SENSE_TURN:
            return 1 if turns[name] > 0 else -1
    return -1


def unfold(angle: Floats, sense: int) -> tuple[Floats, bool]:
    """Resolve the aliasing of a body that seems to turn against the sense, by one turn per frame.

    A rotation by w between frames is indistinguishable from one by w - 2 pi. Friction drives both bodies in the same
    sense, so the rotor has the sense of the casing. The results are the angle, and whether it was changed.
    """
    turn = net_turn(angle)
    steps = max(int(np.isfinite(angle).sum()) - 1, 1)
    if turn * sense >= 0 or abs(turn) / steps < 0.02:
        return angle, False
    return angle + sense * 2.0 * np.pi * np.arange(len(angle)), True
