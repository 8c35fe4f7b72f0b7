"""Units and quantities of column headers: factors to s, rad and rad/s."""

from __future__ import annotations

import math
import re

TURN = 2 * math.pi

UNITS: dict[str, dict[str, float]] = {
    "t": {"s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "milliseconds": 1e-3,
          "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "microseconds": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    "angle": {"rad": 1.0, "radian": 1.0, "radians": 1.0, "mrad": 1e-3, "urad": 1e-6, "deg": math.pi / 180,
              "degree": math.pi / 180, "degrees": math.pi / 180, "°": math.pi / 180, "gon": math.pi / 200,
              "rev": TURN, "turn": TURN, "turns": TURN, "revolutions": TURN, "cycles": TURN},
    "omega": {"rad/s": 1.0, "rads-1": 1.0, "rads^-1": 1.0, "rad/sec": 1.0, "s-1": 1.0, "s^-1": 1.0, "1/s": 1.0,
              "mrad/s": 1e-3, "deg/s": math.pi / 180, "°/s": math.pi / 180, "degs-1": math.pi / 180,
              "dps": math.pi / 180,
              "rpm": TURN / 60, "1/min": TURN / 60, "min-1": TURN / 60, "u/min": TURN / 60, "rev/min": TURN / 60,
              "rev/s": TURN, "rps": TURN, "turns/s": TURN, "hz": TURN},
}  # fmt: skip
"""Factor of each unit to SI, by quantity."""

_HEADER_WORDS = {
    "t": {"t", "time", "times", "zeit", "temps", "tiempo", "tempo", "timestamp", "timestamps", "clock", "elapsed",
          "millis", "micros"},
    "angle": {"angle", "angles", "psi", "phi", "theta", "ψ", "φ", "θ", "winkel", "yaw", "heading", "azimuth", "alpha"},
    "omega": {"omega", "w", "ω", "speed", "angularvelocity", "gyro", "gyroscope", "gyr", "drehzahl", "rpm",
              "winkelgeschwindigkeit", "rotationrate", "angularspeed", "angularrate",
              "gx", "gy", "gz", "gyrox", "gyroy", "gyroz", "gyrx", "gyry", "gyrz", "wx", "wy", "wz"},
    "sigma": {"sigma", "σ", "error", "err", "uncertainty", "std", "sd"},
    "frame": {"frame", "frames", "step", "frameidx"},
    "revolutions": {"revolutions", "revs", "counts", "count", "counter", "pulses", "revolution"},
}  # fmt: skip
"""Words in a header for each quantity; the first match is used."""

_TICKS = {"millis": "ms", "micros": "us"}
"""Functions of microcontrollers that give times, and their units."""

ROLES = tuple(_HEADER_WORDS)


def clean(unit: str) -> str:
    """Return a unit without blanks and multiplication signs."""
    return re.sub(r"[\s*·_]", "", unit)


def is_unit(text: str) -> bool:
    """Return whether a word is a unit, of the supported quantities or others."""
    return factor("", text) is not None or clean(text).casefold() in {
        "state",
        "px",
        "m",
        "cm",
        "mm",
        "1",
        "v",
    }


def factor(role: str, unit: str) -> float | None:
    """Return the factor of a unit to SI for a role (any role if it is empty); None if the unit is unknown.

    Units that are not in the table are converted with `pint`, if it is installed.
    """
    bare = clean(unit)
    tables = [UNITS[role]] if role else list(UNITS.values())
    for table in tables:
        for text in (bare, bare.casefold()):
            if text in table:
                return table[text]
    return _by_pint(role, unit) if role else None


def _by_pint(role: str, unit: str) -> float | None:
    try:
        import pint
    except ImportError:
        return None
    try:
        target = {"t": "s", "angle": "rad", "omega": "rad/s"}[role]
        return float(pint.UnitRegistry().Quantity(1.0, unit).to(target).magnitude)
    except Exception:
        return None


def header_of(name: str) -> tuple[str, str]:
    """Split ``t [s]``, ``t (s)``, ``t / s`` or ``t_ms`` into name and unit ("" without one)."""
    match = re.fullmatch(r"([^\[\](){}/]+?)\s*(?:[\[({]\s*(.*?)\s*[\])}]|/\s*(.*))?", name.strip())
    word, unit = (match[1], match[2] or match[3] or "") if match else (name, "")
    unit = unit or _TICKS.get(word.strip().casefold(), "")
    if not unit:
        parts = [p for p in word.split("_") if not re.fullmatch(r"\d+fps", p)]
        for size in (2, 1):
            tail = "/".join(parts[-size:]) if size == 2 else parts[-1]
            if len(parts) > size and factor("", tail) is not None:
                return "_".join(parts[:-size]), tail
    return word.strip(), unit


def role_of(name: str) -> str | None:
    """Return the quantity of a column by its name without unit; None if it is unknown."""
    text = name.casefold()
    if "accel" in text:
        return None
    if text.startswith(("sigma_", "err_", "d_", "u_")) or text.endswith(
        ("_sigma", "_err", "_error", " error")
    ):
        return "sigma"
    words = [w for w in re.split(r"[\s_.\-:#]+", text) if w]
    whole = "".join(words)
    for role, known in _HEADER_WORDS.items():
        if whole in known:
            return role
    return next(
        (role for w in words for role, known in _HEADER_WORDS.items() if w in known and role != "sigma"), None
    )
