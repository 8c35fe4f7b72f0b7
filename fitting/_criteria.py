"""Every threshold that determines a result, in one record.

`fit`, `diagnose`, `improve`, `laws`, `certify` and `plan` take a `Criteria`. A fit keeps its own, with which the noise
of its recordings was measured; a search with other criteria of the noise repeats the fit with them (`NOISE`).

>>> from dataclasses import replace
>>> strict = replace(Criteria(), significance=0.001)

``print(Criteria())`` lists all of them with their meaning and source.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any

from fitting._errors import EstimationError

_KASS = "Kass & Raftery 1995"
_NULL = "Westfall & Young 1993"


def _criterion(default: Any, meaning: str, source: str = "") -> Any:
    return field(default=default, metadata={"meaning": meaning, "source": source})


@dataclass(frozen=True)
class Criteria:
    """Thresholds of the search for a missing effect; immutable, changed with `dataclasses.replace`.

    A probability lies in (0, 1], a share in [0, 1]; differences of deviance and of BIC are twice a logarithm of a
    likelihood ratio, without unit; "sigma" counts standard errors.

    Sources: R. Kass, A. Raftery, J. Am. Stat. Assoc. 90, 773 (1995): a BIC difference of 2 is positive evidence, of 10
    very strong. P. Westfall, S. Young, Resampling-Based Multiple Testing (1993): p-values over a list from simulated
    null data. J. Hart, Nonparametric Smoothing and Lack-of-Fit Tests (1997). Where no source is named, the value
    is a convention of this package.

    Raises
    ------
    EstimationError
        If a value is not a finite number in its range.
    """

    # fmt: off
    significance: float = _criterion(0.03, "family-wise p-value below which a candidate is significant", _NULL)
    evidence: float = _criterion(2.0, "fall of BIC that an added effect needs", _KASS)
    evidence_periodic: float = _criterion(10.0, "the same for periodic laws on tracked film", _KASS)
    equivalence_width: float = _criterion(10.0, "BIC difference of indistinguishable candidates", _KASS)
    collinearity: float = _criterion(0.9999, "cosine of responses that no data separates")
    measurement_penalty: float = _criterion(3.2, "BIC added to measurement effects", "prior odds 1:5, 2 ln 5")
    shape_evidence: float = _criterion(10.0, "fall of BIC that frees a shape constant of a law", _KASS)
    essential_sigma: float = _criterion(3.3, "strength below which an added effect is tried without", "p = 0.001")
    crowded: int = _criterion(3, "added effects from which on each is tried without")
    max_steps: int = _criterion(5, "effects that `improve` adds at most")
    named_sigma: float = _criterion(3.0, "strength over its standard uncertainty from which an effect is named")
    follow_up: int = _criterion(1, "further effects that `diagnose` adds at most")
    explained: float = _criterion(0.95, "share of unmodelled torque that an approximate answer explains")
    lack_of_fit: float = _criterion(1e-5, "p-value of slow torques below which a fit fails", "Draper 1998")
    reduced_chi2: float = _criterion(1.4, "reduced chi2 of rows above which a fit fails, at p < `lack_of_fit`")
    undetermined: float = _criterion(100.0, "standard uncertainty over value above which a parameter is undetermined")
    correlated_noise: float = _criterion(8.0, "deviance that correlated angle noise needs", "chi2, 2 dof")
    excess_noise: float = _criterion(4.0,
        "process noise of a fit above that of the recording that voids its form [sigma]")
    spectral_line: float = _criterion(0.001, "p-value of a sinusoid that is not noise", "Baluev 2008")
    periodic_torque: float = _criterion(0.001, "p-value of a torque of the angle that is not noise")
    doubt_named: float = _criterion(0.01, "smooth-test p-value that contradicts a named effect", "Hart 1997")
    doubt_adequate: float = _criterion(0.001, "p-value of a test that contradicts an adequate fit", "Baluev 2008")
    inertia_sigma: float = _criterion(2.0, "error of an inertia that its uncertainty allows [sigma]")
    inertia_largest: float = _criterion(0.05, "relative error of an inertia whose uncertainty is not stated")
    failure_sigma: float = _criterion(4.0, "peak of a reported stretch of unmodelled torque [sigma]")
    harmonic_sigma: float = _criterion(4.3, "amplitude of a reported harmonic [sigma]", "p = 1e-4, 2 dof")
    experiment_sigma: float = _criterion(5.0, "separation that makes an experiment worth doing [sigma]")
    shape_share: float = _criterion(0.1, "share of the best score from which shapes are refined")
    refit_share: float = _criterion(0.1, "share of the best score from which candidates are refitted")
    refit_p: float = _criterion(0.5, "family-wise p-value above which candidates are not refitted")
    refit_least: int = _criterion(4, "candidates that are always refitted")
    refit_most: int = _criterion(14, "candidates that are refitted at most")
    rival_share: float = _criterion(0.5, "share of the best score from which a poor refit is repeated")
    refit_shortfall: float = _criterion(10.0, "deviance by which a refit may fall short of its score", _KASS)
    own_phase: float = _criterion(10.0, "deviance per case that justifies a separate phase", _KASS)
    changepoint_score: float = _criterion(25.0, "score that moves a changepoint far away", "5 sigma")
    equation_error: float = _criterion(3.0, "error of the equations, over the least, up to which a spring is fitted")
    refit_reversals: int = _criterion(500, "reversals that all refits of a step integrate", "15 s of one core")
    refit_oscillation_p: float = _criterion(0.1,
        "family-wise p-value above which candidates of an oscillation are not refitted")
    gross_misfit: float = _criterion(0.7, "rms phase drift by a torque like the residuals of a gross lack of fit")
    quieter: float = _criterion(0.8, "ratio below which process noise counts as reduced")
    angle_noise_ratio: float = _criterion(
        30.0, "correlated over white angle noise above which it is not noise")
    random_torque: float = _criterion(0.01,
        "random torque above which it is not noise, as a share of the mean torque")
    random_torque_evidence: float = _criterion(10.0, "deviance that a random torque above the noise needs", _KASS)
    random_torque_shortest: float = _criterion(0.05, "shortest correlation time of a random torque [s]")
    random_torque_longest: float = _criterion(10.0, "longest correlation time of a random torque [s]")
    start_u: float = _criterion(3e-3,
        "typical error of a start whose uncertainty is not stated [s]")
    slip_tolerance: float = _criterion(0.1, "deviation of a step from a whole turn that slipped [turns]")
    slip_sigma: float = _criterion(8.0, "scatter of the steps of an angle up to which a slip is evident [sigma]")
    # fmt: on

    def refits_through(self, reversals: int) -> int:
        """Return the number of candidates that are always refitted, given the number of reversals of an oscillation.

        A search through one reversal takes some 0.03 s of a core.
        """
        return min(self.refit_least, max(1, self.refit_reversals // max(reversals, 1)))

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if (
                isinstance(value, bool)
                or not isinstance(value, int | float)
                or not math.isfinite(value)
                or value < 0
            ):
                raise EstimationError(
                    f"criterion {f.name} is {value!r}", "give a finite number, zero or more"
                )
            if f.name in _AT_MOST_ONE and value > 1:
                raise EstimationError(
                    f"criterion {f.name} is {value!r}, more than 1", "give a share or probability"
                )

    def __str__(self) -> str:
        lines = [f"{'criterion':<20}{'value':>8}  meaning (source)"]
        for f in fields(self):
            value = getattr(self, f.name)
            changed = "*" if value != f.default else " "
            source = f.metadata["source"]
            lines.append(
                f"{f.name:<20}{value:>8g}{changed} {f.metadata['meaning']}{f' ({source})' if source else ''}"
            )
        return "\n".join(lines)


_AT_MOST_ONE = frozenset({
    "significance", "random_torque", "collinearity", "explained", "lack_of_fit", "doubt_named", "doubt_adequate",
    "spectral_line",
    "periodic_torque", "shape_share", "refit_share", "refit_p", "refit_oscillation_p", "rival_share", "quieter",
})  # fmt: skip

DEFAULT = Criteria()

NOISE = (
    "correlated_noise", "spectral_line", "periodic_torque", "angle_noise_ratio", "slip_tolerance", "slip_sigma",
    "gross_misfit",
)  # fmt: skip
"""Criteria that determine what is noise in a recording: where they differ, a fit has other weights."""
