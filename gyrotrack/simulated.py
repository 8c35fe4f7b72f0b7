"""Simulated runs as case files and as films: where fitting's equations meet the renderer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fitting.model import INERTIA_CASING, INERTIA_ROTOR, Model
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
    _, path = simulate_path(model, values, experiment)
    time = np.linspace(0.0, experiment.duration, int(experiment.duration * 500) + 1)
    sampler = Sampler(path.mesh, time)
    turned = [sampler.integral(*path.angle(s)) for s in ("omega_r", "omega_c")]
    motion = Motion.from_angles(time, turned[0], turned[1])
    clips: list[tuple[str, float, float, float, float]] = [
        (_CASING_CLIP, experiment.casing_fps, experiment.casing_fps, 0.0, experiment.duration)
    ]
    clips += [
        (f"rotor_{i}.mp4", experiment.rotor_fps, _STORED_FPS, start, experiment.window_length)
        for i, start in enumerate(experiment.windows, 1)
    ]
    total = sum(int(length * fps) - 2 for _, fps, _, _, length in clips)
    done, written = 0, []
    for name, fps, stored, start, length in clips:
        frames = int(length * fps) - 2

        def count(k: int, _: int | None, before: int = done) -> None:
            if progress is not None:
                progress(before + k, total)

        camera = Camera(
            fps=fps, container_fps=stored, exposure=_EXPOSURE / fps, start=start + 1 / fps, tilt=0.06
        )
        render_clip(
            folder / name,
            Scene(),
            motion,
            camera,
            Light(),
            frames=frames,
            seed=seed + done,
            force=force,
            progress=count,
        )
        written.append(folder / name)
        done += frames
    return written
