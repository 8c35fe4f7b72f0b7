"""A gyroscope at known parameters, as far as linear tests depend on a fit: nothing is searched, so it takes 10 ms."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np

from fitting import LINEAR, Model, make_record
from fitting._numbers import SI
from fitting.inference._case_data import CaseData
from fitting.inference._noise import TorqueNoise, TorqueResponse
from fitting.inference._parameters import ParameterLayout
from fitting.inference._problem import Problem

# the record begins at 3 s
BEGIN, SPAN, SIGMA = 3.0, 12.0, 1e-3
START = {"initial.omega_r": 300.0, "initial.omega_c": 20.0}
VALUES = {
    "rotor.air.quadratic.a2": 1e-9,
    "touchpoint.constant.b1": 1e-5,
    "casing.air.linear.b2": 1e-6,
    "bearing.linear.d": 2e-7,
}
WINDOWS = ((4.0, 5.0), (12.0, 13.0))


class Level(SimpleNamespace):
    """Process noise of a level, with the response of the rows to it."""

    def at(self, level):
        return Level(**{**vars(self), "level": level, "whitener": self.whitener.at(level)})


@cache
def data(label="case", seed=0, *, single=False):
    """Angles of both bodies with white noise; what they show hardly matters to a test that is linear."""
    rng = np.random.default_rng(seed)
    t = np.linspace(BEGIN, BEGIN + SPAN, 600)
    windows = [np.linspace(*w, 100) for w in WINDOWS]

    def samples(time, rate):
        return time, rate * time + SIGMA * rng.standard_normal(len(time)), np.full(len(time), SIGMA)

    return CaseData.of(
        make_record(
            casing=samples(t, 20.0), rotor=[] if single else [samples(w, 300.0) for w in windows],
            I_rotor=5.5e-5, I_casing=2e-5, label=label, single=single,
        )
    )  # fmt: skip


def gyroscope(
    names=LINEAR, values=None, *, cases=("case",), level=None, raised=False, per_case=(), residual=None
):
    """Return the linearised motion for these parameters, by key or by name, with process noise of a level [N m].

    `names` are effects of the library, or a model.
    `residual` (rows,) is added to the measured rows of the last case, instead of their difference from the model.
    """
    known = VALUES | (values or {})
    model = names if isinstance(names, Model) else Model.of(names)
    every = [data(label, seed) for seed, label in enumerate(cases)]
    layout = ParameterLayout.of(model, [d.record for d in every], per_case=per_case)
    theta = np.array(
        [
            known.get(n, known.get(n.partition("@")[0], START.get(n.partition("@")[0], 0.0)))
            for n in layout.names
        ]
    )
    problem = Problem.of(layout, every)
    predictions = tuple(problem.predict(theta))
    if residual is not None:
        every = [_Measured(d, p.rows + r) for d, p, r in zip(every, predictions, residual, strict=True)]
    noise = ()
    if level is not None:
        whiteners = [
            TorqueResponse(d, p.motion).whitener(TorqueNoise(level, 1.0))
            for d, p in zip(problem.data, predictions, strict=True)
        ]
        ratios = SimpleNamespace(ratios=np.ones(1), weights=np.ones(1))
        noise = tuple(
            Level(level=level, least=0.1 * level, pure=level, raised=raised, whitener=w, process=ratios)
            for w in whiteners
        )
    problem = replace(problem, data=tuple(every))
    return SimpleNamespace(
        problem=problem, theta=theta, model=model, predictions=predictions, noise=noise, torque_unit="N m", units=SI,
        labels=tuple(cases),
    )  # fmt: skip


class _Measured:
    """Data with other measured rows."""

    def __init__(self, data, z):
        self._data, self.z = data, z

    def __getattr__(self, name):
        return getattr(self._data, name)


def covariance(fit, level, case=0):
    """Return the covariance of the rows of a case at a level of process noise."""
    whitener, size = fit.noise[case].whitener, len(fit.predictions[case].rows)
    m, n = len(whitener.vectors), len(whitener.values)
    whole = np.eye(size)
    whole[:m, :m] += level**2 * (whitener.vectors * whitener.values[:m]) @ whitener.vectors.T
    whole[np.arange(m, n), np.arange(m, n)] += level**2 * whitener.values[m:]
    return whole


def least_squares(columns, rows, covariance):
    """Return chi-square and the values of generalised least squares."""
    root = np.linalg.cholesky(covariance)
    a, b = np.linalg.solve(root, columns), np.linalg.solve(root, rows)
    size = np.linalg.norm(a, axis=0)
    size[size == 0] = 1.0
    found = np.linalg.lstsq(a / size, b, rcond=1e-12)[0]
    rest = b - (a / size) @ found
    return float(rest @ rest), found / size
