"""Commands that track a film and make a case from the sources.

The body in a film determines how the film is tracked. The sources determine how the case is made: `gyrotrack sync`
joins the recordings of films with markers, `import` joins tables, and `spindown` measures a single body.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from gyrotrack._errors import UsageError
from gyrotrack.io._records import Inertia

if TYPE_CHECKING:
    from gyrotrack.apps.workbench._state import Source, State

_ALONE = "single"  # body of a source that shows a single body


def argument(name: str) -> str:
    """Return a file name that is not parsed as an option."""
    return f"./{name}" if name.startswith("-") else name


@dataclass(frozen=True)
class Tracking:
    """Tracking of the markers of a film, which makes a recording."""

    resumes: bool = True  # whether an interrupted run continues
    makes: str = "recording"

    def words(self, x: Source, _state: State) -> list[str]:
        """Return the command."""
        profile = ["--profile", argument(x.profile)] if x.profile else []
        return ["extract", argument(x.file), *_rate(x), *profile, "-o", x.output]

    def profile(self, x: Source, unused: str) -> str:
        """Return the profile to which the clicked markers are written; "" without a profile."""
        return (x.marked or unused) if x.picks else ""

    def is_marked(self, x: Source) -> bool:
        """Whether enough was clicked for a preview."""
        return bool(x.picks)


@dataclass(frozen=True)
class Registration(Tracking):
    """Tracking of the whole body by registration of its image, which makes a case."""

    resumes: bool = False
    makes: str = "case"

    def words(self, x: Source, state: State) -> list[str]:
        """Return the command."""
        hub = [] if x.hub is None else ["--hub", f"{x.hub[0]:.1f},{x.hub[1]:.1f}"]
        report = f"{Path(x.output).stem}.html"
        words = ["spindown", argument(x.file), *_rate(x), "-o", x.output, "--report", report]
        return [*words, *hub, *_entries(state)]

    def profile(self, _x: Source, _unused: str) -> str:
        """Return "", because the clicks are points to follow, not markers."""
        return ""

    def is_marked(self, x: Source) -> bool:
        """Whether enough was clicked for a preview."""
        return bool(x.picks) or x.hub is not None


_TRACKING = {_ALONE: Registration()}
_OF_MARKERS = Tracking()


def tracking_of(x: Source) -> Tracking:
    """Return the tracking method for a film."""
    return _TRACKING.get(x.body, _OF_MARKERS)


def _rate(x: Source) -> list[str]:
    return [] if x.capture_fps is None else ["--capture-fps", f"{x.capture_fps:g}"]


def _entries(state: State) -> list[str]:
    names = ("inertia", "label", "body_name")
    return [f"--{k.replace('_', '-')}={v}" for k in names if (v := getattr(state, k))]


@dataclass(frozen=True)
class Route:
    """A way from sources to a case; the base class is for sources that cannot be combined.

    `fits` states whether the command also fits the case. `optional` names the entries that may be missing, but must be
    valid if given.
    """

    name: str = ""
    fits: bool = False
    optional: tuple[str, ...] = ()

    def missing(self, _state: State, _untracked: Sequence[str]) -> list[str]:
        """Return a message that names the missing entries, or "".

        `untracked` are the names of films that are not tracked.
        """
        return ["Films and tables cannot be combined in one case."]

    def makes_case(self, _state: State) -> bool:
        """Whether a separate command, not the tracking of the film, makes the case."""
        return True

    def words(self, _state: State, _case: str) -> list[str]:
        """Return the command that makes the case."""
        return []

    def result(self, state: State) -> dict[str, object]:
        """Return the result of the command that made the case."""
        return state.match


@dataclass(frozen=True)
class _OfGyroscope(Route):
    """The case of a rotor in its casing, from films."""

    def missing(self, state: State, untracked: Sequence[str]) -> list[str]:
        found = []
        bodies = [x.body for x in state.sources]
        if bodies.count("casing") != 1 or "rotor" not in bodies:
            found.append("A case needs one source of the casing and at least one of the rotor.")
        if untracked:
            found.append(f"Not tracked yet: {', '.join(untracked)}.")
        for body in ("rotor", "casing"):
            try:
                Inertia.required(getattr(state, f"inertia_{body}") or None, body)
            except UsageError as error:
                found.append(error.message)
        return found

    def words(self, state: State, case: str) -> list[str]:
        ordered = [x for body in ("casing", "rotor") for x in state.sources if x.body == body]
        inertias = [f"--inertia-rotor={state.inertia_rotor}", f"--inertia-casing={state.inertia_casing}"]
        names = [f"--{k}={getattr(state, k)}" for k in ("label", "surface") if getattr(state, k)]
        return [*self.files(ordered), "-o", case, *inertias, *names]

    def files(self, sources: Sequence[Source]) -> list[str]:
        """Return the command with its files."""
        return ["sync", *(argument(x.output or x.file) for x in sources)]


@dataclass(frozen=True)
class _OfTables(_OfGyroscope):
    """The case of a rotor in its casing, from tables."""

    def files(self, sources: Sequence[Source]) -> list[str]:
        return ["import", *(word for x in sources for word in (f"--{x.body}", argument(x.file)))]


@dataclass(frozen=True)
class _OfBody(Route):
    """The case of a single body, from one film or table."""

    def missing(self, state: State, _untracked: Sequence[str]) -> list[str]:
        several = "A single body needs exactly one film or table; remove the others."
        return [several] if len(state.sources) > 1 else []

    def makes_case(self, state: State) -> bool:
        return state.sources[0].kind != "film"

    def words(self, state: State, case: str) -> list[str]:
        words = ["spindown", argument(state.sources[0].file), "-o", case]
        return [*words, "--report", f"{Path(case).stem}.html", *_entries(state)]

    def result(self, state: State) -> dict[str, object]:
        return state.match if self.makes_case(state) else state.sources[0].result


_ROUTES: dict[frozenset[str], Route] = {
    frozenset({"table"}): _OfTables("import"),
    frozenset({"film"}): _OfGyroscope("sync"),
}


def route_of(sources: Sequence[Source]) -> Route:
    """Return the way from these sources to a case."""
    if any(x.body == _ALONE for x in sources):
        return _OfBody("single", fits=True, optional=("inertia",))
    kinds = frozenset("table" if x.kind == "table" else "film" for x in sources if x.body)
    return _ROUTES.get(kinds, Route())
