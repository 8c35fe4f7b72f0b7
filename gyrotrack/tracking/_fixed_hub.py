"""Whether a body turns about one fixed hub: the displacement of its hub, fitted frame by frame.

A rotation about a hub also explains a part of the change of pictures in which nothing turns about a fixed axis: a block
that moves along a line beside its plot, or several things that move and change their size. The picture that is learnt
about the hub then fits better at a place that changes from frame to frame.
"""

from __future__ import annotations

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
# displacement of a body on an axle in four frames of five, in px, and over the mean radius of the ring. Real films: up
# to 0.7 px; drawn hubs that wobble by 1 to 2 px: 1.8 px; a ball that is thrown again and again: 2.5 px; a block on a
# spring: 3.1 px (2 % of the radius); three bodies of changing size: more than 6 px (9 %)
_DRIFT, _DRIFT_SHARE, _MOST_FRAMES = 2.3, 0.015, 0.8
REFUSED = 2.0  # displacement over this limit from which no body is on an axle


def drift(
    ring: Ring, frames: Sequence[Plane], angle: Floats, area: Area, *, separate: bool
) -> tuple[float, float]:
    """Return the displacement of a body from its circles about a hub [px], and the largest one on an axle [px].

    Four frames of five have a smaller one: a hand or a shadow may disturb the others. It is that of the middle of the
    details of the body, which is determined best: the rotation of a bob far from its hub is not.
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


# error of the angles by the difference of the inner and the outer half of a ring (see `hub_error`) over their standard
# deviation, from which both do not turn as one body. Real discs, drawn rods, bobs and wheels: up to 0.007; double
# pendulums within one ring: 0.037 and 0.074; a block on a spring: 0.11
_RIGID = 0.02


def halves_differ(angle: Floats, error: float) -> float | None:
    """Return the error by the difference of both halves [rad] over the standard deviation of the angle (n,), if large.

    Over more than three turns the error is 0 (see `apart_beyond_harmonics`).
    """
    share = error / max(float(np.std(angle)), 1e-12)
    return share if share > _RIGID else None


# share of the change of brightness that a rotation explains in the frames of the search, less that in the whole film,
# from which it is not about one hub throughout. Real films on an axle: up to 0.07; a drawn pole on a cart: 0.23
_FALLS = 0.15
_FALLEN = 0.2  # ... from which the film is refused


def fallen(searched: float, film: float) -> bool:
    """Return whether the share that rotation explains falls too far for one hub throughout (see `hub_doubt`)."""
    return searched - film > _FALLEN


def hub_doubt(searched: float, film: float) -> str | None:
    """Return a warning if rotation explains clearly less in a whole film than in the frames of the search for the hub.

    `searched` and `film` are both shares of the change of brightness.
    """
    if searched - film < _FALLS:
        return None
    return (
        f"Rotation about the hub explains {100 * searched:.0f} % of the change of brightness in the frames in which "
        f"it was searched for, and {100 * film:.0f} % in the whole film: the hub may move, as on a cart. --from and "
        "--to select a part of the film."
    )


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
