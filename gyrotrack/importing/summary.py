"""What was imported, in numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from gyrotrack.dataset.records import Case, Series


def summary(case: Case) -> dict[str, Any]:
    """Return what was imported in numbers: samples, times and sigmas of the casing and of each window."""
    windows = (
        case.rotor.window if case.rotor.window is not None else np.zeros(len(case.rotor.time), dtype=int)
    )
    key = "omega_sigma" if case.quantity == "omega" else "sigma"
    rotor = [{"window": int(k), **_extent(case.rotor, windows == k, key)} for k in np.unique(windows)]
    return {
        "label": case.label,
        "casing": {
            **_extent(case.casing, np.ones(len(case.casing.time), dtype=bool), key),
            "quantity": case.quantity,
            "sigma_source": case.casing.sigma_source,
        },
        "rotor": {"windows": rotor, "quantity": case.quantity, "sigma_source": case.rotor.sigma_source},
        "sense": case.extra["sense"],
        "warnings": list(case.warnings),
    }


def _extent(series: Series, chosen: npt.NDArray[np.bool_], key: str) -> dict[str, Any]:
    time, omega = series.time[chosen], series.omega[chosen]
    known = omega[np.isfinite(omega)]
    return {
        "samples": len(time),
        "t_start": float(time[0]),
        "t_stop": float(time[-1]),
        "omega_min": float(known.min()) if len(known) else None,
        "omega_max": float(known.max()) if len(known) else None,
        "median_sigma": float(np.median(getattr(series, key)[chosen])),
    }
