"""Small motions about a solution, by variation of constants.

With the fundamental matrix Phi(t) of the linearised speeds, a torque u(t) along b gives

    d omega(t) = Phi(t) integral Phi^-1(s) b u(s) ds,
    d psi(t)   = integral [Psi(t) - Psi(s)] Phi^-1(s) b u(s) ds,    Psi = integral of Phi,

which needs only running sums over the times at which u is known, however fast u varies. A casing that comes
to rest forgets what moved it; so that Phi keeps its inverse, it is taken to remember a millionth.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitting.simulation.collocation import Path, Propagator, Sampler, rule

Array = NDArray[np.float64]

_MEMORY = 1e-6


class LinearMotion:
    """The linearised motion of both speeds (states of effects held) about a solution.

    Parameters
    ----------
    path : Path
        The solution.
    propagator : Propagator
        Its linearised equations.
    """

    def __init__(self, path: Path, propagator: Propagator) -> None:
        n = len(path.states)
        self._sense = path.sense
        zero = np.zeros((*path.y.shape, 2))
        edges = propagator.remembering(_MEMORY).chain(
            zero, np.zeros((path.y.shape[0], n, 2)), np.eye(n)[:, :2]
        )
        self._mesh = path.mesh
        self._nodes = np.einsum("iknm,imq->iknq", propagator.transfer, edges[:-1])[:, :, :2]
        steps = path.mesh.half[..., None] * np.einsum("k,iknm->inm", rule().w, self._nodes)
        self._starts = np.concatenate([np.zeros((1, 2, 2)), np.cumsum(steps, axis=0)])

    def fundamental(self, times: Array) -> Array:
        """Return Phi at some times, shape (times, 2, 2)."""
        return Sampler(self._mesh, times).value(self._nodes)

    def integrated(self, times: Array) -> Array:
        """Return Psi at some times, shape (times, 2, 2)."""
        return Sampler(self._mesh, times).integral(self._starts, self._nodes)

    def kicks(self, times: Array, direction: Array) -> Array:
        """Return Phi^-1(s) b, shape (times, 2); b holds the rates that a unit torque gives [rad s-2]."""
        pushes = np.stack([np.full(len(times), direction[0]), direction[1] * self.moving(times)], axis=1)
        return np.asarray(np.linalg.solve(self.fundamental(times), pushes[..., None])[..., 0])

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
        kicks = self.kicks(inner.ravel(), direction).reshape(*inner.shape, 2)
        reach = self.integrated(inner.ravel()).reshape(*inner.shape, 2, 2)
        kicks *= (half[:, None] * gauss.w)[..., None]
        pushes = np.einsum("iqm,iqc->imc", kicks, torque)
        delayed = np.einsum("iqsm,iqm->iqs", reach, kicks)
        sums = np.concatenate([np.zeros((1, *pushes.shape[1:])), np.cumsum(pushes, axis=0)])
        late = np.einsum("iqs,iqc->sic", delayed, torque)
        late = np.concatenate([np.zeros((2, 1, late.shape[2])), np.cumsum(late, axis=1)], axis=1)
        speed = np.einsum("tsm,tmc->stc", self.fundamental(times), sums)
        angle = np.einsum("tsm,tmc->stc", self.integrated(times), sums) - late
        return speed, angle
