"""Every threshold that determines a result, in one record.

`fit`, `diagnose`, `improve`, `laws`, `certify` and `plan` accept a `Criteria`. A fit stores the criteria with which the
noise of its recordings was measured. A search with different noise criteria (`NOISE`) first repeats the fit with the
criteria of the search.

>>> from dataclasses import replace
>>> strict = replace(Criteria(), significance=0.001)

``print(Criteria())`` lists all thresholds with their meaning and source. The text below each threshold also states its
unit and origin (`fitting._settings`).
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, fields

from fitting._errors import EstimationError
from fitting._settings import settings_of


@dataclass(frozen=True)
class Criteria:
    """Thresholds of the search for a missing effect; immutable; `dataclasses.replace` makes a changed copy.

    Probabilities and shares are at most 1. Differences of deviance and of BIC are twice the logarithm of a likelihood
    ratio and have no unit. The unit "sigma" is one standard error.

    Sources: R. Kass, A. Raftery, J. Am. Stat. Assoc. 90, 773 (1995): a BIC difference of 2 is positive evidence, a
    difference of 10 is very strong evidence. P. Westfall, S. Young, Resampling-Based Multiple Testing (1993): simulated
    data without any effect give the p-value of the best of a list of candidates. J. Hart, Nonparametric Smoothing and
    Lack-of-Fit Tests (1997). N. Draper, H. Smith, Applied Regression Analysis (1998). R. Baluev, Mon. Not. R. Astron.
    Soc. 385, 1279 (2008).

    Raises
    ------
    EstimationError
        If a value is not a finite number in its range.
    """

    significance: float = 0.03
    """Family-wise p-value below which a candidate is significant [1]. Source: Westfall & Young 1993; in simulated
    recordings without a missing effect, there are 0 false alarms in 54 and, with correlated angle noise, 4 in 100; a
    smaller value overlooks weak effects."""
    evidence: float = 2.0
    """Smallest fall of BIC for which an effect is added [1]. Source: Kass & Raftery 1995; positive evidence."""
    evidence_periodic: float = 10.0
    """Smallest fall of BIC for a periodic law on tracked film [1]. Source: Kass & Raftery 1995; very strong evidence,
    because tracking errors are periodic as well."""
    equivalence_width: float = 10.0
    """Largest BIC difference of indistinguishable candidates [1]. Source: Kass & Raftery 1995; a larger difference is
    very strong evidence against the worse candidate."""
    collinearity: float = 0.9999
    """Smallest cosine of the angle between responses that no data can separate [1]. Chosen: a smaller value joins
    effects that more data would separate; with a larger value, rounding errors separate equal effects."""
    measurement_penalty: float = 3.2
    """Penalty that is added to the BIC of a measurement effect [1]. Derived: 2 ln 5, prior odds 1:5; a smaller value
    takes torques for camera errors, a larger one takes camera errors for torques."""
    shape_evidence: float = 10.0
    """Smallest fall of BIC for which a shape constant is fitted [1]. Source: Kass & Raftery 1995; very strong
    evidence."""
    essential_sigma: float = 3.3
    """Strength of an added effect below which its removal is tried [sigma]. Derived: p = 0.001; a smaller value keeps
    superfluous effects, a larger one costs time."""
    crowded: int = 3
    """Smallest number of added effects for which the removal of each is tried [1]. Chosen: a smaller value costs time,
    a larger one keeps superfluous effects."""
    max_steps: int = 5
    """Largest number of effects that `improve` adds [1]. Chosen: with a smaller value, unmodelled torques remain; a
    larger one costs time."""
    named_sigma: float = 3.0
    """Smallest strength of a named effect, divided by its standard uncertainty [sigma]. Chosen: with a smaller value,
    undetermined effects are named; with a larger one, weak effects are not named."""
    follow_up: int = 1
    """Largest number of further effects that `diagnose` adds [1]. Chosen: with a smaller value, the remainder is not
    explained; a larger one costs time."""
    explained: float = 0.95
    """Smallest share of the unmodelled torque that an approximate answer explains [1]. Chosen: a smaller value hides a
    second effect; with a larger one, small remainders count as a second effect."""
    lack_of_fit: float = 1e-5
    """Slow-torque test: p-value below which a fit fails [1]. Source: Draper 1998 for the test; errors of the noise
    model do not cause such small p-values; with a larger value, fits fail because of these errors; a smaller value
    overlooks missing laws."""
    reduced_chi2: float = 1.4
    """A fit fails if chi2 per row exceeds this value with a p-value below `lack_of_fit` [1]. Chosen: noise alone gives
    1.00 +- 0.03 in 2000 rows; a smaller value rejects fits with irrelevant deviations, a larger one accepts a lack of
    fit."""
    undetermined: float = 100.0
    """Relative standard uncertainty above which a parameter is undetermined [1]. Chosen: a smaller value refuses
    parameters near zero, a larger one reports values without meaning."""
    correlated_noise: float = 8.0
    """Smallest fall of deviance for which correlated angle noise is added [1]. Derived: chi2, 2 dof; for white noise,
    chi2 exceeds this value in 2 % of the recordings; a smaller value adds noise that is absent, a larger one
    understates uncertainties."""
    excess_noise: float = 4.0
    """Excess process noise above which the form of a law is not established [sigma]. Chosen: the excess is relative to
    the process noise of the recording without a model; a smaller value rejects right forms; with a larger one, noise
    absorbs a wrong form."""
    spectral_line: float = 0.001
    """P-value below which a sinusoid is a line, not noise [1]. Source: Baluev 2008 for the test; a larger value finds
    lines by chance; with a smaller one, lines count as process noise."""
    periodic_torque: float = 0.001
    """P-value below which an angle-dependent torque is not noise [1]. Chosen: a larger value finds torques by chance, a
    smaller one counts torques as noise."""
    doubt_named: float = 0.01
    """Smooth test: p-value below which an effect is doubted [1]. Source: Hart 1997 for the test; a larger value rejects
    right forms, a smaller one accepts wrong forms."""
    doubt_adequate: float = 0.001
    """Test p-value below which an adequate fit is doubted [1]. Source: Baluev 2008 for one test; a larger value rejects
    right fits, a smaller one overlooks missing laws."""
    inertia_sigma: float = 2.0
    """Largest error of an inertia that is compatible with the stated uncertainty [sigma]. Chosen: with a smaller value,
    effects are named that a wrong inertia imitates; with a larger one, real effects are attributed to the inertia."""
    inertia_largest: float = 0.05
    """Largest relative error of an inertia whose uncertainty is not stated [1]. Chosen: with a smaller value, effects
    are named that a wrong inertia imitates; with a larger one, real effects are attributed to the inertia."""
    failure_sigma: float = 4.0
    """Smallest peak of a reported interval of unmodelled torque [sigma]. Chosen: a smaller value reports noise, a
    larger one omits weak torques."""
    harmonic_sigma: float = 4.3
    """Smallest amplitude of a reported harmonic [sigma]. Derived: p = 1e-4, 2 dof; this p is exp(-4.3^2 / 2); a smaller
    value reports noise, a larger one omits weak torques."""
    experiment_sigma: float = 5.0
    """Separation of rivals below which repeating a proposed run is advised [sigma]. Chosen: a smaller value proposes
    runs that may not decide, a larger one recommends needless repetitions."""
    shape_share: float = 0.1
    """Share of the best score above which shapes are refined [1]. Chosen: a smaller value costs time, a larger one may
    omit the right effect."""
    refit_share: float = 0.1
    """Share of the best score above which candidates are refitted [1]. Chosen: a smaller value costs time, a larger one
    may omit the right effect."""
    refit_p: float = 0.5
    """Family-wise p-value above which candidates are not refitted [1]. Chosen: a larger value costs time, a smaller one
    may omit the right effect."""
    refit_least: int = 4
    """Number of best candidates that are always refitted [1]. Chosen: a smaller value may omit the right effect, a
    larger one costs time."""
    refit_most: int = 14
    """Largest number of refitted candidates [1]. Chosen: a smaller value may omit the right effect, a larger one costs
    time."""
    rival_share: float = 0.5
    """Share of the best score above which a poor refit is repeated [1]. Chosen: a smaller value costs time, a larger
    one ranks rivals by refits in a wrong minimum."""
    refit_shortfall: float = 10.0
    """Score minus fall of deviance above which a refit is poor [1]. Source: Kass & Raftery 1995; a larger difference
    between score and refit would change the order of the candidates."""
    own_phase: float = 10.0
    """Smallest fall of deviance per case for separate phases [1]. Source: Kass & Raftery 1995; very strong evidence for
    each case after the first."""
    changepoint_score: float = 25.0
    """Smallest score at which a changepoint is moved to a distant time [1]. Derived: 5 sigma; a smaller value follows
    noise; with a larger one, a wrong time remains."""
    equation_error: float = 3.0
    """Largest equation-of-motion error of a fitted spring, divided by the smallest [1]. Chosen: a smaller value may
    omit the right spring, a larger one costs time."""
    refit_reversals: int = 500
    """Largest number of reversals of the motion in all refits of a search step [1]. Chosen: refits take 15 s of one
    core; a smaller value may omit the right effect, a larger one costs time."""
    refit_oscillation_p: float = 0.1
    """Family-wise p-value above which candidates for oscillations are not refitted [1]. Chosen: a larger value costs
    time, a smaller one may omit the right effect."""
    gross_misfit: float = 0.7
    """Rms phase drift due to residual torque above which a lack of fit is gross [rad]. Chosen: a smaller value takes
    small deviations for a wrong motion, a larger one linearises about a wrong motion."""
    quieter: float = 0.8
    """Ratio below which process noise counts as reduced [1]. Chosen: a larger value takes the uncertainty of the noise
    for an improvement, a smaller one overlooks improvements."""
    angle_noise_ratio: float = 30.0
    """Largest ratio of correlated to white angle noise that counts as noise [1]. Chosen: a smaller value calls usual
    tracking errors a fault, a larger one lets noise absorb motion."""
    random_torque: float = 0.01
    """Largest random torque that counts as noise, as a share of the mean torque [1]. Chosen: at this value, an effect
    is named in 3 of 200 simulated recordings with a random torque and no missing effect; with a smaller value, effects
    are named that a random torque imitates; with a larger one, real effects are attributed to a random torque."""
    random_torque_evidence: float = 10.0
    """Smallest fall of deviance for an additional random torque [1]. Source: Kass & Raftery 1995; very strong evidence
    of a torque beyond the process noise of the recording."""
    random_torque_shortest: float = 0.05
    """Shortest correlation time of a random torque [s]. Chosen: a torque of a shorter time is part of the measured
    process noise; with a larger value, some times are not tried."""
    random_torque_longest: float = 10.0
    """Longest correlation time of a random torque [s]. Chosen: a torque of a longer time absorbs any slow law; with a
    smaller value, some times are not tried."""
    start_u: float = 3e-3
    """Typical error of the start of a clip if its uncertainty is not stated [s]. Chosen: a few frames; a smaller value
    overlooks start errors; with a larger one, real effects are attributed to start errors."""
    slip_tolerance: float = 0.1
    """Largest deviation from a whole turn with which a step counts as a slip [turns]. Chosen: a smaller value overlooks
    slips in noise, a larger one takes other steps for slips."""
    slip_sigma: float = 8.0
    """Smallest ratio of `slip_tolerance` to the scatter of the angle steps [sigma]. Chosen: a smaller value takes noise
    for slips, a larger one overlooks slips in noise."""

    def refits_through(self, reversals: int) -> int:
        """Return the largest number of refitted candidates, given the number of reversals of an oscillation.

        A search through one reversal takes about 0.03 s of a core.
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
        for setting in settings_of(sys.modules[__name__]):
            name = setting.name.partition(".")[2]
            value = getattr(self, name)
            changed = "*" if value != setting.value else " "
            unit = "" if setting.unit == "1" else f" [{setting.unit}]"
            kind, _, origin = setting.origin.partition(": ")
            source = "" if kind == "chosen" else f" ({origin.partition(';')[0]})"
            lines.append(f"{name:<20}{value:>8g}{changed} {setting.meaning}{unit}{source}")
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
"""Criteria that determine the noise of a recording, and thus the weights of a fit."""
