"""The near corners of a marker from fitted edges, and the uncertainty of the angle as defined in the paper.

The paper is V. Tanrıverdi and A. Erbasan, arXiv:2605.06700.

Notation, for one frame: C the centre, P_1 and P_2 the two near corners, M their midpoint, rho = |M - C| the radius,
delta = |P_2 - P_1| the base, beta the angle between the base and the radius; mean() is the average over the clip.
Ideally delta and rho are constant and beta is a right angle. Then

    u_r  = |rho - mean(rho)| / mean(rho)                                 (relative, one for both corners)
    u_1k = |angle(M +- mean(delta)/2 * e_base)  - angle(P_k)|            (average base, measured direction)
    u_2k = |angle(M +- mean(delta)/2 * e_right) - angle(P_k)|            (average base at a right angle)
    sigma_k = sqrt((30 u_r)^2 + (150 u_1k)^2 + (150 u_2k)^2)             for each corner k

with e_base along the base and e_right perpendicular to the radius. The angle is the mean of the angles of the corners.
The uncertainty of this mean has the components u_r, u_1 and u_2. Each of them is the root mean square of the values of
both corners. The formula of sigma_k with these components gives the uncertainty of the angle. Averaging does not reduce
the uncertainty, because the errors of both corners have the same causes.

In the unrolled ring a marker has two radial edges and a nearly tangential near edge. An edge is the place at which the
score is half way between the score of the marker and the score of the background beyond this edge. The background may
differ from edge to edge, for example next to a coloured bar under the marker. Lines are fitted through the crossings in
several bands of rows and columns; the corners are the intersections of the lines.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from gyrotrack._arrays import Bools, Complexes, Floats
from gyrotrack._column_store import new_columns, row_blocks
from gyrotrack._native import _kernels as kernels
from gyrotrack._smoothing import median_of
from gyrotrack.tracking._polar import Windows

FACTOR_R = 30.0
"""Factor of u_r in the uncertainty as defined in the paper [rad]. Source: V. Tanrıverdi and A. Erbasan,
arXiv:2605.06700; see the module docstring."""
FACTOR_1 = 150.0
"""Factor of u_1 in the uncertainty as defined in the paper [1]. Source: V. Tanrıverdi and A. Erbasan, arXiv:2605.06700;
see the module docstring."""
FACTOR_2 = 150.0
"""Factor of u_2 in the uncertainty as defined in the paper [1]. Source: V. Tanrıverdi and A. Erbasan, arXiv:2605.06700;
see the module docstring."""


@dataclass(frozen=True)
class PaperAngle:
    """The paper's quantities for n frames [px, rad]; NaN where a corner is missing."""

    delta: Floats
    rho: Floats
    beta: Floats
    angle: Floats
    u_r: Floats
    u_1: Floats
    u_2: Floats
    sigma: Floats


def paper_angle(corner: Floats, centre: Floats, use: Bools) -> PaperAngle:
    """Compute angle (counter-clockwise as seen, in (-pi, pi]) and uncertainty from the near corners as the paper does.

    `corner` (n, 2, 2): frame, corner, (x, y) [px], y downwards, the lower angle first; averages are over frames `use`.
    """
    found = PaperAngle(**new_columns(len(corner), {f.name: ((), "f8") for f in fields(PaperAngle)}))
    for part in row_blocks(len(corner)):
        _, middle, base = _seen_from(corner[part], centre[part])
        found.rho[part], found.delta[part] = np.abs(middle), np.abs(base)
    use = use & np.isfinite(found.rho)
    mean_rho = float(found.rho[use].mean()) if use.any() else np.nan
    mean_delta = float(found.delta[use].mean()) if use.any() else np.nan
    for part in row_blocks(len(corner)):
        with np.errstate(invalid="ignore"):
            some = _from_corners(*_seen_from(corner[part], centre[part]), mean_rho, mean_delta)
        for f in fields(PaperAngle):
            getattr(found, f.name)[part] = getattr(some, f.name)
    return found


def _seen_from(corner: Floats, centre: Floats) -> tuple[Complexes, Complexes, Complexes]:
    """Return the corners relative to the centre (n, 2), their midpoint and the base (n,), as complex numbers [px]."""
    v = corner - centre[:, None, :]
    z = v[..., 0] - 1j * v[..., 1]
    middle, base = z.mean(axis=1), z[:, 1] - z[:, 0]
    known = np.isfinite(np.abs(middle)) & (np.abs(middle) > 0) & (np.abs(base) > 0)
    z[~known] = middle[~known] = base[~known] = np.nan + 0j
    return z, middle, base


def _from_corners(
    z: Complexes, middle: Complexes, base: Complexes, mean_rho: float, mean_delta: float
) -> PaperAngle:
    rho, delta = np.abs(middle), np.abs(base)
    beta = np.abs(np.angle(base / middle))
    along = base / delta
    across = 1j * middle / rho
    side = np.array([-0.5, 0.5]) * mean_delta
    u_1k = np.angle((middle[:, None] + side * along[:, None]) / z)
    u_2k = np.angle((middle[:, None] + side * across[:, None]) / z)
    u_r = np.abs(rho - mean_rho) / mean_rho
    u_1, u_2 = (np.sqrt(np.mean(u**2, axis=1)) for u in (u_1k, u_2k))
    turn = z / np.abs(z)
    return PaperAngle(
        delta, rho, beta, np.angle(turn[:, 0] + turn[:, 1]), u_r, u_1, u_2, paper_sigma(u_r, u_1, u_2)
    )


def paper_sigma(u_r: Floats, u_1: Floats, u_2: Floats) -> Floats:
    """Return sqrt((30 u_r)^2 + (150 u_1)^2 + (150 u_2)^2) in rad."""
    return np.asarray(np.sqrt((FACTOR_R * u_r) ** 2 + (FACTOR_1 * u_1) ** 2 + (FACTOR_2 * u_2) ** 2))


SIDE_BANDS = 4
"""Number of bands into which the rows of a side are averaged [1]. Chosen: with fewer, the line has no redundancy; with
more, each edge is noisier."""
NEAR_BANDS = 5
"""Number of bands into which the columns of the near edge are averaged [1]. Chosen: a parabola has 3 coefficients; with
fewer, there is no redundancy; with more, each edge is noisier."""
_LEAST_FALL = 1e-9
"""Fall of the score below which an edge is flat [1]. Derived: rounding errors of floating-point numbers."""


def near_corners(
    window: Windows, radii: Floats, angles: Floats, inner: float, outer: float
) -> tuple[Floats, Floats]:
    """Return radius [px] and angle [rad] of the near corners of a marker in n windows, (n, 2), the lower angle first.

    The score is 0 on the background and 1 on the marker, which is near the middle column. The `radii` of the rows and
    the `angles` of the columns increase uniformly. `inner` and `outer` are typical radii of the near and the far edge.
    The results are NaN where an edge is not found.
    """
    left, right = _side_edges(window, radii, angles, inner, outer)
    if not np.isfinite(left[0] + right[0]).any():
        nothing = np.full((len(left[0]), 2), np.nan)
        return nothing, nothing
    near = _near_edge(window, radii, angles, 0.5 * (right[0] - left[0]), 0.5 * (right[0] + left[0]))
    radius, angle = np.empty((2, len(left[0]), 2))
    for side, (base, lean) in enumerate((left, right)):
        r = np.full(len(base), inner)
        for _ in range(3):
            phi = base + lean * (r - inner)
            r = near[0] + near[1] * phi + near[2] * phi**2
        radius[:, side], angle[:, side] = r, base + lean * (r - inner)
    return radius, angle


_SIDE_FROM = 0.12
"""Distance from the near edge of a marker at which the fit of the sides starts [lengths of the marker]. Chosen: a
smaller value includes the rounded corner, a larger one extrapolates farther."""
_SIDE_TO = 0.85
"""Distance from the near edge of a marker at which the fit of the sides ends [lengths of the marker]. Chosen: a larger
value includes the far corner, a smaller one gives a noisy direction."""


def _side_edges(
    window: Windows, radii: Floats, angles: Floats, inner: float, outer: float
) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
    """Fit the line angle = a + b (r - inner) to each side of the marker; return (a, b) of both sides."""
    length = outer - inner
    rows = np.flatnonzero((radii >= inner + _SIDE_FROM * length) & (radii <= inner + _SIDE_TO * length))
    if len(rows) < 2:
        rows = (
            np.flatnonzero((radii >= inner) & (radii <= outer)) if length > 0 else np.array([len(radii) // 2])
        )
    if len(rows) == 0:
        rows = np.array([int(np.argmin(np.abs(radii - 0.5 * (inner + outer))))])
    mixing = _bands(rows, len(radii), SIDE_BANDS)
    part = window.bands(mixing)
    middle = part.shape[2] // 2
    r = mixing @ radii - inner
    right, left = _edge(part, angles, middle, 1), _edge(part, angles, middle, -1)
    return _lines(left, r), _lines(right, r)


_NEAR_WITHIN = 0.8
"""The near edge is fitted within this share of the half width of the marker [1]. Chosen: a larger value includes the
rounded corners, a smaller one gives a noisy curve."""
_EDGE_SEEN = 0.6
"""Smallest share of bands in which the near edge is seen [1]. Chosen: a smaller value extrapolates, a larger one omits
partly covered edges."""


def _near_edge(
    window: Windows, radii: Floats, angles: Floats, half: Floats, middle: Floats
) -> tuple[Floats, Floats, Floats]:
    """Fit r = c0 + c1 phi + c2 phi^2 to the middle part of the near edge (`_NEAR_WITHIN`)."""
    known = np.isfinite(half)
    typical, centre = median_of(half[known]), median_of(middle[known])
    columns = np.flatnonzero(np.abs(angles - centre) < _NEAR_WITHIN * typical)
    nothing = np.full(len(half), np.nan)
    if len(columns) < 3:
        columns = np.arange(len(angles) // 2 - 1, len(angles) // 2 + 2)
    mixing = _bands(columns, len(angles), NEAR_BANDS)
    across = window.bands(mixing, across=True)
    top = int(np.argmax(np.median(np.ascontiguousarray(across.mean(axis=1).T), axis=1)))
    if top < 1:
        return nothing, nothing, nothing
    edge = _edge(across, radii, top, -1)
    phi = mixing @ angles
    degree = 2 if len(phi) >= 5 else 0
    known = np.isfinite(edge)
    seen = known.mean(axis=1) > _EDGE_SEEN
    mean = np.where(known, edge, 0.0).sum(axis=1, keepdims=True) / np.maximum(
        known.sum(axis=1, keepdims=True), 1
    )
    edge = np.where(known, edge, mean)
    solve = np.linalg.pinv(np.vander(phi, degree + 1, increasing=True))
    coefficient = np.zeros((len(half), 3))
    coefficient[:, : degree + 1] = np.where(seen[:, None], edge, np.nan) @ solve.T
    coefficient[~seen] = np.nan
    return coefficient[:, 0], coefficient[:, 1], coefficient[:, 2]


def _bands(chosen: npt.NDArray[np.integer], size: int, most: int) -> Floats:
    """Return weights (bands, size) that average neighbouring rows or columns in at most `most` bands."""
    parts = np.array_split(chosen, min(most, len(chosen)))
    mixing = np.zeros((len(parts), size))
    for line, part in zip(mixing, parts, strict=True):
        line[part] = 1.0 / len(part)
    return mixing


_DARKEST = -0.3
"""Smallest score of the surroundings beyond an edge (0 on the background, 1 on the marker) [1]. Chosen: a smaller value
lets a shadow displace the edge, a larger one ignores dark surroundings."""
_BRIGHTEST = 0.6
"""Largest score of the surroundings beyond an edge [1]. Chosen: a larger value takes the marker itself for its
surroundings, a smaller one ignores a coloured bar."""


def _edge(values: Floats, axis: Floats, first: int, step: int) -> Floats:
    """Return where curves fall half way to the background; the search starts at the sample `first`, in the marker.

    The shape of `values` is (n, k, size); the shape of the result is (n, k).
    """
    outwards = values[:, :, first::step]
    beyond = float(np.clip(median_of(outwards[:, :, -2:]), _DARKEST, _BRIGHTEST))
    level = 0.5 * (1.0 + beyond)
    place = kernels.crossings(values, first, step, level, _LEAST_FALL)
    return np.asarray(axis[first] + step * (axis[1] - axis[0]) * place)


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
