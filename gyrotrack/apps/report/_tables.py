"""The tables of a report: parameters, candidates, plausibility, clips, provenance."""

from __future__ import annotations

import math
import platform
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib import metadata
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fitting._numbers import (
    Units,
    percentage,
    probability,
    scaled,
    short,
    symbol_parts,
    symbol_text,
    unit_text,
    with_uncertainty,
)
from gyrotrack.plotting._study_data import StudyView

if TYPE_CHECKING:
    from fitting.effects._effect import Effect
    from fitting.inference._case_data import CaseData
    from fitting.inference._params import Estimate
    from fitting.inference._record import Body
    from fitting.inference._result import Fit
    from gyrotrack.io._records import Placement, Recording


Array = NDArray[np.float64]
JOINTS = {
    "rotor": "rotor",
    "casing": "casing",
    "bearing": "both bodies",
    "contact": "both bodies",
    "factor": "bearing × factor",
    "input": "recorded input",
    "camera.casing": "camera (casing)",
    "camera.rotor": "camera (rotor)",
}
_LARGE_CHANGE = 3.0


Row = dict[str, Any]  # the cells of a row, by the names that the templates of the report use


def parameter_rows(view: StudyView) -> list[Row]:
    """Return one row per parameter of the final model, with its value in the base model."""
    from fitting.inference._result import not_determined

    weak = set(not_determined(view.final.estimates))
    rows = []
    for name, e in view.final.estimates.items():
        key, _, label = name.partition("@")
        effect, _, symbol = key.rpartition(".")
        head, index = symbol_parts(symbol)
        before = view.base.estimates.get(name) if view.improved else None
        fixed = key in view.final.model.constants
        row = {
            "symbol": head,
            "index": index + ("0" if effect == "initial" else ""),
            "effect": "initial value" if effect == "initial" else view.name(effect).words,
            "key": view.name(key).key,
            "case": label if len(view.cases) > 1 else "",
            "value": with_uncertainty(e.value, e.stderr, e.unit),
            "relative": _relative(e),
            "before": "" if before is None else with_uncertainty(before.value, before.stderr, before.unit),
            "note": _note(e, before, undetermined=name in weak, fixed=fixed),
            "is_new": effect in view.added,
        }
        rows.append(row)
    return [*rows, *_response_rows(view)]


def _response_rows(view: StudyView) -> list[Row]:
    """Return the time constant and the gains of a driven body in the final model, as rows of the parameter table."""
    from fitting.inference._first_order import first_order

    rows = []
    for response in first_order(view.final):
        numbers = [("τ", "", response.time_constant), *(("K", name, e) for name, e in response.gains.items())]
        for symbol, index, e in numbers:
            rows.append(
                {
                    "symbol": symbol,
                    "index": index,
                    "effect": "first-order response",
                    "key": "",
                    "case": response.label if len(view.cases) > 1 else "",
                    "value": with_uncertainty(e.value, e.stderr, e.unit),
                    "relative": _relative(e),
                    "before": "",
                    "note": "derived",
                    "is_new": False,
                }
            )
    return rows


def _relative(e: Estimate) -> str:
    if not math.isfinite(e.stderr) or e.value == 0:
        return "–"
    return f"{short(100 * e.stderr / abs(e.value), 2)} %"


def _note(e: Estimate, before: Estimate | None, *, undetermined: bool, fixed: bool) -> str:
    if fixed:
        return "not fitted"
    if e.at_bound:
        return "at a bound"
    if undetermined:
        return "not determined by these data"
    if before is not None and math.isfinite(before.stderr) and before.stderr > 0:
        own = e.stderr if math.isfinite(e.stderr) else 0.0
        away = abs(before.value - e.value) / math.hypot(before.stderr, own)
        if away > _LARGE_CHANGE:
            return f"changed by {away:.0f} σ"
    return ""


def candidate_rows(view: StudyView) -> list[Row]:
    """Return one row per candidate effect, best first, with its law as SVG and as text."""
    from fitting.effects._expression import latex
    from gyrotrack.plotting._discovery import formula

    return [
        {
            "effect": view.name(c.effect).words,
            "key": view.name(c.effect).key,
            "kind": "physics" if c.physical else "measurement",
            "joint": (JOINTS | {"casing": view.body}).get(c.effect.site, c.effect.site),
            "score": short(c.score),
            "delta_bic": short(c.delta_bic),
            "p_value": probability(c.p_value),
            "held_out_gain": short(c.held_out_gain, 2),
            "rivals": "; ".join(view.name(n).words for n in c.indistinguishable_from),
            "parameters": [with_symbol(k, e) for k, e in c.estimates.items()] if c.significant else [],
            "law": c.effect.law,
            "svg": formula(latex(c.effect.expression), f"law{i}", size=11.5),
            "significant": c.significant,
        }
        for i, c in enumerate(view.candidates)
    ]


def limit_rows(view: StudyView) -> list[Row]:
    """Return 95 % upper limits of effects that are not in the final model, the largest rms torque first."""
    from fitting.effects._instances import laws_of

    laws = laws_of(view.final.model.mechanism)
    joints, unit = JOINTS | {"casing": view.body}, view.final.torque_unit
    rows = []
    for u in view.upper_limits:
        joint = laws[u.effect].site if u.effect in laws else "–"
        factor, prefix = scaled(u.torque_Nm, Units.by_torque(unit).prefixes)
        rows.append(
            {
                "effect": view.name(u.effect).words,
                "key": view.name(u.effect).key,
                "joint": joints.get(joint, joint),
                "torque": f"< {short(factor * u.torque_Nm, 2 if prefix else 3)} {prefix}{unit_text(unit)}",
                "strength": f"{symbol_text(u.symbol)} < {short(u.upper_limit, 3)} {unit_text(u.unit)}".rstrip(),
            }
        )
    return rows


def with_symbol(key: str, e: Estimate) -> str:
    """Return ``k = (9.996 ± 0.002) × 10⁻¹¹ N m s²`` for a parameter."""
    symbol = symbol_text(key.partition("@")[0].rpartition(".")[2])
    at = f" ({key.partition('@')[2]})" if "@" in key else ""
    end = " (at a bound)" if e.at_bound else ""
    return f"{symbol}{at} = {with_uncertainty(e.value, e.stderr, e.unit)}{end}"


def clip_row(r: Recording, placement: Placement | None) -> Row:
    """Return the tracking quality of a clip."""
    sigmas = [f"{name}: {_milliradians(b.sigma)}" for name, b in r.bodies.items() if len(b.sigma)]
    lost = r.frames_declared - r.frames_decoded
    offset = ambiguous = "–"
    if placement is not None:
        offset, ambiguous = (
            _offset(placement),
            "yes: the start is not unique" if placement.ambiguous else "no",
        )
    return {
        "source": r.source,
        "body": r.body,
        "frames": f"{r.frames_decoded}"
        + (f" ({lost} of {r.frames_declared} not decoded)" if lost > 0 else ""),
        "fps": short(r.capture_fps, 4),
        "markers": [f"{m.name}: {_statuses(m.status)}" for m in r.markers.values()],
        "sigma": "; ".join(sigmas) or "–",
        "offset": offset,
        "ambiguous": ambiguous,
        "warnings": r.warnings,
    }


def _milliradians(sigma: np.ndarray[tuple[int], np.dtype[np.float64]]) -> str:
    good = sigma[np.isfinite(sigma)]
    return f"{short(1e3 * float(np.median(good)), 2)} mrad" if len(good) else "unknown"


def _statuses(status: np.ndarray[tuple[int], np.dtype[np.int8]]) -> str:
    from gyrotrack.io._schema import STATUS_WORDS

    total = max(1, len(status))
    parts = []
    for code, words in STATUS_WORDS.items():
        count = int((status == code).sum())
        if count or words == "ok":
            parts.append(f"{100 * count / total:.3g} % {words}")
    return ", ".join(parts)


def _offset(p: Placement) -> str:
    text = with_uncertainty(p.clock_offset, p.clock_offset_sigma, "s")
    if p.clock_rate != 1.0 or (math.isfinite(p.clock_rate_sigma) and p.clock_rate_sigma > 0):
        text += f"; rate {with_uncertainty(p.clock_rate, p.clock_rate_sigma, '1')}"
    return text


_POINTS = 800
_NEGLIGIBLE = 1e-3
_SIGNIFICANT = 2.0  # smallest energy that is distinguished from zero [standard uncertainties]


@dataclass(frozen=True)
class Plausibility:
    """One effect in one case: largest torque on each body, dissipated energy and its share, and an assessment."""

    effect: str
    key: str
    case: str
    torques: tuple[str, ...]  # torques in the order of `StudyView.bodies`
    energy: str
    share: str
    judgement: str
    is_unphysical: bool


def plausibility_rows(fit: Fit) -> list[Plausibility]:
    """Return torque and dissipated energy of each effect along the modelled motion of each case.

    The torque of an effect is the torque of the model minus the torque of the model without the effect. The dissipated
    energy is the negative integral of the power of this torque. The standard uncertainty of the energy follows from the
    covariance of the parameters of the effect, for a fixed motion. An effect whose law is not friction (it depends on
    time or angle) may supply energy. A restoring torque is conservative: its work between the ends of the record is not
    dissipated.
    """
    several = len(fit.problem.data) > 1
    return [row for i in range(len(fit.problem.data)) for row in _plausibility(fit, i, named=several)]


def _plausibility(fit: Fit, index: int, *, named: bool) -> list[Plausibility]:
    from fitting.dynamics._collocation import Sampler
    from fitting.dynamics._model import Dynamics

    case, path, layout = fit.problem.cases[index], fit.predictions[index].path, fit.problem.layout
    record = fit.problem.data[index].record
    inertia = np.array(record.inertias)
    bodies = len(inertia)
    time = np.linspace(path.mesh.edges[0], path.mesh.edges[-1], _POINTS)
    state = Sampler(path.mesh, time).value(path.y)
    found = []
    model = layout.model.smooth
    for effect in model.effects:
        rest = Dynamics(model.without(effect.name), inputs=record.inputs)
        if effect.joint == "inertia" or not set(rest.states) <= set(path.states):
            continue
        without = state[:, [path.states.index(s) for s in rest.states]]

        def torque(theta: Array, rest: Dynamics = rest, without: Array = without) -> Array:
            numbers = layout.numbers(theta, index)
            whole = case.dynamics.rates(time, state, numbers)[:, :bodies]
            return np.asarray((whole - rest.rates(time, without, numbers)[:, :bodies]) * inertia)

        def energy(tau: Array) -> float:
            return -float(np.trapezoid(np.sum(tau * state[:, :bodies], axis=1), time))

        split = [n.partition("@") for n in layout.names]
        at = [
            i
            for i, (key, _, label) in enumerate(split)
            if key.rpartition(".")[0] == effect.name and label in {"", record.label}
        ]
        tau = torque(fit.theta)
        gradient = []
        for i in at:
            step = np.zeros_like(fit.theta)
            step[i] = 1e-4 * abs(fit.theta[i]) or 1e-12
            change = energy(torque(fit.theta + step)) - energy(torque(fit.theta - step))
            gradient.append(change / (2 * step[i]))
        g = np.array(gradient)
        variance = float(g @ np.nan_to_num(fit.covariance[np.ix_(at, at)], posinf=0.0) @ g) if at else 0.0
        found.append((effect, tau, energy(tau), math.sqrt(max(variance, 0.0))))
    total = sum(max(e, 0.0) for effect, _, e, _ in found if not effect.restoring) or 1.0
    rows = []
    for effect, tau, e, u in found:
        judgement = (
            CONSERVATIVE if effect.restoring else _judgement(e, u, total, may_supply=_may_supply(effect))
        )
        rows.append(
            Plausibility(
                effect=fit.name(effect).words,
                key=fit.name(effect).key,
                case=record.label if named else "",
                torques=tuple(short(float(np.abs(tau[:, b.state]).max())) for b in reversed(record.bodies)),
                energy=with_uncertainty(e, u, ""),
                share="–" if effect.restoring else f"{100 * e / total:.1f} %".replace("-", "−"),
                judgement=judgement,
                is_unphysical=judgement == UNPHYSICAL,
            )
        )
    return rows


def _may_supply(effect: Effect) -> bool:
    """Return whether a law may supply energy: the law depends on time or angle, or modifies another torque."""
    from fitting.effects._expression import symbols

    drives = effect.depends_on_angle or any(p.role == "phase" for p in effect.parameters)
    return drives or bool(effect.inputs) or effect.joint == "factor" or "t" in symbols(effect.expression)


UNPHYSICAL, CONSERVATIVE = "negative dissipation: unphysical", "conservative"


def _judgement(energy: float, sigma: float, total: float, *, may_supply: bool) -> str:
    if abs(energy) < _NEGLIGIBLE * total:
        return "negligible"
    if abs(energy) < _SIGNIFICANT * sigma:
        return "not distinguished from zero"
    if energy > 0:
        return "dissipates"
    return "supplies energy" if may_supply else UNPHYSICAL


# largest number of contributions that are shown per parameter, and smallest share of the variance that is shown
_MOST_PARTS, _LEAST_SHARE = 3, 0.005


def budget_rows(view: StudyView) -> list[Row]:
    """Return one row per parameter of the final model, with the combined uncertainty and its largest contributions."""
    from fitting._errors import FittingError
    from fitting.inference._budget import budget

    try:
        found = budget(view.final)
    except FittingError:  # the fit did not converge
        return []
    rows = []
    for name, b in found.items():
        key, _, label = name.partition("@")
        effect, _, own = key.rpartition(".")
        symbol, index = symbol_parts(own)
        shown = [c for c in b.contributions[:_MOST_PARTS] if c.share >= _LEAST_SHARE]
        case = f" ({label})" if label and len(view.cases) > 1 else ""
        called = view.name(key)
        rows.append(
            {
                "symbol": symbol,
                "index": index + ("0" if effect == "initial" else ""),
                "value": with_uncertainty(b.value, b.u, b.unit),
                "effect": (called.words if effect == "initial" else view.name(effect).words) + case,
                "key": called.key,
                "parts": [f"{c.source} (type {c.type}) {percentage(c.share)}" for c in shown],
            }
        )
    return rows


def experiment_rows(view: StudyView) -> list[tuple[str, str]]:
    """Return the measured quantities of each case: bodies with their moments of inertia, samples, surface."""
    rows = []
    for data in view.base.problem.data:
        r = data.record
        at = f" of {r.label}" if len(view.cases) > 1 else ""
        note = r.units.note
        rows += [
            (f"Moment of inertia of the {b.name}{at}", f"not given: {note}" if note else _inertia(b))
            for b in reversed(r.bodies)
        ]
        rows.append((f"Samples of the {r.quantity}{at}", _counts(data)))
        first, last = r.span
        rows.append((f"Time{at}", f"{first:.2f} s to {last:.2f} s"))
    rows.append(
        ("Method", "Films and laws: the method page of the documentation; all tables: the HTML report.")
    )
    return rows


def _inertia(body: Body) -> str:
    value, u = body.inertia, body.inertia_u
    stated = math.isfinite(u)
    return with_uncertainty(value, u, "kg m²") if stated else f"{short(value, 4)} kg m², no uncertainty given"


_WINDOWS = {"rotor": " in {} windows"}


def _counts(data: CaseData) -> str:
    """Return text with the number of samples of each body, and the number of equivalent independent samples."""
    parts = (
        f"{b.name} {sum(map(len, b.series))}{_WINDOWS.get(b.role, '').format(len(b.series))}"
        for b in data.record.bodies
    )
    return f"{', '.join(parts)}; {data.n_effective:.0f} equivalent independent samples"


_LIBRARIES = ("numpy", "scipy", "h5py", "matplotlib", "av", "opencv-contrib-python-headless")


def origin_rows(fit: Fit, given: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return the rows of the provenance: the rows `given`, the data of the fit, the versions."""
    from gyrotrack._versions import __version__

    rows = [(str(k), str(v)) for k, v in given.items()]
    for data in fit.problem.data:
        r = data.record
        rows.append((f"case {r.label}", f"{r.source or 'in memory'}; SHA-256 of the data {r.digest}"))
        rows.append((f"samples of {r.label}", _samples(data)))
    rows.append(("gyrotrack", __version__))
    rows.append(("Python", f"{platform.python_version()} on {sys.platform}"))
    found = []
    for name in _LIBRARIES:
        with suppress(metadata.PackageNotFoundError):
            found.append(f"{name} {metadata.version(name)}")
    return [*rows, ("libraries", ", ".join(found))]


def _samples(data: CaseData) -> str:
    r = data.record
    inertias = ", ".join(f"I_{b.name} {short(b.inertia, 4)}" for b in reversed(r.bodies))
    return f"{_counts(data)}; {r.units.note or f'{inertias} kg m²'}; measured: {r.quantity}"
