"""Why a film cannot be tracked: it is cut, the camera moves, nothing moves, two bodies turn, or the body is blurred.

A few pairs of near frames are examined. The motion between two frames is measured by features (B. Lucas, T. Kanade,
IJCAI 1981). Rigid motions of the picture are fitted to the features one after the other (random sample consensus).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from gyrotrack._arrays import Bools, Complexes, Integers, Plane, Singles
from gyrotrack._errors import TrackingError
from gyrotrack.tracking._camera_motion import features_of, tracked
from gyrotrack.tracking._film import FEWEST_FRAMES, Film, fresh_frames
from gyrotrack.tracking._links import share_a_joint
from gyrotrack.tracking._registration import Ring

_PAIRS = 16
"""Number of pairs of frames that are compared [1]. Chosen: with fewer, chance decides; with more, the comparison takes
longer."""
_LAGS = (1, 2, 4, 8)
"""Lags between the frames of a pair [frames]. Chosen: the first lag at which the features move measurably is used;
longer lags lose features of fast bodies."""
_STEP = 1.0
"""Smallest displacement of a feature in motion [px]. Chosen: a smaller value includes noise, a larger one needs
longer lags."""
_AT_REST = 0.3
"""Largest displacement of a feature at rest [px]. Measured: up to 0.1 px in noisy films."""
_FEWEST = 12
"""Smallest number of features of a pair, and of one motion [features]. Chosen: with fewer, features agree by chance;
with more, bodies without texture are not diagnosed."""
_NEAR = 0.8
"""Largest distance of a feature from its rigid motion [px]. Chosen: a smaller value rejects blurred features, a larger
one joins two motions."""
_MOST = 0.75
"""Smallest share of the pairs that agree [1]. Chosen: a smaller value refuses films because of single pairs, a larger
one overlooks a motion in part of the film."""
_WITH_CAMERA = 0.7
"""Smallest share of all features that move with the camera [1]. Chosen: a smaller value takes a large body for the
camera, a larger one overlooks parallax."""
_WHOLE = 0.4
"""Smallest area enclosed by the features that move with the camera, divided by the area of the picture [1]. Chosen: a
smaller value takes a large body for the camera, a larger one overlooks a camera before blank walls."""
_NO_HUB = 0.3
"""A picture does not turn about a hub if the rms residual of a rotation about one hub, divided by the rms displacement,
is at least this value [1]. Chosen: a smaller value refuses a disc that fills the picture, a larger one accepts a camera
held by hand."""
MOSTLY_TRANSLATES = 0.7
"""Limit that replaces `_NO_HUB` if the hub moves less than the rim, like the hub of a suspended body [1]. Measured:
0.40 for a real trifilar table that fills 40 % of the picture, 0.94 to 0.97 for drawn and real cameras held by hand."""
_SECOND = 0.25
"""There is a second body if at least this share of the moving features are outliers of the first motion [1]. Chosen: a
smaller value finds a second body in outliers, a larger one overlooks a small second body."""
_EXPLAINED = 0.5
"""Smallest share of the outliers of the first motion that are inliers of the second motion [1]. Chosen: a smaller value
finds a second body in outliers, a larger one overlooks a blurred second body."""
_OTHER_TURN = 0.3
"""Smallest relative difference of the rotations of two bodies [1]. Chosen: a smaller value takes a deformed picture for
two bodies, a larger one overlooks links of similar speed."""
_LEAST_TURN = 2e-3
"""Smallest rotation of each of two bodies [rad]. Chosen: a smaller value takes translation for rotation, a larger one
overlooks slow bodies."""
_LINKED = 0.25
"""The hub of a body moves if the scatter of the fixed point from pair to pair, divided by the largest distance of the
features of the body from its hub, is at least this value [1]. Chosen: a smaller value takes noise for a link, a larger
one overlooks links."""
_COAXIAL = 0.15
"""Smallest distance of two separate fixed points, divided by the largest distance of the features of a body from its
hub [1]. Chosen: a smaller value refuses rotor and casing as two hubs, a larger one joins neighbouring bodies."""
_CUT = 2.5
"""Smallest change of a frame at a cut, divided by the largest other change near the cut [1]. Chosen: a smaller value
finds a cut in a flash, a larger one overlooks a cut."""
_CUT_REACH = 12
"""Distance from a cut within which other changes are compared with it [frames]. Chosen: a smaller value compares few
changes, a larger one includes other cuts."""
_CUT_LEAST = 6.0
"""Smallest change of a frame at a cut [grey levels]. Chosen: a smaller value finds cuts in noise, a larger one
overlooks cuts between similar shots."""
_REMAINS = 0.5
"""Smallest difference of the mean pictures before and after a cut, relative to the change of the frame at the cut [1].
Chosen: a fast body changes every frame, but not the mean of several frames; a larger value overlooks cuts."""
_SHOT = 12
"""Length of the shortest shot [frames]. Chosen: a smaller value averages too few frames, a larger one overlooks short
titles."""
_SMEARED = 0.12
"""A picture is sharp if the detail along the circles of a ring, divided by the detail across the circles, is at least
this value (see `detail`) [1]. Chosen: only the stated cause of a refusal depends on it; a smaller value overlooks blur,
a larger one calls discs with rings blurred."""
FOLLOW_LINKS = (
    "Follow the joint and a point of the second link; give their positions in the first frame, in this order: "
    "`gyrotrack extract --links --points X,Y --points X,Y`; --hub X,Y gives the pivot."
)
_FAINT = 3.0
"""Smallest change (rms) of the picture in a ring with detail, in standard deviations of the noise [1]. Chosen: only the
stated cause of a refusal depends on it; a smaller value overlooks faint marks, a larger one wrongly states them as the
cause."""


class RefusedFilmError(TrackingError):
    """A film that cannot be tracked, and the kind of its problem.

    `kind` is "cut", "moving camera", "no motion", "two bodies", "two links", "blurred" or "no rotation". `evidence`
    contains the numbers and `frames` the pictures that show the problem; `hub` is the best candidate (x, y) [px].
    """

    def __init__(
        self,
        message: str,
        hint: str,
        *,
        kind: str,
        evidence: dict[str, float],
        frames: Sequence[Plane] = (),
        hub: tuple[float, float] | None = None,
    ) -> None:
        super().__init__(message, hint)
        self.kind, self.evidence, self.frames, self.hub = kind, evidence, tuple(frames), hub

    def add_hint(self, text: str) -> None:
        """Append a sentence to the hint."""
        self.hint = f"{self.hint} {text}".lstrip()
        self.args = (f"{self.message} {self.hint}",)


@dataclass(frozen=True)
class RigidMotion:
    """The motion z -> a z + b of some features between two frames; |a| is 1."""

    a: complex
    b: complex
    members: Bools  # mask of the features of the pair with this motion

    @property
    def turn(self) -> float:
        """Angle of the rotation, clockwise in the picture [rad]."""
        return math.atan2(self.a.imag, self.a.real)


@dataclass(frozen=True)
class Pair:
    """The features of a frame and their displacements to a later frame."""

    lag: int  # number of frames from the first to the second
    place: Complexes  # x + i y [px]
    step: Complexes  # [px]

    def motion(self, among: Bools) -> RigidMotion | None:
        """Return the rigid motion of most of the features `among`; None for fewer than `_FEWEST` features."""
        if among.sum() < _FEWEST:
            return None
        z0, z1 = self.place[among], (self.place + self.step)[among]
        found, _ = cv2.estimateAffinePartial2D(
            _xy(z0), _xy(z1), method=cv2.RANSAC, ransacReprojThreshold=_NEAR, maxIters=500
        )
        if found is None:
            return None
        a, b = complex(found[0, 0], found[1, 0]), complex(found[0, 2], found[1, 2])
        for _ in range(3):
            size = max(abs(a), 1e-9)
            if not 0.9 < size < 1.1:
                return None
            members = among & (np.abs(self.place * (a - 1.0) + b - self.step) < _NEAR)
            if members.sum() < _FEWEST:
                return None
            z0, z1 = self.place[members], (self.place + self.step)[members]
            m0, m1 = z0.mean(), z1.mean()
            a = complex(np.vdot(z0 - m0, z1 - m1))
            a /= max(abs(a), 1e-12)
            b = complex(m1 - a * m0)
        return RigidMotion(a, b, members)


def _xy(z: Complexes) -> Singles:
    return np.stack([z.real, z.imag], axis=1).astype(np.float32)


def pairs_of(film: Film, usable: Integers) -> list[Pair]:
    """Return the displacements of features in pairs of near frames from the whole film."""
    if len(usable) <= max(_LAGS):
        return []
    starts = np.unique(np.linspace(0, len(usable) - 1 - max(_LAGS), _PAIRS).astype(int))
    needed = np.unique(np.concatenate([starts + lag for lag in (0, *_LAGS)]))
    pictures = dict(zip(needed.tolist(), film.some(usable[needed]), strict=True))
    later = ([np.asarray(pictures[start + lag]) for lag in (0, *_LAGS)] for start in starts.tolist())
    return [pair for some in later if (pair := pair_of(*some)) is not None]


def pair_of(first: Plane, *later: Plane) -> Pair | None:
    """Return the displacements of the features of a frame at the first lag at which they are measurable.

    If no lag is sufficient, the last lag is used. The result is None without features. If most features move together,
    for example with a slow camera, their common motion must be measurable, not only the motion of a few features.
    """
    places = features_of(first)
    pair = None
    for lag, second in zip(_LAGS, later, strict=True) if len(places) >= _FEWEST else ():
        moved = tracked(first, places, second)
        known = np.isfinite(moved).all(axis=1)
        if known.sum() < _FEWEST:
            continue
        z, d = (v[known].astype(np.float64) @ np.array([1.0, 1j]) for v in (places, moved))
        pair = Pair(lag, z, d)
        if (
            np.count_nonzero(np.abs(d) > _STEP) >= _FEWEST
            and not lag * _STEP / _LAGS[-1] < np.median(np.abs(d)) < _STEP
        ):
            break
    return pair


def frames_of_one_shot(film: Film) -> Integers:
    """Return the frames that do not repeat the previous one; a TrackingError for few such frames, or several shots."""
    usable = fresh_frames(film)
    if len(usable) < FEWEST_FRAMES:
        raise TrackingError(
            f"{film.path.name} has only {len(usable)} different frames; at least {FEWEST_FRAMES} are required to track "
            "a motion.",
            "Give a longer film.",
        )
    refuse_cut(film, usable)
    return usable


def refuse_cut(film: Film, usable: Integers) -> None:
    """Raise a RefusedFilmError for a film of several shots."""
    if (at := cut_at(film, usable)) is not None:
        frame, change, other = at
        time = film.stamps - film.stamps[0]
        before, after = film.some([frame - 1, frame])
        longer = "--to" if frame > len(film) - frame else "--from"
        raise RefusedFilmError(
            f"{film.path.name} is cut at frame {frame} ({time[frame]:.3g} s): the picture changes by {change:.0f} grey "
            f"levels there, and by at most {other:.1f} in the frames around.",
            f"Select one shot; for the longest one, give {longer} {time[frame - (longer == '--to')]:.3f}.",
            kind="cut",
            evidence={"frame": float(frame), "change": change, "other": other},
            frames=(before, after),
        )


def refuse_moving_camera(
    film: Film, usable: Integers, pairs: Sequence[Pair], shape: tuple[int, ...], least: float = _NO_HUB
) -> None:
    """Raise a RefusedFilmError if the whole picture moves, and a rotation about a hub has a residual above `least`."""
    camera = camera_motion(pairs, shape)
    if camera is not None and camera[2] >= least:
        step, share, off = camera
        some = film.some(usable[np.linspace(0, len(usable) - 1, 4).astype(int)])
        raise RefusedFilmError(
            f"The camera moves in {film.path.name}: {100 * share:.0f} % of the features move together by {step:.1f} px "
            f"per frame, and a rotation about a hub does not explain this (residual {100 * off:.0f} %).",
            "Film with the camera on a stand; if a body fills the picture, give its centre of rotation with "
            "--hub X,Y.",
            kind="moving camera",
            evidence={"step_px": step, "share": share, "no_hub": off},
            frames=tuple(some),
        )


def cut_at(film: Film, usable: Integers) -> tuple[int, float, float] | None:
    """Return the frame at which another shot begins, its change, and the largest change around it [grey levels].

    After a flash of light the picture is the same as before, after a cut it is not. Shots of fewer than `_SHOT` frames
    (a still at the beginning) are ignored here; the tracker handles them.
    """
    change = film.changes[usable]
    if len(change) < 2 * _SHOT:
        return None
    for k in np.argsort(-change[_SHOT : len(change) - _SHOT + 1])[:3] + _SHOT:
        near = np.abs(np.arange(len(change)) - k) <= _CUT_REACH
        near[[0, k]] = False
        other = float(change[near].max())
        if change[k] < max(_CUT * other, _CUT_LEAST):
            continue
        # a fast body changes every frame, but not the mean of several
        some = [np.asarray(f, dtype=np.float32) for f in film.some(usable[k - _SHOT : k + _SHOT])]
        apart = np.mean(some[_SHOT:], axis=0) - np.mean(some[:_SHOT], axis=0)
        if float(np.abs(apart).mean()) > _REMAINS * change[k]:
            return int(usable[k]), float(change[k]), other
    return None


def camera_motion(pairs: Sequence[Pair], shape: tuple[int, ...]) -> tuple[float, float, float] | None:
    """Return the motion of the whole picture, or None if it turns about a hub.

    The result has three numbers. The first is the median displacement of the features per frame [px]. The second is the
    share of the features that move together. The third is the rms residual of the displacements after the fit of a
    rotation about the best hub, divided by the rms displacement.
    """
    steps, shares, left, right = [], [], [], []
    at_rest = 0
    for pair in pairs:
        motion = pair.motion(np.ones(len(pair.place), dtype=np.bool_))
        size, share = 0.0, 0.0
        if motion is not None:
            size, share = float(np.median(np.abs(pair.step[motion.members]))), float(motion.members.mean())
        if (
            motion is None
            or size < _STEP
            or share < _WITH_CAMERA
            or not _covers(pair.place[motion.members], shape)
        ):
            at_rest += _covers(pair.place[np.abs(pair.step) < _AT_REST], shape)
            continue
        steps.append(size / pair.lag)
        shares.append(share)
        middle = complex(np.mean(pair.place[motion.members]))
        # a rotation about a hub h displaces the middle of the features by (1 - a) (h - middle)
        left.append(1.0 - motion.a)
        right.append(motion.b - (1.0 - motion.a) * middle)
    # a handheld camera causes parallax, which is not a rigid motion: such pairs count neither as motion nor as rest
    if len(steps) < max(_MOST * (len(steps) + at_rest), 0.5 * len(pairs), 3):
        return None
    one, moved = np.array(left), np.array(right)
    hub = np.vdot(one, moved) / max(float(np.vdot(one, one).real), 1e-12)
    # a rotation of the picture about its middle hardly displaces the middle: use the displacement at the edge
    reach = 0.25 * float(sum(shape[:2]))
    size = math.sqrt(float(np.mean(np.abs(moved) ** 2 + (np.abs(one) * reach) ** 2)))
    off = math.sqrt(float(np.mean(np.abs(moved - one * hub) ** 2))) / max(size, 1e-9)
    return None if off < _NO_HUB else (float(np.median(steps)), float(np.median(shares)), off)


def _covers(place: Complexes, shape: tuple[int, ...]) -> bool:
    """Return whether the convex hull of some features is a large part of the picture."""
    return len(place) > 2 and cv2.contourArea(cv2.convexHull(_xy(place))) >= _WHOLE * shape[0] * shape[1]


@dataclass(frozen=True)
class TwoMotions:
    """Two bodies that turn differently: medians over the pairs of frames."""

    hubs: tuple[complex, complex]  # fixed points of both motions, x + i y [px]
    spread: tuple[float, float]  # median distance of the fixed points of the pairs from `hubs` [px]
    places: tuple[complex, complex]  # centroids of the features of both bodies [px]
    shares: tuple[float, float]  # shares of the moving features
    ratio: float  # rotation of the second body divided by the rotation of the first
    joined: bool = False  # whether a joint at a fixed distance from a hub belongs to both bodies

    @property
    def moving(self) -> int:
        """Number of moving hubs."""
        reach = max(abs(self.places[k] - self.hubs[k]) for k in (0, 1))
        return sum(spread > _LINKED * max(reach, 1.0) for spread in self.spread)

    @property
    def linked(self) -> bool:
        """Whether one body turns about a hub, the other about a joint on the first body, as in a double pendulum."""
        return self.moving == 1 and self.joined

    @property
    def coaxial(self) -> bool:
        """Whether both bodies turn about one hub, as rotor and casing of a gyroscope."""
        reach = max(abs(self.places[k] - self.hubs[k]) for k in (0, 1))
        return abs(self.hubs[0] - self.hubs[1]) < _COAXIAL * max(reach, 1.0)


def two_motions(pairs: Sequence[Pair]) -> TwoMotions | None:
    """Return the motions of two bodies that turn differently; None unless most pairs of frames show both motions."""
    found, turns, motions = [], [], []
    moving = 0
    for pair in pairs:
        moves = np.abs(pair.step) > _STEP
        moving += int(moves.sum() >= _FEWEST)
        first = pair.motion(moves)
        if first is None:
            continue
        rest = moves & ~first.members
        second = pair.motion(rest) if rest.sum() >= _SECOND * moves.sum() else None
        if second is None or second.members.sum() < _EXPLAINED * rest.sum():
            continue
        one, two = first.turn, second.turn
        if abs(one - two) < _OTHER_TURN * max(abs(one), abs(two)) or min(abs(one), abs(two)) < _LEAST_TURN:
            continue
        hubs = [m.b / (1.0 - m.a) for m in (first, second)]
        places = [complex(np.mean(pair.place[m.members])) for m in (first, second)]
        shares = [float(m.members.sum() / moves.sum()) for m in (first, second)]
        found.append((*hubs, *places, *shares))
        turns.append(two / one)
        motions.append([[m.a, m.b] for m in (first, second)])
    if len(found) < max(_MOST * moving, 3):
        return None
    columns = np.array(found, dtype=np.complex128).T
    middle = np.median(columns.real, axis=1) + 1j * np.median(columns.imag, axis=1)
    spread = np.median(np.abs(columns - middle[:, None]), axis=1)
    k = int(np.argmin(spread[:2]))  # the body whose hub moves less
    pair_motions = np.array(motions)
    return TwoMotions(
        (complex(middle[0]), complex(middle[1])),
        (float(spread[0]), float(spread[1])),
        (complex(middle[2]), complex(middle[3])),
        (float(middle[4].real), float(middle[5].real)),
        float(np.median(turns)),
        share_a_joint(complex(middle[k]), pair_motions[:, k], pair_motions[:, 1 - k]),
    )


def refuse_two_motions(name: str, pairs: Sequence[Pair], frames: Sequence[Plane]) -> None:
    """Raise a RefusedFilmError, with some frames, if two bodies turn differently about different hubs or are links.

    A moving hub is evidence of a second body only if it is the joint of two links.
    """
    two = two_motions(pairs)
    if two is None or two.coaxial or (two.moving and not two.linked):
        return
    (p, q), (h, _), (s, t) = two.places, two.hubs, two.shares
    measured = (
        f"{100 * s:.0f} % of the moving features, about ({p.real:.0f}, {p.imag:.0f}) px, turn together, and "
        f"{100 * t:.0f} %, about ({q.real:.0f}, {q.imag:.0f}) px, {two.ratio:.2g} times as far"
    )
    kind, what = "two bodies", f"Two bodies turn in {name}"
    one, other = (f"--hub {z.real:.0f},{z.imag:.0f}" for z in two.hubs)
    hint = f"Give the centre of the body to track: {one} or {other}."
    if two.linked:
        kind, what, hint = "two links", f"Two linked bodies turn in {name}", FOLLOW_LINKS
    raise RefusedFilmError(
        f"{what}: {measured}.",
        hint,
        kind=kind,
        evidence={"share": s, "other_share": t, "ratio": two.ratio},
        frames=tuple(frames),
        hub=(h.real, h.imag),
    )


def refuse_blurred(film: Film, frames: Sequence[Plane], ring: Ring, noise: float) -> None:
    """Raise a RefusedFilmError if the frames show no detail of a body in the ring about its best hub."""
    change, share = detail(ring, frames, noise)
    if change > _FAINT and share > _SMEARED:
        return
    x, y = ring.hub
    why = (
        f"its detail along the circles about ({x:.0f}, {y:.0f}) px is {100 * share:.0f} % of the detail across them"
        if share <= _SMEARED
        else f"its picture changes by only {change:.1f} standard deviations of the noise ({noise:.1f} grey levels)"
    )
    raise RefusedFilmError(
        f"The moving body in {film.path.name} is too blurred to be tracked: {why}.",
        "Film with a shorter exposure and a higher frame rate, or put a marker of high contrast on the body.",
        kind="blurred",
        evidence={"change_sigma": change, "detail": share},
        frames=tuple(frames[k] for k in np.linspace(0, len(frames) - 1, 4).astype(int)),
        hub=ring.hub,
    )


def detail(ring: Ring, frames: Sequence[Plane], noise: float) -> tuple[float, float]:
    """Return the rms change of a ring divided by the noise, and the ratio of the detail along and across circles.

    The detail is the rms gradient per px in each direction, less the gradient of the noise. If a body turns by several
    times the width of a detail during an exposure, its detail along the circles is smeared.
    """
    polars = np.stack([ring.unwrap(frame) for frame in frames]).astype(np.float64)
    change = float(np.sqrt(np.mean((polars - polars.mean(axis=0)) ** 2))) / noise
    step = (ring.outer - ring.inner) / ring.rows
    along = np.diff(polars, axis=2) / (ring.radius[:, None] * ring.step)
    across = np.diff(polars, axis=1) / step
    # noise of the difference of two samples; interpolation has averaged some samples
    floor = noise**2
    sizes = [
        math.sqrt(max(float(np.mean(g**2)) - floor / d**2, 0.0))
        for g, d in ((along, float(np.mean(ring.radius)) * ring.step), (across, step))
    ]
    return change, sizes[0] / max(sizes[1], 1e-9)
