"""Plausibility of fitted torques, and the provenance of the numbers of a report."""

from __future__ import annotations

import platform
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import metadata
from typing import TYPE_CHECKING

import numpy as np

from fitting._numbers import short

if TYPE_CHECKING:
    from fitting.inference._case_data import CaseData
    from fitting.inference._result import Fit


_LIBRARIES = ("numpy", "scipy", "h5py", "matplotlib", "av", "opencv-contrib-python-headless")


def origin_rows(fit: Fit, given: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return the rows (what, from where): those `given`, the data of the fit, the versions."""
    from gyrotrack._versions import __version__

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


_POINTS = 800
_NEGLIGIBLE = 1e-3


@dataclass(frozen=True)
class Plausibility:
    """One effect in one case: largest torques on both bodies, energy that it takes, its share, and a word on it."""

    effect: str
    case: str
    rotor: str
    casing: str
    energy: str
    share: str
    word: str


def plausibility_rows(fit: Fit) -> list[Plausibility]:
    """Return what each effect that moves bodies does along the motion of each case.

    The torque of an effect is that of the whole model minus that of the model without it; the energy it takes is
    minus the integral of the power of both torques.
    """
    several = len(fit.problem.data) > 1
    return [row for i in range(len(fit.problem.data)) for row in _case(fit, i, named=several)]


def _case(fit: Fit, index: int, *, named: bool) -> list[Plausibility]:
    from fitting.dynamics._mesh import Sampler
    from fitting.dynamics._model import Dynamics

    case, path = fit.problem.cases[index], fit.predictions[index].path
    record = fit.problem.data[index].record
    inertia = np.array([record.I_rotor, record.I_casing])
    numbers = fit.problem.layout.numbers(fit.theta, index)
    time = np.linspace(path.mesh.edges[0], path.mesh.edges[-1], _POINTS)
    state = Sampler(path.mesh, time).value(path.y)
    whole = case.dynamics.rates(time, state, numbers)[:, :2]
    found = []
    model = fit.problem.layout.model.smooth
    for effect in model.effects:
        if effect.joint == "inertia":
            continue
        rest = Dynamics(model.without(effect.name))
        if not set(rest.states) <= set(path.states):
            continue
        seen = state[:, [path.states.index(s) for s in rest.states]]
        torque = (whole - rest.rates(time, seen, numbers)[:, :2]) * inertia
        power = np.sum(torque * state[:, :2], axis=1)
        found.append((effect.name, torque, -float(np.sum(0.5 * (power[1:] + power[:-1]) * np.diff(time)))))
    total = sum(max(e, 0.0) for _, _, e in found) or 1.0
    return [
        Plausibility(
            effect=name,
            case=record.label if named else "",
            rotor=short(float(np.abs(torque[:, 0]).max())),
            casing=short(float(np.abs(torque[:, 1]).max())),
            energy=short(energy, 3),
            share=f"{100 * energy / total:.1f} %".replace("-", "−"),
            word=_word(energy, total),
        )
        for name, torque, energy in found
    ]


def _word(energy: float, total: float) -> str:
    if abs(energy) < _NEGLIGIBLE * total:
        return "negligible"
    return "takes energy, as friction does" if energy > 0 else "gives energy: no friction does that"
