"""Friction models of two spinning bodies: fit them, test them, find the missing effect.

>>> from fitting import Model, fit, load  # doctest: +SKIP
>>> result = fit(Model.of("reduced"), load("case1.h5"))  # doctest: +SKIP

Public names are imported on first use; ``import fitting`` alone imports nothing else.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fitting._api import fit, load
    from fitting._criteria import Criteria
    from fitting._errors import (
        EffectError,
        EstimationError,
        ExpressionError,
        FittingError,
        LedgerError,
        RecordError,
        SimulationError,
    )
    from fitting.discovery._laws import laws
    from fitting.discovery._plan import plan
    from fitting.discovery._select import Candidate, improve
    from fitting.discovery._verdict import Diagnosis, diagnose
    from fitting.dynamics._model import Model
    from fitting.effects._effect import Effect, Parameter
    from fitting.effects._library import GENERAL, LIBRARY, LINEAR, REDUCED
    from fitting.effects._user import read_effects
    from fitting.effects._user import resolve as effect
    from fitting.inference._budget import budget
    from fitting.inference._cross_validation import predict_recordings
    from fitting.inference._profile import profile as profile_interval
    from fitting.inference._record import Record, make_record
    from fitting.inference._result import Estimate, Fit
    from fitting.inference._simulation import Experiment, simulate
    from fitting.study._comparison import compare
    from fitting.study._history import Ledger
    from fitting.study._scan import Scan, scan
    from fitting.study._scan_tables import scan_lines
    from fitting.study._serialisation import load_fit

_MODULES = {
    "fitting._api": ("fit", "load"),
    "fitting._errors": (
        "EffectError",
        "EstimationError",
        "ExpressionError",
        "FittingError",
        "LedgerError",
        "RecordError",
        "SimulationError",
    ),
    "fitting._criteria": ("Criteria",),
    "fitting.discovery._laws": ("laws",),
    "fitting.discovery._plan": ("plan",),
    "fitting.discovery._select": ("Candidate", "improve"),
    "fitting.discovery._verdict": ("Diagnosis", "diagnose"),
    "fitting.dynamics._model": ("Model",),
    "fitting.effects._effect": ("Effect", "Parameter"),
    "fitting.effects._library": ("GENERAL", "LIBRARY", "LINEAR", "REDUCED"),
    "fitting.effects._user": ("effect", "read_effects"),
    "fitting.inference._budget": ("budget",),
    "fitting.inference._cross_validation": ("predict_recordings",),
    "fitting.inference._profile": ("profile_interval",),
    "fitting.inference._record": ("Record", "make_record"),
    "fitting.inference._result": ("Estimate", "Fit"),
    "fitting.inference._simulation": ("Experiment", "simulate"),
    "fitting.study._comparison": ("compare",),
    "fitting.study._history": ("Ledger",),
    "fitting.study._scan": ("Scan", "scan"),
    "fitting.study._scan_tables": ("scan_lines",),
    "fitting.study._serialisation": ("load_fit",),
}
_ALIASES = {"effect": "resolve", "profile_interval": "profile"}
_PLACES = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [
    "GENERAL",
    "LIBRARY",
    "LINEAR",
    "REDUCED",
    "Candidate",
    "Criteria",
    "Diagnosis",
    "Effect",
    "EffectError",
    "Estimate",
    "EstimationError",
    "Experiment",
    "ExpressionError",
    "Fit",
    "FittingError",
    "Ledger",
    "LedgerError",
    "Model",
    "Parameter",
    "Record",
    "RecordError",
    "Scan",
    "SimulationError",
    "budget",
    "compare",
    "diagnose",
    "effect",
    "fit",
    "improve",
    "laws",
    "load",
    "load_fit",
    "make_record",
    "plan",
    "predict_recordings",
    "profile_interval",
    "read_effects",
    "scan",
    "scan_lines",
    "simulate",
]


def __getattr__(name: str) -> Any:
    """Import a public name where it is first used."""
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_PLACES[name]), _ALIASES.get(name, name))
    return value


def __dir__() -> list[str]:
    """Return the public names, imported or not."""
    return sorted({*globals(), *__all__})
