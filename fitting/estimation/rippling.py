"""Responses to torques that follow the casing's angle: computed on the samples, about an angle without noise.

The noise of an angle, put into a sine of that very angle, is a torque that wanders. So the angle is that of the model,
and beside it what the measurement differs by, smoothed by cubics in as few pieces as it allows,

    BIC(pieces) = N log(sum of squares left) + 4 pieces log(N)

(G. Schwarz, Ann. Stat. 6, 461 (1978)): a model that fails by much is followed closely, one that holds is believed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from fitting.case_data import CaseData
from fitting.effects import Effect
from fitting.expression import Tape
from fitting.rough_speeds import hermite
from fitting.simulation import Path, Sampler
from fitting.simulation.linear import LinearMotion
from fitting.simulation.mesh import rule

Array = NDArray[np.float64]

_GAUSS = 3
_PIECES = (480, 240, 120, 60, 30, 15)
_MIN_PIECE = 12
_CUBIC = 4


def ripple_rows(
    data: CaseData, effect: Effect, path: Path, motion: LinearMotion, numbers: Mapping[str, float]
) -> tuple[Array, Array]:
    """Return the rows that a law gives at strength 1, at phase 0 and at a quarter turn.

    Parameters
    ----------
    data : CaseData
        The case.
    effect : Effect
        A law that follows an angle.
    path : Path
        The solution without it.
    motion : LinearMotion
        Small motions about the solution.
    numbers : mapping of str to float
        Parameters by key. A law of some strength meets the ripple that it makes itself, which gives a mean torque of
        second order.
    """
    record = data.record
    t = record.casing.time
    half = 0.5 * np.diff(t)
    inner = ((t[:-1] + half)[:, None] + half[:, None] * rule(_GAUSS).x).ravel()
    sampler = Sampler(path.mesh, inner)
    known = {name: sampler.value(path.y[..., i]) for i, name in enumerate(path.states[:2])}
    known["delta"] = known["omega_r"] - known["omega_c"]
    known["psi_r"] = sampler.integral(*path.angle("omega_r"))
    known["psi_c"] = sampler.integral(*path.angle("omega_c"))
    known["t"] = inner
    pieces = 0
    if data.is_angle:
        left = record.casing.value - Sampler(path.mesh, t).integral(*path.angle("omega_c"))
        pieces = pieces_needed(t, left)
        known["psi_c"] = known["psi_c"] + np.interp(inner, t, smoothed(t, left, pieces))
    tape = Tape([effect.expression])
    on_rotor = {"rotor": 1.0, "casing": 0.0, "bearing": -1.0}[effect.joint]
    on_casing = {"rotor": 0.0, "casing": 1.0, "bearing": 1.0}[effect.joint]
    direction = np.array([on_rotor / record.I_rotor, on_casing / record.I_casing])
    laws, strength = _unit_laws(effect, numbers)

    def driven() -> tuple[Array, Array]:
        torque = [np.asarray(tape({**law, **known})[0]) * np.ones(len(inner)) for law in laws]
        return motion.driven(t, np.stack(torque, axis=-1).reshape(len(half), _GAUSS, -1), direction)

    speed, angle = driven()
    if pieces and strength.any():
        known["psi_c"] = known["psi_c"] + _swing(t, angle[1] @ strength, speed[1] @ strength, inner, pieces)
        speed, angle = driven()
    rows = data.casing_rows(angle[1] if data.is_angle else speed[1]) + _rotor_rows(data, speed[0], angle[0])
    return rows[:, 0], rows[:, 1]


def pieces_needed(time: Array, values: Array) -> int:
    """Return in how many pieces a noisy curve is to be smoothed."""
    n = len(time)
    counts = sorted({max(1, min(c, n // _MIN_PIECE)) for c in _PIECES})
    left = [float(np.sum((values - smoothed(time, values, c)) ** 2)) for c in counts]
    bic = [n * np.log(x + 1e-300) + _CUBIC * c * np.log(n) for x, c in zip(left, counts, strict=True)]
    return counts[int(np.argmin(bic))]


def smoothed(time: Array, values: Array, pieces: int) -> Array:
    """Return a curve smoothed by a cubic in each of some pieces of equally many samples."""
    ends = np.array([len(part) for part in np.array_split(np.empty(len(time)), pieces)]).cumsum()
    first, last = np.concatenate([[0], ends[:-1]]), ends - 1
    piece = np.repeat(np.arange(pieces), ends - first)
    middle, reach = 0.5 * (time[first] + time[last]), np.maximum(0.5 * (time[last] - time[first]), 1e-9)
    powers = legvander((time - middle[piece]) / reach[piece], _CUBIC - 1)
    gram = np.add.reduceat(powers[:, :, None] * powers[:, None, :], first)
    seen = np.add.reduceat(powers * values[:, None], first)
    cubic = (np.linalg.pinv(gram, hermitian=True) @ seen[..., None])[..., 0]
    return np.asarray(np.sum(powers * cubic[piece], axis=1))


def _unit_laws(effect: Effect, numbers: Mapping[str, float]) -> tuple[Sequence[dict[str, float]], Array]:
    """Return the parameters of the law at strength 1 and both phases, and the present strengths of the two."""
    values = {p.symbol: numbers.get(f"{effect.name}.{p.symbol}", p.start) for p in effect.parameters}
    symbol = {p.role: p.symbol for p in effect.parameters}
    # what is held has another role: then it stands in the law as it is
    phase, amplitude = symbol.get("phase", ""), symbol.get("amplitude", "")
    unit = {amplitude: 1.0} if amplitude else {}
    laws = [values | unit | ({phase: phi} if phase else {}) for phi in (0.0, np.pi / 2)]
    k = numbers.get(f"{effect.name}.{amplitude}", 0.0) if amplitude else 1.0
    phi = values.get(phase, 0.0)
    return laws, k * np.array([np.cos(phi), np.sin(phi)])


def _swing(t: Array, angle: Array, speed: Array, times: Array, pieces: int) -> Array:
    """Return by how much a law's own ripple of the angle exceeds what the smoothed angle shows of it."""
    seen = np.interp(times, t, smoothed(t, angle, pieces))
    return hermite(t, angle, speed, times) - seen


def _rotor_rows(data: CaseData, speed: Array, angle: Array) -> Array:
    # the bearing passes on what is slow; the ripple itself moves the rotor by less than can be seen
    t = data.record.casing.time
    times = [np.clip(w.node_times, t[0], t[-1]) for w in data.rotor]
    seen = [hermite(t, angle, speed, w, slopes=not data.is_angle) for w in times]
    return data.rows(np.zeros((len(data.casing.node_times), angle.shape[1])), seen)
