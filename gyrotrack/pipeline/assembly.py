"""Putting the results of tracking into the records that the dataset keeps."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gyrotrack.angles.departures import wrapped
from gyrotrack.angles.joining import BodyAngles
from gyrotrack.angles.sightings import Sightings
from gyrotrack.angles.uncertainty import paper_angle
from gyrotrack.angles.velocity import WIDTH, angular_velocity
from gyrotrack.dataset.columns import new_columns, put_away, stretches
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
    kinds = {"corner": ((2, 2), "f8"), "status": ((), "i1"), "angle_fine": ((), "f8")}
    own = new_columns(len(found.angle), kinds)
    for part in stretches(len(found.angle)):
        some, angle = seen.at(part), found.angle[part]
        own["status"][part] = status = _status(paper, some, np.isfinite(angle), size)
        own["corner"][part] = np.where((status == STATUS["ok"])[:, None, None], _corners(some), np.nan)
        own["angle_fine"][part] = wrapped(sense * angle)
    measured = paper_angle(own["corner"], centre, own["status"] == STATUS["ok"])
    for part in stretches(len(found.angle)):
        measured.angle[part] = wrapped(sense * measured.angle[part])
    return MarkerTrack(
        name=paper.name,
        body=paper.body,
        mount_angle=float(np.angle(np.exp(1j * sense * found.mount))),
        corner=own["corner"] if sense > 0 else own["corner"][:, ::-1],
        delta=measured.delta,
        rho=measured.rho,
        beta=measured.beta,
        angle=measured.angle,
        sigma=measured.sigma,
        u_r=measured.u_r,
        u_1=measured.u_1,
        u_2=measured.u_2,
        status=own["status"],
        angle_fine=own["angle_fine"],
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
    columns = {"time": time[use], "angle": angle, "sigma": sigma, "n_markers": body.count[use]}
    columns["sigma_paper"] = _paper_sigma([markers[m].sigma for m in body.markers])[use]
    columns["omega"], columns["omega_sigma"] = angular_velocity(columns["time"], angle, sigma, WIDTH)
    return BodyTrack(name=name, smoothing_width=WIDTH, **put_away(columns))


def _paper_sigma(own: list[Floats]) -> Floats:
    """Return sqrt(sum sigma_m^2) / n over the n markers whose uncertainty is known, (n,); NaN where there is none."""
    out = np.empty(len(own[0]))
    for part in stretches(len(out)):
        sigma = np.stack([one[part] for one in own])
        known = np.isfinite(sigma)
        count = known.sum(axis=0)
        total = np.sqrt((np.where(known, sigma, 0.0) ** 2).sum(axis=0))
        out[part] = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return out
