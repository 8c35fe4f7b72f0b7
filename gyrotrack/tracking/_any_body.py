"""Tracking of one rotating body in any film, by its markers or by its texture.

The moving part of the picture is found, and candidates for the hub are proposed. The ring about each candidate is
tracked through a few hundred frames, and the candidate that best explains the change of brightness is refined. See
`_registration` for the measurement of the angle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import NoReturn

import cv2
import numpy as np

from gyrotrack._arrays import Bools, Floats, Integers, Picture, Plane
from gyrotrack._column_store import StoredPictures, large_blocks_returned, new_columns, release_pages
from gyrotrack._errors import TrackingError, UsageError
from gyrotrack.tracking._aliasing import unaliased
from gyrotrack.tracking._camera_motion import Shake, camera_shake
from gyrotrack.tracking._coaxial import second_rotation
from gyrotrack.tracking._diagnosis import (
    FOLLOW_LINKS,
    MOSTLY_TRANSLATES,
    Pair,
    RefusedFilmError,
    frames_of_one_shot,
    pairs_of,
    refuse_blurred,
    refuse_moving_camera,
    refuse_two_motions,
)
from gyrotrack.tracking._film import Film, Progress, frames_of, reduced
from gyrotrack.tracking._fixed_hub import REFUSED, displaced, drift, fallen, halves_differ, hub_doubt
from gyrotrack.tracking._hub_search import (
    FARTHEST,
    Motion,
    Proposal,
    distance_from,
    propose_hubs,
    ring_for,
    tilted_outline,
)
from gyrotrack.tracking._links import carries_a_link
from gyrotrack.tracking._live_angles import FrameAngles
from gyrotrack.tracking._moving_hub import may_be_loose, track_by_features, track_free_body
from gyrotrack.tracking._registration import (
    TURN,
    Area,
    Pose,
    Ring,
    Template,
    every,
    explained,
    follow,
    learn,
    register,
    rolled,
    without_slips,
)
from gyrotrack.tracking._silhouettes import axes_meet
from gyrotrack.tracking._tracked import (
    Tracked,
    apart_beyond_harmonics,
    correlated_variance,
    hub_error,
    white_noise,
)
from gyrotrack.tracking._translation import translates

_TRIAL = 300
"""Number of frames on which a candidate for the hub is evaluated [frames]. Chosen: a smaller number shows little
motion, a larger one costs time."""
_EXCERPT = 300
"""Number of frames that `read_excerpt` reads [frames]. Chosen: equal to `_TRIAL`; a larger number costs time, a smaller
one shows little motion."""
_LEARNT = 300
"""Number of frames from which the template is estimated [frames]. Chosen: a smaller number gives a noisier template, a
larger one costs time and memory."""
_HUB_FRAMES = 100
"""Number of frames from which the motion of the hub, or its distance, is measured [frames]. Chosen: a smaller number
gives an uncertain hub, a larger one costs time."""
_PATH_SETTLED = 0.02
"""For a body far from its hub, the iterations for the displacement in a frame end if a step is smaller than this value
[px]. Chosen: a larger value stops early, a smaller one costs time."""
_PATH_ROUNDS = 5
"""Number of iterations that refine a hub far from its body [iterations]. Chosen: a smaller number stops before distance
and template agree, a larger one costs time."""
_FEWEST_STEPS = 4.0
"""Smallest effective number, (sum s)^2 / (sum s^2), of the steps s by which a body turns from frame to frame [1].
Chosen: a smaller value mistakes a cut for a rotation, a larger one refuses short motions."""
_DISPLACED = 0.05
"""Smallest distance of a better hub from the given hub that triggers a warning [radii]. Chosen: a smaller value warns
of accurate hubs, a larger one accepts biased angles."""
_PATH_ERROR = 0.1
"""Position-dependent error of a displacement, due to background and interpolation [px]. Measured: 0.06 px in drawn
films."""
# options for a film in which no hub is found
_GIVE_HUB = "Give the centre of rotation with --hub X,Y, or a point to follow with --point X,Y."
_COARSE = 48.0
"""Resolution of the ring in the search [samples per radius]. Chosen: a larger value costs time, a smaller one blurs the
marks."""
_FINE = 200.0
"""Resolution of the ring in the measurement [samples per radius]. Chosen: a larger value costs time, a smaller one
loses detail."""
_EXPLAINED = 0.4
"""Smallest share of the change of brightness that the rotation explains [1]. Chosen: a smaller value accepts other
motions, a larger one refuses uneven light."""
_OUTSIDE = 0.85
"""Smallest explained share for a hub that is not given, if the hub or most of its ring is outside the picture [1].
Chosen: rotation about such a hub resembles translation; a smaller value accepts translation, a larger one refuses
pendulums."""
_SHOWN = 0.33
"""Largest share of a ring inside the picture for which `_OUTSIDE` applies [1]. Chosen: a body in a corner of the
picture shows a smaller share; a larger value refuses cut discs, a smaller one accepts translation."""
_WHOLE = 0.9
"""The camera may turn about a hub outside the picture if at least this share of the picture moves [1]. Chosen: a
smaller value refuses bodies that fill the picture, a larger one accepts moving cameras."""
_UNDETERMINED = 0.25
"""Largest accepted error of the angles due to the hub, divided by the standard deviation of the angles [1]. Chosen: if
the assumed hub is too near, all angles are too large; at this limit the amplitude of a pendulum does not determine its
period."""
_AS_MUCH = 1.1
"""Two hubs are reported if the unexplained share with the other hub, divided by the unexplained share with the best
hub, is at most this value [1]. Chosen: a smaller value hides alternatives, a larger one reports worse hubs."""
_OTHER_RANGE = 0.05
"""Two hubs are reported if the ranges of the angles about them differ by at least this relative difference [1]. Chosen:
a smaller value reports hubs with equal angles, a larger one hides different angles."""
_AS_GOOD = 0.8
"""The film is ambiguous if the explained share of a second body, relative to the best candidate, is at least this value
[1]. Chosen: a smaller value refuses films with shadows, a larger one may choose the wrong body."""
_GIVEN_IS_NEAR = 0.8
"""Explained share about a given hub below which proposed hubs near it are also tried [1]. Chosen: a local search finds
the true hub only if it is near; a smaller value overlooks a distant hub, a larger one costs time."""
_HOPELESS = 0.3
"""Explained share, relative to the best candidate or to the required share, below which a candidate is not refined [1].
Chosen: refinement is the slowest step; a smaller value costs time, a larger one may omit the true hub."""
_HOPEFUL = 0.5
"""Fraction of the required share below which no candidate is refined [1]. Chosen: a smaller value costs time for films
that are refused, a larger one refuses films that a refinement would explain."""
_CLEAR = 0.6
"""Smallest explained share for which a candidate is refined immediately [1]. Chosen: with a smaller value, more
candidates are refined; with a larger one, all candidates are first refined cheaply."""
_FEW_FRAMES = 12
"""Number of frames of the cheap refinement of a candidate [frames]. Chosen: with fewer, noise decides; with more, the
refinement takes longer."""
_FEW_STEPS = 3
"""Number of iterations of the cheap refinement of a candidate [iterations]. Chosen: a smaller number stops early, a
larger one costs time."""
_PROMISING = 0.85
"""Fraction of the required share that the cheap refinement must reach [1]. Chosen: few frames are explained better than
many; a smaller value refines more candidates, a larger one may omit the true hub."""
_SCREEN_SIZE = 320
"""Smallest length of the longer side of a reduced frame [px]. Chosen: a larger value costs time, a smaller one loses
the marks of small bodies."""
_SCREEN_AREA = 1000
"""Smallest moving area in the reduced frames for which these frames are used for screening [px2]. Chosen: a smaller
value refuses small bodies, a larger one screens fewer films."""
_SCREENED = 0.75
"""Required share in reduced frames, divided by the required share in full frames [1]. Chosen: reduced frames lose
detail; a larger value refuses films that the full frames explain, a smaller one costs time."""
_STEPS = 6
"""Number of iterations of the refinement of a candidate [iterations]. Chosen: a smaller number stops early, a larger
one costs time."""
_FRAMES = 60
"""Number of frames for the refinement of a candidate [frames]. Chosen: a smaller number gives an uncertain hub, a
larger one costs time."""
_TILTED = 0.35
"""Smallest tilt of the axis that the result states [rad]. Chosen: cos 0.35 = 0.94; a smaller value reports noise, a
larger one hides a tilt."""
_ELSEWHERE = 0.2
"""A second body is searched for if the moving area outside the best ring, divided by the moving area within it, is at
least this value [1]. Chosen: a smaller value costs time on shadows, a larger one overlooks a second body."""
_COUPLED = 0.55
"""A second body may act on the first body if the moving area outside the best ring, divided by the moving area within
it, is at least this value [1]. Measured: up to 0.47 for real single bodies; 0.64 to 2.1 for drawn double pendulums with
one link tracked."""
_STRETCH_SPAN = 3.0
"""Smallest range of the angle for which the ellipse due to a tilted camera is fitted [rad]. Chosen: about half a turn;
with a smaller value the ellipse is undetermined, with a larger one the tilt is not corrected."""
_STATIC_SPAN = 1.0
"""Smallest range of the angle for which a fixed picture is always part of the model [rad]. Chosen: a smaller value
confuses the fixed picture with the body, a larger one leaves glare in the template."""
_CLEARLY_BETTER = 0.02
"""A fixed picture is part of the model at ranges below `_STATIC_SPAN` if it increases the explained share by at least
this value [1]. Chosen: a pendulum in front of a wall needs the fixed picture; a smaller value adds this picture due to
noise, a larger one omits it."""


class NothingMovesError(RefusedFilmError):
    """No part of the picture changes by more than noise."""


@dataclass(frozen=True)
class _Trial:
    """One interpretation of a film: a ring, a method of tracking, and the explained share of the change of brightness.

    `static`: the mean picture is subtracted for tracking. `separate`: a fixed picture is part of the model.
    """

    ring: Ring
    way: str
    band: str
    static: bool
    angle: Floats
    score: float
    separate: bool


@large_blocks_returned()
def track_body(
    film: Film, hub: tuple[float, float] | None = None, progress: Progress | None = None
) -> Tracked:
    """Track the rotating body in a film about `hub` [px], if known; a TrackingError unless exactly one body turns."""
    usable = frames_of_one_shot(film)
    chosen = usable[np.unique(np.linspace(0, len(usable) - 1, 120).astype(int))]
    sample = film.some(chosen)
    shake = camera_shake(sample, film.frames())
    if shake is not None:
        film.stabilise(shake)
        still, margin = film.some(chosen), shake.margin(sample[0].shape)
        # if the stabilised film shows no motion, or is not calmer, the body in front of a blank wall was mistaken for
        # the background
        with suppress(NothingMovesError):
            if calmer(sample, still, margin):
                return _with_shake(
                    _track_stabilised(film, usable, still, hub, progress, shake, margin), shake
                )
        film.stabilise(None)
    return _track(film, usable, sample, hub, progress)


def calmer(sample: Sequence[Plane], still: Sequence[Plane], margin: int) -> bool:
    """Return whether frames change less, in the mean, after the motion of the camera is compensated."""
    height, width = sample[0].shape
    inside = slice(margin, height - margin), slice(margin, width - margin)
    before, after = (
        sum(float(np.abs(b[inside].astype(np.float32) - a[inside]).sum()) for a, b in pairwise(some))
        for some in (sample, still)
    )
    return after < before


def _track_stabilised(
    film: Film,
    usable: Integers,
    sample: Sequence[Plane],
    hub: tuple[float, float] | None,
    progress: Progress | None,
    shake: Shake,
    margin: int,
) -> Tracked:
    """Track the body after the motion of the camera is compensated; without a body the error names the camera."""
    try:
        return _track(film, usable, sample, hub, progress, margin=margin)
    except RefusedFilmError as error:
        if error.kind != "no rotation" or hub is not None:
            raise
        raise RefusedFilmError(
            f"The camera moves in {film.path.name}, by {shake.rms:.2g} px rms and {1e3 * shake.roll.std():.2g} mrad "
            "rms, and no body that turns about a hub is found after this motion is compensated.",
            "Film with the camera on a stand, or give a point to follow with --point X,Y.",
            kind="moving camera",
            evidence={**error.evidence, "shake_px": shake.rms},
            frames=error.frames,
            hub=error.hub,
        ) from error


def read_excerpt(
    path: Path, hub: tuple[float, float] | None = None, progress: Progress | None = None
) -> tuple[Film, Tracked] | None:
    """Track a body by its texture through the first frames of a film, about `hub` [px]; None if no body is found."""
    film = Film(path, most=_EXCERPT)
    for track in (track_body, track_free_body):
        with suppress(TrackingError):
            return film, track(film, hub, progress)
    return None


def _with_shake(found: Tracked, shake: Shake) -> Tracked:
    """Add the uncertainty of the compensation: s / r for a displacement s at the radius r, and the roll's error."""
    share = math.hypot(shake.shift_sigma / (0.5 * (found.ring.inner + found.ring.outer)), shake.roll_sigma)
    text = (
        f"The camera moves by {shake.rms:.2g} px rms and {1e3 * shake.roll.std():.2g} mrad rms; {shake.features} "
        f"features of the background are used to compensate this motion. "
        f"The uncertainty of the compensation is {1e3 * share:.2g} mrad and is included."
    )
    # the text is first, because the last warning states why a result is doubtful
    return replace(found, sigma=np.hypot(found.sigma, share), warnings=(text, *found.warnings))


def _track(
    film: Film,
    usable: Integers,
    sample: Sequence[Plane],
    hub: tuple[float, float] | None,
    progress: Progress | None,
    margin: int = 0,
) -> Tracked:
    """Track the body in a film by a static camera; a margin [px] is excluded at every edge."""
    motion = Motion.of(sample, margin)
    moving = float(motion.moving.mean())
    if moving < 2e-4:
        largest = float(cv2.blur(motion.deviation, (3, 3)).max())
        raise NothingMovesError(
            f"Nothing moves in {film.path.name}: the brightness of {1e6 * moving:.0f} of a million pixels changes by "
            f"more than 4 standard deviations of the noise ({motion.noise:.1f} grey levels). The largest change is "
            f"{largest:.1f} grey levels.",
            "Check the film and the illumination; a body that turns by more than one turn during an exposure "
            "shows no motion.",
            kind="no motion",
            evidence={"moving": moving, "noise": motion.noise, "largest": largest},
            frames=(sample[0], sample[-1]),
        )
    first = min(len(usable) // 10, max(0, len(usable) - _TRIAL)) if len(usable) > 60 else 0
    if hub is not None and not all(math.isfinite(v) for v in hub):
        what = "The coordinates of the hub are not finite numbers."
        raise UsageError(what, "Give the hub as --hub X,Y in px.")
    pairs = cache(lambda: pairs_of(film, usable))
    seen_whole = hub is None and not margin
    if seen_whole:
        refuse_moving_camera(film, usable, pairs(), motion.mean.shape, MOSTLY_TRANSLATES)
    small = _Reduced.of(film, usable, sample, motion, margin)
    loose = None
    if small is None or may_be_loose(small.frames, small.motion):
        loose = track_by_features(film, usable, motion, progress)
    # a body without an axle, for example a suspended table, does not turn about a given point of the body
    if loose is not None and (hub is None or math.dist(hub, loose.ring.hub) < loose.ring.outer):
        return loose
    if seen_whole:
        refuse_moving_camera(film, usable, pairs(), motion.mean.shape)
    where, hint = "about a hub", _GIVE_HUB
    if hub is not None:
        where = f"about the hub ({hub[0]:g}, {hub[1]:g}) px"
        hint = "Check the hub. The body must show marks or texture; --point X,Y follows one of its points."
    if small is not None:
        there = None if hub is None else small.reduced(hub)
        screened = _candidates(small.frames[first : first + _TRIAL], small.motion, there, share=_SCREENED)
        if not screened.kept:
            shown = film.some(usable[first : first + _TRIAL][:: max(min(len(usable), _TRIAL) // 30, 1)])
            _refuse(film, pairs(), shown, motion, small.seen(screened.best), where, hint, screened.needed)
    block = film.some(usable[first : first + _TRIAL])
    candidates = _candidates(block, motion, hub)
    if not candidates.kept:
        _refuse(film, pairs(), block, motion, candidates.best, where, hint, candidates.needed)
    distinct = candidates.kept
    if hub is None:
        refuse_link(film.path.name, block, motion, distinct[0])
    refined = [_refined_trial(trial, block, motion.area, keep=hub is not None) for trial in distinct]
    best = max(refined, key=lambda t: t.score * _steadiness(t))
    outside = _off_picture(best.ring, motion, hub)
    needed = _OUTSIDE if outside else _EXPLAINED
    if best.score < needed:
        _refuse(film, pairs(), block, motion, best, where, hint, needed)
    _refuse_translation(film.path.name, block, motion, best)
    left, top, right, bottom = motion.area
    if outside and motion.moving[top:bottom, left:right].mean() > _WHOLE:
        what = (
            f"All of the picture moves in {film.path.name}: the camera moves, or the body fills the picture."
        )
        raise TrackingError(
            what, "If the body fills the picture, give its centre of rotation with --hub X,Y."
        )
    moved, allowed = 0.0, math.inf
    if hub is None:  # if a given hub is wrong, the displacement is the error of the hub
        moved, allowed = drift(best.ring, block, best.angle, motion.area, separate=best.separate)
        if moved > REFUSED * allowed:
            _refuse_loose(film.path.name, block, best, moved, allowed)
    if hub is None:
        refuse_link(film.path.name, block, motion, best)
    if hub is None and (other := _second_body(block, motion, best)) is not None:
        (x, y), (u, v) = best.ring.hub, other.ring.hub
        raise RefusedFilmError(
            f"Two bodies turn in {film.path.name}: one about ({x:.0f}, {y:.0f}) px, one about ({u:.0f}, {v:.0f}) px, "
            f"which explain {100 * best.score:.0f} % and {100 * other.score:.0f} % of the change of brightness there.",
            f"Give the centre of the body to track with --hub {x:.0f},{y:.0f} or --hub {u:.0f},{v:.0f}.",
            kind="two bodies",
            evidence={"explained": best.score, "other_explained": other.score},
            frames=tuple(block[k] for k in np.linspace(0, len(block) - 1, 4).astype(int)),
            hub=best.ring.hub,
        )
    tracked = _measure(film, usable, first, best, motion, progress)
    doubts = []
    if (share := elsewhere(motion.moving, best.ring)) > _ELSEWHERE:
        text = (
            f"Other parts of the picture move as well: {100 * share:.0f} % as many pixels as in the ring. If they "
            "belong to another body that acts on this one (a second link, a gear), a torque law of one body does not "
            "describe it."
        )
        if share > _COUPLED and hub is None:
            doubts.append(text)
        else:
            tracked = replace(tracked, warnings=(text, *tracked.warnings))
    second = second_rotation(
        block, motion, best.ring.hub, best.angle, stretch=best.ring.stretch, separate=best.separate
    )
    if second is not None:  # it is unclear which body is to be measured
        doubts.append(second.warning(best.angle))
    if hub is None and moved > allowed and not tracked.ambiguous:
        doubts.append(_loose_doubt(moved, allowed))
    if hub is None and (doubt := hub_doubt(best.score, tracked.explained)) is not None:
        doubts.append(doubt)
    whole = hub is None and tracked.ring.span >= TURN and tracked.correlated > float(np.median(tracked.sigma))
    if whole and (apart := halves_differ(tracked.angle, tracked.correlated)) is not None:
        doubts.append(
            "The inner and the outer half of the body do not turn in the same way: their difference causes an error of "
            f"{100 * apart:.2g} % of the standard deviation of the angle. Two bodies may move, or the hub may be "
            "wrong: look at the picture of the body (.png)."
        )
    other_hub = (
        rival_hub(
            [(t.ring.hub, t.ring.outer, t.angle, t.score * _steadiness(t)) for t in refined],
            refined.index(best),
        )
        if hub is None
        else _doubt_of_hub(distinct[refined.index(best)], best, block, motion)
    )
    doubts += [other_hub] if other_hub else []
    if not doubts:
        return tracked
    if tracked.ambiguous:  # the file keeps the last warning
        *others, last = tracked.warnings
        tracked, doubts = replace(tracked, warnings=tuple(others)), [last, *doubts]
    return replace(tracked, warnings=(*tracked.warnings, " ".join(doubts)), ambiguous=True)


@dataclass(frozen=True)
class _Candidates:
    """Candidates to be refined, the best of all candidates, and the share that the best one must explain."""

    kept: Sequence[_Trial]
    best: _Trial | None
    needed: float


def _candidates(
    block: StoredPictures, motion: Motion, hub: tuple[float, float] | None, share: float = 1.0
) -> _Candidates:
    """Propose hubs unless the hub is given, track about each, and keep the candidates that may explain enough.

    The refinement is the slowest step. Before the refinement, the explained share of a candidate must reach limits that
    are proportional to `share`.
    """
    proposals = propose_hubs(block, motion) if hub is None else [Proposal(hub, "given")]
    trials = [trial for p in proposals for trial in _trials(p, block, motion)]
    if max((t.score for t in trials), default=0.0) < _OUTSIDE and (seen := tilted_outline(motion, hub)):
        trials += _trials(seen, block, motion)
    if (
        max((t.score for t in trials), default=0.0) < _EXPLAINED
        and hub is None
        and (place := axes_meet(block, motion))
    ):
        trials += _trials(Proposal(place, "axes of a long body"), block, motion)
    trials.sort(key=lambda trial: -trial.score - 0.02 * trial.static)
    coarse = trials[0].score if trials else 0.0
    if coarse < share * _HOPEFUL * _EXPLAINED:
        return _Candidates((), trials[0] if trials else None, _EXPLAINED)
    distinct = _distinct(trials)
    if coarse >= _CLEAR:
        return _Candidates(distinct, trials[0], _EXPLAINED)
    # a cheap refinement shows whether any candidate can explain enough
    rough = [_quickly_refined(trial, block, motion.area, keep=hub is not None) for trial in distinct]
    needs = [_OUTSIDE if _off_picture(t.ring, motion, hub) else _EXPLAINED for t in rough]
    kept = [t for t, r, n in zip(distinct, rough, needs, strict=True) if r.score >= share * _PROMISING * n]
    k = max(range(len(rough)), key=lambda k: rough[k].score / needs[k])
    return _Candidates(kept, rough[k], needs[k])


@dataclass(frozen=True)
class _Reduced:
    """The reduced frames for screening a film: each pixel is the mean of a square of `factor` px."""

    factor: int
    frames: StoredPictures
    motion: Motion

    @classmethod
    def of(
        cls,
        film: Film,
        usable: Integers,
        sample: Sequence[Plane],
        motion: Motion,
        margin: int,
    ) -> _Reduced | None:
        """Reduce the frames of a film; None for a small picture or a small moving area."""
        factor = max(motion.mean.shape) // _SCREEN_SIZE
        if factor < 2 or np.count_nonzero(motion.moving) < _SCREEN_AREA * factor**2:
            return None
        few = [reduced(f, factor) for f in sample]
        small = StoredPictures.of(len(usable), (reduced(f, factor) for f in frames_of(film, usable)))
        return cls(factor, small, Motion.of(few, -(-margin // factor)))

    def reduced(self, place: tuple[float, float]) -> tuple[float, float]:
        """Return the position of a point (x, y) of the film in the reduced frames."""
        x, y = ((v + 0.5) / self.factor - 0.5 for v in place)
        return x, y

    def seen(self, trial: _Trial | None) -> _Trial | None:
        """Return a candidate with its ring in the full frames."""
        if trial is None:
            return None
        ring = trial.ring
        x, y = ((v + 0.5) * self.factor - 0.5 for v in ring.hub)
        inner, outer = self.factor * ring.inner, self.factor * ring.outer
        there = Ring.about(
            (x, y), inner, outer, finest=_COARSE, start=ring.start, span=ring.span, stretch=ring.stretch
        )
        return replace(trial, ring=there)


def _off_picture(ring: Ring, motion: Motion, given: tuple[float, float] | None) -> bool:
    """Return whether a hub that was found, or most of its ring, is outside the picture."""
    height, width = motion.mean.shape
    inside = 0 <= ring.hub[0] < width and 0 <= ring.hub[1] < height
    return given is None and not (inside and float(ring.inside(motion.area).mean()) > _SHOWN)


def _refuse(
    film: Film,
    pairs: Sequence[Pair],
    block: StoredPictures,
    motion: Motion,
    best: _Trial | None,
    where: str,
    hint: str,
    needed: float,
) -> NoReturn:
    """Raise a RefusedFilmError with the reason why no rotation explains a film."""
    some = tuple(block[k] for k in np.linspace(0, len(block) - 1, 4).astype(int))
    refuse_two_motions(film.path.name, pairs, some)
    if best is not None and best.ring.span >= TURN:
        refuse_blurred(film, block[:: max(len(block) // 30, 1)], best.ring, motion.noise)
    what = f"No body that turns {where} is found in {film.path.name}"
    if best is not None:
        what += (
            f": the best candidate explains {100 * max(best.score, 0):.0f} % of the change of brightness; "
            f"{100 * needed:.0f} % are required"
        )
    raise RefusedFilmError(
        f"{what}.",
        hint,
        kind="no rotation",
        evidence={"explained": 0.0 if best is None else best.score, "needed": needed},
        frames=some,
        hub=None if best is None else best.ring.hub,
    )


def _refuse_translation(name: str, block: StoredPictures, motion: Motion, best: _Trial) -> None:
    """Raise a RefusedFilmError if translation explains a block of frames better than the rotation of a candidate."""
    few = np.unique(np.linspace(0, len(block) - 1, _FRAMES).astype(int))
    if not translates(block.at(few), motion.moving, best.ring.hub, best.ring.outer, best.angle[few]):
        return
    raise RefusedFilmError(
        f"The body that moves in {name} does not turn: translation along its path explains its picture "
        f"better than rotation about ({best.ring.hub[0]:.0f}, {best.ring.hub[1]:.0f}) px.",
        "Follow one of its points with --point X,Y, about a pivot given with --hub X,Y.",
        kind="no rotation",
        evidence={"explained": best.score},
        frames=tuple(block[k] for k in np.linspace(0, len(block) - 1, 4).astype(int)),
        hub=best.ring.hub,
    )


def _loose_doubt(moved: float, allowed: float) -> str:
    return (
        f"The hub moves by {moved:.1f} px; the hub of a body on an axle moves by at most {allowed:.1f} px. The "
        "body may also translate, or several bodies may move: look at the picture of the body (.png)."
    )


def _refuse_loose(name: str, frames: Sequence[Plane], best: _Trial, moved: float, allowed: float) -> NoReturn:
    """Raise a RefusedFilmError for a body whose hub moves by more than `allowed` [px], so it is not on an axle."""
    raise RefusedFilmError(
        f"No body in {name} turns about a fixed axis: the hub of the best candidate, at "
        f"({best.ring.hub[0]:.0f}, {best.ring.hub[1]:.0f}) px, moves by {moved:.1f} px; at most {allowed:.1f} px "
        "are usual.",
        f"The body or the camera also translates, or several bodies move. {_GIVE_HUB}",
        kind="no rotation",
        evidence={"explained": best.score, "hub_moves_px": moved},
        frames=tuple(frames[k] for k in np.linspace(0, len(frames) - 1, 4).astype(int)),
        hub=best.ring.hub,
    )


def _refuse_fallen(film: Film, usable: Integers, best: _Trial, share: float) -> NoReturn:
    """Raise a RefusedFilmError for a rotation that explains only a small `share` of the whole film."""
    raise RefusedFilmError(
        f"No body in {film.path.name} turns about one fixed axis throughout: rotation about ({best.ring.hub[0]:.0f}, "
        f"{best.ring.hub[1]:.0f}) px explains {100 * best.score:.0f} % of the change of brightness in the frames in "
        f"which it was searched for, and {100 * max(share, 0):.0f} % in the whole film.",
        f"The hub may move, as on a cart: --from and --to select a part of the film. {_GIVE_HUB}",
        kind="no rotation",
        evidence={"explained": best.score, "in_film": share},
        frames=tuple(film.some(usable[np.linspace(0, len(usable) - 1, 4).astype(int)])),
        hub=best.ring.hub,
    )


def refuse_link(name: str, block: StoredPictures, motion: Motion, best: _Trial) -> None:
    """Raise a RefusedFilmError if a second link on the rim of a body moves outside its ring."""
    share = elsewhere(motion.moving, best.ring)
    use = np.unique(np.linspace(0, len(block) - 1, _FRAMES).astype(int))
    if share < _ELSEWHERE or not carries_a_link(best.ring, block.at(use), best.angle[use], motion.noise):
        return
    x, y = best.ring.hub
    raise RefusedFilmError(
        f"Two linked bodies turn in {name}: one about ({x:.0f}, {y:.0f}) px, and one that is joined to it, extends "
        f"beyond it and turns differently; outside the first one, {100 * share:.0f} % as many pixels change as inside.",
        FOLLOW_LINKS,
        kind="two links",
        evidence={"explained": best.score, "elsewhere": share},
        frames=tuple(block[k] for k in np.linspace(0, len(block) - 1, 4).astype(int)),
        hub=best.ring.hub,
    )


def rival_hub(found: Sequence[tuple[tuple[float, float], float, Floats, float]], chosen: int) -> str | None:
    """Return a warning with both hubs if rotation about another hub explains the film as well as the chosen one.

    `found` contains the hub [px], the outer radius of the ring [px], the angles [rad] and the explained share of each
    candidate. Another hub is reported if its unexplained share is at most `_AS_MUCH` times the unexplained share of the
    chosen hub, and if the ranges of the angles differ by more than `_OTHER_RANGE`.
    """
    (x, y), outer, angle, score = found[chosen]
    for k, ((u, v), _, other, share) in enumerate(found):
        apart = math.hypot(u - x, v - y) > _DISPLACED * outer
        ratio = float(np.ptp(other)) / max(float(np.ptp(angle)), 1e-12)
        if (
            k != chosen
            and apart
            and 1.0 - share < _AS_MUCH * (1.0 - score)
            and abs(ratio - 1.0) > _OTHER_RANGE
        ):
            return (
                f"Two hubs explain the film: ({x:.0f}, {y:.0f}) px, {100 * score:.0f} %, with angles over "
                f"{np.ptp(angle):.3g} rad in the frames compared, and ({u:.0f}, {v:.0f}) px, {100 * share:.0f} %, over "
                f"{np.ptp(other):.3g} rad. The first one is used; --hub X,Y selects another one."
            )
    return None


def _doubt_of_hub(trial: _Trial, given: _Trial, block: StoredPictures, motion: Motion) -> str | None:
    """Return a warning if rotation about another point near the given hub explains the film much better."""
    starts = [trial]
    if given.score < _GIVEN_IS_NEAR:  # the true hub may be too far for a local search
        near = [
            p
            for p in propose_hubs(block, motion)
            if math.dist(p.hub, given.ring.hub) < 0.5 * given.ring.outer
        ]
        others = [other for p in near for other in _trials(p, block, motion)]
        starts += sorted(others, key=lambda t: -t.score)[:1]
    free = max((_refined_trial(t, block, motion.area, keep=False) for t in starts), key=lambda t: t.score)
    away = math.dist(free.ring.hub, given.ring.hub)
    if away < _DISPLACED * given.ring.outer or 1.0 - free.score > 0.5 * (1.0 - given.score):
        return None
    x, y = free.ring.hub
    return (
        f"Rotation about ({x:.0f}, {y:.0f}) px, {away:.0f} px from the given hub, explains {100 * free.score:.0f} % of "
        f"the change of brightness instead of {100 * given.score:.0f} %: the angles may be wrong. Correct --hub X,Y."
    )


def _second_body(block: StoredPictures, motion: Motion, best: _Trial) -> _Trial | None:
    """Return a second body outside the best ring whose picture a rotation explains; None without such a body."""
    if elsewhere(motion.moving, best.ring) < _ELSEWHERE:
        return None
    rest = replace(motion, moving=_outside(motion.moving, best.ring))
    trials = [trial for p in propose_hubs(block, rest) for trial in _trials(p, block, rest)]
    needed = max(_EXPLAINED, _AS_GOOD * best.score)
    start = max(trials, key=lambda t: t.score, default=None)
    if start is None or start.score < _HOPELESS * needed:
        return None
    found = _refined_trial(start, block, motion.area, keep=False)
    apart = math.dist(found.ring.hub, best.ring.hub)
    clear = apart > best.ring.outer and apart > found.ring.outer
    return found if clear and found.score > needed else None


def _outside(moving: Bools, ring: Ring) -> Bools:
    return np.asarray(moving & (distance_from(ring.hub, moving.shape) > 1.1 * ring.outer))


def elsewhere(moving: Bools, ring: Ring) -> float:
    """Return the ratio of the numbers of changing pixels outside and inside a ring."""
    outside = int(np.count_nonzero(_outside(moving, ring)))
    return outside / max(int(np.count_nonzero(moving)) - outside, 1)


def _trials(proposal: Proposal, block: Sequence[Plane], motion: Motion) -> list[_Trial]:
    ring = ring_for(proposal.hub, motion, _COARSE, proposal.stretch)
    if ring is None:
        return []
    polars = [ring.unwrap(frame) for frame in block]
    allowed = ring.inside(motion.area)
    mean = np.mean(polars, axis=0)
    moving = np.std(polars, axis=0) > 4 * motion.noise
    area = ring.area.astype(np.float32) * allowed
    found = []
    for static, bands in ((True, ("low", "middle", "high")), (False, ("low", "high"))):
        weight = area if static else area * moving
        for band in bands:
            rough = follow(
                polars, weight.astype(np.float32), mean if static else np.zeros_like(mean), ring, band=band
            )
            if np.ptp(rough) < 2e-3:
                continue
            separate = bool(np.ptp(rough) > _STATIC_SPAN)
            score, _ = _score(polars, rough, allowed, ring, separate=separate)
            if not separate:
                other, _ = _score(polars, rough, allowed, ring, separate=True)
                separate = other > score + _CLEARLY_BETTER
                score = other if separate else score
            found.append(_Trial(ring, proposal.way, band, static, rough, score, separate))
    return found


def _score(
    polars: Sequence[Picture], angle: Floats, allowed: Bools, ring: Ring, *, separate: bool
) -> tuple[float, Floats]:
    use = slice(None, None, every(len(polars)))
    template = learn(polars[use], angle[use], allowed, ring, separate=separate, plain=True)
    return explained(polars, angle, template)


def _distinct(trials: Sequence[_Trial]) -> list[_Trial]:
    """Return the best candidates whose motions differ, at most three."""
    kept: list[_Trial] = []
    for trial in trials:
        if trial.score > _HOPELESS * trials[0].score and all(
            np.std(trial.angle - other.angle) > 0.1 * np.std(other.angle) for other in kept
        ):
            kept.append(trial)
        if len(kept) == 3:
            break
    return kept


_LEAST_BEND = 3.0
"""Smallest change of the step from frame to frame that is a jump [columns]. Chosen: a smaller value takes noise of slow
bodies for jumps, a larger one hides jumps."""


def _steadiness(trial: _Trial) -> float:
    """Return the share of the frames without a jump.

    A jump is a change of the step from frame to frame by more than the typical step. For a body with equal parts, for
    example spokes with a static shadow, angles that repeatedly jump back by one part explain the film at least as well
    as the true angles.
    """
    step = np.diff(trial.angle)
    limit = max(float(np.median(np.abs(step))), _LEAST_BEND * trial.ring.step)
    return float((np.abs(np.diff(step)) <= limit).mean()) if len(step) > 1 else 1.0


def _refined_trial(trial: _Trial, block: StoredPictures, area: Area, *, keep: bool) -> _Trial:
    """Refine radii, hub and angles of a candidate on its block of frames."""
    ring, angle = trial.ring, trial.angle
    polars = [ring.unwrap(frame) for frame in block]
    _, rows = _score(polars, angle, ring.inside(area), ring, separate=trial.separate)
    ring = ring.trimmed(rows, finest=_COARSE)
    use = np.unique(np.linspace(0, len(block) - 1, _FRAMES).astype(int))
    found = _search(ring, angle[use], block.at(use), area, separate=trial.separate, keep=keep, steps=_STEPS)
    ring, angles, _ = found
    polars = [ring.unwrap(frame) for frame in block]
    allowed = ring.inside(area)
    template = learn([polars[i] for i in use], angles, allowed, ring, separate=trial.separate, plain=True)
    offset = float(np.median(angles - angle[use]))
    angle = np.array([register(p, template, a + offset).angle for p, a in zip(polars, angle, strict=True)])
    score, _ = _score(polars, angle, allowed, ring, separate=trial.separate)
    return replace(trial, ring=ring, angle=angle, score=score)


def _quickly_refined(trial: _Trial, block: StoredPictures, area: Area, *, keep: bool) -> _Trial:
    """Refine a candidate on few frames and in few steps; its angles are not changed."""
    use = np.unique(np.linspace(0, len(block) - 1, _FEW_FRAMES).astype(int))
    ring, _, score = _search(
        trial.ring,
        trial.angle[use],
        block.at(use),
        area,
        separate=trial.separate,
        keep=keep,
        steps=_FEW_STEPS,
    )
    return replace(trial, ring=ring, score=score)


def _search(
    ring: Ring, angle: Floats, few: StoredPictures, area: Area, *, separate: bool, keep: bool, steps: int
) -> tuple[Ring, Floats, float]:
    """Refine hub and stretch of a ring on few frames; return ring, angles, and explained share."""

    def tried(place: Floats, angle: Floats) -> tuple[float, Floats]:
        there = _placed(ring, place)
        allowed = there.inside(area)
        if allowed.mean() < 0.7 * ring.inside(area).mean():  # the ring leaves the picture
            return -math.inf, angle
        polars = [there.unwrap(frame) for frame in few]
        for _ in range(2):
            template = learn(polars, angle, allowed, there, separate=separate, plain=True)
            angle = np.array([register(p, template, a).angle for p, a in zip(polars, angle, strict=True)])
        template = learn(polars, angle, allowed, there, separate=separate, plain=True)
        usable = (allowed * there.area).astype(np.float32)
        mean = np.mean(polars, axis=0)
        rest = sum(
            float(np.sum(usable * (p - template.fixed - rolled(template.body, a / there.step)) ** 2))
            for p, a in zip(polars, angle, strict=True)
        )
        total = sum(float(np.sum(usable * (p - mean) ** 2)) for p in polars)
        return 1.0 - rest / max(total, 1e-9), angle

    place: Floats = np.array([*ring.hub, *ring.stretch])
    angles: Floats
    best, angles = tried(place, angle)
    free = _free(ring, angle, given=keep)
    for _ in range(steps if free else 0):
        change: Floats = np.zeros(4)
        change[free] = ring_step(_placed(ring, place), few, angles, free, area, separate=separate)
        factor, before, start = 1.0, best, place
        while True:  # lengthen the step while this improves the fit: the template adapts to the new hub
            value, there = tried(start + factor * change, angles)
            if value > best:
                best, place, angles, factor = value, start + factor * change, there, 1.7 * factor
            elif best > before or factor < 0.2:
                break
            else:
                factor *= 0.3
        if best - before < 1e-4:
            break
    return _placed(ring, place), angles, best


def _free(ring: Ring, angle: Floats, *, given: bool) -> list[int]:
    """Return which of hub (0, 1) and stretch (2, 3) of a ring are fitted."""
    stretch = ring.span >= TURN and np.ptp(angle) > _STRETCH_SPAN
    return ([] if given else [0, 1]) + ([2, 3] if stretch else [])


def ring_step(
    ring: Ring, frames: Sequence[Plane], angles: Floats, free: Sequence[int], area: Area, *, separate: bool
) -> Floats:
    """Return the Gauss-Newton step in hub and stretch (x, y, p, q), with template and angles projected out."""
    allowed = ring.inside(area)
    polars = StoredPictures.of(len(frames), map(ring.unwrap, frames))
    template = learn(polars, angles, allowed, ring, separate=separate, plain=True)
    cos, sin = np.cos(ring.angle), np.sin(ring.angle)
    x, y = ring.radius[:, None] * cos, ring.radius[:, None] * sin
    kernel = (ring.outer - ring.inner) / ring.rows
    turns = [int(np.rint(a / ring.step)) for a in angles]
    stored = new_columns(
        len(frames), {"slopes": ((len(free), *allowed.shape), "f4"), "rests": (allowed.shape, "f4")}
    )
    slopes, rests = stored["slopes"], stored["rests"]
    mean = np.zeros(slopes.shape[1:], dtype=np.float32)
    for t, (polar, angle, turn) in enumerate(zip(polars, angles, turns, strict=True)):
        model = rolled(template.body, angle / ring.step)
        radial = np.gradient(model, kernel, axis=0)
        across = np.gradient(model, axis=1) / (ring.radius[:, None] * ring.step)
        by_x, by_y = radial * cos - across * sin, radial * sin + across * cos
        every = (by_x, by_y, x * by_x - y * by_y, y * by_x + x * by_y)
        for n, k in enumerate(free):
            slopes[t, n] = np.roll(every[k], -turn, axis=1)
        rests[t] = np.roll(polar - template.fixed - model, -turn, axis=1)
        mean += slopes[t] / np.float32(len(frames))
        release_pages()
    root = np.sqrt(ring.area / template.body_variance).astype(np.float32)
    along = np.gradient(template.body, axis=1) * root
    energy = max(float(np.sum(along**2)), 1e-9)
    left, right = np.zeros((len(free), len(free))), np.zeros(len(free))
    for t, turn in enumerate(turns):
        usable = np.roll(allowed, -turn, axis=1)
        basis = ((slopes[t] - mean) * root * usable).reshape(len(free), -1)
        rest = (rests[t] * root * usable).ravel()
        basis = basis - np.outer(basis @ along.ravel(), along.ravel()) / energy
        left += basis @ basis.T
        right += basis @ rest
        release_pages()
    scale = np.sqrt(np.diag(left)) + 1e-12
    solved = np.linalg.solve(left / np.outer(scale, scale) + 1e-4 * np.eye(len(free)), right / scale) / scale
    limit = np.array([0.05 * ring.outer, 0.05 * ring.outer, 0.05, 0.05])[list(free)]
    return np.asarray(-solved * min(1.0, float(np.min(limit / np.maximum(np.abs(solved), 1e-12)))))


def _placed(ring: Ring, place: Floats) -> Ring:
    """Return a ring with another hub (x, y) and stretch (p, q)."""
    x, y, p, q = (float(v) for v in place)
    return replace(ring, hub=(x, y), stretch=(p, q))


def _measure(
    film: Film,
    usable: Integers,
    first: int,
    best: _Trial,
    motion: Motion,
    progress: Progress | None,
) -> Tracked:
    """Track the body through the whole film, estimate its template, and register every frame."""
    coarse = best.ring
    area = motion.area
    allowed = coarse.inside(area)
    polars = StoredPictures.of(len(usable), map(coarse.unwrap, frames_of(film, usable)))
    use = np.unique(np.linspace(0, len(polars) - 1, 120).astype(int))
    mean = np.mean([polars[i] for i in use], axis=0)
    moving = np.std([polars[i] for i in use], axis=0) > 4 * motion.noise
    ways = [(best.static, best.band)]
    ways += [(s, b) for s in (True, False) for b in ("high", "middle", "low") if (s, b) != ways[0]]
    angle, share = np.zeros(len(polars)), -math.inf
    for static, band in ways:
        weight = (coarse.area * allowed * (1.0 if static else moving)).astype(np.float32)
        fixed = mean if static else np.zeros_like(mean)
        found = np.zeros(len(polars))
        found[first:] = follow(polars[first:], weight, fixed, coarse, band=band)
        if first:
            found[first::-1] = follow(polars[first::-1], weight, fixed, coarse, band=band)
        score, _ = _score(polars, found, allowed, coarse, separate=best.separate)
        if score > share:
            angle, share = found, score
        if share > 0.85 * best.score:
            break
    angle = _settle(polars, angle, allowed, coarse, separate=best.separate)
    few = use[:: max(1, len(use) // 100)]
    template = learn(
        [polars[i] for i in few], angle[few], allowed, coarse, separate=best.separate, plain=True
    )

    def share_of(counter_clockwise: Floats) -> float:
        return _score(polars, -counter_clockwise, allowed, coarse, separate=best.separate)[0]

    alias = unaliased(-angle, usable, template, share_of)
    angle = without_slips(polars, -alias.angle, usable, template)
    share = share_of(-angle)
    if share < _EXPLAINED:
        raise TrackingError(
            f"The body in {film.path.name} is tracked through a part of the film only: tracking quality "
            f"{100 * max(share, 0):.0f} %; {100 * _EXPLAINED:.0f} % are required.",
            "Cut the film to the motion"
            + (". Check --hub X,Y." if best.way == "given" else f". {_GIVE_HUB}"),
        )
    if best.way != "given" and fallen(best.score, share):
        _refuse_fallen(film, usable, best, share)
    best = replace(best, score=share)
    ring = replace(
        Ring.about(
            coarse.hub, coarse.inner, coarse.outer, finest=_FINE, start=coarse.start, span=coarse.span
        ),
        stretch=coarse.stretch,
    )
    allowed = ring.inside(area)
    chosen = np.unique(np.linspace(0, len(usable) - 1, _LEARNT).astype(int))
    pictures = film.some(usable[chosen])
    separate = best.separate
    free = _free(ring, angle, given=best.way == "given")
    for _ in range(2):
        shown = StoredPictures.of(len(pictures), map(ring.unwrap, pictures))
        template = learn(shown, angle[chosen], allowed, ring, separate=separate, plain=True)
        poses = [register(p, template, a) for p, a in zip(shown, angle[chosen], strict=True)]
        angle[chosen] = [p.angle for p in poses]
        few = np.unique(np.linspace(0, len(chosen) - 1, 60).astype(int))
        if free:
            place = np.array([*ring.hub, *ring.stretch])
            place[free] += ring_step(
                ring, pictures.at(few), angle[chosen][few], free, area, separate=separate
            )
            ring = _placed(ring, place)
    distance = 0.0
    if best.way != "given" and ring.span < TURN:
        some = np.unique(np.linspace(0, len(chosen) - 1, _HUB_FRAMES).astype(int))
        before = angle[chosen[some]]
        ring, after, distance = _at_distance_of_path(ring, pictures.at(some), before, area, separate=separate)
        if not math.isfinite(distance):
            raise TrackingError(
                f"The body in {film.path.name} moves along a straight line, so it does not turn about a hub.",
                _GIVE_HUB,
            )
        angle = np.asarray(np.polyval(np.polyfit(before, after, 1), angle), dtype=np.float64)
        allowed = ring.inside(area)
    doubts = [] if alias.warning is None else [alias.warning]
    whole = replace(best, ring=ring, angle=angle[chosen])
    _refuse_translation(film.path.name, pictures, motion, whole)
    if (
        best.way != "given"
    ):  # a hub that is fixed in the frames of the search may move in other parts of the film
        moved, limit = drift(ring, pictures, angle[chosen], area, separate=separate)
        if moved > REFUSED * limit:
            _refuse_loose(film.path.name, pictures, whole, moved, limit)
        if moved > limit:
            doubts.append(_loose_doubt(moved, limit))
    shown = StoredPictures.of(len(pictures), map(ring.unwrap, pictures))
    template = learn(shown, angle[chosen], allowed, ring, separate=separate, plain=True)
    poses = [register(p, template, a) for p, a in zip(shown, angle[chosen], strict=True)]
    angle[chosen] = [p.angle for p in poses]
    good = _good(poses)
    template = learn(shown, angle[chosen], allowed, ring, separate=separate, counted=good)
    hub_sigma = _hub_motion(shown, angle[chosen], template) if best.way != "given" else 0.0
    template = replace(template, hub_sigma=hub_sigma)
    poses = []
    parts = template.halves()
    halves = np.empty((2, len(usable)))
    live = FrameAngles("single")
    for k, frame in enumerate(frames_of(film, usable)):
        polar = ring.unwrap(frame)
        poses.append(register(polar, template, angle[k]))
        halves[:, k] = [-register(polar, part, poses[-1].angle).angle for part in parts]
        live.add(int(usable[k]), -poses[-1].angle)
        if progress is not None:
            progress(k + 1, len(usable))
    tracked = _finish(film, usable, ring, template, parts, poses, halves, best, angle, distance)
    if not doubts:
        return tracked
    return replace(tracked, warnings=(*tracked.warnings, " ".join(doubts)), ambiguous=True)


def _settle(polars: StoredPictures, angle: Floats, allowed: Bools, ring: Ring, *, separate: bool) -> Floats:
    """Refine the angles of all frames on the coarse ring."""
    for _ in range(2):
        use = np.unique(np.linspace(0, len(polars) - 1, _LEARNT).astype(int))
        template = learn(polars.at(use), angle[use], allowed, ring, separate=separate, plain=True)
        angle = np.array([register(p, template, a).angle for p, a in zip(polars, angle, strict=True)])
    return angle


def _good(poses: Sequence[Pose]) -> Floats:
    misfit = np.array([p.misfit for p in poses])
    return np.asarray(misfit < 3 * np.median(misfit), dtype=np.float64)


def _hub_motion(polars: StoredPictures, angle: Floats, template: Template) -> float:
    """Return the standard deviation of the displacement of the hub [px]; 0 if it is not significant."""
    use = np.unique(np.linspace(0, len(polars) - 1, _HUB_FRAMES).astype(int))
    polars, angle = polars.at(use), angle[use]
    fixed = [register(p, template, a) for p, a in zip(polars, angle, strict=True)]
    moved = [register(p, template, a, move=True) for p, a in zip(polars, angle, strict=True)]
    gain = np.median([m.misfit for m in moved]) / max(float(np.median([f.misfit for f in fixed])), 1e-12)
    noise = float(np.median([p.shift_sigma for p in moved]))
    size = float(np.median(np.abs(np.array([p.shift for p in moved])))) * 1.4826
    return size if gain < 0.8 and size > 3 * noise else 0.0


@dataclass(frozen=True)
class _BodyPath:
    """The path of a body far from its hub, from displacements that are fitted frame by frame.

    Let the true hub be displaced from the assumed hub by -b towards the middle of the path, and by c across this
    direction. The distance of the body from the assumed hub is then r + b (1 - cos theta) + c sin theta, apart from a
    constant.
    """

    middle: float  # direction from the hub to the middle of the path [rad]
    radius: float  # r: distance of the body from the hub [px]
    theta: Floats  # (n,) angle of the position about the hub, 0 in the middle [rad]
    bend: float  # b [px]
    # standard uncertainty of b; it includes correlated residuals and position-dependent errors [px]
    bend_sigma: float
    across: float  # c [px]

    @classmethod
    def of(cls, pictures: Sequence[Plane], angle: Floats, template: Template) -> _BodyPath:
        ring, known = template.ring, template.information()
        poses = []
        for picture, start in zip(pictures, angle, strict=True):
            about, shift = displaced(picture, template, float(start), _PATH_SETTLED)
            poses.append((about, *shift))
        turn, x, y = np.array(poses).T
        power = (known[:, None] * np.gradient(template.body, axis=1) ** 2).sum(axis=0)
        towards = float(np.angle(np.sum(power * np.exp(1j * ring.angle))))
        radius = float(np.average(ring.radius, weights=known))
        away = radius * np.exp(1j * (towards + turn)) + x + 1j * y
        theta = np.angle(away * np.exp(-1j * towards))
        middle = 0.5 * float(theta.min() + theta.max())
        theta = theta - middle
        rows = np.stack([1.0 - np.cos(theta), np.sin(theta), np.ones_like(theta)], axis=1)
        found, *_ = np.linalg.lstsq(rows, np.abs(away), rcond=None)
        rest = np.abs(away) - rows @ found
        # the residuals are correlated if the camera is unsteady
        error = math.sqrt(float(np.linalg.pinv(rows.T @ rows)[0, 0]) * correlated_variance(rest))
        error = math.hypot(error, _PATH_ERROR / max(float(rows[:, 0].max()), 1e-9))
        return cls(towards + middle, radius, theta, float(found[0]), error, float(found[1]))


def _at_distance_of_path(
    ring: Ring, pictures: Sequence[Plane], angle: Floats, area: Area, *, separate: bool
) -> tuple[Ring, Floats, float]:
    """Return ring and angles with the hub at the distance given by the curvature of the path, and the distance's error.

    The displacements of a body far from its hub are precise. Its rotation, from which the distance is first estimated,
    is not precise; moreover, the ball of a pendulum need not turn with its thread. The hub is moved if its distance
    differs by more than three standard uncertainties from the distance given by the path. The error returned is the
    standard uncertainty divided by the distance; for a straight path it is infinite.
    """
    plain, moved = True, False
    for _ in range(_PATH_ROUNDS):
        shown = StoredPictures.of(len(pictures), map(ring.unwrap, pictures))
        # First, all samples have equal variances. The individual variances would give a small weight to samples that a
        # wrong hub blurs, and these samples show the error of the hub.
        template = learn(shown, angle, ring.inside(area), ring, separate=separate, plain=plain)
        path = _BodyPath.of(pictures, angle, template)
        wrong, sigma = path.bend / path.radius, path.bend_sigma / path.radius
        if abs(wrong) < 3.0 * sigma:
            if not (moved and plain):
                break
            plain = False
            continue
        radius = path.radius / max(1.0 - wrong, 1e-9)
        if radius > FARTHEST * max(pictures[0].shape):
            return ring, angle, math.inf
        move = (path.radius - radius + 1j * path.across) * np.exp(1j * path.middle)
        scale = path.radius / radius
        ring = Ring.about(
            (float(ring.hub[0] + move.real), float(ring.hub[1] + move.imag)),
            ring.inner + radius - path.radius,
            ring.outer + radius - path.radius,
            finest=_FINE,
            start=path.middle + (ring.start - path.middle) * scale,
            span=ring.span * scale,
        )
        angle, moved = path.theta * scale, True
    return ring, angle, sigma if moved else 0.0


def _finish(
    film: Film,
    usable: Integers,
    ring: Ring,
    template: Template,
    parts: tuple[Template, Template],
    poses: Sequence[Pose],
    halves: Floats,
    best: _Trial,
    rough: Floats,
    distance: float,
) -> Tracked:
    angle = -np.array([p.angle for p in poses])
    formal = np.array([p.formal for p in poses])
    misfit = np.array([p.misfit for p in poses])
    usual = float(np.median(misfit))
    kept = (misfit < 6 * usual) & (np.abs(angle + rough) < 4 * ring.step + 0.1)
    scatter = white_noise(angle[kept], usable[kept])
    inflated = formal * np.sqrt(np.maximum(misfit / usual, 1.0))
    scale = max(scatter / float(np.median(inflated[kept])), 1.0)  # not below the Cramer-Rao bound
    warnings = list(film.warnings)
    if (tilt := ring.tilt) is not None and tilt[0] > _TILTED:
        warnings.append(
            f"The axis of rotation is tilted by {math.degrees(tilt[0]):.0f} degrees relative to the line of sight (the "
            f"orbits are ellipses with an axis ratio of {math.cos(tilt[0]):.2f} and the short axis at "
            f"{math.degrees(tilt[1]):.0f} degrees): the angles are measured in the plane of the body. The film "
            "does not show which side of the body is nearer; the sense of rotation is stated as seen."
        )
    repeated = int(film.selected.sum()) - len(usable)
    if repeated:
        warnings.append(
            f"{repeated} of {film.selected.sum()} frames repeat the previous frame and are omitted."
        )
    lost = int((~kept).sum())
    if lost:
        warnings.append(
            f"The body does not match its template in {lost} of {len(kept)} frames, which are omitted."
        )
    steps = np.abs(np.diff(angle[kept]))
    if np.sum(steps) ** 2 < _FEWEST_STEPS * np.sum(steps**2):
        raise TrackingError(
            f"The picture of the body in {film.path.name} changes between a few frames only, so it is not rotating.",
            "Check that it is the right film"
            + (", and --hub X,Y." if best.way == "given" else f". {_GIVE_HUB}"),
        )
    correlated = hub_error(angle[kept], halves[:, kept], parts)
    typical = float(np.median(scale * inflated[kept]))
    motion = float(np.std(angle[kept]))
    if best.way != "given" and correlated > _UNDETERMINED * motion:
        raise TrackingError(
            f"The centre of rotation of the body in {film.path.name} is not determined: with the best candidate, the "
            f"angles have an error of {100 * correlated / motion:.0f} % of the motion.",
            _GIVE_HUB,
        )
    if distance * motion > correlated:
        correlated = distance * motion
        warnings.append(
            f"The path of the body gives the distance of the hub within {100 * distance:.2g} %; the uncertainty "
            f"contains {1e3 * correlated:.2g} mrad for this."
        )
    elif (apart := apart_beyond_harmonics(angle[kept], halves[:, kept], usable[kept], typical)) is not None:
        correlated = max(correlated, apart)
        warnings.append(
            "The inner and the outer half of the body do not turn in the same way: beyond harmonics of the angle, they "
            f"differ by {2e3 * apart:.2g} mrad rms. Two bodies may turn. The uncertainty contains "
            f"{1e3 * apart:.2g} mrad for this."
        )
    elif correlated > typical:
        warnings.append(
            f"The angles from the inner and the outer half of the ring differ as if the hub were displaced; "
            f"the uncertainty contains {1e3 * correlated:.2g} mrad for this."
        )
    return Tracked(
        frame=usable[kept],
        angle=angle[kept],
        sigma=np.hypot(scale * inflated[kept], correlated),
        ring=ring,
        template=replace(template, _phases=[], _shifts=[]),  # without cached results of registration
        hub_path=np.array([p.shift for p in poses])[kept],
        explained=best.score,
        way=best.way,
        scale=scale,
        halves=halves[:, kept],
        correlated=correlated,
        warnings=tuple(warnings),
        distance_error=distance,
    )
