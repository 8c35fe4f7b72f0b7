"""The public functions that make a case from films: extract, sync, read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Literal

from gyrotrack.io._atomic import refuse_existing
from gyrotrack.io._hdf5 import read_case, read_kind, read_recording, write_case
from gyrotrack.io._records import Case, Inertia, Recording
from gyrotrack.synchronisation._decision import Synchronised, synchronise
from gyrotrack.tracking._extract import ExtractionJob
from gyrotrack.tracking._extract import extract as track
from gyrotrack.tracking._profile import PAPER, Profile, load

Progress = Callable[[int, int | None], None]


def _ignore(*_: object) -> None:
    """Discard progress and messages."""


def extract(
    video: str | Path,
    output: str | Path | None = None,
    *,
    capture_fps: float | None = None,
    profile: Profile | str | Path | None = None,
    body: Literal["casing", "rotor", "both"] | None = None,
    times: Literal["auto", "stamps", "frames"] = "auto",
    workers: int | None = 1,
    resume: bool = False,
    force: bool = False,
    progress: Progress | None = None,
) -> Recording:
    """Track the markers of a film and return the angles of its bodies with their uncertainties.

    Parameters
    ----------
    video : str or Path
        The film.
    output : str or Path, optional
        HDF5 file to write; without it nothing is written, and `resume` and `force` have no effect.
    capture_fps : float, optional
        Capture rate of the camera [1/s]; by default the first known rate of these three: in the profile, in the tag of
        the camera, in the container.
    profile : Profile, str or Path, optional
        Markers and their colours, or a TOML file that defines them; by default the markers of the paper.
    body : {"casing", "rotor", "both"}, optional
        Body to track; by default every body in view.
    times : {"auto", "stamps", "frames"}
        "frames" counts frames at the capture rate, "stamps" uses the timestamps of the film, and "auto" uses the
        timestamps if the frame rate varied.
    workers : int or None
        Number of processes that track parts of the film; None: one per core. A script that starts several processes
        needs the guard ``if __name__ == "__main__":``.
    resume : bool
        Continue an interrupted run of the same film and settings; if the output is complete, read and return it.
    force : bool
        Replace an existing output.
    progress : callable, optional
        Called with (frames done, frames in total or None).

    Returns
    -------
    Recording
        ``recording.bodies["casing"]`` has the arrays time [s], angle [rad], sigma [rad], omega [rad/s], each (n,).

    Raises
    ------
    VideoError
        The film cannot be decoded, or its capture rate is unknown.
    TrackingError
        No markers are found, or the requested body is not in view.
    OutputError
        The output exists (see `force`) or cannot be written.

    Examples
    --------
    >>> recording = extract("rotor_1.mp4", "rotor_1.h5", capture_fps=1000)  # doctest: +SKIP
    >>> recording.bodies["rotor"].omega  # doctest: +SKIP
    """
    chosen = profile if isinstance(profile, Profile) else PAPER if profile is None else load(Path(profile))
    if output is None:
        return track(
            Path(video),
            chosen,
            capture_fps=capture_fps,
            body=body,
            times=times,
            workers=workers,
            progress=progress,
        )
    task = ExtractionJob(Path(video), Path(output), chosen, capture_fps, body, times, workers)
    if resume and not force and (complete := task.earlier()) is not None:
        return complete
    read = None if isinstance(profile, Profile) or profile is None else Path(profile)
    refuse_existing(task.target, force=force, reads=[task.video, read])

    @contextmanager
    def bar() -> Iterator[Progress]:
        yield progress or _ignore

    recording, _ = task.run(command="gyrotrack.extract", bar=bar, tell=_ignore, resume=resume, force=force)
    return recording


def sync(
    casing: Recording | str | Path,
    rotors: Sequence[Recording | str | Path],
    output: str | Path | None = None,
    *,
    inertia_rotor: float | str,
    inertia_casing: float | str,
    label: str = "",
    surface: str = "",
    force: bool = False,
    progress: Progress | None = None,
) -> Case:
    """Put the recordings of one experiment on one clock and return the case.

    The rotor recordings must show the casing too: the angle of the casing, which both cameras measure, determines the
    start of each recording.

    Parameters
    ----------
    casing : Recording, str or Path
        The recording of the casing through the whole run, or its file.
    rotors : sequence of Recording, str or Path
        The recordings of the rotor.
    output : str or Path, optional
        HDF5 file to write; without it nothing is written.
    inertia_rotor, inertia_casing : float or str
        Moments of inertia [kg m2], or texts like "5.54e-5 +- 0.06e-5" and "554 g cm2".
    label, surface : str
        Name of the case, and the surface on which the casing turned.
    force : bool
        Replace an existing output.
    progress : callable, optional
        Called with (clips done, clips in total).

    Returns
    -------
    Case
        ``case.casing`` and ``case.rotor`` have the arrays time [s], angle [rad], sigma [rad], omega [rad/s];
        ``case.placements`` has the start and the clock rate of each clip with uncertainties.

    Raises
    ------
    SyncError
        A clip does not belong to this run, is given twice, or does not show the casing.
    UsageError
        A moment of inertia is not positive, or no rotor recording is given.
    OutputError
        The output exists (see `force`) or cannot be written.

    Examples
    --------
    >>> case = sync(  # doctest: +SKIP
    ...     "casing.h5", ["rotor_1.h5"], "case1.h5", inertia_rotor=5.54e-5, inertia_casing=2.06e-5
    ... )
    """
    if isinstance(rotors, str | Path | Recording):
        rotors = [rotors]
    if output is not None:
        files = [Path(r) for r in (casing, *rotors) if not isinstance(r, Recording)]
        refuse_existing(Path(output), force=force, reads=files)
    inertias = Inertia.of(inertia_rotor, "rotor"), Inertia.of(inertia_casing, "casing")
    found = synchronised(casing, rotors, label, surface, inertias, progress)
    if output is not None:
        settings = {"I_rotor": inertias[0].value, "I_casing": inertias[1].value}
        write_case(Path(output), found.case, command="gyrotrack.sync", settings=settings, force=force)
    return found.case


def synchronised(
    casing: Recording | str | Path,
    rotors: Sequence[Recording | str | Path],
    label: str,
    surface: str,
    inertias: tuple[Inertia, Inertia],
    progress: Progress | None = None,
) -> Synchronised:
    """Synchronise recordings or files of recordings; see `sync`."""
    given = [casing, *rotors]
    recordings = [r if isinstance(r, Recording) else read_recording(Path(r)) for r in given]
    names = [
        r.source or f"recording {i}" if isinstance(r, Recording) else Path(r).name
        for i, r in enumerate(given)
    ]
    found = synchronise(
        recordings[0],
        recordings[1:],
        names,
        label=label,
        surface=surface,
        I_rotor=inertias[0].value,
        I_casing=inertias[1].value,
        progress=progress,
    )
    case = replace(found.case, I_rotor_u=inertias[0].u, I_casing_u=inertias[1].u)
    return Synchronised(case, found.matches)


def read(path: str | Path) -> Recording | Case:
    """Read a file written by gyrotrack.

    Parameters
    ----------
    path : str or Path
        A recording, as `extract` writes it, or a case, as `sync` writes it.

    Returns
    -------
    Recording or Case

    Raises
    ------
    DatasetError
        The file does not exist, is damaged, or was not written by gyrotrack.

    Examples
    --------
    >>> read("case1.h5")  # doctest: +SKIP
    """
    path = Path(path)
    return read_case(path) if read_kind(path) == "case" else read_recording(path)
