"""Write docs/reference/json.md from the documents that the commands print: `python docs/make_json.py`."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import re
import sys
import types
import typing
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np
from pydantic import BaseModel

from fitting._case_format import CASE_ATTRIBUTES, INPUT, Attribute, is_nan
from fitting._numbers import unit_text
from gyrotrack.apps.cli._app import COMMANDS
from gyrotrack.io._schema import RECORDING_ATTRIBUTES

TARGET = Path(__file__).parent / "reference" / "json.md"

_MODULES = """fitting._schema fitting._settings fitting.discovery._oscillator fitting.inference._budget
fitting.comparison._comparison fitting.law_search._documents fitting.planning._documents fitting.paper._tables
fitting.study._serialisation gyrotrack.apps._spindown gyrotrack.apps.batch._runner gyrotrack.apps.cli._batch
gyrotrack.apps.cli._data gyrotrack.apps.cli._fitting gyrotrack.apps.cli._presentation
gyrotrack.apps.cli._simulation gyrotrack.apps.cli._tracking gyrotrack.io._contents gyrotrack.io._records
gyrotrack.io.readers._import_case gyrotrack.io.readers._reading gyrotrack.synchronisation._decision
gyrotrack.tracking._profile""".split()  # noqa: SIM905
# the names that annotations contain, also of modules that are imported for annotations only
_NAMES = {name: found for m in _MODULES for name, found in vars(importlib.import_module(m)).items()}

# documents of each command, in the words of its options, with the classes whose keys they have
DOCUMENTS: dict[str, dict[str, str]] = {
    "profile": {"": "ProfileDocument", "without markers": "NoMarkersDocument"},
    "extract": {"": "ExtractionDocument"},
    "import": {"": "ImportDocument ImportSummary"},
    "spindown": {"": "SpindownDocument"},
    "sync": {"": "SyncDocument"},
    "batch": {"": "BatchDocument", "with `--dry-run`": "BatchPlan"},
    "config": {"": "ConfigDocument", "with `--tracking` or `--fitting`": "NumbersDocument"},
    "export": {"": "ExportedFile ExportDocument"},
    "info": {
        "of a case": "InspectionDocument Provenance CaseSummary",
        "of a recording": "InspectionDocument Provenance RecordingSummary",
    },
    "fit": {"of one case, or with `--joint`": "FitDocument", "of several cases": "FitsDocument"},
    "scan": {"": "ScanDocument ScanSettings"},
    "diagnose": {"": "DiagnosisDocument"},
    "improve": {"": "ImprovedDocument"},
    "laws": {"": "LawsDocument"},
    "plan": {"": "PlanDocument"},
    "budget": {"": "BudgetDocument"},
    "certify": {"": "CertificateDocument"},
    "compare": {"": "ComparisonDocument"},
    "ladder": {"": "LadderDocument"},
    "report": {"": "ReportDocument"},
    "figures": {"": "FiguresDocument"},
    "view": {"": "ViewDocument"},
    "effects": {"": "EffectsDocument", "of one effect": "EffectDocument"},
    "demo": {"": "DemoDocument"},
    "simulate": {"": "SimulationDocument"},
    "reveal": {"": "RevealDocument"},
}
# keys that are attributes of a file, which docs/reference/format.md lists as well
_OF_A_FILE: dict[str, tuple[Attribute, ...]] = {
    "RecordingSummary": RECORDING_ATTRIBUTES,
    "ClipSummary": RECORDING_ATTRIBUTES,
    "CaseSummary": CASE_ATTRIBUTES,
    "InputSummary": INPUT.attributes,
}
_TORQUE = "N m, or rad s-2"
_SHORT = 10  # characters of a unit that is not wrapped

_HEAD = """# JSON documents

Every command prints one JSON document with `--json`, and nothing else on stdout. This page lists every key. It is
generated from the program by `docs/make_json.py`, and a test compares it with the documents of real commands. For
example, this command prints the parameters of a fit with their standard errors:

```sh
gyrotrack fit case.h5 --json | jq .parameters
```

An error is `{"error": {"code", "message", "hint"}}`: a word for programs, a sentence, and a remedy (it may be empty).
The exit codes are 0: done; 1: the input or the data is invalid; 2: wrong usage; 3: done, but the result is not to be
trusted, as its verdict or its warnings state; 130: interrupted (129 by SIGHUP, 143 by SIGTERM).

Numbers are in SI units, also with `--rpm`. A number that is unknown or infinite is null; in the documents of `config`
and `compare` an infinite number is the text `inf` or `-inf`. An object *by* something has a key for each, for example
for each parameter. A key is always present unless its meaning begins with "Optional". In the column of units, 1 is a
ratio or a count, and `unit` is the unit in the key of this name. "N m, or rad s⁻²" means N m, but rad s⁻² if no moment
of inertia is known: torques are then per unit of inertia, also in keys whose names contain `Nm`.
"""


class Key(typing.NamedTuple):
    """A key of a document."""

    name: str
    type: typing.Any
    unit: str
    meaning: str
    optional: bool = False


def is_document(kind: object) -> bool:
    """Return whether a type is a class of documents."""
    return isinstance(kind, type) and (
        issubclass(kind, BaseModel) or typing.is_typeddict(kind) or dataclasses.is_dataclass(kind)
    )


@cache
def keys(kind: type) -> dict[str, Key]:
    """Return the keys of a class of documents by name; a LookupError names a key without a meaning or a unit."""
    found = {a.name: _of_attribute(a) for a in _OF_A_FILE.get(kind.__name__, ())}
    own = vars(sys.modules[kind.__module__])
    hints = typing.get_type_hints(kind, None, _NAMES | own, include_extras=True)
    meanings = _comments(kind)
    names = getattr(kind, "model_fields", None) or getattr(kind, "__dataclass_fields__", None) or hints
    for name in names:
        hint, optional = hints[name], name in getattr(kind, "absent", ())
        if typing.get_origin(hint) is typing.NotRequired:
            (hint,), optional = typing.get_args(hint), True
        elif optional:  # left out instead of null
            hint = typing.get_args(hint)[0]
        if typing.get_origin(hint) is typing.Annotated and isinstance(hint.__metadata__[0], str):
            meanings.setdefault(name, hint.__metadata__[0])
        stated = re.fullmatch(r"(.+?)(?: \[([^\]]+)\])?\.", meanings.get(name, ""))
        if stated is None:
            raise LookupError(f"{kind.__name__}.{name} has no meaning")
        unit = {"torque": _TORQUE}.get(stated[2], stated[2] or "")
        if not unit and re.search("number", type_text(hint)) and not _documents(hint):
            raise LookupError(f"{kind.__name__}.{name} has no unit")
        found[name] = Key(name, hint, unit, stated[1], optional)
    return found


def _of_attribute(a: Attribute) -> Key:
    may_miss = a.default == () or is_nan(a.default) or a.nan_is_default  # see `stated_attributes`
    return Key(a.name, a.kind, a.units, a.long_name, may_miss)


@cache
def _source(module: str) -> tuple[list[str], dict[str, ast.ClassDef]]:
    """Return the lines of a module, and its class statements by name."""
    source = inspect.getsource(sys.modules[module])
    return source.splitlines(), {n.name: n for n in ast.parse(source).body if isinstance(n, ast.ClassDef)}


def _comments(kind: type) -> dict[str, str]:
    """Return the comments that begin with ``#:`` of the keys of a class and its bases."""
    lines, statements = _source(kind.__module__)
    statement = statements.get(kind.__name__)
    if statement is None:  # a TypedDict without a class statement
        return {}
    found: dict[str, str] = {}
    for base in statement.bases:  # a TypedDict has no method resolution order
        if isinstance(base, ast.Name) and is_document(known := _NAMES.get(base.id)):
            found |= _comments(known)
    for node in statement.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            above = node.lineno - 1
            while lines[above - 1].strip().startswith("#: "):
                above -= 1
            text = " ".join(x.strip().removeprefix("#: ") for x in lines[above : node.lineno - 1])
            if text := lines[(node.end_lineno or 0) - 1].partition("  #: ")[2] or text:
                found[node.target.id] = text
    return found


def _parts(hint: typing.Any) -> tuple[typing.Any, tuple[typing.Any, ...]]:
    """Return origin and arguments of a type, without metadata."""
    if typing.get_origin(hint) is typing.Annotated:
        return _parts(typing.get_args(hint)[0])
    return typing.get_origin(hint) or hint, typing.get_args(hint)


def _documents(hint: typing.Any) -> list[type]:
    """Return the classes of documents that a type contains."""
    origin, arguments = _parts(hint)
    return [origin] if is_document(origin) else [d for a in arguments for d in _documents(a)]


_SIMPLE = {
    float: "number",
    int: "integer",
    bool: "boolean",
    str: "string",
    Path: "string",
    types.NoneType: "null",
}


def type_text(hint: typing.Any, *, plural: bool = False) -> str:
    """Return a type as text with links."""
    origin, arguments = _parts(hint)
    s = "s" if plural else ""
    if is_document(origin):
        return f"[{title(origin)}](#{anchor(origin)})"
    if origin in _SIMPLE:
        return f"{_SIMPLE[origin]}{s}"
    if origin in (typing.Union, types.UnionType):
        return _listed([type_text(a, plural=plural) for a in arguments])
    if origin is typing.Literal:
        return _listed([f"`{a}`" for a in arguments])
    if origin is np.ndarray:
        return f"array{s} of arrays of numbers"
    if origin is tuple and arguments[-1] is not Ellipsis:
        return f"array{s} of {len(arguments)} {type_text(arguments[0], plural=True)}"
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return f"object{s} of {type_text(arguments[1], plural=True)}".removesuffix(" of any")
    if isinstance(origin, type) and issubclass(origin, Sequence):
        return f"array{s} of {type_text(arguments[0], plural=True)}".removesuffix(" of any")
    return "any"


def _listed(words: Sequence[str]) -> str:
    return f"{', '.join(words[:-1])} or {words[-1]}" if len(words) > 1 else words[0]


def title(kind: type) -> str:
    """Return the title of a section."""
    return kind.__name__.removesuffix("Document")


def anchor(kind: type) -> str:
    """Return the name of a section in links."""
    return f"json-{title(kind).lower()}"


def classes(command: str) -> dict[str, list[type]]:
    """Return the classes of each document of a command."""
    return {case: [_NAMES[n] for n in names.split()] for case, names in DOCUMENTS[command].items()}


def _table(kinds: Sequence[type]) -> list[str]:
    rows = ["| key | type | unit | meaning |", "|---|---|---|---|"]
    for k in (key for kind in kinds for key in keys(kind).values()):
        meaning = k.meaning if k.meaning.startswith("`") else k.meaning[:1].upper() + k.meaning[1:]
        meaning = f"Optional. {meaning}." if k.optional else f"{meaning}."
        unit = unit_text(k.unit) or k.unit  # "1" is shown
        unit = unit.replace(" ", "\N{NO-BREAK SPACE}") if len(unit) < _SHORT else unit
        rows.append(f"| `{k.name}` | {type_text(k.type)} | {unit} | {meaning} |".replace("|  |", "| |"))
    return [*rows, ""]


def _summary(kind: type) -> str:
    return (inspect.getdoc(kind) or "").partition("\n\n")[0].replace("\n", " ")


def page() -> str:
    """Return the page."""
    used = [k for command in DOCUMENTS for kinds in classes(command).values() for k in kinds]
    nested: dict[str, type] = {}
    waiting = [d for kind in used for key in keys(kind).values() for d in _documents(key.type)]
    while waiting:
        kind = waiting.pop()
        if nested.setdefault(title(kind), kind) is not kind:
            raise LookupError(f"two classes of documents are called {title(kind)}")
        waiting += [
            d for key in keys(kind).values() for d in _documents(key.type) if d not in nested.values()
        ]
    parts = [_HEAD, "## Commands\n"]
    for command in (entry.name for entry in COMMANDS):
        parts.append(f"### `{command}`\n")
        for case, kinds in classes(command).items():
            where = f"{case[0].upper()}{case[1:]}: " if case else ""
            if kinds[0] in nested.values():
                parts.append(f"{where}{_summary(kinds[0])} Keys: [{title(kinds[0])}](#{anchor(kinds[0])}).\n")
            else:
                parts += [f"{where}{' '.join(map(_summary, kinds))}\n", *_table(kinds)]
    parts.append("## Parts of documents\n")
    for name in sorted(nested, key=str.lower):
        kind = nested[name]
        parts += [f"({anchor(kind)})=\n### {name}\n", f"{_summary(kind)}\n", *_table([kind])]
    return "\n".join(parts)


if __name__ == "__main__":
    TARGET.write_text(page(), encoding="utf-8")
