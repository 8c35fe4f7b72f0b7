"""The two corners of a marker nearest to the centre, from its fitted edges.

In the unrolled ring a paper has two upright edges and a near edge that is almost level. Each edge is where
the score crosses half of the marker's height; lines are fitted through these crossings in several bands of rows
and columns, and the corners are where they meet. Half way is between the marker and what lies beyond that edge:
a bar in a colour of its own under the marker is not as dark as the rest.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Windows = npt.NDArray[np.float32] | Floats

SIDE_BANDS, NEAR_BANDS = 4, 5
"""Bands into which the rows of a side, and the columns of the near edge, are gathered."""


def near_corners(
    window: Windows, radii: Floats, angles: Floats, inner: float, outer: float
) -> tuple[Floats, Floats]:
    """Find the near corners in a batch of windows about a marker.

    Parameters
    ----------
    window : ndarray, shape (n, rows, columns)
        Score with the background at 0 and the marker at 1, the marker near the middle column.
    radii : ndarray, shape (rows,)
        Radii of the rows in px, increasing.
    angles : ndarray, shape (columns,)
        Angles of the columns relative to the marker in rad, increasing.
    inner, outer : float
        Typical radii of the near and the far edge in px.

    Returns
    -------
    radius, angle : ndarray, shape (n, 2)
        Polar coordinates of both corners, the lower angle first; NaN where an edge is not seen.
    """
    left, right = _side_edges(window, radii, angles, inner, outer)
    if not np.isfinite(left[0] + right[0]).any():
        nothing = np.full((len(window), 2), np.nan)
        return nothing, nothing
    near = _near_edge(window, radii, angles, 0.5 * (right[0] - left[0]), 0.5 * (right[0] + left[0]))
    radius, angle = np.empty((2, len(window), 2))
    for side, (base, lean) in enumerate((left, right)):
        r = np.full(len(window), inner)
        for _ in range(3):
            phi = base + lean * (r - inner)
            r = near[0] + near[1] * phi + near[2] * phi**2
        radius[:, side], angle[:, side] = r, base + lean * (r - inner)
    return radius, angle


def _side_edges(
    window: Windows, radii: Floats, angles: Floats, inner: float, outer: float
) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
    """Fit angle = base + lean (r - inner) to each side over the nearer part of the paper."""
    length = outer - inner
    rows = np.flatnonzero((radii >= inner + 0.12 * length) & (radii <= inner + 0.85 * length))
    if len(rows) < 2:
        rows = (
            np.flatnonzero((radii >= inner) & (radii <= outer)) if length > 0 else np.array([len(radii) // 2])
        )
    if len(rows) == 0:
        rows = np.array([int(np.argmin(np.abs(radii - 0.5 * (inner + outer))))])
    mixing = _bands(rows, len(radii), SIDE_BANDS)
    part = np.matmul(mixing.astype(window.dtype), window).astype(np.float64)
    middle = part.shape[2] // 2
    r = mixing @ radii - inner
    right = _crossing(_from_beyond(part[:, :, middle:]), angles[middle:])
    left = _crossing(_from_beyond(part[:, :, middle::-1]), angles[middle::-1])
    return _lines(left, r), _lines(right, r)


def _near_edge(
    window: Windows, radii: Floats, angles: Floats, half: Floats, middle: Floats
) -> tuple[Floats, Floats, Floats]:
    """Fit r = c0 + c1 phi + c2 phi^2 to the near edge within 0.8 of the half width."""
    typical, centre = float(np.nanmedian(half)), float(np.nanmedian(middle))
    columns = (
        np.flatnonzero(np.abs(angles - centre) < 0.8 * typical) if np.isfinite(typical) else np.array([], int)
    )
    nothing = np.full(len(window), np.nan)
    if len(columns) < 3:
        columns = np.arange(len(angles) // 2 - 1, len(angles) // 2 + 2)
    mixing = _bands(columns, len(angles), NEAR_BANDS)
    across = np.matmul(window, mixing.T.astype(window.dtype)).astype(np.float64)
    top = int(np.argmax(np.median(across.mean(axis=2), axis=0)))
    if top < 1:
        return nothing, nothing, nothing
    edge = _crossing(_from_beyond(across[:, top::-1].transpose(0, 2, 1)), radii[top::-1])
    phi = mixing @ angles
    degree = 2 if len(phi) >= 5 else 0
    known = np.isfinite(edge)
    seen = known.mean(axis=1) > 0.6
    mean = np.where(known, edge, 0.0).sum(axis=1, keepdims=True) / np.maximum(
        known.sum(axis=1, keepdims=True), 1
    )
    edge = np.where(known, edge, mean)
    solve = np.linalg.pinv(np.vander(phi, degree + 1, increasing=True))
    coefficient = np.zeros((len(window), 3))
    coefficient[:, : degree + 1] = np.where(seen[:, None], edge, np.nan) @ solve.T
    coefficient[~seen] = np.nan
    return coefficient[:, 0], coefficient[:, 1], coefficient[:, 2]


def _bands(chosen: npt.NDArray[np.integer], size: int, most: int) -> Floats:
    """Return weights (bands, size) that average neighbouring rows or columns in at most so many bands."""
    parts = np.array_split(chosen, min(most, len(chosen)))
    mixing = np.zeros((len(parts), size))
    for line, part in zip(mixing, parts, strict=True):
        line[part] = 1.0 / len(part)
    return mixing


def _from_beyond(values: Floats) -> Floats:
    """Shift and scale curves that run from the marker outwards so that what lies beyond the edge is at 0."""
    beyond = float(np.clip(np.median(values[:, :, -2:]), -0.3, 0.6))
    return np.asarray((values - beyond) / (1.0 - beyond))


def _crossing(values: Floats, axis: Floats) -> Floats:
    """Return where a curve that starts on the marker first falls below one half, (n, k); NaN where never."""
    below = values < 0.5
    first = np.argmax(below, axis=2)
    valid = below.any(axis=2) & (first > 0)
    index = np.clip(first, 1, values.shape[2] - 1)
    high = np.take_along_axis(values, index[..., None] - 1, axis=2)[..., 0]
    low = np.take_along_axis(values, index[..., None], axis=2)[..., 0]
    part = (high - 0.5) / np.maximum(high - low, 1e-9)
    place = axis[index - 1] + np.clip(part, 0.0, 1.0) * (axis[index] - axis[index - 1])
    return np.where(valid, place, np.nan)


def _lines(edge: Floats, r: Floats) -> tuple[Floats, Floats]:
    """Fit lines through the crossings of all rows; NaN where fewer than 60 % of the rows have one."""
    seen = np.isfinite(edge)
    enough = seen.mean(axis=1) > 0.6
    count = np.maximum(seen.sum(axis=1), 1)
    value = np.where(seen, edge, 0.0)
    mean_r = (seen * r).sum(axis=1) / count
    mean = value.sum(axis=1) / count
    dr = np.where(seen, r - mean_r[:, None], 0.0)
    spread = (dr**2).sum(axis=1)
    lean = np.where(spread > 0, (dr * (value - mean[:, None])).sum(axis=1) / np.maximum(spread, 1e-9), 0.0)
    base = mean - lean * mean_r
    return np.where(enough, base, np.nan), np.where(enough, lean, np.nan)
