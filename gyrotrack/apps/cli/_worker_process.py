"""The worker process of a batch: commands in, JSON out."""

from __future__ import annotations

import io
import json
import os
import queue
import sys
import threading
from contextlib import redirect_stdout
from time import perf_counter
from typing import Any

from gyrotrack._versions import __version__
from gyrotrack.apps.cli._app import run


def perform(words: list[str]) -> dict[str, Any]:
    """Run one command of the program and return its exit code and its JSON document."""
    said, began = io.StringIO(), perf_counter()
    with redirect_stdout(said):
        code = run([words[0], "--json", "-q", *words[1:]])
    try:
        document = json.loads(said.getvalue() or "{}")
    except ValueError:
        document = {"error": {"code": "bug", "message": "The command did not answer in JSON.", "hint": ""}}
    seconds = round(perf_counter() - began, 3)
    return {"code": code, "document": document, "version": __version__, "seconds": seconds}


def main() -> None:
    """Answer until the input ends."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # whatever a library prints is no answer
    tasks: queue.SimpleQueue[list[str]] = queue.SimpleQueue()

    def listen() -> None:
        for line in sys.stdin:
            tasks.put(json.loads(line))
        os._exit(0)  # nobody waits for the answer any more; outputs are whole or not there

    threading.Thread(target=listen, daemon=True).start()
    while True:
        answers.write(json.dumps(perform(tasks.get())) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
