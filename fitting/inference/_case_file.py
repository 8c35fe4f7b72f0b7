"""The record of a case file (HDF5), which may be damaged or malicious."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fitting._case_checks import is_body_name
from fitting._case_format import CASE
from fitting._dataset import Reader
from fitting._errors import RecordError
from fitting._stored_case import StoredCase, StoredSeries, read_stored_case
from fitting.dynamics._inputs import Input
from fitting.effects._mechanism import GYROSCOPE, Mechanism
from fitting.inference._error_modes import ErrorMode
from fitting.inference._record import Record, make_record


def _error(what: str, hint: str) -> RecordError:
    """Return an error of this package that states what is wrong, and what to do."""
    return RecordError(what.removesuffix("."), f"{hint[:1].lower()}{hint[1:].removesuffix('.')}")


def read_record(path: str | Path) -> Record:
    """Read an HDF5 file of kind "case", layout version 1 or 2; a RecordError states why a file cannot be read."""
    reader = Reader(_error)
    with reader.open(Path(path), CASE) as file:
        stored = read_stored_case(file, reader)
    return _record(Path(path), stored)


def _record(path: Path, case: StoredCase) -> Record:
    stated, casing, others = case.attributes, case.casing, case.others
    gyroscope = bool(others) and not case.joints
    mechanism = Mechanism.of([s.name for s in (casing, *others)], case.joints) if case.joints else GYROSCOPE
    inertias = [s.inertia for s in others]
    if gyroscope:
        inertias = [(stated["I_rotor"], stated["I_rotor_u"])]
    (I_rotor, I_rotor_u), *further = inertias or [(1.0, math.nan)]
    windows = [(s, w) for s in others for w in _windows(s)]
    errors = ("correlated_sigma", "correlated_time", "periodic_sigma", "harmonic_sigma")
    return make_record(
        label=stated["label"] or path.stem,
        surface=stated["surface"],
        I_rotor=I_rotor,
        I_casing=1.0 if stated["per_inertia"] else stated["I_casing"],
        I_rotor_u=I_rotor_u,
        I_casing_u=stated["I_casing_u"],
        per_inertia=bool(stated["per_inertia"]),
        casing=(casing.time, casing.value, casing.u),
        rotor=[(s.time[w], s.value[w], s.u[w]) for s, w in windows],
        name=casing.name if not others and is_body_name(casing.name) else "",
        start_sigma=_start_sigma(case, others[0]) if gyroscope else [],
        quantity=stated["quantity"],
        source=str(path),
        tracked=casing.stated["sigma_source"] == "measured",
        correlated=[casing.stated[name] for name in errors],
        correlated_profile=casing.stated["correlated_profile"],
        inputs=[_input(path, name, **values) for name, values in case.inputs.items()],
        modes=[
            *_modes(casing, "casing", {None: np.ones(len(casing.time), dtype=bool)}),
            *(
                m
                for s in others
                for m in _modes(s, "rotor", {i: w for i, (of, w) in enumerate(windows) if of is s})
            ),
        ],
        mechanism=mechanism,
        states=[mechanism.bodies.index(s.name) for s, _ in windows],
        harmonics=[s.stated["harmonic_sigma"] for s, _ in windows],
        further=further,
    )


def _windows(series: StoredSeries) -> list[Any]:
    """Return a mask of the samples of each window; one empty mask if the series has no samples."""
    return [series.segment == w for w in np.unique(series.segment)] or [series.segment == 0]


def _modes(series: StoredSeries, body: str, windows: Mapping[Any, Any]) -> Iterator[ErrorMode]:
    """Yield the error modes of a series in each of its `windows`, masks of samples by number of the window."""
    measured = np.isfinite(series.time) & np.isfinite(series.value)
    for mode in series.modes:
        for number, window in windows.items():
            rows = measured & window
            yield ErrorMode(
                mode.name,
                series.time[rows],
                mode.basis[rows],
                mode.covariance,
                body=body,
                window=number,
                group=mode.group,
                origin=mode.origin,
            )


def _input(path: Path, name: str, *, u: Any, **values: Any) -> Input:
    known = np.isfinite(u)
    if known.any() and not known.all():
        raise RecordError(f"{path}: input/{name}/u lacks some values", "give all uncertainties, or none")
    return Input(name, u=u if known.any() else None, **values)


def _start_sigma(case: StoredCase, rotor: StoredSeries) -> list[float]:
    """Return the uncertainty of the start of each window on the casing's clock [s]; NaN if it is not given.

    An imported case has no camera; its `start_u` applies to every window.
    """
    sigma = [case.start_u.get(f"rotor_{w}", math.nan) for w in np.unique(rotor.segment)]
    if not np.isfinite(sigma).any():
        stated = case.attributes["start_u"]
        return [stated if math.isfinite(stated) and stated >= 0 else math.nan] * len(sigma)
    return [s if math.isfinite(s) and s > 0 else 0.0 for s in sigma]
