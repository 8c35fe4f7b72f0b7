"""The slant of the view: tilt, perspective, and an axis that lies beside the disc, for each body of a film."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from gyrotrack.angles.candidates import Candidate
from gyrotrack.angles.joining import BodyAngles
from gyrotrack.geometry.centre import LEAST_SIGMA, CentrePath
from gyrotrack.geometry.refining import refine_centre
from gyrotrack.geometry.tilt import NO_FLATTENING, Flattening
from gyrotrack.pipeline.views import View
from gyrotrack.profile import Profile

Floats = npt.NDArray[np.float64]

BLOCK_ERROR, LIGHT_ERROR = 0.09, 0.8e-3
"""Errors by place in the picture where no body turns enough to show them, root mean squares over films of many
kinds in which one does: of the encoder's blocks in px, of uneven light in rad."""


def slanted(
    centre: CentrePath, views: dict[str, View], profile: Profile, *, marked: bool
) -> tuple[CentrePath, dict[str, Flattening]]:
    """Find the slant of the view on each body's orbits; a marked centre is then corrected by the markers' radii."""
    if not profile.tilt_correction:
        return centre, dict.fromkeys(views, NO_FLATTENING)
    flat = _flattening(centre, views)
    if not marked:
        return centre, flat
    better = refine_centre(
        centre, (r for name, look in views.items() for r in look.radii(centre.centre, flat[name]))
    )
    return better, _flattening(better, views)


def _flattening(centre: CentrePath, views: dict[str, View]) -> dict[str, Flattening]:
    """Find the slant on each body's orbits; a body that passes an arc only is given that of one that goes round."""
    flat = {name: look.flattening(centre.centre) for name, look in views.items()}
    known = [name for name, look in views.items() if any(m in flat[name].offset for m in look.coloured)]
    if not known:
        return flat
    look, lender = views[known[0]], flat[known[0]]
    p, q = _beyond(np.array([lender.p, lender.q]), usual_error_by_place(look) / look.radius)
    lender = replace(lender, p=float(p), q=float(q))
    shift = _beyond(lender.shift(look.coloured), usual_error_by_place(look, len(look.coloured)))
    size = float(np.hypot(np.hypot(*shift), LEAST_SIGMA))
    return {
        name: f if f.offset else views[name].lent(centre.centre, lender, shift, size)
        for name, f in flat.items()
    }


def usual_error_by_place(look: View, markers: int = 1) -> float:
    """Return the usual error by place in px of the mean of so many markers: light pulls all of them alike."""
    return float(np.hypot(BLOCK_ERROR / np.sqrt(markers), LIGHT_ERROR * look.radius))


def _beyond(found: Floats, error: float) -> Floats:
    """Return what is left of a vector, (2,), when as much of its square as errors would make is taken off."""
    return np.asarray(found * max(1.0 - 2.0 * error**2 / float(found @ found + 1e-12), 0.0))


def error_by_place(look: View, flat: Flattening, body: BodyAngles) -> float:
    """Return the errors by place in px that a body has learnt, without the swing that perspective makes of them.

    Where they are mostly swing, what is left is known no better than the usual error.
    """
    learnt, swing = body.place_error * look.radius, axis_beside(look, flat, body)
    left = float(np.sqrt(max(learnt**2 - 0.5 * float(swing @ swing), 0.0)))
    return max(left, min(learnt, usual_error_by_place(look)))


def axis_beside(look: View, flat: Flattening, body: BodyAngles) -> Floats:
    """Return how far in px the angles of a fast body say that its axis lies beside where its radii do, (2,), y up.

    Both err by place; what such errors would make is taken off.
    """
    off = [z * look.radius for m, z in body.axis_off.items() if m in flat.offset]
    if not off:
        return np.zeros(2)
    error = usual_error_by_place(look, len(off))
    return _beyond(np.mean([(z.real, z.imag) for z in off], axis=0), np.sqrt(2.0) * error)


def in_perspective(
    centre: CentrePath, views: dict[str, View], flat: dict[str, Flattening], rotor: BodyAngles
) -> Flattening:
    """Return the slant of the casing's orbit, with what is perspective in it told from an axis that lies beside.

    A circle about e seen in perspective has its near half larger: its radius swings once a turn, as if about a + e,
    with a growing as the square of the radius, while its angles are those about e. The rotor's markers turn fast, so
    that their angles show its e. The casing's is expected to be the same within its own size, since both come from
    heights below the disc, and is measured by its radius less the perspective. All of these err by place.
    """
    own, look, lender = flat["casing"], views["rotor"], flat["rotor"]
    beside = axis_beside(look, lender, rotor)
    if not beside.any() or not own.offset or not any(m in lender.offset for m in look.coloured):
        return own
    error = usual_error_by_place(look, len(rotor.axis_off))
    axis = _beyond(lender.shift(look.coloured) + beside, error)
    more = (views["casing"].radius / look.radius) ** 2
    swing, size = -more * beside, float(np.hypot(np.hypot(*axis), error))
    if own.doubt:
        slant = replace(lender, p=own.p, q=own.q)
        return views["casing"].lent(centre.centre, slant, axis + swing, size).moved(-swing)
    sure = size**2 / (size**2 + usual_error_by_place(look) ** 2 * (1.0 + more**2))
    shift = own.shift(own.offset)
    doubt = {name: (1.0 - sure) * size**2 * np.eye(2) for name in own.offset}
    return replace(own.moved(axis + sure * (shift - swing - axis) - shift), doubt=doubt)


def pulled(candidates: dict[str, Candidate], flat: Flattening) -> Floats:
    """Return how far in px doubt about its slant leaves a body's markers uncertain along their orbit, (n,)."""
    own = [np.nan_to_num(flat.pull(name, c.angle)) for name, c in candidates.items()]
    return np.asarray(np.sqrt(np.mean(np.square(own), axis=0)))
