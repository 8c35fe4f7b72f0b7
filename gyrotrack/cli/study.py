"""What the commands on cases have in common: read cases, find the rung to start from, choose models."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gyrotrack.errors import UsageError

if TYPE_CHECKING:
    from fitting.case_data import CaseData
    from fitting.effects import Effect
    from fitting.estimation import Fit
    from fitting.ledger import Entry, Ledger
    from fitting.model import Model

From = Annotated[
    str | None, typer.Option("--from", metavar="ID", help="Start from this fit; the latest, if not given.")
]
LedgerFile = Annotated[
    Path | None,
    typer.Option(
        "--ledger", metavar="FILE", help="Where the fits are kept; beside the first case, if not given."
    ),
]
EffectsFile = Annotated[
    Path | None, typer.Option("--effects", metavar="FILE", help="Effects of your own, in TOML.")
]
DataKind = Annotated[
    str | None,
    typer.Option("--data", metavar="D", help="angle or velocity (smoothed as in the paper): what is fitted."),
]
RotorKind = Annotated[
    str,
    typer.Option(
        "--rotor", metavar="R", help="windows as measured, or generated: the paper's curve through them."
    ),
]


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
    from fitting.record import read_record

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


def own_effects(path: Path | None) -> list[Effect]:
    """Read the effects of the user's file, if there is one."""
    from fitting.effects import read_effects

    return read_effects(path) if path is not None else []


def changed(model: Model, add: Sequence[str], drop: Sequence[str], own: Sequence[Effect]) -> Model:
    """Return a model with effects added (by name or as `body: law`) and dropped."""
    from fitting.effects import resolve

    known = {e.name: e for e in own}
    for name in add:
        effect = known.get(name) or resolve(name)
        model = model if effect.name in model.names else model.with_effect(effect)
    for name in drop:
        model = model.without(name)
    return model
