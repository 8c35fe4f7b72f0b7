"""Where the numbers of a report come from: data, program, libraries."""

from __future__ import annotations

import platform
import sys
from collections.abc import Mapping
from importlib import metadata
from typing import TYPE_CHECKING

from fitting.typesetting import short

if TYPE_CHECKING:
    from fitting.case_data import CaseData
    from fitting.estimation import Fit

_LIBRARIES = ("numpy", "scipy", "h5py", "matplotlib", "av", "opencv-contrib-python-headless")


def origin_rows(fit: Fit, given: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return the rows (what, from where): those `given`, the data of the fit, the versions."""
    from gyrotrack import __version__

    rows = [(str(k), str(v)) for k, v in given.items()]
    for data in fit.problem.data:
        r = data.record
        rows.append((f"case {r.label}", f"{r.source or 'in memory'}; SHA-256 of the numbers {r.digest}"))
        rows.append((f"samples of {r.label}", _samples(data)))
    rows.append(("gyrotrack", __version__))
    rows.append(("Python", f"{platform.python_version()} on {sys.platform}"))
    return [*rows, *_versions()]


def _samples(data: CaseData) -> str:
    r = data.record
    if r.single:
        facts = f"one body {len(r.casing)}; {data.n_effective:.0f} effective; I {short(r.I_casing, 4)} kg m²"
        return f"{facts}; measured: {r.quantity}"
    rotor = f"rotor {sum(len(w) for w in r.rotor)} in {len(r.rotor)} windows"
    inertia = f"I_rotor {short(r.I_rotor, 4)}, I_casing {short(r.I_casing, 4)} kg m²"
    seen = f"casing {len(r.casing)}, {rotor}; {data.n_effective:.0f} effective"
    return f"{seen}; {inertia}; measured: {r.quantity}"


def _versions() -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    for name in _LIBRARIES:
        try:
            rows.append((name, metadata.version(name)))
        except metadata.PackageNotFoundError:
            continue
    return [("libraries", ", ".join(f"{n} {v}" for n, v in rows))]
