"""What a report shows, collected from fits into one frozen record; nothing here draws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gyrotrack.report.case_view import CaseView, case_view
from gyrotrack.report.floor import smoothing_floor

if TYPE_CHECKING:
    from fitting.diagnosis import ResidualTorque
    from fitting.discovery import Candidate, Diagnosis, Rung
    from fitting.estimation import Fit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Step:
    """One rung: what was changed and what the errors did; see `fitting.summary.rung_document`."""

    change: str
    rmse: float
    reduced_chi2: float
    held_out: float
    delta_bic: float
    energy_drift: float
    torque_left: float
    torque_pure: float
    verdict: str


@dataclass(frozen=True)
class Content:
    """Everything that a report shows about the fits.

    `models` in a case has the base and, if anything was added, the final model. `rmse_floor` is what noise
    alone makes of the casing's rms error [rad/s].
    """

    steps: tuple[Step, ...]
    rmse_floor: float
    base: Fit
    final: Fit
    added: tuple[str, ...]
    verdict: str
    sentence: str
    candidates: tuple[Candidate, ...]
    next_experiment: str
    whiteness: tuple[tuple[str, float], ...]
    cases: tuple[CaseView, ...]

    @property
    def body(self) -> str:
        """What people call the body in the casing's place: "body" where only one was recorded."""
        return self.cases[0].body

    @property
    def improved(self) -> bool:
        """Whether there is a final model that differs from the base."""
        return len(self.steps) > 1


def gather(rungs: Sequence[Rung], diagnosis: Diagnosis | None) -> Content:
    """Collect what is to be shown.

    Parameters
    ----------
    rungs : sequence of Rung
        The ladder, base first.
    diagnosis : Diagnosis or None
        That of the base.
    """
    from fitting.diagnosis import whiteness
    from fitting.summary import ladder_verdict

    base, final = rungs[0].fit, rungs[-1].fit
    fits = (base, final) if len(rungs) > 1 else (base,)
    torques = tuple(_torques(f, diagnosis) for f in fits)
    candidates = diagnosis.candidates if diagnosis is not None else rungs[0].candidates
    verdict = ladder_verdict(rungs)
    if len(rungs) == 1 and diagnosis is not None:
        verdict = diagnosis.verdict
    return Content(
        steps=_steps(rungs),
        rmse_floor=smoothing_floor(final),
        base=base,
        final=final,
        added=tuple(n for n in final.model.names if n not in base.model.names),
        verdict=verdict,
        sentence=diagnosis.sentence if diagnosis is not None else "",
        candidates=tuple(c for c in candidates if c.score > 0),
        next_experiment=diagnosis.next_experiment if diagnosis is not None else "",
        whiteness=tuple((w.label, w.p_value) for w in whiteness(final)),
        cases=tuple(case_view(rungs, diagnosis, torques, i) for i in range(len(base.problem.data))),
    )


def _steps(rungs: Sequence[Rung]) -> tuple[Step, ...]:
    from fitting.summary import rung_document

    steps = []
    for i, rung in enumerate(rungs):
        d = rung_document(rung.fit, "", rung.change, rungs[i - 1].fit if i else None)
        steps.append(
            Step(
                change=rung.change or "base model",
                rmse=d["rmse_casing"],
                reduced_chi2=d["reduced_chi2"],
                held_out=d["held_out"],
                delta_bic=d["delta_bic"],
                energy_drift=d["energy_drift"],
                torque_left=rung.fit.torque_noise,
                torque_pure=max(n.pure for n in rung.fit.noise),
                verdict=rung.fit.verdict,
            )
        )
    return tuple(steps)


def _torques(fit: Fit, diagnosis: Diagnosis | None) -> tuple[ResidualTorque, ...]:
    from fitting.diagnosis import residual_torques

    if diagnosis is not None and diagnosis.fit is fit:
        return diagnosis.torques
    return tuple(residual_torques(fit))


def correlations(fit: Fit) -> tuple[list[str], Array]:
    """Return the names of the parameters that have a finite error, and their correlation matrix."""
    variance = np.diag(fit.covariance)
    keep = np.flatnonzero(np.isfinite(variance) & (variance > 0))
    root = np.sqrt(variance[keep])
    matrix = fit.covariance[np.ix_(keep, keep)] / np.outer(root, root)
    return [fit.problem.layout.names[i] for i in keep], np.clip(matrix, -1, 1)
