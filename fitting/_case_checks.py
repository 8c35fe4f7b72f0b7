"""Checks of the values of a case, for both packages: before they are written, after they were read, and in memory.

Each check returns None or a `Defect`, which contains the sentence and the hint of an error.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

MOST_AMPLITUDES = 400
"""Largest number of amplitudes of a record [1]. Chosen: each amplitude is a parameter of every fit; a larger value
makes fits slow, a smaller one refuses recordings with many windows."""
_ROUNDING = 1e-9
"""Largest asymmetry and largest negative eigenvalue of a correlation matrix that count as rounding errors [1]. Chosen:
a smaller value refuses computed covariances, a larger one accepts invalid matrices."""


_BODY_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,40}")
# names with a meaning in the library
_TAKEN = {
    "ground",
    "rotor",
    "casing",
    "bearing",
    "touchpoint",
    "external",
    "input",
    "camera",
    "setup",
    "contact",
    "initial",
}


class Defect(NamedTuple):
    """The sentence of an error, and a hint on how to correct the error."""

    what: str
    hint: str


def defect_of_mode(basis: Any, covariance: Any, measured: Any) -> Defect | None:
    """Check basis and covariance of an error mode; `measured` is a mask of the samples of the series with a value."""
    basis, covariance = (np.asarray(a, dtype=float) for a in (basis, covariance))
    samples = len(measured)
    if basis.ndim != 2 or len(basis) != samples or not basis.size:
        return Defect(
            f"its basis has the shape {basis.shape} for {samples} samples",
            "give one row for each sample and one column for each amplitude",
        )
    amplitudes = basis.shape[1]
    if amplitudes > MOST_AMPLITUDES:
        return Defect(
            f"it has {amplitudes} amplitudes; at most {MOST_AMPLITUDES} can be fitted",
            "combine the smallest amplitudes into the uncertainty of the samples",
        )
    if covariance.shape != (amplitudes, amplitudes):
        return Defect(
            f"its covariance has the shape {covariance.shape} for {amplitudes} amplitudes",
            "give a symmetric matrix with one row for each column of the basis",
        )
    for name, values in (("basis", basis[measured]), ("covariance", covariance)):
        if not np.isfinite(values).all():
            return Defect(f"its {name} has values that are not finite", "leave the mode out")
    if not _is_covariance(covariance):
        return Defect(
            "its covariance is not symmetric or has a negative variance", "give a covariance matrix"
        )
    return None


def _is_covariance(matrix: Any) -> bool:
    """Return whether a matrix of finite numbers is a covariance, apart from rounding errors."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    with np.errstate(over="ignore"):
        correlation = matrix / scale[:, None] / scale
    if not np.isfinite(correlation).all() or np.abs(correlation - correlation.T).max() > _ROUNDING:
        return False
    return bool(np.linalg.eigvalsh((correlation + correlation.T) / 2)[0] >= -_ROUNDING)


def defect_of_clock(covariance: Any) -> Defect | None:
    """Check the covariance of offset and rate of a clock."""
    if np.isfinite(covariance).all() and (np.diag(covariance) >= 0).all():
        return None
    return Defect("it has no covariance of offset and rate", "give a covariance matrix (2, 2)")


def defect_of_inertia(body: str, inertia: float, u: float, *, optional: bool = False) -> Defect | None:
    """Check a moment of inertia and its standard uncertainty, which may be NaN [kg m2]."""
    if not 0 < inertia < math.inf:
        what = f"the moment of inertia of the {body} is {inertia:g}, not positive"
        return Defect(what, f"give a positive value [kg m2]{', or none' if optional else ''}")
    if u < 0 or u == math.inf:
        what = f"the standard uncertainty of the moment of inertia of the {body} is {u:g}"
        return Defect(what, "give a positive value [kg m2], or none")
    return None


def defect_of_inertias(attributes: Mapping[str, Any]) -> Defect | None:
    """Check the moments of inertia in the attributes of a case (`_case_format.CASE_ATTRIBUTES`)."""
    two = attributes["bodies"] == "two"
    if two and attributes["per_inertia"]:
        what = "an inertia is missing: torques between two bodies follow from the ratio of inertias"
        return Defect(what, "give the moments of inertia of both bodies [kg m2]")
    names = {"casing": "casing", "rotor": "rotor"} if two else {"casing": attributes["body_name"] or "body"}
    for key, name in names.items():
        inertia, u = attributes[f"I_{key}"], attributes[f"I_{key}_u"]
        if math.isnan(inertia):
            return Defect(f"the attribute 'I_{key}' is missing", f"give the inertia of the {name} [kg m2]")
        if defect := defect_of_inertia(name, inertia, u):
            return defect
    return None


def is_body_name(name: str) -> bool:
    """Return whether a text can name a single body: an identifier without a meaning in the library."""
    return name not in _TAKEN - {"casing"} and _BODY_NAME.fullmatch(name) is not None


def defect_of_joints(names: Sequence[str], joints: Mapping[str, Sequence[str]]) -> Defect | None:
    """Check the names of several bodies, and whether joints connect all bodies."""
    if len(names) < 2:
        return Defect(f"a joint connects two bodies, but {names[0]} is the only body", "leave joints out")
    if not joints:
        return Defect(
            f"no joint connects the bodies {', '.join(names)}", "state which bodies each joint connects"
        )
    wrong = next(
        (n for n in (*names, *joints) if not isinstance(n, str) or n == "casing" or not is_body_name(n)), None
    )
    if wrong is not None:
        return Defect(
            f"{str(wrong)[:40]!r} cannot be the name of a body or a joint: it has another meaning in laws",
            "choose another name, for example wheel or belt",
        )
    if len({*names, *joints}) < len(names) + len(joints):
        return Defect("a body and a joint have the same name", "give each a different name")
    for joint, (first, second) in joints.items():
        if first not in names or second not in names or first == second:
            return Defect(
                f"the joint {joint} is between {str(first)[:30]} and {str(second)[:30]}",
                f"name two of the bodies {', '.join(names)}",
            )
    reached = {names[0]}
    for _ in names:
        reached |= {body for pair in joints.values() if reached & {*pair} for body in pair}
    loose = [n for n in names if n not in reached]
    if loose:
        return Defect(
            f"no joint connects {loose[0]} to {names[0]}",
            "bodies without a common joint are separate cases",
        )
    return None


def defect_of_chain(
    inertias: Mapping[str, tuple[float, float]], joints: Mapping[str, Sequence[str]]
) -> Defect | None:
    """Check several bodies: their joints, and the moment of inertia of each with its uncertainty [kg m2]."""
    if defect := defect_of_joints([*inertias], joints):
        return defect
    for name, (value, u) in inertias.items():
        if math.isnan(value):
            what = f"{name} has no inertia: torques between bodies follow from the ratios of their inertias"
            return Defect(what, f"give the inertia of the {name} [kg m2]")
        if defect := defect_of_inertia(name, value, u):
            return defect
    return None
