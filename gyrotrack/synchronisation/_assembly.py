"""From recordings to a case."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from gyrotrack._errors import SyncError, UsageError
from gyrotrack.io._records import BodyTrack, Case, Placement, Recording, Series
from gyrotrack.synchronisation._curves import TURN, casing_curve
from gyrotrack.synchronisation._decision import UNCERTAIN, Match, Rival, match_clips

Progress = Callable[[int, int | None], None]


@dataclass(frozen=True)
class Synchronised:
    """A case, and where each clip was found, in the order in which the clips were given."""

    case: Case
    matches: tuple[Match, ...]


def synchronise(
    casing: Recording,
    rotors: Sequence[Recording],
    names: Sequence[str],
    *,
    I_rotor: float,
    I_casing: float,
    label: str = "",
    surface: str = "",
    progress: Progress | None = None,
) -> Synchronised:
    """Put the rotor clips of one experiment on the clock of the casing's camera.

    Parameters
    ----------
    casing : Recording
        The recording that follows the casing throughout.
    rotors : sequence of Recording
        Clips that show the rotor, and the casing too.
    names : sequence of str
        What to call the recordings in messages, the casing's first.
    label, surface : str
        Name of the case, and what the casing turned on.
    I_rotor, I_casing : float
        Moments of inertia [kg m2].
    progress : callable, optional
        Told how many clips are done.

    Raises
    ------
    SyncError
        A clip does not belong to this run, is given twice, or lacks a body.
    UsageError
        A moment of inertia is not positive, or there is no clip.
    """
    if not (I_rotor > 0 and I_casing > 0):
        raise UsageError("A moment of inertia must be positive.", "Give it in kg m2, such as 5.54e-5.")
    if not rotors:
        raise UsageError("There is no rotor clip.", "Name the rotor recordings after the casing recording.")
    _refuse_twice([casing, *rotors], names)
    wheels = [_rotor(recording, name) for recording, name in zip(rotors, names[1:], strict=True)]
    curves = [casing_curve(r, name) for r, name in zip([casing, *rotors], names, strict=True)]
    cameras = [(r.capture_fps, r.width, r.height) for r in rotors]
    matches = match_clips(curves[0], curves[1:], names[1:], cameras, progress)
    order = sorted(range(len(rotors)), key=lambda k: matches[k].start.offset)
    ids = {k: f"rotor_{window}" for window, k in enumerate(order)}
    still = Placement("casing", 0.0, 0.0, 1.0, 0.0, 0.0, ambiguous=False, method="the reference clock")
    case = Case(
        I_rotor=I_rotor,
        I_casing=I_casing,
        label=label,
        surface=surface,
        casing=_series([casing.bodies["casing"]]),
        rotor=_windows([_on_clock(wheels[k], matches[k]) for k in order]),
        recordings={"casing": casing, **{ids[k]: rotors[k] for k in order}},
        placements={"casing": still, **{ids[k]: _placement(ids[k], matches[k]) for k in order}},
        warnings=tuple(_doubts(matches, wheels, order)),
        extra={"sync_covariance": {ids[k]: matches[k].covariance.tolist() for k in order}},
    )
    return Synchronised(case, tuple(matches))


def _refuse_twice(recordings: Sequence[Recording], names: Sequence[str]) -> None:
    seen: dict[str, str] = {}
    for recording, name in zip(recordings, names, strict=True):
        if recording.source_sha256 and recording.source_sha256 in seen:
            raise SyncError(
                f"{name} and {seen[recording.source_sha256]} come from the same film.",
                "Give every film once.",
            )
        seen[recording.source_sha256] = name


def _rotor(recording: Recording, name: str) -> BodyTrack:
    body = recording.bodies.get("rotor")
    if body is None or not len(body.time):
        raise SyncError(
            f"{name} does not show the rotor.", "Track the rotor's markers in it, or leave it out."
        )
    return body


def _on_clock(body: BodyTrack, match: Match) -> BodyTrack:
    """Return a clip's rotor on the casing camera's clock and direction."""
    rate = 1 + match.start.eps
    return replace(
        body,
        time=match.start.offset + rate * body.time,
        angle=body.angle + match.start.angle % TURN,
        omega=body.omega / rate,
        omega_sigma=body.omega_sigma / rate,
    )


def _windows(parts: list[BodyTrack]) -> Series:
    window = np.concatenate([np.full(len(part.time), k, dtype=np.int64) for k, part in enumerate(parts)])
    return replace(_series(parts), window=window)


def _series(parts: list[BodyTrack]) -> Series:
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("time", "angle", "sigma", "omega", "omega_sigma")
    }
    turn = np.floor(joined["angle"] / TURN).astype(np.int64)
    return Series(**joined, turn=turn, window=None, sigma_source="measured")


def _placement(name: str, match: Match) -> Placement:
    return Placement(
        id=name,
        clock_offset=float(match.start.offset),
        clock_offset_sigma=float(match.offset_sigma),
        clock_rate=float(1 + match.start.eps),
        clock_rate_sigma=float(match.rate_sigma),
        angle_offset=float(match.start.angle % TURN),
        ambiguous=match.ambiguous,
        method=match.method,
    )


def _told(rival: Rival) -> str:
    turn = " (one turn of the casing away)" if rival.kind == "turn" else ""
    return f"{rival.offset:.3f} s{turn}"


def _doubts(matches: Sequence[Match], wheels: Sequence[BodyTrack], order: Sequence[int]) -> list[str]:
    """Say which starts are uncertain, and what contradicts itself."""
    found = []
    for match in matches:
        rivals = [rival for rival in match.rivals if rival.delta_chi2 < 25]
        if rivals:
            others = ", ".join(_told(rival) for rival in rivals[:3])
            found.append(f"{match.name}: it may as well start at {others} as at {match.start.offset:.3f} s")
        elif match.offset_sigma > UNCERTAIN:
            found.append(
                f"{match.name}: its start is known to {1e3 * match.offset_sigma:.1f} ms only, "
                "as the casing's speed changes too little there"
            )
    for a, b in pairwise(order):
        first, second = _on_clock(wheels[a], matches[a]), _on_clock(wheels[b], matches[b])
        pair = f"{matches[a].name} and {matches[b].name}"
        if second.time[0] < first.time[-1]:
            found.append(f"{pair} overlap in time")
        elif np.nanmedian(second.omega) > 1.02 * np.nanmedian(first.omega):
            found.append(f"{pair}: the rotor is faster in the later clip, so one of them may be misplaced")
    return found
