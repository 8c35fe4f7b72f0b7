"""Commands for fits: fit, budget, scan, diagnose, improve, ladder, effects."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import TYPE_CHECKING, Annotated, Any, TypedDict

import typer

from fitting._numbers import rounded
from fitting._workers import WorkerPool
from gyrotrack._errors import DatasetError, UsageError
from gyrotrack.apps._study import FitRequest, open_study, read_cases, with_ledgers
from gyrotrack.apps.cli import _settings as shared
from gyrotrack.apps.cli._output import (
    DONE,
    NOT_TRUSTED,
    Output,
    bias_tables,
    diagnosis_tables,
    duration,
    fit_tables,
    ladder_tables,
    prediction_tables,
)
from gyrotrack.apps.cli._settings import option

if TYPE_CHECKING:
    from fitting._schema import FitDocument, ListedStep, StepDocument
    from fitting.effects._effect import Effect
    from fitting.inference._budget import ParameterBudget
    from fitting.inference._profile import Interval
    from fitting.inference._result import Fit
    from fitting.paper._scan import Predicted


_LOSSES = ("linear", "huber", "cauchy")


class FitsDocument(TypedDict):
    """Separate fits of several cases."""

    fits: list[FitDocument]  #: One fit per case.


def fit_command(
    cases: shared.CaseFiles,
    *,
    model: Annotated[
        str | None,
        option(
            "--model M",
            "Model: reduced, general, linear, or a TOML file; by default reduced for the first fit.",
        ),
    ] = None,
    add: Annotated[
        list[str] | None, option("--add E", "Effect to add, by name or as a law: 'casing: -k*omega_c**3'.")
    ] = None,
    drop: Annotated[list[str] | None, option("--drop E", "Effect to remove.")] = None,
    effects: shared.EffectsFile = None,
    joint: Annotated[bool, option("--joint", "Fit the cases together.")] = False,
    share: Annotated[list[str] | None, option("--share P", "Parameter with one value for all cases.")] = None,
    per_case: Annotated[
        list[str] | None, option("--per-case P", "Parameter with one value per case.")
    ] = None,
    profile: Annotated[
        list[str] | None,
        option(
            "--profile P",
            "Compute the 95 % interval of a parameter by profile likelihood; 'weak' selects all weakly "
            "determined parameters.",
        ),
    ] = None,
    fix: Annotated[list[str] | None, option("--fix P=V", "Fix a parameter at a value (SI units).")] = None,
    data: shared.DataKind = None,
    rotor: shared.RotorKind = "windows",
    loss: Annotated[str, option("--loss L", "Loss function: linear, huber or cauchy.")] = "linear",
    hold_out: Annotated[
        bool, option("--hold-out", "Also predict each case from a fit of the other cases.")
    ] = False,
    prior: shared.PriorStudy = None,
    prior_rotor: shared.PriorRotor = None,
    start: shared.From = None,
    ledger: shared.LedgerFile = None,
    out: shared.Out,
) -> int:
    """Fit a model: parameters, uncertainties, goodness of fit.

    With --add or --drop, the latest model is modified, and the fit is added to its history.

    Example: gyrotrack fit case1.h5 --add casing.air.quadratic
    """
    from fitting.study._preparation import curve_bias
    from fitting.study._serialisation import fit_document

    if (share or per_case or hold_out) and not joint:
        raise UsageError("--share, --per-case and --hold-out need a joint fit.", "Add --joint.")
    if loss not in _LOSSES:
        raise UsageError(f"Unknown loss function {loss[:40]!r}.", f"Loss functions: {', '.join(_LOSSES)}.")
    groups = [cases] if joint else [[case] for case in cases]
    request = FitRequest(
        model=model,
        add=tuple(add or ()),
        drop=tuple(drop or ()),
        share=tuple(share or ()),
        per_case=tuple(per_case or ()),
        held=_fixed_values(fix or ()),
        loss=loss,
    )
    documents: list[dict[str, Any]] = []
    for group in groups:
        study = open_study(group, ledger, data=data, rotor=rotor, prior=prior, prior_rotor=prior_rotor)
        with out.progress("fitting") as progress:
            progress(0, None)
            own = shared.own_effects(effects, study.mechanism)
            found, fit_id = replace(request, own=own).fit(study, start)
            intervals = _intervals(found, profile or ())
            predicted = _predicted(found) if hold_out else None
            bias = curve_bias(found)
        documents.append(fit_document(found, fit_id, intervals, bias, predicted))
        out.show(*fit_tables(found, fit_id, intervals), *bias_tables(found, bias))
        out.show(*prediction_tables(predicted or ()))
        _note_unused_inputs(found, out)
    out.result(documents[0] if len(documents) == 1 else {"fits": documents})
    return NOT_TRUSTED if any(d["verdict"] == "not_converged" for d in documents) else DONE


def _note_unused_inputs(found: Fit, out: Output) -> None:
    """Print the option that adds each recorded input that no law of the model contains."""
    used = {name for e in found.model.effects for name, _ in e.inputs}
    recorded = {i.name for c in found.problem.data for i in c.record.inputs}
    site = found.model.mechanism.main
    for name in sorted(recorded - used):
        out.note(
            f"The model does not contain the recorded input {name}. If it is a drive, add it with "
            f"--add {site}.input.{name}."
        )


def _predicted(found: Fit) -> Sequence[Predicted]:
    from fitting.paper._scan import predict_recordings

    return predict_recordings(found.model, found.problem.data, found.noise)


def _intervals(found: Fit, wanted: Sequence[str]) -> dict[str, Interval]:
    from fitting.inference._profile import profile, weakly_determined

    names: list[str] = []
    for word in wanted:
        if word == "weak":
            names += weakly_determined(found)
            continue
        # a symbol, or a key without its case, selects all matching parameters
        keys = [k for k in found.problem.layout.names if word in {k, k.partition("@")[0], _symbol(k)}]
        names += keys or [word]
    return {name: profile(found, name) for name in dict.fromkeys(names)}


def _symbol(name: str) -> str:
    return name.partition("@")[0].rpartition(".")[2]


def _fixed_values(fix: Sequence[str]) -> dict[str, float]:
    """Parse assignments like ``bearing.power.g=0.7``."""
    held = {}
    for text in fix:
        name, equals, value = text.partition("=")
        try:
            held[name.strip()] = float(value)
        except ValueError:
            equals = ""
        if not equals:
            what = f"{text[:60]!r} is not an assignment to a parameter."
            raise UsageError(what, "Write it as --fix bearing.power.g=0.7.")
    return held


class BudgetDocument(TypedDict):
    """The uncertainty budget of a fit."""

    fit_id: str  #: Name of the fit in the ledger.
    parameters: dict[str, ParameterBudget]  #: Contributions, by the key of the parameter in a fit.


# smallest contribution to the variance in the table; the JSON document contains all contributions
_MIN_SHARE = 1e-3


def budget_command(
    cases: shared.CaseFiles,
    *,
    start: shared.From = None,
    clock_rate: Annotated[
        float | None,
        option(
            "--clock-rate U",
            "Relative standard uncertainty of the time base; by default 2.9e-5, the uncertainty of a quartz "
            "crystal.",
        ),
    ] = None,
    speed_scale: Annotated[
        float | None,
        option(
            "--speed-scale U",
            "Relative standard uncertainty of the scale of a sensor of angular velocity (from its data "
            "sheet).",
        ),
    ] = None,
    ledger: shared.LedgerFile = None,
    out: shared.Out,
) -> None:
    """Uncertainty budget of every parameter: contributions, type A or B, sensitivity, share (GUM).

    Inertias contribute if the case contains their uncertainties, for example `--inertia-rotor "5.54e-5 +- 0.06e-5"`.

    Example: gyrotrack budget case1.h5
    """
    from fitting.inference._budget import CRYSTAL, budget

    for name, u in (("--clock-rate", clock_rate), ("--speed-scale", speed_scale)):
        if u is not None and not 0 <= u < 1:
            raise UsageError(
                f"{name} {u:g} is not between 0 and 1.", "Give a relative uncertainty, for example 1e-4."
            )
    study = open_study(cases, ledger)
    with out.progress("fitting with other inertias") as progress:
        progress(0, None)
        fit, fit_id = study.base(start)
        found = budget(
            fit, clock_rate_u=CRYSTAL if clock_rate is None else clock_rate, speed_scale_u=speed_scale or 0.0
        )
    out.result(BudgetDocument(fit_id=fit_id, parameters=found))
    out.show(_budget_table(fit, found, fit_id))


def _budget_table(fit: Fit, found: Mapping[str, ParameterBudget], fit_id: str) -> str:
    from gyrotrack.apps.cli._parameters import in_words, key_beneath

    lines = [f"uncertainty budget of fit {fit_id} (combined standard uncertainties)"]
    for name, b in found.items():
        lines += [
            "",
            *key_beneath(f"{in_words(fit, name)}: {rounded(b.value, b.u, b.unit)}", fit.name(name).key),
        ]
        lines.append(f"  {'source':<32}{'type':<6}{'u':>10}{'sensitivity':>13}{'share':>9}")
        for c in b.contributions:
            if c.share >= _MIN_SHARE:
                slope = "" if c.sensitivity is None else f"{c.sensitivity:.3g}"
                lines.append(f"  {c.source:<32}{c.type:<6}{c.u:>10.2g}{slope:>13}{100 * c.share:>7.1f} %")
    return "\n".join(lines)


class ScanSettings(TypedDict):
    """The fitted data, and the written files."""

    data: str  #: Fitted quantity: `angle` or `velocity`.
    rotor: str  #: Rotor data: `windows` (measured) or `generated` (a curve).
    outputs: list[Path]  #: Files of `--csv` and `--latex`.


def scan_command(
    cases: shared.CaseFiles,
    *,
    csv: Annotated[Path | None, option("--csv FILE", "Also write all fits as one flat table.")] = None,
    latex: Annotated[
        Path | None, option("--latex FILE", "Also write the tables as LaTeX (booktabs).")
    ] = None,
    data: shared.DataKind = None,
    rotor: shared.RotorKind = "windows",
    force: shared.Force = False,
    out: shared.Out,
) -> int:
    """Fit every on/off combination of the paper's terms, and the paper's reduced and general models.

    For each case: five fits without one of the drag terms, and fifteen with all combinations of the bearing laws. For
    all cases: both models separately and jointly, their figures of merit, and the scatter of each parameter. The
    history of fits is not changed.

    Example: gyrotrack scan case1.h5 case2.h5 --latex tables.tex
    """
    from fitting.paper._scan import scan
    from fitting.paper._tables import scan_csv, scan_document, scan_latex, scan_lines
    from gyrotrack.io._atomic import new_file
    from gyrotrack.io._outputs import new_outputs

    reads = with_ledgers(cases)
    with new_outputs(csv, latex, force=force, reads=reads):
        pass
    targets = {path: make for path, make in ((csv, scan_csv), (latex, scan_latex)) if path is not None}
    read = read_cases(cases, data=data, rotor=rotor)
    with out.progress("fitting") as progress:
        found = scan(read, progress=progress)
    with new_outputs(*targets, force=force, reads=reads):
        for path, make in targets.items():
            with new_file(path, force=force) as stream:
                stream.write(make(found).encode("utf-8"))
    settings = ScanSettings(data=data or read[0].record.quantity, rotor=rotor, outputs=list(targets))
    out.result({**scan_document(found), **settings})
    out.show("\n".join(scan_lines(found)))
    for path in targets:
        out.show(f"written: {path}")
    return DONE if found.converged else NOT_TRUSTED


_CERTIFIED = 200  # default number of recordings of `certify`


def diagnose_command(
    cases: shared.CaseFiles,
    *,
    effects: shared.EffectsFile = None,
    friction: shared.Friction = False,
    prior: shared.PriorStudy = None,
    prior_rotor: shared.PriorRotor = None,
    start: shared.From = None,
    ledger: shared.LedgerFile = None,
    out: shared.VerboseOut,
) -> None:
    """Locate the lack of fit in time, speed and torque, and rank the effects that could be missing.

    Several cases are diagnosed jointly. Without an earlier fit the reduced model is fitted first. With -v every fit of
    the search is listed, with its purpose and its result.

    Example: gyrotrack diagnose case1.h5
    """
    from fitting.discovery._certificate import planned
    from fitting.discovery._verdict import diagnose
    from fitting.study._serialisation import diagnosis_document

    study = open_study(cases, ledger, prior=prior, prior_rotor=prior_rotor)
    with WorkerPool() as workers, out.progress("scoring effects") as progress:
        progress(0, None)
        # CPU time is measured, because a test uses workers in the same way as this search
        began = process_time()
        fit, fit_id = study.base(start)
        own = shared.own_effects(effects, study.mechanism, friction=friction)
        found = diagnose(fit, own, workers=workers)
        one = process_time() - began
        study.keep_diagnosis(fit_id, found, own)
    out.result(diagnosis_document(found, fit_id))
    out.show(*diagnosis_tables(found, fit_id))
    for refit in found.trace:
        out.detail(refit.sentence(found.fit.model.names))
    every = " ".join(str(c) for c in cases)
    out.note(
        f"`gyrotrack certify {every}` tests this answer on simulated recordings (about "
        f"{duration(one * len(planned(found, _CERTIFIED)))})."
    )


class ImprovedDocument(TypedDict):
    """The history of a search for missing effects."""

    ladder: list[StepDocument]  #: Fits of the search, oldest first.
    final: FitDocument  #: The last fit.
    verdict: str  #: `adequate`, `missing_effect` (found and added), `unexplained` or `undecided`.


def improve_command(
    cases: shared.CaseFiles,
    *,
    effects: shared.EffectsFile = None,
    prior: shared.PriorStudy = None,
    prior_rotor: shared.PriorRotor = None,
    start: shared.From = None,
    ledger: shared.LedgerFile = None,
    out: shared.Out,
) -> None:
    """Add effects one by one until the residuals are consistent with noise, and print the history of fits.

    Example: gyrotrack improve case1.h5
    """
    from fitting.discovery._select import improve
    from fitting.discovery._verdict import diagnose
    from fitting.study._serialisation import fit_document, history_verdict

    study = open_study(cases, ledger, prior=prior, prior_rotor=prior_rotor)
    with WorkerPool() as workers, out.progress("adding effects") as progress:
        progress(0, None)
        base, parent = study.base(start)
        own = shared.own_effects(effects, study.mechanism)
        kept = study.recorder(parent, base)
        history = improve(base, own, progress=progress, workers=workers, keep=kept)
        # the diagnosis is made here, because the report needs it and most of the work is already done
        found = diagnose(base, own, candidates=history[0].candidates, workers=workers)
        study.keep_diagnosis(parent, found, own)
    steps = [entry.document["rung"] for entry in kept.entries]
    # if the diagnosis is undecided, the addition of an effect does not establish this effect
    verdict = found.verdict if len(history) == 1 or found.verdict == "undecided" else history_verdict(history)
    said = _FAULT if len(history) == 1 and verdict == "missing_effect" else _VERDICTS[verdict]
    if history.stopped:
        out.warn(f"the search stopped: {history.stopped}")
    final: Any = fit_document(history[-1].fit, kept.entries[-1].fit_id)
    out.result(ImprovedDocument(ladder=steps, final=final, verdict=verdict))
    own_values = [k for k in history[-1].fit.problem.layout.per_case if k not in base.problem.layout.per_case]
    differing = f"; {' and '.join(own_values)} has a value for each recording" if own_values else ""
    out.show(*ladder_tables(steps, study.data[0].record), f"verdict: {said}{differing}")


_FAULT = "a fault of the measurement; no effect was added; run `gyrotrack diagnose`"
_VERDICTS = {
    "adequate": "the model is adequate; no effect was added",
    "missing_effect": "the missing effect was added; the residuals are consistent with noise",
    "unexplained": "an unexplained torque remains; run `gyrotrack diagnose`",
    "undecided": "nothing is established; run `gyrotrack diagnose`",
}


class LadderDocument(TypedDict):
    """The fits of some cases."""

    ladder: list[ListedStep]  #: Fits, oldest first.


def ladder_command(
    cases: shared.CaseFiles,
    *,
    data: shared.DataKind = None,
    rotor: shared.RotorKind = "windows",
    name: Annotated[str | None, option("--name ID=TEXT", "Name a fit: f2='quadratic drag'.")] = None,
    note: Annotated[str | None, option("--note ID=TEXT", "Write a note on a fit; empty removes it.")] = None,
    delete: Annotated[
        str | None, option("--delete ID", "Delete a fit on which no other fit is based.")
    ] = None,
    ledger: shared.LedgerFile = None,
    out: shared.Out,
) -> None:
    """List the fits of these cases: one bar per fit, each below the fit on which it is based.

    `gyrotrack fit --from ID --add EFFECT` begins a branch.

    Example: gyrotrack ladder case1.h5
    """
    from fitting._schema import ListedStep

    study = open_study(cases, ledger, data=data, rotor=rotor)
    if not study.ledger.of(study.data):
        raise DatasetError("There is no fit of these cases yet.", "Run `gyrotrack fit`.")
    for key, text in (("name", name), ("note", note)):
        if text is not None:
            fit_id, equals, content = text.partition("=")
            if not equals:
                what = f"--{key} {text[:40]} does not contain the name of a fit."
                raise UsageError(what, f"Write it as --{key} f2='text'.")
            found = study.entry(fit_id.strip())
            study.ledger.annotate(found.fit_id if found else fit_id, **{key: content})
    if delete is not None:
        found = study.entry(delete)
        study.ledger.delete(found.fit_id if found else delete)
        out.note(f"{delete} is deleted from {study.ledger.path}.")
    steps: list[Any] = [
        {**e.document["rung"], **{k: e.document.get(k, "") for k in ListedStep.__annotations__}}
        for e in study.ledger.of(study.data)
    ]
    out.result(LadderDocument(ladder=steps))
    out.show(*ladder_tables(steps, study.data[0].record))


class EffectParameter(TypedDict):
    """A parameter of an effect."""

    symbol: str  #: Symbol.
    unit: str  #: SI unit.
    role: str  #: Role in the law: `amplitude`, `shape`, `phase` or `fixed`.
    lower: float  #: Lower bound; null if there is none [`unit`].
    upper: float  #: Upper bound; null if there is none [`unit`].
    meaning: str  #: Meaning in words.


class EffectDocument(TypedDict):
    """An effect of the library, or of `--effects`."""

    name: str  #: Name.
    words: str  #: Name in words.
    symbol: str  #: Symbol of the strength.
    kind: str  #: `physical` or `measurement`.
    joint: str  #: Body, joint or camera on which the effect acts.
    law: str  #: Formula.
    latex: str  #: Formula in LaTeX.
    parameters: list[EffectParameter]  #: Parameters of the law.
    signature: str  #: Signature in the data.
    confused_with: list[str]  #: Names of similar effects.
    source: str  #: Publication in which the law is described.


class EffectsDocument(TypedDict):
    """All effects."""

    effects: list[EffectDocument]  #: The library, then the effects of `--effects`.


def effects_command(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="Effect to show in full.")] = None,
    *,
    effects: shared.EffectsFile = None,
    out: shared.Out,
) -> None:
    """Show the library of effects: formula, units, signature, similar effects.

    Example: gyrotrack effects casing.air.quadratic
    """
    from fitting.effects._library import LIBRARY, find

    own = {e.name: e for e in shared.own_effects(effects)}
    if name is not None:
        effect = own.get(name) or find(name)
        out.result(_effect_document(effect))
        out.show(_effect_text(effect))
        return
    every = [*LIBRARY.values(), *own.values()]
    out.result(EffectsDocument(effects=[_effect_document(e) for e in every]))
    out.show(
        "\n".join(
            f"{e.name:<27} {e.words or _where(e)}" + chr(10) + f"{'':<29}{_where(e)}: {e.law}" for e in every
        )
    )


def _effect_document(e: Effect) -> EffectDocument:
    from fitting._schema import as_document
    from fitting.effects._expression import latex
    from fitting.effects._words import effect_name

    return {
        "name": e.name,
        "words": effect_name(e.name, effects=[e]).words,
        "symbol": effect_name(e.name, effects=[e]).symbol,
        "kind": e.kind,
        "joint": e.joint,
        "law": e.law,
        "latex": latex(e.expression),
        "parameters": [as_document(EffectParameter, p) for p in e.parameters],
        "signature": e.signature,
        "confused_with": list(e.confused_with),
        "source": e.source,
    }


def _where(e: Effect) -> str:
    return {
        "factor": "bearing, factor",
        "inertia": "casing, factor",
        "camera.casing": "casing camera",
        "camera.rotor": "rotor camera",
    }.get(e.joint, e.joint)


def _effect_text(e: Effect) -> str:
    lines = [f"{e.name} ({e.kind})", *([f"  {e.words}"] if e.words else []), f"  {_where(e)}: {e.law}"]
    if e.state is not None:
        lines.append(f"  d({e.state.symbol})/dt = {e.state.rate}")
    lines += [f"  {p.symbol:<7}[{p.unit}]  {p.meaning}" for p in e.parameters]
    if e.signature:
        lines += textwrap.wrap(f"  signature: {e.signature}", 79, subsequent_indent="    ")
    if e.confused_with:
        lines.append(f"  similar to: {', '.join(e.confused_with)}")
    if e.source:
        lines.append(f"  source: {e.source}")
    return "\n".join(lines)
