"""What a finished fit can do by itself: print, become a table, be saved. Mixed into `Fit` and `SavedFit`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

from fitting.errors import EstimationError
from fitting.rounding import rounded

if TYPE_CHECKING:
    from fitting.estimation.metrics import CaseMetrics
    from fitting.estimation.outcome import Estimate
    from fitting.model import Model

WORDS = {
    "adequate": "adequate; what the model leaves is noise",
    "misfit": "the model misses something; `gyrotrack diagnose` says where",
    "not converged": "not converged; do not trust these numbers",
}


# what a fit to such a curve has to say of itself
GENERATED = (
    "the rotor's curve was generated, not measured: the errors leave out how wrong it may be, which is often more "
    "than ten of them; fit the windows instead"
)


class Account:
    """The readable side of a fit."""

    model: Model
    estimates: Mapping[str, Estimate]
    n_eff: float
    bic: float

    if TYPE_CHECKING:

        @property
        def cases(self) -> tuple[CaseMetrics, ...]:
            """Figures of merit of each case."""
            ...

        @property
        def verdict(self) -> str:
            """One of the keys of `WORDS`."""
            ...

    def __repr__(self) -> str:
        return "\n".join([f"fit: {WORDS[self.verdict]}", "", *account_lines(self)])

    def to_dataframe(self) -> Any:
        """Return the parameters as a pandas data frame, one row each, indexed by name.

        Returns
        -------
        pandas.DataFrame
            Columns value, stderr (nan on a bound and for what is held), unit, at_bound.

        Raises
        ------
        EstimationError
            If pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError:
            raise EstimationError(
                "a data frame needs pandas, which is not installed", 'pip install "gyrotrack[notebook]"'
            ) from None
        rows = {k: (e.value, e.stderr, e.unit, e.at_bound) for k, e in self.estimates.items()}
        frame = pd.DataFrame.from_dict(rows, orient="index", columns=["value", "stderr", "unit", "at_bound"])
        return frame.rename_axis("parameter")

    def save(self, path: str | Path) -> None:
        """Write the fit as JSON, whole or not at all; `fitting.load_fit` reads it back."""
        from fitting.saving import save_fit

        save_fit(self, Path(path))


def account_lines(fit: Account) -> list[str]:
    """Return how well a fit describes its data, then its parameters, as lines of at most 80 columns."""
    lines = [f"{'':<12}{'R2':>10}{'rmse [rad/s]':>14}{'chi2/n':>12}{'held out':>11}"]
    for case in fit.cases:
        alone = math.isnan(case.rotor.rmse)  # the record of one body has none of a rotor
        for name, body in (("body" if alone else "casing", case.casing), ("rotor", case.rotor)):
            if math.isnan(body.rmse):
                continue
            title = f"{case.label[:5]} {name}" if len(fit.cases) > 1 else name
            lines.append(
                f"{title:<12}{body.r2:>10.6f}{body.rmse:>14.4g}{body.reduced_chi2:>12.4g}{body.held_out:>11.4g}"
            )
    lines.append(
        f"energy drift {max(c.energy_drift for c in fit.cases):.2g}, "
        f"effective samples {fit.n_eff:.0f}, BIC {fit.bic:.1f}"
    )
    left = ", ".join(f"{level:.2g}" for level in _levels(fit))
    lines += [f"random torque that this model leaves: {left} N m rms", ""]
    held = fit.model.constants
    for name, e in fit.estimates.items():
        note = " (on its bound)" if e.at_bound else " (held)" if name in held else ""
        value = rounded(e.value, e.stderr, e.unit)
        lines += (
            [f"  {name:<32}{value}{note}"] if len(name) < 32 else [f"  {name}", f"  {'':<32}{value}{note}"]
        )
    if getattr(fit, "generated", False):
        lines += ["", *wrap(GENERATED, 79)]
    weak = not_determined(fit.estimates)
    if weak:
        lines += ["", *wrap(f"not determined by this data: {', '.join(weak)}", 79)]
    return lines


def _levels(fit: Account) -> Sequence[float]:
    return [n.level for n in getattr(fit, "noise", ())]


def not_determined(estimates: Mapping[str, Estimate]) -> list[str]:
    """Return the parameters whose error is larger than their value: the data does not hold them."""
    return [
        k
        for k, e in estimates.items()
        if not k.startswith("initial.") and math.isfinite(e.stderr) and e.stderr > abs(e.value)
    ]
