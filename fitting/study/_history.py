"""The history of fits of a study: a JSON ledger next to the data.

An entry contains the model (with the laws of effects that are not in the library), parameters, figures of merit, noise,
the name of its parent fit, digests of the data, and the version of the program. A ledger may contain the histories of
several sets of cases; each entry names its cases. `fitting._schema.EntryDocument` declares the keys.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from copy import deepcopy
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from fitting._arguments import PATH, require
from fitting._errors import FittingError, LedgerError
from fitting._numbers import to_json
from fitting._schema import (
    EntryDocument,
    EstimateDocument,
    LedgerDocument,
    StoredCertificate,
    StoredDiagnosis,
    StoredFit,
    as_json,
    as_text,
    effects_of,
    first_error,
    locked,
    own_effects,
    parse_json,
    read_json,
    refuse_special,
    write_text,
)
from fitting.discovery._certificate import Certificate
from fitting.discovery._verdict import Diagnosis
from fitting.dynamics._model import Model
from fitting.effects._effect import Effect
from fitting.inference._case_data import CaseData, with_prior
from fitting.inference._fit import robust_fit
from fitting.inference._prior import Prior
from fitting.inference._result import Fit
from fitting.study._serialisation import (
    fit_document,
    restored_certificate,
    restored_diagnosis,
    restored_fit,
    step_document,
    stored_certificate,
    stored_diagnosis,
    stored_fit,
)

_ELSEWHERE = "move it away or choose another with --ledger"
# errors that occur if a part of the file was damaged by editing; the program then computes this part again
_DAMAGED = (LookupError, TypeError, ValueError, AttributeError, FittingError)


@dataclass(frozen=True)
class Entry:
    """One fit of a ledger."""

    document: dict[str, Any]  # the JSON object of the entry, with all keys of the file

    @cached_property
    def stored(self) -> EntryDocument:
        """The document as a validated object; a pydantic.ValidationError if a key is missing or of a wrong type."""
        return EntryDocument.model_validate(self.document)

    @property
    def fit_id(self) -> str:
        """The name of the fit: f1, f2, ..."""
        return self.stored.fit_id

    @property
    def digests(self) -> list[str]:
        """Digests of the cases that were fitted."""
        return self.stored.digests

    @property
    def choices(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Parameters shared by all cases, and parameters with one value per case.

        Only choices that differ from the default are listed.
        """
        return tuple(self.stored.share), tuple(self.stored.per_case)

    @cached_property
    def prior(self) -> Prior | None:
        """The prior of the fit; None without a prior."""
        stored = self.stored.prior
        if stored is None:
            return None
        covariance = tuple(map(tuple, stored.covariance))
        return Prior(tuple(stored.names), tuple(stored.mean), covariance, stored.source)

    def as_prior(self, source: str) -> Prior:
        """Return the parameters of the fit with their covariance as a prior of another study.

        `source` is the name of the study of this fit. A LedgerError is raised if the ledger contains no covariance, an
        EstimationError if the fit determines no parameter that another study can use.
        """
        if not self.stored.covariance:
            raise LedgerError(
                f"the fit {self.fit_id} of {source} was stored without a covariance", "fit this study again"
            )
        title = f"{source} ({self.fit_id})"
        return Prior.of(self.stored.variables, self.stored.covariance, self.estimates, title)

    @property
    def model(self) -> Model:
        """The fitted model."""
        return Model(effects_of(self.stored.model, self.stored.own_effects))

    @property
    def variables(self) -> list[str]:
        """Names of the parameters of `covariance`; empty if the fit was stored without a covariance."""
        return list(self.stored.variables)

    @property
    def covariance(self) -> list[list[float]]:
        """Covariance of the `variables`, in SI units."""
        return [list(row) for row in self.stored.covariance]

    @property
    def estimates(self) -> dict[str, EstimateDocument]:
        """The parameters with their standard uncertainties."""
        return self.stored.parameters

    def shown(self, data: Sequence[CaseData]) -> Fit:
        """Return the fit for display: restored if the same version of the code stored it, otherwise fitted again."""
        data = with_prior(data, self.prior)
        stored, found = self.document.get("restored_from"), None
        if stored:
            with suppress(*_DAMAGED):
                found = restored_fit(StoredFit.model_validate(stored), self.model, data)
        return found or self.refit(data)

    def diagnosis(self, fit: Fit, extra: Sequence[Effect] = ()) -> Diagnosis | None:
        """Return the stored diagnosis; None unless the same version of the code made it with the same user effects."""
        stored = self.document.get("diagnosis")
        if stored:
            with suppress(*_DAMAGED):
                return restored_diagnosis(StoredDiagnosis.model_validate(stored), fit, extra)
        return None

    def certificate(
        self, found: Diagnosis, seed: int | None = None, *, film: bool | None = None
    ) -> Certificate | None:
        """Return the stored certificate of `found`, also an incomplete one.

        None if this version of the code stored none.

        `seed` selects certificates whose random errors have this seed; `film` selects certificates from films (True) or
        from simulated data (False). A certificate from films is preferred, because it tests the tracking as well.
        """
        answer = Certificate.of_answer(found, (), 0)
        for key in (_OF_FILMS, _OF_DATA):
            known = None
            with suppress(*_DAMAGED):
                stored = self.document.get(key)
                known = restored_certificate(StoredCertificate.model_validate(stored)) if stored else None
            if known is None or (known.verdict, known.named) != (answer.verdict, answer.named):
                continue
            if seed in {None, known.seed} and film in {None, known.film}:
                return known
        return None

    def latest_certificate(self) -> Certificate | None:
        """Return the stored certificate of any answer, preferably from films.

        None if this version of the code stored none.
        """
        for key in (_OF_FILMS, _OF_DATA):
            stored = self.document.get(key)
            with suppress(*_DAMAGED):
                if stored and (found := restored_certificate(StoredCertificate.model_validate(stored))):
                    return found
        return None

    def refit(self, data: Sequence[CaseData]) -> Fit:
        """Fit the model again with the stored parameters as initial values."""
        return robust_fit(
            self.model,
            with_prior(data, self.prior),
            self.stored.loss,
            share=self.stored.share,
            per_case=self.stored.per_case,
            start={k: e.value for k, e in self.stored.parameters.items()},
            ranges=self.stored.ranges,
        )


# keys of the certificates from simulated data and from films
_OF_DATA, _OF_FILMS = "certificate", "certificate_of_films"


class Ledger:
    """The fits in one file.

    Parameters
    ----------
    path : Path
        The file; it need not exist yet.

    Raises
    ------
    LedgerError
        If the file exists and is not a ledger.
    """

    def __init__(self, path: Path) -> None:
        require("path", path, PATH)
        self.path = path = Path(path)
        self.entries: list[Entry] = []
        if path.exists():
            self.entries = _read(path)

    def __repr__(self) -> str:
        return f"Ledger {self.path}: {len(self.entries)} fits"

    @classmethod
    def default_for(cls, case: Path) -> Ledger:
        """Return the ledger next to a case file: ``case1.h5`` has ``case1.fits.json``.

        Parameters
        ----------
        case : Path
            The case file.
        """
        return cls(case.with_name(f"{case.stem}.fits.json"))

    def of(self, data: Sequence[CaseData]) -> list[Entry]:
        """Return the fits of exactly these cases.

        Parameters
        ----------
        data : sequence of CaseData
            The cases.
        """
        key = sorted(d.record.digest for d in data)
        return [e for e in self.entries if sorted(e.digests) == key]

    def find(self, fit_id: str) -> Entry:
        """Return a fit by its name.

        Parameters
        ----------
        fit_id : str
            "f1", "f2", ...

        Raises
        ------
        LedgerError
            If no fit has this name.
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
        """Append a fit and write the file atomically; entries that other processes have added are kept.

        Parameters
        ----------
        found : Fit
            The fit.
        parent : str
            Name of the fit from which this fit was made.
        added : str
            The change from the parent.
        previous : Fit, optional
            The fit with which the errors are compared.
        share, per_case : sequence of str
            Parameters shared by all cases, and parameters with one value per case; only choices that differ from the
            default.
        ranges : dict, optional
            Bounds [unit of the parameter] that replace the bounds of the effects.
        loss : str
            Robust loss of the fit.
        """
        if not share and not per_case:
            share, per_case = found.problem.layout.choices
        records = [d.record for d in found.problem.data]
        with self._locked():
            fit_id = f"f{1 + max((int(e.fit_id[1:]) for e in self.entries), default=0)}"
            document = EntryDocument(
                **fit_document(found, fit_id),
                parent=parent,
                added=added,
                rung=step_document(found, fit_id, added, previous),  # type: ignore[arg-type]  # pydantic reads it
                digests=[r.digest for r in records],
                sources=[r.source for r in records],
                own_effects=own_effects(found.model.effects),
                share=list(share),
                per_case=list(per_case),
                ranges=ranges or {},
                loss=loss,
                data=records[0].quantity,
                rotor="generated" if records[0].generated else "windows",
                created=datetime.now(UTC).isoformat(timespec="seconds"),
                software_version=_version(),
                variables=list(found.problem.layout.names),
                covariance=found.covariance.tolist(),
                # a robust fit uses pseudo-values, which are not stored
                restored_from=as_json(stored_fit(found)) if loss == "linear" else None,
            )
            entry = Entry(to_json(document.model_dump(exclude={"diagnosis"})))
            self.entries.append(entry)
            return entry

    def keep_diagnosis(self, fit_id: str, found: Diagnosis, extra: Sequence[Effect] = ()) -> None:
        """Store the diagnosis of a fit for later display without a new search.

        Parameters
        ----------
        fit_id : str
            Name of the fit.
        found : Diagnosis
            The diagnosis of the fit.
        extra : sequence of Effect
            Effects of the user that were tested in addition to the library.
        """
        with self._locked():
            self.find(fit_id).document["diagnosis"] = as_json(stored_diagnosis(found, extra))

    def keep_certificate(self, fit_id: str, found: Certificate) -> None:
        """Store the test of an answer, also an incomplete one; it replaces an earlier test of the same kind.

        Parameters
        ----------
        fit_id : str
            Name of the fit.
        found : Certificate
            The test.
        """
        with self._locked():
            key = _OF_FILMS if found.film else _OF_DATA
            self.find(fit_id).document[key] = as_json(stored_certificate(found))

    def annotate(self, fit_id: str, *, name: str | None = None, note: str | None = None) -> None:
        """Set the name or the note of a fit; None keeps the present text.

        Parameters
        ----------
        fit_id : str
            The fit.
        name, note : str or None
            Texts of at most 200 and 2000 characters (longer texts are cut); an empty text removes the present text.

        Raises
        ------
        LedgerError
            If no fit has this name.
        """
        with self._locked():
            document = self.find(fit_id).document
            if name is not None:
                document["name"] = name.strip()[:200]
            if note is not None:
                document["note"] = note.strip()[:2000]

    def delete(self, fit_id: str) -> Entry:
        """Remove a fit without successors, and return it for `restore`.

        Parameters
        ----------
        fit_id : str
            The fit.

        Raises
        ------
        LedgerError
            If no fit has this name, or other fits were made from this fit.
        """
        with self._locked():
            entry = self.find(fit_id)
            successors = [e.fit_id for e in self.entries if e.stored.parent == fit_id]
            if successors:
                raise LedgerError(
                    f"{fit_id} has successors: {', '.join(successors)}",
                    "delete the successors first, or keep this fit",
                )
            self.entries.remove(entry)
            return entry

    def restore(self, entry: Entry) -> None:
        """Add a deleted fit again.

        Parameters
        ----------
        entry : Entry
            The entry from `delete`.

        Raises
        ------
        LedgerError
            If another fit has the same name.
        """
        with self._locked():
            if any(e.fit_id == entry.fit_id for e in self.entries):
                raise LedgerError(f"{self.path} has another fit {entry.fit_id}", "fit the model again")
            self.entries.append(entry)
            self.entries.sort(key=lambda e: int(e.fit_id[1:]))

    @contextmanager
    def _locked(self) -> Iterator[None]:
        """Lock and read the file, let the block change the entries, and write the file.

        The entries are checked before they are written. If the block or the check fails, they remain unchanged.
        """
        with locked(self.path):
            before = _content(self.path)
            self.entries = _read(self.path) if before is not None else self.entries
            kept = [Entry(deepcopy(e.document)) for e in self.entries]
            try:
                yield
                text = as_text(LedgerDocument(fits=[e.document for e in self.entries]))
                try:
                    _parsed(text, self.path)
                except LedgerError as fault:
                    what = f"this change would make {fault.message.replace(' is damaged', ' unreadable')}"
                    raise LedgerError(what, "correct the text") from None
                # on some network drives a lock does not exclude other hosts
                write_text(self.path, text, unchanged=lambda: _content(self.path) == before)
                # new objects are made, because entries cache values of documents that may have changed
                self.entries = [Entry(e.document) for e in self.entries]
            except BaseException:
                self.entries = kept
                raise


def _content(path: Path) -> bytes | None:
    refuse_special(path)
    return path.read_bytes() if path.exists() else None


def _read(path: Path) -> list[Entry]:
    return _entries(read_json(path, LedgerDocument, *_WRONG), path)


def _parsed(text: str, path: Path) -> list[Entry]:
    return _entries(parse_json(text, path, LedgerDocument, *_WRONG), path)


_WRONG = "is not a ledger of fits", _ELSEWHERE
_FIT_ID = re.compile("f[1-9][0-9]{0,8}")


def _entries(document: LedgerDocument, path: Path) -> list[Entry]:
    entries = [Entry(d) for d in document.fits]
    for entry in entries:
        try:
            valid = _FIT_ID.fullmatch(entry.fit_id)
        except ValidationError as fault:
            raise LedgerError(f"{path} is damaged: {first_error(fault)}", _ELSEWHERE) from None
        if not valid:
            raise LedgerError(f"{path} is damaged: {entry.fit_id[:40]!r} is not a name of a fit", _ELSEWHERE)
    return entries


def _version() -> str:
    try:
        return version("gyrotrack")
    except PackageNotFoundError:
        return "unknown"
