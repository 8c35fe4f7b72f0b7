"""Which moving colours are called what: the bodies by how fast they turn, the markers by colour and body."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from gyrotrack.geometry.papers import placed
from gyrotrack.geometry.scene import Paper
from gyrotrack.profile import Body, MarkerProfile
from gyrotrack.proposal.bodies import Group
from gyrotrack.proposal.markers import Candidate, Circle
from gyrotrack.segmentation.colour import nearest_colour


@dataclass(frozen=True)
class ProposedMarker:
    """A marker that was chosen: as it stands in the profile, and how it looks in the film.

    Attributes
    ----------
    profile, paper
        Both.
    angle, clear : ndarray, shape (n,)
        Its angle in each sample [rad], and whether it was seen clearly.
    step : float
        By how much its body turns from frame to frame [rad].
    """

    profile: MarkerProfile
    paper: Paper
    angle: npt.NDArray[np.float64]
    clear: npt.NDArray[np.bool_]
    step: float

    @property
    def seen(self) -> float:
        """Share of the samples in which it was seen clearly."""
        return float(self.clear.mean())


def resting_casing(standing: list[Group], groups: list[Group], circle: Circle | None) -> Group | None:
    """Return the marker on a casing that rests all through the film: it has the colour of the disc."""
    if circle is None or len(groups) != 1:
        return None
    colour = nearest_colour(circle.hue)
    alike = [g for g in standing if g.members[0].colour == colour]
    moving = {c.colour for c in groups[0].members}
    return alike[0] if alike and colour not in moving else None


def name_bodies(
    groups: list[Group], resting: Group | None, circle: Circle | None
) -> tuple[dict[Body, Group], list[str]]:
    """Name the bodies; the rotor is the one that turns faster."""
    notes = []
    if len(groups) > 2:
        colours = ", ".join(c.colour for g in groups[2:] for c in g.members)
        notes.append(f"more than two bodies seem to turn; left out: {colours}")
    if resting is not None:
        colour = resting.members[0].colour
        notes.append(
            f"the {colour} marker stands still; it is taken for the casing's, as it has the colour of the disc"
        )
        return {"casing": resting, "rotor": groups[0]}, notes
    if len(groups) == 1:
        (one,) = groups
        alone = len(one.members) == 1
        casing = alone and circle is not None and nearest_colour(circle.hue) == one.members[0].colour
        name: Body = "casing" if casing else "rotor"
        why = "it has the colour of the disc" if casing else "nothing else turns"
        notes.append(f"only one body is seen to turn; it is taken for the {name}, as {why}")
        return {name: one}, notes
    slow, fast = sorted(groups[:2], key=lambda g: abs(g.pace.step))
    if abs(fast.pace.step) < 1.25 * abs(slow.pace.step):
        # What lies on the casing is never hidden; its bar passes over what lies on the rotor.
        open_share = [min(float(c.sighting.clear.mean()) for c in g.members) for g in (slow, fast)]
        if len(fast.members) < len(slow.members) or (
            len(fast.members) == len(slow.members) and open_share[1] > open_share[0]
        ):
            slow, fast = fast, slow
        notes.append("both bodies turn about equally fast: which one is the rotor is a guess")
    return {"casing": slow, "rotor": fast}, notes


def name_markers(bodies: dict[Body, Group], notes: list[str]) -> list[ProposedMarker]:
    """Give every marker a name; of two of one hue on one body neither can be told from the other."""
    found: list[ProposedMarker] = []
    taken: set[str] = set()
    for body, group in bodies.items():
        papers = placed([c.sighting for c in group.members])
        for candidate, seen in zip(group.members, papers, strict=True):
            colour = candidate.colour
            name = colour if colour not in taken else f"{colour}_{body}"
            if name in taken:
                name = f"{name}_{sum(t.startswith(name) for t in taken) + 1}"
            if candidate.twin:
                notes.append(
                    f"a second {colour} marker is there beside that on the {body}; they may be taken for each "
                    "other: give one another colour"
                )
            taken.add(name)
            marker = MarkerProfile(name=name, colour=colour, body=body, hue=round(candidate.hue, 1))
            paper = replace(seen.paper, name=name, body=body, colour=colour)
            found.append(ProposedMarker(marker, paper, seen.angle, seen.clear, group.pace.step))
    return found


def left_out(candidate: Candidate) -> str:
    """Say why a colour that moves is no marker of the profile."""
    if candidate.twin:
        return (
            f"there are two {candidate.colour} markers, which cannot be told apart: give one another colour; "
            "they are left out"
        )
    return f"something {candidate.colour} moves, but not evenly about the centre; it is left out"
