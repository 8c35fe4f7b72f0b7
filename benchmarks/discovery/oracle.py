"""What any method could find: the hidden effect seen by someone who knows the noise and the effect's own constants.

With rows whitened by the true noise and everything that the base may move taken out (M), a hidden effect
leaves M v. lambda = |M v|^2 is the noncentrality of the test for exactly this effect: nothing tests better.
The part of M v that no rival (any effect, any of its shape constants on the grid) reproduces has the square
`apart`; where it is small the rival fits as well. The rate at which the truth then fits best is at most
Phi(sqrt(apart) / 2), for one rival.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np
from experiment import Hidden
from hidden import TWINS
from scipy.optimize import nnls

from fitting.discovery._score import CaseColumns, Trial
from fitting.effects._effect import Effect
from fitting.effects._library import LIBRARY
from fitting.effects._user import resolve
from fitting.inference._metrics import block_diagonal
from fitting.inference._noise import TorqueNoise
from fitting.inference._result import Fit

# rivals at no more shapes than these: enough for the nearest one to a tenth of a sigma or so
_MOST_SHAPES = 50
_NEVER = ("camera.centre", "camera.tilt", "camera.shutter", "camera.blur")


@dataclass(frozen=True)
class Reach:
    """Size of a hidden effect in sigma: whole, beside the base, and beside base and nearest rival."""

    whole: float
    beside_base: float
    beside_rival: float
    rival: str


class Oracle:
    """Looks at a fitted base with the true noise.

    Parameters
    ----------
    base : Fit
        The base, fitted to what was measured.
    noise : float
        True rms of the random torques [N m].
    time : float
        Their correlation time [s].
    """

    def __init__(self, base: Fit, noise: float, time: float) -> None:
        self._base = base
        self._cases = [CaseColumns(base, i) for i in range(len(base.problem.cases))]
        self._whiteners = [c.response.whitener(TorqueNoise(noise, time)) for c in self._cases]
        data = base.problem.data
        self._ends = np.cumsum([0, *(len(d.z) for d in data)])
        free = np.concatenate([p.jacobian for p in base.predictions])
        self._basis = _basis(
            self._white(np.concatenate([free, block_diagonal([d.nuisance for d in data])], axis=1))
        )

    def reach(self, name: str, worlds: list[Hidden]) -> Reach:
        """Return how far a hidden effect stands out: by its name in the library, or by its law."""
        effect = resolve(worlds[0].law) if worlds[0].law else LIBRARY[name]
        v = self._seen(effect, worlds)
        left = self._left(v)
        rival, apart = self._nearest(left, effect)
        return Reach(*(float(np.linalg.norm(x)) for x in (v, left)), apart, rival)

    def default_for(self, name: str, worlds: list[Hidden]) -> Oracle:
        """Return an oracle for whom the strength of this effect, too, is free in the base."""
        more = copy(self)
        more._basis = _basis(np.column_stack([self._basis, self._seen(LIBRARY[name], worlds)]))  # noqa: SLF001
        return more

    def _seen(self, effect: Effect, worlds: list[Hidden]) -> np.ndarray:
        """Return what the rows show of an effect, whitened."""
        rows = []
        for case, world in zip(self._cases, worlds, strict=True):
            law = resolve(world.law) if world.law else effect
            found = case.trials(law, [_shape(law, world)])[0].columns
            rows.append(found @ _strength(law, world))
        return self._white(np.concatenate(rows))

    def _nearest(self, left: np.ndarray, effect: Effect) -> tuple[str, float]:
        same = frozenset({effect.name}).union(*(t for t in TWINS if effect.name in t))
        best = ("", float(np.linalg.norm(left)))
        for rival in (e for e in LIBRARY.values() if e.searched):
            if (
                rival.name in same
                or rival.name in self._base.model.names
                or rival.name in _NEVER
                or rival.restoring
            ):
                continue
            groups = self._rows(rival)
            every = self._left(self._white(np.concatenate(groups, axis=1)))
            for seen in np.split(every, len(groups), axis=1):
                apart = _distance(left, seen, one_sign=_one_sign(rival))
                if apart < best[1]:
                    best = (rival.name, apart)
        return best

    def _rows(self, rival: Effect) -> list[np.ndarray]:
        """Return the columns of a rival over the rows of all cases, for each of its shapes."""
        trials = [c.trials(rival) for c in self._cases]
        every = max(1, max(len(t) for t in trials) // _MOST_SHAPES)
        if not rival.per_case:
            together = zip(*(t[::every] for t in trials), strict=False)
            return [np.concatenate([t.columns for t in one]) for one in together]
        combined = self._own(trials) if len(trials) > 1 else [[t] for t in trials[0]]
        return [block_diagonal([t.columns for t in one]) for one in combined]

    def _own(self, trials: list[list[Trial]]) -> list[list[Trial]]:
        """Return shapes of each case beside a middle one of the others: not all combinations."""
        middle = [t[len(t) // 2] for t in trials]
        return [
            [t if j == i else middle[j] for j in range(len(trials))]
            for i, one in enumerate(trials)
            for t in one
        ]

    def _left(self, rows: np.ndarray) -> np.ndarray:
        return np.asarray(rows - self._basis @ (self._basis.T @ rows))

    def _white(self, rows: np.ndarray) -> np.ndarray:
        parts = zip(self._whiteners, self._ends, self._ends[1:], strict=False)
        return np.concatenate([w(rows[a:b]) for w, a, b in parts])


def _basis(columns: np.ndarray) -> np.ndarray:
    size = np.linalg.norm(columns, axis=0)
    u, s, _ = np.linalg.svd(columns[:, size > 0] / size[size > 0], full_matrices=False)
    return np.asarray(u[:, s > 1e-10 * s[0]])


def _distance(v: np.ndarray, columns: np.ndarray, *, one_sign: bool) -> float:
    """Return how far v is from what the columns can be, with strengths of one sign only if so wished."""
    size = np.linalg.norm(columns, axis=0)
    columns = columns[:, size > 0] / size[size > 0]
    if not columns.shape[1]:
        return float(np.linalg.norm(v))
    if one_sign:
        return float(nnls(columns, v)[1])
    q = _basis(columns)
    return float(np.linalg.norm(v - q @ (q.T @ v)))


def _one_sign(effect: Effect) -> bool:
    # windage of the other sign would be a touch point under load
    return (
        effect.amplitude is not None
        and effect.amplitude.lower == 0
        and not any(p.role == "phase" for p in effect.parameters)
    )


def _shape(effect: Effect, world: Hidden) -> dict[str, float]:
    return {p.symbol: world.truth[p.symbol] for p in effect.parameters if p.role == "shape"}


def _strength(effect: Effect, world: Hidden) -> np.ndarray:
    """Return the strength of each column: k cos(phi) and k sin(phi) where there is a phase."""
    k = next(world.truth[p.symbol] for p in effect.parameters if p.role == "amplitude")
    phi = next((world.truth[p.symbol] for p in effect.parameters if p.role == "phase"), None)
    return k * (np.ones(1) if phi is None else np.array([np.cos(phi), np.sin(phi)]))
