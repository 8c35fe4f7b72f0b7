"""Tracking of a body whose hub moves: a table suspended by threads, a sliding puck, a rolling cylinder.

The path of the hub is found first: from features if the body hardly moves, otherwise from the outline of the region
that differs from the background. The picture of the body about this path is then registered against a template averaged
from the film, which measures the angle and the remaining displacement together.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from statistics import median

import cv2
import numpy as np

from gyrotrack._arrays import Bools, Complexes, Floats, Integers, Picture, Plane
from gyrotrack._column_store import StoredPictures
from gyrotrack._errors import TrackingError
from gyrotrack._smoothing import running_quantile
from gyrotrack.tracking._film import Film, Progress, frames_of, fresh_frames
from gyrotrack.tracking._hub_search import Motion, follow_features, ring_for, spatial_noise, still_point
from gyrotrack.tracking._live_angles import FrameAngles
from gyrotrack.tracking._registration import (
    TURN,
    Area,
    Pose,
    Ring,
    explained,
    follow,
    learn,
    register,
)
from gyrotrack.tracking._silhouettes import median_picture, quantile_picture
from gyrotrack.tracking._tracked import Tracked, white_noise

_LEAST_RANGE = 0.01
"""Smallest range of the angles in which features are followed [rad]. Chosen: a smaller value follows noise, a larger
one overlooks a suspended table."""
_WIDEST = 2.0
"""Largest range of the angles in which features are followed [rad]. Chosen: larger rotations are measured by
registration about a hub, because features are lost during a larger rotation."""
_LENIENT = 2.0
"""In reduced frames, the smallest range of the angles is divided by this factor, and the largest travel of the hub is
multiplied by it [1]. Chosen: a smaller factor refuses films that full frames would admit, a larger one examines more
films in full frames."""
_EXPLAINED = 0.4
"""Smallest share of the change of brightness about the path that the rotation explains [1]. Chosen: a smaller value
accepts bodies that only translate, a larger one refuses uneven light."""
_RIGID = 0.7
"""If the path of a body is the path of its outline, rotation must explain at least this share of the change; for a
rigid body, it explains nearly the whole change [1]. Measured: 0.79 to 0.99 for real pucks and a cylinder, 0.56 to 0.63
for a wave, a part of a turning rod and wires on a puck."""
_ROUGHLY_RIGID = 0.5
"""A body is registered if rotation by the rough angles explains at least this share of the change [1]. Measured:
registration changes the share by less than 0.1; the films are not recorded."""
_COARSE = 48.0
"""Largest resolution for rough angles [samples per radius]. Chosen: a larger value costs time, a smaller one blurs the
marks of the body."""
_MIDDLE = 100.0
"""Largest resolution for the final angles [samples per radius]. Chosen: a larger value costs time, a smaller one loses
detail."""
_LEARNT = 150
"""Number of frames from which the template is learnt [frames]. Chosen: a smaller number gives a noisier template, a
larger one costs time."""
_ROUNDS = 10
"""Largest number of iterations between template and poses [iterations]. Chosen: a smaller number stops before path and
template agree, a larger one costs time."""
_SETTLED = 1e-3
"""Change of the angles, relative to the motion, that ends the iterations [1]. Chosen: a larger value stops early, a
smaller one costs time."""
_HIDDEN = 6.0
"""Largest mean square residual, divided by its median, of a frame that shows the body [1]. Chosen: a smaller value
omits frames of uneven light, a larger one keeps frames with a hand."""
_AS_WELL = 1.2
"""The angle extrapolated from the last frames is used if its misfit, divided by the misfit at the rough angle, is at
most this value [1]. Chosen: equal parts fit equally well within noise; a smaller value keeps slips, a larger one
removes true jumps."""
_RECENT = 6
"""Number of the last frames that predict the next angle [frames]. Chosen: a smaller number follows a single wrong
angle, a larger one lags behind a change of the speed."""
_LARGEST_STEP = 2.0
"""Largest correction of the path by a registration [px]. Chosen: a smaller value needs more iterations, a larger one
follows wrong fits."""

_BACKGROUND = 60
"""Number of frames for the background, which is their median [frames]. Chosen: a larger number costs memory and time, a
smaller one keeps a slow body in the background."""
_ONE_SIGN = 3.0
"""The whole body counts as lighter (or darker) than the background if the ratio of lighter to darker differences (or
the inverse ratio) is at least this value [1]. Chosen: a smaller value takes marks of a body for the background, a
larger one leaves a body at rest in the background."""
_RARE = 0.15
"""If a body covers a pixel most of the time, the background must be visible there in at least this share of the frames
[1]. Chosen: a smaller value follows noise and shadows, a larger one takes a body that stays longer for the
background."""
_LAG = 4
"""Distance between two frames in which the pictures of a moving body differ measurably [frames]. Chosen: a smaller
number shows less motion than noise, a larger one shifts the ends of the motion."""
_CONTRAST = 6.0
"""Smallest difference of a body from the background in standard deviations of the noise [1]. Chosen: a smaller value
finds noise, a larger one loses faint bodies."""
_FAINTEST = 0.1
"""Smallest difference of a body from the background, relative to the strongest contrast [1]. Chosen: a smaller value
includes shadows, a larger one loses dark parts of the body."""
_FEWEST = 12
"""Smallest number of frames of a path [frames]. Chosen: a smaller number accepts short-lived objects, a larger one
loses fast bodies."""
_SMALLEST = 24.0
"""Smallest area of a body [px2]. Chosen: a smaller value follows noise, a larger one loses small bodies."""
_REGIONS = 50
"""Largest number of regions of a frame that are considered, the largest first [1]. Chosen: a larger number costs time,
a smaller one loses bodies in noisy films."""
_LOST = 5
"""Number of frames without the body after which a path ends [frames]. Chosen: colliding bodies start new paths; a
smaller number splits a path at each occlusion, a larger one joins different bodies."""
_AREA = 0.3
"""Smallest relative change of the area of a body that touches another body or is occluded [1]. Chosen: a smaller value
discards frames of uneven light, a larger one keeps touching bodies."""
_RESCALED = 0.1
"""The size of a body is followed if at least this share of the frames of a path show an area that only a changed
distance from the camera explains [1]. Chosen: a smaller value follows the noise of the areas, a larger one omits the
ends of a path towards the camera."""
_SIMILAR = 0.25
"""Largest relative change of the moment of an outline, divided by its squared area, at a change of distance from the
camera [1]. Derived: a disc of which half is hidden changes by 0.28; a larger value takes occlusion for distance, a
smaller one omits bodies that wobble."""
_TREND = 15, 31
"""Lengths of the running medians of area and moment [frames]. Chosen: smaller values follow an occlusion, larger values
do not follow the distance."""
_GATE = 0.7
"""Largest distance of a body from its prediction [diameters]. Chosen: a smaller value loses fast bodies, a larger one
confuses neighbours."""
_TRAVEL = 0.5
"""Smallest distance that a free body moves [diameters]. Chosen: a smaller value follows bodies on an axle, a larger one
omits short paths."""
_OF_FILM = 0.25
"""Smallest changed area of the picture in the frames of a path, divided by the changed area in all frames [1]. Chosen:
a body with a smaller share is not the subject of the film; a larger value omits one body of several."""
_SLIDING = 1.0
"""Smallest displacement of a moving body in `_LAG` frames [px]. Chosen: a smaller value includes rest, a larger
one cuts slow ends."""
_TURNING = 3.0
"""Smallest change (rms) of the picture of a moving body, in standard deviations of the noise [1]. Chosen: a smaller
value includes rest, a larger one cuts slow ends."""
_TURNED = 0.2
"""Smallest change (rms) of the picture of a moving body, relative to the largest change [1]. Chosen: changes by the
codec at rest exceed the noise; a smaller value includes these changes, a larger one cuts slow ends."""
_STEADY = 9
"""Length of a window in which most frames show the motion [frames]. Chosen: a smaller number ends the motion at a
single frame, a larger one blurs its ends."""
_WITHIN = 0.9
"""Share of the radius within which the picture shows the body alone [1]. Chosen: a larger value includes the
background, a smaller one loses marks near the rim."""
_BODIES = 4
"""Largest number of paths for which the rotation is measured [1]. Chosen: a larger number costs time, a smaller one may
omit the body that turns."""
_FASTEST = 0.25 * TURN
"""Largest rotation per frame [rad per frame]. Derived: beyond a quarter of a turn a disc with two similar sides fits
either sense."""
_SUDDEN = 0.1 * TURN
"""Largest difference between the rotation in one frame and the rotation in neighbouring frames [rad]. Chosen: a smaller
value refuses collisions, a larger one accepts another orientation of the template."""
_TURNS = 5.0
"""Smallest standard deviation of the angles of a rotating body, in standard uncertainties of one angle [1]. Chosen: a
smaller value reports noise, a larger one omits small rotations."""


_STILL = 0.5
"""Rms displacement below which a hub stands still [px]. Chosen: a smaller value takes the noise of features for a
path, a larger one ignores the motion of a suspended body."""
_EXCURSION = 2.0
"""Largest displacement of a hub that stands still [px]. Chosen: a smaller value takes an outlier for a path, a larger
one ignores a short displacement."""


def track_by_features(
    film: Film, usable: Integers, motion: Motion, progress: Progress | None = None
) -> Tracked | None:
    """Track a body without an axle, for example a suspended table, by its features; None for any other film.

    The hub must move by about a pixel or more, and the range of angles must be below 2 rad. Registration, which uses
    the whole picture, tracks all other bodies: a body on an axle, a body that moves more than it turns, and a body
    whose hub is outside the picture, for example the ball of a pendulum.
    """
    found = _loose_motion(frames_of(film, usable), motion)
    if found is None:
        return None
    theta, path, followed, ring = found
    hub = complex(np.mean(path))
    if path.std() < _STILL and np.abs(path - hub).max() < _EXCURSION:
        return None
    shift = np.stack([(path - hub).real, (path - hub).imag], axis=1)
    use = np.unique(np.linspace(0, len(usable) - 1, _LEARNT).astype(int))
    pictures = film.some(usable[use])
    for again in range(2):
        polars = [ring.unwrap(f, tuple(shift[k])) for k, f in zip(use, pictures, strict=True)]
        allowed = ring.inside(motion.area)
        template = learn(polars, theta[use], allowed, ring, separate=False, plain=True)
        share, rows = explained(polars, theta[use], template)
        if not again:
            ring = ring.trimmed(rows, finest=_COARSE)
    if share < _EXPLAINED:
        return None
    tracked = _along_path(film, usable, ring, theta, shift, motion.area, progress)
    if tracked.explained < _EXPLAINED:  # the features belong to several bodies
        return None
    # The background biases features at the edge of the body, so the result is taken from registration. The scatter of
    # the difference is a correlated uncertainty. New features inherit the error of the previous features, so the mean
    # difference of each selection of features is removed.
    kept = np.isin(usable, tracked.frame)
    apart, followed = tracked.angle + theta[kept], followed[kept]
    for first in np.unique(followed):
        apart[followed == first] -= apart[followed == first].mean()
    correlated = float(apart.std())
    repeated = int(film.selected.sum()) - len(usable)
    notes = [
        (
            f"The hub moves by {float(path.std()):.1f} px rms; its path is measured. Angles from "
            f"features and from registration differ by {1e3 * correlated:.2g} mrad rms, which the uncertainty includes."
        )
    ]
    if repeated:
        notes.append(f"{repeated} of {film.selected.sum()} frames repeat the previous frame and are omitted.")
    return _completed(film, tracked, correlated, "features", notes)


def may_be_loose(frames: Iterable[Plane], motion: Motion) -> bool:
    """Return whether the features of reduced frames show a body that turns by a small angle and moves little."""
    return _loose_motion(frames, motion, travel=_LENIENT, least=_LEAST_RANGE / _LENIENT) is not None


def _loose_motion(
    frames: Iterable[Plane], motion: Motion, travel: float = 1.0, least: float = _LEAST_RANGE
) -> tuple[Floats, Complexes, Integers, Ring] | None:
    """Return angles, hub path, frames of selection and ring of a body from its features; None for any other body.

    The frame of selection of a frame is the frame in which its features were selected. The range of the angles must
    exceed `least` [rad], and the hub must move by less than `travel` times the arcs of the rim.
    """
    found = follow_features(frames, motion, _WIDEST)
    if found is None:
        return None
    turn, moved, followed = found
    theta = np.unwrap(np.angle(turn))
    if not least < np.ptp(theta) < _WIDEST:
        return None
    path = turn * complex(*still_point(turn, moved)) + moved
    hub = complex(np.mean(path))
    height, width = motion.moving.shape
    if not (0.0 <= hub.real < width and 0.0 <= hub.imag < height):
        return None
    ring = ring_for((hub.real, hub.imag), motion, _COARSE)
    if ring is None or path.std() > travel * theta.std() * ring.outer:
        return None
    return theta, path, followed, ring


def _completed(film: Film, tracked: Tracked, correlated: float, way: str, notes: list[str]) -> Tracked:
    """Return a motion with the correlated uncertainty [rad] of its angles, the method for its hub, and warnings."""
    sigma, warnings = np.hypot(tracked.sigma, correlated), (*film.warnings, *tracked.warnings, *notes)
    return replace(tracked, sigma=sigma, correlated=correlated, way=way, warnings=warnings)


def track_free_body(
    film: Film, near: tuple[float, float] | None = None, progress: Progress | None = None
) -> Tracked:
    """Track the rotation of a body that moves across the picture in front of a fixed background.

    The body is the one that passes the point `near` (x, y) [px], by default the body with the largest range of angles.
    A TrackingError is raised if no body moves across the picture, or if no such body turns measurably.
    """
    usable = fresh_frames(film)
    noise = max(spatial_noise(film.some(usable[:: max(1, len(usable) // 8)])), 0.5)
    paths = find_paths(film, usable, noise)
    if near is None:
        paths = [p for p in paths if p.share > _OF_FILM]
    else:
        paths = [p for p in paths if np.hypot(*(p.place - np.array(near)).T).min() < 2 * p.radius]
    starts = [start for path in paths[:_BODIES] if (start := _rotation(film, path, noise)) is not None]
    starts.sort(key=lambda start: -float(np.ptp(start[2])))
    for n, (path, ring, theta, shift) in enumerate(starts):
        tracked = _along_path(film, path.frame, ring, theta, shift, None, progress, path.scale)
        if tracked.explained < _RIGID or np.std(tracked.angle) < _TURNS * np.median(tracked.sigma):
            continue
        steps = np.diff(tracked.angle) / np.diff(tracked.frame)
        sudden = np.abs(steps - running_quantile(steps, 5, 2))
        # a jump to another orientation that fits the template better: not one rigid body
        if np.max(np.abs(steps)) > _FASTEST or np.max(sudden) > _SUDDEN:
            continue
        apart = tracked.halves[0] - tracked.halves[1]
        correlated = 0.5 * math.sqrt(max(float(np.var(apart)) - white_noise(apart, tracked.frame) ** 2, 0.0))
        notes = []
        for other, *_ in starts[n + 1 :]:
            x, y = other.place[0]
            notes.append(f"Another body moves as well; --hub {x:.0f},{y:.0f} selects it.")
        if path.scale is not None:
            notes.append(
                f"The distance of the body from the camera changes: its size in the picture changes by a factor of "
                f"{path.scale.max() / path.scale.min():.2g}, which is compensated."
            )
        # the file keeps the last warning, which must state why the result is doubtful
        notes.append(
            f"The body does not turn about a fixed axis: it moves across the picture by "
            f"{np.hypot(*np.ptp(path.place, axis=0)):.0f} px. Its angle is measured about the centroid of its outline, "
            f"complete in {len(path.frame)} of {len(film)} frames; forces on the body may also change its rotation."
        )
        return replace(_completed(film, tracked, correlated, "outline", notes), ambiguous=True)
    where = "" if near is None else f" and passes ({near[0]:.0f}, {near[1]:.0f}) px"
    what = f"No body that turns while it moves across the picture{where} is found in {film.path.name}."
    hint = "--point X,Y follows a point of it."
    raise TrackingError(
        what, f"--hub X,Y selects a body by a point on its path; {hint}" if near is None else hint
    )


@dataclass(frozen=True)
class Path:
    """The path of a body."""

    frame: Integers  # frames in which the outline is complete, (m,)
    place: Floats  # centroid of the outline (x, y) [px], (m, 2)
    radius: float  # radius of a circle of the same area [px]
    # changed area of the picture in these frames, divided by the changed area in all frames
    share: float = 1.0
    # size of the body relative to `radius`, (m,); None if its distance from the camera is constant
    scale: Floats | None = None


@dataclass
class _Outline:
    """A body in one frame: centroid (x, y) [px], area [px2], and polar moment divided by the squared area."""

    place: Floats
    area: float
    moment: float = 1 / TURN  # of a disc


@dataclass
class _Link:
    """The outlines of one body, frame by frame."""

    frame: list[int] = field(default_factory=list)
    outline: list[_Outline] = field(default_factory=list)

    def area(self) -> float:
        return median(o.area for o in self.outline[-10:])

    def expected(self, frame: int) -> Floats:
        """Extrapolate the position with the velocity of the last steps."""
        last = self.outline[-1].place
        if len(self.frame) < 3:
            return last
        step = (last - self.outline[-3].place) / (self.frame[-1] - self.frame[-3])
        return np.asarray(last + step * (frame - self.frame[-1]))


def find_paths(film: Film, usable: Integers, noise: float) -> list[Path]:
    """Return the paths of all bodies that move across the picture, the one with the largest area swept first.

    The background is the median of frames between which the picture changes by equal amounts. A body that comes to rest
    is then not part of the background.
    """
    changed = _changed(film, usable, _CONTRAST * noise)
    moved = np.cumsum(changed)
    steps = np.searchsorted(moved, np.linspace(0.0, moved[-1], _BACKGROUND + 2)[1:-1])
    sample = film.some(usable[np.unique(np.minimum(steps, len(usable) - 1))])
    background = median_picture(sample)
    away = max(float(np.quantile(np.abs(frame - background), 0.999)) for frame in sample)
    limit = max(_CONTRAST * noise, _FAINTEST * away)
    background = _uncovered(background, sample, limit)
    active: list[_Link] = []
    ended: list[_Link] = []
    for index, frame in zip(usable.tolist(), frames_of(film, usable), strict=True):
        ended += [k for k in active if index - k.frame[-1] > _LOST and len(k.frame) >= _FEWEST]
        active = [k for k in active if index - k.frame[-1] <= _LOST]
        _link(active, index, _outlines(np.abs(frame - background) > limit))
    found = []
    for link in ended + active:
        area = np.array([o.area for o in link.outline])
        whole, scale = _sizes(area, np.array([o.moment for o in link.outline]))
        place = np.array([o.place for o in link.outline])[whole]
        radius = math.sqrt(float(np.median(area)) / math.pi)
        if len(place) >= _FEWEST and np.hypot(*np.ptp(place, axis=0)) > _TRAVEL * 2 * radius:
            frames = np.array(link.frame, dtype=np.int64)[whole]
            share = float(changed[np.isin(usable, frames)].sum()) / max(float(moved[-1]), 1.0)
            found.append(Path(frames, place, radius, share, None if scale is None else scale[whole]))
    return sorted(found, key=lambda p: -p.radius * float(np.hypot(*np.diff(p.place, axis=0).T).sum()))


def _uncovered(background: Picture, sample: Sequence[Plane], limit: float) -> Picture:
    """Return the median of some frames, corrected where a body covers the background most of the time.

    If nearly all differences larger than `limit` have one sign, the body is lighter, or darker, than the background.
    Where the median shows the body, the rarer values of the other sign are the background.
    """
    sizes = [float(sum(np.count_nonzero(s * (f - background) > limit) for f in sample)) for s in (1.0, -1.0)]
    if max(sizes) <= _ONE_SIGN * min(sizes):
        return background
    sign = 1.0 if sizes[0] > sizes[1] else -1.0
    rank = int(_RARE * (len(sample) - 1))
    other = quantile_picture(sample, (rank if sign > 0 else len(sample) - 1 - rank,))
    return np.where(sign * (background - other) > limit, other, background)


def _sizes(area: Floats, moment: Floats) -> tuple[Bools, Floats | None]:
    """Return in which frames of a path the outline is complete, and the size of the body relative to its median size.

    The size is None if it does not change.

    `area` [px2] and `moment` (the polar moment divided by the squared area) are properties of the outlines. The moment
    of a body that touches another one, or is occluded, changes with its area. If only the area changes, and slowly, the
    distance from the camera changes.
    """
    ratio = area / np.median(area)
    usual = np.abs(ratio - 1.0) < _AREA
    trend, shape = (running_quantile(v, n, n // 2) for v, n in zip((ratio, moment), _TREND, strict=True))
    similar = (np.abs(ratio / trend - 1.0) < _AREA) & (np.abs(moment / shape - 1.0) < _SIMILAR)
    if np.mean(similar & ~usual) < _RESCALED:
        return usual, None
    return similar, np.sqrt(trend)


def _changed(film: Film, usable: Integers, limit: float) -> Floats:
    """Return the area [px2] that differs by more than a limit between each frame and an earlier frame."""
    before: deque[Plane] = deque(maxlen=_LAG)
    area = []
    for frame in frames_of(film, usable):
        smooth = np.asarray(cv2.blur(frame, (3, 3)), dtype=np.uint8)
        area.append(float(np.count_nonzero(cv2.absdiff(smooth, before[0]) > limit)) if before else 0.0)
        before.append(smooth)
    return np.array(area)


def _outlines(differs: Bools) -> list[_Outline]:
    """Return the regions that differ from the background and do not touch the edge of the picture."""
    closed = cv2.morphologyEx(differs.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    contours, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    contours = sorted(contours, key=cv2.contourArea)[-_REGIONS:]
    height, width = differs.shape
    found = []
    for contour in contours:
        left, top, wide, high = cv2.boundingRect(contour)
        if left < 1 or top < 1 or left + wide > width - 1 or top + high > height - 1:
            continue
        sums = cv2.moments(contour)
        if sums["m00"] >= _SMALLEST:
            place = np.array([sums["m10"], sums["m01"]]) / sums["m00"]
            moment = (sums["mu20"] + sums["mu02"]) / sums["m00"] ** 2
            found.append(_Outline(place, float(sums["m00"]), float(moment)))
    return found


def _link(links: list[_Link], index: int, outlines: Sequence[_Outline]) -> None:
    """Assign the outlines of a frame to the bodies of the previous frames, in the order of distance."""
    pairs = []
    places = np.array([o.place for o in outlines]).reshape(-1, 2)
    areas = np.array([o.area for o in outlines])
    for link in links:
        area = link.area()
        gate = _GATE * 2 * math.sqrt(area / math.pi) + 2.0
        misses = [np.hypot(*(places - at).T) for at in (link.expected(index), link.outline[-1].place)]
        miss = np.minimum(*misses)
        unlike = np.minimum(*(np.abs(areas / a - 1.0) for a in (area, link.outline[-1].area)))
        near = np.flatnonzero((miss < gate) & (unlike < _AREA))
        pairs += [(float(miss[n]), n, link) for n in near.tolist()]
    joined: set[int] = set()
    grown: set[int] = set()
    for _, n, link in sorted(pairs, key=lambda pair: pair[0]):
        if n not in joined and id(link) not in grown:
            joined.add(n)
            grown.add(id(link))
            link.frame.append(index)
            link.outline.append(outlines[n])
    links += [_Link([index], [o]) for n, o in enumerate(outlines) if n not in joined]


def _rotation(film: Film, path: Path, noise: float) -> tuple[Path, Ring, Floats, Floats] | None:
    """Track the angle of a body along its path; None if rotation does not explain the change of the body's picture."""
    hub = path.place.mean(axis=0)
    ring = Ring.about(
        (float(hub[0]), float(hub[1])), max(1.0, 0.1 * path.radius), _WITHIN * path.radius, finest=_COARSE
    )
    shift = path.place - hub
    size = np.ones(len(path.frame)) if path.scale is None else path.scale
    shown = enumerate(frames_of(film, path.frame))
    pictures = (ring.scaled(size[k]).unwrap(f, tuple(shift[k])) for k, f in shown)
    polars = StoredPictures.of(len(path.frame), pictures)
    # exclude frames of a body at rest: they contain no information, and a codec copies them without noise
    turning = np.array([float(np.std(b - a)) for a, b in zip(polars, polars[_LAG:], strict=False)])
    sliding = np.hypot(*(path.place[_LAG:] - path.place[:-_LAG]).T)
    least = max(_TURNING * noise, _TURNED * float(np.quantile(turning, 0.95)))
    moving = ((turning > least) | (sliding > _SLIDING)).astype(float)
    moves = np.flatnonzero(np.convolve(moving, np.ones(_STEADY) / _STEADY, mode="same") > 0.5)
    if len(moves) < _FEWEST - _LAG:
        return None
    kept = slice(moves[0], moves[-1] + _LAG + 1)
    scale = None if path.scale is None else path.scale[kept]
    path = replace(path, frame=path.frame[kept], place=path.place[kept], scale=scale)
    polars, shift = polars[kept], shift[kept]
    allowed = np.ones((ring.rows, ring.columns), dtype=bool)
    nothing = np.zeros((ring.rows, ring.columns), dtype=np.float32)
    weight = np.broadcast_to(ring.area, nothing.shape).astype(np.float32)
    best, angle = 0.0, np.zeros(len(polars))
    some = slice(None, None, max(1, len(polars) // 100))
    for band in ("low", "middle", "high"):
        rough = follow(polars, weight, nothing, ring, band=band)
        template = learn(polars[some], rough[some], allowed, ring, separate=False, plain=True)
        share, _ = explained(polars, rough, template)
        if share > best:
            best, angle = share, rough
    return (path, ring, angle, shift) if best > _ROUGHLY_RIGID else None


def _along_path(
    film: Film,
    frames: Integers,
    ring: Ring,
    theta: Floats,
    shift: Floats,
    area: Area | None,
    progress: Progress | None,
    scale: Floats | None = None,
) -> Tracked:
    """Register a body about an approximate path; angle and displacement of the hub are fitted together.

    `theta` (m,) are rough angles [rad], from x to y; `shift` (m, 2) are displacements of the hub [px] from the centre
    of the ring. `area` is the part of the picture that is used if the hub moves little; otherwise the whole body is
    inside the picture. `scale` (m,) is the size of the body in units of the ring, 1 by default.
    """
    size = np.ones(len(frames)) if scale is None else scale
    theta, shift = theta.copy(), shift.copy()
    use = np.unique(np.linspace(0, len(frames) - 1, _LEARNT).astype(int))
    pictures = film.some(frames[use])
    ring = Ring.about(ring.hub, ring.inner, ring.outer, finest=_MIDDLE, start=ring.start, span=ring.span)
    allowed = np.ones((ring.rows, ring.columns), dtype=bool) if area is None else ring.inside(area)

    def polar_of(frame: Plane, k: int) -> Picture:
        return ring.scaled(size[k]).unwrap(frame, tuple(shift[k]))

    def unwrapped() -> StoredPictures:
        pairs = zip(use, pictures, strict=True)
        return StoredPictures.of(len(use), (polar_of(f, int(k)) for k, f in pairs))

    for _ in range(_ROUNDS):
        polars = unwrapped()
        template = learn(polars, theta[use], allowed, ring, separate=False, plain=True)
        poses = [register(p, template, theta[k], move=True) for k, p in zip(use, polars, strict=True)]
        before = theta[use]
        theta[use] = [p.angle for p in poses]
        moved = size[use, None] * np.array([p.shift for p in poses])
        shift[use] += moved.clip(-_LARGEST_STEP, _LARGEST_STEP)
        if np.std(theta[use] - before) < _SETTLED * np.std(theta):
            break
    polars = unwrapped()
    # equal variances for all samples: over a small range of angles, the variances would be smallest in uniform parts of
    # the body, where only shading that is fixed in the image changes
    template = learn(polars, theta[use], allowed, ring, separate=False, plain=True)
    parts = template.halves()
    every: list[Pose] = []
    halves = np.empty((2, len(theta)))
    live = FrameAngles("single")
    for k, frame in enumerate(frames_of(film, frames)):
        polar = polar_of(frame, k)
        pose = register(polar, template, theta[k], move=True)
        if area is None and k > 1:
            # the rough angle of a free body may belong to an equal part of the body, or be lost
            recent = np.array([p.angle for p in every[-_RECENT:]])
            rate = median(np.diff(recent) / np.diff(frames[k - len(recent) : k]))
            step = rate * (frames[k] - frames[k - 1])
            steady = register(polar, template, recent[-1] + step, move=True)
            pose = steady if steady.misfit < _AS_WELL * pose.misfit else pose
        shift[k] += np.clip(size[k] * np.array(pose.shift), -_LARGEST_STEP, _LARGEST_STEP)
        polar = polar_of(frame, k)
        every.append(register(polar, template, pose.angle, move=True))
        halves[:, k] = [-register(polar, part, pose.angle, move=True).angle for part in parts]
        live.add(int(frames[k]), -every[-1].angle)
        if progress is not None:
            progress(k + 1, len(frames))
    share, _ = explained(polars, theta[use], template)
    angle = -np.array([p.angle for p in every])
    misfit = np.array([p.misfit for p in every])
    usual = float(np.median(misfit))
    kept = misfit < _HIDDEN * usual
    formal = np.array([p.formal for p in every]) * np.sqrt(np.maximum(misfit / usual, 1.0))
    # the uncertainty is not below the Cramer-Rao bound
    larger = max(white_noise(angle[kept], frames[kept]) / float(np.median(formal[kept])), 1.0)
    lost = int((~kept).sum())
    text = f"The body does not match its template in {lost} of {len(kept)} frames, which are omitted."
    return Tracked(
        frame=frames[kept],
        angle=angle[kept],
        sigma=(larger * formal)[kept],
        ring=ring,
        template=template,
        hub_path=shift[kept],
        explained=share,
        way="",
        scale=larger,
        halves=halves[:, kept],
        correlated=0.0,
        warnings=(text,) if lost else (),
        size=None if scale is None else scale[kept],
    )
