"""A plan of the next run as a document."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from fitting._schema import selected
from fitting.discovery._next_run import NextRun
from fitting.discovery._plan import Plan
from fitting.discovery._power import CONFIDENCE, POWER, EffectLimits

# attributes of the limits of an effect, of a proposed run and of its expected information that are keys of the document
_LIMITS = (
    "unit", "shape", "stderr", "detection_limit", "upper_limit", "size", "power", "runs_needed", "absorbed",
    "indistinguishable_from",
)  # fmt: skip
_RUN = ("omega_rotor", "omega_casing", "duration", "windows", "window_length")
_INFORMATION = ("rivals", "inseparable", "sentence")


def plan_document(found: Plan) -> dict[str, Any]:
    """Return a plan under the keys of `plan --json`."""
    return {
        "effects": [_limits(e) | {"words": found.fit.name(e.effect).words} for e in found.effects],
        "classes": found.classes,
        "next_run": _next_run(found.next_run) if found.next_run is not None else None,
        "power_wanted": POWER,
        "confidence": CONFIDENCE,
        "size_Nm": found.size,
        "warning": found.warning,
    }


def _limits(e: EffectLimits) -> dict[str, Any]:
    """Return limits and power for one effect; not finite where the model absorbs it, or no torque exists.

    `detection_limit`, `upper_limit`, `stderr` and `size` are strengths in `unit`; `torque_Nm`, `upper_torque_Nm` and
    `size_Nm` are the same as rms torques along the motion.
    """
    return selected(e, _LIMITS) | {
        "effect": e.effect.name,
        "kind": e.effect.kind,
        "symbol": e.strength,
        "torque_Nm": e.detection_torque,
        "upper_torque_Nm": e.upper_torque,
        "detection_range_Nm": e.detection_range if e.effect.mechanical else (float("nan"), float("nan")),
        "size_Nm": e.size * e.torque,
    }


def _next_run(n: NextRun) -> dict[str, Any]:
    """Return the proposed run: initial angular rates [rad/s], times [s], expected separation of rivals [sigma]."""
    return {
        **selected(n.run, _RUN),
        **selected(n, _INFORMATION),
        "inertia_casing_ratio": n.run.ring,
        "touchpoint_ratio": n.run.surface,
        "separation_sigma": max(n.separation, 0.0) ** 0.5,
        "present_sigma": max(n.present, 0.0) ** 0.5,
        "repeated_sigma": max(n.repeated, 0.0) ** 0.5,
        "detection_limit_ratio": n.gains,
        "bounds": asdict(n.bounds),
    }
