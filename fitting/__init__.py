"""Friction models of two spinning bodies: fit them, test them, find the missing effect.

>>> from fitting import Case, fit  # doctest: +SKIP
>>> result = fit("reduced", Case.load("case1.h5"))  # doctest: +SKIP

Public names, listed in ``__init__.pyi``, are imported on first use; ``import fitting`` alone imports nothing else.
"""

from typing import Any

import lazy_loader

_attribute, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """Import a public name where it is first used."""
    value = _attribute(name)
    if name in __all__:
        from fitting._arguments import PUBLIC, checked, of_function

        if name in PUBLIC:
            value = globals()[name] = checked(value, name, of_function(name))
    return value
