"""Write docs/reference/effects.md from the library of effects: `python docs/make_effects.py`."""

from __future__ import annotations

from pathlib import Path

from fitting.effects._effect import Effect
from fitting.effects._library import GENERAL, LIBRARY, LINEAR, REDUCED

TARGET = Path(__file__).parent / "reference" / "effects.md"

_HEAD = """# Effects

This page is made from the library itself by `docs/make_effects.py`; a test compares the two. `gyrotrack effects NAME`
shows one effect, with its bounds under `--json`.

A law is a torque in N m. One on the rotor or the casing acts on that body; one in the bearing is +law on the casing
and -law on the rotor; one in a contact, of the ratio n, is law on the rotor and -n law on the casing, `slip` is
omega_r - n omega_c, and the discovery does not try it; a *factor* multiplies the whole bearing torque. `delta` is
omega_r - omega_c. A law of a camera is an angle [rad] added to what it sees, with `psi` and `omega` those of the
filmed body: an artefact, never physics.

A name in the first column is what `gyrotrack fit --add` takes and what `gyrotrack diagnose` answers. A law of your own
may contain t, omega_r, omega_c, psi_r, psi_c and delta; any other name in it is a parameter. A moment, as t0 in
`heaviside(t - t0)` or in `exp(-((t - t0)/w)**2)`, is sought in the whole record.
"""

_JOINTS = {
    "rotor": "On the rotor",
    "bearing": "Between rotor and casing",
    "contact": "Where rotor and casing touch",
    "factor": "Factors of the bearing torque",
    "casing": "On the casing",
    "inertia": "Of the experimenter (measurement): a factor of the casing's acceleration",
    "camera.rotor": "Of the rotor's camera (measurement)",
    "camera.casing": "Of the casing's camera (measurement)",
}


def page() -> str:
    """Return the page as it should be."""
    parts = [_HEAD]
    unnamed = {e.joint for e in LIBRARY.values()} - set(_JOINTS)
    if unnamed:
        raise LookupError(f"give these joints a title: {sorted(unnamed)}")
    for joint, title in _JOINTS.items():
        parts.append(f"## {title}\n")
        parts.append("| name | law | parameters | seen as | looks like |\n|---|---|---|---|---|")
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
    looks_like = ", ".join(e.confused_with) or "-"
    return f"| {e.name} | {law} | {parameters} | {e.signature} | {looks_like} |".replace("||", "\\|\\|")


if __name__ == "__main__":
    TARGET.write_text(page(), encoding="utf-8")
