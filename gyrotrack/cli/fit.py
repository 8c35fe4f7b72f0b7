"""`gyrotrack fit`: the parameters of a model from one case or several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gyrotrack.cli.options import CaseFiles, Json, Quiet
from gyrotrack.cli.output import DONE, NOT_TRUSTED, Output
from gyrotrack.cli.study import (
    DataKind,
    EffectsFile,
    From,
    LedgerFile,
    RotorKind,
    Study,
    changed,
    open_study,
    own_effects,
)
from gyrotrack.cli.tables import fit_tables, prediction_tables
from gyrotrack.errors import UsageError

if TYPE_CHECKING:
    from fitting.effects import Effect
    from fitting.estimation import Fit
    from fitting.estimation.prediction import Predicted
    from fitting.estimation.profile import Interval
    from fitting.model import Model

_NAMED = ("reduced", "general", "linear")
_LOSSES = ("linear", "huber", "cauchy")


def command(
    cases: CaseFiles,
    *,
    model: Annotated[
        str | None,
        typer.Option(
            "--model",
            metavar="M",
            help="reduced, general, linear, or a TOML file; reduced, if nothing was fitted yet.",
        ),
    ] = None,
    add: Annotated[
        list[str] | None,
        typer.Option("--add", metavar="E", help="Add an effect by name, or a law: 'casing: -k*omega_c**3'."),
    ] = None,
    drop: Annotated[list[str] | None, typer.Option("--drop", metavar="E", help="Take an effect out.")] = None,
    effects: EffectsFile = None,
    joint: Annotated[bool, typer.Option("--joint", help="Fit the cases together.")] = False,
    share: Annotated[
        list[str] | None, typer.Option("--share", metavar="P", help="One value for all cases.")
    ] = None,
    per_case: Annotated[
        list[str] | None, typer.Option("--per-case", metavar="P", help="A value for each case.")
    ] = None,
    profile: Annotated[
        list[str] | None,
        typer.Option(
            "--profile",
            metavar="P",
            help="95 % interval of a parameter by its profile likelihood; 'weak' for all that are weakly known.",
        ),
    ] = None,
    fix: Annotated[
        list[str] | None, typer.Option("--fix", metavar="P=V", help="Hold a parameter at a value (SI units).")
    ] = None,
    data: DataKind = None,
    rotor: RotorKind = "windows",
    loss: Annotated[
        str, typer.Option("--loss", metavar="L", help="linear, huber or cauchy: how much outliers count.")
    ] = "linear",
    hold_out: Annotated[
        bool, typer.Option("--hold-out", help="Also predict each recording from a fit of the others.")
    ] = False,
    start: From = None,
    ledger: LedgerFile = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Fit a model to angles: parameters, their errors, and how well it describes the data.

    With --add or --drop the latest fit is the start; the new fit is a further rung of the ladder.

    Example: gyrotrack fit case1.h5 --add casing.air.quadratic
    """
    if (share or per_case) and not joint:
        raise UsageError("--share and --per-case speak of a joint fit.", "Add --joint.")
    if hold_out and not joint:
        raise UsageError("--hold-out speaks of a joint fit.", "Add --joint.")
    if loss not in _LOSSES:
        raise UsageError(f"There is no loss named {loss[:40]!r}.", f"Losses: {', '.join(_LOSSES)}.")
    out = Output(as_json=as_json, quiet=quiet)
    groups = [cases] if joint else [[case] for case in cases]
    documents, trusted = [], True
    for group in groups:
        study = open_study(group, ledger, data=data, rotor=rotor)
        wish = _Wish(
            model,
            tuple(add or ()),
            tuple(drop or ()),
            own_effects(effects),
            tuple(share or ()),
            tuple(per_case or ()),
            _held(fix or ()),
            loss,
        )
        with out.progress("fitting") as progress:
            progress(0, None)
            found, fit_id = wish.fit(study, start)
            intervals = _intervals(found, profile or ())
            predicted = _predicted(found) if hold_out else ()
        document = _document(found, fit_id, intervals)
        documents.append(document | ({"predicted": _plain(predicted)} if hold_out else {}))
        trusted &= found.verdict != "not converged"
        out.show(*fit_tables(found, fit_id, intervals), *prediction_tables(predicted))
    out.result(documents[0] if len(documents) == 1 else {"fits": documents})
    return DONE if trusted else NOT_TRUSTED


def _document(found: Fit, fit_id: str, intervals: Mapping[str, Interval]) -> dict[str, Any]:
    from fitting.summary import fit_document, interval_document

    document = fit_document(found, fit_id)
    for name, interval in intervals.items():
        document["parameters"][name]["interval"] = interval_document(interval)
    return document


def _intervals(found: Fit, wanted: Sequence[str]) -> dict[str, Interval]:
    from fitting.estimation.profile import profile, weakly_determined

    names: list[str] = []
    for word in wanted:
        if word == "weak":
            names += weakly_determined(found)
            continue
        # a symbol, or a key without its case, stands for all that it fits
        keys = [k for k in found.problem.layout.names if word in {k, k.partition("@")[0], _symbol(k)}]
        names += keys or [word]
    return {name: profile(found, name) for name in dict.fromkeys(names)}


def _symbol(name: str) -> str:
    return name.partition("@")[0].rpartition(".")[2]


def _held(fix: Sequence[str]) -> dict[str, float]:
    """Read ``bearing.power.g=0.7``."""
    held = {}
    for text in fix:
        name, equals, value = text.partition("=")
        try:
            held[name.strip()] = float(value)
        except ValueError:
            equals = ""
        if not equals:
            raise UsageError(f"{text[:60]!r} holds no parameter.", "Write it as --fix bearing.power.g=0.7.")
    return held


def _predicted(found: Fit) -> Sequence[Predicted]:
    from fitting.estimation.prediction import predict_recordings

    return predict_recordings(found.model, found.problem.data, found.noise)


def _plain(predicted: Sequence[Predicted]) -> list[dict[str, Any]]:
    return [{k: getattr(p, k) for k in ("label", "casing", "rotor", "r2", "rmse")} for p in predicted]


class _Wish:
    """What the user asked to be fitted."""

    def __init__(
        self,
        model: str | None,
        add: tuple[str, ...],
        drop: tuple[str, ...],
        own: Sequence[Effect],
        share: tuple[str, ...],
        per_case: tuple[str, ...],
        held: dict[str, float],
        loss: str,
    ) -> None:
        self.held, self.loss = held, loss
        self.model, self.add, self.drop, self.own = model, add, drop, own
        self.share, self.per_case = share, per_case

    def fit(self, study: Study, start: str | None) -> tuple[Fit, str]:
        """Fit and keep the result."""
        from fitting.effects import REDUCED
        from fitting.errors import FittingError
        from fitting.estimation.robust import robust_fit

        follows = self.model is None and (self.add or self.drop or start)
        entry = study.entry(start) if follows else None
        base = (
            entry.model
            if entry is not None
            else study.model(REDUCED)
            if self.model is None
            else self._named(self.model, study)
        )
        wanted = changed(base, self.add, self.drop, self.own).with_fixed(self.held)
        ranges = _paper_ranges(study, self.share, self.per_case) if self.model == "general" else {}
        previous = entry.refit(study.data) if entry is not None else None
        if previous is None and self.add and self.model is None:
            previous, fit_id = study.base(None)
            entry = study.entry(fit_id)
        values = _starts(previous, wanted) if previous is not None else None
        options = {"share": self.share, "per_case": self.per_case, "ranges": ranges}
        try:
            found = robust_fit(wanted, study.data, self.loss, start=values, **options)
        except FittingError:
            # what suited the parent may be no start for the new model: the program's own then
            if values is None:
                raise
            found = robust_fit(wanted, study.data, self.loss, **options)
        steps = [
            *(f"+{a}" for a in self.add),
            *(f"-{d}" for d in self.drop),
            *(f"{k}={v:g}" for k, v in self.held.items()),
            *([self.loss] if self.loss != "linear" else []),
        ]
        change = " ".join(steps) or (self.model or "")
        kept = study.ledger.add(
            found,
            parent=entry.fit_id if entry is not None else "",
            added=change,
            previous=previous,
            share=self.share,
            per_case=self.per_case,
            ranges=ranges,
            loss=self.loss,
        )
        return found, kept.fit_id

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
