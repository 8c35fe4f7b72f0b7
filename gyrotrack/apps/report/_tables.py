"""The tables of a report."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fitting._numbers import probability, short, with_uncertainty
from gyrotrack.plotting._study_data import Content

if TYPE_CHECKING:
    from fitting.inference._result import Estimate
    from gyrotrack.io._records import Placement, Recording


JOINTS = {
    "rotor": "rotor",
    "casing": "casing",
    "bearing": "both bodies",
    "factor": "bearing × factor",
    "camera.casing": "camera (casing)",
    "camera.rotor": "camera (rotor)",
}
_MOVED = 3.0
_LOWERED = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
_GREEK = {"omega": "ω", "phi": "φ", "eps": "ε", "tau": "τ", "psi": "ψ", "kappa": "κ", "chi": "χ"}


@dataclass(frozen=True)
class ParameterRow:
    """One parameter of the final model."""

    symbol: str
    index: str
    effect: str
    case: str
    value: str
    relative: str
    before: str
    note: str
    is_new: bool


@dataclass(frozen=True)
class CandidateRow:
    """One candidate; `svg` is its law drawn, `law` the same as text."""

    effect: str
    kind: str
    joint: str
    score: str
    delta_bic: str
    p_value: str
    held_out_gain: str
    rivals: str
    parameters: tuple[str, ...]
    law: str
    svg: str
    significant: bool


@dataclass(frozen=True)
class ClipRow:
    """One clip behind a case."""

    source: str
    body: str
    frames: str
    fps: str
    markers: tuple[str, ...]
    sigma: str
    offset: str
    ambiguous: str
    warnings: tuple[str, ...]


def parameter_rows(content: Content) -> list[ParameterRow]:
    """Return the parameters of the final model, with what the base had for them."""
    from fitting.inference._result import not_determined

    weak = set(not_determined(content.final.estimates))
    rows = []
    for name, e in content.final.estimates.items():
        key, _, label = name.partition("@")
        effect, _, symbol = key.rpartition(".")
        head, index = _split(symbol)
        before = content.base.estimates.get(name) if content.improved else None
        rows.append(
            ParameterRow(
                symbol=_GREEK.get(head, head),
                index=index + ("0" if effect == "initial" else ""),
                effect="start speed" if effect == "initial" else effect,
                case=label if len(content.cases) > 1 else "",
                value=with_uncertainty(e.value, e.stderr, e.unit),
                relative=_relative(e),
                before=with_uncertainty(before.value, before.stderr, before.unit)
                if before is not None
                else "",
                note=_note(e, before, undetermined=name in weak, fixed=key in content.final.model.constants),
                is_new=effect in content.added,
            )
        )
    return rows


def _split(symbol: str) -> tuple[str, str]:
    """Return a symbol and its index: b2 is b with 2, omega_c is omega with c."""
    head, _, tail = symbol.partition("_")
    letters = head.rstrip("0123456789")
    return (letters, head[len(letters) :] + tail) if letters else (symbol, "")


def _relative(e: Estimate) -> str:
    if not math.isfinite(e.stderr) or e.value == 0:
        return "–"
    return f"{short(100 * e.stderr / abs(e.value), 2)} %"


def _note(e: Estimate, before: Estimate | None, *, undetermined: bool, fixed: bool) -> str:
    if fixed:
        return "not fitted"
    if e.at_bound:
        return "on its bound"
    if undetermined:
        return "not determined by this data"
    if before is not None and math.isfinite(before.stderr) and before.stderr > 0:
        away = abs(before.value - e.value) / math.hypot(
            before.stderr, e.stderr if math.isfinite(e.stderr) else 0.0
        )
        if away > _MOVED:
            return f"moved by {away:.0f} σ"
    return ""


def candidate_rows(content: Content) -> list[CandidateRow]:
    """Return the candidates, best first, each with its law drawn."""
    from fitting.effects._latex import latex
    from gyrotrack.plotting._parameters import formula

    return [
        CandidateRow(
            effect=c.effect.name,
            kind="physics" if c.physical else "measurement",
            joint=(JOINTS | {"casing": content.body}).get(c.effect.joint, c.effect.joint),
            score=short(c.score),
            delta_bic=short(c.delta_bic),
            p_value=probability(c.p_value),
            held_out_gain=short(c.held_out_gain, 2),
            rivals=", ".join(c.indistinguishable_from),
            parameters=tuple(named(k, e) for k, e in c.estimates.items()) if c.significant else (),
            law=c.effect.law,
            svg=formula(latex(c.effect.expression), f"law{i}", size=11.5),
            significant=c.significant,
        )
        for i, c in enumerate(content.candidates)
    ]


def named(key: str, e: Estimate) -> str:
    """Return ``k = (9.996 ± 0.002) × 10⁻¹¹ N m s²`` for a parameter."""
    head, index = _split(key.partition("@")[0].rpartition(".")[2])
    symbol = _GREEK.get(head, head) + (
        f"_{index}" if index and not index.isdigit() else index.translate(_LOWERED)
    )
    at = f" ({key.partition('@')[2]})" if "@" in key else ""
    return f"{symbol}{at} = {with_uncertainty(e.value, e.stderr, e.unit)}" + (
        " (on its bound)" if e.at_bound else ""
    )


def clip_rows(recordings: Mapping[str, Recording], placements: Mapping[str, Placement]) -> list[ClipRow]:
    """Return what tracking made of each clip."""
    return [_clip(r, placements.get(key)) for key, r in recordings.items()]


def _clip(r: Recording, placement: Placement | None) -> ClipRow:
    sigmas = [f"{name}: {_milliradians(b.sigma)}" for name, b in r.bodies.items() if len(b.sigma)]
    lost = r.frames_declared - r.frames_decoded
    return ClipRow(
        source=r.source,
        body=r.body,
        frames=f"{r.frames_decoded}" + (f" ({lost} of {r.frames_declared} not decoded)" if lost > 0 else ""),
        fps=short(r.capture_fps, 4),
        markers=tuple(f"{m.name}: {_statuses(m.status)}" for m in r.markers.values()),
        sigma="; ".join(sigmas) or "–",
        offset="–" if placement is None else _offset(placement),
        ambiguous="–"
        if placement is None
        else ("yes: another start cannot be excluded" if placement.ambiguous else "no"),
        warnings=r.warnings,
    )


def _milliradians(sigma: np.ndarray[tuple[int], np.dtype[np.float64]]) -> str:
    good = sigma[np.isfinite(sigma)]
    return f"{short(1e3 * float(np.median(good)), 2)} mrad" if len(good) else "unknown"


def _statuses(status: np.ndarray[tuple[int], np.dtype[np.int8]]) -> str:
    from gyrotrack.io._schema import STATUS

    total = max(1, len(status))
    parts = []
    for name, code in STATUS.items():
        count = int((status == code).sum())
        if count or name == "ok":
            parts.append(f"{100 * count / total:.3g} % {name.replace('_', ' ')}")
    return ", ".join(parts)


def _offset(p: Placement) -> str:
    text = with_uncertainty(p.clock_offset, p.clock_offset_sigma, "s")
    if p.clock_rate != 1.0 or (math.isfinite(p.clock_rate_sigma) and p.clock_rate_sigma > 0):
        text += f"; rate {with_uncertainty(p.clock_rate, p.clock_rate_sigma, '1')}"
    return text
