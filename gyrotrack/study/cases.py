"""Cases that are looked at together, and the ledger of their fits.

What fits is imported where it is needed: the commands that take a study must come up fast.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from gyrotrack.errors import UsageError

if TYPE_CHECKING:
    from fitting.beside import Beside
    from fitting.case_data import CaseData
    from fitting.discovery import Diagnosis, Rung
    from fitting.effects import Effect
    from fitting.estimation import Fit
    from fitting.ledger import Entry, Ledger
    from fitting.model import Model


@dataclass(frozen=True)
class Study:
    """Cases that are looked at together, and their fits so far."""

    data: tuple[CaseData, ...]
    ledger: Ledger

    def entry(self, fit_id: str | None) -> Entry | None:
        """Return the rung asked for, or the latest one of these cases, or None."""
        if fit_id is not None:
            found = self.ledger.find(fit_id)
            if sorted(found.digests) != sorted(d.record.digest for d in self.data):
                raise UsageError(
                    f"The fit {fit_id} is not one of these cases.", "`gyrotrack ladder` lists them."
                )
            return found
        entries = self.ledger.of(self.data)
        return entries[-1] if entries else None

    def model(self, names: Iterable[str]) -> Model:
        """Return the model of these effects, or the part of it that one body alone has if there is but one."""
        from fitting.model import Model

        whole = Model.of(names)
        return whole.alone if self.data[0].record.single else whole

    def rungs_to(self, fit_id: str | None) -> list[Rung]:
        """Return the fit asked for, or the latest, and those that it was made from, the first one first."""
        from fitting.discovery import Rung

        if self.entry(fit_id) is None:
            fit, _ = self.base(None)
            return [Rung("", fit, ())]
        chain = self._chain(fit_id)
        return [Rung(str(e.document.get("added", "")), e.shown(self.data), ()) for e in reversed(chain)]

    def _chain(self, fit_id: str | None) -> list[Entry]:
        """Return the rung asked for, or the latest, and those that it was made from, the first one last."""
        entry = self.entry(fit_id)
        if entry is None:
            return []
        known = {e.fit_id: e for e in self.ledger.of(self.data)}
        chain = [entry]
        while (
            parent := known.get(str(chain[-1].document.get("parent", "")))
        ) is not None and parent not in chain:
            chain.append(parent)
        return chain

    def diagnosis(
        self, fit_id: str | None, fit: Fit, extra: Sequence[Effect] = (), *, beside: Beside | None = None
    ) -> Diagnosis:
        """Return the diagnosis of the first of the rungs that led to a fit, kept if there is one, else made and kept.

        Parameters
        ----------
        fit_id : str or None
            The last of the rungs, as for `rungs_to`.
        fit : Fit
            The fit of the first.
        extra : sequence of Effect
            Effects of the user beside the library.
        beside : Beside, optional
            A second process that takes its share of the work.
        """
        from fitting.discovery import diagnose

        entry = self._chain(fit_id)[-1]
        found = entry.diagnosis(fit, extra)
        if found is None:
            found = diagnose(fit, extra, beside=beside)
            self.keep_diagnosis(entry.fit_id, found, extra)
        return found

    def keep_diagnosis(self, fit_id: str, found: Diagnosis, extra: Sequence[Effect] = ()) -> None:
        """Keep a diagnosis with its rung, where the ledger can be written; it can be found again without."""
        from fitting.errors import LedgerError

        with suppress(LedgerError):
            self.ledger.keep_diagnosis(fit_id, found, extra)

    def keep(self, rungs: Sequence[Rung], first: str) -> list[Entry]:
        """Keep the rungs of a ladder whose first one is the fit `first` of the ledger; return all of them."""
        entries = [self.ledger.find(first)]
        for before, rung in pairwise(rungs):
            parent = entries[-1].fit_id
            entries.append(self.ledger.add(rung.fit, parent=parent, added=rung.change, previous=before.fit))
        return entries

    def base(self, fit_id: str | None) -> tuple[Fit, str]:
        """Return the fit to start from and its name; without any the reduced model is fitted and kept."""
        from fitting.effects import REDUCED
        from fitting.estimation import fit

        entry = self.entry(fit_id)
        if entry is not None:
            return entry.refit(self.data), entry.fit_id
        found = fit(self.model(REDUCED), self.data)
        return found, self.ledger.add(found).fit_id


def open_study(
    cases: Sequence[Path], ledger: Path | None, *, data: str | None = None, rotor: str = "windows"
) -> Study:
    """Read cases and their ledger."""
    from fitting.ledger import Ledger

    read = read_cases(cases, data=data, rotor=rotor)
    return Study(read, Ledger(ledger) if ledger is not None else Ledger.beside(Path(cases[0])))


def read_cases(
    cases: Sequence[Path], *, data: str | None = None, rotor: str = "windows"
) -> tuple[CaseData, ...]:
    """Read cases and project them: what was measured, or the paper's velocities and generated rotor curve."""
    from fitting.case_data import CaseData
    from fitting.case_file import read_record

    _known("--data", data or "angle", ("angle", "velocity"))
    _known("--rotor", rotor, ("windows", "generated"))
    records = [read_record(path) for path in cases]
    if data is not None or rotor != "windows":
        from fitting.paper_data import prepared

        records = [prepared(r, data, rotor) for r in records]
    return tuple(CaseData.of(r) for r in records)


def _known(option: str, word: str, words: tuple[str, ...]) -> None:
    if word not in words:
        raise UsageError(f"{option} {word[:40]!r} is not known.", f"It is one of: {', '.join(words)}.")
