"""On what the unmodelled torque depends: a smooth function of each variable, with its share, its p-value and its band.

A torque f(x) on a body, with f a cubic spline of a variable x (t, omega_r, omega_c, delta; harmonics for the angle
psi_c; products of splines for a pair of variables), is the same function in all recordings. With whitened residuals r,
rows S of the spline's functions, and all parameters of the base and nuisance parameters projected out (M, `_score`),

    chi2 = r'M S (S'M S)^+ S'M r   with rank(M S) degrees of freedom if nothing is missing.

Its level of process noise is profiled. The p-value is calibrated on null data that go through all variables: the
smallest p of many correlated tests (P. Westfall, S. Young, Resampling-Based Multiple Testing (1993)). The explained
share is that of the excess of chi-square over its degrees of freedom at the noise of the data.

The curve is the posterior mean of f for independent coefficients of variance s^2, the most likely one. Where the spline
leaves more than noise, because the law has a finer shape, the noise of the coefficients is scaled by the root of the
reduced chi-square (R. Birge, Phys. Rev. 40, 207 (1932)). The base can represent some functions itself (a linear drag
for example); the curve is the part that it cannot represent, and its band is the standard deviation of that part.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.discovery._score import CaseColumns, ScoreContext, over_many_tests
from fitting.dynamics._mesh import Sampler
from fitting.effects._effect import Effect, Joint, Parameter
from fitting.inference._result import Fit

Array = NDArray[np.float64]

_COLUMNS = 10
_PAIR = 4
_CUBIC = 3
_HARMONICS = (1, 2, 3, 4)
_DRAWS = 1000
_RANK = 1e-5
_CURVE = 120
_STRENGTHS = np.geomspace(1e-4, 1e4, 33)
_WORDS = {
    "omega_c": "the speed of the casing",
    "omega_r": "the speed of the rotor",
    "delta": "the speed of the bearing",
    "t": "time",
    "psi_c": "the angle of the casing",
}
_ON = {"casing": "on the casing", "bearing": "in the bearing", "rotor": "on the rotor"}
_TESTS: dict[str, tuple[tuple[str, ...], ...]] = {
    "casing": (("omega_c",), ("omega_r",), ("t",), ("psi_c",), ("omega_c", "omega_r"), ("omega_c", "t")),
    "bearing": (("delta",), ("t",), ("delta", "t"), ("delta", "omega_c")),
    "rotor": (("omega_r",), ("t",)),
}


@dataclass(frozen=True)
class Dependence:
    """The unmodelled torque as a smooth function of one variable, or of two.

    Attributes
    ----------
    variable : str
        "omega_c", "t", ...; two joined by "*".
    body : str
        Where the torque acts: "casing", "rotor", or "bearing" (internal).
    p_value : float
        Of no dependence, over all variables that were tried.
    explained : float
        Share of the lack of fit (excess of chi-square over its degrees of freedom) that it explains (0-1).
    score : float
        Fall of the deviance.
    columns : int
        Functions of the spline that the base cannot represent.
    value : ndarray, shape (points,)
        Values of the variable [s, rad/s or rad]; empty for two variables.
    torque, sigma : ndarray, shape (points,)
        Torque and its standard uncertainty there, the part that the base cannot represent [N m].
    """

    variable: str
    body: str
    p_value: float
    explained: float
    score: float
    columns: int
    value: Array = field(repr=False)
    torque: Array = field(repr=False)
    sigma: Array = field(repr=False)
    identified: Array = field(repr=False)

    @property
    def words(self) -> str:
        """The variable and the body in words."""
        names = " and ".join(_WORDS[v] for v in self.variable.split("*"))
        return f"{names} (torque {_ON[self.body]})"

    def comparable(self, torque: Array) -> Array:
        """Return of a torque at `value` the part that the base cannot represent, which compares with the curve."""
        return np.asarray(self.identified @ torque)


def context_without(
    about: Fit,
    effects: Sequence[Effect],
    cases: Sequence[CaseColumns],
    *,
    draws: int = 1,
    release: bool = False,
) -> ScoreContext:
    """Return the data linearised about a fit, the torque of some of its effects taken out of the model."""
    rows = [np.zeros(len(d.z)) for d in about.problem.data]
    for e in effects:
        for i, case in enumerate(cases):
            numbers = case.numbers
            own = {p.role: numbers[f"{e.name}.{p.symbol}"] for p in e.parameters}
            shape = {p.symbol: numbers[f"{e.name}.{p.symbol}"] for p in e.parameters if p.role == "shape"}
            columns = case.trials(e, [shape])[0].columns
            phase = own.get("phase", 0.0)
            waves = np.array([np.cos(phase), np.sin(phase)])[: columns.shape[1]]
            rows[i] = rows[i] + columns @ (own["amplitude"] * waves)
    return ScoreContext(
        about,
        draws,
        without=[e.name for e in effects],
        torque_rows=np.concatenate(rows),
        release=release,
    )


class _Test(NamedTuple):
    body: Joint
    variables: tuple[str, ...]
    columns: Array
    value: Array
    basis: Array


def dependence(
    about: Fit, *, without: Sequence[str] = (), context: ScoreContext | None = None
) -> list[Dependence]:
    """Return on what the unmodelled torque of a fit depends, the smallest BIC first: one variable if that is enough.

    Parameters
    ----------
    about : Fit
        The fit about which the data are linearised.
    without : sequence of str
        Laws of this fit that count as unmodelled.
    context : ScoreContext, optional
        The linearised data, if they are known already.
    """
    cases = [CaseColumns(about, i) for i in range(len(about.problem.cases))]
    if context is None:
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
    """Yield the rows of a spline of each variable, over the rows of all cases."""
    single = about.problem.data[0].record.single
    known = [_motion(about, i, c) for i, c in enumerate(cases)]
    for body, choices in _TESTS.items():
        if single and body != "casing":
            continue
        for variables in choices:
            if single and not {"omega_c", "t", "psi_c"}.issuperset(variables):
                continue
            if variables == ("psi_c",):
                if about.problem.data[0].is_angle:
                    yield _harmonics(cases)
                continue
            axes = [_Axis(np.concatenate([k[v] for k in known]), len(variables)) for v in variables]
            rows = []
            for k, c in zip(known, cases, strict=True):
                torque = axes[0](k[variables[0]])
                for axis, v in zip(axes[1:], variables[1:], strict=True):
                    torque = (torque[:, :, None] * axis(k[v])[:, None, :]).reshape(len(torque), -1)
                acting = {"casing": c.response.casing, "rotor": c.response.rotor}.get(body)
                acting = c.response.casing - c.response.rotor if acting is None else acting
                smooth = acting @ torque
                rows.append(
                    np.concatenate([smooth, np.zeros((len(c.case.data.z) - len(smooth), smooth.shape[1]))])
                )
            value = np.linspace(axes[0].low, axes[0].high, _CURVE) if len(variables) == 1 else np.zeros(0)
            basis = axes[0](value) if len(variables) == 1 else np.zeros((0, rows[0].shape[1]))
            yield _Test(_joint(body), variables, np.concatenate(rows), value, basis)


def _joint(body: str) -> Joint:
    return "casing" if body == "casing" else "rotor" if body == "rotor" else "bearing"


def _motion(about: Fit, index: int, case: CaseColumns) -> dict[str, Array]:
    path, t = about.predictions[index].path, case.response.centres
    y = Sampler(path.mesh, t).value(path.y)
    return {"t": t, "omega_r": y[:, 0], "omega_c": y[:, 1], "delta": y[:, 0] - y[:, 1]}


class _Axis:
    """Cubic B-splines of equal spacing over the range of a variable."""

    def __init__(self, values: Array, dimensions: int) -> None:
        self.low, self.high = float(values.min()), float(values.max())
        count = _COLUMNS if dimensions == 1 else _PAIR
        inner = np.linspace(self.low, max(self.high, self.low + 1e-9), count - _CUBIC + 1)
        self._knots = np.concatenate([[inner[0]] * _CUBIC, inner, [inner[-1]] * _CUBIC])

    def __call__(self, values: Array) -> Array:
        from scipy.interpolate import BSpline

        inside = np.clip(values, self._knots[0], self._knots[-1])
        return np.asarray(BSpline.design_matrix(inside, self._knots, _CUBIC).toarray())


def _harmonics(cases: Sequence[CaseColumns]) -> _Test:
    psi = np.linspace(0, 2 * np.pi, _CURVE)
    phase = Parameter("phi", "rad", "phase", -np.inf, np.inf)
    rows, basis = [], []
    for n in _HARMONICS:
        law = Effect(f"harmonic.{n}", "casing", f"k*sin({n}*psi_c - phi)", (Parameter("k", "N m"), phase))
        rows.append(np.concatenate([c.trials(law)[0].columns for c in cases]))
        basis += [np.sin(n * psi), -np.cos(n * psi)]
    return _Test("casing", ("psi_c",), np.concatenate(rows, axis=1), psi, np.stack(basis, axis=1))


def _tested(context: ScoreContext, test: _Test) -> tuple[Dependence | None, Array]:
    from scipy.special import chdtrc

    size = np.linalg.norm(test.columns, axis=0)
    size[size == 0] = np.inf
    rotated = context.rotated(test.columns / size)
    least = min(level.deviance for level in context.levels)
    best: tuple[float, float, Array, Array, Array] | None = None
    explained = 0.0
    null = np.ones(context.draws.shape[1])
    for i, level in enumerate(context.levels):
        white = level.gain[:, None] * rotated
        left = white - level.basis @ (level.basis.T @ white)
        u, s, vt = np.linalg.svd(left, full_matrices=False)
        kept = s > _RANK * max(float(np.linalg.norm(white, axis=0).max()), 1e-300)
        if not kept.any():
            continue
        u, s, vt = u[:, kept], s[kept], vt[kept]
        seen = u.T @ level.residual
        chi2 = float(seen @ seen)
        gain = chi2 - (level.deviance - least)
        dof = max(len(level.residual) - level.basis.shape[1] - len(s), 1)
        if i == 0:
            excess = max(float(level.residual @ level.residual) - dof - len(s), chi2, 1e-300)
            explained = float(np.clip((chi2 - len(s)) / excess, 0.0, 1.0))
        if best is None or gain > best[0]:
            left_over = max(1.0, (float(level.residual @ level.residual) - chi2) / dof)
            best = (gain, left_over, s, vt, seen)
        if i == len(context.levels) - 1:
            null = np.asarray(chdtrc(len(s), ((u.T @ context.draws) ** 2).sum(axis=0)))
    if best is None:
        return None, null
    gain, scatter, s, vt, seen = best
    rank, name = len(s), "*".join(test.variables)
    p = float(chdtrc(rank, max(gain, 0.0)))
    torque, sigma, identified = _curve(test, s / np.sqrt(scatter), vt, size, seen / np.sqrt(scatter))
    return Dependence(
        name, test.body, p, explained, max(gain, 0.0), rank, test.value, torque, sigma, identified
    ), null


def _curve(test: _Test, s: Array, vt: Array, size: Array, seen: Array) -> tuple[Array, Array, Array]:
    """Return torque, standard deviation, and the matrix that takes any torque to its identified part.

    The variance of the coefficients is the most likely one of a grid.
    """
    if not len(test.value):
        return np.zeros(0), np.zeros(0), np.zeros((0, 0))
    unit = 1 / max(float(np.median(s)), 1e-300)
    prior = (_STRENGTHS * unit * max(1.0, float(np.sqrt(np.mean(seen**2))))) ** 2
    variance = 1 + np.outer(prior, s**2)
    level = int(np.argmin((np.log(variance) + seen**2 / variance).sum(axis=1)))
    weight = prior[level] * s / variance[level]
    known = prior[level] * s**2 > 1
    shown = (test.basis / size) @ vt.T * known
    sigma = np.sqrt(shown**2 @ (prior[level] / variance[level]))
    # a torque has the coefficients B^+ torque
    coefficients = np.where(np.isfinite(size), size, 0.0)[:, None] * np.linalg.pinv(test.basis, rcond=1e-6)
    return shown @ (weight * seen), sigma, np.asarray(shown @ (vt @ coefficients))
