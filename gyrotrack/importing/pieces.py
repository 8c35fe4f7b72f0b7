"""Stretches of a table without large gaps: their angles, speeds and uncertainties, and the series of a case."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrotrack.angles import angular_velocity
from gyrotrack.dataset.records import Floats, Series
from gyrotrack.importing.scatter import scatter
from gyrotrack.importing.table import Table
from gyrotrack.importing.unwrapping import TURN, is_wrapped, pieces, unwrap

SMOOTHING = 51  # points of the paper's medians


@dataclass(frozen=True)
class Piece:
    """One stretch of one table: s, rad and rad/s, all of shape (n,)."""

    time: Floats
    angle: Floats
    sigma: Floats
    omega: Floats
    omega_sigma: Floats


def pieces_of(table: Table, notes: list[str]) -> list[Piece]:
    """Cut a table at its gaps and bring each piece to angles, speeds and their uncertainties.

    Where the table has no sigma it is estimated from the scatter; what is doubtful is added to `notes`.
    """
    cuts = pieces(table.time)
    value = table.value
    if table.quantity == "angle" and is_wrapped(value):
        value, doubtful = unwrap(table.time, value)
        notes += [f"{table.path.name}: a turn may be lost in the gap after {t:.3f} s" for t in doubtful]
    sigma = table.sigma
    if sigma is None:
        sigma = np.concatenate([scatter(table.time[cut], value[cut]) for cut in cuts])
        notes.append(
            f"{table.path.name}: sigma was estimated from the scatter, median {np.median(sigma):.2g}"
        )
    make = _from_angles if table.quantity == "angle" else _from_speeds
    made = [make(table.time[cut], value[cut], sigma[cut]) for cut in cuts]
    for piece in made:
        if not np.isfinite(piece.omega).any():
            start = f"{table.path.name}: the piece at {piece.time[0]:.3f} s"
            notes.append(f"{start} is too short for the smoothed speed ({len(piece.time)} samples)")
    return made


def _from_angles(time: Floats, angle: Floats, sigma: Floats) -> Piece:
    omega, omega_sigma = angular_velocity(time, angle, sigma, SMOOTHING)
    return Piece(time, angle, sigma, omega, omega_sigma)


def _from_speeds(time: Floats, omega: Floats, sigma: Floats) -> Piece:
    """Integrate by the trapezium rule; the errors of the speeds add up along the way."""
    step = np.diff(time)
    angle = np.concatenate([[0.0], np.cumsum((omega[1:] + omega[:-1]) / 2 * step)])
    share = np.concatenate([[step[0]], step]) * sigma
    return Piece(time, angle, np.sqrt(np.cumsum(share**2)), omega, sigma)


def series_of(parts: Sequence[Piece], sense: int) -> Series:
    """Put pieces one after the other, each a window; angles and speeds are multiplied by `sense`."""
    angle = np.concatenate([sense * part.angle for part in parts])
    return Series(
        time=np.concatenate([part.time for part in parts]),
        angle=angle,
        sigma=np.concatenate([part.sigma for part in parts]),
        omega=np.concatenate([sense * part.omega for part in parts]),
        omega_sigma=np.concatenate([part.omega_sigma for part in parts]),
        turn=np.floor(angle / TURN).astype(np.int64),
        window=np.concatenate([np.full(len(part.time), k, dtype=np.int64) for k, part in enumerate(parts)]),
    )


def no_series() -> Series:
    """Return the series of a body that is not there."""
    none, whole = np.zeros(0), np.zeros(0, dtype=np.int64)
    return Series(none, none, none, none, none, whole, window=whole, sigma_source="given")
