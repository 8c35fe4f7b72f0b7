"""Laws of a search as a document, and as a TOML file of effects.

A law found by a search is an effect like any other, and is stored in a TOML file of effects: `fit --effects FILE.toml
--add NAME` adds it, and `diagnose --effects FILE.toml` tests it together with the library.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TypedDict

from fitting._errors import EffectError
from fitting._schema import (
    DifferenceBetweenRecordings,
    EstimateDocument,
    as_document,
    locked,
    refuse_special,
    write_text,
)
from fitting.discovery._dependence import Dependence
from fitting.effects._library import LIBRARY
from fitting.effects._user import read_effects
from fitting.inference._parameters import parameters_at
from fitting.law_search._laws import Difference, Law, Laws
from fitting.study._serialisation import shown_difference

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_.]{0,60}")
_AROUND = (0.5, 0.7, 1.0, 1.4, 2.0)
"""Trial values of a shape constant in a file of effects, divided by the fitted value [1]. Chosen: with fewer, a fit of
other data starts far from the optimum; with more, the search takes longer."""
_UNITS = {"t": "s", "psi_c": "rad"}


class TermDocument(TypedDict):
    """One term of a law."""

    body: str  #: Body or joint on which the term acts.
    law: str  #: Formula.
    rate: str  #: Rate of the internal state of the law as a formula; empty without a state.


class LawDocument(TypedDict):
    """A law that explains the unmodelled torque, and the evidence for it."""

    formula: str  #: Terms as `body: law`, joined by ` + `; `fit --add` accepts a single term.
    body: str  #: Body or joint on which the law acts; two names are joined by ` and `.
    form: str  #: The law in words.
    score: float  #: Decrease of the deviance when the law is added [1].
    delta_bic: float  #: BIC with the law minus BIC of the base model [1].
    description_length: float  #: Penalty of the length of the formula, added to BIC in the ranking [1].
    p_value: float  #: Probability of an equal or larger score in the whole search if no law is missing [1].
    torque_rms_Nm: float  #: Rms torque along the measured motion [torque].
    indistinguishable_from: list[str]  #: Formulas of other laws that the data cannot separate from this law.
    same_torque_as: list[str]  #: Formulas of other laws with the same torque along the recorded motion.
    terms: list[TermDocument]  #: Terms of the law, one or two.
    parameters: dict[str, EstimateDocument]  #: Parameters of the law, by key as in a fit.
    verdict: str  #: Verdict of the fit with this law.
    differences: list[Difference]  #: Largest difference from each other law of the answer.


class CurveDocument(TypedDict):
    """The unmodelled torque as a function of a variable."""

    unit: str  #: Unit of the variable.
    value: list[float]  #: Values of the variable [`unit`].
    torque_Nm: list[float]  #: The part of the torque that the base model cannot represent [torque].
    sigma_Nm: list[float]  #: Standard uncertainty of this part [torque].


class DependenceDocument(TypedDict):
    """The dependence of the unmodelled torque on one variable, or on two."""

    variable: str  #: Variable: `omega_c`, `t`, ...; a pair of variables is joined by `*`.
    body: str  #: Body, or `bearing`.
    #: Probability of an equal or more significant dependence on any tested variable if there is no dependence [1].
    p_value: float
    explained: float  #: Share of the lack of fit that the dependence explains, 0 to 1 [1].
    score: float  #: Decrease of the deviance [1].
    curve: CurveDocument | None  #: The dependence as a curve; null for two variables.


class LawsDocument(TypedDict):
    """Laws that explain the unmodelled torque of a fit."""

    fit_id: str  #: Name of the base fit in the ledger.
    #: `law`, `library` (an effect of the library suffices), `parameter` (see `differs`) or `none`.
    verdict: str
    sentence: str  #: The answer in words.
    next_experiment: str  #: The run that separates the laws, in words; empty for one law.
    trials: int  #: Number of scored candidates.
    laws: list[LawDocument]  #: Laws, best first.
    library: str | None  #: Name of the effect of the library that describes the data as well as the laws.
    #: A parameter whose separate values in the cases describe the data as well as the laws; null if there is none.
    differs: DifferenceBetweenRecordings | None
    depends_on: list[DependenceDocument]  #: Dependence on each variable, the largest explained share first.


def laws_document(found: Laws, fit_id: str) -> LawsDocument:
    """Return laws under the keys of `laws --json`; `fit_id` is the base model in the ledger."""
    return as_document(
        LawsDocument,
        found,
        fit_id=fit_id,
        laws=[_law(x) for x in found.laws],
        library=found.library.effect.name if found.library is not None else None,
        differs=shown_difference(found.differs),
        depends_on=[as_document(DependenceDocument, d, curve=_curve(d)) for d in found.depends_on],
    )


def _curve(d: Dependence) -> CurveDocument | None:
    """Return the unmodelled torque as a function of a variable."""
    if not len(d.value):
        return None
    columns = {"value": d.value, "torque_Nm": d.torque, "sigma_Nm": d.sigma}
    unit = _UNITS.get(d.variable, "rad/s")
    return as_document(CurveDocument, d, unit=unit, **{k: v.tolist() for k, v in columns.items()})


def _law(x: Law) -> LawDocument:
    """Return a law and the evidence for it, with the largest difference from each other law of its set."""
    return as_document(
        LawDocument,
        x,
        terms=[{"body": e.joint, "law": e.law, "rate": e.state.rate if e.state else ""} for e in x.effects],
        parameters={k: EstimateDocument.model_validate(e).model_dump() for k, e in x.estimates.items()},
        verdict=x.fit.verdict,
        differences=[asdict(d) for d in x.differences],
    )


def check_name(name: str, path: Path, terms: int = 1) -> None:
    """Raise an EffectError if a law of one or two terms cannot be added to a file of effects under this name.

    There are three possible reasons: the name is malformed, the name is in use in the library or in the file, or the
    file does not contain effects. A second term is called ``NAME.second``.
    """
    if not _NAME.fullmatch(name):
        raise EffectError(
            f"{name[:60]!r} is not a valid name of an effect",
            "a name has letters, digits, dots and underscores, and starts with a letter",
        )
    refuse_special(path)
    taken = {*LIBRARY, *(e.name for e in read_effects(path))} if path.exists() else set(LIBRARY)
    for wanted in _names(name, terms):
        if wanted in taken:
            where = "the library" if wanted in LIBRARY else str(path)
            raise EffectError(f"{where} has an effect named {wanted!r} already", "choose another name")


def _names(name: str, terms: int) -> list[str]:
    return [name, f"{name}.second"][:terms]


def save_law(law: Law, name: str, path: Path, source: str) -> None:
    """Add a law to a TOML file of effects, which is created if necessary; `source` states where the law was found.

    Raise the errors of `check_name`, and a LedgerError if the file cannot be written.
    """
    with locked(path):
        check_name(name, path, len(law.effects))
        before = path.read_text(encoding="utf-8").rstrip() + "\n\n" if path.exists() else ""
        write_text(path, before + "\n".join(_tables(law, _names(name, len(law.effects)), source)) + "\n")


def _tables(law: Law, names: Sequence[str], source: str) -> list[str]:
    lines: list[str] = []
    records = law.fit.problem.layout.records
    for effect, name in zip(law.effects, names, strict=True):
        lines += [*([""] if lines else []), "[[effect]]", f"name = {json.dumps(name)}"]
        lines += [f'body = "{effect.joint}"', f"law = {json.dumps(effect.law)}"]
        lines += [f"rate = {json.dumps(effect.state.rate)}"] if effect.state else []
        lines += [f"signature = {json.dumps(law.form)}", f"source = {json.dumps(source)}"]
        lines += ["per_case = true"] if effect.per_case else []
        for key, p in parameters_at([effect], records).items():
            value = next((e.value for k, e in law.estimates.items() if k.partition("@")[0] == key), p.start)
            lines += ["", f"[effect.parameters.{p.symbol}]", f"unit = {json.dumps(p.unit)}"]
            lines += [f"start = {value!r}"]
            for bound, limit in (("lower", p.lower), ("upper", p.upper)):
                lines += [f"{bound} = {limit!r}"] if math.isfinite(limit) and p.role == "shape" else []
            if p.role == "shape":
                grid = [float(f"{value * q:.6g}") for q in _AROUND if p.lower <= value * q <= p.upper]
                lines += [f"grid = {grid!r}", "shape = true"]
            lines += [f"meaning = {json.dumps(p.meaning)}"] if p.meaning else []
    return lines
