"""Errors of the moments of inertia: a lack of fit that they explain, and effects that imitate them.

Only ratios of torque to inertia are observable, and the torque between the bodies acts on both: the data determine the
ratio of the moments of inertia. With a wrong ratio the base has a systematic error, so that a wrong effect, or the
right one with a wrong form, may describe the data best. So the list of candidates is scored once more with the ratio
free, and the best ones are refitted with it.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace

from fitting._criteria import Criteria
from fitting._errors import FittingError
from fitting._numbers import rounded
from fitting.discovery._refine import refit
from fitting.discovery._select import Candidate, Selection, rank
from fitting.effects._effect import Effect
from fitting.effects._library import LIBRARY
from fitting.inference._fit import fit_like
from fitting.inference._result import Estimate, Fit

NAME = "setup.inertia"
# largest number of effects that are refitted with a free ratio
_MOST_REFITS = 5
_SHARE = f"{NAME}.eps"


def relative_uncertainty(found: Fit) -> float:
    """Return the relative standard uncertainty of I_casing/I_rotor, the smallest of all cases; 0 if none is stated."""
    relative = []
    for d in found.problem.data:
        r = d.record
        both = (r.I_casing_u / r.I_casing, r.I_rotor_u / r.I_rotor)
        relative.append(math.hypot(*(u for u in both if math.isfinite(u))))
    return min(relative)


@dataclass(frozen=True)
class InertiaRival:
    """An effect that describes the data as well or better with the ratio of the moments of inertia free."""

    share: Estimate  # relative error of I_casing/I_rotor
    stated: float  # its relative standard uncertainty; 0 if none is stated
    effect: str  # the effect
    fit: Fit  # the fit with effect and free ratio
    better: bool  # whether it describes the data better than the selected effect, and not only as well

    def is_allowed(self, criteria: Criteria) -> bool:
        """Return whether the stated uncertainty allows the error."""
        allowed = criteria.inertia_sigma * math.hypot(self.stated, self.share.stderr)
        return self.stated > 0 and abs(self.share.value) <= allowed

    @property
    def sentence(self) -> str:
        """The error of the ratio and its stated uncertainty, in words."""
        error = rounded(100 * self.share.value, 100 * self.share.stderr, "%")
        stated = (
            f"standard uncertainty {100 * self.stated:.2g} %" if self.stated > 0 else "no uncertainty stated"
        )
        return (
            f"With I_casing/I_rotor larger by {error} than given ({stated}), {self.effect} describes the data "
            f"{'better' if self.better else 'as well'}: check the moments of inertia."
        )


def with_free_inertia(
    base: Fit, selection: Selection, extra: tuple[Effect, ...], criteria: Criteria
) -> InertiaRival | None:
    """Return the effect that describes the data as well as the selected ones, or better, with free inertia.

    None if no effect does, or only with an error that is not credible; laws of an angle are not tried.
    """
    chosen = selection.chosen
    single = base.problem.data[0].record.single
    if chosen is None or not chosen.physical or chosen.effect.depends_on_angle or single:
        return None
    if NAME in selection.final.model.names:
        return None
    with suppress(FittingError):
        model = base.model.with_effect(LIBRARY[NAME])
        freed = fit_like(base, model, start=base.values, noise=base.noise)
        ranked = rank(freed, extra, criteria=criteria, refitting=False)
        usable = [c for c in ranked if c.physical and c.significant and not c.screened.absorbed][
            :_MOST_REFITS
        ]
        near = [c for c in usable if c.score > usable[0].score - criteria.equivalence_width]
        refits = [(c.effect.name, refit(freed, c.screened, criteria)) for c in near]
        best = min(
            ((name, f) for name, f in refits if f is not None), key=lambda item: item[1].bic, default=None
        )
        if best is None:
            return None
        name, found = best
        share, stated = found.estimates[_SHARE], relative_uncertainty(base)
        largest = criteria.inertia_sigma * stated if stated > 0 else criteria.inertia_largest
        credible = abs(share.value) <= largest + criteria.inertia_sigma * share.stderr
        better = selection.final.bic - found.bic
        least = criteria.shape_evidence if name == chosen.effect.name else -criteria.equivalence_width
        if credible and better > least:
            return InertiaRival(share, stated, name, found, better > criteria.shape_evidence)
    return None


def reselected(selection: Selection, rival: InertiaRival) -> Selection:
    """Return the selection with the best effect with free inertia first, then the effect selected without it."""
    chosen = selection.chosen
    if chosen is None or rival.effect == chosen.effect.name:
        return selection._replace(final=rival.fit)
    if not rival.better:
        members = (*chosen.indistinguishable_from, rival.effect)
        first = replace(chosen, indistinguishable_from=tuple(dict.fromkeys(members)))
        kept = [first if c is chosen else c for c in selection.candidates]
        return selection._replace(candidates=kept, chosen=first)
    own = {k: e for k, e in rival.fit.estimates.items() if k.startswith(f"{rival.effect}.")}
    old = next((c for c in selection.candidates if c.effect.name == rival.effect), None)
    if old is None:  # the list of candidates was given, without it
        return selection
    first = replace(
        old,
        fit=rival.fit,
        estimates=own,
        significant=True,
        indistinguishable_from=(chosen.effect.name, *chosen.indistinguishable_from),
    )
    others = [c for c in selection.candidates if c is not old]
    return selection._replace(candidates=[first, *others], chosen=first, named=rival.fit, final=rival.fit)


def inertia_within_uncertainty(fit: Fit, named: list[Candidate], criteria: Criteria) -> str:
    """Return a sentence if errors of the moments of inertia within their uncertainties explain a lack of fit, else "".

    The data determine the ratio of the moments of inertia, so the relative uncertainties add in quadrature; one that is
    not given counts as none. `named` are the effects that explain the lack of fit, which the data cannot separate.
    """
    found = [e for c in named if c.effect.joint == "inertia" for e in c.estimates.values()]
    u = relative_uncertainty(fit)
    if not found or u <= 0:
        return ""
    share = found[0]
    if abs(share.value) > criteria.inertia_sigma * math.hypot(u, share.stderr):
        return ""
    return (
        f"The model is adequate within the uncertainty of the moments of inertia: I_casing/I_rotor larger by "
        f"{rounded(100 * share.value, 100 * share.stderr, '%')} than given (standard uncertainty {100 * u:.2g} %) "
        "explains the lack of fit."
    )
