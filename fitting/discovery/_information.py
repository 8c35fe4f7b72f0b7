"""Fisher information of present or planned recordings about parameters and candidate effects.

A planned run is simulated without noise. Its rows and their derivatives are computed as for a recording, with the
measurement noise and the process noise of the first present recording. Let J be the derivatives with respect to the
shared parameters, and s the responses to the candidate effects. The information is

    I = sum over runs of [J s]' C^-1 [J s],

where the parameters that belong to one run only (initial angular rates, touch point, casing drag, phases of the films)
are projected out. The information of present and planned runs is additive.

Rival explanations are sets of effects that the present recordings do not separate. Let I be the information about the
strengths of all candidates, with the shared parameters projected out, and b the products of their responses with the
residuals. A linear refit with a set H of candidates lowers the deviance by

    b_H' I_HH^-1 b_H.

Effects of the model that are not in the models of the paper are candidates as well. Their contribution to the motion is
added to the residuals, so that another effect can replace them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import Criteria
from fitting.discovery._score import CaseColumns
from fitting.dynamics._collocation import Sampler
from fitting.dynamics._model import INERTIA_CASING
from fitting.effects._effect import Effect
from fitting.effects._library import GENERAL
from fitting.inference._case_data import CaseData
from fitting.inference._compression import CASING_DEGREE, ROTOR_DEGREE, compress
from fitting.inference._linear_algebra import orthogonal_to, orthonormal
from fitting.inference._noise import Noise, TorqueNoise, TorqueResponse
from fitting.inference._parameters import START_CASING, START_ROTOR, ParameterLayout
from fitting.inference._problem import Problem
from fitting.inference._record import Record, Samples
from fitting.inference._result import Fit
from fitting.inference._simulation import Experiment, simulate_path

Array = NDArray[np.float64]

_BLOCKS = 24
"""Number of blocks of a planned recording [1]. Chosen: a smooth motion without noise needs few blocks; a smaller number
does not resolve the start, a larger one costs time."""
_PER_BLOCK = 64
"""Number of samples of a block of a planned recording [samples]. Chosen: a smaller number does not determine the
polynomial of a block, a larger one costs time."""
_RANK = 1e-7
"""Relative singular value below which a free direction is rounding error [1]. Chosen: a smaller value projects out
rounding errors, a larger one counts information twice."""
_TINY = 1e-12
"""Relative eigenvalue below which a direction of the information is not determined [1]. Chosen: a smaller value inverts
rounding errors, a larger one omits weakly determined strengths."""


@dataclass(frozen=True)
class Run:
    """Settings of a planned run."""

    # initial angular rates [rad/s]
    omega_rotor: float
    omega_casing: float
    duration: float  # length of the recording of the casing [s]
    windows: tuple[float, ...]  # start of each rotor window [s]
    window_length: float  # length of each window [s]
    ring: float = 1.0  # moment of inertia of the casing, divided by the present value
    surface: float = 1.0  # friction at the touch point, divided by the present value


class Information:
    """Fisher information of runs about the shared parameters and the strengths of candidates (with shape constants)."""

    def __init__(self, fit: Fit, candidates: Sequence[tuple[Effect, Mapping[str, float]]]) -> None:
        self.fit = fit
        self.candidates = [(e, dict(s)) for e, s in candidates if not e.depends_on_angle]
        layout, model = fit.problem.layout, fit.model.smooth
        self._shared = [k for k in model.free if k not in {*model.per_case, *layout.per_case}]
        # parameters at a bound are held, as in the search
        bound = dict(zip(layout.names, layout.at_bound(fit.theta), strict=True))
        self._held = {k for k in self._shared if bound.get(k, False)}
        parts = [self._of(fit, i) for i in range(len(fit.problem.cases))]
        self.present = np.asarray(np.sum([p[0] for p in parts], axis=0))
        # scalar products of all columns with the residuals of the fit
        self.right = np.asarray(np.sum([p[1] for p in parts], axis=0))

    def added(self) -> dict[str, tuple[int, float]]:
        """Return column and strength of each physical effect that is not in the models of the paper, by name.

        Only effects with one free strength for all runs are included.
        """
        found = {}
        for e in self.fit.model.smooth.effects:
            key = f"{e.name}.{e.amplitude.symbol}" if e.amplitude is not None else ""
            free = key in self._shared and key not in self._held
            if free and e.name not in GENERAL and e.kind == "physical":
                found[e.name] = self._shared.index(key), self.fit.estimates[key].value
        return found

    @property
    def parameters(self) -> int:
        """Number of shared parameters; their columns precede the columns of the candidates."""
        return len(self._shared)

    def _of(self, fit: Fit, case: int) -> tuple[Array, Array]:
        """Return the information of one run, and the scalar products of its columns with the residuals.

        The parameters that belong to this run only are projected out.
        """
        data, prediction, noise = fit.problem.data[case], fit.predictions[case], fit.noise[case]
        whitener = noise.whitener.at(noise.pure)
        layout, jacobian = fit.problem.layout, prediction.jacobian
        places = [int(p) for p in layout.places(case, self._shared)]
        shared = jacobian[:, places]
        shared[:, [k in self._held for k in self._shared]] = 0.0
        rest = [i for i in range(jacobian.shape[1]) if i not in places]
        candidate = CaseColumns(fit, case)
        strengths = [candidate.trials(effect, [shape])[0].columns for effect, shape in self.candidates]
        everything = whitener(np.concatenate([shared, *strengths], axis=1))
        own = whitener(np.concatenate([jacobian[:, rest], data.nuisance], axis=1))
        everything = orthogonal_to(orthonormal(own, _RANK), everything)
        residual = whitener(data.z - prediction.rows)
        return np.asarray(everything.T @ everything), np.asarray(everything.T @ residual)

    def places(self, candidate: int) -> list[int]:
        """Return the indices of the columns of a candidate; a law with a phase has two columns."""
        widths = [2 if any(p.role == "phase" for p in e.parameters) else 1 for e, _ in self.candidates]
        first = self.parameters + sum(widths[:candidate])
        return list(range(first, first + widths[candidate]))

    def of_run(self, run: Run) -> tuple[Array, Fit]:
        """Return the information of a planned run and its noiseless simulation; a FittingError if that fails."""
        planned = simulated(self.fit, run)
        return self._of(planned, 0)[0], planned


def schur(information: Array, kept: Sequence[int], free: Sequence[int]) -> Array:
    """Return the information about the columns `kept` if the columns `free` are free, the Schur complement."""
    kept, free = list(kept), list(free)
    block = information[np.ix_(free, free)]
    size = np.sqrt(np.maximum(np.diag(block), 1e-300))
    inverse = np.linalg.pinv(block / np.outer(size, size), rcond=_TINY, hermitian=True) / np.outer(size, size)
    cross = information[np.ix_(kept, free)]
    return np.asarray(information[np.ix_(kept, kept)] - cross @ inverse @ cross.T)


def simulated(fit: Fit, run: Run) -> Fit:
    """Return the noiseless recording of a planned run as a fit, with the parameters and noise of the first case."""
    template = fit.problem.data[0].record
    layout = fit.problem.layout
    numbers = layout.numbers(fit.theta, 0) | {INERTIA_CASING: template.I_casing * run.ring}
    for effect in fit.model.smooth.effects:
        if effect.per_surface and effect.amplitude is not None:
            numbers[f"{effect.name}.{effect.amplitude.symbol}"] *= run.surface
    experiment = Experiment(
        omega_rotor=run.omega_rotor,
        omega_casing=run.omega_casing,
        duration=run.duration,
        windows=run.windows,
        window_length=run.window_length,
    )
    # inputs of the recording, with time measured from the start of the run
    began = template.span[0]
    inputs = tuple(replace(i, time=i.time - began) for i in template.inputs)
    _, path = simulate_path(fit.model.smooth, numbers, experiment, inputs)
    count = _BLOCKS * _PER_BLOCK
    time = np.linspace(0.0, run.duration, count)
    angle = template.quantity == "angle"

    def samples(t: Array, state: str, like: Samples, effective: float, fewest: int) -> Samples:
        sampler = Sampler(path.mesh, t)
        starts, speed = path.angle(state)
        value = sampler.integral(starts, speed) if angle else sampler.value(speed)
        # the recording determines the number of independent samples per second
        rate = effective / max(float(like.time[-1] - like.time[0]), 1e-9)
        seconds = max(float(t[-1] - t[0]), 1e-9)
        sigma = float(np.median(like.sigma)) * math.sqrt(fewest / (rate * seconds))
        return Samples(t, value, np.full(len(t), sigma))

    first = fit.problem.data[0]
    effective = first.casing.n_effective / first.casing.scale**2
    casing = samples(time, "omega_c", template.casing, effective, count)
    windows = []
    if template.rotor:
        like, run_of = template.rotor[0], first.rotor[0]
        for start in run.windows:
            t = start + np.linspace(0.0, run.window_length, 2 * _PER_BLOCK)
            windows.append(samples(t, "omega_r", like, run_of.n_effective / run_of.scale**2, len(t)))
    record = Record(
        "planned",
        template.I_rotor,
        template.I_casing * run.ring,
        casing,
        tuple(windows),
        template.quantity,
        digest="planned",
        inputs=inputs,
    )
    data = CaseData(
        record,
        compress(casing, degree=CASING_DEGREE, blocks=_BLOCKS, noisy=False),
        tuple(compress(w, degree=ROTOR_DEGREE, blocks=1, noisy=False) for w in windows),
        noiseless=True,
        criteria=fit.criteria,
    )
    problem = Problem.of(ParameterLayout.of(fit.model.smooth, [record]), [data])
    values = numbers | {START_ROTOR: run.omega_rotor, START_CASING: run.omega_casing}
    theta = np.array([values[n.partition("@")[0]] for n in problem.layout.names])
    predictions = tuple(problem.predict(theta))
    own = fit.noise[0]
    response = TorqueResponse(data, predictions[0].motion)
    whitener = response.whitener(TorqueNoise(own.pure, own.time))
    noise = (Noise(1.0, own.pure, own.pure_u, own.pure, own.time, whitener, own.process),)
    return replace(
        fit,
        model=problem.layout.model,
        labels=("planned",),
        theta=theta,
        noise=noise,
        problem=problem,
        predictions=predictions,
    )


_COLLINEAR = 1e-6
"""Determinant of the correlation of candidates below which no data separate them [1]. Chosen: a smaller value keeps
sets with undetermined strengths, a larger one drops rivals that data could separate."""
_ABSORBED = 1e-12
"""The shared parameters absorb a candidate if the information about its strength with free shared parameters, divided
by the information with fixed shared parameters, is below this value [1]. Chosen: it is the rounding error of the
projection; a larger value drops weakly determined candidates, a smaller one keeps rounding errors."""


@dataclass(frozen=True)
class Rival:
    """An explanation: candidate effects with their shape constants and strengths."""

    names: tuple[str, ...]  # the effects
    columns: tuple[int, ...]  # indices of their columns in `Information`
    strengths: Array  # strength of each column
    weight: float = 1.0  # relative posterior probability, exp(-(BIC - lowest BIC) / 2)


MOST_RIVALS = 6
"""Largest number of rival explanations that a plan considers [1]. Chosen: a smaller number omits explanations, a larger
one costs time."""


def rivals(information: Information, threshold: Sequence[float], criteria: Criteria) -> list[Rival]:
    """Return the explanations that the present recordings do not separate, to first order (score test).

    Every set of at most two effects is scored; the effects are the candidates and the effects of the model that are not
    in the models of the paper. A set is a rival if its BIC is within the equivalence width of the lowest BIC, and if no
    subset of it has an equal or lower BIC. `threshold` contains the score above which each candidate is significant in
    the whole list. The list is empty if nothing is significant or if there are fewer than two rivals.
    """
    added = information.added()
    names = [*added, *(e.name for e, _ in information.candidates)]
    columns = [[place] for place, _ in added.values()]
    columns += [information.places(i) for i in range(len(information.candidates))]
    count = [1 for _ in added] + [len(e.free) for e, _ in information.candidates]
    # friction coefficients are not negative
    one_sided = [False for _ in added] + [
        e.amplitude is not None and e.amplitude.lower >= 0 and len(c) == 1
        for (e, _), c in zip(information.candidates, columns[len(added) :], strict=True)
    ]
    physical = [True for _ in added] + [e.kind == "physical" for e, _ in information.candidates]
    places, strengths = [p for p, _ in added.values()], np.array([g for _, g in added.values()])
    base = [k for k in range(information.parameters) if k not in places]
    everything = [k for c in columns for k in c]
    n = len(information.present)
    augmented = np.zeros((n + 1, n + 1))
    augmented[:n, :n] = information.present
    augmented[:n, n] = augmented[n, :n] = information.right
    reduced = schur(augmented, [*everything, n], base)
    full, right = reduced[:-1, :-1], reduced[:-1, -1]
    index = {k: i for i, k in enumerate(everything)}
    if places:
        right = right + full[:, [index[p] for p in places]] @ strengths
    size = np.sqrt(np.maximum(np.diag(full), 1e-300))
    per_parameter = math.log(information.fit.problem.rows)
    scored: dict[frozenset[int], tuple[float, Array]] = {frozenset(): (0.0, np.zeros(0))}
    usable = [
        i
        for i, c in enumerate(columns)
        if physical[i] and all(full[index[k], index[k]] > _ABSORBED * information.present[k, k] for k in c)
    ]
    for n in (1, 2):
        for chosen in itertools.combinations(usable, n):
            at = [index[k] for i in chosen for k in columns[i]]
            block = full[np.ix_(at, at)] / np.outer(size[at], size[at])
            if np.linalg.det(block) < _COLLINEAR:
                continue
            g = np.linalg.solve(block, right[at] / size[at])
            gain = float(g @ (right[at] / size[at]))
            owners = [i for i in chosen for _ in columns[i]]
            if any(v < 0 and one_sided[i] for i, v in zip(owners, g, strict=True)):
                continue
            bic = -gain + per_parameter * sum(count[i] for i in chosen)
            scored[frozenset(chosen)] = bic, g / size[at]
    best = min(bic for bic, _ in scored.values())
    most = max(scored, key=lambda s: -scored[s][0])
    if not added:
        score = -best + per_parameter * sum(count[i] for i in most)
        if not most or score < min(threshold) or best > -criteria.evidence:
            return []
    kept = []
    for members, (bic, g) in sorted(scored.items(), key=lambda item: item[1][0]):
        redundant = any(scored[part][0] <= bic for part in scored if part < members)
        if members and not redundant and bic < best + criteria.equivalence_width:
            order = [i for i in usable if i in members]
            own = tuple(k for i in order for k in columns[i])
            kept.append(Rival(tuple(names[i] for i in order), own, g, math.exp(-0.5 * (bic - best))))
    kept = kept[:MOST_RIVALS]
    return kept if len(kept) > 1 else []
