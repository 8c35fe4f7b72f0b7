"""A plan of the next run as a document."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from fitting._schema import Document, Number
from fitting.discovery._next_run import NextRun
from fitting.discovery._plan import Plan
from fitting.discovery._power import CONFIDENCE, POWER, EffectLimits


class EffectLimitsDocument(Document):
    """Limits and power for one effect; null where the model absorbs it (`absorbed`) or no torque exists.

    `detection_limit`, `upper_limit`, `stderr` and `size` are strengths in `unit`; `torque_Nm`, `upper_torque_Nm` and
    `size_Nm` are the same as rms torques along the motion.
    """

    effect: str
    words: str
    kind: str
    symbol: str
    unit: str
    shape: dict[str, Number]
    stderr: Number
    detection_limit: Number
    upper_limit: Number
    torque_Nm: Number  # noqa: N815 - the unit's own capitals
    upper_torque_Nm: Number  # noqa: N815
    detection_range_Nm: tuple[Number, Number]  # noqa: N815
    size: Number
    size_Nm: Number  # noqa: N815
    power: Number
    runs_needed: Number
    absorbed: bool
    indistinguishable_from: list[str]


class NextRunDocument(Document):
    """The proposed run: initial angular rates [rad/s], times [s], and its expected separation of rivals [sigma]."""

    omega_rotor: Number
    omega_casing: Number
    duration: Number
    windows: list[Number]
    window_length: Number
    inertia_casing_ratio: Number
    touchpoint_ratio: Number
    rivals: list[list[str]]
    separation_sigma: Number
    present_sigma: Number
    repeated_sigma: Number
    inseparable: list[tuple[str, str]]
    detection_limit_ratio: dict[str, Number]
    bounds: dict[str, tuple[Number, Number] | bool]
    sentence: str


class PlanDocument(Document):
    """What `plan --json` prints."""

    effects: list[EffectLimitsDocument]
    classes: list[list[str]]
    next_run: NextRunDocument | None
    power_wanted: Number
    confidence: Number
    size_Nm: Number  # noqa: N815
    warning: str = ""


def plan_document(found: Plan) -> dict[str, Any]:
    """Return a plan under the keys of `plan --json`."""
    document = PlanDocument.model_validate(
        vars(found)
        | {
            "effects": [_limits(e) | {"words": found.fit.name(e.effect).words} for e in found.effects],
            "next_run": _next_run(found.next_run) if found.next_run is not None else None,
            "power_wanted": POWER,
            "confidence": CONFIDENCE,
            "size_Nm": found.size,
        }
    )
    return document.model_dump()


def _limits(e: EffectLimits) -> dict[str, Any]:
    return vars(e) | {
        "effect": e.effect.name,
        "kind": e.effect.kind,
        "symbol": e.strength,
        "torque_Nm": e.detection_torque,
        "upper_torque_Nm": e.upper_torque,
        "detection_range_Nm": e.detection_range if e.effect.mechanical else (float("nan"), float("nan")),
        "size_Nm": e.size * e.torque,
        "absorbed": e.absorbed,
    }


def _next_run(n: NextRun) -> dict[str, Any]:
    return {
        **vars(n),
        **vars(n.run),
        "inertia_casing_ratio": n.run.ring,
        "touchpoint_ratio": n.run.surface,
        "separation_sigma": max(n.separation, 0.0) ** 0.5,
        "present_sigma": max(n.present, 0.0) ** 0.5,
        "repeated_sigma": max(n.repeated, 0.0) ** 0.5,
        "detection_limit_ratio": n.gains,
        "bounds": asdict(n.bounds),
    }
