"""Simulated runs as case files and as films: where fitting's equations meet the renderer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fitting.dynamics import INERTIA_CASING, INERTIA_ROTOR
from fitting.model import Model
from fitting.record import Record, Samples
from fitting.simulation import Sampler
from fitting.simulation.recording import Experiment, simulate_path
from gyrotrack.angles import angular_velocity
from gyrotrack.dataset import write_case
from gyrotrack.dataset.records import Case, Series
from gyrotrack.synthetic import Camera, Light, Motion, Scene, render_clip

_CASING_CLIP = "casing.mp4"
_EXPOSURE = 0.4
_STORED_FPS = 25.0
_TILT = 0.06
_POINTS_PER_SECOND = 500


def write_record(
    path: Path,
    record: Record,
    *,
    surface: str,
    command: str,
    settings: Mapping[str, Any],
    force: bool = False,
) -> Path:
    """Write a simulated recording as a case file."""
    casing = _series([record.casing])
    rotor = _series(list(record.rotor))
    case = Case(
        I_rotor=record.I_rotor,
        I_casing=record.I_casing,
        label=record.label,
        surface=surface,
        casing=Series(**{**vars(casing), "window": None}),
        rotor=rotor,
        recordings={},
        placements={},
        rotor_generated=None,
        quantity=record.quantity,
    )
    return write_case(path, case, command=command, settings=settings, force=force)


def _series(runs: list[Samples]) -> Series:
    speeds = [angular_velocity(s.time, s.value, s.sigma) for s in runs]
    angle = np.concatenate([s.value for s in runs])
    return Series(
        time=np.concatenate([s.time for s in runs]),
        angle=angle,
        sigma=np.concatenate([s.sigma for s in runs]),
        omega=np.concatenate([omega for omega, _ in speeds]),
        omega_sigma=np.concatenate([sigma for _, sigma in speeds]),
        turn=np.floor(angle / (2 * np.pi)).astype(np.int64),
        window=np.concatenate([np.full(len(s), i, dtype=np.int64) for i, s in enumerate(runs)]),
        sigma_source="given",
    )


def draw_films(
    folder: Path,
    model: Model,
    numbers: Mapping[str, float],
    experiment: Experiment,
    inertias: tuple[float, float],
    seed: int,
    *,
    force: bool = False,
    progress: Callable[[int, int | None], None] | None = None,
) -> list[Path]:
    """Draw the casing clip and the rotor clips of a simulated run.

    Returns
    -------
    list of Path
        ``casing.mp4``, ``rotor_1.mp4`` and so on; the rotor clips are stored at 25 frames a second.
    """
    folder.mkdir(parents=True, exist_ok=True)
    values = {**model.constants, **numbers, INERTIA_ROTOR: inertias[0], INERTIA_CASING: inertias[1]}
    motion = _motion(model, values, experiment)
    clips = _clips(experiment)
    total = sum(clip.frames for clip in clips)
    done, written = 0, []
    for clip in clips:

        def count(k: int, _: int | None, before: int = done) -> None:
            if progress is not None:
                progress(before + k, total)

        render_clip(
            folder / clip.name,
            Scene(),
            motion,
            clip.camera,
            Light(),
            frames=clip.frames,
            seed=seed + done,
            force=force,
            progress=count,
        )
        written.append(folder / clip.name)
        done += clip.frames
    return written


@dataclass(frozen=True)
class _Clip:
    """One film of an experiment: name, capture rate and stored rate [1/s], when it starts and its length [s]."""

    name: str
    fps: float
    stored: float
    start: float
    length: float

    @property
    def frames(self) -> int:
        # the first frame is taken one frame after the start, and the last one must lie inside too
        return int(self.length * self.fps) - 2

    @property
    def camera(self) -> Camera:
        start, exposure = self.start + 1 / self.fps, _EXPOSURE / self.fps
        return Camera(fps=self.fps, container_fps=self.stored, exposure=exposure, start=start, tilt=_TILT)


def _clips(e: Experiment) -> list[_Clip]:
    casing = _Clip(_CASING_CLIP, e.casing_fps, e.casing_fps, 0.0, e.duration)
    rotor = [
        _Clip(f"rotor_{i}.mp4", e.rotor_fps, _STORED_FPS, start, e.window_length)
        for i, start in enumerate(e.windows, 1)
    ]
    return [casing, *rotor]


def _motion(model: Model, values: Mapping[str, float], experiment: Experiment) -> Motion:
    _, path = simulate_path(model, values, experiment)
    time = np.linspace(0.0, experiment.duration, int(experiment.duration * _POINTS_PER_SECOND) + 1)
    sampler = Sampler(path.mesh, time)
    rotor, casing = (sampler.integral(*path.angle(s)) for s in ("omega_r", "omega_c"))
    return Motion.from_angles(time, rotor, casing)
