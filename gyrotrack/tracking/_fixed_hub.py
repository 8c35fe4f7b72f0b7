"""Whether a body turns about one fixed hub: the displacement of its hub, fitted frame by frame.

A rotation about a hub also explains a part of the change of pictures in which nothing turns about a fixed axis: a block
that moves along a line beside its plot, or several things that move and change their size. The picture that is learnt
about the hub then fits better at a place that changes from frame to frame.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from gyrotrack.tracking._registration import Area, Ring, Template, learn, register

Floats = npt.NDArray[np.float64]
Plane = npt.NDArray[np.uint8]

_FRAMES = 40  # frames in which the displacement is fitted
# largest step of an iteration per axis [px], number of iterations, and the step that ends them: the displacement may
# exceed the width of the details
_STEP, _STEPS, _SETTLED = 2.0, 8, 0.05
# rms displacement of the hub of a body on an axle: in px, and over the mean radius of the ring. Real films: 0.1 to 1.1
# px; drawn hubs that wobble by 1 to 2 px: 1.2 px; a drawn block on a spring: 3.3 px (2 % of the radius); three drawn
# bodies of changing size: 5.8 px (9 %)
_DRIFT, _DRIFT_SHARE = 2.5, 0.015
REFUSED = 2.0  # displacement over this limit from which no body is on an axle


def drift(
    ring: Ring, frames: Sequence[Plane], angle: Floats, area: Area, *, separate: bool
) -> tuple[float, float]:
    """Return the rms displacement of a body from its circles about a hub [px], and the largest one on an axle [px].

    It is that of the middle of its details, which is determined best: the rotation of a bob far from its hub is not.
    `angle` (n,) are the angles of the body in the frames, clockwise as seen [rad].
    """
    use = np.unique(np.linspace(0, len(frames) - 1, _FRAMES).astype(int))
    pictures, turns = [frames[k] for k in use], angle[use]
    shown = [ring.unwrap(picture) for picture in pictures]
    template = learn(shown, turns, ring.inside(area), ring, separate=separate, plain=True)
    found = [displaced(p, template, float(a)) for p, a in zip(pictures, turns, strict=True)]
    middle = _middle_of(template)
    shift = np.array([s + middle(a) - middle(start) for (a, s), start in zip(found, turns, strict=True)])
    # 1.4826 times the median deviation: frames that a hand or a shadow disturbs do not count
    off = np.median(np.abs(shift - np.median(shift, axis=0)), axis=0)
    limit = max(_DRIFT, _DRIFT_SHARE * 0.5 * (ring.inner + ring.outer))
    return 1.4826 * math.hypot(*off), limit


def _middle_of(template: Template) -> Callable[[float], Floats]:
    """Return the place (x, y) [px], from the hub, of the middle of the details of a body that is turned by an angle."""
    ring = template.ring
    weight = np.gradient(template.body, axis=0) ** 2 + np.gradient(template.body, axis=1) ** 2
    weight = weight * template.allowed * ring.area
    middle = complex(
        np.sum(weight * ring.radius[:, None] * np.exp(1j * ring.angle)) / max(np.sum(weight), 1e-12)
    )

    def place(angle: float) -> Floats:
        turned = middle * np.exp(1j * angle)
        return np.array([turned.real, turned.imag])

    return place


def displaced(
    picture: Plane, template: Template, angle: float, step: float = _SETTLED
) -> tuple[float, Floats]:
    """Return the angle of a body in a picture [rad] and the displacement (x, y) of its hub [px], from a rough angle.

    The iterations end at a change of the displacement below `step` [px].
    """
    shift = np.zeros(2)
    for _ in range(_STEPS):
        pose = register(template.ring.unwrap(picture, tuple(shift)), template, angle, move=True)
        change = np.clip(pose.shift, -_STEP, _STEP)
        shift, angle = shift + change, pose.angle
        if np.abs(change).max() < step:
            break
    return angle, shift
