"""Reading of files of the layout, which may be damaged or malicious, for both packages.

A file is validated before anything is read (`fitting._hdf5`). Before a dataset is read, its storage is checked: it must
be stored in the file itself, have the declared type and dimensions, and not be larger than its stored chunks can be.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from fitting import _case_format as layout
from fitting._case_format import Attribute, Field, Table
from fitting._files import Files
from fitting._hdf5 import Guard, location

MOST_MEMBERS = 64
"""Largest number of clips, inputs, bodies, series or error modes [1]. Chosen: a smaller value refuses large set-ups, a
larger one admits malicious files."""
_MOST_ROWS = 50_000_000
"""Largest number of rows of a dataset [1]. Chosen: 53 hours at 260 frames per second; a smaller value refuses long
films, a larger one admits files that fill the memory."""
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_RECREATE = "Create it again with `gyrotrack extract`, `sync` or `import`."
_HOW_TO_MAKE = {
    None: "Use `gyrotrack import` for tables, `gyrotrack extract` for films.",
    layout.RECORDING: "Create a recording with `gyrotrack extract`.",
    layout.CASE: "Create a case with `gyrotrack sync` or `gyrotrack import`.",
}
_OTHER_LAYOUT = "The file is not in this layout."
SHOWN = 20
"""Largest number of characters of a wrong word in a message [1]. Chosen: a smaller number hides the word, a larger one
fills the line."""
# errors that h5py raises for damaged files
_FAULTS = (OSError, RuntimeError, KeyError, ValueError, TypeError, UnicodeError)
_KIND_NAMES: dict[type[Any], str] = {
    int: "an integer",
    float: "a number",
    str: "a string",
    tuple: "a table of pairs",
    list: "a list of strings",
}


@dataclass(frozen=True)
class Reader(Guard):
    """Reads files of the layout; `fail` makes an error from a sentence and a hint."""

    @contextmanager
    def open(self, path: Path, kind: str | None = None) -> Iterator[h5py.File]:
        """Validate and open a file of a `kind`, by default a recording or a case.

        Faults of HDF5 while the file is read become errors of the reader. The block must contain only code that reads
        the file, because any other error in it would be reported as damage to the file.
        """
        path = Path(path)
        self._check_signature(path, kind)
        self.check_file(path, _RECREATE)
        try:
            file = h5py.File(path, "r")
        except (*_FAULTS, MemoryError) as error:
            raise self.fail(f"{path} is damaged or truncated.", _RECREATE) from error
        try:
            with file:
                self._check_root(file, path, kind)
                self.check_tree(file)
                yield file
        except MemoryError as error:
            what = f"{path} needs more memory than there is."
            raise self.fail(what, "Close other programs, or store a part of the recording.") from error
        except _FAULTS as error:
            why = (str(error).strip().splitlines() or ["it cannot be read"])[0].rstrip(".")[:120]
            raise self.fail(f"{path} is damaged: {why}.", _RECREATE) from error

    def _check_signature(self, path: Path, kind: str | None) -> None:
        Files(self.fail).refuse_special(path)
        try:
            with path.open("rb") as stream:
                head = stream.read(len(_SIGNATURE))
        except FileNotFoundError as error:
            raise self.fail(f"{path} does not exist.", "Check the name.") from error
        except OSError as error:
            what = f"{path} cannot be read: {error.strerror}."
            raise self.fail(what, "Give the name of a file.") from error
        if not head:
            raise self.fail(f"{path} is empty.", _RECREATE)
        if head != _SIGNATURE:
            raise self.fail(f"{path} is not an HDF5 file.", _HOW_TO_MAKE[kind])

    def _check_root(self, file: h5py.File, path: Path, kind: str | None) -> None:
        if self.attribute(file, "format", str, "?") != layout.FORMAT:
            raise self.fail(
                f"{path} is an HDF5 file, but was not written by gyrotrack: the attribute 'format' is missing.",
                _HOW_TO_MAKE[kind],
            )
        version = self.attribute(file, "format_version", str)
        major = version.partition(".")[0]
        if not major.isdecimal() or len(major) > SHOWN:
            what = f"{path} has no valid format version ({version[:SHOWN]!r})."
            raise self.fail(what, _RECREATE)
        shown = f"{path} has the layout {version[:SHOWN]}"
        if int(major) < 1:
            raise self.fail(f"{shown}; the oldest supported layout is 1.0.", _RECREATE)
        if int(major) > layout.MAJOR:
            raise self.fail(
                f"{shown}; the newest supported layout is {layout.FORMAT_VERSION}.", "Update gyrotrack."
            )
        found = self.attribute(file, "kind", str)
        if found not in {layout.RECORDING, layout.CASE} or (kind is not None and found != kind):
            what = f"{path} is a {found[:SHOWN]}, not a {kind or 'recording or case'}."
            raise self.fail(what, _HOW_TO_MAKE[kind])

    def child(self, group: Any, name: str) -> Any:
        """Return a direct member of `group`; it must exist and not be a link."""
        if name not in group.keys():  # noqa: SIM118 - `in group` follows links
            what = f"{location(group)} lacks '{name}'."
            raise self.fail(what, "The file is not complete; create it again.")
        return self.own_member(group, name)

    def child_group(self, group: Any, name: str) -> Any:
        """Return a direct member of `group` that is itself a group."""
        member = self.child(group, name)
        if not isinstance(member, h5py.Group):
            raise self.fail(f"{location(group)}: '{name}' is not a group.", _OTHER_LAYOUT)
        return member

    def members(self, group: Any, name: str, *, optional: bool = False) -> list[tuple[str, Any]]:
        """List the groups below the member `name` of `group`; this member must exist unless it is `optional`."""
        if optional and name not in group.keys():  # noqa: SIM118 - `in group` follows links
            return []
        parent = self.child_group(group, name)
        if len(parent) > MOST_MEMBERS:
            what = f"{location(parent)} has {len(parent)} members; at most {MOST_MEMBERS} are allowed."
            raise self.fail(what, _OTHER_LAYOUT)
        return [(member, self.child_group(parent, member)) for member in parent]

    def table(
        self, group: Any, table: Table, lengths: Mapping[str, int] | None = None
    ) -> dict[str, NDArray[Any]]:
        """Read the datasets of `table` from `group` and check them; `lengths` are the lengths of known dimensions."""
        known = {**layout.LENGTHS, **(lengths or {})}
        values: dict[str, NDArray[Any]] = {}
        for f in table.fields:
            if f.optional and f.name not in group.keys():  # noqa: SIM118 - `in group` follows links
                continue
            dataset = self.child(group, f.name)
            self.check_storage(dataset)
            self._check_shape(dataset, f, known)
            found = self.load(dataset)
            # other programs write integers as floating-point numbers
            whole = found.dtype.kind != "f" or (np.isfinite(found) & (found == np.round(found))).all()
            if f.dtype != "f8" and not whole:
                raise self.fail(f"{location(dataset)} does not contain integers.", _OTHER_LAYOUT)
            if f.dtype != "f8" and found.size:
                least, most = np.iinfo(f.dtype).min, np.iinfo(f.dtype).max
                if int(found.min()) < least or int(found.max()) > most:
                    what = f"{location(dataset)} contains integers outside the range {least} to {most}."
                    raise self.fail(what, _OTHER_LAYOUT)
            values[f.name] = found.astype(f.dtype, copy=False)
        return values

    def record(self, group: Any, table: Table, lengths: Mapping[str, int] | None = None) -> dict[str, Any]:
        """Read the datasets and attributes of a table, by the names of the fields in the record."""
        return {**self.table(group, table, lengths), **self.attributes(group, table.attributes)}

    def _check_shape(self, dataset: Any, f: Field, known: dict[str, int]) -> None:
        """Refuse a dataset whose dimensions differ from `known`; its new dimensions are added to `known`."""
        shape, dims = tuple(dataset.shape), [d.removeprefix("other_") for d in f.dims]
        for dim, length in zip(dims, shape, strict=False):
            known.setdefault(dim, length)
        wanted = tuple(known.get(d, 1) for d in dims)
        if shape != wanted:
            raise self.fail(f"{location(dataset)} has the shape {shape}, not {wanted}.", _OTHER_LAYOUT)
        if shape[0] > _MOST_ROWS:
            what = f"{location(dataset)} has {shape[0]:,} rows; at most {_MOST_ROWS:,} are read."
            raise self.fail(what, "Store a part of the recording.")

    def check_storage(self, dataset: Any) -> None:
        """Raise an error for a dataset in another file, or for a dataset larger than its stored bytes can be."""
        if not isinstance(dataset, h5py.Dataset):
            raise self.fail(f"{location(dataset)} is not a dataset.", _OTHER_LAYOUT)
        if dataset.shape is None or dataset.dtype.kind not in "iuf" or dataset.dtype.itemsize > 16:
            raise self.fail(f"{location(dataset)} does not contain plain numbers.", _OTHER_LAYOUT)
        self.check_bytes(dataset)

    def load(self, dataset: Any) -> NDArray[Any]:
        """Read all values of a dataset whose storage has been checked."""
        try:
            return np.asarray(dataset[()])
        except (OSError, RuntimeError, ValueError) as error:
            what = f"{location(dataset)} cannot be read: the file is damaged."
            raise self.fail(what, "Create it again, or restore a copy.") from error

    def attributes(self, group: Any, attributes: Sequence[Attribute]) -> dict[str, Any]:
        """Read attributes by the names of the fields in the record, with the rules of `Attribute`."""
        return {a.key: self._attribute(group, a) for a in attributes}

    def _attribute(self, group: Any, a: Attribute) -> Any:
        value = self.attribute(group, a.name, a.kind, a.default)
        if a.choices and value not in a.choices:
            what = f"{location(group)}: the attribute '{a.name}' is '{value[:SHOWN]}'."
            raise self.fail(what, f"Use {' or '.join(a.choices)}.")
        if a.kind is not float or math.isfinite(value) or layout.is_nan(a.default):
            return value
        if a.nan_is_default and math.isnan(value):
            return a.default
        what = f"{location(group)}: the attribute '{a.name}' is {value}, not a finite number."
        raise self.fail(what, "Correct it, or create the file again.")

    def attribute(self, group: Any, name: str, kind: type[Any], default: Any = None) -> Any:
        """Return an attribute as `kind`: int, float, str, pairs for tuple, texts for list.

        An attribute without a `default` must exist.
        """
        if name not in group.attrs:
            if default is not None:
                return default
            what = f"{location(group)} lacks the attribute '{name}'."
            raise self.fail(what, "The file is not complete; create it again.")
        try:
            if kind is tuple:
                pairs = np.asarray(group.attrs[name], dtype=np.float64)
                if pairs.ndim == 2 and pairs.shape[1] == 2 and np.isfinite(pairs).all():
                    return tuple(map(tuple, pairs.tolist()))
            elif kind is list:
                texts = np.asarray(group.attrs[name], dtype=object)
                words = [w.decode() if isinstance(w, bytes) else w for w in texts.reshape(-1)]
                if all(isinstance(w, str) for w in words):
                    return words
            elif group.attrs.get_id(name).shape in {(), (1,)}:
                value = np.asarray(group.attrs[name]).reshape(())[()]
                value = value.decode() if isinstance(value, bytes) else value
                if (kind is str) == isinstance(value, str):
                    return kind(value)
            cause = None
        except (TypeError, ValueError, OSError, RuntimeError, OverflowError) as error:
            cause = error
        what = f"{location(group)}: the attribute '{name}' is not {_KIND_NAMES[kind]}."
        raise self.fail(what, _OTHER_LAYOUT) from cause

    def json(self, group: Any, name: str, default: Any) -> Any:
        """Return a JSON attribute, which must have the type of `default`."""
        text = self.attribute(group, name, str, json.dumps(default))
        try:
            value = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise self.fail(
                f"{location(group)}: the attribute '{name}' is not JSON.", _OTHER_LAYOUT
            ) from error
        if not isinstance(value, type(default)):
            kind = "object" if isinstance(default, dict) else "list"
            raise self.fail(f"{location(group)}: the attribute '{name}' is not a JSON {kind}.", _OTHER_LAYOUT)
        return value
