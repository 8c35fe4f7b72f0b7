"""Joint solution of all clips: common clock rate and direction, ambiguity; and the resulting case.

Clips of one camera have a common clock rate, and a common direction if the camera was not moved in between. Both are
assumed only if the data confirm them. A common rate must not increase chi2 significantly. A common direction determines
the start modulo whole turns of the casing; it is assumed if the directions agree with a probability by chance of less
than 0.001.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np
from scipy.stats import chi2 as chi2_distribution

from gyrotrack._errors import SyncError, UsageError
from gyrotrack.io._records import (
    BodyTrack,
    Case,
    Floats,
    Placement,
    Recording,
    doubts_of,
    series_of,
    speed_warnings,
)
from gyrotrack.synchronisation._matching import TURN, Curve, Pair, Solution, Start, casing_curve, solve
from gyrotrack.synchronisation._search import NEAR, RATE_SIGMA, RIVAL, Prepared, half_length, prepare, survey

EXCLUDED = 25.0  # increase of chi2 above which an alternative start is excluded
MAX_START_SIGMA = 1e-3  # largest uncertainty of a start that is not ambiguous [s]
MAX_CHANCE = 1e-3  # largest probability that directions agree by chance
AGREE = 4.0  # largest difference of equal directions [sigma]
RESOLVED = TURN / 10  # largest uncertainty of a direction that identifies the turn [rad]
MAX_COMBINATIONS = 64


@dataclass(frozen=True)
class Rival:
    """An alternative start of a clip [s], and its increase of chi2."""

    offset: float
    delta_chi2: float
    kind: str


@dataclass(frozen=True)
class Match:
    """Start, rate and direction of one clip with uncertainties and `covariance` (3, 3) of (offset, rate, angle)."""

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
        """Whether another start cannot be excluded, or the uncertainty is too large."""
        return self.offset_sigma > MAX_START_SIGMA or any(r.delta_chi2 < EXCLUDED for r in self.rivals)

    @property
    def method(self) -> str:
        """Description of the method."""
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
    """Determine start, rate and direction of every clip by the casing's angle; equal `cameras` are one camera."""
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
            common = False
            fits = [_solve(pairs, combo, common_rate=False) for combo in _combinations(prepared)]
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
    """Return the most likely combinations of possible starts."""
    options = [[s for s in p.solutions if s.chi2 < p.solutions[0].chi2 + RIVAL] for p in prepared]
    combos = sorted(product(*options), key=lambda combo: sum(solution.chi2 for solution in combo))
    return [tuple(solution.starts[0] for solution in combo) for combo in combos[:MAX_COMBINATIONS]]


def _rivals(fits: list[Solution], best: Solution, clip: int) -> list[Rival]:
    """Return the distinct alternative starts of a clip with their increase of chi2."""
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
    """Return the whole turns between the directions of the clips, None where unknown, and the solution with them.

    The clip with the best known direction is the reference; the others are added in order of increasing uncertainty.
    """
    count = len(pairs)
    none: list[int | None] = [None] * count
    reference = int(np.argmin([best.sigma(k)[2] for k in range(count)]))
    turns, solution, chance = list(none), best, 1.0
    turns[reference] = 0
    remaining = set(range(count)) - {reference}
    while remaining:
        spread = {k: _difference(solution, k, reference)[1] for k in remaining}
        k = min(remaining, key=spread.__getitem__)
        remaining.discard(k)
        difference, sigma = _difference(solution, k, reference)
        turn = round(difference / TURN)
        if sigma > RESOLVED or abs(difference - TURN * turn) > AGREE * sigma:
            continue
        chance *= min(1.0, 2 * AGREE * sigma / TURN)
        turns[k] = turn
        solution = _solve(pairs, solution.starts, common_rate=common_rate, turns=turns)
    if chance > MAX_CHANCE or not solution.converged:
        return none, best
    return turns, solution


def _difference(solution: Solution, k: int, reference: int) -> tuple[float, float]:
    """Return the difference of the directions of two clips, and its uncertainty [rad]."""
    a, b = 3 * k + 2, 3 * reference + 2
    c = solution.covariance
    variance = c[a, a] + c[b, b] - 2 * c[a, b]
    return solution.starts[k].angle - solution.starts[reference].angle, float(np.sqrt(max(variance, 0.0)))


def _next_turns(pair: Pair, best: Solution, locked: Solution, k: int) -> list[Rival]:
    """Return the starts one turn earlier and later, with their chi2 in the fit without common direction."""
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
    """A case, and the match of each clip in the order of the input."""

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
    """Synchronise the rotor clips of one experiment with the casing camera.

    The names, for messages, begin with that of the casing; moments of inertia are in kg m2; `progress` is called with
    (clips done, clips in total). A SyncError says that a clip does not belong to this run, is given twice, or does not
    show both bodies; a UsageError that a moment of inertia is not positive, or there is no clip.
    """
    if not (I_rotor > 0 and I_casing > 0):
        raise UsageError("A moment of inertia must be positive.", "Give it in kg m2, such as 5.54e-5.")
    if not rotors:
        raise UsageError("There is no rotor clip.", "Give the rotor recordings after the casing recording.")
    _check_distinct_films([casing, *rotors], names)
    rotor_tracks = [_rotor(recording, name) for recording, name in zip(rotors, names[1:], strict=True)]
    curves = [casing_curve(r, name) for r, name in zip([casing, *rotors], names, strict=True)]
    cameras = [(r.capture_fps, r.width, r.height) for r in rotors]
    matches = match_clips(curves[0], curves[1:], names[1:], cameras, progress)
    order = sorted(range(len(rotors)), key=lambda k: matches[k].start.offset)
    ids = {k: f"rotor_{window}" for window, k in enumerate(order)}
    of_casing = replace(series_of([casing.bodies["casing"]]), window=None)
    of_rotor = series_of([_on_clock(rotor_tracks[k], matches[k]) for k in order])
    remedy = (
        "name the bodies in a profile (`gyrotrack profile VIDEO -o P.toml`) and repeat "
        "`gyrotrack extract VIDEO --profile P.toml`"
    )
    still = Placement("casing", 0.0, 0.0, 1.0, 0.0, 0.0, ambiguous=False, method="the reference clock")
    case = Case(
        I_rotor=I_rotor,
        I_casing=I_casing,
        label=label,
        surface=surface,
        casing=of_casing,
        rotor=of_rotor,
        recordings={"casing": casing, **{ids[k]: rotors[k] for k in order}},
        placements={"casing": still, **{ids[k]: _placement(ids[k], matches[k]) for k in order}},
        warnings=(
            *(
                f"{n}: {doubt}"
                for n, r in zip(names, [casing, *rotors], strict=True)
                for doubt in doubts_of(r)
            ),
            *_warnings(matches, rotor_tracks, order),
            *speed_warnings(of_casing, of_rotor, remedy),
        ),
        extra={"sync_covariance": {ids[k]: matches[k].covariance.tolist() for k in order}},
    )
    return Synchronised(case, tuple(matches))


def _check_distinct_films(recordings: Sequence[Recording], names: Sequence[str]) -> None:
    seen: dict[str, str] = {}
    for recording, name in zip(recordings, names, strict=True):
        if recording.source_sha256 and recording.source_sha256 in seen:
            other = seen[recording.source_sha256]
            raise SyncError(f"{name} and {other} come from the same film.", "Give each film once.")
        seen[recording.source_sha256] = name


def _rotor(recording: Recording, name: str) -> BodyTrack:
    body = recording.bodies.get("rotor")
    if body is None or not len(body.time):
        what = f"{name} does not show the rotor."
        raise SyncError(what, "Track the markers of the rotor, or omit the recording.")
    return body


def _on_clock(body: BodyTrack, match: Match) -> BodyTrack:
    """Transform the rotor of a clip to clock and direction of the casing camera."""
    rate = 1 + match.start.eps
    return replace(
        body,
        time=match.start.offset + rate * body.time,
        angle=body.angle + match.start.angle % TURN,
        omega=body.omega / rate,
        omega_sigma=body.omega_sigma / rate,
    )


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


def _warnings(matches: Sequence[Match], rotor_tracks: Sequence[BodyTrack], order: Sequence[int]) -> list[str]:
    """Return warnings about uncertain starts and inconsistent clips."""
    found = []
    for match in matches:
        rivals = [rival for rival in match.rivals if rival.delta_chi2 < EXCLUDED]
        if rivals:
            away = {"turn": " (one turn of the casing away)"}
            others = ", ".join(f"{r.offset:.3f} s{away.get(r.kind, '')}" for r in rivals[:3])
            found.append(f"{match.name}: ambiguous start, {match.start.offset:.3f} s or {others}")
        elif match.offset_sigma > MAX_START_SIGMA:
            found.append(
                f"{match.name}: the uncertainty of the start is {1e3 * match.offset_sigma:.1f} ms, "
                "because the speed of the casing changes little in this clip"
            )
    for a, b in pairwise(order):
        first, second = _on_clock(rotor_tracks[a], matches[a]), _on_clock(rotor_tracks[b], matches[b])
        pair = f"{matches[a].name} and {matches[b].name}"
        if second.time[0] < first.time[-1]:
            found.append(f"{pair} overlap in time")
        elif np.nanmedian(second.omega) > 1.02 * np.nanmedian(first.omega):
            found.append(f"{pair}: the rotor is faster in the later clip; one of the starts may be wrong")
    return found
