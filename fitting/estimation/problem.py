"""All cases of a fit as one least-squares problem in straight variables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fitting.case_data import CaseData
from fitting.estimation.case_model import CaseModel, Prediction
from fitting.estimation.coordinates import Valley, find_valleys, from_physical, to_physical
from fitting.estimation.layout import Layout
from fitting.estimation.waves import find_waves, from_polar, to_polar
from fitting.noise import WHITE, Whitener

Array = NDArray[np.float64]

_ROUNDING = 1e-11


class Projection:
    """Whitens the rows of a case and takes out what its nuisances can explain."""

    def __init__(self, data: CaseData, whitener: Whitener) -> None:
        self.whitener = whitener
        columns = whitener(data.nuisance)
        size = np.linalg.norm(columns, axis=0)
        u, s, _ = np.linalg.svd(columns[:, size > 0] / size[size > 0], full_matrices=False)
        self.basis = u[:, s > 1e-7 * s.max(initial=1.0)]

    def __call__(self, rows: Array) -> Array:
        """Return the whitened rows, orthogonal to the nuisances."""
        white = self.whitener(rows)
        return np.asarray(white - self.basis @ (self.basis.T @ white))

    def unexplained(self, columns: Array) -> Array:
        """Return the same of columns, nothing where a nuisance explains a column down to rounding."""
        white = self.whitener(columns)
        left = white - self.basis @ (self.basis.T @ white)
        size = np.linalg.norm(white, axis=0)
        return np.asarray(np.where(np.linalg.norm(left, axis=0) > _ROUNDING * size, left, 0.0))


class Problem:
    """Residuals and Jacobian of all cases.

    Parameters
    ----------
    layout : Layout
        The variables.
    data : sequence of CaseData
        The cases, in the order of the layout.
    """

    def __init__(self, layout: Layout, data: Sequence[CaseData]) -> None:
        self.layout, self.data = layout, tuple(data)
        self.cases = [CaseModel(d, layout, i) for i, d in enumerate(data)]
        self.projections = [Projection(d, WHITE) for d in data]
        self.reference = reference_speed(self.data)
        self.valleys = find_valleys(layout, [d.rough_speeds for d in data])
        # where the last search ended on bounds of d or f: its valleys, and which variables are held
        self.edge: tuple[tuple[Valley, ...], tuple[int, ...]] | None = None

    def set_noise(self, whiteners: Sequence[Whitener]) -> None:
        """Weigh the rows by this noise from now on."""
        self.projections = [Projection(d, w) for d, w in zip(self.data, whiteners, strict=True)]

    def predict(self, theta: Array) -> list[Prediction]:
        """Return the prediction of each case at physical variables."""
        return [case.predict(theta) for case in self.cases]

    def residuals(self, predictions: Sequence[Prediction]) -> tuple[Array, Array]:
        """Return whitened, projected residuals and their Jacobian by the physical variables.

        The rows of each case are turned so that a few hold all: a case with p variables has p + 1 rows. Sums of
        squares and of products, all that least squares knows, stay what they are.
        """
        r, j = [], []
        for data, project, p in zip(self.data, self.projections, predictions, strict=True):
            both = project.unexplained(np.concatenate([p.columns, (p.rows - data.z)[:, None]], axis=1))
            few = turned(both)
            r.append(few[:, -1])
            dense = np.zeros((len(few), p.count))
            dense[:, p.places] = few[:, :-1]
            j.append(dense)
        return np.concatenate(r), np.concatenate(j)

    @property
    def rows(self) -> int:
        """Number of rows of all cases that nuisances leave."""
        return sum(len(d.z) - p.basis.shape[1] for d, p in zip(self.data, self.projections, strict=True))

    def __call__(self, u: Array) -> tuple[Array, Array]:
        """Return residuals and Jacobian by the straight variables u."""
        waves = find_waves(self.layout)
        theta, slope = to_physical(u, self.valleys)
        theta, turn = to_polar(theta, waves)
        r, j = self.residuals(self.predict(theta))
        if waves:
            j = j @ turn
        return r, j @ slope if self.valleys else j

    def straight(self, theta: Array) -> Array:
        """Return the straight variables of physical ones."""
        return from_physical(from_polar(theta, find_waves(self.layout)), self.valleys)

    def physical(self, u: Array) -> Array:
        """Return the physical variables of straight ones."""
        return to_polar(to_physical(u, self.valleys)[0], find_waves(self.layout))[0]

    def straight_bounds(self, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Return the bounds of the straight variables: d and f may leave theirs on the way, a lone f only upwards.

        A strength with a phase has none.
        """
        lower, upper = lower.copy(), upper.copy()
        for w in find_waves(self.layout):
            lower[w.strength], upper[w.strength] = -np.inf, np.inf
        for v in self.valleys:
            if v.held:
                free = v.f if v.held == "d" else v.d
                lower[free], upper[free] = -np.inf, np.inf
            elif v.d is not None:
                lower[[v.d, v.f]], upper[[v.d, v.f]] = -np.inf, np.inf
            else:
                lower[v.f], upper[v.f] = 0.0 if lower[v.f] >= 0 else -np.inf, np.inf
        return lower, upper


def turned(columns: Array) -> Array:
    """Return columns turned into as many rows as there are columns: all their products stay the same."""
    return np.asarray(np.linalg.qr(columns, mode="r") if np.isfinite(columns).all() else columns)


def reference_speed(data: Sequence[CaseData]) -> float:
    """Return a typical speed of the bearing in these cases [rad/s]."""
    typical = []
    for d in data:
        _, speeds = d.rough_speeds
        typical.append(np.median(np.abs(speeds[:, 0] - speeds[:, 1])))
    return float(max(np.mean(typical), 1e-3))
