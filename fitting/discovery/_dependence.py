"""The unmodelled torque as a smooth function of each variable, with explained share, p-value and uncertainty band.

The unmodelled torque on a body is the same function f(x) of a variable x in all recordings. f is a cubic spline for
t, omega_r, omega_c and delta, a sum of harmonics for an angle, and a product of splines for a pair of variables. Let r
be the whitened residuals, S the rows of the functions, and M the projection that removes all parameters of the base and
the nuisance parameters. Then

    chi2 = r'M S (S'M S)^+ S'M r

has rank(M S) degrees of freedom if no torque is missing. The level of the process noise is profiled. The p-value is
family-wise: it is compared with the smallest p-value of all these correlated tests in null data (P. Westfall, S. Young,
Resampling-Based Multiple Testing (1993)). The size of the lack of fit is the excess of chi-square over its degrees of
freedom at the noise level of the data. The explained share is the part of this excess that the function removes.

The curve has finer splines than the test, so that it resolves a resonance. The coefficients b of the splines have a
Gaussian prior with the Matern covariance of order 3/2,

    cov(b_i, b_j) = s^2 (1 + q) exp(-q),   q = sqrt(3) |x_i - x_j| / l,

at the centres x_i of the splines. s and l maximise the likelihood (C. Rasmussen, C. Williams, Gaussian Processes for
Machine Learning, MIT Press (2006), ch. 5). A broad law gives a large l, which averages the noise; a narrow peak gives a
small l. The base already contains some functions, for example a linear drag. The data hardly determine some other
functions. The curve is therefore the least-squares estimate of the part of the torque that the data determine better
than the prior; its band is the standard uncertainty. A law is compared with the curve after the same projection.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.discovery._score import RANK, CaseColumns, Level, ScoreContext
from fitting.effects._effect import Effect, Joint, Parameter, bodies_of
from fitting.inference._linear_algebra import block_diagonal, orthogonal_to, orthonormal
from fitting.inference._multiple_tests import over_many_tests
from fitting.inference._result import Fit

Array = NDArray[np.float64]

_COLUMNS = 10
"""Number of splines in the test of a torque that depends on one variable [1]. Chosen: a smaller number overlooks narrow
laws, a larger one lowers the power for broad laws."""
_FINE = 36
"""Number of splines of the displayed curve [1]. Chosen: a smaller number does not resolve a resonance, a larger one
costs time; the prior smooths the splines."""
_PAIR = 4
"""Number of splines along each of two variables [1]. Chosen: the test has the square of this number of splines; a
smaller number overlooks curved laws, a larger one lowers the power."""
_CUBIC = 3
"""Degree of the splines [1]. Chosen: a smaller value gives curves with kinks, a larger one oscillates at the ends."""
_HARMONICS = (1, 2, 3, 4)
"""Harmonics of the angle of the casing in the test [1]. Chosen: with fewer harmonics, higher harmonics are overlooked;
with more, the power for the first two is lower."""
_ROTOR_HARMONICS = (1, 2)
"""Harmonics of the angle of the rotor in the test [1]. Chosen: with the first harmonic alone, the second harmonic is
overlooked; higher harmonics are aliased at the frame rate of the casing."""
_FASTEST = np.pi
"""Largest phase by which a tested harmonic of the rotor angle may advance between two frames of the casing [rad].
Derived: the Nyquist limit, half a period per frame."""
_DRAWS = 1000
"""Number of null data sets [1]. Chosen: the smallest p-value is 0.001; a smaller number makes the p-value coarser, a
larger one costs time."""
_RANK = 1e-5
"""A direction is rounding error if its singular value, divided by the norm of the largest column, is below this value
[1]. Chosen: a smaller value counts rounding errors as a degree of freedom, a larger one omits directions that the data
determine weakly."""
_CURVE = 120
"""Number of points of a displayed curve [1]. Chosen: a smaller number shows corners, a larger one makes larger
files."""
_STRENGTHS = np.geomspace(1e-3, 1e5, 33)
"""Trial standard deviations of a torque, divided by the standard deviation that the data suggest [1]. Chosen: four per
decade from far below the noise to far above it; the optimum may be outside a shorter range; a coarser grid rounds the
optimum."""
_LENGTHS = np.geomspace(0.03, 3.0, 9)
"""Trial correlation lengths, divided by the range of the variable [1]. Chosen: the splines do not resolve shorter
lengths; with longer lengths, the curve is nearly a straight line."""
_WORDS = {
    "omega_c": "the speed of the casing",
    "omega_r": "the speed of the rotor",
    "delta": "the speed of the bearing",
    "t": "time",
    "psi_c": "the angle of the casing",
    "psi_r": "the angle of the rotor",
}
_ON = {"casing": "on the casing", "bearing": "in the bearing", "rotor": "on the rotor"}
_TESTS: dict[Joint, tuple[tuple[str, ...], ...]] = {
    "casing": (("omega_c",), ("omega_r",), ("t",), ("psi_c",), ("omega_c", "omega_r"), ("omega_c", "t")),
    "bearing": (("delta",), ("t",), ("delta", "t"), ("delta", "omega_c")),
    "rotor": (("omega_r",), ("t",), ("psi_r",)),
}


@dataclass(frozen=True)
class Dependence:
    """The unmodelled torque as a smooth function of one variable, or of two."""

    variable: str  # "omega_c", "t", ...; a pair of variables is joined by "*"
    body: str  # "casing", "rotor", or "bearing" (internal)
    # family-wise: probability that any tested dependence is at least as significant if there is none
    p_value: float
    # explained share of the lack of fit (excess of chi-square over its degrees of freedom), 0-1
    explained: float
    score: float  # fall of the deviance
    columns: int  # number of functions of the test that the base cannot represent
    value: Array = field(repr=False)  # values of the variable [s, rad/s or rad]; empty for two variables
    torque: Array = field(repr=False)  # the part of the torque that the base cannot represent [N m]
    sigma: Array = field(repr=False)  # standard uncertainty of `torque` [N m]
    identified: Array = field(repr=False)  # matrix that projects a torque at `value` on the determined part

    @property
    def words(self) -> str:
        """The variable and the body in words."""
        names = " and ".join(_WORDS[v] for v in self.variable.split("*"))
        return f"{names} (torque {_ON[self.body]})"

    def comparable(self, torque: Array) -> Array:
        """Return the part of a torque at `value` that the base cannot represent, for comparison with `torque` [N m]."""
        return np.asarray(self.identified @ torque)


def torque_rows(effects: Sequence[Effect], cases: Sequence[CaseColumns]) -> Array:
    """Return the change of the rows of all cases that the torques of some effects cause at their fitted strengths."""
    rows = [np.zeros(len(c.case.data.z)) for c in cases]
    for e in effects:
        for i, case in enumerate(cases):
            shape, strengths = case.fitted(e)
            columns = case.trials(e, [shape])[0].columns
            rows[i] = rows[i] + columns @ strengths[: columns.shape[1]]
    return np.concatenate(rows)


def context_without(
    about: Fit,
    effects: Sequence[Effect],
    cases: Sequence[CaseColumns],
    *,
    draws: int = 1,
    release: bool = False,
) -> ScoreContext:
    """Return the data linearised about a fit, with some effects removed from its model."""
    return ScoreContext(
        about,
        draws,
        without=[e.name for e in effects],
        torque_rows=torque_rows(effects, cases),
        release=release,
    )


class _Test(NamedTuple):
    """Responses of the rows to the functions of a test (`columns`) and of its curve (`fine`).

    At the points `value` the functions of the curve have the values `basis`. `priors` are the prior covariances of
    their coefficients for s = 1, one for each correlation length.
    """

    body: Joint
    variables: tuple[str, ...]
    columns: Array
    fine: Array
    value: Array
    basis: Array
    priors: tuple[Array, ...]


def dependence(about: Fit, *, without: Sequence[str] = ()) -> list[Dependence]:
    """Return the unmodelled torque of a fit as a function of each variable and of pairs, in ascending order of BIC.

    The torques of the effects named in `without` count as unmodelled.
    """
    about.model.refuse_chain(
        "the dependence of the unmodelled torque on a variable",
        "gyrotrack diagnose states it against time",
    )
    cases = [CaseColumns(about, i) for i in range(len(about.problem.cases))]
    effects = [e for e in about.model.effects if e.name in without]
    context = context_without(about, effects, cases, draws=_DRAWS)
    tests = list(_tests(about, cases))
    found, smallest = [], np.ones(_DRAWS)
    for test in tests:
        result, null = _tested(context, test)
        if result is not None:
            found.append(result)
            smallest = np.minimum(smallest, null)
    calibrated = [replace(d, p_value=over_many_tests(d.p_value, smallest)) for d in found]
    return sorted(calibrated, key=lambda d: d.columns * np.log(about.n_eff) - d.score)


def _tests(about: Fit, cases: Sequence[CaseColumns]) -> Iterator[_Test]:
    """Yield the test of each variable and pair of variables, with the rows of all cases."""
    bodies = about.problem.data[0].record.parts
    known = [{v: c.along_motion(v) for v in ("t", "omega_r", "omega_c", "delta")} for c in cases]
    for body, choices in _TESTS.items():
        for variables in choices:
            if not bodies_of(body, variables) <= bodies:
                continue
            if variables[0].startswith("psi"):
                orders = _orders(about, variables[0])
                if orders:
                    yield _angle_test(cases, body, variables[0], orders)
                continue
            axes = [_Axis(np.concatenate([k[v] for k in known]), _COLUMNS if len(variables) == 1 else _PAIR)
                    for v in variables]  # fmt: skip
            acting = [_acting(c, body) for c in cases]
            columns = [
                c.padded(w @ _product([axis(k[v]) for axis, v in zip(axes, variables, strict=True)]))
                for c, k, w in zip(cases, known, acting, strict=True)
            ]
            rows = np.concatenate(columns)
            if len(variables) > 1:
                yield _Test(body, variables, rows, rows, np.zeros(0), np.zeros((0, rows.shape[1])), ())
                continue
            (name,) = variables
            fine = _Axis(np.concatenate([k[name] for k in known]), _FINE)
            finer = [c.padded(w @ fine(k[name])) for c, k, w in zip(cases, known, acting, strict=True)]
            value = np.linspace(fine.low, fine.high, _CURVE)
            yield _Test(body, variables, rows, np.concatenate(finer), value, fine(value), fine.priors())


def _acting(case: CaseColumns, body: str) -> Array:
    """Return the response of the smooth rows to a torque on a body or in the bearing."""
    response = case.response
    if body == "bearing":
        return response.casing - response.rotor
    return response.casing if body == "casing" else response.rotor


def _product(factors: Sequence[Array]) -> Array:
    """Return all products of the functions of each variable, shape (cells, functions)."""
    total = factors[0]
    for f in factors[1:]:
        total = (total[:, :, None] * f[:, None, :]).reshape(len(total), -1)
    return total


class _Axis:
    """Cubic B-splines of equal spacing over the range of a variable."""

    def __init__(self, values: Array, count: int) -> None:
        self.low, self.high = float(values.min()), float(values.max())
        inner = np.linspace(self.low, max(self.high, self.low + 1e-9), count - _CUBIC + 1)
        self._knots = np.concatenate([[inner[0]] * _CUBIC, inner, [inner[-1]] * _CUBIC])

    def __call__(self, values: Array) -> Array:
        from scipy.interpolate import BSpline

        inside = np.clip(values, self._knots[0], self._knots[-1])
        return np.asarray(BSpline.design_matrix(inside, self._knots, _CUBIC).toarray())

    def priors(self) -> tuple[Array, ...]:
        """Return the Matern covariance of the coefficients for each correlation length, at variance 1."""
        centres = np.lib.stride_tricks.sliding_window_view(self._knots[1:-1], _CUBIC).mean(axis=1)
        apart = np.sqrt(3) * np.abs(centres[:, None] - centres) / (self.high - self.low)
        return tuple((1 + apart / x) * np.exp(-apart / x) for x in _LENGTHS)


def _orders(about: Fit, angle: str) -> tuple[int, ...]:
    """Return the harmonics of an angle that the recordings resolve."""
    data = about.problem.data
    if data[0].measured_angle is None:
        return ()
    if angle == "psi_c":
        return _HARMONICS
    step = max(
        float(np.median(np.diff(d.record.casing.time)) * np.abs(p.path.y[..., 0]).max())
        for d, p in zip(data, about.predictions, strict=True)
    )
    return tuple(n for n in _ROTOR_HARMONICS if n * step < _FASTEST)


def _angle_test(cases: Sequence[CaseColumns], body: Joint, angle: str, orders: Sequence[int]) -> _Test:
    """Return the test of harmonics of an angle.

    Harmonics of the rotor have separate amplitudes and phases in each case, so the test has no common curve.
    """
    phase = Parameter("phi", "rad", "phase", -np.inf, np.inf)
    psi = np.linspace(0, 2 * np.pi, _CURVE)
    rows, basis = [], []
    for n in orders:
        law = Effect(f"harmonic.{n}", body, f"k*sin({n}*{angle} - phi)", (Parameter("k", "N m"), phase))
        columns_of = [c.trials(law)[0].columns for c in cases]
        rows.append(np.concatenate(columns_of) if angle == "psi_c" else block_diagonal(columns_of))
        basis += [np.sin(n * psi), -np.cos(n * psi)]
    columns = np.concatenate(rows, axis=1)
    if angle != "psi_c":
        return _Test(body, (angle,), columns, columns, np.zeros(0), np.zeros((0, columns.shape[1])), ())
    unit = (np.eye(columns.shape[1]),)
    return _Test(body, (angle,), columns, columns, psi, np.stack(basis, axis=1), unit)


def _tested(context: ScoreContext, test: _Test) -> tuple[Dependence | None, Array]:
    from scipy.special import chdtrc

    size = np.linalg.norm(test.columns, axis=0)
    size[size == 0] = np.inf
    rotated = context.rotated(test.columns / size)
    least = min(level.deviance for level in context.levels)
    best: tuple[float, int, Level] | None = None
    explained = 0.0
    null = np.ones(context.draws.shape[1])
    for i, level in enumerate(context.levels):
        white = level.gain[:, None] * rotated
        u, s, _ = np.linalg.svd(orthogonal_to(level.basis, white), full_matrices=False)
        kept = s > _RANK * max(float(np.linalg.norm(white, axis=0).max()), 1e-300)
        if not kept.any():
            continue
        u = u[:, kept]
        data = u.T @ level.residual
        chi2 = float(data @ data)
        gain = chi2 - (level.deviance - least)
        if i == 0:
            dof = max(len(level.residual) - level.basis.shape[1] - u.shape[1], 1)
            excess = max(float(level.residual @ level.residual) - dof - u.shape[1], chi2, 1e-300)
            explained = float(np.clip((chi2 - u.shape[1]) / excess, 0.0, 1.0))
        if best is None or gain > best[0]:
            best = (gain, u.shape[1], level)
        if i == len(context.levels) - 1:
            null = np.asarray(chdtrc(u.shape[1], ((u.T @ context.draws) ** 2).sum(axis=0)))
    if best is None:
        return None, null
    gain, rank, level = best
    p = float(chdtrc(rank, max(gain, 0.0)))
    torque, sigma, identified = _curve(context, level, test)
    return Dependence(
        "*".join(test.variables),
        test.body,
        p,
        explained,
        max(gain, 0.0),
        rank,
        test.value,
        torque,
        sigma,
        identified,
    ), null


def _curve(context: ScoreContext, level: Level, test: _Test) -> tuple[Array, Array, Array]:
    """Return the curve, its standard uncertainty, and the matrix that projects a torque on its determined part.

    All are empty if the test has no curve.
    """
    if not len(test.value):
        return np.zeros(0), np.zeros(0), np.zeros((0, 0))
    white = level.gain[:, None] * context.rotated(test.fine)
    response = orthogonal_to(level.basis, white)
    # the residuals scatter more than the noise if the law has finer details than the curve, or another variable
    free = orthonormal(response, RANK)
    rest = orthogonal_to(free, level.residual)
    scatter = max(1.0, float(rest @ rest) / max(len(rest) - level.basis.shape[1] - free.shape[1], 1))
    best: tuple[float, float, Array, Array, Array, Array] | None = None
    for prior in test.priors:
        root = np.linalg.cholesky(prior + 1e-10 * np.eye(len(prior)))
        # coefficients b = root beta with independent beta
        u, s, vt = np.linalg.svd(response @ root / np.sqrt(scatter), full_matrices=False)
        data = u.T @ level.residual / np.sqrt(scatter)
        unit = max(1.0, float(np.sqrt(np.mean(data**2)))) / max(float(s[0]), 1e-300)
        variances = (_STRENGTHS * unit) ** 2
        spread = 1 + np.outer(variances, s**2)
        deviance = (np.log(spread) + data**2 / spread).sum(axis=1)
        k = int(np.argmin(deviance))
        if best is None or deviance[k] < best[0]:
            best = (float(deviance[k]), float(variances[k]), root @ vt.T, s, data, u)
    if best is None:
        return np.zeros(0), np.zeros(0), np.zeros((0, 0))
    _, variance, vectors, s, data, u = best
    known = variance * s**2 > 1
    shown = test.basis @ vectors[:, known]
    s, data, u = s[known], data[known], u[:, known]
    sigma = np.sqrt(shown**2 @ (1 / s**2))
    # response, along the determined directions, to a torque; the coefficients of the torque are B^+ torque
    rows = (u.T @ response) @ np.linalg.pinv(test.basis, rcond=1e-6) / np.sqrt(scatter)
    return shown @ (data / s), sigma, (shown / s) @ rows
