"""A film tracked into a file: from its start, from where an earlier run was stopped, or not at all as it is done."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

from gyrotrack.dataset import Recording, read_recording, read_settings, write_recording
from gyrotrack.dataset.journal import Journal
from gyrotrack.errors import DatasetError
from gyrotrack.pipeline.extraction import extract, run_facts
from gyrotrack.pipeline.notes import frames_kept
from gyrotrack.profile import Profile
from gyrotrack.video import file_sha256, probe

Bar = Callable[[], AbstractContextManager[Callable[[int, int | None], None]]]


@dataclass(frozen=True)
class Task:
    """One film, and what is wanted of it.

    Attributes
    ----------
    video, target : Path
        The film, and the file to write.
    profile : Profile
        Its markers.
    capture_fps : float, optional
        Frames a second of the camera; the profile's or the film's own, if not given.
    body : str, optional
        Track only this body.
    times : {"auto", "stamps", "frames"}
        Where the times of the frames are from.
    """

    video: Path
    target: Path
    profile: Profile
    capture_fps: float | None = None
    body: str | None = None
    times: str = "auto"

    @property
    def settings(self) -> dict[str, Any]:
        """What shaped the result, as the file keeps it."""
        return {
            "video": self.video,
            "capture_fps": self.capture_fps,
            "body": self.body,
            "times": self.times,
            "profile": self.profile.model_dump(mode="json"),
        }

    def earlier(self) -> Recording | None:
        """Return the output if it is there already, of this film and these settings.

        Raises
        ------
        VideoError
            The film cannot be read.
        """
        probe(self.video)
        try:
            same = {**read_settings(self.target), "video": None} == {**self.settings, "video": None}
            recording = read_recording(self.target) if same else None
        except DatasetError:
            return None
        if recording is None or recording.source_sha256 != file_sha256(self.video):
            return None
        with Journal(self.target, {}) as journal:  # of a run that was killed just after it wrote the output
            journal.discard()
        return recording

    def run(
        self,
        *,
        command: str,
        bar: Bar,
        tell: Callable[[str], None],
        resume: bool = False,
        force: bool = False,
    ) -> tuple[Recording, float]:
        """Track the film and write the output.

        Parameters
        ----------
        command : str
            The words by which this was called, for the file.
        bar : callable
            Opens what shows (frames done, frames in all).
        tell : callable
            Hears where the run begins, and what is kept of it when it is interrupted.
        resume : bool
            Go on with the journal of an earlier run, if there is one.
        force : bool
            Replace an existing output.

        Returns
        -------
        tuple of (Recording, float)
            What was written, and the frames done in a second.

        Raises
        ------
        VideoError, TrackingError, OutputError
            The film cannot be read, shows no markers, or the output cannot be written.
        """
        with Journal(
            self.target, run_facts(self.video, self.profile, self.body, self.times), resume=resume
        ) as journal:
            taken = frames_kept(journal)
            if resume:
                tell(_resumed(journal, taken))
            start = perf_counter()
            try:
                with bar() as progress:
                    recording = extract(
                        self.video,
                        self.profile,
                        capture_fps=self.capture_fps,
                        body=self.body,
                        times=self.times,
                        progress=progress,
                        journal=journal,
                    )
            except KeyboardInterrupt:
                if kept := frames_kept(journal):
                    tell(f"{kept} frames are kept; the same command with --resume goes on from there")
                raise
            pace = (recording.frames_decoded - taken) / max(perf_counter() - start, 1e-9)
            write_recording(self.target, recording, command=command, settings=self.settings, force=force)
            journal.discard()
        return recording, pace


def _resumed(journal: Journal, taken: int) -> str:
    if taken:
        return f"going on after frame {taken - 1}"
    if journal.other:
        return f"{journal.path.name} was of another film, profile or version; starting from the first frame"
    return "no unfinished run is there; starting from the first frame"
