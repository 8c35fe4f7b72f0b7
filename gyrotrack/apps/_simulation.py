"""Simulated runs as case files and films."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fitting.dynamics._mesh import Sampler
from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR, Model
from fitting.effects._library import typical_of_model
from fitting.inference._record import Record, Samples
from fitting.inference._simulation import Experiment, simulate, simulate_path
from gyrotrack._errors import UsageError
from gyrotrack._smoothing import angular_velocity
from gyrotrack.io._hdf5 import write_case
from gyrotrack.io._records import Case, Series
from gyrotrack.synthetic._motion import Motion
from gyrotrack.synthetic._scene import Camera, Light, Scene
from gyrotrack.synthetic._truth import render_clip

_CASING_CLIP = "casing.mp4"
_EXPOSURE = 0.4
_STORED_FPS = 25.0
_TILT = 0.06
_POINTS_PER_SECOND = 500
_CASING_SPEED = 100.0  # rad/s at which an added effect has the torque that is asked for


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


@dataclass(frozen=True)
class SimulatedRun:
    """All that a simulated run comes from.

    Attributes
    ----------
    model : Model
        The equations.
    numbers : mapping of str to float
        Its parameters [SI].
    experiment : Experiment
        How it is started and filmed.
    inertias : tuple of float
        Moments of inertia of rotor and casing [kg m2].
    seed : int
        Random seed of all noise.
    """

    model: Model
    numbers: Mapping[str, float]
    experiment: Experiment
    inertias: tuple[float, float]
    seed: int

    @classmethod
    def of(
        cls,
        model: Model,
        strength: float,
        experiment: Experiment,
        inertias: tuple[float, float],
        seed: int,
        given: Sequence[str] = (),
    ) -> SimulatedRun:
        """Choose typical parameters for what is not given.

        Parameters
        ----------
        strength : float
            Torque of added effects over the budget of 1e-4 N m.
        given : sequence of str
            Parameters as ``casing.air.quadratic.k=1e-9``.

        Raises
        ------
        UsageError
            The model has effects of the measurement, or what is given is no parameter of it.
        """
        if model.measurement:
            raise UsageError(
                "Measurement effects cannot be simulated this way.",
                "For a centre offset give --centre-offset.",
            )
        speeds = {"omega_r": 0.6 * experiment.omega_rotor, "omega_c": _CASING_SPEED}
        numbers = typical_of_model(model.effects, strength, duration=experiment.duration, speeds=speeds)
        return cls(model, numbers | _given(given, numbers), experiment, inertias, seed)

    def record(self, label: str) -> Record:
        """Integrate the motion and measure it, with all noise.

        Parameters
        ----------
        label : str
            Name of the case.
        """
        return simulate(
            self.model,
            self.numbers,
            self.experiment,
            inertia_rotor=self.inertias[0],
            inertia_casing=self.inertias[1],
            seed=self.seed,
            label=label,
        )

    def film_files(self, folder: Path) -> list[Path]:
        """Return the names of the films: the casing's, then those of the rotor.

        Parameters
        ----------
        folder : Path
            Where the films are.
        """
        return [folder / clip.name for clip in _clips(self.experiment)]

    def films(
        self,
        folder: Path,
        *,
        force: bool = False,
        progress: Callable[[int, int | None], None] | None = None,
    ) -> list[Path]:
        """Draw the casing clip and the rotor clips.

        Parameters
        ----------
        folder : Path
            Where the films are written.
        force : bool
            Replace existing films.
        progress : callable, optional
            Called with the number of frames done and in all.

        Returns
        -------
        list of Path
            ``casing.mp4``, ``rotor_1.mp4`` and so on; the rotor clips are stored at 25 frames a second.
        """
        folder.mkdir(parents=True, exist_ok=True)
        inertias = {INERTIA_ROTOR: self.inertias[0], INERTIA_CASING: self.inertias[1]}
        motion = _motion(self.model, {**self.model.constants, **self.numbers, **inertias}, self.experiment)
        clips = _clips(self.experiment)
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
                seed=self.seed + done,
                force=force,
                progress=count,
            )
            written.append(folder / clip.name)
            done += clip.frames
        return written


def _given(items: Sequence[str], numbers: Mapping[str, float]) -> dict[str, float]:
    """Read ``casing.air.quadratic.k=1e-9``."""
    given = {}
    for item in items:
        key, equals, value = item.partition("=")
        key = key.strip()
        if not equals or key not in numbers:
            raise UsageError(
                f"{item[:60]!r} sets no parameter of the model.", f"It has: {', '.join(numbers)}."
            )
        try:
            given[key] = float(value)
        except ValueError:
            raise UsageError(f"{value[:30]!r} is not a number.", f"Write for example {key}=1e-9.") from None
    return given


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
