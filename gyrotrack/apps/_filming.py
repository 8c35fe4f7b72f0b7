"""Rendered films that imitate the films of a case: they show the scene of the case with the motion of a fit.

Image size, frame rates, start times, centre and tilt are taken from the recordings. The markers have the radii, widths,
mount angles and colours that `extract` measured. The exposure follows from the motion blur of the rotor's markers: on
each side, the blur widens a marker by half the product of speed and exposure. The image noise is chosen so that the
tracked angles scatter as in the recordings. Metal, table, lamps and lens are the defaults of the package's renderer,
because they are not measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gyrotrack._errors import DatasetError
from gyrotrack.io._hdf5 import read_recording
from gyrotrack.io._records import Case, Recording
from gyrotrack.synthetic._film import render_clip
from gyrotrack.synthetic._scene import PAPERS, WHITE, Camera, Colour, Light, Marker, Motion, Scene

# chroma below which a marker counts as colourless; luma of a coloured marker, assumed because recordings do not contain
# it [grey levels]
_COLOURLESS, _LUMA = 5.0, 110.0
# exposure if the motion blur does not determine it, and limits of the exposure [frame period]
_USUAL_EXPOSURE, _EXPOSURES = 0.4, (0.02, 0.95)
# trial film that determines the image noise: number of frames, noise of the trial, limits of the result [grey levels]
_TRIAL, _TRIAL_NOISE, _NOISES = 1200, 2.0, (0.3, 12.0)
# outer radius of the paper's casing markers [mm]
_OUTER = max(p.near + p.length for p in PAPERS if p.body == "casing")

Command = Callable[[Sequence[str]], Mapping[str, Any]]


@dataclass(frozen=True)
class Filming:
    """Scene of a case, and its cameras: the camera of the casing's film, then the camera of each rotor film.

    Attributes
    ----------
    scene : Scene
        Bodies and markers.
    cameras : tuple of Camera
        The start of a camera is the time of its first frame on the clock of the case.
    frames : tuple of int
        Number of frames of each film.
    sigma : tuple of float
        Median standard uncertainty of the angle of casing or rotor in each film [rad].
    """

    scene: Scene
    cameras: tuple[Camera, ...]
    frames: tuple[int, ...]
    sigma: tuple[float, ...]

    @classmethod
    def of(cls, case: Case) -> Filming:
        """Return the scene and the cameras of a case that `sync` made from films.

        Parameters
        ----------
        case : Case
            The case.

        Raises
        ------
        DatasetError
            The case has no films of two bodies, or the films contain no measured markers.
        """
        names = sorted(n for n in case.recordings if n.startswith("rotor_"))
        if case.bodies != "two" or "casing" not in case.recordings or not names:
            what = "This case was not made from films of casing and rotor."
            raise DatasetError(what, "Omit --film: recordings are then simulated as data.")
        films = [case.recordings[n] for n in ("casing", *names)]
        places = [case.placements.get(n) for n in ("casing", *names)]
        starts = [0.0 if p is None else p.clock_offset for p in places]
        scale = _paper(films[0], "casing")["outer"] / _OUTER
        scene = _scene(films[0], films[1], scale)
        share = _exposure(films[0], films[1:]) * films[0].capture_fps
        cameras = tuple(_camera(f, s, scale, share) for f, s in zip(films, starts, strict=True))
        bodies = ["casing", *["rotor"] * len(names)]
        sigma = tuple(float(np.median(f.bodies[b].sigma)) for f, b in zip(films, bodies, strict=True))
        # the exposures of the first and the last frame are within the duration of the motion
        return cls(scene, cameras, tuple(f.frames_decoded - 2 for f in films), sigma)

    def with_measured_noise(self, motion: Motion, folder: Path, run: Command, seed: int) -> Filming:
        """Return a copy with the image noise for which the angles of a trial film scatter as in the recordings.

        Parameters
        ----------
        motion : Motion
            Motion of both bodies on the clock of the case.
        folder : Path
            Folder in which the trial is rendered and tracked.
        run : callable
            Runs a command of the program, and returns its exit code and JSON document.
        seed : int
            Seed of the trial.
        """
        noise = {}
        for i in (0, 1):
            trial = replace(self.cameras[i], noise=_TRIAL_NOISE)
            film = folder / f"trial_{i}.mp4"
            render_clip(
                film, self.scene, motion, trial, Light(), frames=min(_TRIAL, self.frames[i]), seed=seed
            )
            recording = _extracted(film, trial, run)
            body = recording.bodies.get("rotor" if i else "casing") if recording is not None else None
            ratio = self.sigma[i] / float(np.median(body.sigma)) if body is not None else 1.0
            noise[i] = float(np.clip(_TRIAL_NOISE * ratio, *_NOISES))
        cameras = (replace(c, noise=noise[min(i, 1)]) for i, c in enumerate(self.cameras))
        return replace(self, cameras=tuple(cameras))

    def recorded(
        self, motion: Motion, folder: Path, run: Command, inertias: Sequence[str], seed: int
    ) -> Path | None:
        """Render the films, track and synchronise them; return the case, or None if one of these steps fails.

        Parameters
        ----------
        motion, folder, run, seed
            As for `with_measured_noise`.
        inertias : sequence of str
            Options of `sync` for moments of inertia and label.
        """
        files = []
        for i, (camera, frames) in enumerate(zip(self.cameras, self.frames, strict=True)):
            film = folder / (f"rotor_{i}.mp4" if i else "casing.mp4")
            render_clip(film, self.scene, motion, camera, Light(), frames=frames, seed=seed + i)
            if _extracted(film, camera, run) is None:
                return None
            film.unlink()
            files.append(str(film.with_suffix(".h5")))
        case = folder / "case.h5"
        run(["sync", *files, "-o", str(case), *inertias])
        return case if case.exists() else None


def _extracted(film: Path, camera: Camera, run: Command) -> Recording | None:
    target = film.with_suffix(".h5")
    run(["extract", str(film), "--capture-fps", f"{camera.fps:g}", "-o", str(target), "--workers", "1"])
    return read_recording(target) if target.exists() else None


def _paper(film: Recording, body: str) -> dict[str, Any]:
    papers = film.extra.get("papers") or {}
    found = [papers[n] for n, m in film.markers.items() if m.body == body and n in papers]
    if not found:
        what = f"{film.source} contains no measured marker of the {body}."
        raise DatasetError(what, "Track the film with markers, or omit --film.")
    return dict(found[0])


def _scene(casing: Recording, rotor: Recording, scale: float) -> Scene:
    """Return the scene, with the markers of each body from its own film."""
    markers, usual = [], Scene()
    for film, body in ((casing, "casing"), (rotor, "rotor")):
        papers = film.extra.get("papers") or {}
        _paper(film, body)
        for name, marker in film.markers.items():
            if marker.body != body or name not in papers:
                continue
            p = papers[name]
            middle = 0.5 * (p["inner"] + p["outer"])
            length, base = (p["outer"] - p["inner"]) / scale, 2 * middle * math.tan(p["half_width"]) / scale
            colour = _colour(*p["contrast"])
            markers.append(
                Marker(name, "casing" if body == "casing" else "rotor", colour, marker.mount_angle,
                       p["inner"] / scale, length, base)
            )  # fmt: skip
    disc = usual.circle_colour if casing.extra.get("centre_from") == "disc" else (usual.metal,) * 3
    return replace(usual, markers=tuple(markers), circle_colour=disc)


def _colour(cb: float, cr: float) -> Colour:
    """Return the linear colour of a marker from its chroma relative to the metal (BT.601), or white without chroma."""
    if abs(cr) < _COLOURLESS:
        return WHITE
    grey = (_LUMA + 1.402 * cr, _LUMA - 0.344 * cb - 0.714 * cr, _LUMA + 1.772 * cb)
    red, green, blue = (float(np.clip(g / 255, 0.02, 0.95)) ** Camera().gamma for g in grey)
    return red, green, blue


def _exposure(casing: Recording, rotor: Sequence[Recording]) -> float:
    """Return the exposure of the casing's film from the smear of the rotor's markers [s].

    The width of the markers was measured in the sharpest frames, in which the rotor is slowest. The smear is
    proportional to the exposure, so in the film with the higher frame rate it is smaller by the ratio of the frame
    periods.
    """
    period = 1 / casing.capture_fps
    slow, fast = (film.extra.get("papers") or {} for film in (casing, rotor[0]))
    both = [n for n in slow.keys() & fast.keys() if n in casing.markers and casing.markers[n].body == "rotor"]
    speeds = [np.nanmin(np.abs(f.bodies["rotor"].omega)) for f in rotor if "rotor" in f.bodies]
    share = 1 - casing.capture_fps / rotor[0].capture_fps
    found = math.nan
    if both and speeds and min(speeds) > 0 and share > 0:
        wider = float(np.median([slow[n]["half_width"] - fast[n]["half_width"] for n in both]))
        found = 2 * wider / float(min(speeds)) / share
    low, high = (x * period for x in _EXPOSURES)
    return found if low <= found <= high else _USUAL_EXPOSURE * period


def _camera(film: Recording, start: float, scale: float, share: float) -> Camera:
    tilt = (film.extra.get("tilt") or {}).get("casing") or {}
    p, q = (float(tilt.get(k) or 0.0) for k in "pq")
    x, y = np.nanmedian(film.centre, axis=0)
    fps = film.capture_fps
    return Camera(
        width=film.width - film.width % 2, height=film.height - film.height % 2, fps=fps,
        container_fps=film.container_fps, exposure=share / fps, scale=scale, centre=(float(x), float(y)),
        tilt=float(tilt.get("angle") or 0.0), tilt_azimuth=0.5 * math.atan2(q, p), start=start + 1 / fps,
        sense=film.sense,
    )  # fmt: skip
