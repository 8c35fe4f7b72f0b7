"""Putting the results of tracking into the records that the dataset keeps."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gyrotrack.angles.departures import wrapped
from gyrotrack.angles.joining import BodyAngles
from gyrotrack.angles.sightings import Sightings
from gyrotrack.angles.uncertainty import paper_angle
from gyrotrack.angles.velocity import WIDTH, angular_velocity
from gyrotrack.dataset.records import STATUS, BodyTrack, MarkerTrack
from gyrotrack.geometry.scene import Paper

Floats = npt.NDArray[np.float64]
Codes = npt.NDArray[np.int8]


def marker_track(
    paper: Paper,
    seen: Sightings,
    body: BodyAngles,
    centre: Floats,
    sense: int,
    size: tuple[int, int],
) -> MarkerTrack:
    """Build the record of one marker; its corners are given only where nothing hides the marker."""
    found = body.markers[paper.name]
    status = _status(paper, seen, np.isfinite(found.angle), size)
    ok = status == STATUS["ok"]
    corner = _corners(seen)
    corner[~ok] = np.nan
    measured = paper_angle(corner, centre, ok)
    return MarkerTrack(
        name=paper.name,
        body=paper.body,
        mount_angle=float(np.angle(np.exp(1j * sense * found.mount))),
        corner=corner if sense > 0 else corner[:, ::-1],
        delta=measured.delta,
        rho=measured.rho,
        beta=measured.beta,
        angle=wrapped(sense * measured.angle),
        sigma=measured.sigma,
        u_r=measured.u_r,
        u_1=measured.u_1,
        u_2=measured.u_2,
        status=status,
        angle_fine=wrapped(sense * found.angle),
        sigma_calibrated=found.sigma,
    )


def _corners(seen: Sightings) -> Floats:
    """Return the near corners in the picture, (n, 2, 2) in px, the one with the lower angle as seen first."""
    x = seen.centre[:, None, 0] + seen.corner_radius * np.cos(seen.corner_angle)
    y = seen.centre[:, None, 1] - seen.corner_radius * np.sin(seen.corner_angle)
    return np.stack([x, y], axis=-1)


def _status(paper: Paper, seen: Sightings, used: npt.NDArray[np.bool_], size: tuple[int, int]) -> Codes:
    """Say for each frame how a marker was seen.

    ok: whole, with both corners. blurred: whole, but its corners are not to be made out. occluded: something
    stands before a part of it. out_of_frame: a part lies outside the picture. lost: nothing like it where it
    should be.
    """
    status = np.full(len(used), STATUS["lost"], dtype=np.int8)
    status[np.isfinite(seen.angle) & ~seen.open] = STATUS["occluded"]
    status[used & seen.open] = STATUS["blurred"]
    status[used & seen.open & np.isfinite(seen.corner_angle).all(axis=1)] = STATUS["ok"]
    status[seen.outside(paper.inner, paper.outer, 0.7 * paper.half_width, size)] = STATUS["out_of_frame"]
    return status


def body_track(
    name: str, body: BodyAngles, markers: dict[str, MarkerTrack], time: Floats, sense: int
) -> BodyTrack:
    """Build the record of one body from the frames in which its angle is known.

    `sigma_paper` is the paper's uncertainty of the mean of the markers that were whole in a frame,
    sqrt(sum sigma_m^2) / n, and NaN where there was none.
    """
    use = np.isfinite(body.angle)
    angle, sigma = sense * body.angle[use], body.sigma[use]
    omega, omega_sigma = angular_velocity(time[use], angle, sigma, WIDTH)
    own = np.stack([markers[m].sigma for m in body.markers])
    known = np.isfinite(own)
    count = known.sum(axis=0)
    total = np.sqrt((np.where(known, own, 0.0) ** 2).sum(axis=0))
    paper = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return BodyTrack(
        name=name,
        time=time[use],
        angle=angle,
        sigma=sigma,
        sigma_paper=paper[use],
        n_markers=body.count[use],
        omega=omega,
        omega_sigma=omega_sigma,
        smoothing_width=WIDTH,
    )
