"""Effects that users write: a formula on the command line, or several in a TOML file."""

from __future__ import annotations

import re
import string
import tomllib
from pathlib import Path
from typing import Any

from fitting.effects.effect import Effect
from fitting.effects.formula import formula
from fitting.effects.library import LIBRARY, find
from fitting.errors import EffectError, ExpressionError, FittingError
from fitting.expression.dimension import parse_unit

_NAME = re.compile(r"^[A-Za-z][A-Za-z0-9_.]{0,60}$")
_PARAMETER_KEYS = {"unit", "lower", "upper", "start", "grid", "meaning", "shape"}
_EFFECT_KEYS = {"name", "body", "law", "parameters", "signature", "source"}


def resolve(text: str) -> Effect:
    """Return an effect from its name in the library or from a formula ``body: law``.

    Parameters
    ----------
    text : str
        Such as ``casing.air.quadratic`` or ``casing: -k*omega_c**3``. Names in the law that are no
        variables are parameters; those in which the law is linear start from a regression.

    Raises
    ------
    EffectError, ExpressionError
        With what is not understood.
    """
    body, colon, law = text.partition(":")
    if not colon:
        return find(text.strip())
    return formula(text.strip(), body.strip(), law.strip(), {})


def read_effects(path: Path) -> list[Effect]:
    """Read effects from a TOML file with one ``[[effect]]`` table an effect.

    Each has ``name``, ``body``, ``law`` and, if wished, ``signature``, ``source`` and
    ``[effect.parameters.k]`` tables with ``unit``, ``lower``, ``upper``, ``start``, ``grid``, ``meaning``,
    and ``shape = true`` for a parameter that is not to be taken as the law's strength.

    Raises
    ------
    EffectError
        If the file cannot be read or a key is unknown or missing; the key is named.
    """
    try:
        with path.open("rb") as file:
            document = tomllib.load(file)
    except OSError as fault:
        raise EffectError(f"{path}: {fault.strerror or fault}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as fault:
        raise EffectError(f"{path} is not a TOML file: {fault}") from None
    tables = document.get("effect")
    if not isinstance(tables, list) or not tables:
        raise EffectError(f"{path} has no [[effect]] table", "see `gyrotrack effects --help`")
    effects = [_from_table(path, i, table) for i, table in enumerate(tables, 1)]
    names = [e.name for e in effects]
    for name in names:
        if names.count(name) > 1 or name in LIBRARY:
            raise EffectError(f"{path}: there is another effect named {name!r}", "give it a name of its own")
    return effects


def _from_table(path: Path, number: int, table: Any) -> Effect:
    where = f"{path}, effect {number}"
    if not isinstance(table, dict):
        raise EffectError(f"{where} is not a table")
    unknown = set(table) - _EFFECT_KEYS
    missing = {"name", "body", "law"} - set(table)
    if unknown or missing:
        wrong = f"unknown key {sorted(unknown)[0]!r}" if unknown else f"missing key {sorted(missing)[0]!r}"
        raise EffectError(f"{where}: {wrong}", "keys: " + ", ".join(sorted(_EFFECT_KEYS)))
    for key in ("name", "body", "law", "signature", "source"):
        if not isinstance(table.get(key, ""), str):
            raise EffectError(f"{where}: {key} must be text")
    if not _NAME.match(table["name"]):
        raise EffectError(
            f"{where}: a name has letters, digits, dots and underscores, and starts with a letter"
        )
    declared = table.get("parameters", {})
    if not isinstance(declared, dict):
        raise EffectError(f"{where}: parameters must be a table", "write [effect.parameters.k]")
    for symbol, keys in declared.items():
        _check_keys(f"{where}, parameter {symbol}", keys)
    words = {k: table[k] for k in ("signature", "source") if k in table}
    try:
        return formula(table["name"], table["body"], table["law"], declared, **words)
    except FittingError as fault:
        raise EffectError(f"{where}: {fault.message}", fault.hint) from None


def _check_keys(where: str, keys: Any) -> None:
    if not isinstance(keys, dict):
        raise EffectError(f"{where} must be a table", "write [effect.parameters.k]")
    unknown = sorted(set(keys) - _PARAMETER_KEYS)
    if unknown:
        raise EffectError(
            f"{where}: unknown key {unknown[0]!r}", "keys: " + ", ".join(sorted(_PARAMETER_KEYS))
        )
    for key, kind, word in (
        ("unit", str, "text"),
        ("meaning", str, "text"),
        ("grid", list, "a list"),
        ("shape", bool, "true or false"),
    ):
        if not isinstance(keys.get(key, kind()), kind):
            raise EffectError(f"{where}: {key} must be {word}")
    try:
        parse_unit(keys.get("unit", "1"), dict.fromkeys(string.ascii_lowercase, 1.0))
    except ExpressionError as fault:
        raise EffectError(f"{where}: {fault.message}", fault.hint) from None
