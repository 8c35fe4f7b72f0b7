"""Whether the torques of a model are ones that friction can make: how large each is, and the energy that it takes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fitting.typesetting import short

if TYPE_CHECKING:
    from fitting.estimation import Fit

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
    from fitting.dynamics import Dynamics
    from fitting.simulation import Sampler

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
