"""What a pass through a film of the paper's gyroscope might have measured, made without a film."""

from dataclasses import fields

import numpy as np

from gyrotrack._column_store import in_file
from gyrotrack.tracking._film_tracker import BodyObservations, FilmObservations
from gyrotrack.tracking._marker_tracker import MarkerObservations
from gyrotrack.tracking._scene import Disc, Marker, Scene
from gyrotrack.video._time_base import FrameTimes

CENTRE, SIZE, FPS = (320.0, 180.0), (640, 360), 260.0
PAPERS = tuple(
    Marker(name, body, colour, inner, inner + 22.0, 0.12, (20.0, 30.0), 0.2, mount)
    for name, body, colour, inner, mount in (
        ("red", "casing", "red", 40.0, 0.0),
        ("blue", "rotor", "blue", 100.0, 0.4),
        ("white", "rotor", "white", 100.0, 2.5),
        ("green", "rotor", "green", 100.0, 4.6),
    )
)


def scene():
    return Scene(CENTRE, Disc(CENTRE, 10.0, (20.0, 30.0)), PAPERS)


def watched(count, seed=0):
    """Return so many frames of both bodies, with noise, errors by place, faults, gaps, and a bar over the rotor."""
    rng = np.random.default_rng(seed)
    time = np.arange(count) / FPS
    centre = CENTRE + 0.4 * np.stack([np.sin(0.9 * time), np.cos(0.7 * time)], axis=1)
    truth = {
        "casing": -62.0 * time - 2.0 * np.sin(0.3 * time),
        "rotor": -420.0 * time + 50.0 * time**2 / time[-1],
    }
    bodies = {}
    for body, angle in truth.items():
        coarse = angle + rng.normal(0.0, 4e-3, count)
        coarse[rng.random(count) < 1e-3] = np.nan
        markers = {p.name: _marker(p, angle, truth["casing"], centre, rng) for p in PAPERS if p.body == body}
        for seen in markers.values():
            seen.gain[np.isnan(coarse)] = np.nan
        bodies[body] = BodyObservations(coarse, markers)
    disc = centre + rng.normal(0.0, 0.1, centre.shape)
    return FilmObservations(
        bodies, disc, time, FrameTimes(np.arange(count)), (), SIZE, np.zeros(count, dtype=bool)
    )


def _marker(paper, body, casing, centre, rng):
    count = len(body)
    place = body + paper.mount
    hidden = (paper.body == "rotor") & (np.abs((place - casing + np.pi) % (2.0 * np.pi) - np.pi) < 0.35)
    angle = place + 1.5e-3 * np.sin(3.0 * place) + rng.normal(0.0, 1.2e-3, count) * np.where(hidden, 3.0, 1.0)
    angle[rng.random(count) < 3e-3] += 0.1
    corner = angle[:, None] + paper.half_width * np.array([-1.0, 1.0]) + rng.normal(0.0, 3e-3, (count, 2))
    corner[hidden] = np.nan
    columns = {
        "angle": (angle + np.pi) % (2.0 * np.pi) - np.pi,
        "radius": paper.radius + rng.normal(0.0, 0.1, count),
        "corner_angle": corner,
        "corner_radius": paper.inner + rng.normal(0.0, 0.1, (count, 2)),
        "gain": rng.normal(1.0, 0.03, count),
        "misfit": np.abs(rng.normal(0.04, 0.01, count)),
        "weakness": rng.uniform(0.95, 1.05, count) * np.where(hidden, 2.0, 1.0),
        "open": ~hidden,
        "centre": centre,
    }
    assert set(columns) == {f.name for f in fields(MarkerObservations)}
    return MarkerObservations(**in_file(columns))
