"""Friction models of a two-body gyroscope: fit them, see where they fail, learn what is missing.

>>> from fitting import Model, fit, load  # doctest: +SKIP
>>> result = fit(Model.of("reduced"), load("case1.h5"))  # doctest: +SKIP

The names below are imported when they are first asked for; ``import fitting`` alone costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fitting.discovery import diagnose as diagnose
    from fitting.discovery import improve as improve
    from fitting.effects import resolve as effect
    from fitting.estimation.asked import fit as fit
    from fitting.loading import load as load
    from fitting.model import Model as Model
    from fitting.record import make_record as make_record
    from fitting.saving import load_fit as load_fit
    from fitting.scanning import scan as scan

_PLACES = {
    "Model": ("fitting.model", "Model"),
    "diagnose": ("fitting.discovery", "diagnose"),
    "effect": ("fitting.effects", "resolve"),
    "fit": ("fitting.estimation.asked", "fit"),
    "improve": ("fitting.discovery", "improve"),
    "load": ("fitting.loading", "load"),
    "load_fit": ("fitting.saving", "load_fit"),
    "make_record": ("fitting.record", "make_record"),
    "scan": ("fitting.scanning", "scan"),
}

__all__ = ["Model", "diagnose", "effect", "fit", "improve", "load", "load_fit", "make_record", "scan"]


def __getattr__(name: str) -> Any:
    """Import a public name where it is first used."""
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, attribute = _PLACES[name]
    value = globals()[name] = getattr(import_module(module), attribute)
    return value


def __dir__() -> list[str]:
    """Return the public names, imported or not."""
    return sorted({*globals(), *__all__})
