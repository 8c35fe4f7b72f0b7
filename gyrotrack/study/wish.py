"""The next fit of a study: which model is wanted, from where it starts, and the rung that it becomes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gyrotrack.errors import UsageError
from gyrotrack.study.cases import Study

if TYPE_CHECKING:
    from fitting.effects import Effect
    from fitting.estimation import Fit
    from fitting.ledger import Entry
    from fitting.model import Model

_NAMED = ("reduced", "general", "linear")


@dataclass(frozen=True)
class Wish:
    """A model to be fitted to the cases of a study.

    Attributes
    ----------
    model : str, optional
        reduced, general, linear, or the name of a TOML file. Without it the wish is a change of an earlier fit, and
        if there is none the reduced model.
    add, drop : tuple of str
        Effects by name, and for `add` also laws such as ``casing: -k*omega_c**3``.
    own : sequence of Effect
        Effects of the user, which `add` may name.
    share, per_case : tuple of str
        Parameters with one value for all cases, or with a value for each.
    held : mapping
        Values of parameters that are not fitted [SI].
    loss : str
        linear, huber or cauchy.
    """

    model: str | None = None
    add: tuple[str, ...] = ()
    drop: tuple[str, ...] = ()
    own: Sequence[Effect] = ()
    share: tuple[str, ...] = ()
    per_case: tuple[str, ...] = ()
    held: Mapping[str, float] = field(default_factory=dict)
    loss: str = "linear"

    def fit(self, study: Study, start: str | None = None) -> tuple[Fit, str]:
        """Fit, and keep the result in the ledger.

        Parameters
        ----------
        study : Study
            The cases.
        start : str, optional
            Name of the fit that is changed; the latest, if not given.

        Returns
        -------
        tuple of (Fit, str)
            What was found, and its name in the ledger.

        Raises
        ------
        UsageError
            There is no such model, or the fit `start` is not one of these cases.
        """
        wanted, entry = self._wanted(study, start)
        share, per_case = self._choices(entry, wanted)
        ranges = _paper_ranges(study, share, per_case) if self.model == "general" else {}
        previous = entry.refit(study.data) if entry is not None else None
        if previous is None and self.add and self.model is None:
            previous, fit_id = study.base(None)
            entry = study.entry(fit_id)
        values = _starts(previous, wanted) if previous is not None else None
        options: dict[str, Any] = {"share": share, "per_case": per_case, "ranges": ranges}
        found = self._fitted(study, wanted, values, options)
        kept = study.ledger.add(
            found,
            parent=entry.fit_id if entry is not None else "",
            added=self.change,
            previous=previous,
            **options,
            loss=self.loss,
        )
        return found, kept.fit_id

    def _fitted(
        self,
        study: Study,
        wanted: Model,
        start: Mapping[str, float] | None,
        options: dict[str, Any],
    ) -> Fit:
        from fitting.errors import FittingError
        from fitting.estimation.robust import robust_fit

        try:
            return robust_fit(wanted, study.data, self.loss, start=start, **options)
        except FittingError:
            # what suited the parent may be no start for the new model: the program's own then
            if start is None:
                raise
            return robust_fit(wanted, study.data, self.loss, **options)

    def _choices(self, entry: Entry | None, wanted: Model) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return what to share and what not: as the fit that is changed does, where the wish has no other word."""
        if entry is None:
            return self.share, self.per_case
        from fitting.estimation.layout import covers

        share, per_case = (
            [n for n in names if any(covers(n, key) for key in wanted.free)] for names in entry.choices
        )
        return (
            (*self.share, *(n for n in share if n not in self.per_case)),
            (*self.per_case, *(n for n in per_case if n not in self.share)),
        )

    @property
    def change(self) -> str:
        """The wish in few words, as the ladder shows it."""
        steps = [
            *(f"+{a}" for a in self.add),
            *(f"-{d}" for d in self.drop),
            *(f"{k}={v:g}" for k, v in self.held.items()),
            *([self.loss] if self.loss != "linear" else []),
        ]
        return " ".join(steps) or (self.model or "")

    def _wanted(self, study: Study, start: str | None) -> tuple[Model, Entry | None]:
        """Return the model, and the rung of which it is a change."""
        from fitting.effects import REDUCED

        follows = self.model is None and (self.add or self.drop or start)
        entry = study.entry(start) if follows else None
        if entry is not None:
            base = entry.model
        elif self.model is None:
            base = study.model(REDUCED)
        else:
            base = self._named(self.model, study)
        return changed(base, self.add, self.drop, self.own).with_fixed(dict(self.held)), entry

    def _named(self, name: str, study: Study) -> Model:
        from fitting.effects import GENERAL, LINEAR, REDUCED
        from fitting.model import read_model

        if name in _NAMED:
            return study.model({"reduced": REDUCED, "general": GENERAL, "linear": LINEAR}[name])
        path = Path(name)
        if not path.is_file():
            raise UsageError(
                f"{name} is no model.", f"Models: {', '.join(_NAMED)}, or the name of a TOML file."
            )
        return read_model(path, self.own)


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


def _starts(previous: Fit, wanted: Model) -> dict[str, float]:
    from fitting.discovery import found_starts, needs_search

    new = [e for e in wanted.effects if e.name not in previous.model.names and needs_search(e)]
    found = found_starts(previous, new) if new else {}
    return {k: e.value for k, e in previous.estimates.items()} | found


def _paper_ranges(
    study: Study, share: tuple[str, ...], per_case: tuple[str, ...]
) -> dict[str, tuple[float, float]]:
    from fitting.effects import REDUCED
    from fitting.estimation import fit
    from fitting.scanning import paper_ranges

    reduced = fit(study.model(REDUCED), study.data, share=share, per_case=per_case)
    return paper_ranges([reduced], reduced.labels)
