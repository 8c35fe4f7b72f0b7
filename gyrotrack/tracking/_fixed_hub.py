"""Test whether a body turns about one fixed hub: the displacement of its hub is fitted frame by frame.

Some films show no rotation about a fixed axis, but rotation about a hub explains a part of the change. Examples are a
block that moves along a line beside a moving plot, and several objects that move and change their size. The template
about the hub then fits better at a position that changes from frame to frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from gyrotrack._arrays import Floats, Plane
from gyrotrack.tracking._registration import Area, Ring, Template, learn, register

_FRAMES = 40
"""Number of frames in which the displacement is fitted [frames]. Chosen: a smaller number gives an uncertain quantile,
a larger one costs time."""
_STEP = 2.0
"""Largest step of an iteration per axis [px]. Chosen: a smaller value needs more iterations, a larger one leaves the
range of the linear model."""
_STEPS = 8
"""Largest number of iterations [iterations]. Chosen: 8 steps of 2 px reach 16 px, beyond the width of the details; a
smaller number stops early, a larger one costs time."""
_SETTLED = 0.05
"""Step that ends the iterations [px]. Chosen: a larger value stops early, a smaller one costs time."""
_DRIFT = 2.3
"""Largest displacement of a body on an axle, in four frames of five [px]. Measured: up to 0.7 px in real films, 1.8 px
for drawn hubs that wobble by 1 to 2 px, 2.5 px for a ball that is thrown repeatedly, 3.1 px for a block on a spring."""
_DRIFT_SHARE = 0.015
"""Largest displacement of a body on an axle, relative to the mean radius of the ring [1]. Measured: 0.02 for a block on
a spring, 0.09 for three bodies of changing size."""
_MOST_FRAMES = 0.8
"""Quantile of the displacements of a body that is compared with `_DRIFT` and `_DRIFT_SHARE` [1]. Chosen: a larger value
is dominated by bad frames, a smaller one hides short motions."""
REFUSED = 2.0
"""Displacement divided by its limit, above which a body is not on an axle [1]. Chosen: a smaller value refuses wobbling
hubs, a larger one measures bodies that translate."""


def drift(
    ring: Ring, frames: Sequence[Plane], angle: Floats, area: Area, *, separate: bool
) -> tuple[float, float]:
    """Return the displacement of a body from a rotation about a hub [px], and the limit for a body on an axle [px].

    The displacement is the 80 % quantile over the frames, because a hand or a shadow may disturb some frames. It is
    measured at the middle of the details of the body, where it is determined best, even for a bob far from its hub.
    `angle` (n,) are the angles of the body in the frames, clockwise as seen [rad].
    """
    use = np.unique(np.linspace(0, len(frames) - 1, _FRAMES).astype(int))
    pictures, turns = [frames[k] for k in use], angle[use]
    shown = [ring.unwrap(picture) for picture in pictures]
    template = learn(shown, turns, ring.inside(area), ring, separate=separate, plain=True)
    found = [displaced(p, template, float(a)) for p, a in zip(pictures, turns, strict=True)]
    middle = _middle_of(template)
    shift = np.array([s + middle(a) - middle(start) for (a, s), start in zip(found, turns, strict=True)])
    off = np.hypot(*(shift - np.median(shift, axis=0)).T)
    limit = max(_DRIFT, _DRIFT_SHARE * 0.5 * (ring.inner + ring.outer))
    return float(np.quantile(off, _MOST_FRAMES)), limit


_RIGID = 0.02
"""The two halves of a ring do not turn as one body if the error of the angles due to their difference (`hub_error`),
divided by the standard deviation of the angles, exceeds this value [1]. Measured: up to 0.007 for real discs, drawn
rods, bobs and wheels, 0.037 and 0.074 for double pendulums within one ring, 0.11 for a block on a spring."""


def halves_differ(angle: Floats, error: float) -> float | None:
    """Return the `error` from the two halves [rad], divided by the standard deviation of the angle (n,); None if small.

    Over more than three turns the error is 0 (see `apart_beyond_harmonics`).
    """
    share = error / max(float(np.std(angle)), 1e-12)
    return share if share > _RIGID else None


_FALLS = 0.15
"""The hub is not fixed if the share of the change that rotation explains in the frames of the search exceeds the share
in the whole film by more than this value [1]. Measured: up to 0.07 for real films on an axle, 0.23 for a drawn pole on
a cart."""
_FALLEN = 0.2
"""Decrease of the explained share, as for `_FALLS`, above which the film is refused [1]. Measured: 0.23 for a public
film of a pole on a cart, up to 0.07 for real films on an axle."""


def fallen(searched: float, film: float) -> bool:
    """Return whether the share explained by rotation decreases too much for a fixed hub (see `hub_doubt`)."""
    return searched - film > _FALLEN


def hub_doubt(searched: float, film: float) -> str | None:
    """Return a warning if rotation explains clearly less in a whole film than in the frames of the search for the hub.

    `searched` and `film` are explained shares of the change of brightness.
    """
    if searched - film < _FALLS:
        return None
    return (
        f"Rotation about the hub explains {100 * searched:.0f} % of the change of brightness in the frames in which "
        f"it was searched for, and {100 * film:.0f} % in the whole film: the hub may move, as on a cart. --from and "
        "--to select a part of the film."
    )


def _middle_of(template: Template) -> Callable[[float], Floats]:
    """Return a function of the angle: the position (x, y) of the middle of a body's details from the hub [px]."""
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
