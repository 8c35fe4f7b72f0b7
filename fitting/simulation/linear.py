"""Small motions about a solution, by variation of constants.

With the fundamental matrix Phi(t) of the linearised equations, a torque u(t) along b gives

    d omega(t) = Phi(t) integral Phi^-1(s) b u(s) ds,
    d psi(t)   = integral [Psi(t) - Psi(s)] Phi^-1(s) b u(s) ds,    Psi = integral of Phi,

which needs only running sums over the times at which u is known, however fast u varies. A casing that comes
to rest forgets what moved it; so that Phi keeps its inverse, it is taken to remember a millionth.

Where one motion dies away long before the record ends, what is left of any column of Phi is the other one, and the
inverse has lost its digits. Then the column that dies is computed backwards from the end, where it grows and nothing
else does, and its integral is taken from there: the dichotomy of U. Ascher, R. Mattheij, R. Russell, Numerical
Solution of Boundary Value Problems for Ordinary Differential Equations, SIAM (1995), ch. 6.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitting.errors import SimulationError
from fitting.simulation.mesh import Path, Sampler, rule
from fitting.simulation.propagator import UNBOUNDED, Propagator

Array = NDArray[np.float64]

_MEMORY = 1e-6
# columns of Phi nearer to dependent than this have lost their digits
_DEPENDENT = 1e-9


class LinearMotion:
    """The linearised motion of both speeds about a solution.

    States of effects (a warmth, a phase) move with the speeds and act back on them. Where anything forgets so fast that
    Phi has no inverse, all of these states are held.

    Parameters
    ----------
    path : Path
        The solution.
    propagator : Propagator
        Its linearised equations.
    """

    def __init__(self, path: Path, propagator: Propagator) -> None:
        self._sense, self._mesh = path.sense, path.mesh
        dying: list[int] = []
        self._nodes = _fundamental(propagator)
        if not _independent(self._nodes):
            propagator = propagator.of_speeds()
            self._nodes = _fundamental(propagator)
            if not _independent(self._nodes):
                self._nodes, dying = _parted(propagator), [1]
        steps = path.mesh.half[..., None] * np.tensordot(self._nodes, rule().w, (1, 0))
        self._starts = np.concatenate([np.zeros((1, *steps.shape[1:])), np.cumsum(steps, axis=0)])
        self._starts[:-1, :, dying] = -np.cumsum(steps[::-1, :, dying], axis=0)[::-1]
        self._starts[-1, :, dying] = 0.0

    def fundamental(self, times: Array) -> Array:
        """Return the speeds' rows of Phi at some times, shape (times, 2, n)."""
        return Sampler(self._mesh, times).value(self._nodes)[:, :2]

    def integrated(self, times: Array) -> Array:
        """Return the speeds' rows of Psi at some times, shape (times, 2, n)."""
        return Sampler(self._mesh, times).integral(self._starts, self._nodes)[:, :2]

    def kicks(self, times: Array, direction: Array) -> Array:
        """Return Phi^-1(s) b, shape (times, n); b holds the rates that a unit torque gives [rad s-2]."""
        return self._kicks(Sampler(self._mesh, times), direction)

    def _kicks(self, sampler: Sampler, direction: Array) -> Array:
        phi = sampler.value(self._nodes)
        pushes = np.zeros(phi.shape[:2])
        pushes[:, 0] = direction[0]
        pushes[:, 1] = direction[1] * np.abs(self._sense[sampler.index])
        try:
            return np.asarray(np.linalg.solve(phi, pushes[..., None])[..., 0])
        except np.linalg.LinAlgError:
            # after several stops nothing is remembered of what was before: not even a millionth of a millionth
            if not np.isfinite(phi).all():
                raise SimulationError(UNBOUNDED) from None
            return np.asarray((np.linalg.pinv(phi) @ pushes[..., None])[..., 0])

    def moving(self, times: Array) -> Array:
        """Return 1 where the casing answers to a torque, 0 where friction holds it."""
        return np.abs(self._sense[Sampler(self._mesh, times).index])

    def driven(self, times: Array, torque: Array, direction: Array) -> tuple[Array, Array]:
        """Return d omega and d psi of both bodies at sample times, for a torque between them.

        Parameters
        ----------
        times : ndarray, shape (n,)
            Sample times [s].
        torque : ndarray, shape (n - 1, q, columns)
            Torques [N m] at the q Gauss nodes of each interval between samples.
        direction : ndarray, shape (2,)
            Rates of both speeds that a unit torque gives.

        Returns
        -------
        tuple of ndarray, each of shape (2, n, columns)
            The rotor first, the casing second.
        """
        gauss = rule(torque.shape[1])
        half = 0.5 * np.diff(times)
        inner = (times[:-1] + half)[:, None] + half[:, None] * gauss.x
        sampler = Sampler(self._mesh, inner.ravel())
        kicks = self._kicks(sampler, direction).reshape(*inner.shape, -1)
        reach = sampler.integral(self._starts, self._nodes)[:, :2].reshape(*inner.shape, 2, -1)
        kicks *= (half[:, None] * gauss.w)[..., None]
        pushes = kicks.transpose(0, 2, 1) @ torque
        delayed = (reach @ kicks[..., None])[..., 0]
        sums = np.concatenate([np.zeros((1, *pushes.shape[1:])), np.cumsum(pushes, axis=0)])
        late = np.moveaxis(delayed.transpose(0, 2, 1) @ torque, 1, 0)
        late = np.concatenate([np.zeros((2, 1, late.shape[2])), np.cumsum(late, axis=1)], axis=1)
        sampler = Sampler(self._mesh, times)
        phi, psi = sampler.value(self._nodes), sampler.integral(self._starts, self._nodes)
        speed, angle = (np.moveaxis(m[:, :2] @ sums, 1, 0) for m in (phi, psi))
        return speed, angle - late


def _fundamental(propagator: Propagator) -> Array:
    """Return Phi of all states at the nodes, shape (intervals, nodes, n, n)."""
    first = np.eye(propagator.transfer.shape[-1])
    return propagator.carried(_chained(propagator, first))


def _chained(propagator: Propagator, first: Array) -> Array:
    """Return what becomes of small deviations at the start, at all edges."""
    nothing = np.zeros((*propagator.transfer.shape[:2], *first.shape))
    return propagator.remembering(_MEMORY).chain(nothing, nothing[:, 0], first)


def _parted(propagator: Propagator) -> Array:
    """Return two motions of the speeds at the nodes: what is remembered longest, and what dies away before."""
    lasting = _chained(propagator, np.array([[1.0], [0.0]]))
    end = lasting[-1] / np.linalg.norm(lasting[-1])
    dying = propagator.remembering(_MEMORY).back(np.array([-end[1], end[0]]))
    size = np.linalg.norm(dying[0])
    if not np.isfinite(size):
        raise SimulationError(UNBOUNDED)
    return propagator.carried(np.concatenate([lasting, dying / size], axis=2))


def _independent(phi: Array) -> bool:
    """Return whether the columns of Phi keep apart."""
    size = np.linalg.norm(phi, axis=-2, keepdims=True)
    if not (size > 0).all():
        return False
    return float(np.linalg.svd(phi / size, compute_uv=False)[..., -1].min()) > _DEPENDENT
