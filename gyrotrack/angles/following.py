"""Following a body through a film: one coarse, unwrapped angle a frame, from rings that show its markers.

The input is a score over all directions, frame by frame: high where the body's markers would coincide with
what is seen. A lock finds angle and speed from some frames at once; then each frame is searched only near
its prediction, so that nothing else of the same colour can take over; after a loss the prediction runs on,
then a new lock is sought.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

LOCK_FRAMES = 24
LONGEST_COAST = 40
REACH = 0.35
"""Half width in rad of the window about a prediction."""


@dataclass(frozen=True)
class Motion:
    """Where a body is: unwrapped angle [rad], step [rad / frame], frames since it was seen."""

    angle: float
    step: float
    missed: int = 0


def find_lock(
    score: Floats, threshold: float, hint: float = 0.0, place: Floats | None = None
) -> tuple[int, Motion] | None:
    """Find the first run of frames whose best directions advance evenly.

    Parameters
    ----------
    score : ndarray, shape (n, columns)
        Score of every direction in consecutive frames.
    threshold : float
        Least score that counts as seen.
    hint : float
        Step in rad a frame that is expected: of steps that differ by whole turns the nearest is taken.
    place : ndarray, shape (n,), optional
        When the frames were taken, in frames of the camera; evenly, if not given.

    Returns
    -------
    (frame, Motion) or None
        The motion at that frame.

    Notes
    -----
    The step w maximises |sum exp(i (theta_k - w k))| over all w in (-pi, pi]: frames in which
    something else is brighter only lower the sum. A lock needs 70 % of the frames that were seen in phase.
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


def _even_advance(angle: Floats, frame: Floats, hint: float) -> Motion | None:
    span = int(frame[-1]) + 1
    phasor = np.exp(1j * angle)

    def power(steps: Floats) -> Floats:
        return np.asarray(np.abs(np.exp(-1j * np.outer(steps, frame)) @ phasor) / len(frame))

    even = bool((frame == np.rint(frame)).all())  # only then do steps that differ by a turn look alike
    steps = np.linspace(-np.pi, np.pi, 16 * span, endpoint=False) + (0.0 if even else hint)
    step, width = float(steps[np.argmax(power(steps))]), float(steps[1] - steps[0])
    for _ in range(3):
        steps = step + np.linspace(-width, width, 21)
        step, width = float(steps[np.argmax(power(steps))]), 0.1 * width
    if even:
        step += 2.0 * np.pi * round((hint - step) / (2.0 * np.pi))
    start = float(np.angle(np.mean(phasor * np.exp(-1j * step * frame))))
    off = np.abs(np.angle(phasor * np.exp(-1j * (start + step * frame))))
    if np.mean(off < 0.25) < 0.7:
        return None
    return Motion(start, step)


def follow(
    score: Floats, motion: Motion, threshold: float, advance: Floats | None = None
) -> tuple[Floats, npt.NDArray[np.bool_], Motion]:
    """Follow a body through consecutive frames from a known motion.

    Parameters
    ----------
    score : ndarray, shape (n, columns)
        Score of every direction.
    motion : Motion
        The prediction for frame 0.
    threshold : float
        Least score that counts as seen.
    advance : ndarray, shape (n,), optional
        Frames of the camera from each frame to the next: more than 1 where frames are missing, 0 before one that
        repeats it, and no whole number where the camera's rate varied.

    Returns
    -------
    angle, seen, motion
        Unwrapped angle (n,) [rad], whether it was seen (n,), and the prediction for frame n. From the frame
        on where the body was missed more than `LONGEST_COAST` times in a row the angles are NaN.
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
    """Blend a prediction with what was seen (alpha-beta filter); the step learns slowly."""
    error = place - motion.angle
    return Motion(motion.angle + 0.6 * error, motion.step + 0.12 * error / (1 + motion.missed), 0)


def _vertex(left: float, middle: float, right: float) -> float:
    """Return the offset of the top of the parabola through three neighbours."""
    bend = left - 2.0 * middle + right
    return 0.0 if bend >= 0.0 else float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5))
