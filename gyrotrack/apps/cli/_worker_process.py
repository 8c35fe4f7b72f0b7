"""The worker process of a batch: commands in, JSON out."""

from __future__ import annotations

import io
import json
import os
import queue
import signal
import sys
import threading
import time
from contextlib import redirect_stdout
from time import perf_counter
from typing import Any

from gyrotrack._versions import __version__
from gyrotrack.apps.cli._app import catch_sigterm, run
from gyrotrack.apps.cli._output import INTERRUPTED, TERMINATED

_GRACE = 5.0  # s to remove what is half written


def perform(words: list[str]) -> dict[str, Any]:
    """Run one command of the program and return its exit code and its JSON document."""
    printed, began = io.StringIO(), perf_counter()
    with redirect_stdout(printed):
        code = run([words[0], "--json", "-q", *words[1:]])
    try:
        document = json.loads(printed.getvalue() or "{}")
    except ValueError:
        document = {"error": {"code": "bug", "message": "The command did not answer in JSON.", "hint": ""}}
    seconds = round(perf_counter() - began, 3)
    return {"code": code, "document": document, "version": __version__, "seconds": seconds}


def main() -> None:
    """Answer until the input ends."""
    catch_sigterm()
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # whatever a library prints is no answer
    tasks: queue.SimpleQueue[list[str]] = queue.SimpleQueue()

    def listen() -> None:
        for line in sys.stdin:
            tasks.put(json.loads(line))
        if hasattr(signal, "pthread_kill"):  # nobody waits for the answer any more: clean up and end
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)
            time.sleep(_GRACE)
        os._exit(0)

    threading.Thread(target=listen, daemon=True).start()
    try:
        while True:
            answer = perform(tasks.get())
            if answer["code"] in {INTERRUPTED, TERMINATED}:
                return
            answers.write(json.dumps(answer) + "\n")
            answers.flush()
    except (KeyboardInterrupt, BrokenPipeError):
        return


if __name__ == "__main__":
    main()
