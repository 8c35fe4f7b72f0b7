"""What markers err again and again: by their place in the picture, and by the angle to the other body."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gyrotrack.angles.bias import KNOTS, closed_curve, curve_at, once_a_turn, without_common_motion
from gyrotrack.angles.departures import FAST, TURN, Departures, wrapped
from gyrotrack.dataset.columns import stretches
from gyrotrack.geometry.local import local_fit, spread
from gyrotrack.geometry.tilt import CELL

Floats = npt.NDArray[np.float64]

MOSTLY = 0.5
"""Share of the frames in which a body must turn round for its errors by place to be known."""
ENOUGH = 0.2
"""Share of the frames that must be fast for curves to be learnt from these alone."""


def learn_places(state: Departures, smooth: Floats) -> None:
    """Learn each marker's error by its place in the picture (see `bias`)."""
    fast = state.turning & state.fast
    geometry_only = fast.sum() > ENOUGH * state.turning.sum()
    when = fast if geometry_only else state.turning
    curves = {}
    for name, c in state.candidates.items():
        fit = state.use[name] & c.open & when
        curves[name] = _curve(state, name, c.angle, state.by_neighbour[name], smooth, fit)
    if geometry_only:
        state.axis_off = {name: once_a_turn(curve) for name, curve in curves.items()}
    else:
        curves = without_common_motion(curves, state.mounts)
    for name, curve in curves.items():
        for part in stretches(len(state.path)):
            place = np.nan_to_num(state.candidates[name].angle[part])
            state.by_place[name][part] = curve_at(curve - curve.mean(), place)


def learn_neighbours(
    state: Departures, smooth: Floats, other: Floats, window: tuple[int, int], *, above: bool
) -> None:
    """Learn each marker's error by its angle to the other body (see `bias`).

    Markers below it err where it hides a part of them. Markers above it (`above`) err wherever the other body's
    own markers pass beside them; that is learnt where these pass so fast that no motion follows them. Where they
    pass nearly in step with the frames, a curve over their angle may creep as slowly as a motion: what of it a
    local polynomial (`window`: half width and degree) can follow is taken for motion, and left in.
    """
    with np.errstate(invalid="ignore"):
        passing = state.turning & (state.speed(other - state.path) > FAST)
    if above and passing.sum() <= ENOUGH * state.turning.sum():
        return
    for name, c in state.candidates.items():
        beside = np.nan_to_num(c.angle - other)
        near = state.use[name] & np.isfinite(other)
        when = near & (passing if above else state.turning)
        curve = _curve(state, name, beside, state.by_place[name], smooth, when)
        for part in stretches(len(near)):
            shown = near[part] & (above | ~c.open[part])
            state.by_neighbour[name][part] = np.where(shown, curve_at(curve, beside[part]), 0.0)
        if above:
            slow, _ = local_fit(state.by_neighbour[name], near.astype(np.float64), *window)
            state.by_neighbour[name] -= np.where(near, np.nan_to_num(slow), 0.0)


def places_passed(state: Departures) -> float:
    """Return how many places with errors of their own the body passes, where it does not turn round."""
    path = state.path[~state.turning & np.isfinite(state.path)]
    return float(np.ptp(path)) / CELL if len(path) else 0.0


def place_error(state: Departures) -> float:
    """Return the usual size of the errors by place that were learnt, of the marker that errs least [rad].

    A marker that is faint or smeared errs more than the place makes it, and so does one beside a bar that stands
    nearly still, in some places only: then the core's standard deviation is taken. NaN if none could be learnt,
    or if the markers come back to the same few places.
    """
    if state.turning.mean() < MOSTLY:
        return float("nan")
    learnt = []
    for name, c in state.candidates.items():
        seen = state.use[name] & c.open & state.turning
        if len(np.unique(np.rint(c.angle[seen] * KNOTS / TURN))) >= KNOTS / 2:
            error = state.by_place[name][seen]
            learnt.append(min(float(np.sqrt(np.mean(error**2))), spread(error)))
    return min(learnt, default=float("nan"))


def _curve(
    state: Departures, name: str, over: Floats, known: Floats, smooth: Floats, use: npt.NDArray[np.bool_]
) -> Floats:
    """Learn a closed curve over an angle from what a marker departs from the smooth motion."""
    off, weight = np.empty((2, len(over)))
    for part in stretches(len(over)):
        ahead = state.candidates[name].angle[part] - state.path[part] - state.mounts[name] - known[part]
        off[part] = wrapped(ahead) - smooth[part]
        weight[part] = np.where(use[part], 1.0 / state.sigma(name, part) ** 2, 0.0)
    return closed_curve(over, off, weight)
