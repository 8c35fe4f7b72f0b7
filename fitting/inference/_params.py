"""Parameters of a fit as lmfit shows them: a mapping by name, with short names, and a report with correlations.

M. Newville et al., lmfit, doi:10.5281/zenodo.11813. A mapping of parameters is immutable: `Params.set` returns a new
mapping, which can be passed to the next fit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Protocol

import numpy as np

from fitting._arguments import TEXT, require
from fitting._errors import EffectError, EstimationError, FittingError
from fitting._numbers import rounded
from fitting.dynamics._model import Model
from fitting.inference._case import inward, outward
from fitting.inference._metrics import CaseMetrics
from fitting.inference._record import Record
from fitting.inference._ties import find_key

_SCREEN = 20
"""Largest number of lines of a repr [lines]. Chosen: one screen of a console; a smaller value hides parameters, a
larger one scrolls."""
LEAST_CORRELATION = 0.1
"""Smallest correlation in a report [1]. Source: lmfit, whose report has the same default."""
# settings that a user may change for a parameter
SETTINGS = ("value", "vary", "min", "max", "expr")


@dataclass(frozen=True)
class Estimate:
    """A fitted number.

    Attributes
    ----------
    value, stderr : float
        Value and standard uncertainty, in `unit`; the uncertainty is NaN at a bound.
    unit : str
        SI unit.
    at_bound : bool
        Whether a bound is active.
    vary : bool
        Whether the number was fitted (and not held).
    min, max : float
        Bounds of the fit, in `unit`.
    expr : str or None
        The expression of other parameters that determines the number; None if it is independent.
    """

    value: float
    stderr: float
    unit: str
    at_bound: bool
    vary: bool = True
    min: float = -math.inf
    max: float = math.inf
    expr: str | None = None


class Params(Mapping[str, Estimate]):
    """Parameters by name; the end of a name suffices if it is unique: ``params["b2"]``.

    Each has `value`, `stderr`, `unit`, `vary`, `min`, `max` and `expr`.

    Parameters
    ----------
    estimates : mapping of str to Estimate
        The parameters.
    changed : frozenset of str
        Names of the parameters that `set` changed.
    """

    def __init__(self, estimates: Mapping[str, Estimate], changed: frozenset[str] = frozenset()) -> None:
        self._estimates = dict(estimates)
        self.changed = changed

    def __getitem__(self, name: str) -> Estimate:
        """Return a parameter; an EffectError lists the names if no parameter, or several, have this name."""
        return self._estimates[self.full_name(name)]

    def __contains__(self, name: object) -> bool:
        try:
            return isinstance(name, str) and self.full_name(name) in self._estimates
        except FittingError:
            return False

    def __iter__(self) -> Iterator[str]:
        return iter(self._estimates)

    def __len__(self) -> int:
        return len(self._estimates)

    def full_name(self, name: str) -> str:
        """Return the full name of a parameter.

        Parameters
        ----------
        name : str
            The name, or an end of the name that only one parameter has.

        Raises
        ------
        EffectError
            If no parameter, or several, have it.
        """
        require("name", name, TEXT)
        return find_key(name, self._estimates)

    def set(self, name: str, **settings: Any) -> Params:
        """Return the parameters with one parameter changed, for `fitting.fit(model, case, params=...)`.

        Parameters
        ----------
        name : str
            Name of the changed parameter.
        **settings
            ``value``, the initial value, or the held value if ``vary=False``; ``vary``; ``min`` and ``max`` [SI]; and
            ``expr``, an expression of other parameters that determines the parameter (None: the parameter is fitted).

        Raises
        ------
        EffectError
            If there is no such parameter.
        EstimationError
            If a setting is unknown or has a wrong type.
        """
        require("name", name, TEXT)
        key = self.full_name(name)
        refuse_settings(key, settings)
        changed = replace(self._estimates[key], **settings)
        if settings.get("expr") is not None:
            changed = replace(changed, vary=False)
        elif "expr" in settings and "vary" not in settings:
            changed = replace(changed, vary=True)
        return Params(self._estimates | {key: changed}, self.changed | {key})

    def valuesdict(self) -> dict[str, float]:
        """Return the values by name."""
        return {name: e.value for name, e in self._estimates.items()}

    def __repr__(self) -> str:
        lines = [f"{len(self)} parameters"]
        for name, e in self._estimates.items():
            lines.append(f"  {name}: {rounded(e.value, e.stderr, e.unit)}{note(e)}")
        if len(lines) > _SCREEN:
            lines = [*lines[: _SCREEN - 1], f"  ... {len(lines) - _SCREEN + 1} more"]
        return "\n".join(lines)


def note(e: Estimate) -> str:
    """Return the remark in brackets on a parameter that is tied, held or at its bound.

    Empty for any other parameter.
    """
    if e.expr is not None:
        return f" (= {e.expr})"
    if not e.vary:
        return " (held)"
    return " (at its bound)" if e.at_bound else ""


def refuse_settings(name: str, settings: Mapping[str, Any]) -> None:
    """Raise an EstimationError for a setting of a parameter that is unknown or has a wrong type."""
    for key, value in settings.items():
        if key not in SETTINGS:
            raise EstimationError(
                f"a parameter has no setting {str(key)[:30]!r}", "settings: " + ", ".join(SETTINGS)
            )
        kind: Any = bool if key == "vary" else str if key == "expr" else int | float | np.number
        right = value is None if key == "expr" and value is None else isinstance(value, kind)
        if not right or (key != "vary" and isinstance(value, bool)):
            raise EstimationError(
                f"{key} of {name} is {str(value)[:30]!r}",
                f"give {'True or False' if key == 'vary' else 'an expression' if key == 'expr' else 'a number'}",
            )
        if key == "value" and not math.isfinite(value):
            raise EstimationError(f"the value of {name} is {value}", "give a finite number, in SI units")


@dataclass(frozen=True)
class Settings:
    """Fixed values, initial values, ranges and ties of parameters, by the names of the library."""

    fixed: dict[str, float] = field(default_factory=dict)
    start: dict[str, float] = field(default_factory=dict)
    ranges: dict[str, tuple[float, float]] = field(default_factory=dict)
    ties: dict[str, str] = field(default_factory=dict)

    def joined(self, other: Settings) -> Settings:
        """Return the combined settings; the settings of `other` take precedence."""
        return Settings(*(getattr(self, f.name) | getattr(other, f.name) for f in fields(self)))


def settings_of(params: Any, model: Model, records: Sequence[Record]) -> Settings:
    """Return the settings of parameters of a model: from an earlier fit, or a mapping of names to settings.

    Raises an EstimationError or EffectError for anything else, or for an unknown name.
    """
    if params is None:
        return Settings()
    if not isinstance(params, Mapping):
        raise EstimationError(
            f"params is a {type(params).__name__}",
            'use the params of an earlier fit, or a mapping: {"k": {"value": 0.7, "vary": False}}',
        )
    found = Settings()
    names = Names.of(model, records)
    for name, given in params.items():
        entries = given
        if not isinstance(given, Mapping):
            entries = _of_estimate(given, changed=not isinstance(params, Params) or name in params.changed)
        if entries is None:
            raise EstimationError(
                f"the settings of {str(name)[:40]} are a {type(given).__name__}",
                'write {"value": 0.7, "vary": False}',
            )
        if not isinstance(given, Mapping) and names.missing(name):
            continue  # a parameter of the earlier fit that the new model does not have
        refuse_settings(str(name), entries)
        _add(found, names(name), entries)
    return found


def _of_estimate(given: Any, *, changed: bool) -> dict[str, Any] | None:
    if not hasattr(given, "value") or not hasattr(given, "expr"):
        return None
    entries: dict[str, Any] = {"value": given.value, "expr": given.expr}
    if given.expr is None and not given.vary:
        entries["vary"] = False
    if changed:
        entries |= {"min": given.min, "max": given.max}
    return entries


def _add(found: Settings, key: str, entries: Mapping[str, Any]) -> None:
    if entries.get("expr") is not None:
        found.ties[key] = entries["expr"]
        return
    value = entries.get("value")
    if entries.get("vary") is False:
        if value is None:
            raise EstimationError(f"{key} is held without a value", 'write {"value": 0.7, "vary": False}')
        found.fixed[key] = float(value)
        return
    if value is not None:
        found.start[key] = float(value)
    low, high = (float(entries.get(k, s * math.inf)) for k, s in (("min", -1), ("max", 1)))
    if not low <= high:
        raise EstimationError(f"the range of {key} is {low:g} to {high:g}", "min must not exceed max")
    if math.isfinite(low) or math.isfinite(high):
        found.ranges[key] = (low, high)


@dataclass(frozen=True)
class Names:
    """Names of the parameters of a model as a user writes them: short, or with the name of the body."""

    keys: tuple[str, ...]
    body: str

    @classmethod
    def of(cls, model: Model, records: Sequence[Record]) -> Names:
        """Return the names of a model of some records."""
        body = records[0].name if records else ""
        starts = ("initial.omega_c", "initial.omega_r", "initial.deflection")
        own = [f"{s}@{r.label}" for r in records for s in starts]
        per_case = [f"{k}@{r.label}" for r in records for k in model.free] if len(records) > 1 else []
        return cls((*model.free, *model.constants, *own, *per_case), body)

    def __call__(self, name: str) -> str:
        """Return the key of a parameter; an EffectError if there is none."""
        if not isinstance(name, str):
            raise EffectError(f"a {type(name).__name__} is not the name of a parameter", "use a string")
        key = inward(name, self.body)
        if key.startswith("initial.") and "@" not in key:
            found = [k for k in self.keys if k.partition("@")[0] == key]
            if len(found) == 1:
                return found[0]
        if key in self.keys:
            return key
        # a name that contains a label of a case is not the end of another name
        return find_key(key, [k for k in self.keys if "@" not in k] if "@" not in key else self.keys)

    def missing(self, name: str) -> bool:
        """Return whether the model has no such parameter."""
        try:
            self(name)
        except EffectError:
            return True
        return False

    def tie(self, text: str) -> str:
        """Return an expression with the parameter names of the library instead of names with the name of the body."""
        if not self.body or not isinstance(text, str):
            return text
        for key in sorted(self.keys, key=len, reverse=True):
            text = text.replace(outward(key, self.body), key)
        return text


def shown_name(key: str, body: str, cases: int) -> str:
    """Return the name of a parameter of a fit for a user, without the label of the case if there is only one case."""
    return outward(key.partition("@")[0] if cases == 1 else key, body)


class Reported(Protocol):
    """The attributes of a `Fit` that its report shows."""

    @property
    def params(self) -> Params: ...
    @property
    def cases(self) -> tuple[CaseMetrics, ...]: ...
    @property
    def verdict(self) -> str: ...
    @property
    def shown_model(self) -> str: ...
    @property
    def samples(self) -> int: ...
    @property
    def n_eff(self) -> float: ...
    @property
    def chi2(self) -> float: ...
    @property
    def aic(self) -> float: ...
    @property
    def bic(self) -> float: ...
    def correlations(self) -> list[tuple[str, str, float]]: ...


def report(fit: Reported, least_correlation: float = LEAST_CORRELATION) -> str:
    """Return model, figures of merit, parameters and correlations as text, in the form of lmfit."""
    params = fit.params
    free = [n for n, e in params.items() if e.vary]
    values = [
        ("verdict", fit.verdict),
        ("data points", f"{fit.samples}"),
        ("effective samples", f"{fit.n_eff:.0f}"),
        ("variables", f"{len(free)}"),
        ("chi-square", f"{fit.chi2:.6g}"),
        ("reduced chi-square", ", ".join(f"{c.casing.reduced_chi2:.4g}" for c in fit.cases)),
        ("R-squared", ", ".join(f"{c.casing.r2:.6f}" for c in fit.cases)),
        ("Akaike info crit", f"{fit.aic:.4f}"),
        ("Bayesian info crit", f"{fit.bic:.4f}"),
    ]
    lines = ["[[Model]]", f"    {fit.shown_model}", "[[Fit Statistics]]"]
    lines += [f"    {name:<20} = {value}" for name, value in values]
    lines.append("[[Variables]]")
    width = max(map(len, params), default=0) + 1
    for name, e in params.items():
        share = f" ({100 * e.stderr / abs(e.value):.2f}%)" if math.isfinite(e.stderr) and e.value else ""
        lines.append(f"    {name + ':':<{width}} {rounded(e.value, e.stderr, e.unit)}{share}{note(e)}")
    pairs = [p for p in fit.correlations() if abs(p[2]) >= least_correlation]
    if pairs:
        lines.append(f"[[Correlations]] (unreported correlations are < {least_correlation:.3f})")
        wide = max(len(f"{a}, {b}") for a, b, _ in pairs)
        lines += [f"    C({f'{a}, {b}':<{wide}}) = {c:+.4f}" for a, b, c in pairs]
    return "\n".join(lines)
