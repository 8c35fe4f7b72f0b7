"""Worker processes on this machine, and workers of a Dask cluster.

A worker process reads one JSON array of arguments per line and answers with one JSON object per line. It ends when its
input ends, even if its parent is killed. The answers of a cluster are JSON bytes, so that results are never unpickled.
"""

from __future__ import annotations

import json
import os
import secrets
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from fitting._workers import available_cores
from gyrotrack._errors import GyrotrackError, UsageError
from gyrotrack._versions import __version__

WORKER = "gyrotrack.apps.cli._batch"

Answer = dict[str, Any]

_WATCH = 0.5  # time between two checks whether a batch still runs [s]
_GRACE = 5.0  # time for a worker to remove unfinished outputs before it is killed [s]
_MAX_ANSWER = 2**26  # largest size of an answer [bytes]


class Child:
    """A worker process, started on first use and restarted after a crash."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None

    @property
    def pid(self) -> int | None:
        """Process number; None without a process."""
        return self._process.pid if self._process is not None else None

    def run(self, words: Sequence[str], timeout: float | None = None) -> Answer:
        """Run one command; return exit code ``code`` and output ``document``, also after crash or timeout [s]."""
        late = threading.Event()
        timer: threading.Timer | None = None
        try:
            process = self._process
            if process is None or process.poll() is not None:
                process = self._process = _start()
            if timeout is not None:
                running = process

                def stop() -> None:
                    late.set()
                    end_process(running)

                timer = threading.Timer(timeout, stop)
                timer.daemon = True
                timer.start()
        except (OSError, RuntimeError) as error:  # no further process or thread can be started
            self.close()
            return failure(
                "processes",
                f"No worker process could be started: {getattr(error, 'strerror', None) or error}.",
                "Raise the limits of processes and open files (`ulimit -u`, `ulimit -n`).",
            )
        try:
            line = _answer_of(process, words)
        finally:
            if timer is not None:
                timer.cancel()
        if not line.endswith("\n"):
            self.close()
            if late.is_set():
                what = f"The time limit of {timeout:g} s was reached."
                return failure("timeout", what, "Raise it with --timeout.")
            code = process.returncode
            how = f"by signal {-code}" if code and code < 0 else f"with exit code {code}"
            hint = "Check the limits of memory, processes and open files."
            return failure("crash", f"The worker process ended {how}, without an answer.", hint)
        return checked(line)

    def close(self) -> None:
        """End the process; it removes unfinished outputs."""
        process, self._process = self._process, None
        if process is not None:
            end_process(process)
            for stream in (process.stdin, process.stdout):
                if stream is not None:
                    with suppress(OSError):
                        stream.close()
            process.wait()


def run_once(words: Sequence[str], timeout: float | None = None, sign: str | None = None) -> bytes:
    """Run one command in a separate process and return its answer as JSON; a worker of a cluster calls this function.

    The command ends when the file `sign` is removed, because a cluster does not end running commands.
    """
    if sign is not None and not Path(sign).exists():
        return json.dumps(failure("cancelled", "The batch has ended.", "")).encode()
    child, ended = Child(), threading.Event()
    if sign is not None:
        threading.Thread(target=_end_with, args=(Path(sign), child, ended), daemon=True).start()
    try:
        return json.dumps(child.run(words, timeout)).encode()
    finally:
        ended.set()
        child.close()


def _end_with(sign: Path, child: Child, ended: threading.Event) -> None:
    while not ended.wait(_WATCH):
        if not sign.exists():
            child.close()


def _start() -> subprocess.Popen[str]:
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONUTF8": "1"}
    # the worker reads no settings file, because the settings are among the arguments
    environment["GYROTRACK_CONFIG"] = "none"
    return subprocess.Popen(  # noqa: S603 - gyrotrack itself, without a shell
        [sys.executable, "-P", "-m", WORKER],  # -P: no module is imported from the working folder
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        encoding="utf-8",
        env=environment,
        start_new_session=True,  # Ctrl-C is handled by the parent
    )


def end_process(process: subprocess.Popen[str]) -> None:
    """Terminate a process, and kill it if it does not end."""
    if process.poll() is None:
        with suppress(OSError):
            process.terminate()
        try:
            process.wait(_GRACE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _answer_of(process: subprocess.Popen[str], words: Sequence[str]) -> str:
    """Return the answer line of the process, or "" if the process has ended."""
    assert process.stdin is not None  # noqa: S101
    assert process.stdout is not None  # noqa: S101
    try:
        process.stdin.write(json.dumps(list(words)) + "\n")
        process.stdin.flush()
        return process.stdout.readline()
    except (OSError, ValueError):  # ValueError: another thread has closed the pipes
        return ""


def checked(text: str | bytes) -> Answer:
    """Parse an answer and check its form; an invalid answer becomes an error document."""
    try:
        answer = json.loads(text) if len(text) <= _MAX_ANSWER else None
    except (ValueError, RecursionError):
        answer = None
    if (
        not isinstance(answer, dict)
        or not isinstance(answer.get("code"), int)
        or not isinstance(answer.get("document"), dict)
        or not isinstance(answer.get("seconds", 0.0), int | float)
    ):
        return failure("crash", "The worker's answer is not valid.", "Install the same version everywhere.")
    if answer.get("version", __version__) != __version__:
        what = f"The worker runs gyrotrack {str(answer['version'])[:40]}, not {__version__}."
        return failure("version", what, "Install the same version everywhere.")
    return answer


def failure(code: str, message: str, hint: str) -> Answer:
    """Return the answer of a command that could not be run."""
    return {"code": 1, "document": {"error": {"code": code, "message": message, "hint": hint}}}


class Workers(Protocol):
    """Runs commands in parallel."""

    def submit(self, words: Sequence[str], timeout: float | None) -> Future[Answer]:
        """Begin a command; the answer has the form of the answer of `Child.run`."""

    def close(self) -> None:
        """Stop running commands and end."""


class LocalWorkers:
    """A number of processes on this machine, each of which runs one command after another."""

    def __init__(self, count: int) -> None:
        self._own = threading.local()
        self._children: list[Child] = []
        self._pool = ThreadPoolExecutor(count, thread_name_prefix="batch")

    def submit(self, words: Sequence[str], timeout: float | None) -> Future[Answer]:
        """Begin a command; if no thread can be started, run the command immediately."""
        try:
            return self._pool.submit(self._run, list(words), timeout)
        except RuntimeError:
            done: Future[Answer] = Future()
            done.set_result(self._run(list(words), timeout))
            return done

    def _run(self, words: list[str], timeout: float | None) -> Answer:
        if not hasattr(self._own, "child"):
            self._own.child = Child()
            self._children.append(self._own.child)
        answer: Answer = self._own.child.run(words, timeout)
        return answer

    def close(self) -> None:
        """End the processes; their outputs are complete or absent."""
        self._pool.shutdown(wait=False, cancel_futures=True)
        for child in self._children:  # all are ended simultaneously, because each may need time to clean up
            with suppress(OSError, ProcessLookupError):
                if child.pid is not None:
                    os.kill(child.pid, signal.SIGTERM)
        for child in self._children:
            child.close()
        self._pool.shutdown()


class ClusterWorkers:
    """The workers of a Dask cluster, which must have access to the same folders.

    Each command runs in a separate process on a worker, so that a crash does not end the worker; if a worker is lost,
    the scheduler reassigns its commands. The name of a function and arguments are sent, JSON is returned. The messages
    of Dask are pickled, so the scheduler must be trusted: its address (``tls://host:port`` or ``tcp://host:port``) is
    never read from the folder of the data, and with TLS both sides authenticate themselves.
    """

    def __init__(self, address: str, sign: Path, security: Any) -> None:
        """Connect to a scheduler; the file `sign` exists until `close`."""
        try:
            from distributed import Client
        except ImportError:
            what = "A cluster needs dask.distributed, which is not installed."
            raise UsageError(what, 'Install it: pip install "gyrotrack[cluster]"') from None
        options: Any = {"timeout": "20s", "set_as_default": False}
        if security is not None:
            options["security"] = security
        try:
            client: Any = Client(address, **options)  # type: ignore[no-untyped-call]
        except (OSError, ValueError, TimeoutError) as error:
            what = f"The scheduler at {address[:80]} does not answer."
            raise GyrotrackError(what, "Start it, and check its address and certificates.") from error
        self._client, self._sign = client, sign
        self._executor = client.get_executor(pure=False)
        self._pending: set[Future[Answer]] = set()

    def submit(self, words: Sequence[str], timeout: float | None) -> Future[Answer]:
        """Begin a command."""
        answer: Future[Answer] = Future()

        def parse(done: Future[Any]) -> None:
            try:
                raw = done.result()
                answer.set_result(checked(raw if isinstance(raw, bytes) else b""))
            except (
                BaseException
            ) as error:  # a lost scheduler raises a cancellation, which is not an Exception in all versions
                answer.set_result(_lost(error))

        self._pending.add(answer)
        answer.add_done_callback(self._pending.discard)
        try:
            self._executor.submit(run_once, list(words), timeout, str(self._sign)).add_done_callback(parse)
        except Exception as error:
            answer.set_result(_lost(error))
        return answer

    def close(self) -> None:
        """End all commands, wait until they have removed their unfinished outputs, and disconnect."""
        self._sign.unlink(missing_ok=True)
        wait(set(self._pending), timeout=2 * _GRACE)
        with suppress(Exception):  # the scheduler may be lost
            self._executor.shutdown(wait=False)
            self._client.close(timeout=_GRACE)


_SIGN = "batch.running."


def new_sign(results: Path) -> Path:
    """Return a new sign, a file whose removal ends the steps on a cluster.

    Older signs in the locked folder are removed.
    """
    for left in results.glob(f"{_SIGN}*"):
        left.unlink(missing_ok=True)
    sign = results.resolve() / f"{_SIGN}{secrets.token_hex(8)}"
    sign.touch(exist_ok=False)
    return sign


@dataclass(frozen=True)
class Cluster:
    """A Dask cluster: scheduler (None: this machine), certificate authority, own certificate, own key (PEM files)."""

    scheduler: str | None = None
    tls_ca: Path | None = None
    tls_cert: Path | None = None
    tls_key: Path | None = None

    def workers(self, folder: Path, processes: int | None = None) -> Workers:
        """Return the workers of the cluster, or processes on this machine, for commands with outputs in `folder`."""
        if self.scheduler is None:
            return LocalWorkers(processes or available_cores())
        return ClusterWorkers(self.scheduler, new_sign(folder), self._security(self.scheduler))

    def _security(self, address: str) -> Any:
        """Return distributed's `Security` for a tls:// address, else None; other addresses have no certificates."""
        named = {"--tls-ca": self.tls_ca, "--tls-cert": self.tls_cert, "--tls-key": self.tls_key}
        if not address.startswith("tls://"):
            if any(named.values()):
                what = f"The certificates cannot be used with the address {address[:80]}."
                raise UsageError(what, "Give the scheduler as tls://HOST:PORT.")
            return None
        for option, path in named.items():
            if path is None:
                what = "A tls:// address needs a certificate authority, a certificate and a key."
                raise UsageError(what, f"Give {option} FILE.")
            if not path.is_file():
                raise UsageError(f"There is no file {path}.", f"Check {option}.")
        from distributed import Security

        return Security(  # type: ignore[no-untyped-call]
            tls_ca_file=str(self.tls_ca),
            tls_client_cert=str(self.tls_cert),
            tls_client_key=str(self.tls_key),
            require_encryption=True,
        )


def _lost(error: BaseException) -> Answer:
    return failure(
        "crash", f"The worker or the scheduler was lost ({type(error).__name__}).", "Check the cluster."
    )
