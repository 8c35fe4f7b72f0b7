"""The ranges in which the paper lets its general model move about the reduced fits."""

from __future__ import annotations

from collections.abc import Sequence

from fitting.estimation import Fit

# share of the reduced value by which each parameter may move; all others keep their declared bounds
WIDTHS = {
    "rotor.air.quadratic.a2": 0.2,
    "casing.air.linear.b2": 0.2,
    "bearing.power.g": 0.2,
    "bearing.linear.d": 0.5,
    "bearing.power.f": 0.5,
}


def paper_ranges(reduced: Sequence[Fit], labels: Sequence[str] = ()) -> dict[str, tuple[float, float]]:
    """Return ranges about the mean of some fits of the reduced model.

    That the mean is over the separate fits can be read off the paper: g = 1.05 and f = 0.0795e-7 of its second
    case lie on the edges 0.8 (1.32 + 1.30)/2 and 0.5 (0.126 + 0.192)/2 e-7.

    Parameters
    ----------
    reduced : sequence of Fit
        Fits of the reduced model.
    labels : sequence of str
        Cases of the joint fit in which some of the parameters are each case's own.

    Returns
    -------
    dict
        Bounds by name. A parameter that the reduced fits put at zero keeps its declared bounds.
    """
    ranges = {}
    for key, width in WIDTHS.items():
        values = [
            e.value for fit in reduced for name, e in fit.estimates.items() if name.partition("@")[0] == key
        ]
        mean = sum(values) / len(values) if values else 0.0
        if mean > 0:
            for name in (key, *(f"{key}@{label}" for label in labels)):
                ranges[name] = ((1 - width) * mean, (1 + width) * mean)
    return ranges
