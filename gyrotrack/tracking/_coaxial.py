"""Two bodies about one hub: another rotation explains changes of brightness that the first one leaves unexplained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrotrack._arrays import Floats, Plane
from gyrotrack.tracking._hub_search import Motion, ring_for
from gyrotrack.tracking._registration import every, explained, follow, learn, rolled

_COARSE = 48.0
"""Resolution of the ring in the search [samples per radius]. Chosen: a larger value costs time, a smaller one blurs the
marks of the second body."""
_OF_REST = 0.4
"""A second rotation must explain at least this share of the change of brightness that the first rotation leaves
unexplained [1]. Measured: less than 0.2 for one body with light fixed in the image or a displaced hub."""
_OF_ALL = 0.05
"""A second rotation must explain at least this share of the whole change of brightness [1]. Measured: less than 0.03
for one body with light fixed in the image or a displaced hub."""
_LESS_OF_REST = 0.2
"""Limit that replaces `_OF_REST` if the rotation explains at least `_MORE_OF_ALL` of the whole change of brightness
[1]. Measured: 0.22 for a rendered rotor in a slowly turning casing."""
_MORE_OF_ALL = 0.1
"""If a second rotation explains at least this share of the whole change of brightness, `_LESS_OF_REST` replaces
`_OF_REST` [1]. Measured: 0.13 for a rendered rotor in a slowly turning casing, less than 0.03 for one body."""
_APART = 0.2
"""Two angles belong to different motions if the standard deviation of their difference, divided by the larger of their
two standard deviations, exceeds this value [1]. Measured: up to 0.1 for one body with a displaced hub. What the
rotation leaves unexplained then turns with the body."""
_LEAST_RANGE = 2e-3
"""Smallest range of the angle of a second rotation [rad]. Chosen: a smaller value takes noise for a body, a larger one
overlooks small oscillations."""


@dataclass(frozen=True)
class SecondRotation:
    """Rotation of another part of the picture about the hub of a body."""

    angle: Floats  # shape (n,); angle of this part in each frame, clockwise as seen [rad]
    of_rest: float  # explained share of the change of brightness left by the first body
    of_all: float  # explained share of the whole change of brightness

    def warning(self, first: Floats) -> str:
        """Return the warning, which also states the range of the angles (n,) of the `first` body [rad]."""
        return (
            f"Another part of the picture turns about the same hub: by {np.ptp(self.angle):.3g} rad in "
            f"{len(first)} frames, in which the tracked body turns by {np.ptp(first):.3g} rad. It explains "
            f"{100 * self.of_rest:.0f} % of the change of brightness not explained by the tracked body. "
            "Use --point X,Y to follow a detail of either body, or --colour to follow a body of one colour. "
            "`gyrotrack extract` measures rotor and casing by their coloured markers. A torque law of one body does "
            "not describe bodies that act on each other."
        )


def second_rotation(
    frames: Sequence[Plane],
    motion: Motion,
    hub: tuple[float, float],
    angle: Floats,
    *,
    stretch: tuple[float, float] = (0.0, 0.0),
    separate: bool = True,
) -> SecondRotation | None:
    """Return the rotation of another part of the picture about the hub of a tracked body; None if there is none.

    `angle` (n,) is the angle of the tracked body in the consecutive `frames`, clockwise as seen [rad]. `stretch`
    describes the circles about a tilted axis (see `Ring`). `separate` states whether a fixed picture is part of the
    model of the tracked body.
    """
    ring = ring_for(hub, motion, _COARSE, stretch)
    if ring is None:
        return None
    allowed = ring.inside(motion.area)
    polars = [ring.unwrap(frame) for frame in frames]
    some = slice(None, None, every(len(polars)))
    body = learn(polars[some], angle[some], allowed, ring, separate=separate, plain=True)
    share, _ = explained(polars, angle, body)
    if 1.0 - share < _OF_ALL:
        return None
    rest = [p - body.fixed - rolled(body.body, a / ring.step) for p, a in zip(polars, angle, strict=True)]
    fixed, weight = np.mean(rest, axis=0), (ring.area * allowed).astype(np.float32)
    found = []
    for band in ("low", "high"):
        other = follow(rest, weight, fixed, ring, band=band)
        if np.ptp(other) < _LEAST_RANGE:
            continue
        second = learn(rest[some], other[some], allowed, ring, separate=True, plain=True)
        of_rest, _ = explained(rest, other, second)
        found.append(SecondRotation(other, of_rest, of_rest * (1.0 - share)))
    best = max(found, key=lambda second: second.of_rest, default=None)
    if best is None or not enough(best.of_rest, best.of_all):
        return None
    return best if differs_from(angle, best.angle) else None


def enough(of_rest: float, of_all: float) -> bool:
    """Return whether a second rotation explains enough of the remaining and of the whole change of brightness."""
    clear = of_rest >= _OF_REST and of_all >= _OF_ALL
    return clear or (of_rest >= _LESS_OF_REST and of_all >= _MORE_OF_ALL)


def differs_from(angle: Floats, other: Floats) -> bool:
    """Return whether two angles (n,) [rad] belong to different motions."""
    largest = max(float(np.std(angle)), float(np.std(other)), 1e-12)
    return bool(np.std(other - angle) > _APART * largest)
