"""The work that the workbench does in other processes: commands, and the ranking of candidate effects.

A job is one command with ``--json``; it reports progress and angles as JSON lines on stderr (see
`gyrotrack.apps.cli._output`) and its document on stdout. A cancelled or killed `extract` keeps its checkpoint.

Candidates are ranked by ``python -m gyrotrack.apps.workbench._processes CASE``, which reads one JSON document per line
(an entry of a ledger), writes one line for each, and ends when its input ends. Each answer contains the ranking and the
residuals that each candidate predicts. The same class `Prediction` serves the sliders of the page.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from threading import Lock
from time import monotonic
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from fitting._errors import FittingError
from fitting._numbers import to_json
from gyrotrack._errors import GyrotrackError, UsageError
from gyrotrack.apps.batch._workers import end_process
from gyrotrack.apps.workbench._growing_motion import GrowingMotion

if TYPE_CHECKING:
    from fitting.discovery._score import CaseColumns
    from fitting.discovery._select import Candidate
    from fitting.effects._effect import Effect
    from fitting.inference._problem import Projection
    from fitting.inference._result import Fit

_BACKGROUND = 10  # added to the niceness of computations, so that requests of the page have priority


def in_background(process: int) -> None:
    """Lower the priority of a process, if the system supports priorities."""
    with suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, process, os.getpriority(os.PRIO_PROCESS, 0) + _BACKGROUND)


State = Literal["waiting", "running", "done", "failed", "cancelled"]

_GRACE = 5.0  # time for a process to save its checkpoint and remove unfinished outputs [s]
_MAX_ANSWER = 2**26  # largest size of a document [bytes]


@dataclass
class Job:
    """One command."""

    # `words` are the arguments of ``python -m module``; the default module is `gyrotrack`
    words: tuple[str, ...]
    module: str = "gyrotrack"
    state: State = "waiting"  # state of the job
    # progress of the command
    label: str = ""
    done: int = 0
    total: int | None = None
    document: dict[str, Any] = field(
        default_factory=dict
    )  # JSON document of the command, or ``{"error": ...}``
    began: float = field(default_factory=monotonic)
    process: subprocess.Popen[str] | None = None
    motion: GrowingMotion = field(default_factory=GrowingMotion)  # angles that the command has found so far

    @property
    def is_active(self) -> bool:
        """Whether the job is waiting or running."""
        return self.state in ("waiting", "running")

    def summary(self) -> dict[str, Any]:
        """Return the state for the page."""
        error = self.document.get("error") or {}
        return {
            "state": self.state,
            "label": self.label,
            "done": self.done,
            "total": self.total,
            "angles": self.motion.reported,
            "seconds": round(monotonic() - self.began, 1) if self.is_active else None,
            "message": " ".join(
                x if x[-1] in ".?!" else f"{x}." for x in (error.get("message"), error.get("hint")) if x
            ),
        }


class Jobs:
    """The jobs of one work folder: at most `most` jobs run at a time, and at most one job per key."""

    def __init__(self, folder: Path, most: int) -> None:
        self._folder = folder
        self._slots = threading.BoundedSemaphore(max(1, most))
        self._lock = threading.RLock()
        self._jobs: dict[str, Job] = {}
        self._threads: set[threading.Thread] = set()
        self._closed = False

    def active(self) -> dict[str, dict[str, Any]]:
        """Return the summaries of all waiting and running jobs."""
        return {k: j.summary() for k, j in list(self._jobs.items()) if j.is_active}

    def get(self, key: str) -> Job | None:
        """Return the latest job of a key."""
        return self._jobs.get(key)

    def start(
        self,
        key: str,
        words: Sequence[str],
        finished: Callable[[Job], None],
        *,
        module: str = "gyrotrack",
        replace: bool = False,
    ) -> Job:
        """Queue a command; `finished` is called in a separate thread when the command has ended.

        If the latest job of the key is active, an error is raised or, with `replace`, that job is cancelled.
        """
        with self._lock:
            old = self._jobs.get(key)
            if old is not None and old.is_active:
                if not replace:
                    what = "This step is already running."
                    raise UsageError(what, "Wait until it has ended, or cancel it.")
                self.cancel(key)
            if self._closed:
                raise UsageError("The workbench is closing.", "Start it again.")
            job = self._jobs[key] = Job(tuple(words), module)
            thread = threading.Thread(target=self._run, args=(job, finished), daemon=True)
            self._threads.add(thread)
            thread.start()
            return job

    def cancel(self, key: str) -> None:
        """Cancel the job of a key if it is active."""
        with self._lock:
            job = self._jobs.get(key)
            if job is None or not job.is_active:
                return
            job.state = "cancelled"
            process = job.process
        if process is not None:
            end_process(process)

    def _run(self, job: Job, finished: Callable[[Job], None]) -> None:
        try:
            with self._slots:
                with self._lock:
                    if job.state != "waiting" or self._closed:
                        job.state = "cancelled"
                    else:
                        job.state, job.began = "running", monotonic()
                        with suppress(OSError):
                            job.process = self._started(job)
                            in_background(job.process.pid)
                if job.process is not None:
                    self._follow(job, job.process)
                elif job.state == "running":
                    job.state = "failed"
                    job.document = _error("No process could be started.", "End other programs and try again.")
            finished(job)
        finally:
            self._threads.discard(threading.current_thread())

    def _started(self, job: Job) -> subprocess.Popen[str]:
        tail = ["--json"] if job.module == "gyrotrack" else []
        environment = {**os.environ, "GYROTRACK_PROGRESS": "json", "PYTHONUTF8": "1", "PYTHONSAFEPATH": "1"}
        return subprocess.Popen(  # noqa: S603 - gyrotrack itself, without a shell
            [sys.executable, "-P", "-m", job.module, *job.words[:1], *tail, *job.words[1:]],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            cwd=self._folder,
            text=True,
            encoding="utf-8",
            errors="replace",
            env=environment,
            start_new_session=True,  # Ctrl-C is handled by the server
        )

    def _follow(self, job: Job, process: subprocess.Popen[str]) -> None:
        """Read the progress and the document of a process until it ends."""
        assert process.stdout is not None and process.stderr is not None  # noqa: S101, PT018 - opened as pipes
        progress = threading.Thread(target=_listen, args=(job, process.stderr), daemon=True)
        progress.start()
        answer = process.stdout.read(_MAX_ANSWER)
        process.wait()
        progress.join(_GRACE)
        process.stdout.close()
        process.stderr.close()
        with self._lock:
            job.process = None
            if job.state == "cancelled":
                return
            try:
                job.document = dict(json.loads(answer))
            except (ValueError, TypeError):
                job.document = _error(f"The process ended with code {process.returncode}.", "Run it again.")
            job.state = "failed" if "error" in job.document else "done"

    def close(self) -> None:
        """End all processes and wait for them."""
        with self._lock:
            self._closed = True
            active = [job for job in self._jobs.values() if job.is_active]
            for job in active:
                job.state = "cancelled"
                if job.process is not None and job.process.poll() is None:
                    with suppress(OSError):
                        job.process.terminate()
        for job in active:
            if job.process is not None:
                end_process(job.process)
        for thread in list(self._threads):
            thread.join(_GRACE)


def _listen(job: Job, stream: Any) -> None:
    with suppress(ValueError, OSError):  # the stream is closed already
        for line in stream:
            with suppress(ValueError, KeyError, TypeError):
                if line.startswith('{"angles"'):
                    job.motion.add(json.loads(line)["angles"])
                elif line.startswith('{"progress"'):
                    found = json.loads(line)["progress"]
                    job.label, job.done, job.total = found["label"], found["done"], found["total"]


def _error(message: str, hint: str) -> dict[str, Any]:
    return {"error": {"code": "process", "message": message, "hint": hint}}


Array = NDArray[np.float64]


class Ranker:
    """A process that ranks candidates for the latest requested model of a case file."""

    def __init__(self, case: Path) -> None:
        self._case = case
        self._lock = Lock()
        self._process: subprocess.Popen[str] | None = None
        self._busy = False
        self._closed = False
        self._began = 0.0
        self._seconds: float | None = None  # duration of the last search

    def progress(self) -> dict[str, Any]:
        """Return the elapsed and the expected duration of the search [s]; empty without a search."""
        if not self._busy:
            return {}
        return {"seconds": round(monotonic() - self._began, 2), "expected": self._seconds}

    def cancel(self) -> None:
        """End the search."""
        with self._lock:
            if self._busy:
                self._end()

    def rank(self, model: dict[str, Any]) -> dict[str, Any]:
        """Return the diagnosis of a model; an unfinished search is cancelled, and its call raises a GyrotrackError."""
        with self._lock:
            if self._busy:
                self._end()
            process = self._started()
            self._busy, began = True, monotonic()
            self._began = began
        try:
            assert process.stdin is not None and process.stdout is not None  # noqa: S101, PT018 - opened as pipes
            process.stdin.write(json.dumps(model) + "\n")
            process.stdin.flush()
            line = process.stdout.readline()
        except (OSError, ValueError):
            line = ""
        with self._lock:
            newest = process is self._process
            if newest:
                self._busy = False
        if not line:
            raise GyrotrackError(f"The search {'failed' if newest else 'was cancelled'}.")
        self._seconds = monotonic() - began
        return dict(json.loads(line))

    def _started(self) -> subprocess.Popen[str]:
        if self._closed:
            raise GyrotrackError("The workbench is closing.")
        if self._process is None or self._process.poll() is not None:
            self._process = subprocess.Popen(  # noqa: S603 - gyrotrack itself, without a shell
                [sys.executable, "-m", "gyrotrack.apps.workbench._processes", str(self._case)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            in_background(self._process.pid)
        return self._process

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        self._process, self._busy = None, False

    def close(self) -> None:
        """End the process."""
        with self._lock:
            self._closed = True
            self._end()


_MAX_CANDIDATES = 12  # largest number of candidates on the page; their effects on the residual are predicted


def _answer(line: str, case: Path) -> dict[str, Any]:
    from fitting.discovery._score import CaseColumns
    from fitting.discovery._verdict import diagnose
    from fitting.inference._case_data import CaseData
    from fitting.inference._case_file import read_record
    from fitting.study._history import Entry
    from fitting.study._serialisation import diagnosis_document

    try:
        fit = Entry(json.loads(line)).refit([CaseData.of(read_record(case))])
        found = diagnose(fit)
        prediction, columns = Prediction(fit), CaseColumns(fit, 0)
        shown = [c for c in found.candidates if c.score > 0][:_MAX_CANDIDATES]
        document: Any = diagnosis_document(found, "")
        excess = max(prediction.misfit**2 - 1.0, 1e-12)
        for c, row in zip(found.candidates, document["candidates"], strict=True):
            row |= {"fits": c.effect.signature, "contradiction": contradiction(c.effect)}
        predicted = {c.effect.name: prediction.with_candidate(c, columns) for c in shown}
        for p in predicted.values():
            p["share"] = (
                min(1.0, max(0.0, 1.0 - (p["misfit"] ** 2 - 1.0) / excess)) if excess > _RESOLVED else None
            )
    except FittingError as error:
        return {"error": {"code": error.code, "message": error.message, "hint": error.hint}}
    return {"diagnosis": document, "predicted": predicted, "base_misfit": prediction.misfit}


# shares of candidates are computed if the mean square residual exceeds the noise by at least this relative amount
_RESOLVED = 0.05


def contradiction(effect: Effect) -> str:
    """Return the observation that would contradict an effect, from the variables of its law."""
    from fitting.effects._expression import symbols

    names = symbols(effect.expression)
    body = {"rotor": "rotor", "bearing": "bearing"}.get(effect.joint, "body")
    if effect.kind == "measurement":
        return "The same deviation in a recording with another camera or another camera position."
    if effect.state is not None or "temperature" in names:
        return "No change when the run is repeated immediately, while the contact is still warm."
    if names & {"psi_r", "psi_c", "deflection", "strain"}:
        return "A torque that does not return at the same angle in every turn."
    if "t" in names:
        return "The same torque at another time of a repeated run."
    if "delta" in names:
        return "A torque that remains while rotor and casing have the same speed."
    if {"omega_r", "omega_c"} <= names:
        return "The same torque with the other body at rest."
    if effect.joint == "casing" and "omega_r" in names:
        return "The same torque on the casing after the rotor has stopped."
    return f"Different torques on the {body} at the same speed while speeding up and while slowing down."


def main() -> None:
    """Answer requests until the input ends."""
    warnings.simplefilter("ignore")
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    case = Path(sys.argv[1])
    for line in sys.stdin:
        sys.stdout.write(json.dumps(to_json(_answer(line, case))) + "\n")
        sys.stdout.flush()


# half range of a slider [standard errors]; if there is no standard error, [sigma of the change of the residual]
_SLIDER_RANGE = 5.0
_DRAWN = 200  # number of points of a torque curve


class Prediction:
    """Residual speeds of a fit of one case as a function of its parameters."""

    def __init__(self, fit: Fit) -> None:
        self._fit = fit
        from fitting.inference._speed_residuals import SpeedMap

        self._map = SpeedMap(fit.problem, fit.noise[0], 0)

    def sliders(self) -> dict[str, Any]:
        """Return the parameters with their ranges, and the derivatives of the residual speeds.

        ``parameters``: name, value, low, high, unit, u; ``time`` and ``value`` of each run, the casing first;
        ``sigma`` of the casing; ``slope[run][parameter][sample]``: derivative of the residual speed with respect to
        the parameter.
        """
        fit, layout = self._fit, self._fit.problem.layout
        lower, upper = layout.bounds()
        slope = self._map(-fit.predictions[0].jacobian)
        noise = float(np.sqrt(np.mean(self._sigma**2)))
        rows, places = [], []
        for k, name in enumerate(layout.names):
            value, estimate = float(fit.theta[k]), fit.estimates.get(name)
            if estimate is None:  # the model may contain a parameter of the rotor in a recording of one body
                continue
            known = np.isfinite(estimate.stderr) and estimate.stderr > 0
            size = max(float(np.sqrt(np.mean(slope[0][:, k] ** 2))), 1e-300)
            half = _SLIDER_RANGE * (estimate.stderr if known else noise / size)
            low, high = float(max(value - half, lower[k])), float(min(value + half, upper[k]))
            rows.append(
                {
                    "name": name,
                    "value": value,
                    "low": low,
                    "high": high,
                    "unit": estimate.unit,
                    "u": float(estimate.stderr) if known else None,
                }
            )
            places.append(k)
        return {
            "parameters": rows,
            "time": [time.tolist() for _, time, _, _ in self._map.parts],
            "value": [v.tolist() for v in self._residuals(fit.predictions[0].rows)],
            "slope": [s[:, places].T.tolist() for s in slope],
            "sigma": self._sigma.tolist(),
        }

    def moved(self, values: Mapping[str, float]) -> dict[str, Any]:
        """Return the exact residual speeds for changed parameters; a UsageError names an invalid parameter."""
        fit, layout = self._fit, self._fit.problem.layout
        theta = fit.theta.copy()
        lower, upper = layout.bounds()
        for name, value in values.items():
            k = layout.index.get(name, -1)
            if k < 0:
                raise UsageError(f"There is no parameter {name[:60]}.", "Reload the page.")
            if not (np.isfinite(value) and lower[k] <= value <= upper[k]):
                raise UsageError(
                    f"{name} is outside its bounds.", f"The bounds are {lower[k]:g} and {upper[k]:g}."
                )
            theta[k] = value
        predictions = fit.problem.predict(theta)
        rows = predictions[0].rows
        return {"value": [v.tolist() for v in self._residuals(rows)], "misfit": self._misfit(rows)}

    def _residuals(self, rows: Array) -> list[Array]:
        return self._map(self._fit.problem.data[0].z - rows)

    @cached_property
    def _sigma(self) -> Array:
        return self._fit.speed_residuals(0)[0].sigma

    @cached_property
    def _pure(self) -> Projection:
        """Whitening with the noise that does not depend on the model, as in the metrics of a fit."""
        from fitting.inference._problem import Projection

        noise = self._fit.noise[0]
        return Projection(self._fit.problem.data[0], noise.whitener.at(noise.pure))

    @property
    def misfit(self) -> float:
        """The misfit of the fit; see `_misfit`."""
        return self._misfit(self._fit.predictions[0].rows)

    def _misfit(self, rows: Array) -> float:
        """Return the rms residual of modelled rows divided by the noise, as `Fit.misfit`."""
        from fitting.inference._metrics import chi2_per_row

        data = self._fit.problem.data[0]
        return math.sqrt(chi2_per_row(data, self._pure, self._pure(rows - data.z))[0])

    def with_candidate(self, candidate: Candidate, columns: CaseColumns) -> dict[str, Any]:
        """Return the predicted residual speeds with an added candidate, and the torque of this candidate.

        If the search has refitted the candidate, residual speeds and torque come from this refit. Otherwise the
        strength of the candidate comes from its score test, the other parameters are refitted to first order, and the
        torque is None.
        """
        from gyrotrack.plotting._study_data import added_torque

        drawn, fit = None, self._fit
        if candidate.fit is not None:
            rows = candidate.fit.predictions[0].rows
            torque = added_torque(candidate.effect.name, fit, candidate.fit, 0)
            if torque is not None:
                few = np.unique(np.linspace(0, len(torque.time) - 1, _DRAWN).astype(int))
                curves = {"time": torque.time, "omega_c": torque.omega_c, **torque.torques}
                drawn = {name: values[few].tolist() for name, values in curves.items()}
        else:
            rows = fit.predictions[0].rows + self._linear_change(candidate, columns)
        values = self._residuals(rows)
        return {"value": [v.tolist() for v in values], "misfit": self._misfit(rows), "torque": drawn}

    def _linear_change(self, candidate: Candidate, columns: CaseColumns) -> Array:
        """Return the first-order change of the modelled rows caused by a candidate and the refitted parameters."""
        fit, screened = self._fit, candidate.screened
        data, prediction, whitener = fit.problem.data[0], fit.predictions[0], fit.noise[0].whitener
        shape = screened.shape[0] if screened.shape else {}
        (trial,) = columns.trials(candidate.effect, [shape])
        gained = trial.columns @ np.atleast_1d(screened.gamma)[: trial.columns.shape[1]]
        moving = ~fit.problem.layout.at_bound(fit.theta)
        free = np.concatenate([prediction.jacobian[:, moving], data.nuisance], axis=1)
        size = np.linalg.norm(free, axis=0)
        free = free[:, size > 0] / size[size > 0]
        rest = data.z - prediction.rows - gained
        change = free @ np.linalg.lstsq(whitener(free), whitener(rest), rcond=1e-10)[0]
        return np.asarray(gained + change)


if __name__ == "__main__":
    main()
