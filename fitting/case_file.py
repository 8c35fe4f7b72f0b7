"""A case file, read as the record of one experiment; the file is not changed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting.errors import RecordError
from fitting.hdf5 import column, number, series, text
from fitting.intact import check_intact
from fitting.record import Quantity, Record, make_record

Array = NDArray[np.float64]

FORMAT = "gyrotrack"
MAJOR = 1


def read_record(path: str | Path) -> Record:
    """Read a case file.

    Parameters
    ----------
    path : str or Path
        An HDF5 file of kind "case", layout version 1.

    Raises
    ------
    RecordError
        If the file is missing, not of this format, newer, damaged, or holds too little to fit.
    """
    import h5py

    path = Path(path)
    if not path.is_file():
        raise RecordError(f"{path}: there is no such file")
    try:
        check_intact(path)
        with h5py.File(path, "r") as file:
            return _read(path, file)
    except (OSError, KeyError, ValueError, TypeError, RuntimeError) as fault:
        if isinstance(fault, RecordError):
            raise
        if not h5py.is_hdf5(path):
            raise RecordError(
                f"{path} is not an HDF5 file", "make a case with `gyrotrack sync` or `gyrotrack import`"
            ) from None
        raise RecordError(
            f"{path} is damaged or incomplete: {fault}", "`gyrotrack info` tells what it holds"
        ) from None


def _read(path: Path, file: Any) -> Record:
    attributes = dict(file.attrs)
    if text(attributes.get("format")) != FORMAT:
        raise RecordError(
            f"{path} was not written by gyrotrack", "make a case with `gyrotrack sync` or `gyrotrack import`"
        )
    version = text(attributes.get("format_version", "1.0"))
    if not version.split(".")[0].isdigit() or int(version.split(".")[0]) > MAJOR:
        raise RecordError(
            f"{path} has layout version {version[:12]}; this program reads {MAJOR}.x", "update gyrotrack"
        )
    if text(attributes.get("kind")) != "case":
        raise RecordError(
            f"{path} holds a {text(attributes.get('kind'))[:20] or 'file'}, not a case",
            "make a case with `gyrotrack sync`",
        )
    quantity: Quantity = "omega" if text(attributes.get("quantity", "angle")) == "omega" else "angle"
    key = ("omega", "omega_sigma") if quantity == "omega" else ("angle", "sigma")
    casing = series(path, file, "casing", key)
    single = text(attributes.get("bodies")) == "one"
    rotor = (
        [] if single else _windows(series(path, file, "rotor", key), column(path, file, "rotor", "window"))
    )
    inertias = [float(np.asarray(attributes[k])) for k in ("I_rotor", "I_casing")]
    if not all(np.isfinite(i) and i > 0 for i in inertias):
        raise RecordError(f"{path}: the moments of inertia {inertias} are not positive")
    return make_record(
        label=text(attributes.get("label")) or path.stem,
        surface=text(attributes.get("surface")),
        I_rotor=inertias[0],
        I_casing=inertias[1],
        casing=casing,
        rotor=rotor,
        single=single,
        start_sigma=[] if single else _start_sigma(file, column(path, file, "rotor", "window")),
        quantity=quantity,
        source=str(path),
        tracked=text(file["casing"].attrs.get("sigma_source")) == "measured",
    )


def _windows(rotor: tuple[Array, Array, Array], window: Array) -> list[tuple[Array, Array, Array]]:
    return [(rotor[0][window == w], rotor[1][window == w], rotor[2][window == w]) for w in np.unique(window)]


def _start_sigma(file: Any, window: Array) -> list[float]:
    """Return the uncertainty of each window's start on the casing's clock [s], zero where no camera is known."""
    sigma = [number(file, f"recording/rotor_{int(w)}", "clock_offset_sigma") for w in np.unique(window)]
    return [s if np.isfinite(s) and s > 0 else 0.0 for s in sigma]
