"""The figures of one case of a report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from gyrotrack.report.case_view import CaseView
from gyrotrack.report.figures import Picture

if TYPE_CHECKING:
    from gyrotrack.dataset import Case
    from gyrotrack.report.frames import Sheet
    from gyrotrack.report.tracks import Tracks


@dataclass(frozen=True)
class Section:
    """The figures of one case, under a heading if there are several."""

    heading: str
    surface: str
    motion: tuple[Picture, ...]
    misfit: tuple[Picture, ...]
    torque: Picture
    energy: Picture
    tracking: tuple[Picture, ...]
    sheets: tuple[Sheet, ...]


def section(
    view: CaseView,
    index: int,
    changes: tuple[str, ...],
    heading: str,
    case: Case | None,
    tracks: Tracks | None,
    films: Sequence[Path],
) -> Section:
    """Return the figures of the case at `index`; those of tracking and films if there is a `case` with its clips.

    `changes` are the names of the ladder's rungs.
    """
    from gyrotrack.report.figures.misfit import misfit_picture
    from gyrotrack.report.figures.motion import casing_picture, rotor_picture
    from gyrotrack.report.figures.numbers import energy_picture
    from gyrotrack.report.figures.torque import torque_picture
    from gyrotrack.report.frames import contact_sheets

    stretches = [(f.t_start, f.t_stop) for f in view.failures]
    return Section(
        heading=heading,
        surface=view.surface,
        misfit=(misfit_picture(view, f"misfit{index}"),),
        motion=(
            casing_picture(view, f"casing{index}"),
            *((rotor_picture(view, f"rotor{index}"),) if view.rotor else ()),
        ),
        torque=torque_picture(view, f"torque{index}"),
        energy=energy_picture(view, changes, f"energy{index}"),
        tracking=_tracking(view, tracks, index),
        sheets=tuple(contact_sheets(case, films, stretches)) if case is not None and films else (),
    )


def _tracking(view: CaseView, tracks: Tracks | None, index: int) -> tuple[Picture, ...]:
    from gyrotrack.report.figures.tracking import centre_picture, sigma_picture, sync_picture

    if tracks is None:
        return ()
    return (
        sigma_picture(tracks, view, f"sigma{index}"),
        centre_picture(tracks, view, f"centre{index}"),
        sync_picture(tracks, f"sync{index}"),
    )
