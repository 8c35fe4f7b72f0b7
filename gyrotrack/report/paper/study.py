"""What the paper's figures show of a study: data and the curves of four fits for each case."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from fitting.case_data import CaseData
    from fitting.estimation import Fit
    from fitting.scanning import Scan
    from gyrotrack.dataset import Case

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Shown:
    """One of the paper's fits of one case: its short name, the fit, and which of the fit's cases it is."""

    name: str
    fit: Fit
    index: int


@dataclass(frozen=True)
class PaperCase:
    """One case: its record, the tracking behind it if there is any, and its fits (RM, GM, RM-JF, GM-JF)."""

    label: str
    data: CaseData
    case: Case | None
    fits: tuple[Shown, ...]

    @property
    def reduced(self) -> Shown:
        """The separate fit of the reduced model."""
        return self.fits[0]


def paper_cases(scan: Scan, data: Sequence[CaseData], cases: Sequence[Case]) -> list[PaperCase]:
    """Return the cases of a study with the fits that a scan made of them."""
    known = {c.label: c for c in cases}
    short = {"reduced": "RM", "general": "GM"}
    found = []
    for i, d in enumerate(data):
        fits = [Shown(short[m.name], m.separate[i], 0) for m in scan.models]
        fits += [Shown(f"{short[m.name]}-JF", m.joint, i) for m in scan.models if m.joint is not None]
        found.append(PaperCase(d.record.label, d, known.get(d.record.label), tuple(fits)))
    return found


def clear_frame(cases: Sequence[PaperCase], folders: Sequence[Path]) -> NDArray[np.uint8] | None:
    """Return a frame (red, green, blue) on which most markers are found, drawn over; None without any film."""
    from gyrotrack.dataset import STATUS
    from gyrotrack.errors import GyrotrackError
    from gyrotrack.pipeline.film import Film, find_film

    for case in cases:
        # clips of the rotor show all papers at the higher rate
        recordings = case.case.recordings.values() if case.case is not None else ()
        for r in sorted(recordings, key=lambda r: -r.capture_fps):
            path = find_film(r, list(folders))
            if path is None or not r.markers:
                continue
            whole = np.sum([m.status == STATUS["ok"] for m in r.markers.values()], axis=0)
            try:
                with Film(path, r) as film:
                    picture = film.picture(int(np.argmax(whole)))
            except GyrotrackError:
                continue
            if picture is not None:
                return np.ascontiguousarray(picture[..., ::-1])
    return None
