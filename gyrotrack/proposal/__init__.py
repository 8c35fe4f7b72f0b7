"""A profile proposed from the film alone: which colours turn about which centre, and on which body.

`hues` finds the colours of what moves, `markers` the papers that turn about a common centre, `bodies` tells which of
them sit on one body and which body is which, `finding` brings it together, `picture` shows it.
"""

from __future__ import annotations

from gyrotrack.proposal.finding import Proposal, propose
from gyrotrack.proposal.naming import ProposedMarker
from gyrotrack.proposal.picture import write_picture

__all__ = ["Proposal", "ProposedMarker", "propose", "write_picture"]
