"""Write docs/reference/effects.md from the library of effects: `python docs/make_effects.py`."""

from __future__ import annotations

from pathlib import Path

from fitting.effects._effect import Effect
from fitting.effects._library import GENERAL, LIBRARY, LINEAR, REDUCED

TARGET = Path(__file__).parent / "reference" / "effects.md"

_HEAD = """# Effects

This page is generated from the library by `docs/make_effects.py`. `gyrotrack effects NAME` shows one effect, and its
bounds with `--json`.

A law is a torque in N m. An effect on the rotor or the casing acts on that body. An effect in the bearing acts on the
casing with +law and on the rotor with -law, where `delta` is omega_r - omega_c. An effect in a contact of ratio n acts
on the rotor with law and on the casing with -n law, where `slip` is omega_r - n omega_c; the discovery does not include
contacts. A *factor* multiplies the whole bearing torque. The law of a camera is an error [rad] added to the measured
angle, a function of the angle `psi` and the angular velocity `omega` of the filmed body; it does not act on the motion.

`gyrotrack fit --add` and `--json` use the names in the first column. For a case of a single body the role may be left
out (`air.quadratic`), and the touch point is its support (`support.constant`); in words, the name of the body replaces
"casing". User-defined laws may contain t, omega_r, omega_c, psi_r, psi_c and delta; any other name is a parameter.
Times of events, for example t0 in `heaviside(t - t0)` or `exp(-((t - t0)/w)**2)`, are searched for in the whole record.
"""

_JOINTS = {
    "rotor": "On the rotor",
    "bearing": "Between rotor and casing",
    "contact": "Where rotor and casing touch",
    "factor": "Factors of the bearing torque",
    "casing": "On the casing",
    "inertia": "On the moment of inertia (measurement): a factor of the casing's acceleration",
    "camera.rotor": "On the rotor camera (measurement)",
    "camera.casing": "On the casing camera (measurement)",
}


def page() -> str:
    """Return the text of the page."""
    parts = [_HEAD]
    unnamed = {e.joint for e in LIBRARY.values()} - set(_JOINTS)
    if unnamed:
        raise LookupError(f"these joints have no title: {sorted(unnamed)}")
    for joint, title in _JOINTS.items():
        parts.append(f"## {title}\n")
        parts.append(
            "| name | in words | law | parameters | observable effect | similar effects |\n|---|---|---|---|---|---|"
        )
        parts += [_row(e) for e in LIBRARY.values() if e.joint == joint]
        parts.append("")
    parts.append("## Models\n")
    parts.append("| name | effects |\n|---|---|")
    for name, effects in (("linear", LINEAR), ("reduced", REDUCED), ("general", GENERAL)):
        parts.append(f"| {name} | {', '.join(effects)} |")
    parts += ["", "## Sources\n", "| name | source |\n|---|---|"]
    parts += [f"| {e.name} | {e.source} |" for e in LIBRARY.values()]
    return "\n".join([*parts, ""])


def _row(e: Effect) -> str:
    law = f"`{e.law}`" + (f"; d({e.state.symbol})/dt = `{e.state.rate}`" if e.state else "")
    parameters = ", ".join(f"{p.symbol} [{p.unit}]" for p in e.parameters)
    similar = ", ".join(e.confused_with) or "-"
    return f"| {e.name} | {e.words} | {law} | {parameters} | {e.signature} | {similar} |".replace(
        "||", "\\|\\|"
    )


if __name__ == "__main__":
    TARGET.write_text(page(), encoding="utf-8")
