"""One body, from a film or a table to its motion, its torque law and a report.

What the motion is (a spin-down, an oscillation, a steady rotation) is read from the angles by least squares; the
uncertainties are from a block bootstrap of the residuals, which keeps what neighbouring frames have in common.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from gyrotrack._errors import DatasetError, TrackingError, VideoError
from gyrotrack._inertia import Inertia
from gyrotrack._smoothing import WIDTH, angular_velocity
from gyrotrack.apps._study import open_study
from gyrotrack.apps.report._page import write_report
from gyrotrack.io._atomic import new_file
from gyrotrack.io._hdf5 import read_case, read_recording, write_case
from gyrotrack.io._records import BodyTrack, Case, Placement, Recording, Series
from gyrotrack.io.readers._import_case import import_body, no_series
from gyrotrack.io.readers._motion_table import ReadOptions
from gyrotrack.io.readers._run import Limits
from gyrotrack.tracking._any_body import Film, Tracked, track_body
from gyrotrack.video._container import file_sha256
from gyrotrack.video._timestamps import SLOWEST_PLAIN_RATE, gap_warnings

Floats = npt.NDArray[np.float64]
Progress = Callable[[int, int | None], None]

TURN = 2 * math.pi
_RESAMPLED = 400
_FEWEST = 12
_FILMS = (".mp4", ".mov", ".mkv", ".webm", ".avi", ".m4v", ".3gp", ".mjpeg", ".mjpg")


@dataclass(frozen=True)
class Value:
    """A quantity and its standard uncertainty."""

    value: float
    stderr: float


@dataclass(frozen=True)
class BodyMotion:
    """The motion of one body.

    Attributes
    ----------
    kind : {"spin-down", "oscillation", "steady"}
        What the motion is.
    turns : float
        Distance between the extreme angles in turns.
    omega : dict
        Angular velocity at the "first" and the "last" sample [rad/s].
    omega_mean : Value
        Mean angular velocity [rad/s].
    alpha : Value
        Angular acceleration at the middle of the record [rad/s2].
    period, amplitude, decay : Value or None
        Of an oscillation: period [s], amplitude at the middle of the record [rad], rate of decay [1/s].
    """

    kind: str
    turns: float
    omega: dict[str, float]
    omega_mean: Value
    alpha: Value
    period: Value | None = None
    amplitude: Value | None = None
    decay: Value | None = None


def motion_of(time: Floats, angle: Floats, sigma: Floats) -> BodyMotion:
    """Describe a motion.

    Parameters
    ----------
    time, angle, sigma : ndarray, shape (n,)
        Time [s], unwrapped angle and its standard uncertainty [rad].

    Notes
    -----
    A rotation is fitted by a polynomial in time (of order 1 to 6, by the Bayesian information criterion) and, from one
    turn on, the first two harmonics of the angle, which are what a hub out of place and a tilted camera add. An
    oscillation is a exp(-d t) cos(2 pi t / P + phi) about a mean that may drift.

    Raises
    ------
    DatasetError
        There are fewer than 12 samples.
    """
    if len(time) < _FEWEST:
        raise DatasetError(
            f"The motion has {len(time)} samples; {_FEWEST} are needed.", "Give a longer record."
        )
    middle = 0.5 * (time[0] + time[-1])
    t = time - middle
    turns = float(np.ptp(angle)) / TURN
    swing = _oscillation(t, angle, sigma)
    polynomial = _rotation(t, angle, sigma)
    if swing is not None:
        period, amplitude, decay, rest = swing
        if _reverses(t, angle, period.value) and rest < 0.2 * np.var(angle):
            return BodyMotion(
                "oscillation", turns, polynomial[0], polynomial[1], polynomial[2], period, amplitude, decay
            )
    omega, mean, alpha = polynomial
    change = abs(omega["last"] - omega["first"])
    steady = abs(alpha.value) < 3 * alpha.stderr or change < 0.01 * abs(mean.value)
    return BodyMotion("steady" if steady else "spin-down", turns, omega, mean, alpha)


def _reverses(t: Floats, angle: Floats, period: float) -> bool:
    """Tell whether the body turns back at least twice, and does not get ahead while it does."""
    net, path = abs(angle[-1] - angle[0]), float(np.abs(np.diff(angle)).sum())
    return bool(np.ptp(t) > 1.2 * period and net < 0.6 * path)


def _rotation(t: Floats, angle: Floats, sigma: Floats) -> tuple[dict[str, float], Value, Value]:
    half = max(abs(t[0]), abs(t[-1]))
    x = t / half
    root = 1.0 / sigma
    harmonics = [f(k * angle) for k in (1, 2) for f in (np.cos, np.sin)] if np.ptp(angle) > TURN else []
    best = None
    for order in range(1, 7):
        basis = np.stack([x**k for k in range(order + 1)] + harmonics, axis=1)
        if len(t) < 2 * basis.shape[1]:
            break
        solved: Floats = np.asarray(
            np.linalg.lstsq(basis * root[:, None], angle * root, rcond=None)[0], dtype=np.float64
        )
        rest = angle - basis @ solved
        effective = len(t) / _inflation(rest * root)
        score = effective * math.log(max(float(np.mean((rest * root) ** 2)), 1e-300)) + basis.shape[
            1
        ] * math.log(max(effective, 2.0))
        if best is None or score < best[0]:
            best = (score, order, basis, solved, rest)
    assert best is not None  # noqa: S101 - 12 samples carry order 1
    _, order, basis, solved, rest = best
    draws = solved[None, :] + _resampled(basis, root, rest)

    def rates(c: npt.NDArray[Any]) -> Floats:
        first = sum(k * c[..., k] * x[0] ** (k - 1) for k in range(1, order + 1)) / half
        last = sum(k * c[..., k] * x[-1] ** (k - 1) for k in range(1, order + 1)) / half
        mean = sum(c[..., k] * (x[-1] ** k - x[0] ** k) for k in range(1, order + 1)) / (t[-1] - t[0])
        alpha = 2 * c[..., 2] / half**2 if order >= 2 else 0.0 * c[..., 1]
        return np.stack([np.asarray(v, dtype=np.float64) for v in (first, last, mean, alpha)], axis=-1)

    found, spread = rates(solved), rates(draws).std(axis=0)
    if order < 2:  # what a quadratic term could be
        wider = np.insert(basis, 2, x**2, axis=1)
        spread[3] = 2 / half**2 * float(_resampled(wider, root, rest)[:, 2].std())
        found[3] = 2 / half**2 * float(np.linalg.lstsq(wider * root[:, None], angle * root, rcond=None)[0][2])
    omega = {"first": float(found[0]), "last": float(found[1])}
    return omega, Value(float(found[2]), float(spread[2])), Value(float(found[3]), float(spread[3]))


def _inflation(rest: Floats) -> float:
    """Return by what factor the variance of a mean grows because neighbours are correlated, 1 for white noise."""
    rest = rest - rest.mean()
    power = float(rest @ rest)
    total = 1.0
    for lag in range(1, len(rest) // 4):
        share = float(rest[lag:] @ rest[:-lag]) / max(power, 1e-300)
        if share < 0.05:
            break
        total += 2 * share
    return total


def _resampled(basis: Floats, root: Floats, rest: Floats) -> Floats:
    """Return changes of the coefficients under a block bootstrap of the residuals, (_RESAMPLED, columns)."""
    n, p = basis.shape
    rng = np.random.default_rng(0)
    block = int(np.clip(3 * _inflation(rest * root), 3, max(3, n // 6)))
    inverse = np.linalg.pinv(basis * root[:, None])
    scaled = rest * root * math.sqrt(n / max(n - p, 1))
    starts = rng.integers(0, n, size=(_RESAMPLED, -(-n // block)))
    index = (starts[:, :, None] + np.arange(block)).reshape(_RESAMPLED, -1)[:, :n] % n
    signs = rng.choice([-1.0, 1.0], size=starts.shape).repeat(block, axis=1)[:, :n]
    return np.asarray((scaled[index] * signs) @ inverse.T)


def _oscillation(t: Floats, angle: Floats, sigma: Floats) -> tuple[Value, Value, Value, float] | None:
    """Fit a damped oscillation about a drifting mean; None where there is none."""
    even = np.linspace(t[0], t[-1], len(t))
    value = np.interp(even, t, angle)
    value = value - np.polyval(np.polyfit(even, value, 1), even)
    power = np.abs(np.fft.rfft(value * np.hanning(len(value)), 8 * len(value))) ** 2
    frequency = np.fft.rfftfreq(8 * len(value), even[1] - even[0])
    valid = frequency > 0.7 / np.ptp(t)
    if not valid.any():
        return None
    start = float(frequency[valid][np.argmax(power[valid])])
    root = 1.0 / sigma

    def model(c: Floats) -> Floats:
        wave = c[2] * np.cos(TURN * c[0] * t) + c[3] * np.sin(TURN * c[0] * t)
        return np.asarray(np.exp(-c[1] * t) * wave + c[4] + c[5] * t)

    c0 = np.array([start, 0.0, 0.0, 0.0, 0.0, 0.0])
    linear = np.stack([np.cos(TURN * start * t), np.sin(TURN * start * t), np.ones_like(t), t], axis=1)
    c0[2:] = np.linalg.lstsq(linear, angle, rcond=None)[0]
    limit = 5.0 / np.ptp(t)

    def residual(c: Floats) -> Floats:
        return (model(c) - angle) * root

    lower = [0.5 * start, -limit, *[-np.inf] * 4]
    upper = [2 * start, 4 * limit, *[np.inf] * 4]
    found = least_squares(residual, c0, x_scale=np.maximum(np.abs(c0), 1e-3), bounds=(lower, upper))
    c, rest = found.x, angle - model(found.x)
    jacobian: Floats = np.asarray(found.jac, dtype=np.float64)
    draws = _resampled(jacobian / root[:, None], root, rest)
    size = float(np.hypot(c[2], c[3]))
    period = Value(1 / float(c[0]), float(draws[:, 0].std()) / float(c[0]) ** 2)
    amplitude = Value(size, float(np.std(draws[:, 2] * c[2] + draws[:, 3] * c[3]) / max(size, 1e-300)))
    return period, amplitude, Value(float(c[1]), float(draws[:, 1].std())), float(np.var(rest))


def start_of_motion(time: Floats, angle: Floats, sigma: Floats) -> int:
    """Return the first sample of the free motion: what a hand or a motor speeds up before it is left out.

    The speed over windows of a fiftieth of the record (5 samples at least) rises to its largest in the first half of
    the record by more than 5 % and 5 standard errors; an oscillation is never cut.
    """
    width = max(5, len(time) // 50)
    edges = np.arange(0, len(time) - width + 1, width)
    if len(edges) < 8:
        return 0
    speed = np.array([np.polyfit(time[i : i + width], angle[i : i + width], 1)[0] for i in edges])
    duration = float(np.median(np.diff(time))) * width
    error = float(np.median(sigma)) * math.sqrt(12 / width) / duration
    size = np.abs(speed)
    if (
        speed.min() < -5 * error
        and speed.max() > 5 * error
        and min(-speed.min(), speed.max()) > 0.2 * size.max()
    ):
        return 0
    top = int(np.argmax(size))
    late = float(np.median(size[len(size) // 2 :]))
    rises = size[top] - size[0] > max(0.05 * size[top], 5 * error)
    if top == 0 or top > len(size) // 2 or not rises or late > 0.98 * size[top]:
        return 0
    return int(edges[top])


@dataclass(frozen=True)
class Wish:
    """What is asked of `spindown`.

    Attributes
    ----------
    hub : tuple of float, optional
        Centre of rotation (x, y) [px].
    capture_fps : float, optional
        Frames per second of the camera.
    inertia : str, optional
        Moment of inertia [kg m2], such as "5.5e-5 +- 0.1e-5"; without it torques are per unit of inertia [rad/s2].
    pulses_per_turn : float, optional
        The table is one column of times of pulses, so many of them a turn.
    keep_all : bool
        Keep the start of the record even where a hand or a motor drives the body.
    label : str
        Name of the case.
    """

    hub: tuple[float, float] | None = None
    capture_fps: float | None = None
    inertia: str | None = None
    pulses_per_turn: float | None = None
    keep_all: bool = False
    label: str = ""


def read_source(source: Path, wish: Wish, progress: Progress | None = None) -> tuple[Case, Tracked | None]:
    """Make a case of one body from a film, a recording or a table.

    Raises
    ------
    VideoError, TrackingError, DatasetError
        The source cannot be read, or shows no motion that can be measured.
    """
    moment = Inertia(1.0) if wish.inertia is None else Inertia.of(wish.inertia)
    if not source.is_file():
        raise DatasetError(f"There is no file {source}.", "Check the path.")
    tracked = None
    if source.suffix.lower() in _FILMS and wish.pulses_per_turn is None:
        recording, tracked = film_recording(source, wish, progress)
        case = _recording_case(recording, moment.value)
    elif source.suffix.lower() in (".h5", ".hdf5") and (found := _recording_in(source)) is not None:
        case = _recording_case(found, moment.value)
    else:
        options = ReadOptions(pulses_per_turn=wish.pulses_per_turn, fps=wish.capture_fps)
        case = import_body(source, moment.value, options=options, limits=Limits(keep_all=wish.keep_all))
    case = replace(case, I_casing_u=moment.u)
    warnings = list(case.warnings)
    if wish.inertia is None:
        warnings.append("No inertia is given: torques are per unit of inertia, in rad/s2 (inertia 1).")
    series = case.casing
    table = not case.recordings  # its reader has cut it
    first = 0 if wish.keep_all or table else start_of_motion(series.time, series.angle, series.sigma)
    if first:
        warnings.append(
            f"The body is driven until {series.time[first]:.3f} s (a hand or a motor); {first} samples before it are "
            "left out. --keep-all keeps them."
        )
        kept = {
            k: getattr(series, k)[first:] for k in ("time", "angle", "sigma", "omega", "omega_sigma", "turn")
        }
        series = replace(series, **kept)
    return replace(case, casing=series, warnings=tuple(warnings), label=wish.label or source.stem), tracked


def _recording_in(path: Path) -> Recording | None:
    try:
        return read_recording(path)
    except DatasetError:
        return None


def film_recording(source: Path, wish: Wish, progress: Progress | None = None) -> tuple[Recording, Tracked]:
    """Track one body in a film and make a recording of it."""
    film = Film(source)
    warnings = []
    if wish.capture_fps is not None:
        fps, origin = wish.capture_fps, "asked for"
        if not (math.isfinite(fps) and fps > 0):
            raise VideoError(f"a capture rate of {fps:g} fps is not possible", "give a positive number")
    elif film.info.tag_fps is not None:
        fps, origin = film.info.tag_fps, "tag of the camera"
    elif math.isfinite(film.info.container_fps):
        fps, origin = film.info.container_fps, "container"
        if fps < SLOWEST_PLAIN_RATE:
            warnings.append(
                f"Time from the container's rate, {fps:g} frames/s; a film in slow motion needs --capture-fps."
            )
    else:
        raise VideoError(f"{source} does not say at what rate it was captured", "give --capture-fps")
    tracked = track_body(film, wish.hub, progress)
    time_all = film.numbers / fps
    time = time_all[tracked.frame]
    sense = 1 if tracked.angle[-1] >= tracked.angle[0] else -1
    angle = sense * tracked.angle
    omega, omega_sigma = angular_velocity(time, angle, tracked.sigma, WIDTH)
    body = BodyTrack(
        name="casing",
        time=time,
        angle=angle,
        sigma=tracked.sigma,
        sigma_paper=np.full(len(time), np.nan),
        n_markers=np.ones(len(time), dtype=np.int64),
        omega=omega,
        omega_sigma=omega_sigma,
        smoothing_width=WIDTH,
    )
    centre = np.full((len(film), 2), np.nan)
    centre[tracked.frame] = np.array(tracked.ring.hub) + tracked.hub_path
    height, width = next(iter(film.frames(0, 1))).shape
    recording = Recording(
        source=source.name,
        source_sha256=file_sha256(source),
        width=width,
        height=height,
        capture_fps=fps,
        container_fps=film.info.container_fps,
        frames_declared=film.info.frames_declared,
        frames_decoded=len(film),
        sense=sense,
        body="casing",
        frame_index=np.asarray(film.numbers, dtype=np.int64),
        time=time_all,
        pts_time=film.stamps,
        centre=centre,
        centre_sigma=np.full(len(film), np.nan),
        markers={},
        bodies={"casing": body},
        warnings=(*warnings, *tracked.warnings, *gap_warnings(film.numbers)),
        extra={
            "times_from": "frames",
            "capture_rate_from": origin,
            "centre_from": tracked.way,
            "tracking": {
                "method": "registration of the polar picture",
                "hub_px": list(tracked.ring.hub),
                "stretch": list(tracked.ring.stretch),
                "ring_px": [tracked.ring.inner, tracked.ring.outer],
                "explained": tracked.explained,
                "scatter_over_bound": tracked.scale,
                "correlated_rad": tracked.correlated,
                "hub_motion_px": tracked.template.hub_sigma,
            },
        },
    )
    return recording, tracked


def _recording_case(recording: Recording, inertia: float) -> Case:
    """Put the one body of a recording in the casing's place."""
    if len(recording.bodies) != 1:
        raise DatasetError(
            f"The recording holds {len(recording.bodies)} bodies; one is needed.",
            "Use `gyrotrack sync` for two.",
        )
    body = next(iter(recording.bodies.values()))
    series = Series(
        body.time,
        body.angle,
        body.sigma,
        body.omega,
        body.omega_sigma,
        np.floor(body.angle / TURN).astype(np.int64),
        sigma_source="measured",
    )
    return Case(
        I_rotor=inertia,
        I_casing=inertia,
        label="",
        surface="",
        casing=series,
        rotor=no_series(),
        recordings={"casing": recording},
        placements={
            "casing": Placement("casing", 0.0, 0.0, 1.0, 0.0, 0.0, ambiguous=False, method="one film")
        },
        bodies="one",
        warnings=recording.warnings,
        extra={"sense": recording.sense, "smoothing_width": body.smoothing_width},
    )


def spindown(
    source: Path,
    target: Path,
    report: Path | None,
    wish: Wish,
    *,
    command: str,
    force: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Measure, fit, diagnose, improve and report the motion of one body.

    Parameters
    ----------
    source : Path
        Film, recording or table.
    target, report : Path
        The case and the report to write; no report without its path.
    wish : Wish
        Options.
    command : str
        The command line, for the case file.
    force : bool
        Replace existing outputs.
    progress : callable, optional
        Called with (frames done, frames in all) while a film is tracked.

    Returns
    -------
    dict
        The JSON document of `gyrotrack spindown`.
    """
    from fitting._errors import FittingError
    from fitting._workers import WorkerPool
    from fitting.discovery._select import improve
    from fitting.discovery._verdict import diagnose
    from fitting.study._serialisation import diagnosis_document

    case, tracked = read_source(source, wish, progress)
    series = case.casing
    motion = motion_of(series.time, series.angle, series.sigma)
    if motion.turns * TURN < 10 * float(np.median(series.sigma)):
        raise TrackingError(f"nothing turns in {source}", "check that it is the right file")
    settings = {"source": source, "hub": wish.hub, "capture_fps": wish.capture_fps, "inertia": wish.inertia}
    write_case(target, case, command=command, settings=settings, force=force)
    picture = None
    if tracked is not None:
        picture = target.with_suffix(".png")
        _write_picture(picture, Film(source), tracked)
    steps: list[Any] = []
    diagnosis: dict[str, Any] | None = None
    warnings = list(case.warnings)
    written = None
    try:
        study = open_study([target], None)
        with WorkerPool() as workers:
            base, parent = study.base(None)
            rungs = improve(base, [], workers=workers)
            steps = [entry.document["rung"] for entry in study.keep(rungs, parent)]
            found = diagnose(base, [], candidates=rungs[0].candidates, workers=workers)
            study.keep_diagnosis(parent, found, [])
            diagnosis = diagnosis_document(found, parent)
            if report is not None:
                shown = study.steps_to(None)
                recordings = [read_case(target)]
                where = {"command": command, "ledger": str(study.ledger.path)}
                write_report(
                    report,
                    shown,
                    found,
                    recordings=recordings,
                    films=[source.parent],
                    provenance=where,
                    force=force,
                )
                written = report
    except FittingError as error:
        warnings.append(f"No torque law is fitted: {error.message}")
    return {
        "case": target,
        "report": written,
        "picture": picture,
        "motion": motion,
        "ladder": steps,
        "diagnosis": diagnosis,
        "warnings": warnings,
    }


def _write_picture(path: Path, film: Film, tracked: Tracked) -> None:
    """Draw hub, ring and angle into four frames, with the learnt picture of the body below them."""
    ring = tracked.ring
    index = np.linspace(0, len(tracked.frame) - 1, 4).astype(int)
    tiles = []
    for k, picture in zip(index, film.some(np.unique(tracked.frame[index])), strict=False):
        tile: Any = cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
        phi = np.linspace(ring.start, ring.start + ring.span, 200)
        p, q = ring.stretch
        for radius in (ring.inner, ring.outer):
            x = ring.hub[0] + radius * ((1 + p) * np.cos(phi) + q * np.sin(phi))
            y = ring.hub[1] + radius * (q * np.cos(phi) + (1 - p) * np.sin(phi))
            points = np.stack([x, y], axis=1).clip(-30000, 30000).round().astype(np.int32)
            cv2.polylines(tile, [points], isClosed=False, color=(0, 255, 255), thickness=1)
        theta = -tracked.angle[k] + ring.start
        cos, sin = math.cos(theta), math.sin(theta)
        ends = [
            (
                round(float(np.clip(ring.hub[0] + r * ((1 + p) * cos + q * sin), -30000, 30000))),
                round(float(np.clip(ring.hub[1] + r * (q * cos + (1 - p) * sin), -30000, 30000))),
            )
            for r in (ring.inner, ring.outer)
        ]
        cv2.line(tile, ends[0], ends[1], (0, 0, 255), 2)
        tiles.append(tile)
    row: Any = np.hstack(tiles)
    scale = 1600 / row.shape[1]
    row = cv2.resize(row, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    learnt: Any = np.clip(tracked.template.body, 0, 255).astype(np.uint8)
    learnt = cv2.resize(cv2.cvtColor(learnt, cv2.COLOR_GRAY2BGR), (row.shape[1], 200))
    encoded = cv2.imencode(".png", np.vstack([row, learnt]))[1]
    with new_file(path, force=True) as stream:
        stream.write(encoded.tobytes())
