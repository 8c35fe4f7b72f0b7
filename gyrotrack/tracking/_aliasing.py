"""Temporal aliasing: different rotations that are consistent with the same film.

A picture of a body with an n-fold symmetry repeats after a period p = 2 pi / n. Frames determine the rotation per frame
only up to multiples of p: if a rotation by d per frame describes the film, d - p does as well. Tracking by continuity
selects the smaller of the two rotations in the first frames. A body that turns by more than p / 2 per frame therefore
seems to turn backwards, and its apparent speed grows while it slows down.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from gyrotrack._arrays import Floats, Integers
from gyrotrack.tracking._registration import TURN, Template, rolled

_MOST_FOLD = 48
"""Largest order of symmetry that is considered [1]. Chosen: a larger value takes fine texture for a symmetry, a smaller
one overlooks wheels with many spokes."""
_ALIKE = 0.5
"""The other rotation is tried if the correlation between a body's picture and the same picture rotated by a period is
at least this value [1]. Chosen: a smaller value tries more rotations, which costs time; a larger one overlooks an
alias."""
_FAST = 0.25
"""Smallest turn per frame, in periods, for which the other rotation is tried [1]. Chosen: if the motion is slower, the
other rotation is implausibly fast; a smaller value adds needless warnings, a larger one overlooks aliases."""
_EQUAL = 0.02
"""Smallest difference of the explained shares of two rotations that decides between them [1]. Chosen: with a smaller
value, noise decides; with a larger one, the change of speed decides even if the pictures are clear."""
_STEADY = 0.02
"""Smallest relative change of the speed that counts as speeding up or slowing down [1]. Chosen: with a smaller value,
noise decides; a larger one leaves slow decays undecided."""


class Alias(NamedTuple):
    """The selected rotation, and the warning if the film allows another rotation."""

    angle: Floats
    warning: str | None


def symmetries(template: Template) -> list[int]:
    """Return the orders n > 1 of approximate rotational symmetry (by 2 pi / n) of a template, largest first."""
    ring = template.ring
    body = template.body - template.body.mean(axis=1, keepdims=True)
    weight = ring.area.astype(np.float64)
    energy = float(np.sum(weight * body**2))
    if energy <= 0:
        return []
    orders = range(min(_MOST_FOLD, ring.columns // 8), 1, -1)
    return [
        n for n in orders if float(np.sum(weight * body * rolled(body, ring.columns / n))) > _ALIKE * energy
    ]


_ONE_WAY = 0.95
"""Smallest share of the steps in one sense for which another rotation is tried [1]. Chosen: an oscillation has no
alternative; a smaller value tries another rotation for an oscillation, a larger one leaves noisy rotations aliased."""


def unaliased(
    angle: Floats, frame: Integers, template: Template, explained: Callable[[Floats], float]
) -> Alias:
    """Select one of the rotations that are consistent with a film.

    `explained` returns the share of the changes of brightness that a rotation explains. The rotation with the larger
    share is selected. If the shares are equal, the rotation that slows down is selected, because a free body slows
    down. If both rotations are steady, the slower one is selected, with a warning. Whole periods per frame are
    subtracted first, unless this reduces the explained share. `angle` (n,) are angles tracked by continuity,
    counter-clockwise [rad], in the frames `frame`; the picture `template` was averaged at these angles.
    """
    steps = np.diff(angle) / np.diff(frame)
    usual = float(np.median(steps))
    sense = math.copysign(1.0, usual)
    # an oscillation has no alternative
    if np.mean(sense * steps > 0) < _ONE_WAY:
        return Alias(angle, None)
    orders = symmetries(template)
    # the first step may be too large by a whole period
    for period in (TURN / n for n in orders if abs(usual) > TURN / n):
        slower = angle - sense * math.floor(abs(usual) / period) * period * (frame - frame[0])
        if explained(slower) > explained(angle) - _EQUAL:
            return unaliased(slower, frame, template, explained)
    for n in [*orders, 1]:
        period = TURN / n
        if abs(usual) < _FAST * period or abs(usual) > period:
            continue
        other = angle - sense * period * (frame - frame[0])
        gain = explained(other) - explained(angle)
        if gain > _EQUAL:
            return Alias(other, None)
        if gain < -_EQUAL:
            continue
        slows, other_slows = (_growth(a, frame) < -_STEADY for a in (angle, other))
        fastest = float(np.quantile(np.abs(steps), 0.99))
        if not other_slows or (slows and fastest < 0.5 * period):
            # two steady rotations cannot be distinguished
            if fastest > 0.5 * period or not (slows or other_slows):
                return Alias(angle, _warning(angle, other, frame, period, chosen="that is slower at first"))
            continue
        return Alias(other, _warning(other, angle, frame, period, chosen="that slows down"))
    return Alias(angle, None)


_FEWEST = 10
"""Number of angles above which a change of the speed is determined [frames]. Chosen: with fewer, noise decides; with
more, short films remain aliased."""


def slowing(angle: Floats, frame: Integers) -> Floats | None:
    """Return the rotation with one turn per frame less if it slows down while `angle` speeds up; None otherwise.

    This applies to markers, for which only whole turns are ambiguous.
    """
    usual = float(np.median(np.diff(angle) / np.diff(frame))) if len(angle) > _FEWEST else 0.0
    if not _FAST * TURN < abs(usual) < TURN:
        return None
    other = angle - math.copysign(TURN, usual) * (frame - frame[0])
    return other if _growth(angle, frame) > _STEADY and _growth(other, frame) < -_STEADY else None


def doubtful(taken: Floats, other: Floats, frame: Integers, *, chosen: str = "named first") -> str:
    """Return the warning that a film of markers is consistent with the rotation `other` as well as with `taken`."""
    remedy = "Film with a higher frame rate, or state the sense of rotation in the profile (`sense`)."
    return _warning(taken, other, frame, TURN, chosen=chosen, remedy=remedy)


def _ends(angle: Floats, frame: Integers) -> tuple[float, float]:
    """Return the mean turn per frame in the first and in the last fifth of the angles."""
    fifth = max(2, len(angle) // 5)
    first, last = (
        float((angle[b] - angle[a]) / (frame[b] - frame[a])) for a, b in ((0, fifth), (-1 - fifth, -1))
    )
    return first, last


def _growth(angle: Floats, frame: Integers) -> float:
    """Return the relative change of speed from the first to the last fifth of the angles; NaN if the sense changes."""
    first, last = _ends(angle, frame)
    return math.nan if first * last <= 0 else abs(last) / abs(first) - 1.0


_REMEDY = "Film with a higher frame rate, or mark the body on one side."


def _warning(
    taken: Floats,
    other: Floats,
    frame: Integers,
    period: float,
    *,
    chosen: str,
    remedy: str = _REMEDY,
) -> str:
    def words(angle: Floats) -> str:
        first, last = (math.degrees(x) for x in _ends(angle, frame))
        return f"{first:+.0f} to {last:+.0f} degrees per frame"

    alike = (
        ""
        if period == TURN
        else f"The body looks the same when rotated by {math.degrees(period):.0f} degrees. "
    )
    return (
        f"{alike}Two rotations fit the film: {words(taken)}, and {words(other)}. The rotation "
        f"{chosen} is used. {remedy}"
    )
