"""One body as the camera sees it: which sightings can be trusted, and where its markers are about a centre."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gyrotrack.angles.candidates import Candidate, candidate, plausible
from gyrotrack.angles.sightings import Sightings
from gyrotrack.dataset.columns import set_down
from gyrotrack.geometry.centre import CentrePath
from gyrotrack.geometry.refining import Radii
from gyrotrack.geometry.scene import Paper
from gyrotrack.geometry.tilt import Flattening, fit_flattening, lent_flattening

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# The corners of a paper reach as far as 0.7 of its smeared half width when it is not smeared.
_CORNER = 0.7


@dataclass(frozen=True)
class View:
    """The sightings of a body's markers.

    Attributes
    ----------
    papers : tuple of Paper
        The markers.
    sightings : dict of Sightings
        By name.
    inside, whole : dict of ndarray of bool, shape (n,)
        Where a marker lies in the picture, and where it also is open and looks as it should.
    """

    papers: tuple[Paper, ...]
    sightings: dict[str, Sightings]
    inside: dict[str, Mask]
    whole: dict[str, Mask]

    @property
    def radius(self) -> float:
        """Mean radius of the markers in px."""
        return float(np.mean([p.radius for p in self.papers]))

    @property
    def coloured(self) -> tuple[str, ...]:
        """The markers seen in the planes of colour, as the disc is; luma may lie beside by half a px."""
        return tuple(p.name for p in self.papers if p.colour != "white")

    def place(self, name: str, centre: Floats) -> Floats:
        """Return where a marker is relative to the centre, (n, 2) in px, y up."""
        away = self.sightings[name].position(self.whole[name])
        away -= centre
        away[:, 1] *= -1.0
        set_down()
        return away

    def flattening(self, centre: Floats) -> Flattening:
        """Fit tilt and offsets to the orbits of the markers."""
        return fit_flattening(self._orbits(centre))

    def lent(self, centre: Floats, lender: Flattening, shift: Floats, size: float) -> Flattening:
        """Take the tilt from another body, and fit offsets to the arcs of the markers (see `lent_flattening`)."""
        return lent_flattening(lender, self._orbits(centre), shift, size)

    def _orbits(self, centre: Floats) -> dict[str, Floats]:
        return {p.name: self._trusted(p.name, centre) for p in self.papers}

    def _trusted(self, name: str, centre: Floats) -> Floats:
        v = self.place(name, centre)
        return v[self.whole[name] & np.isfinite(v).all(axis=1)]

    def radii(self, centre: Floats, flat: Flattening) -> Iterator[Radii]:
        """Yield by how much each marker's radius is too large in each frame."""
        for paper in self.papers:
            v = flat.level(paper.name, self.place(paper.name, centre))
            radius = np.where(self.whole[paper.name], np.hypot(v[:, 0], v[:, 1]), np.nan)
            usual = float(np.nanmedian(radius)) if np.isfinite(radius).any() else np.nan
            yield Radii(np.arctan2(v[:, 1], v[:, 0]), radius - usual)

    def candidates(self, centre: CentrePath, flat: Flattening) -> dict[str, Candidate]:
        """Return the markers' angles as seen from straight above, and how far to trust them."""
        found = {}
        for paper in self.papers:
            v = flat.level(paper.name, self.place(paper.name, centre.centre))
            angle = np.asarray(np.arctan2(v[:, 1], v[:, 0]))
            good = plausible(self.sightings[paper.name]) & self.inside[paper.name]
            found[paper.name] = candidate(self.sightings[paper.name], angle, good, paper.mount)
        return found


def view(papers: tuple[Paper, ...], sightings: dict[str, Sightings], size: tuple[int, int]) -> View:
    """Look at the sightings of a body's markers in a picture of (width, height) px."""
    inside = {
        p.name: ~sightings[p.name].outside(p.inner, p.outer, _CORNER * p.half_width, size) for p in papers
    }
    whole = {m: plausible(sightings[m]) & sightings[m].open & inside[m] for m in inside}
    return View(papers, sightings, inside, whole)
