"""`gyrotrack fit`: the parameters of a model from one case or several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gyrotrack.cli.options import CaseFiles, Json, Quiet
from gyrotrack.cli.output import DONE, NOT_TRUSTED, Output
from gyrotrack.cli.study import DataKind, EffectsFile, From, LedgerFile, RotorKind, own_effects
from gyrotrack.cli.tables import bias_tables, fit_tables, prediction_tables
from gyrotrack.errors import UsageError
from gyrotrack.study import Wish, open_study

if TYPE_CHECKING:
    from fitting.estimation import Fit
    from fitting.estimation.prediction import Predicted
    from fitting.estimation.profile import Interval
    from fitting.rotor_curve import CurveBias

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
    if (share or per_case or hold_out) and not joint:
        raise UsageError("--share, --per-case and --hold-out speak of a joint fit.", "Add --joint.")
    if loss not in _LOSSES:
        raise UsageError(f"There is no loss named {loss[:40]!r}.", f"Losses: {', '.join(_LOSSES)}.")
    out = Output(as_json=as_json, quiet=quiet)
    groups = [cases] if joint else [[case] for case in cases]
    wish = Wish(
        model=model,
        add=tuple(add or ()),
        drop=tuple(drop or ()),
        own=own_effects(effects),
        share=tuple(share or ()),
        per_case=tuple(per_case or ()),
        held=_held(fix or ()),
        loss=loss,
    )
    documents = []
    for group in groups:
        study = open_study(group, ledger, data=data, rotor=rotor)
        with out.progress("fitting") as progress:
            progress(0, None)
            found, fit_id = wish.fit(study, start)
            intervals = _intervals(found, profile or ())
            predicted = _predicted(found) if hold_out else None
            bias = _bias(found)
        documents.append(_document(found, fit_id, intervals, predicted) | _plain_bias(bias))
        out.show(*fit_tables(found, fit_id, intervals), *bias_tables(found, bias))
        out.show(*prediction_tables(predicted or ()))
    out.result(documents[0] if len(documents) == 1 else {"fits": documents})
    return NOT_TRUSTED if any(d["verdict"] == "not converged" for d in documents) else DONE


def _bias(found: Fit) -> dict[str, CurveBias]:
    from fitting.rotor_curve import curve_bias

    return curve_bias(found)


def _plain_bias(bias: Mapping[str, CurveBias]) -> dict[str, Any]:
    from fitting.summary import bias_document

    return {"generated_rotor": bias_document(bias)} if bias else {}


def _document(
    found: Fit, fit_id: str, intervals: Mapping[str, Interval], predicted: Sequence[Predicted] | None
) -> dict[str, Any]:
    from fitting.summary import fit_document, interval_document

    document = fit_document(found, fit_id)
    for name, interval in intervals.items():
        document["parameters"][name]["interval"] = interval_document(interval)
    if predicted is not None:
        document["predicted"] = _plain(predicted)
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
