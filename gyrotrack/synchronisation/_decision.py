"""All clips together: common clock rate, direction and ambiguity; and the case that they make.

Clips of one camera share its clock, and if it was not touched in between also its direction. Both are used
only as far as they are seen to hold. A common rate must not cost more chi2 than chance allows. A common
direction fixes the start to within whole turns of the casing; that the fractions of a turn agree must be too
much of a coincidence (a chance below 0.001) before it is believed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import Any

import numpy as np
from scipy.stats import chi2 as chi2_distribution

from gyrotrack._errors import SyncError, UsageError
from gyrotrack.io._records import BodyTrack, Case, Floats, Placement, Recording, Series
from gyrotrack.synchronisation._matching import TURN, Curve, Pair, Solution, Start, casing_curve, solve
from gyrotrack.synchronisation._search import NEAR, RATE_SIGMA, RIVAL, Prepared, half_length, prepare, survey

EXCLUDED = 25.0  # a rival this much worse in chi2 is out
UNCERTAIN = 1e-3  # s; a start that is known no better is called ambiguous
BELIEVED = 1e-3  # chance below which agreeing directions are no coincidence
AGREE = 4.0  # sigma within which two directions agree
RESOLVED = TURN / 10  # rad; a direction known better than this identifies the turn
COMBINATIONS = 64


@dataclass(frozen=True)
class Rival:
    """Another start of a clip [s], and how much worse it is."""

    offset: float
    delta_chi2: float
    kind: str


@dataclass(frozen=True)
class Match:
    """Where one clip lies, with 1-sigma uncertainties.

    `covariance` (3, 3) is that of (offset [s], rate [1], angle [rad]): near the casing's peak speed a later start looks
    like another direction, and the first and the last go together.
    """

    name: str
    start: Start
    offset_sigma: float
    rate_sigma: float
    angle_sigma: float
    rivals: tuple[Rival, ...]
    misfit: float
    rejected: int
    common_rate: bool
    common_direction: bool
    covariance: Floats

    @property
    def ambiguous(self) -> bool:
        """Whether another start, more than a few milliseconds away, cannot be excluded."""
        return self.offset_sigma > UNCERTAIN or any(rival.delta_chi2 < EXCLUDED for rival in self.rivals)

    @property
    def method(self) -> str:
        """How the start was found, in words."""
        parts = ["casing angle in both cameras"]
        parts += ["one clock rate for all clips"] if self.common_rate else []
        parts += ["one direction for all clips"] if self.common_direction else []
        return ", ".join(parts)


def match_clips(
    casing: Curve,
    clips: Sequence[Curve],
    names: Sequence[str],
    cameras: Sequence[object],
    progress: Callable[[int, int | None], None] | None = None,
) -> list[Match]:
    """Place every clip on the casing's clock.

    Parameters
    ----------
    casing : Curve
        The casing in the casing's own recording.
    clips : sequence of Curve
        The casing in each rotor clip.
    names : sequence of str
        What to call the clips in messages.
    cameras : sequence
        Clips with equal entries come from one camera.
    progress : callable, optional
        Told how many clips have been looked at.

    Raises
    ------
    SyncError
        A clip does not belong to this casing recording.
    """
    surveys = {half: survey(casing, half) for half in {half_length(clip) for clip in clips}}
    prepared = []
    for clip, name in zip(clips, names, strict=True):
        prepared.append(prepare(casing, surveys[half_length(clip)], clip, name))
        if progress is not None:
            progress(len(prepared), len(clips))
    found: dict[int, Match] = {}
    for camera in dict.fromkeys(cameras):
        members = [k for k, other in enumerate(cameras) if other == camera]
        together = _match_camera([prepared[k] for k in members])
        found.update(zip(members, together, strict=True))
    return [found[k] for k in range(len(clips))]


def _match_camera(prepared: list[Prepared]) -> list[Match]:
    pairs = [p.pair for p in prepared]
    common = len(prepared) > 1
    fits = [_solve(pairs, combo, common_rate=common) for combo in _combinations(prepared)]
    best = min(fits, key=lambda fit: fit.chi2)
    if common:
        free = _solve(pairs, best.starts, common_rate=False, windows=best.windows)
        if chi2_distribution.sf(best.chi2 - free.chi2, len(prepared) - 1) < 1e-4:
            common, fits = (
                False,
                [_solve(pairs, combo, common_rate=False) for combo in _combinations(prepared)],
            )
            best = min(fits, key=lambda fit: fit.chi2)
    rivals = [_rivals(fits, best, k) for k in range(len(prepared))]
    turns, locked = _common_direction(pairs, best, common_rate=common)
    matches = []
    for k, p in enumerate(prepared):
        sigma = locked.sigma(k)
        turn_rivals = _next_turns(p.pair, best, locked, k) if turns[k] is not None else []
        matches.append(
            Match(
                name=p.name,
                start=locked.starts[k],
                offset_sigma=float(sigma[0]),
                rate_sigma=float(sigma[1]),
                angle_sigma=float(sigma[2]),
                rivals=tuple(sorted(rivals[k] + turn_rivals, key=lambda rival: rival.delta_chi2)),
                misfit=p.misfit,
                rejected=p.rejected,
                common_rate=common,
                common_direction=turns[k] is not None,
                covariance=locked.covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3],
            )
        )
    return matches


def _solve(
    pairs: Sequence[Pair],
    starts: Sequence[Start],
    *,
    common_rate: bool,
    turns: Sequence[int | None] | None = None,
    windows: Sequence[Start] | None = None,
) -> Solution:
    return solve(pairs, starts, rate_sigma=RATE_SIGMA, common_rate=common_rate, turns=turns, windows=windows)


def _combinations(prepared: list[Prepared]) -> list[tuple[Start, ...]]:
    """Return the combinations of possible starts, the most likely ones if there are too many."""
    options = []
    for p in prepared:
        lowest = p.solutions[0].chi2
        options.append([s for s in p.solutions if s.chi2 < lowest + RIVAL])
    combos = list(product(*options))
    combos.sort(key=lambda combo: sum(solution.chi2 for solution in combo))
    return [tuple(solution.starts[0] for solution in combo) for combo in combos[:COMBINATIONS]]


def _rivals(fits: list[Solution], best: Solution, clip: int) -> list[Rival]:
    """Return the other starts of a clip with their chi2 above the best, each once."""
    near = NEAR + best.sigma(clip)[0] / 10
    others: dict[int, Rival] = {}
    for fit in sorted(fits, key=lambda fit: fit.chi2):
        offset = fit.starts[clip].offset
        if abs(offset - best.starts[clip].offset) > near:
            others.setdefault(round(offset / 0.01), Rival(offset, fit.chi2 - best.chi2, "stretch"))
    return list(others.values())


def _common_direction(
    pairs: Sequence[Pair], best: Solution, *, common_rate: bool
) -> tuple[list[int | None], Solution]:
    """Return the turns by which the clips' directions differ, None where unknown, and the solution with them.

    Starting from the clip whose direction is known best, the others join one by one, the best known first.
    """
    count = len(pairs)
    none: list[int | None] = [None] * count
    reference = int(np.argmin([best.sigma(k)[2] for k in range(count)]))
    turns, solution, chance = list(none), best, 1.0
    turns[reference] = 0
    waiting = set(range(count)) - {reference}
    while waiting:
        spread = {k: _difference(solution, k, reference)[1] for k in waiting}
        k = min(waiting, key=spread.__getitem__)
        waiting.discard(k)
        difference, sigma = _difference(solution, k, reference)
        turn = round(difference / TURN)
        if sigma > RESOLVED or abs(difference - TURN * turn) > AGREE * sigma:
            continue
        chance *= min(1.0, 2 * AGREE * sigma / TURN)
        turns[k] = turn
        solution = _solve(pairs, solution.starts, common_rate=common_rate, turns=turns)
    if chance > BELIEVED or not solution.converged:
        return none, best
    return turns, solution


def _difference(solution: Solution, k: int, reference: int) -> tuple[float, float]:
    """Return how far the directions of two clips are apart, and the uncertainty of that [rad]."""
    a, b = 3 * k + 2, 3 * reference + 2
    c = solution.covariance
    variance = c[a, a] + c[b, b] - 2 * c[a, b]
    return solution.starts[k].angle - solution.starts[reference].angle, float(np.sqrt(max(variance, 0.0)))


def _next_turns(pair: Pair, best: Solution, locked: Solution, k: int) -> list[Rival]:
    """Return the starts one turn earlier and later, as the fit without common direction sees them."""
    middle = locked.starts[k].offset + pair.clip.time.mean()
    window = pair.casing.between(middle - 0.5, middle + 0.5)
    speed = abs(np.polyfit(window.time - middle, window.angle, 1)[0])
    offset, sigma = locked.starts[k].offset, best.sigma(k)[0]
    rivals = []
    for step in (-TURN / speed, TURN / speed):
        distance = (offset + step - best.starts[k].offset) / sigma
        here = (offset - best.starts[k].offset) / sigma
        rivals.append(Rival(float(offset + step), float(distance**2 - here**2), "turn"))
    return rivals


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
