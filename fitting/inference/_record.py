"""Measured angles or angular velocities of one experiment.

A `Record` is made from arrays (`make_record`) or a case file (`fitting.inference._case_file`). Times are on one clock
[s], angles in rad and unwrapped, speeds in rad/s. What was measured is the `quantity`: angles, or angular velocities.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import compress
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fitting._errors import RecordError
from fitting._numbers import PER_INERTIA, TORQUE
from fitting.inference._prior import Prior

Array = NDArray[np.float64]
Quantity = Literal["angle", "omega"]

# an angle tells a speed only over several samples; a measured speed tells it at once
# a block of the compression takes 12 samples for what a model does, and as many measure the noise
_FEWEST_OF_BODY = 24
_FEWEST: dict[str, int] = {"angle": 8, "omega": 1}


@dataclass(frozen=True)
class Samples:
    """A run of measured values without a break: time [s], value [rad or rad/s], sigma (same unit)."""

    time: Array
    value: Array
    sigma: Array

    def __len__(self) -> int:
        return len(self.time)


@dataclass(frozen=True)
class Record:
    """One experiment on one clock.

    Parameters
    ----------
    label, surface : str
        Names for people; the label tells the cases of a joint fit apart.
    I_rotor, I_casing : float
        Moments of inertia [kg m2].
    I_rotor_u, I_casing_u : float
        Their standard uncertainties [kg m2]; NaN if not given.
    casing : Samples
        The casing through the whole run.
    rotor : tuple of Samples
        The rotor in each window.
    quantity : {"angle", "omega"}
        What the values are.
    source : str
        The file, for provenance.
    tracked : bool
        The angles come from film, with tracking's own artefacts once and twice a turn.
    gradients : bool
        The speeds are gradients of filmed angles, with what the camera added to those.
    generated : bool
        The rotor is a curve that was generated, not measured (see `fitting.study._paper`).
    windows : tuple of Samples
        Where it is, what was measured of it.
    start_sigma : tuple of float
        Uncertainty of the start of each rotor window on the casing's clock [s]; empty if it is known.
    per_inertia : bool
        No moment of inertia is known: it is 1, and torques are per unit of inertia [rad/s2].
    digest : str
        SHA-256 of the numbers.
    prior : Prior, optional
        What another study has found about the parameters.
    """

    label: str
    I_rotor: float
    I_casing: float
    casing: Samples
    rotor: tuple[Samples, ...]
    quantity: Quantity = "angle"
    surface: str = ""
    source: str = ""
    tracked: bool = False
    gradients: bool = False
    generated: bool = False
    windows: tuple[Samples, ...] = ()
    start_sigma: tuple[float, ...] = ()
    I_rotor_u: float = math.nan
    I_casing_u: float = math.nan
    per_inertia: bool = False
    digest: str = field(default="")
    prior: Prior | None = None

    def __post_init__(self) -> None:
        if not self.digest:
            object.__setattr__(self, "digest", _digest(self))

    @property
    def single(self) -> bool:
        """Whether it is the record of one body alone, which stands in the casing's place."""
        return not self.rotor

    @property
    def body(self) -> str:
        """What people call the body in the casing's place: "casing", or "body" where only one was recorded."""
        return "body" if self.single else "casing"

    @property
    def torque_unit(self) -> str:
        """Unit of its torques: "N m", or "rad/s2" per unit of inertia."""
        return PER_INERTIA if self.per_inertia else TORQUE

    @property
    def span(self) -> tuple[float, float]:
        """The first and the last time of any sample [s]."""
        ends = [(s.time[0], s.time[-1]) for s in (self.casing, *self.rotor)]
        return float(min(a for a, _ in ends)), float(max(b for _, b in ends))


def make_record(
    *,
    casing: tuple[Array, Array, Array],
    rotor: list[tuple[Array, Array, Array]],
    I_rotor: float,
    I_casing: float,
    label: str = "case",
    surface: str = "",
    quantity: Quantity = "angle",
    source: str = "",
    tracked: bool = False,
    single: bool = False,
    start_sigma: Sequence[float] = (),
    I_rotor_u: float = math.nan,
    I_casing_u: float = math.nan,
    per_inertia: bool = False,
) -> Record:
    """Make a record from arrays of (time, value, sigma); samples that are not finite are left out.

    Parameters
    ----------
    casing : tuple of ndarray, shape (n,)
        Time [s], value [rad or rad/s] and standard uncertainty of the casing, or of the single body.
    rotor : list of tuple of ndarray
        The same for each film of the rotor.
    I_rotor, I_casing : float
        Moments of inertia [kg m2].
    label, surface, source : str
        Name of the recording, what the casing turned on, where the data come from.
    quantity : {"angle", "omega"}
        What the values are.
    tracked : bool
        The data come from film.
    single : bool
        There is one body only, given as `casing`; nothing is known of a rotor.
    start_sigma : sequence of float
        Standard uncertainty of the start of each film of the rotor on the casing's clock [s]; empty if exact.
    I_rotor_u, I_casing_u : float
        Standard uncertainties of the moments of inertia [kg m2]; NaN if unknown.
    per_inertia : bool
        No moment of inertia is known: it is 1, and torques are per unit of inertia [rad/s2].

    Raises
    ------
    RecordError
        If too few samples are left, or times do not grow.
    """
    runs = [_clean(*casing, what="body" if single else "casing"), *(_clean(*r, what="rotor") for r in rotor)]
    if len(runs[0]) < _FEWEST_OF_BODY:
        body = "body" if single else "casing"
        raise RecordError(
            f"{label}: the {body} has {len(runs[0])} usable samples; at least {_FEWEST_OF_BODY} are needed"
        )
    kept = [len(r) >= _FEWEST[quantity] for r in runs[1:]]
    windows = tuple(compress(runs[1:], kept))
    if not windows and not single:
        raise RecordError(
            f"{label}: no rotor window with at least {_FEWEST[quantity]} usable samples",
            "give at least one rotor clip",
        )
    return Record(
        label, I_rotor, I_casing, runs[0], windows, quantity, surface=surface, source=source, tracked=tracked,
        start_sigma=tuple(compress(map(float, start_sigma), kept)), I_rotor_u=I_rotor_u, I_casing_u=I_casing_u,
        per_inertia=per_inertia,
    )  # fmt: skip


def _clean(time: Array, value: Array, sigma: Array, *, what: str) -> Samples:
    time, value, sigma = (np.asarray(a, dtype=float) for a in (time, value, sigma))
    keep = np.isfinite(time) & np.isfinite(value)
    time, value, sigma = time[keep], value[keep], sigma[keep]
    if len(time) > 1 and not (np.diff(time) > 0).all():
        raise RecordError(f"the times of the {what} do not grow from sample to sample")
    good = np.isfinite(sigma) & (sigma > 0)
    # where no uncertainty is known all samples weigh the same; the level is measured from the data
    typical = float(np.median(sigma[good])) if good.any() else 1e-3
    return Samples(time, value, np.where(good, sigma, typical))


def _digest(record: Record) -> str:
    hasher = hashlib.sha256(f"{record.I_rotor!r} {record.I_casing!r} {record.quantity}".encode())
    for samples in (record.casing, *record.rotor):
        for a in (samples.time, samples.value, samples.sigma):
            hasher.update(np.ascontiguousarray(a).tobytes())
    if any(record.start_sigma):
        hasher.update(repr(record.start_sigma).encode())
    uncertainties = (record.I_rotor_u, record.I_casing_u)
    if not all(map(math.isnan, uncertainties)):
        hasher.update(repr(uncertainties).encode())
    return hasher.hexdigest()
