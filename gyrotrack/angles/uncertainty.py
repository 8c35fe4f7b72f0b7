"""The paper's uncertainty of one angle, from its base, radius and the angle between them.

Notation, for one frame: C the centre, P_1 and P_2 the two near corners, M their midpoint, rho = |M - C| the
radius, delta = |P_2 - P_1| the base, beta the angle between the base and the radius; bars are averages over
the clip. Ideally delta and rho are constant and beta is a right angle. Then

    u_r  = |rho - mean(rho)| / mean(rho)                                 (relative, one for both corners)
    u_1k = |angle(M +- mean(delta)/2 * e_base)  - angle(P_k)|            (average base, as it lies)
    u_2k = |angle(M +- mean(delta)/2 * e_right) - angle(P_k)|            (average base at a right angle)
    sigma_k = sqrt((30 u_r)^2 + (150 u_1k)^2 + (150 u_2k)^2)             for each corner k

with e_base along the base and e_right perpendicular to the radius. The datum is the mean of the corners'
angles. Its parts are the root mean squares of the corners' parts, and its uncertainty, by the same formula,
the root mean square of the corners' uncertainties: both corners err from the same causes, so averaging them
is not taken to lessen it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from gyrotrack.dataset.columns import new_columns, stretches

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

FACTOR_R, FACTOR_1, FACTOR_2 = 30.0, 150.0, 150.0
"""The constants of the paper's formula."""


@dataclass(frozen=True)
class PaperAngle:
    """The paper's quantities for n frames; NaN where a corner is missing. px and rad."""

    delta: Floats
    rho: Floats
    beta: Floats
    angle: Floats
    u_r: Floats
    u_1: Floats
    u_2: Floats
    sigma: Floats


def paper_angle(corner: Floats, centre: Floats, use: npt.NDArray[np.bool_]) -> PaperAngle:
    """Compute angle and uncertainty from the near corners as the paper does.

    Parameters
    ----------
    corner : ndarray, shape (n, 2, 2)
        Frame, corner, (x, y) in px, y downwards; the first corner has the lower angle.
    centre : ndarray, shape (n, 2)
        Centre in px.
    use : ndarray of bool, shape (n,)
        Frames that enter the averages.

    Returns
    -------
    PaperAngle
        `angle` is counter-clockwise as seen, wrapped to (-pi, pi].
    """
    found = PaperAngle(**new_columns(len(corner), {f.name: ((), "f8") for f in fields(PaperAngle)}))
    for part in stretches(len(corner)):
        _, middle, base = _seen_from(corner[part], centre[part])
        found.rho[part], found.delta[part] = np.abs(middle), np.abs(base)
    use = use & np.isfinite(found.rho)
    mean_rho = float(found.rho[use].mean()) if use.any() else np.nan
    mean_delta = float(found.delta[use].mean()) if use.any() else np.nan
    for part in stretches(len(corner)):
        with np.errstate(invalid="ignore"):
            some = _from_corners(*_seen_from(corner[part], centre[part]), mean_rho, mean_delta)
        for f in fields(PaperAngle):
            getattr(found, f.name)[part] = getattr(some, f.name)
    return found


def _seen_from(corner: Floats, centre: Floats) -> tuple[Complexes, Complexes, Complexes]:
    """Return the corners about the centre (n, 2), their middle and the base between them (n,), as complex numbers."""
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
