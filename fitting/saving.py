"""Fits as plain JSON files: numbers, covariance, figures of merit, what was fitted. Nothing in them is ever run."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting.effects.stored import effects_of, own_effects
from fitting.errors import FittingError, LedgerError
from fitting.estimation.account import Account
from fitting.estimation.fit import fit
from fitting.estimation.metrics import BodyMetrics, CaseMetrics
from fitting.estimation.outcome import Estimate, Fit
from fitting.model import Model
from fitting.plain import number, plain
from fitting.record import Record

Array = NDArray[np.float64]

FORMAT = "gyrotrack fit"
VERSION = 1
_NUMBERS = ("chi2", "rows", "n_eff", "deviance", "bic")


@dataclass(frozen=True)
class SavedNoise:
    """Rms of the random torque of one case [N m]: what no slow torque explains, and what the model leaves."""

    pure: float
    level: float
    scale: float


@dataclass(frozen=True, repr=False)
class SavedFit(Account):
    """A fit read from a file: everything but the data.

    Attributes
    ----------
    names : tuple of str
        The variables, in the order of `covariance`.
    covariance : ndarray
        Of the variables, in SI units.
    sources, digests : tuple of str
        Files and SHA-256 of the data that were fitted.
    """

    model: Model
    labels: tuple[str, ...]
    estimates: Mapping[str, Estimate]
    cases: tuple[CaseMetrics, ...]
    chi2: float
    rows: int
    n_eff: float
    deviance: float
    bic: float
    verdict: str
    noise: tuple[SavedNoise, ...]
    names: tuple[str, ...]
    covariance: Array
    sources: tuple[str, ...]
    digests: tuple[str, ...]

    def refit(self, cases: Sequence[Record]) -> Fit:
        """Fit the same model again, from these values."""
        return fit(self.model, cases, start={k: e.value for k, e in self.estimates.items()})


def save_fit(found: Account, path: Path) -> None:
    """Write a fit as JSON, whole or not at all.

    Raises
    ------
    LedgerError
        If the file cannot be written.
    """
    text = json.dumps(_document(found), indent=1, allow_nan=False)
    part = path.with_name(path.name + ".part")
    try:
        with part.open("w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        part.replace(path)
    except OSError as fault:
        part.unlink(missing_ok=True)
        raise LedgerError(f"{path} cannot be written: {fault.strerror}", "choose another name") from None


def load_fit(path: str | Path) -> SavedFit:
    """Read a fit that `Fit.save` wrote.

    Raises
    ------
    LedgerError
        If the file is missing, damaged, or no fit.
    """
    path = Path(path)
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as fault:
        raise LedgerError(f"{path}: {fault.strerror or fault}") from None
    except (ValueError, RecursionError):
        raise LedgerError(f"{path} is not a saved fit", "save one with Fit.save") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise LedgerError(f"{path} is not a saved fit", "save one with Fit.save")
    if document.get("version") != VERSION:
        raise LedgerError(f"{path} was written by a newer version", "update gyrotrack")
    try:
        return _fit(document)
    except (KeyError, TypeError, ValueError, AttributeError, FittingError) as fault:
        raise LedgerError(f"{path} is damaged: {type(fault).__name__} {fault}"[:200]) from None


def _document(found: Account) -> dict[str, Any]:
    names, covariance, sources, digests = _behind(found)
    document: dict[str, Any] = plain(
        {
            "format": FORMAT,
            "version": VERSION,
            "model": list(found.model.names),
            "own_effects": own_effects(found.model.effects),
            "labels": [c.label for c in found.cases],
            "estimates": {k: asdict(e) for k, e in found.estimates.items()},
            "cases": [asdict(c) for c in found.cases],
            "noise": [
                {k: getattr(n, k) for k in ("pure", "level", "scale")} for n in getattr(found, "noise", ())
            ],
            "verdict": found.verdict,
            "names": list(names),
            "covariance": covariance.tolist(),
            "sources": list(sources),
            "digests": list(digests),
        }
        | {k: getattr(found, k) for k in _NUMBERS}
    )
    return document


def _behind(found: Account) -> tuple[Sequence[str], Array, Sequence[str], Sequence[str]]:
    if isinstance(found, Fit):
        records = [d.record for d in found.problem.data]
        sources, digests = [r.source for r in records], [r.digest for r in records]
        return found.problem.layout.names, found.covariance, sources, digests
    if isinstance(found, SavedFit):
        return found.names, found.covariance, found.sources, found.digests
    raise LedgerError("only a fit can be saved")


def _fit(document: dict[str, Any]) -> SavedFit:
    covariance = np.array([[number(x) for x in row] for row in document["covariance"]], dtype=float)
    names = tuple(str(n) for n in document["names"])
    if covariance.shape != (len(names), len(names)):
        raise ValueError("the covariance has another size")
    return SavedFit(
        model=Model(effects_of(document["model"], document["own_effects"])),
        labels=tuple(str(x) for x in document["labels"]),
        estimates={
            str(k): Estimate(number(e["value"]), number(e["stderr"]), str(e["unit"]), bool(e["at_bound"]))
            for k, e in document["estimates"].items()
        },
        cases=tuple(_case(c) for c in document["cases"]),
        chi2=number(document["chi2"]),
        rows=int(document["rows"]),
        n_eff=number(document["n_eff"]),
        deviance=number(document["deviance"]),
        bic=number(document["bic"]),
        verdict=str(document["verdict"]),
        noise=tuple(
            SavedNoise(*(number(n[k]) for k in ("pure", "level", "scale"))) for n in document["noise"]
        ),
        names=names,
        covariance=covariance,
        sources=tuple(str(s) for s in document["sources"]),
        digests=tuple(str(s) for s in document["digests"]),
    )


def _case(stored: dict[str, Any]) -> CaseMetrics:
    bodies = [
        BodyMetrics(*(number(stored[b][k]) for k in ("r2", "rmse", "reduced_chi2", "held_out")))
        for b in ("casing", "rotor")
    ]
    return CaseMetrics(
        str(stored["label"]), bodies[0], bodies[1], number(stored["energy_drift"]), number(stored["misfit"])
    )
