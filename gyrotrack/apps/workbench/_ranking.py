"""Ranking of candidate effects in a process of its own.

It reads one JSON document a line (a model with its parameters, as a ledger keeps them), answers one line, and ends
when its input ends.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import warnings
from pathlib import Path
from threading import Lock
from typing import Any

from fitting._numbers import to_json
from gyrotrack._errors import GyrotrackError


class Ranker:
    """A process that ranks candidates for the latest model asked for.

    Parameters
    ----------
    case : Path
        The case file.
    """

    def __init__(self, case: Path) -> None:
        self._case = case
        self._lock = Lock()
        self._process: subprocess.Popen[str] | None = None
        self._busy = False
        self._closed = False

    def rank(self, model: dict[str, Any]) -> dict[str, Any]:
        """Return the diagnosis of a model; a question that is still being answered is given up.

        Raises
        ------
        GyrotrackError
            If it was given up for a newer one, or the process failed.
        """
        with self._lock:
            if self._busy:
                self._end()
            process = self._started()
            self._busy = True
        try:
            assert process.stdin is not None and process.stdout is not None  # noqa: S101, PT018 - asked for as pipes
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
            raise GyrotrackError(
                "The search was given up for a newer one." if not newest else "The search failed."
            )
        return dict(json.loads(line))

    def _started(self) -> subprocess.Popen[str]:
        if self._closed:
            raise GyrotrackError("The workbench is closing.")
        if self._process is None or self._process.poll() is not None:
            self._process = subprocess.Popen(  # noqa: S603 - our own program, no shell
                [sys.executable, "-m", "gyrotrack.apps.workbench._ranking", str(self._case)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
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


_MOST = 12
"""Candidates whose effect on the residual is predicted: those that the page lists."""


def _answer(line: str, case: Path) -> dict[str, Any]:
    from fitting._errors import FittingError
    from fitting.discovery._score import CaseColumns
    from fitting.discovery._verdict import diagnose
    from fitting.inference._case_data import CaseData
    from fitting.inference._case_file import read_record
    from fitting.study._history import Entry
    from fitting.study._serialisation import diagnosis_document
    from gyrotrack.apps.workbench._prediction import Prediction

    try:
        fit = Entry(json.loads(line)).refit([CaseData.of(read_record(case))])
        found = diagnose(fit)
        prediction, columns = Prediction(fit), CaseColumns(fit, 0)
        shown = [c for c in found.candidates if c.score > 0][:_MOST]
        predicted = {c.effect.name: prediction.with_candidate(c, columns) for c in shown}
        return {
            "diagnosis": diagnosis_document(found, ""),
            "predicted": predicted,
            "base_rms": prediction.rms,
        }
    except FittingError as error:
        return {"error": {"code": error.code, "message": error.message, "hint": error.hint}}


def main() -> None:
    """Answer until the input ends."""
    warnings.simplefilter("ignore")
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    case = Path(sys.argv[1])
    for line in sys.stdin:
        sys.stdout.write(json.dumps(to_json(_answer(line, case))) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
