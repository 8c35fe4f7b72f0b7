"""Simulated runs as case files and films, and sealed challenges: runs with a hidden effect.

The commitment to an answer is the SHA-256 of a random salt and the text of the answer. It is stored in the case file
and in the seal, the file that contains the answer, so that a later change of either file is detected. In the seal, the
answer is XORed with a stream derived from the salt; this prevents accidental reading, but not deliberate reading.
"""

from __future__ import annotations

import base64
import hashlib
import json
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from fitting.dynamics._collocation import Sampler
from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR, Model
from fitting.effects._effect import Effect
from fitting.effects._library import LIBRARY, typical_of_model
from fitting.effects._user import resolve
from fitting.inference._record import Record, Samples
from fitting.inference._simulation import Experiment, simulate, simulate_path
from fitting.study._history import Entry
from gyrotrack._errors import DatasetError, UsageError
from gyrotrack._smoothing import angular_velocity
from gyrotrack.io._atomic import new_file
from gyrotrack.io._hdf5 import write_case
from gyrotrack.io._records import Case, Series, series_of
from gyrotrack.synthetic._film import render_clip
from gyrotrack.synthetic._scene import Camera, Light, Motion, Scene

_EXPOSURE = 0.4
_STORED_FPS = 25.0
_TILT = 0.06
_POINTS_PER_SECOND = 500
_CASING_SPEED = 100.0  # speed at which an added effect has the requested torque [rad/s]


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
    case = Case(
        I_rotor=record.I_rotor,
        I_casing=record.I_casing,
        I_rotor_u=record.I_rotor_u,
        I_casing_u=record.I_casing_u,
        label=record.label,
        surface=surface,
        casing=replace(_series([record.casing]), window=None),
        rotor=_series(record.rotor),
        quantity=record.quantity,
        start_u=max(record.start_sigma, default=0.0),
    )
    return write_case(path, case, command=command, settings=settings, force=force)


def _series(runs: Sequence[Samples]) -> Series:
    parts = []
    for s in runs:
        omega, sigma = angular_velocity(s.time, s.value, s.sigma)
        parts.append(
            SimpleNamespace(time=s.time, angle=s.value, sigma=s.sigma, omega=omega, omega_sigma=sigma)
        )
    return series_of(parts, sigma_source="given")


@dataclass(frozen=True)
class SimulatedRun:
    """The complete input of a simulated run.

    Attributes
    ----------
    model : Model
        The equations.
    numbers : mapping of str to float
        Its parameters [SI].
    experiment : Experiment
        Initial motion, cameras and noise.
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
        """Return a run, with typical values for parameters that are not given.

        Parameters
        ----------
        model : Model
            The model with its added effects.
        strength : float
            Torque of each added effect [1e-4 N m].
        experiment : Experiment
            Speeds, duration, cameras and noise.
        inertias : tuple of float
            Moments of inertia of rotor and casing [kg m2].
        seed : int
            Seed of the noise.
        given : sequence of str
            Parameters as ``casing.air.quadratic.k=1e-9``.

        Raises
        ------
        UsageError
            The model contains measurement effects, or a given parameter is not in the model.
        """
        if model.measurement:
            what = "Measurement effects cannot be added to a simulation."
            raise UsageError(what, "Use --centre-offset for a centre offset.")
        speeds = {"omega_r": 0.6 * experiment.omega_rotor, "omega_c": _CASING_SPEED}
        numbers = typical_of_model(model.effects, strength, duration=experiment.duration, speeds=speeds)
        return cls(model, numbers | _given(given, numbers), experiment, inertias, seed)

    def record(self, label: str) -> Record:
        """Integrate the motion and simulate its measurement, with all noise.

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
        """Return the paths of the films: first the film of the casing, then the films of the rotor.

        Parameters
        ----------
        folder : Path
            Folder of the films.
        """
        return [folder / clip.name for clip in _clips(self.experiment)]

    def films(
        self,
        folder: Path,
        *,
        force: bool = False,
        progress: Callable[[int, int | None], None] | None = None,
    ) -> list[Path]:
        """Render the casing clip and the rotor clips.

        Parameters
        ----------
        folder : Path
            Folder of the films.
        force : bool
            Replace existing films.
        progress : callable, optional
            Called with (frames done, frames in total).

        Returns
        -------
        list of Path
            ``casing.mp4``, ``rotor_1.mp4`` and so on; the rotor clips are stored at 25 frames a second.
        """
        folder.mkdir(parents=True, exist_ok=True)
        inertias = {INERTIA_ROTOR: self.inertias[0], INERTIA_CASING: self.inertias[1]}
        motion = _motion(self.model, {**self.model.constants, **self.numbers, **inertias}, self.experiment)
        clips = _clips(self.experiment)
        total, done = sum(clip.frames for clip in clips), 0
        for clip in clips:

            def count(k: int, _: int | None, before: int = done) -> None:
                if progress is not None:
                    progress(before + k, total)

            options: Any = {
                "frames": clip.frames,
                "seed": self.seed + done,
                "force": force,
                "progress": count,
            }
            render_clip(folder / clip.name, Scene(), motion, clip.camera, Light(), **options)
            done += clip.frames
        return self.film_files(folder)


def _given(items: Sequence[str], numbers: Mapping[str, float]) -> dict[str, float]:
    """Parse assignments like ``casing.air.quadratic.k=1e-9``."""
    given = {}
    for item in items:
        key, equals, value = item.partition("=")
        key = key.strip()
        if not equals or key not in numbers:
            what = f"{item[:60]!r} is not an assignment to a parameter of the model."
            raise UsageError(what, f"Parameters: {', '.join(numbers)}.")
        try:
            given[key] = float(value)
        except ValueError:
            raise UsageError(f"{value[:30]!r} is not a number.", f"Write, for example, {key}=1e-9.") from None
    return given


@dataclass(frozen=True)
class _Clip:
    """One film of an experiment: name, capture rate and stored rate [1/s], start and length [s]."""

    name: str
    fps: float
    stored: float
    start: float
    length: float

    @property
    def frames(self) -> int:
        # the first frame is one frame period after the start; the exposure of the last frame must end within `length`
        return int(self.length * self.fps) - 2

    @property
    def camera(self) -> Camera:
        start, exposure = self.start + 1 / self.fps, _EXPOSURE / self.fps
        return Camera(fps=self.fps, container_fps=self.stored, exposure=exposure, start=start, tilt=_TILT)


def _clips(e: Experiment) -> list[_Clip]:
    clips = [_Clip("casing.mp4", e.casing_fps, e.casing_fps, 0.0, e.duration)]
    for i, start in enumerate(e.windows, 1):
        clips.append(_Clip(f"rotor_{i}.mp4", e.rotor_fps, _STORED_FPS, start, e.window_length))
    return clips


def _motion(model: Model, values: Mapping[str, float], experiment: Experiment) -> Motion:
    _, path = simulate_path(model, values, experiment)
    time = np.linspace(0.0, experiment.duration, int(experiment.duration * _POINTS_PER_SECOND) + 1)
    sampler = Sampler(path.mesh, time)
    rotor, casing = (sampler.integral(*path.angle(s)) for s in ("omega_r", "omega_c"))
    return Motion.from_angles(time, rotor, casing)


FORMAT = "gyrotrack seal"
# laws that are not in the library: an answer with the law itself is graded "right"; an answer without any effect is
# graded "right class"
OUTSIDE = (
    "casing: -k*omega_c**3",
    "casing: -k*exp(-((omega_c - 110)/12)**2)",
    "bearing: k*log(abs(delta)/100)",
    "rotor: -k*omega_r**3",
)
_P_OUTSIDE = 0.2
_NOT_DRAWN = {"external.constant", "bearing.power", "casing.friction.presliding"}


@dataclass(frozen=True)
class Hidden:
    """A model with a randomly drawn effect, its strength, and the random seed."""

    model: Model
    effect: Effect
    strength: float
    seed: int

    def seal(self, path: Path, numbers: Mapping[str, float], *, force: bool = False) -> str:
        """Write the effect, with its parameters from `numbers`, to a seal; return the commitment."""
        own = {k: v for k, v in numbers.items() if k.startswith(f"{self.effect.name}.")}
        return seal(path, self.effect.name, own, force=force)


@dataclass(frozen=True)
class Seal:
    """The content of an opened seal: the name or law of the hidden effect, its parameters, and the commitment."""

    effect: str
    parameters: dict[str, float]
    commitment: str


@dataclass(frozen=True)
class Score:
    """The grade of an answer ("right", "right class" or "wrong"), and the normalised errors of its parameters."""

    grade: str
    sentence: str
    pulls: dict[str, float]


def draw_effect(present: Sequence[str], random: Any) -> Effect:
    """Draw an effect of the library that is not `present` and needs no reversals, or (20 %) a law of `OUTSIDE`."""
    if random.random() < _P_OUTSIDE:
        return resolve(OUTSIDE[int(random.integers(len(OUTSIDE)))])
    drawn = [n for n, e in LIBRARY.items() if e.kind == "physical" and e.searched and not e.restoring]
    names = [n for n in drawn if n not in present and n not in _NOT_DRAWN]
    return LIBRARY[names[int(random.integers(len(names)))]]


def hide_effect(model: Model, strength: float) -> Hidden:
    """Add a random effect to a model; its strength is between half and twice `strength`."""
    seed = secrets.randbits(48)
    random = np.random.default_rng(seed)
    effect = draw_effect(model.names, random)
    return Hidden(model.with_effect(effect), effect, float(strength * 2 ** random.uniform(-1, 1)), seed)


def seal(path: Path, effect: str, parameters: Mapping[str, float], *, force: bool = False) -> str:
    """Write the answer (an effect and its parameters) to a sealed JSON file; return its commitment."""
    salt = secrets.token_hex(16)
    answer = json.dumps({"effect": effect, "parameters": dict(parameters)}, sort_keys=True)
    commitment = hashlib.sha256(f"{salt}{answer}".encode()).hexdigest()
    document = {
        "format": FORMAT,
        "commitment": commitment,
        "salt": salt,
        "sealed": base64.b64encode(_xor_with_salt(answer.encode(), salt)).decode(),
    }
    with new_file(path, force=force) as stream:
        stream.write(json.dumps(document, indent=1).encode())
    return commitment


def unseal(path: Path) -> Seal:
    """Open a seal; raise a DatasetError if the file is not a seal, or the answer does not match the commitment."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        sealed = base64.b64decode(document["sealed"], validate=True)
        salt, commitment = str(document["salt"]), str(document["commitment"])
        answer = _xor_with_salt(sealed, salt).decode()
        content = json.loads(answer)
        effect = str(content["effect"])
        parameters = {str(k): float(v) for k, v in content["parameters"].items()}
    except FileNotFoundError:
        raise DatasetError(f"{path} does not exist.", "Check the name.") from None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        what = f"{path} is not a sealed file."
        raise DatasetError(what, "Sealed files are made by `gyrotrack simulate --hide`.") from None
    if hashlib.sha256(f"{salt}{answer}".encode()).hexdigest() != commitment:
        what = f"{path} was changed: the answer does not match its commitment."
        raise DatasetError(what, "Use the original file.")
    return Seal(effect, parameters, commitment)


# earlier versions wrote the second of these words
_WITHOUT_MISFIT = ("no_lack_of_fit", "adequate")


def answer_of(entries: Sequence[Entry]) -> tuple[list[str], dict[str, tuple[float, float]]]:
    """Return the effects added in a history of fits, and the parameters of the last fit that have a standard error.

    If the last fit has significant lack of fit, no effect is returned, because the added effects are hypotheses.
    """
    first, last = entries[0].document, entries[-1].document
    passes = last["verdict"] in _WITHOUT_MISFIT
    named = [n for n in last["model"] if n not in first["model"]] if passes else []
    return named, {k: (v["value"], v["stderr"]) for k, v in last["parameters"].items() if v["stderr"]}


def grade(truth: Seal, named: Sequence[str], found: Mapping[str, tuple[float, float]]) -> Score:
    """Grade an answer: `named` has an effect and the effects indistinguishable from it; `found` has (value, error)."""
    outside = truth.effect not in LIBRARY
    equivalent = {truth.effect} if outside else {truth.effect, *LIBRARY[truth.effect].equivalent}
    word = "right class" if set(named) & equivalent or (outside and not named) else "wrong"
    if named and named[0] in equivalent:
        word = "right"
    pulls = {
        k: (value - truth.parameters[k]) / error
        for k, (value, error) in found.items()
        if k in truth.parameters and error > 0
    }
    answer = ", ".join(named) if named else "none"
    return Score(word, f"Hidden effect: {truth.effect}. Answer: {answer} ({word}).", pulls)


def _xor_with_salt(data: bytes, salt: str) -> bytes:
    stream = b"".join(hashlib.sha256(f"{salt}{i}".encode()).digest() for i in range(len(data) // 32 + 1))
    return bytes(a ^ b for a, b in zip(data, stream, strict=False))
