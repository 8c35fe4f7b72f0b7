"""The steps of the start page of the workbench, from films and tables to a case.

Each step is a command that is shown on the page and runs in a separate process in the work folder. Entries and results
are stored in ``workbench.json`` in this folder, so that closing the page or the program loses nothing. Interrupted
tracking continues from its checkpoint.
"""

from __future__ import annotations

import json
import math
import os
import re
import shlex
import shutil
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from threading import RLock
from time import monotonic
from typing import Any, Literal, get_args

from filelock import Timeout
from pydantic import ValidationError

from fitting._numbers import short, with_uncertainty
from fitting._workers import available_cores
from gyrotrack._errors import ConfigurationError, GyrotrackError, OutputError, UsageError
from gyrotrack.apps._sample import sample_folder
from gyrotrack.apps._study import checked_body_name
from gyrotrack.apps.batch._experiments import FILMS, STATED_RATE, Experiment, read_study
from gyrotrack.apps.workbench._corrections import corrected, corrections, jump, without_correction
from gyrotrack.apps.workbench._films import SourceFrames, marker_middles, marker_positions, positions
from gyrotrack.apps.workbench._history import Change, History, apply, difference
from gyrotrack.apps.workbench._processes import Job, Jobs
from gyrotrack.apps.workbench._routes import Route, argument, route_of, tracking_of
from gyrotrack.apps.workbench._state import FASTEST, Body, Pick, Source, State
from gyrotrack.apps.workbench._uploads import Sent, Uploads
from gyrotrack.io._atomic import locked, new_file, refuse_special, remove_remains
from gyrotrack.io._hdf5 import read_kind, read_recording, read_settings, write_recording
from gyrotrack.io._records import Inertia, Recording
from gyrotrack.io.readers._format_names import SUFFIXES
from gyrotrack.tracking._profile import parse, to_toml
from gyrotrack.video._container import probe

STATE_FILE = "workbench.json"
_DATASETS = {".h5", ".hdf5"}
TABLES = {suffix for suffixes in SUFFIXES.values() for suffix in suffixes} - _DATASETS
LARGEST_UPLOAD = 16 * 2**30  # largest file that a page may upload [bytes]
_MAX_SOURCES = 100
_PREVIEW = "gyrotrack.apps.workbench._films"


class Project:
    """The films, settings and steps of one work folder; all files are written to this folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()
        if not self.folder.is_dir():
            what = f"There is no folder {folder}."
            raise ConfigurationError(what, "Create it, or give another folder with --folder.")
        self._lock = RLock()
        self._infos: dict[str, dict[str, Any]] = {}
        self._read: tuple[tuple[str, int], Recording] | None = None
        self._middles: tuple[tuple[str, str, tuple[str, ...]], dict[str, float]] | None = None
        self._holds = ExitStack()
        try:
            self._holds.enter_context(locked(self.folder / "workbench", 0.0))
        except OutputError as error:
            if not isinstance(error.__cause__, Timeout | RuntimeError):
                raise
            what = f"Another workbench is open in {self.folder}."
            raise ConfigurationError(what, "Use the open workbench, or close it.") from error
        remove_remains(self.folder)
        self.notes: list[str] = []
        self.state = self._read_state()
        self._saved = self.state.model_dump_json()
        self.history = History()
        self.when_fitted: Callable[[], object] = lambda: (
            None
        )  # called when a step has ended and a case can be opened
        self.when_matched: Callable[[], object] = lambda: None  # called when a case is written
        self.when_started: Callable[[], object] = lambda: None  # called when a step begins
        self._analysing = False  # whether the next step starts automatically
        self.revision = 0  # increased by every change, so that all pages show it
        self.jobs = Jobs(self.folder, available_cores())
        self.uploads = Uploads(self.folder)

    def document(self) -> dict[str, Any]:
        """Return the state for the page."""
        with self._lock:
            s = self.state
            return {
                "folder": str(self.folder),
                "available": self._available(),
                "profiles": self.profiles(),
                "samples": sample_folder() is not None,
                "sources": [self._source_document(x) for x in s.sources],
                "uploads": self.uploads.unfinished(),
                "removed": [{"key": x.key, "name": Path(x.file).name} for x in s.removed],
                "revision": self.revision,
                "analysing": self._analysing,
                "undo": self.history.undo_label,
                "redo": self.history.redo_label,
                "seconds": s.seconds,
                "fields": {k: getattr(s, k) for k in _FIELDS},
                "inertias": {k: _inertia_field(getattr(s, k), k) for k in _FIELDS if k.startswith("inertia")},
                "route": self._route().name,
                "can_open": self._can_open(),
                "missing": {"track": self._missing_to_track(), "match": self._missing_to_match()},
                "commands": {
                    "track": [
                        _command(self.track_words(x)) for x in s.sources if x.kind == "film" and x.body
                    ],
                    "match": _command(self._match_words()) if self._is_matchable() else "",
                    "fit": _command(["fit", s.case]) if s.case and not self._route().fits else "",
                },
                "match": s.match,
                "is_matched": self._is_matched(),
                "fit": s.fit if self._is_fitted() else {},
                "case": s.case,
                "jobs": {k: j.summary() for k in ("match", "fit") if (j := self.jobs.get(k)) is not None},
            }

    def _source_document(self, x: Source) -> dict[str, Any]:
        jobs = {k: self.jobs.get(f"{k}:{x.key}") for k in ("track", "preview", "profile", "read")}
        read = jobs["read"]
        return {
            **x.model_dump(exclude={"file", "words"}),
            "name": Path(x.file).name,
            "info": self._info(x),
            "is_current": self.is_tracked(x),
            "can_continue": x.output != "" and (self.folder / f"{x.output}.unfinished").exists(),
            "jobs": {k: j.summary() for k, j in jobs.items() if j is not None},
            "reading": _reading_document(read.document) if read is not None and read.state == "done" else {},
            "command": _command(self.track_words(x)) if x.kind == "film" and x.body else "",
        }

    def _info(self, x: Source) -> dict[str, Any]:
        """Return the metadata of a film, or an error if it cannot be read."""
        if x.kind != "film":
            return {}
        if x.key not in self._infos:
            try:
                found = probe(self.path(x))
                self._infos[x.key] = {
                    "width": found.width,
                    "height": found.height,
                    "frames": found.frames_declared,
                    "container_fps": found.container_fps if math.isfinite(found.container_fps) else None,
                    "tag_fps": found.tag_fps,
                }
            except GyrotrackError as error:
                self._infos[x.key] = {"error": " ".join(filter(None, (error.message, error.hint)))}
        return self._infos[x.key]

    def path(self, x: Source) -> Path:
        """Return the file of a source."""
        return self.folder / x.file  # absolute paths are unchanged

    def _available(self) -> list[str]:
        known = {self.path(x) for x in (*self.state.sources, *self.state.removed)}
        ours = {x.output for x in (*self.state.sources, *self.state.removed)} | {self.state.case, STATE_FILE}
        kinds = FILMS | TABLES | _DATASETS
        with os.scandir(self.folder) as entries:
            names = sorted(e.name for e in entries if e.is_file() and not e.name.startswith("."))
        return [
            n
            for n in names
            if n.isprintable()
            and (Path(n).suffix.lower() in kinds or n == "study.toml")
            and n not in ours
            and self.folder / n not in known
            and not n.endswith(".fits.json")
        ][:200]

    def source(self, key: str) -> Source:
        """Return the source with this key."""
        for x in self.state.sources:
            if x.key == key:
                return x
        raise UsageError("There is no such film or table.", "Reload the page.")

    def add_named(self, name: str) -> None:
        """Add a file of the work folder that is listed on the page."""
        with self._lock:
            if name not in self._available():
                raise UsageError("There is no such file in the work folder.", "Reload the page.")
            self.add(self.folder / name, confined=True)

    def add(self, path: Path, *, confined: bool = False) -> None:
        """Add a film, table, recording or study (study.toml; if `confined`, only with files in the work folder)."""
        path = path if path.is_absolute() else Path.cwd() / path
        with self._changing():
            suffix = path.suffix.lower()
            if not path.is_file():
                raise UsageError(f"There is no file {path}.", "Check the path.")
            if suffix == ".toml":
                self._add_study(read_study(path), confined=confined)
            elif suffix in FILMS or suffix in TABLES:
                self._add_source(path, "film" if suffix in FILMS else "table")
            elif suffix in _DATASETS and read_kind(path) == "recording":
                self._add_source(path, "recording")
            else:
                what = f"{path.name} is not a film, table, recording or study.toml."
                raise UsageError(what, "Open a case with `gyrotrack view CASE.h5`.")
            self._save(f"add {path.name}")

    def add_samples(self) -> None:
        """Add the sample clips with their study.toml."""
        folder = sample_folder()
        if folder is None:
            what = "The sample clips are not installed."
            raise UsageError(what, "Install gyrotrack again.")
        self.add(folder / "study.toml")

    def _add_source(self, path: Path, kind: Literal["film", "recording", "table"]) -> Source:
        for x in self.state.sources:
            if self.path(x) == path:
                return x
        for (
            x
        ) in self.state.removed:  # a source that was removed comes back with its markers and its recording
            if self.path(x) == path:
                self.state.removed.remove(x)
                self.state.sources.append(x)
                return x
        if len(self.state.sources) >= _MAX_SOURCES:
            raise UsageError(f"The limit of {_MAX_SOURCES} sources is reached.", "Remove some.")
        inside = path.parent == self.folder
        known = (*self.state.sources, *self.state.removed)
        key = str(1 + max((int(x.key) for x in known), default=0))
        x = Source(key=key, file=path.name if inside else str(path), kind=kind)
        stem = path.stem.lower()
        x.body = next((b for b in ("casing", "rotor") if b in stem), "")
        if kind == "film":
            x.output = self._unused_name(f"{path.stem}.h5")
            info = self._info(x)
            if (stated := STATED_RATE.search(path.stem)) is not None:
                x.capture_fps, x.rate_from = float(stated[1]), "name of the file"
            elif info.get("tag_fps"):
                x.capture_fps, x.rate_from = info["tag_fps"], "tag of the camera"
        self.state.sources.append(x)
        return x

    def _add_study(self, study: Experiment, *, confined: bool) -> None:
        s = self.state
        for clip in study.clips:
            if confined and any(f.parent != self.folder for f in (clip.file, clip.profile) if f is not None):
                what = f"The study refers to {clip.file.name}, which is not in the work folder."
                raise UsageError(what, "Put films, profiles and study.toml into one folder.")
            if not clip.file.is_file():
                continue  # the missing file may be uploaded later
            x = self._add_source(clip.file, "film")
            x.body = clip.body
            if clip.capture_fps is not None:
                x.capture_fps, x.rate_from = clip.capture_fps, "study.toml"
            if clip.profile is not None and clip.profile.is_file():
                x.profile = self._relative(clip.profile)
        s.label, s.surface = study.label, study.surface
        s.inertia_rotor = study.inertia_rotor or s.inertia_rotor
        s.inertia_casing = study.inertia_casing or s.inertia_casing

    def remove(self, key: str) -> None:
        """Remove a source; files, settings and markers are kept, so that `restore` can restore the source."""
        with self._changing():
            x = self.source(key)
            for step in ("track", "preview", "profile", "read"):
                self.jobs.cancel(f"{step}:{key}")
            self.state.sources.remove(x)
            self.state.removed = [*self.state.removed, x][-_MAX_SOURCES:]
            self._infos.pop(key, None)
            self._save(f"remove {Path(x.file).name}")

    def restore(self, key: str) -> None:
        """Restore a source that was removed, with its settings and markers."""
        with self._changing():
            x = next((x for x in self.state.removed if x.key == key), None)
            if x is None:
                raise UsageError("There is no such removed film or table.", "Reload the page.")
            self.state.removed.remove(x)
            self.state.sources.append(x)
            self._save(f"restore {Path(x.file).name}")

    def undo(self) -> None:
        """Undo the last change of an entry, a marker, a correction or the list of films."""
        self.history.undo(self._lock)

    def redo(self) -> None:
        """Redo the last change that was undone."""
        self.history.redo(self._lock)

    def set(self, key: str, name: str, value: Any) -> None:
        """Set one field of the source with a key, or of the case; a UsageError rejects unknown fields and values."""
        with self._changing():
            if not key:
                if name not in _FIELDS or not isinstance(value, str):
                    raise UsageError("This field cannot be set.", "Reload the page.")
                if name == "body_name":
                    checked_body_name(value.strip())
                setattr(self.state, name, value.strip())
            else:
                x = self.source(key)
                if name == "body" and value in get_args(Body):
                    x.body = value
                elif name == "capture_fps":
                    x.capture_fps, x.rate_from = _rate(value), "entered" if value else ""
                elif name == "profile" and (value == "" or value in self.profiles()):
                    x.profile = value
                else:
                    raise UsageError("This field cannot be set.", "Reload the page.")
            self._save(f"change of {name.replace('_', ' ')}")

    async def receive(self, file: Sent, offset: int, pieces: AsyncIterator[bytes]) -> bool:
        """Write an uploaded file to the work folder from byte `offset` on, and add it; return whether it is complete.

        Folders in the name are ignored. Bytes that arrive before an interruption are kept: see `upload_state`.
        """
        target = self._upload_target(file)
        part = await self.uploads.receive(file, offset, pieces)
        if part is None:
            return False
        try:
            with self._lock:
                target = self.folder / self._unused_name(target.name)
                part.rename(target)
                try:
                    self.add(target, confined=True)
                except GyrotrackError:
                    target.unlink(missing_ok=True)
                    raise
        finally:
            self.uploads.finished(file)
        return True

    def upload_state(self, file: Sent) -> dict[str, Any]:
        """Return how much of a file has arrived; an error is raised if the file cannot be uploaded."""
        self._upload_target(file)
        return self.uploads.state(file)

    def discard_upload(self, key: str) -> None:
        """Delete the part of a file that has arrived."""
        self.uploads.discard(key)
        self.revision += 1

    def _upload_target(self, file: Sent) -> Path:
        name, declared = file.name, file.size
        safe = re.sub(r"[^\w .+()-]", "_", name.replace("\\", "/").rpartition("/")[2]).strip(" .")[-120:]
        suffix = Path(safe).suffix.lower()
        if safe.startswith("-") or not (suffix in FILMS | TABLES | _DATASETS or safe == "study.toml"):
            what = f"{safe[:60] or 'The file'} is not a film, table, recording or study.toml."
            raise UsageError(what, "Choose another file.")
        if not 0 < declared <= LARGEST_UPLOAD:
            what = f"{safe} has {declared} bytes; 1 to {LARGEST_UPLOAD} are accepted."
            raise UsageError(what, "Copy larger films to the work folder and select them there.")
        if shutil.disk_usage(self.folder).free < 1.1 * (declared - self.uploads.state(file)["received"]):
            raise OutputError(f"There is not enough space for {safe} in {self.folder}.", "Free some space.")
        return self.folder / self._unused_name(safe)

    def _unused_name(self, name: str) -> str:
        """Return a name that is not used by a file in the work folder or a planned output."""
        planned = {x.output for x in (*self.state.sources, *self.state.removed)}
        stem, suffix = Path(name).stem, Path(name).suffix
        number, found = 1, name
        while found in planned or (self.folder / found).exists():
            number += 1
            found = f"{stem}_{number}{suffix}"
        return found

    def profiles(self) -> list[str]:
        """Return the profiles in the work folder."""
        own = [p.name for p in self.folder.glob("*.toml") if p.name != "study.toml"]
        return sorted({*own, *(x.profile for x in self.state.sources if x.profile)})

    def mark(self, key: str, hub: Any, picks: Any, disc: str) -> None:
        """Store the hub [px], the markers, and the colour of a disc (or ""), write a profile, and start a preview."""
        with self._changing():
            x = self.source(key)
            try:
                x.picks = [Pick.model_validate(p) for p in picks][:20]
                x.hub = None if hub is None else (float(hub[0]), float(hub[1]))
            except (ValidationError, TypeError, ValueError, LookupError, OverflowError) as error:
                raise UsageError("These positions are not valid.", "Click them again.") from error
            if x.hub is not None and not all(map(math.isfinite, x.hub)):
                raise UsageError("The position of the hub is not valid.", "Click it again.")
            x.disc = disc[:20]
            tracking = tracking_of(x)
            if profile := tracking.profile(x, self._unused_name(f"{Path(x.file).stem}.toml")):
                x.profile = x.marked = profile
                self._write_profile(x)
                x.result = {}  # the old result belongs to other markers
            self._save("change of the markers")
            if tracking.is_marked(x):
                self.preview(key)

    def _write_profile(self, x: Source) -> None:
        """Write the clicked markers of a film as its profile."""
        content: dict[str, Any] = {
            "name": Path(x.file).stem,
            "centre": "circle" if x.disc else "orbit",
            "marker": [p.model_dump(include={"name", "colour", "body"}) for p in x.picks],
        }
        if x.disc:
            content["circle_colour"] = x.disc
        text = to_toml(parse(content, "profile"))
        with new_file(self.folder / x.profile, force=True) as stream:
            stream.write(text.encode())

    def preview(self, key: str) -> None:
        """Track the first frames in a separate process."""
        with self._lock:
            x = self.source(key)
            request = {
                "film": str(self.path(x)),
                "profile": str(self.folder / x.profile) if x.profile else "",
                "hub": x.hub,
                "makes": tracking_of(x).makes,
                "points": [(p.x, p.y) for p in x.picks],
            }
            self.jobs.start(
                f"preview:{key}", [json.dumps(request)], self._previewed, module=_PREVIEW, replace=True
            )

    def _previewed(self, job: Job) -> None:
        """Store the duration of a preview, which is used to estimate the progress of the next preview."""
        with self._lock:
            if job.state == "done":
                self.state.seconds["preview"] = round(monotonic() - job.began, 2)
            self.revision += 1

    def previewed(self, key: str) -> dict[str, Any]:
        """Return the result of the preview; empty before the first preview."""
        job = self.jobs.get(f"preview:{key}")
        return job.document if job is not None and job.state == "done" else {}

    def read(self, key: str) -> None:
        """Read a table in a separate process without writing a case, to show the columns' meaning and the speeds."""
        with self._lock:
            x = self.source(key)
            if x.kind != "table":
                raise UsageError(f"{Path(x.file).name} is not a table.", "Reload the page.")
            words = ["import", "--dry-run", "--body", argument(x.file)]
            self.jobs.start(f"read:{key}", words, lambda _: None, replace=True)

    def find_markers(self, key: str) -> None:
        """Find the markers automatically and write a profile (`gyrotrack profile`)."""
        with self._lock:
            x = self.source(key)
            name = self._unused_name(f"{Path(x.file).stem}.toml")

            def found(_document: dict[str, Any]) -> None:
                x = self.source(key)
                x.profile, x.picks, x.hub = name, [], None
                with suppress(GyrotrackError):
                    self.preview(key)

            self._start(f"profile:{key}", ["profile", argument(x.file), "-o", name], found)

    def tracked(self, key: str, index: int) -> dict[str, Any]:
        """Return the positions of centre and markers in a frame of a film [px]; empty if the film is not tracked."""
        recording = self.recording(key)
        if recording is None or not 0 <= index < len(recording.time):
            return {}
        frame = slice(index, index + 1)
        markers = marker_positions(recording, frame, self._middles_of(key, recording))
        listed = corrections(recording)
        by_hand = {c["marker"]: c["place_px"] for c in listed if c["frame"] == index}
        return {
            "centre": positions(recording.centre[frame])[0],
            "markers": [
                m
                | {k: m[k][0] for k in ("place", "whole", "status", "corners")}
                | {"by_hand": m["name"] in by_hand, "clicked": by_hand.get(m["name"])}
                for m in markers
            ],
            "time": float(recording.time[index]),
            "corrections": [
                {"marker": c["marker"], "frame": c["frame"], "lost": c["place_px"] is None, "at": c["at"]}
                for c in listed
            ],
        }

    def _middles_of(self, key: str, recording: Recording) -> dict[str, float]:
        """Return the radii at which the markers of a film are drawn (cached)."""
        x = self.source(key)
        stamp = (key, x.file, tuple(recording.markers))
        if self._middles is None or self._middles[0] != stamp:
            frames = SourceFrames()
            try:
                self._middles = stamp, marker_middles(recording, lambda k: frames.picture(self.path(x), k))
            finally:
                frames.close()
        return self._middles[1]

    def recording(self, key: str) -> Recording | None:
        """Return the recording of a tracked film with markers; the last recording is cached."""
        with self._lock:
            x = self.source(key)
            path = self.folder / x.output
            recorded = x.kind == "film" and tracking_of(x).makes == "recording"
            if not recorded or not self.is_tracked(x) or not path.is_file():
                return None
            stamp = (key, path.stat().st_mtime_ns)
            if self._read is None or self._read[0] != stamp:
                self._read = (stamp, read_recording(path))
            return self._read[1]

    def correct(
        self, key: str, marker: str, frame: int, place: Any, *, confirmed: bool = False
    ) -> dict[str, float] | None:
        """Correct a marker in one frame of a tracked film, or mark it as lost, and rewrite the recording.

        A position far from the positions in the neighbouring frames is stored only if it is `confirmed`; otherwise the
        deviation ``{"jump_deg"}`` [degrees] is returned. The result is None if the correction was stored.
        """
        with self._changing():
            recording = self._tracked_recording(key)
            if place is not None and not (
                isinstance(place, list) and len(place) == 2 and all(isinstance(v, int | float) for v in place)
            ):
                raise UsageError("This position is not valid.", "Click it again.")
            if place is not None and not confirmed:
                apart = jump(recording, marker, frame, place)
                if apart is not None:
                    return {"jump_deg": math.degrees(apart)}
            earlier = next(
                (c for c in corrections(recording) if (c["marker"], c["frame"]) == (marker, frame)), None
            )
            self._rewrite(key, corrected(recording, marker, frame, place))

            def undo() -> None:
                found = self._tracked_recording(key)
                if earlier is None:
                    self._rewrite(key, without_correction(found, marker, frame))
                else:
                    self._rewrite(key, corrected(found, marker, frame, earlier["place_px"]))

            def redo() -> None:
                self._rewrite(key, corrected(self._tracked_recording(key), marker, frame, place))

            self.history.add(f"correction of {marker} in frame {frame}", undo, redo)
            return None

    def uncorrect(self, key: str, marker: str, frame: int) -> None:
        """Delete a correction and restore the result of tracking in this frame."""
        with self._changing():
            recording = self._tracked_recording(key)
            known = [c for c in corrections(recording) if (c["marker"], c["frame"]) == (marker, frame)]
            self._rewrite(key, without_correction(recording, marker, frame))
            place = known[0]["place_px"]

            def undo() -> None:
                self._rewrite(key, corrected(self._tracked_recording(key), marker, frame, place))

            def redo() -> None:
                self._rewrite(key, without_correction(self._tracked_recording(key), marker, frame))

            self.history.add(f"deletion of the correction of {marker} in frame {frame}", undo, redo)

    def _tracked_recording(self, key: str) -> Recording:
        found = self.recording(key)
        if found is None:
            raise UsageError("This film is not tracked yet.", "Track it first.")
        return found

    def _rewrite(self, key: str, changed: Recording) -> None:
        """Write a recording with changed corrections; the clips must then be synchronised again."""
        x = self.source(key)
        path = self.folder / x.output
        command = shlex.join(["gyrotrack", "view"])
        write_recording(path, changed, command=command, settings=read_settings(path), force=True)
        x.result = {**x.result, "warnings": list(changed.warnings)}
        self.state.matched = []
        self._save()

    def track_words(self, x: Source) -> list[str]:
        """Return the command that tracks a film."""
        return tracking_of(x).words(x, self.state)

    def track(self, keys: Sequence[str] = ()) -> None:
        """Track films, by default all films that are not tracked with their current settings."""
        with self._lock:
            if missing := self._missing_to_track():
                raise UsageError(missing[0], "Complete it in step 1.")
            wanted = [self.source(k) for k in keys] or [
                x for x in self.state.sources if x.kind == "film" and not self.is_tracked(x)
            ]
            for x in wanted:
                job = self.jobs.get(f"track:{x.key}")
                if job is not None and job.is_active:
                    continue
                words = self.track_words(x)
                if tracking_of(x).resumes and (self.folder / f"{x.output}.unfinished").exists():
                    words.append("--resume")
                if x.result or (self.folder / x.output).exists():
                    # an existing output may be replaced, because its name was unused when the film was added
                    words.append("--force")
                self._start(f"track:{x.key}", words, partial(self._tracked, x.key, self.track_words(x)))

    def is_tracked(self, x: Source) -> bool:
        """Whether a source has a result for its current settings; always true for a table or a recording."""
        return x.kind != "film" or (bool(x.result) and x.words == self.track_words(x))

    def _is_matchable(self) -> bool:
        """Whether a case can be made now; tracking the film of a single body makes the case directly."""
        return not self._missing_to_match() and self._route().makes_case(self.state)

    def _is_matched(self) -> bool:
        if self._route().makes_case(self.state):
            return not self._missing_to_match() and self.state.matched == self._match_words()
        return len(self.state.sources) == 1 and self.is_tracked(self.state.sources[0])

    def _can_open(self) -> bool:
        """Whether there is a fit to show in the laboratory."""
        route = self._route()
        if not route.fits:
            return self._is_fitted()
        return self._is_matched() and bool(route.result(self.state).get("fits"))

    def _is_fitted(self) -> bool:
        return self._is_matched() and bool(self.state.fit) and self.state.fitted == self.state.matched

    def _start(self, key: str, words: list[str], done: Callable[[dict[str, Any]], None]) -> None:
        """Start a command; when it has succeeded, call `done` with its document and save the state."""

        def finished(job: Job) -> None:
            with suppress(UsageError), self._changing():  # the source may have been removed
                self.revision += 1
                if job.state == "done":
                    self.state.seconds[key.partition(":")[0]] = round(monotonic() - job.began, 2)
                    done(job.document)
                    self._save()

                if job.state == "done":
                    self._go_on()
                else:
                    self._analysing = False
            if job.state == "done" and self._can_open():
                with suppress(Exception):  # the page shows the error when it opens the case
                    self.when_fitted()

        self.revision += 1
        self.jobs.start(key, words, finished)
        self.when_started()

    def _tracked(self, key: str, words: list[str], document: dict[str, Any]) -> None:
        x = self.source(key)
        x.words, x.result = words, _stored_result(document)
        self.state.matched = []
        if tracking_of(x).makes == "case":
            self.state.case = x.output

    def _route(self) -> Route:
        return route_of(self.state.sources)

    def _missing_to_track(self) -> list[str]:
        found = []
        for x in self.state.sources:
            name = Path(x.file).name
            if "error" in self._info(x):
                found.append(str(self._info(x)["error"]))
            elif not x.body:
                found.append(f"Choose the body in {name}.")
            elif x.kind == "film" and x.capture_fps is None:
                found.append(f"Enter the capture rate of {name}.")
        if not self.state.sources:
            found.append("Add films or tables.")
        errors = (
            _inertia_field(getattr(self.state, field), field)["error"] for field in self._route().optional
        )
        return [*found, *filter(None, errors)]

    def _missing_to_match(self) -> list[str]:
        found = self._missing_to_track()
        if found:
            return found[:1]
        untracked = [Path(x.file).name for x in self.state.sources if not self.is_tracked(x)]
        return self._route().missing(self.state, untracked)

    def _match_words(self) -> list[str]:
        s = self.state
        return self._route().words(s, s.case if s.match and s.case else self._unused_name("case.h5"))

    def match(self) -> None:
        """Synchronise the recordings, or import the tables, to a case."""
        with self._lock:
            if missing := self._missing_to_match():
                raise UsageError(missing[0], "Complete it first.")
            if not self._is_matchable():
                raise UsageError("Tracking the film of a single body makes the case.", "Track the film.")
            words = self._match_words()
            case = words[words.index("-o") + 1]
            again = ["--force"] if self.state.match else []

            def matched(document: dict[str, Any]) -> None:
                self.state.case = case
                self.state.match, self.state.matched = self._match_result(document), words
                if not self._route().fits:
                    self.when_matched()

            self._start("match", [*words, *again], matched)

    def _match_result(self, document: dict[str, Any]) -> dict[str, Any]:
        """Return the result for the page: each clip with its interval on the clock of the casing."""
        keys = ("offset_s", "offset_sigma_s", "rate", "rate_sigma", "ambiguous", "misfit_rad")
        sources = {x.output or Path(x.file).name: x for x in self.state.sources}
        clips = [
            {"name": Path(x.file).name, "offset_s": 0.0, "duration_s": _duration(x)}
            for x in self.state.sources
            if x.body == "casing" and self._route().name == "sync"
        ]
        for c in document.get("clips", []):
            x = sources.get(Path(c["source"]).name)
            name = Path(x.file).name if x is not None else Path(c["source"]).name
            duration = _duration(x) if x is not None else None
            clips.append({"name": name, "duration_s": duration, **{k: c[k] for k in keys}})
        own = _stored_result(document) if "motion" in document else {"fits": 1}
        return own | {"clips": clips, "warnings": document.get("warnings", []), "case": self.state.case}

    def fit(self) -> None:
        """Fit the reduced model to the case."""
        with self._lock:
            if not self.state.case:
                raise UsageError("There is no case yet.", "Synchronise the clips first.")

            def fitted(document: dict[str, Any]) -> None:
                self.state.fit = {k: document.get(k) for k in ("fit_id", "verdict", "n_eff", "bic")}
                self.state.fitted = self.state.matched

            self._start("fit", ["fit", self.state.case], fitted)

    def analyse(self) -> None:
        """Run all missing steps one after the other: tracking, synchronisation, fit."""
        with self._lock:
            if missing := self._missing_to_track():
                raise UsageError(missing[0], "Complete it in step 1.")
            self._analysing = True
            self._go_on()

    def _go_on(self) -> None:
        """Start the next step of `analyse`; stop if an entry is missing. The page names this entry."""
        films = [x for x in self.state.sources if x.kind == "film"]
        if not self._analysing or any(self._is_tracking(x) for x in films):
            return
        if any(not self.is_tracked(x) for x in films):
            self.track()
        elif self._is_matchable() and not self._is_matched():
            self.match()
        elif self._is_matched() and not self._route().fits and not self._is_fitted():
            self.fit()
        else:
            self._analysing = False
            self.revision += 1

    def _is_tracking(self, x: Source) -> bool:
        job = self.jobs.get(f"track:{x.key}")
        return job is not None and job.is_active

    def cancel(self, name: str) -> None:
        """Cancel a step: "match", "fit", "track:KEY", or "all" running steps."""
        self._analysing = False
        for key in [k for k in self.jobs.active() if k == name or name == "all"]:
            self.jobs.cancel(key)
        self.revision += 1

    def _relative(self, path: Path) -> str:
        return path.name if path.parent == self.folder else str(path)

    @contextmanager
    def _changing(self) -> Iterator[None]:
        """Hold the lock, and restore the stored state after an error."""
        with self._lock:
            try:
                yield
            except BaseException:
                self.state = State.model_validate_json(self._saved)
                raise

    def _save(self, undoable: str = "") -> None:
        """Write the state if it is valid; a change with a name can be undone."""
        try:
            text = json.dumps(self.state.model_dump(), indent=1, allow_nan=False)
            State.model_validate_json(text)
        except ValueError as error:
            what = "This entry is too long, or has characters that are not valid."
            raise UsageError(what, "Correct it.") from error
        with new_file(self.folder / STATE_FILE, force=True) as stream:
            stream.write((text + "\n").encode())
        changes = difference(json.loads(self._saved), json.loads(text)) if undoable else []
        self._saved = text
        self.revision += 1
        if changes:
            self.history.add(undoable, partial(self._apply, changes, 0), partial(self._apply, changes, 1))

    def _apply(self, changes: Sequence[Change], side: int) -> None:
        """Set all changed fields to their values before (0) or after (1) a change."""
        with self._changing():
            content = self.state.model_dump()
            apply(content, changes, side)
            self.state = State.model_validate(content)
            for x in self.state.sources:
                if x.picks and x.profile and x.profile == x.marked:
                    self._write_profile(x)
            self._save()

    def _read_state(self) -> State:
        """Return the stored state; an invalid file is renamed, and the state is then empty."""
        path = self.folder / STATE_FILE
        refuse_special(path, ConfigurationError)
        try:
            return State.model_validate_json(path.read_bytes())
        except FileNotFoundError:
            return State()
        except OSError as error:
            what = f"{path} cannot be read: {error.strerror}."
            raise ConfigurationError(what, "Check its permissions.") from error
        except ValueError:
            number = 1
            while (aside := path.with_name(f"workbench.unreadable-{number}.json")).exists():
                number += 1
            path.rename(aside)
            self.notes.append(f"{path} is not a valid state of the workbench; it is kept as {aside.name}.")
            return State()

    def close(self) -> None:
        """End all processes; checkpoints are kept."""
        self.jobs.close()
        self._holds.close()


_FIELDS = ("label", "surface", "body_name", "inertia_rotor", "inertia_casing", "inertia")


def _reading_document(document: dict[str, Any]) -> dict[str, Any]:
    """Return the part of a dry run of `import` that the page shows."""
    return {k: document.get(k, []) for k in ("reading", "plot", "warnings")}


def _command(words: Sequence[str]) -> str:
    return shlex.join(["gyrotrack", *words])


def _rate(value: Any) -> float | None:
    if value in ("", None):
        return None
    try:
        rate = float(str(value).replace(",", "."))
    except ValueError:
        rate = math.nan
    if not 0 < rate < FASTEST:
        raise UsageError("The capture rate is not a positive number.", "Enter it in frames per second.")
    return rate


def _inertia_field(text: str, field: str) -> dict[str, str]:
    """Return the parsed moment of inertia as text, or the error message."""
    if not text:
        return {"value": "", "error": ""}
    try:
        found = Inertia.of(text, field.partition("_")[2] or "body")
    except UsageError as error:
        return {"value": "", "error": f"{error.message} {error.hint}"}
    if math.isfinite(found.u):
        return {"value": with_uncertainty(found.value, found.u, "kg m2"), "error": ""}
    return {"value": f"{short(found.value, 4)} kg m², no uncertainty given", "error": ""}


def _stored_result(document: dict[str, Any]) -> dict[str, Any]:
    """Return the part of a document that is stored and shown."""
    if "motion" in document:  # document of `spindown`
        diagnosis = document.get("diagnosis") or {}
        return {
            "motion": document["motion"],
            "fits": len(document.get("ladder") or []),
            "sentence": diagnosis.get("sentence", ""),
            "warnings": document.get("warnings", []),
        }
    keys = ("frames", "markers", "body", "sense", "capture_fps", "warnings")
    return {k: document.get(k) for k in keys}


def _duration(x: Source) -> float | None:
    frames, rate = x.result.get("frames"), x.result.get("capture_fps")
    return float(frames) / float(rate) if frames and rate else None
