"""`gyrotrack info`: what a file holds, and whether it is sound."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gyrotrack.cli.options import Json, Quiet, Verbose
from gyrotrack.cli.output import DONE, NOT_TRUSTED, Output

if TYPE_CHECKING:
    from gyrotrack.dataset.inspection import Inspection


def command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording or a case.")],
    *,
    verify: Annotated[
        bool, typer.Option("--verify", help="Re-read every chunk against its checksum.")
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> int:
    """Say what a file holds, and whether it is sound (exit code 3 if not).

    Example: gyrotrack info case1.h5 --verify
    """
    from gyrotrack.dataset.inspection import inspect_file

    found = inspect_file(file, verify=verify)
    out = Output(as_json=as_json)
    out.result(_document(found))
    out.show("\n".join(_verdict(found) if quiet else _verdict(found) + _contents(found)))
    if verbose:
        out.show("settings: " + json.dumps(found.provenance["settings"], indent=2))
    return NOT_TRUSTED if found.problems else DONE


def _document(found: Inspection) -> dict[str, Any]:
    return {
        "file": found.path,
        "bytes": found.path.stat().st_size,
        "kind": found.kind,
        "sound": not found.problems,
        "problems": found.problems,
        "warnings": found.warnings,
        "verified": {"datasets": found.datasets_verified, "chunks": found.chunks_verified},
        **found.provenance,
        **found.holds,
    }


def _verdict(found: Inspection) -> list[str]:
    verdict = "sound" if not found.problems else "NOT SOUND"
    size = found.path.stat().st_size / 1e6
    lines = [f"{found.path}: a {found.kind}, {verdict} ({size:.1f} MB)"]
    lines += [f"  problem: {problem}" for problem in found.problems]
    return lines + [f"  warning: {warning}" for warning in found.warnings]


def _contents(found: Inspection) -> list[str]:
    lines = ["", *(_case_lines(found.holds) if found.kind == "case" else _recording_lines(found.holds))]
    version = found.provenance["software_version"]
    lines += ["", f"written by gyrotrack {version}, layout {found.provenance['format_version']}, "]
    lines[-1] += found.provenance["created"]
    lines.append(f"command: {found.provenance['command']}")
    if found.datasets_verified:
        lines.append(f"verified: {found.chunks_verified} chunks of {found.datasets_verified} datasets")
    return lines


def _case_lines(holds: dict[str, Any]) -> list[str]:
    surface = f", on {holds['surface']}" if holds["surface"] else ""
    lines = [
        f"label    {holds['label'] or '-'}{surface}",
        f"inertia  {_inertia(holds)} kg m2",
        f"measured {'angles' if holds['quantity'] == 'angle' else 'angular velocities'}",
        "",
        _HEADER if holds["quantity"] == "angle" else _HEADER.replace("  sigma [mrad]", "sigma [mrad/s]"),
        _motion_line("casing" if holds["bodies"] == "two" else "body", holds["casing"]),
    ]
    lines += [_motion_line(f"rotor {w['window']}", w) for w in holds["rotor"]["windows"]]
    for name, clip in holds["recordings"].items():
        lines += ["", f"clip '{name}'"]
        if "placement" in clip:
            lines.append(_placement_line(clip["placement"]))
        lines += _recording_lines(clip)
    return lines


def _inertia(holds: dict[str, Any]) -> str:
    if holds["bodies"] == "one":
        return f"{holds['I_casing']:.4g}"
    return f"rotor {holds['I_rotor']:.4g}, casing {holds['I_casing']:.4g}"


def _placement_line(p: dict[str, Any]) -> str:
    if not p["clock_rate_sigma"]:
        return f"clock    {p['method']}"
    doubt = ", AMBIGUOUS" if p["ambiguous"] else ""
    sign = "+" if p["clock_rate"] >= 1 else "-"
    return (
        f"clock    starts at {p['clock_offset']:.6f} s +- {1e3 * p['clock_offset_sigma']:.3f} ms, "
        f"rate 1 {sign} {abs(p['clock_rate'] - 1):.1e}{doubt}"
    )


def _recording_lines(holds: dict[str, Any]) -> list[str]:
    turning = "clockwise" if holds["sense"] < 0 else "counter-clockwise"
    stamped = ", times from the time stamps" if holds["times_from"] == "stamps" else ""
    lines = [
        f"film     {holds['source']}, {holds['width']} x {holds['height']} px, {holds['capture_fps']:g} fps{stamped}",
        f"frames   {holds['frames']} in {holds['duration_s']:.3f} s, turning {turning} as seen",
    ]
    if holds["markers"]:
        lines += ["", f"{'marker':<10}{'body':<10}" + "".join(f"{word:>9}" for word in _WORDS)]
    for name, marker in holds["markers"].items():
        lines.append(f"{name:<10}{marker['body']:<10}" + "".join(f"{marker[w]:>9}" for w in _WORDS.values()))
    lines += ["", _HEADER]
    lines += [_motion_line(name, body) for name, body in holds["bodies"].items()]
    return lines


_WORDS = {"ok": "ok", "blurred": "blurred", "occluded": "occluded", "outside": "out_of_frame", "lost": "lost"}
_HEADER = f"{'':<10}{'samples':>9}{'time [s]':>20}{'speed [rad/s]':>20}{'sigma [mrad]':>16}"


def _motion_line(name: str, motion: dict[str, Any]) -> str:
    time = _span(motion["t_start"], motion["t_stop"], 3)
    speed = _span(motion["omega_min"], motion["omega_max"], 1)
    sigma = f"{1e3 * motion['median_sigma']:.2f}" if motion["median_sigma"] is not None else "-"
    return f"{name:<10}{motion['samples']:>9}{time:>20}{speed:>20}{sigma:>16}"


def _span(low: float | None, high: float | None, digits: int) -> str:
    return "-" if low is None or high is None else f"{low:.{digits}f} to {high:.{digits}f}"
