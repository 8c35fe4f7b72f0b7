"""Errors that all samples of a series have in common: functions of time whose amplitudes have a known covariance.

A quantity that was estimated and then subtracted from a measurement, for example the axis of a body, the tilt of a
camera or the start of a film, has an error. All samples of the measurement have this error e in common,

    e(t) = sum_j b_j(t) a_j,    E a = 0,    E a a' = C.

The amplitudes a are nuisance parameters of every fit with the prior C, so that estimates and tests include their
uncertainty. Series with modes of the same group have the same amplitudes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fitting._case_checks import MOST_AMPLITUDES, defect_of_mode
from fitting._errors import RecordError

Array = NDArray[np.float64]


@dataclass(frozen=True, repr=False)
class ErrorMode:
    """An error of one body's series with amplitudes of a known covariance.

    Parameters
    ----------
    name : str
        Name of the error, for example tilt.
    time : ndarray, shape (n,)
        Times of the samples of `basis` on the clock of the record [s].
    basis : ndarray, shape (n, m)
        Error of the samples for unit amplitudes, in units of the series divided by the units of the amplitudes.
    covariance : ndarray, shape (m, m)
        Covariance of the amplitudes, symmetric and positive semidefinite.
    body : {"casing", "rotor"}
        Body of the series; "casing" for a single body.
    window : int, optional
        Number of the window of the rotor that has the error, from 0; by default, all windows that `time` covers.
    group : str
        Name of the amplitudes; modes of the same group have the same amplitudes. If the name is empty, body and name of
        the mode are the group.
    origin : str
        Where the error comes from: "axis", "tilt", "start", "rate", "hub" ...
    """

    name: str
    time: Array
    basis: Array
    covariance: Array
    body: str = "casing"
    window: int | None = None
    group: str = ""
    origin: str = ""

    def __post_init__(self) -> None:
        what = f"error mode {str(self.name)[:40]}"
        for key in ("name", "group", "origin"):
            if not isinstance(getattr(self, key), str):
                raise RecordError(f"{what}: its {key} is not a string", "give a name")
        arrays: dict[str, Array] = {}
        for key in ("time", "basis", "covariance"):
            try:
                arrays[key] = np.array(getattr(self, key), dtype=np.float64)
            except (TypeError, ValueError):
                raise RecordError(f"{what}: {key} holds no numbers", "use a NumPy array") from None
        time, basis, covariance = arrays.values()
        basis = basis[:, None] if basis.ndim == 1 else basis
        covariance = covariance.reshape(1, 1) if covariance.size == 1 else covariance
        if time.ndim != 1 or not np.isfinite(time).all() or not (np.diff(time) > 0).all():
            raise RecordError(
                f"{what}: its times are not finite and strictly increasing", "give one mode for each window"
            )
        if defect := defect_of_mode(basis, covariance, np.ones(len(time), dtype=bool)):
            raise RecordError(f"{what}: {defect.what}", defect.hint)
        if self.body not in ("casing", "rotor"):
            raise RecordError(f"{what}: no body is named {str(self.body)[:20]!r}", "use casing or rotor")
        for key, values in (("time", time), ("basis", basis), ("covariance", covariance)):
            values.flags.writeable = False
            object.__setattr__(self, key, values)

    def __repr__(self) -> str:
        u = self.standard_uncertainty()
        return (
            f"ErrorMode {self.name!r} of the {self.body}: {self.basis.shape[1]} amplitude(s), standard uncertainty "
            f"{u.min():.3g} to {u.max():.3g}" + (f", from {self.origin}" if self.origin else "")
        )

    @property
    def key(self) -> str:
        """Name of the amplitudes: the group or, without a group, body and name."""
        return self.group or f"{self.body}/{self.name}"

    def at(self, times: Array) -> Array:
        """Return the basis at some times, (times, m): linear between its samples, zero beyond the first and last."""
        return np.stack([np.interp(times, self.time, b, left=0.0, right=0.0) for b in self.basis.T], axis=1)

    def rates(self) -> ErrorMode:
        """Return the error of the time derivative of the series."""
        return replace(self, basis=np.gradient(self.basis, self.time, axis=0))

    def standard_uncertainty(self) -> Array:
        """Return the standard uncertainty of each sample due to this error, the root of the diagonal of B C B'."""
        return np.asarray(
            np.sqrt(np.maximum(np.sum((self.basis @ self.covariance) * self.basis, axis=1), 0.0))
        )


def checked_modes(modes: object) -> tuple[ErrorMode, ...]:
    """Return the error modes of a record; a RecordError if a group has two covariances, or there are too many."""
    if not isinstance(modes, Sequence) or not all(isinstance(m, ErrorMode) for m in modes):
        raise RecordError(
            "the error modes are not all ErrorMode objects",
            "use fitting.ErrorMode(name, time, basis, covariance)",
        )
    known: dict[str, Array] = {}
    for mode in modes:
        other = known.setdefault(mode.key, mode.covariance)
        if other.shape != mode.covariance.shape or not np.allclose(
            other, mode.covariance, rtol=1e-9, atol=0.0
        ):
            raise RecordError(
                f"error modes of the group {mode.key[:40]} have different covariances",
                "modes of one group share their amplitudes: give them the same covariance, or other groups",
            )
    count = sum(len(c) for c in known.values())
    if count > MOST_AMPLITUDES:
        raise RecordError(
            f"the error modes have {count} amplitudes; at most {MOST_AMPLITUDES} can be fitted",
            "combine the smallest amplitudes into the uncertainty of the samples",
        )
    return tuple(modes)


def of_windows(modes: Sequence[ErrorMode], kept: Sequence[bool]) -> tuple[ErrorMode, ...]:
    """Return the error modes of the windows that are kept, with the new numbers of these windows."""
    number = {old: new for new, old in enumerate(np.flatnonzero(kept).tolist())}
    return tuple(
        m if m.window is None else replace(m, window=number[m.window])
        for m in modes
        if m.window is None or m.window in number
    )


def mode_columns(
    modes: Sequence[ErrorMode], casing: Array, windows: Sequence[Array]
) -> tuple[Array, list[Array]]:
    """Return the errors of the casing and of each window at one standard deviation of independent amplitudes.

    With C = R R', the columns are B R. The columns of a group have the same indices for all series.

    Parameters
    ----------
    modes : sequence of ErrorMode
        Error modes of a record.
    casing : ndarray, shape (n,)
        Times of the casing [s].
    windows : sequence of ndarray
        Times of each window of the rotor [s].

    Returns
    -------
    tuple of ndarray, shape (n, k), and list of ndarray, shape (window, k)
    """
    roots: dict[str, Array] = {}
    for mode in modes:
        if mode.key not in roots:
            scale = np.sqrt(np.maximum(np.diag(mode.covariance), 1e-300))
            values, vectors = np.linalg.eigh(mode.covariance / np.outer(scale, scale))
            roots[mode.key] = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    ends = np.cumsum([0, *(len(r) for r in roots.values())])
    places = {key: slice(a, b) for key, a, b in zip(roots, ends, ends[1:], strict=False)}
    found = [np.zeros((len(t), int(ends[-1]))) for t in (casing, *windows)]
    for mode in modes:
        for i, times in enumerate((casing, *windows)):
            if (i > 0) == (mode.body == "rotor") and mode.window in (None, i - 1):
                found[i][:, places[mode.key]] += mode.at(times) @ roots[mode.key]
    return found[0], found[1:]
