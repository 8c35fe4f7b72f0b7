"""A plan of the next run as a document."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import NotRequired, TypedDict

from fitting._schema import as_document
from fitting.discovery._next_run import Bounds, NextRun
from fitting.discovery._power import CONFIDENCE, POWER, EffectLimits
from fitting.planning._friction import FrictionDocument
from fitting.planning._plan import Plan


class LimitsDocument(TypedDict):
    """Limits and power for one effect.

    All numbers are null if the model absorbs the effect; torques are also null if the effect is not a torque.
    """

    unit: str  #: Unit of the strength.
    shape: dict[str, float]  #: Shape constants of the limits, by symbol [SI units].
    stderr: float  #: Standard error of the strength when the effect is added [`unit`].
    detection_limit: float  #: Strength that is found with the probability `power_wanted` [`unit`].
    upper_limit: float  #: Upper limit of the strength; null if the effect is significant [`unit`].
    size: float  #: Strength for which `power` and `runs_needed` are computed [`unit`].
    power: float  #: Probability of finding an effect of this size [1].
    #: Number of runs of this kind, including the given runs, with which the effect is found; null also if no number
    #: suffices [1].
    runs_needed: float
    absorbed: bool  #: Whether the model absorbs the effect, so that it has no limit.
    #: Effects that are not separated from this effect at the larger of `size` and `detection_limit`.
    indistinguishable_from: list[str]
    effect: str  #: Name of the effect.
    kind: str  #: `physical` or `measurement`.
    symbol: str  #: Symbol of the strength.
    torque_Nm: float  #: Detection limit as an rms torque along the motion [torque].
    upper_torque_Nm: float  #: Upper limit as an rms torque along the motion [torque].
    #: Smallest and largest detection limit over all trial shapes, as rms torques [torque].
    detection_range_Nm: list[float]
    size_Nm: float  #: `size` as an rms torque along the motion [torque].
    words: str  #: Name of the effect in words.


class NextRunDocument(TypedDict):
    """The proposed run and its expected information."""

    omega_rotor: float  #: Initial angular velocity of the rotor [rad s-1].
    omega_casing: float  #: Initial angular velocity of the casing or single body [rad s-1].
    duration: float  #: Length of the recording [s].
    windows: list[float]  #: Start of each rotor window [s].
    window_length: float  #: Length of each rotor window [s].
    rivals: list[list[str]]  #: The explanations that the run separates, each a set of effects.
    inseparable: list[list[str]]  #: Pairs of explanations that no run within the bounds separates.
    sentence: str  #: The proposal in words.
    #: Moment of inertia of the casing, divided by the present moment of inertia [1].
    inertia_casing_ratio: float
    touchpoint_ratio: float  #: Friction at the touch point, divided by the present friction [1].
    separation_sigma: float  #: Expected separation of the rivals after the run [standard uncertainties].
    present_sigma: float  #: Separation of the rivals without the run [standard uncertainties].
    #: Separation of the rivals after one more run like the present runs [standard uncertainties].
    repeated_sigma: float
    #: Detection limit after the run, divided by the present limit, by effect [1].
    detection_limit_ratio: dict[str, float]
    bounds: Bounds  #: Bounds of the runs that are possible.


class PlanDocument(TypedDict):
    """Detection limits of recordings, and the best next run."""

    effects: list[LimitsDocument]  #: Limits and power, by effect.
    #: Sets of effects that are indistinguishable near their detection limits.
    classes: tuple[tuple[str, ...], ...]
    next_run: NextRunDocument | None  #: The best next run.
    power_wanted: float  #: Probability of detection at the detection limit [1].
    confidence: float  #: Confidence level of the upper limits [1].
    size_Nm: float  #: Rms torque for which `power` and `runs_needed` are computed [torque].
    warning: str  #: Reason why the limits may not apply; empty if they apply.
    friction: NotRequired[FrictionDocument]  #: Friction laws that the recordings separate, with `--friction`.
    picture: NotRequired[Path]  #: The drawing, with `--picture`.


def plan_document(found: Plan) -> PlanDocument:
    """Return a plan under the keys of `plan --json`."""
    return {
        "effects": [_limits(e, found) for e in found.effects],
        "classes": found.classes,
        "next_run": _next_run(found.next_run) if found.next_run is not None else None,
        "power_wanted": POWER,
        "confidence": CONFIDENCE,
        "size_Nm": found.size,
        "warning": found.warning,
    }


def _limits(e: EffectLimits, found: Plan) -> LimitsDocument:
    """Return limits and power for one effect. Numbers are not finite if the model absorbs the effect.

    Torques are not finite if the effect is not a torque.
    """
    return as_document(
        LimitsDocument,
        e,
        effect=e.effect.name,
        kind=e.effect.kind,
        symbol=e.strength,
        torque_Nm=e.detection_torque,
        upper_torque_Nm=e.upper_torque,
        detection_range_Nm=e.detection_range if e.effect.mechanical else (float("nan"), float("nan")),
        size_Nm=e.size * e.torque,
        words=found.fit.name(e.effect).words,
    )


def _next_run(n: NextRun) -> NextRunDocument:
    """Return the proposed run, its settings and its expected information."""
    return as_document(
        NextRunDocument,
        n,
        **{
            k: getattr(n.run, k)
            for k in ("omega_rotor", "omega_casing", "duration", "windows", "window_length")
        },
        inertia_casing_ratio=n.run.ring,
        touchpoint_ratio=n.run.surface,
        separation_sigma=max(n.separation, 0.0) ** 0.5,
        present_sigma=max(n.present, 0.0) ** 0.5,
        repeated_sigma=max(n.repeated, 0.0) ** 0.5,
        detection_limit_ratio=n.gains,
        bounds=asdict(n.bounds),
    )
