"""The record of a search: every fit that it made, with its purpose and its result or the reason of its failure.

`recording` collects the fits of a call of `diagnose` or `improve`, including the fits of nested calls and of workers.
`fit` adds an entry for each result, and `attempt` adds an entry for each failure:

    with recording() as trace:
        with attempt("a refit with a free exponent"):
            fit(model, data)
    trace.refits    # one entry: fitted, or failed and why

Entries belong to the context of the call, so searches in several threads do not mix.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

from fitting._errors import FittingError
from fitting._workers import WorkerPool
from fitting.dynamics._model import Model

T = TypeVar("T")
Common = TypeVar("Common")
Item = TypeVar("Item")


@dataclass(frozen=True)
class Refit:
    """A fit that a search made.

    Attributes
    ----------
    purpose : str
        Why the fit was made.
    effects : tuple of str
        The effects of its model.
    deviance : float
        -2 log L of the result; nan if the fit failed.
    bic : float
        BIC of the result; nan if the fit failed.
    converged : bool
        Whether the minimum was reached.
    failure : str
        Why there is no result; empty if there is one.
    """

    purpose: str
    effects: tuple[str, ...]
    deviance: float = math.nan
    bic: float = math.nan
    converged: bool = False
    failure: str = ""

    def sentence(self, base: Sequence[str] = ()) -> str:
        """Return the entry in one line, the model as its difference from the effects `base`."""
        changes = [f"+{e}" for e in self.effects if e not in base]
        changes += [f"-{e}" for e in base if e not in self.effects]
        if self.failure:
            result = f"failed: {self.failure}"
        else:
            result = f"deviance {self.deviance:.1f}, BIC {self.bic:.1f}"
            result += "" if self.converged else ", not converged"
        return f"{self.purpose} ({' '.join(changes) or 'same model'}): {result}"


class _Result(Protocol):
    @property
    def deviance(self) -> float: ...
    @property
    def bic(self) -> float: ...
    @property
    def converged(self) -> bool: ...


@dataclass
class Trace:
    """Refits in the order in which they ended."""

    refits: list[Refit] = field(default_factory=list)
    fault: FittingError | None = None  # the last failure for which an entry exists


_TRACE: ContextVar[Trace | None] = ContextVar("trace", default=None)
_PURPOSE: ContextVar[str] = ContextVar("purpose", default="a fit")
_MODEL: ContextVar[Model | None] = ContextVar("model", default=None)


@contextmanager
def recording(*, passed_on: bool = True) -> Iterator[Trace]:
    """Collect the fits of this block; if they are `passed_on`, an outer block collects them as well."""
    outer, trace = _TRACE.get(), Trace()
    token = _TRACE.set(trace)
    try:
        yield trace
    finally:
        _TRACE.reset(token)
        if outer is not None and passed_on:
            outer.refits += trace.refits


def record(refits: Sequence[Refit]) -> None:
    """Add entries to the current search, if there is one."""
    trace = _TRACE.get()
    if trace is not None:
        trace.refits += refits


def record_result(found: _Result) -> None:
    """Add the result of the fit of this block (`of_model`)."""
    if _TRACE.get() is not None:
        record([Refit(_PURPOSE.get(), _effects(), found.deviance, found.bic, found.converged)])


def _effects() -> tuple[str, ...]:
    model = _MODEL.get()
    return () if model is None else tuple(model.names)


def _record_failure(fault: FittingError) -> None:
    """Add a failure, unless it has an entry already."""
    trace = _TRACE.get()
    if trace is not None and trace.fault is not fault:
        trace.fault = fault
        record([Refit(_PURPOSE.get(), _effects(), failure=fault.message)])


@contextmanager
def of_model(model: Model) -> Iterator[None]:
    """State the model that this block fits, and record its failure."""
    token = _MODEL.set(model)
    try:
        yield
    except FittingError as fault:
        _record_failure(fault)
        raise
    finally:
        _MODEL.reset(token)


@contextmanager
def with_purpose(purpose: str) -> Iterator[None]:
    """State why the fits of this block are made; a failure still raises its error."""
    token = _PURPOSE.set(purpose)
    try:
        yield
    finally:
        _PURPOSE.reset(token)


@contextmanager
def attempt(purpose: str, kind: type[FittingError] = FittingError) -> Iterator[None]:
    """State why the fits of this block are made; an error of this kind ends the block and is recorded."""
    with with_purpose(purpose):
        try:
            yield
        except kind as fault:
            _record_failure(fault)


def recorded_map(
    workers: WorkerPool,
    work: Callable[[Common, Item], T],
    common: Common,
    items: Sequence[Item],
    shared: Callable[[Common], Sequence[object]],
) -> list[T]:
    """Return ``workers.map(work, common, items, shared)``, recording the fits of all processes in order."""
    found = workers.map(_recorded, common, [(work, item) for item in items], shared)
    for _, refits in found:
        record(refits)
    return [result for result, _ in found]


def _recorded(common: Any, job: tuple[Callable[[Any, Any], T], Any]) -> tuple[T, list[Refit]]:
    work, item = job
    with recording(passed_on=False) as trace:
        return work(common, item), trace.refits
