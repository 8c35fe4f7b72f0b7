"""How many modules does one diagnosis pass through, and how deep do their calls nest?

    python benchmarks/discovery/calls.py

A recording with a hidden quadratic drag of the casing is simulated, fitted and diagnosed in this process. Counted are
the frames of functions of `fitting` between `diagnose` and the innermost call; comprehensions and generator expressions
are part of their function, and a function that calls itself (formulas are trees) counts once.
Printed are the modules with their number of calls, and the deepest chain.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import fitting
from fitting.effects._library import REDUCED

ROOT = str(Path(fitting.__file__).parent)
HIDDEN = "casing.air.quadratic"
PARAMETERS = {
    f"{HIDDEN}.k": 5e-10,
    "rotor.air.quadratic.a2": 9.97e-11,
    "touchpoint.constant.b1": 2.88e-6,
    "casing.air.linear.b2": 8.28e-7,
    "bearing.linear.d": 1.57e-7,
    "bearing.power.f": 1.26e-8,
    "bearing.power.g": 1.32,
}
PARTS = {"<listcomp>", "<dictcomp>", "<setcomp>", "<genexpr>"}


class Calls:
    """Counts calls into modules of `fitting`, and keeps the deepest chain of them."""

    def __init__(self) -> None:
        self.modules: Counter[str] = Counter()
        self.chain: list[CodeType] = []
        self._own: dict[CodeType, bool] = {}
        self._stack: list[tuple[CodeType, bool]] = []

    def __call__(self, frame: FrameType, event: str, _: Any) -> None:
        """Handle an event of `sys.setprofile`."""
        if event not in {"call", "return"}:
            return
        code = frame.f_code
        if code not in self._own:
            self._own[code] = code.co_filename.startswith(ROOT) and code.co_name not in PARTS
        if not self._own[code]:
            return
        if event == "return":
            if self._stack and self._stack[-1][0] is code:
                self._stack.pop()
            return
        self.modules[Path(code.co_filename).relative_to(ROOT).as_posix()] += 1
        self._stack.append((code, all(c is not code for c, _ in self._stack)))
        chain = [c for c, first in self._stack if first]
        if len(chain) > len(self.chain):
            self.chain = chain


def main() -> None:
    record = fitting.simulate(
        fitting.Model.of([*REDUCED, HIDDEN]),
        PARAMETERS,
        fitting.Experiment(duration=40.0, windows=(1.0, 14.0, 30.0)),
        inertia_rotor=5.54e-5,
        inertia_casing=2.06e-5,
        seed=1,
    )
    base = fitting.fit("reduced", record)
    fitting.diagnose  # noqa: B018 - imported before it is counted
    calls = Calls()
    sys.setprofile(calls)
    try:
        answer = fitting.diagnose(base)
    finally:
        sys.setprofile(None)
    print(answer.sentence)
    print(f"{len(calls.modules)} modules, call depth {len(calls.chain)}")
    for name, count in calls.modules.most_common():
        print(f"{count:10d}  {name}")
    for code in calls.chain:
        print(f"    {Path(code.co_filename).relative_to(ROOT).as_posix()}: {code.co_qualname}")


if __name__ == "__main__":
    main()
