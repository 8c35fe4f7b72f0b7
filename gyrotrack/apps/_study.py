"""Cases that are analysed jointly, the history of their fits, and requests for the next fit.

`fitting` is imported where it is needed, so that commands start fast.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitting._errors import FittingError, LedgerError
from fitting._numbers import Units
from gyrotrack._errors import DatasetError, UsageError

if TYPE_CHECKING:
    from fitting._workers import WorkerPool
    from fitting.discovery._certificate import Certificate
    from fitting.discovery._select import Step
    from fitting.discovery._verdict import Diagnosis
    from fitting.dynamics._inputs import Input
    from fitting.dynamics._model import Model
    from fitting.effects._effect import Effect
    from fitting.effects._mechanism import Mechanism
    from fitting.inference._case_data import CaseData
    from fitting.inference._prior import Prior
    from fitting.inference._result import Fit
    from fitting.study._history import Entry, Ledger


@dataclass(frozen=True)
class Study:
    """Cases that are fitted together, and the history of their fits.

    Attributes
    ----------
    data : tuple of CaseData
        The cases, compressed for fitting.
    ledger : Ledger
        The fits of these cases; the same file may contain fits of other sets of cases.
    prior : Prior, optional
        Parameters of another study, used for new fits; by default a fit has the prior of the fit from which it starts.
    """

    data: tuple[CaseData, ...]
    ledger: Ledger
    prior: Prior | None = None

    @property
    def mechanism(self) -> Mechanism:
        """The bodies of the cases and the joints between them."""
        return self.data[0].record.mechanism

    def entry(self, fit_id: str | None) -> Entry | None:
        """Return the fit with this name, by default the latest of these cases; None if there is none.

        Parameters
        ----------
        fit_id : str or None
            "f1", "f2", ...
        """
        if fit_id is not None:
            found = self.ledger.find(fit_id)
            if sorted(found.digests) != sorted(d.record.digest for d in self.data):
                what = f"The fit {fit_id} belongs to other cases."
                raise UsageError(what, "`gyrotrack ladder` lists the fits of these cases.")
            return found
        entries = self.ledger.of(self.data)
        return entries[-1] if entries else None

    def model(self, names: Iterable[str]) -> Model:
        """Return the model with the given effects, without effects that do not apply to the recorded bodies.

        Parameters
        ----------
        names : iterable of str
            Names of effects.
        """
        from fitting.dynamics._model import Model

        return Model.of(names, self.mechanism).of_bodies(self.data[0].record.parts)

    @property
    def first_model(self) -> Model:
        """The model of a first fit: linear for a chain, else reduced (which contains the bearing of the gyroscope)."""
        from fitting.effects._library import LINEAR, REDUCED

        return self.model(LINEAR if self.data[0].record.is_chain else REDUCED)

    def steps_to(self, fit_id: str | None) -> list[Step]:
        """Return the history that ends with a fit (by default the latest), oldest first.

        Parameters
        ----------
        fit_id : str or None
            "f1", "f2", ...
        """
        from fitting.discovery._select import Step

        if self.entry(fit_id) is None:
            fit, _ = self.base(None)
            return [Step("", fit, ())]
        chain = self._chain(fit_id)
        return [Step(str(e.document.get("added", "")), e.shown(self.data), ()) for e in reversed(chain)]

    def _chain(self, fit_id: str | None) -> list[Entry]:
        """Return an entry (by default the latest) and the fits from which it was derived, oldest last."""
        entry = self.entry(fit_id)
        if entry is None:
            return []
        known = {e.fit_id: e for e in self.ledger.of(self.data)}
        chain = [entry]
        while (found := known.get(str(chain[-1].document.get("parent", "")))) and found not in chain:
            chain.append(found)
        return chain

    def diagnosis(
        self, fit_id: str | None, fit: Fit, extra: Sequence[Effect] = (), *, workers: WorkerPool | None = None
    ) -> Diagnosis:
        """Return the stored diagnosis of the first fit of a history, or make and store a new diagnosis.

        Parameters
        ----------
        fit_id : str or None
            The last fit of the history, as for `steps_to`.
        fit : Fit
            The first fit of the history.
        extra : sequence of Effect
            User-defined effects, in addition to the library.
        workers : WorkerPool, optional
            Worker processes.
        """
        from fitting.discovery._verdict import diagnose

        entry = self._chain(fit_id)[-1]
        found = entry.diagnosis(fit, extra)
        if found is None:
            found = diagnose(fit, extra, workers=workers)
            self.keep_diagnosis(entry.fit_id, found, extra)
        return found

    def answered(
        self, fit_id: str | None, extra: Sequence[Effect] = (), *, workers: WorkerPool | None = None
    ) -> tuple[Diagnosis, str]:
        """Return the diagnosis that a report shows, and the name of the diagnosed fit, which is the first of a history.

        Parameters
        ----------
        fit_id : str or None
            The last fit of the history, as for `steps_to`.
        extra : sequence of Effect
            User-defined effects, in addition to the library.
        workers : WorkerPool, optional
            Worker processes.
        """
        first = self.steps_to(fit_id)[0].fit
        return self.diagnosis(fit_id, first, extra, workers=workers), self._chain(fit_id)[-1].fit_id

    def certificate(self, fit_id: str | None, found: Diagnosis) -> Certificate | None:
        """Return the stored test of an answer that `diagnosis` returned; None if there is none.

        Parameters
        ----------
        fit_id : str or None
            The last fit of the history, as for `steps_to`.
        found : Diagnosis
            The answer.
        """
        return self._chain(fit_id)[-1].certificate(found)

    def keep_diagnosis(self, fit_id: str, found: Diagnosis, extra: Sequence[Effect] = ()) -> None:
        """Store a diagnosis with its fit, if the ledger can be written.

        Parameters
        ----------
        fit_id : str
            Name of the fit.
        found : Diagnosis
            Its diagnosis.
        extra : sequence of Effect
            User-defined effects that were tested with the library.
        """
        with suppress(LedgerError):
            self.ledger.keep_diagnosis(fit_id, found, extra)

    def recorder(self, first: str, fit: Fit) -> Recorder:
        """Return a recorder for the steps that follow a fit of the ledger.

        Parameters
        ----------
        first : str
            Name of the fit.
        fit : Fit
            The fit.
        """
        return Recorder(self.ledger, [self.ledger.find(first)], fit)

    def base(self, fit_id: str | None) -> tuple[Fit, str]:
        """Return a fit (by default the latest) and its name; if there is no fit, the reduced model is fitted.

        Parameters
        ----------
        fit_id : str or None
            "f1", "f2", ...
        """
        from fitting.inference._case_data import with_prior
        from fitting.inference._fit import fit

        entry = self.entry(fit_id)
        if entry is None:
            found = fit(self.first_model, with_prior(self.data, self.prior))
            return found, self.ledger.add(found).fit_id
        if self.prior is None or self.prior == entry.prior:
            return entry.refit(self.data), entry.fit_id
        share, per_case = entry.choices
        start = {k: e.value for k, e in entry.estimates.items()}
        data = with_prior(self.data, self.prior)
        found = fit(entry.model, data, share=share, per_case=per_case, start=start)
        added = f"prior {self.prior.source}"
        return found, self.ledger.add(found, parent=entry.fit_id, added=added).fit_id


@dataclass
class Recorder:
    """Stores each step of a search in the ledger immediately, so that an interrupted search loses no step."""

    ledger: Ledger  # the history of fits
    entries: list[Entry]  # the entries, oldest first
    fit: Fit  # the fit of the latest entry

    def __call__(self, step: Step) -> None:
        """Store the next step."""
        parent = self.entries[-1].fit_id
        self.entries.append(self.ledger.add(step.fit, parent=parent, added=step.change, previous=self.fit))
        self.fit = step.fit


def open_study(
    cases: Sequence[Path],
    ledger: Path | None,
    *,
    data: str | None = None,
    rotor: str = "windows",
    prior: Path | None = None,
    prior_rotor: Path | None = None,
    read: tuple[CaseData, ...] = (),
) -> Study:
    """Read cases and their ledger.

    Parameters
    ----------
    cases : sequence of Path
        Case files (HDF5).
    ledger : Path or None
        File of the fits; by default next to the first case.
    data : {"angle", "velocity"}, optional
        Fit the measured angles, or smoothed angular velocities as in the paper.
    rotor : {"windows", "generated"}
        Fit the measured rotor data, or one generated curve through these data as in the paper.
    prior : Path, optional
        Case or ledger of another study; the parameters of its latest fit are a prior for this study.
    prior_rotor : Path, optional
        A study of the rotor as a single body.
    read : tuple of CaseData
        The cases, if they have already been read.
    """
    from fitting.inference._prior import Prior
    from fitting.study._history import Ledger

    read = read or read_cases(cases, data=data, rotor=rotor)
    kept = Ledger(ledger) if ledger is not None else Ledger.default_for(Path(cases[0]))
    if prior is not None and prior_rotor is not None and prior.resolve() == prior_rotor.resolve():
        what = f"{prior} is given as the study of both bodies."
        raise UsageError(what, "Give --prior-rotor the study of the rotor alone.")
    studies = ((prior, False), (prior_rotor, True))
    known = [_prior_of(path, read, rotor=of_rotor) for path, of_rotor in studies if path is not None]
    return Study(read, kept, reduce(Prior.joined, known) if known else None)


def _prior_of(path: Path, data: Sequence[CaseData], *, rotor: bool) -> Prior:
    from fitting.effects._library import of_the_rotor

    (entry,) = latest_fits([path]).values()
    own = {d.record.digest for d in data}.intersection(entry.digests)
    if own:
        what = f"{path} is a fit of the same data; with this prior, a fit would use these data twice."
        raise UsageError(what, "Give --prior a study of other recordings.")
    prior = entry.as_prior(path.name)
    units = Units.common(d.record.units for d in data)
    for name in prior.names:
        unit = entry.model.parameters[name].unit
        expected = units.of(unit)
        if entry.estimates[name].unit != expected:
            what = f"{path} gives {name} in {entry.estimates[name].unit}, but these cases need {expected}."
            raise UsageError(what, "Give --inertia for both studies, or for neither.")
    if not rotor:
        return prior
    renamed: dict[str, str] = {}
    for effect in entry.model.effects:
        same = of_the_rotor(effect)
        if same is not None:
            pairs = zip(effect.parameters, same.parameters, strict=True)
            renamed |= {f"{effect.name}.{p.symbol}": f"{same.name}.{q.symbol}" for p, q in pairs}
    if not renamed.keys() & set(prior.names):
        what = f"No law in {path} can be applied to the rotor."
        raise UsageError(what, "These laws can: air drag, and dry friction of the support.")
    return prior.renamed(renamed)


def checked_body_name(name: str) -> str:
    """Return the name of a single body; a UsageError states what is accepted."""
    from fitting._case_checks import is_body_name

    if name and not is_body_name(name):
        what = (
            f"{name[:40]!r} cannot be the name of a body: it has another meaning in laws, or is not one word."
        )
        raise UsageError(what, "Use one word of letters and digits, for example wheel or disc.")
    return name


def read_cases(
    cases: Sequence[Path], *, data: str | None = None, rotor: str = "windows"
) -> tuple[CaseData, ...]:
    """Read cases and compress them: data as measured, or the paper's velocities and generated rotor curve."""
    from fitting.inference._case_data import CaseData
    from fitting.inference._case_file import read_record

    choices = (("data", data or "angle", ("angle", "velocity")), ("rotor", rotor, ("windows", "generated")))
    for option, word, words in choices:
        if word not in words:
            what = f"Unknown value {word[:40]!r} of --{option}."
            raise UsageError(what, f"Use one of: {', '.join(words)}.")
    records = [read_record(path) for path in cases]
    if data is not None or rotor != "windows":
        from fitting.study._preparation import prepared

        records = [prepared(r, data, rotor) for r in records]
    return tuple(CaseData.of(r) for r in records)


def latest_fits(runs: Sequence[Path], effects: Sequence[str] | None = None) -> dict[str, Entry]:
    """Return the latest fit of each run, by name of the run; a run is a case with a ledger next to it, or a ledger.

    `effects`, if given, are the sorted names of the effects in the model of the fit.
    """
    from fitting.study._history import Ledger

    found: dict[str, Entry] = {}
    seen: set[Path] = set()
    for path in runs:
        if not path.is_file():
            raise DatasetError(f"There is no file {path}.", "Check the path.")
        name = path.name.removesuffix(".fits.json").removesuffix(".h5")
        whole = path.resolve().with_name(name)
        if whole in seen:
            raise UsageError(f"{path} is given twice.", "Give each run once.")
        seen.add(whole)
        name = str(whole) if name in found else name
        if path.suffix == ".json":
            entries = Ledger(path).entries
        else:
            from fitting.inference._case_file import read_record

            digest = read_record(path).digest
            entries = [e for e in Ledger.default_for(path).entries if e.digests == [digest]]
        if effects is not None:
            entries = [e for e in entries if sorted(e.model.names) == list(effects)]
        if not entries:
            raise DatasetError(f"{path} has no fit.", f"Run `gyrotrack improve {path}` first.")
        found[name] = entries[-1]
    return found


def with_ledgers(cases: Sequence[Path], *others: Path | None) -> list[Path | None]:
    """Return the files that no output may replace: cases, the ledgers next to them, and other files."""
    return [*cases, *(case.with_name(f"{case.stem}.fits.json") for case in cases), *others]


_NAMED = ("reduced", "general", "linear")


@dataclass(frozen=True)
class FitRequest:
    """A request to fit a model to the cases of a study.

    Attributes
    ----------
    model : str, optional
        reduced, general, linear, or the name of a TOML file. Without a model, the request modifies an earlier fit, or
        the reduced model if there is no fit.
    add, drop : tuple of str
        Effects by name, and for `add` also laws like ``casing: -k*omega_c**3``.
    own : sequence of Effect
        User-defined effects, which `add` may contain.
    share, per_case : tuple of str
        Parameters with one value for all cases, or one per case.
    held : mapping
        Values of fixed parameters [SI].
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

    def model_for(self, study: Study) -> Model:
        """Return the model that is fitted to cases without earlier fits.

        Parameters
        ----------
        study : Study
            The cases.
        """
        return self._wanted(study, None)[0]

    def fit(self, study: Study, start: str | None = None) -> tuple[Fit, str]:
        """Fit, and store the result in the ledger.

        Parameters
        ----------
        study : Study
            The cases.
        start : str, optional
            Name of the fit that is modified; by default the latest.

        Returns
        -------
        tuple of (Fit, str)
            The result, and its name in the ledger.

        Raises
        ------
        UsageError
            The model is unknown, or the fit `start` belongs to other cases.
        """
        from fitting.inference._case_data import with_prior

        wanted, entry = self._wanted(study, start)
        share, per_case = self._choices(entry, wanted)
        ranges = _paper_ranges(study, share, per_case) if self.model == "general" else {}
        previous = entry.refit(study.data) if entry is not None else None
        if previous is None and self.add and self.model is None:
            previous, fit_id = study.base(None)
            entry = study.entry(fit_id)
        values = (_starts(previous, wanted) or None) if previous is not None else None
        prior = study.prior or (entry.prior if entry is not None else None)
        if prior is not None and not set(prior.names) & set(wanted.free):
            raise UsageError(
                f"No parameter of the prior from {prior.source} is in the model.",
                f"Parameters of the prior: {', '.join(prior.names)}; of the model: {', '.join(wanted.free)}.",
            )
        options: dict[str, Any] = {"share": share, "per_case": per_case, "ranges": ranges}
        found = self._fitted(with_prior(study.data, prior), wanted, values, options)
        parent = entry.fit_id if entry is not None else ""
        options |= {"parent": parent, "added": self.change, "previous": previous, "loss": self.loss}
        return found, study.ledger.add(found, **options).fit_id

    def _fitted(
        self,
        data: Sequence[CaseData],
        wanted: Model,
        start: Mapping[str, float] | None,
        options: dict[str, Any],
    ) -> Fit:
        from fitting.inference._fit import robust_fit

        try:
            found = robust_fit(wanted, data, self.loss, start=start, **options)
        except FittingError:
            # the default initial values are used, because the values of the previous fit may be poor for the new model
            if start is None:
                raise
            return robust_fit(wanted, data, self.loss, **options)
        if start is None or not any(e.inputs for e in wanted.effects) or not found.fails():
            return found
        # if a drag of a driven body is missing, other parameters absorb its effect, and a search from these values may
        # fail
        other = robust_fit(wanted, data, self.loss, **options)
        return other if other.deviance < found.deviance else found

    def _choices(self, entry: Entry | None, wanted: Model) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the shared and the per-case parameters; by default they are the same as in the modified fit."""
        if entry is None:
            return self.share, self.per_case
        from fitting.inference._parameters import covers

        share, per_case = (
            [n for n in names if any(covers(n, key) for key in wanted.free)] for names in entry.choices
        )
        own = (n for n in per_case if n not in self.share)
        return (*self.share, *(n for n in share if n not in self.per_case)), (*self.per_case, *own)

    @property
    def change(self) -> str:
        """Short description of the request, for the history."""
        steps = [
            *(f"+{a}" for a in self.add),
            *(f"-{d}" for d in self.drop),
            *(f"{k}={v:g}" for k, v in self.held.items()),
            *([self.loss] if self.loss != "linear" else []),
        ]
        return " ".join(steps) or (self.model or "")

    def _wanted(self, study: Study, start: str | None) -> tuple[Model, Entry | None]:
        """Return the model, and the entry of the ledger that the request modifies."""
        follows = self.model is None and (self.add or self.drop or start)
        entry = study.entry(start) if follows else None
        if entry is not None:
            base = entry.model
        elif self.model is None:
            base = study.first_model
        else:
            base = self._named(self.model, study)
        inputs = study.data[0].record.inputs
        return changed(base, self.add, self.drop, self.own, inputs).with_fixed(dict(self.held)), entry

    def _named(self, name: str, study: Study) -> Model:
        from fitting.dynamics._model import read_model
        from fitting.effects._library import GENERAL, LINEAR, REDUCED

        if name in _NAMED:
            return study.model({"reduced": REDUCED, "general": GENERAL, "linear": LINEAR}[name])
        path = Path(name)
        if not path.is_file():
            what = f"Unknown model {name[:60]!r}."
            raise UsageError(what, f"Models: {', '.join(_NAMED)}, or the name of a TOML file.")
        return read_model(path, self.own, study.data[0].record.inputs, study.mechanism)


def changed(
    model: Model, add: Sequence[str], drop: Sequence[str], own: Sequence[Effect], inputs: Sequence[Input] = ()
) -> Model:
    """Return a model with effects added (by name or as `body: law`, which may contain `inputs`) and removed.

    Raises
    ------
    UsageError
        A law to be added is in the model under another name; the data could not separate the two strengths.
    """
    from fitting.effects._user import resolve

    known = {e.name: e for e in own}
    for name in add:
        effect = known.get(name) or resolve(name, inputs, model.mechanism)
        if effect.name in model.names:
            continue
        for e in model.effects:
            if e.name not in drop and e.site == effect.site and _form(e) == _form(effect):
                raise UsageError(
                    f"The law {name!r} is already in the model as {e.name!r}.",
                    f"Add another law, or replace this one: --drop {e.name!r}.",
                )
        model = model.with_effect(effect)
    for name in drop:
        model = model.without(name)
    return model


def _form(effect: Effect) -> list[str]:
    """Return the symbols of a law, its parameters by number; a leading sign belongs to the strength."""
    symbols = re.findall(r"\w+|\S", effect.law.strip().removeprefix("-"))
    own = [s for s in dict.fromkeys(symbols) if s in {p.symbol for p in effect.parameters}]
    return [f"parameter {own.index(s)}" if s in own else s for s in symbols]


def _starts(previous: Fit, wanted: Model) -> dict[str, float]:
    from fitting.discovery._select import found_starts, needs_search

    known = {i for e in previous.model.effects for i in e.inputs}
    if any(i not in known for e in wanted.effects for i in e.inputs):
        # in a model without the drive of a body, other parameters absorb the drive
        return {}
    new = [e for e in wanted.effects if e.name not in previous.model.names and needs_search(e)]
    found = found_starts(previous, new) if new else {}
    return {k: e.value for k, e in previous.estimates.items()} | found


def _paper_ranges(
    study: Study, share: tuple[str, ...], per_case: tuple[str, ...]
) -> dict[str, tuple[float, float]]:
    from fitting.effects._library import REDUCED
    from fitting.inference._fit import fit
    from fitting.paper._scan import paper_ranges

    reduced = fit(study.model(REDUCED), study.data, share=share, per_case=per_case)
    return paper_ranges([reduced], reduced.labels)
