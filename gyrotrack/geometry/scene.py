"""What acquisition found in a clip, before it is tracked frame by frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Disc:
    """The coloured disc at the centre: (x, y) and radius in px, and its chroma against its surroundings."""

    centre: tuple[float, float]
    radius: float
    chroma: tuple[float, float]


@dataclass(frozen=True)
class Paper:
    """One marker as it looks in the clip.

    Attributes
    ----------
    name, body, colour : str
        From the profile.
    inner, outer : float
        Radii between which it lies, in px.
    half_width : float
        Half its width (with smear) as an angle at the centre, in rad.
    foot : float
        Angle from its middle to where nothing of it is seen any more, in rad.
    contrast : tuple of float
        Its difference from what lies around it: (U, V) for a colour, (Y, 0) for white, in grey levels.
    stay : float
        Largest share of the samples in which it lies over one direction: near 1 for a body that stands.
    mount : float
        Its angle relative to the body's zero, as seen (counter-clockwise), in rad.
    """

    name: str
    body: str
    colour: str
    inner: float
    outer: float
    half_width: float
    contrast: tuple[float, float]
    foot: float
    mount: float = 0.0
    stay: float = 0.0

    @property
    def radius(self) -> float:
        """Radius of the middle in px."""
        return 0.5 * (self.inner + self.outer)


@dataclass(frozen=True)
class Scene:
    """A clip's scene.

    Attributes
    ----------
    centre : tuple of float
        Where the bodies turn, (x, y) in px, at the time of acquisition.
    disc : Disc or None
        The disc at the centre; None where the centre is taken from the orbit.
    papers : tuple of Paper
        The markers that were found.
    missing : tuple of str
        Names of those that were not.
    warnings : tuple of str
        What the user should know.
    """

    centre: tuple[float, float]
    disc: Disc | None
    papers: tuple[Paper, ...]
    missing: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    def of(self, body: str) -> tuple[Paper, ...]:
        """Return the markers of one body."""
        return tuple(paper for paper in self.papers if paper.body == body)

    @property
    def bodies(self) -> tuple[str, ...]:
        """Bodies of which at least one marker was found."""
        return tuple(body for body in ("casing", "rotor") if self.of(body))
