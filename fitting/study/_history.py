"""The history of fits of a study: a JSON ledger beside the data.

A rung holds the model (with the laws of effects that are not in the library), parameters, figures of
merit, noise, the rung it was made from, digests of the data, and the program's version. A ledger may hold
ladders of several sets of cases; each rung says which cases it belongs to.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from fitting._atomic import locked, refuse_special, write_text
from fitting._errors import FittingError, LedgerError
from fitting._numbers import to_json
from fitting.discovery._verdict import Diagnosis
from fitting.dynamics._model import Model
from fitting.effects._effect import Effect
from fitting.effects._user import effects_of, own_effects
from fitting.inference._case_data import CaseData
from fitting.inference._result import Fit
from fitting.inference._robust import robust_fit
from fitting.study._serialisation import (
    fit_document,
    kept_diagnosis,
    kept_fit,
    restored_diagnosis,
    restored_fit,
    rung_document,
)

FORMAT = "gyrotrack ledger"
VERSION = 1
# what comes of a part of the file that was changed by hand: what was kept there is then found anew
_DAMAGED = (LookupError, TypeError, ValueError, AttributeError, FittingError)


@dataclass(frozen=True)
class Entry:
    """One rung as it is stored: see `document`, the JSON object of the rung."""

    document: dict[str, Any]

    @property
    def fit_id(self) -> str:
        """The name of the rung."""
        return str(self.document["fit_id"])

    @property
    def digests(self) -> list[str]:
        """Digests of the cases that were fitted."""
        return [str(d) for d in self.document["digests"]]

    @property
    def choices(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """What all cases were told to share, and of what each was told to have its own."""
        share, per_case = (tuple(map(str, self.document.get(k, ()))) for k in ("share", "per_case"))
        return share, per_case

    @property
    def model(self) -> Model:
        """The model that was fitted."""
        return Model(effects_of(self.document["model"], self.document.get("own_effects", [])))

    def shown(self, data: Sequence[CaseData]) -> Fit:
        """Return the fit of this rung to be shown: as it was, if this very code made it, else made anew."""
        kept, found = self.document.get("restored_from"), None
        if kept:
            with suppress(*_DAMAGED):
                found = restored_fit(kept, self.model, data)
        return found or self.refit(data)

    def diagnosis(self, fit: Fit, extra: Sequence[Effect] = ()) -> Diagnosis | None:
        """Return the diagnosis of this rung to be shown, if there was one by this very code with these effects."""
        kept = self.document.get("diagnosis")
        if kept:
            with suppress(*_DAMAGED):
                return restored_diagnosis(kept, fit, extra)
        return None

    def refit(self, data: Sequence[CaseData]) -> Fit:
        """Return the fit of this rung, made anew from its own parameters."""
        start = {k: float(v["value"]) for k, v in self.document["parameters"].items()}
        ranges = {k: (float(a), float(b)) for k, (a, b) in self.document.get("ranges", {}).items()}
        return robust_fit(
            self.model,
            data,
            self.document.get("loss", "linear"),
            share=self.document.get("share", ()),
            per_case=self.document.get("per_case", ()),
            start=start,
            ranges=ranges,
        )


class Ledger:
    """The rungs in one file.

    Parameters
    ----------
    path : Path
        The file; it need not exist yet.

    Raises
    ------
    LedgerError
        If the file is there and is no ledger.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.entries: list[Entry] = []
        if path.exists():
            self.entries = _read(path)

    @classmethod
    def beside(cls, case: Path) -> Ledger:
        """Return the ledger beside a case file: ``case1.h5`` has ``case1.fits.json``."""
        return cls(case.with_name(f"{case.stem}.fits.json"))

    def of(self, data: Sequence[CaseData]) -> list[Entry]:
        """Return the rungs of exactly these cases."""
        key = sorted(d.record.digest for d in data)
        return [e for e in self.entries if sorted(e.digests) == key]

    def find(self, fit_id: str) -> Entry:
        """Return a rung by its name.

        Raises
        ------
        LedgerError
            If there is none.
        """
        for entry in self.entries:
            if entry.fit_id == fit_id:
                return entry
        known = ", ".join(e.fit_id for e in self.entries) or "none yet"
        raise LedgerError(f"{self.path} has no fit {fit_id[:40]!r}", f"it has: {known}")

    def add(
        self,
        found: Fit,
        *,
        parent: str = "",
        added: str = "",
        previous: Fit | None = None,
        share: Sequence[str] = (),
        per_case: Sequence[str] = (),
        ranges: dict[str, tuple[float, float]] | None = None,
        loss: str = "linear",
    ) -> Entry:
        """Append a fit and write the file, whole or not at all; what others added meanwhile is kept."""
        if not share and not per_case:
            share, per_case = found.problem.layout.choices
        with locked(self.path):
            if self.path.exists():
                self.entries = _read(self.path)
            fit_id = f"f{1 + max((int(e.fit_id[1:]) for e in self.entries), default=0)}"
            document = fit_document(found, fit_id) | {
                "parent": parent,
                "added": added,
                "rung": rung_document(found, fit_id, added, previous),
                "digests": [d.record.digest for d in found.problem.data],
                "sources": [d.record.source for d in found.problem.data],
                "own_effects": own_effects(found.model.effects),
                "share": list(share),
                "per_case": list(per_case),
                "ranges": {k: list(v) for k, v in (ranges or {}).items()},
                "loss": loss,
                "data": found.problem.data[0].record.quantity,
                "rotor": "generated" if found.problem.data[0].record.generated else "windows",
                "created": datetime.now(UTC).isoformat(timespec="seconds"),
                "software_version": _version(),
                # a robust fit is one of pseudo-values, which are not kept
                "restored_from": kept_fit(found) if loss == "linear" else None,
            }
            entry = Entry(to_json(document))
            self.entries.append(entry)
            self._write()
            return entry

    def keep_diagnosis(self, fit_id: str, found: Diagnosis, extra: Sequence[Effect] = ()) -> None:
        """Keep with a rung what was found missing in it, so that it can be shown again without a new search."""
        with locked(self.path):
            self.entries = _read(self.path)
            self.find(fit_id).document["diagnosis"] = to_json(kept_diagnosis(found, extra))
            self._write()

    def _write(self) -> None:
        document = {"format": FORMAT, "version": VERSION, "fits": [e.document for e in self.entries]}
        write_text(self.path, json.dumps(document, indent=1, allow_nan=False))


def _read(path: Path) -> list[Entry]:
    refuse_special(path)
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as fault:
        raise LedgerError(
            f"{path} is not a ledger of fits: {fault}", "move it away or choose another with --ledger"
        ) from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise LedgerError(f"{path} is not a ledger of fits", "move it away or choose another with --ledger")
    if int(document.get("version", 0)) > VERSION:
        raise LedgerError(f"{path} was written by a newer version", "update gyrotrack")
    entries = [Entry(d) for d in document.get("fits", []) if isinstance(d, dict)]
    if any(not {"fit_id", "model", "parameters", "digests"} <= set(e.document) for e in entries):
        raise LedgerError(
            f"{path} is damaged: a fit lacks its model or parameters",
            "move it away or choose another with --ledger",
        )
    return entries


def _version() -> str:
    try:
        return version("gyrotrack")
    except PackageNotFoundError:
        return "unknown"
