"""One experiment on one clock as a file: `write_case`, and reading it back from its root group."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gyrotrack.dataset import layout
from gyrotrack.dataset.provenance import stamp, to_json
from gyrotrack.dataset.recording import fill_recording, load_json, load_recording, members
from gyrotrack.dataset.records import Case, GeneratedCurve, Placement, Series
from gyrotrack.dataset.tables import attribute, child_group, read_table, write_attributes, write_table
from gyrotrack.dataset.writing import new_hdf5

_PLACED = ("clock_offset", "clock_offset_sigma", "clock_rate", "clock_rate_sigma", "angle_offset")


def write_case(
    path: Path, case: Case, *, command: str, settings: Mapping[str, Any], force: bool = False
) -> Path:
    """Write one experiment to an HDF5 file, whole or not at all.

    Parameters and errors are those of `recording.write_recording`.
    """
    with new_hdf5(Path(path), force=force) as file:
        stamp(file, layout.CASE, command=command, settings=settings)
        write_attributes(file, {"I_rotor": case.I_rotor, "I_casing": case.I_casing})
        write_attributes(
            file,
            {"label": case.label, "surface": case.surface, "quantity": case.quantity, "bodies": case.bodies},
        )
        write_attributes(file, {"warnings": to_json(case.warnings), "extra": to_json(case.extra)})
        file.attrs["default"] = "casing"
        _fill_series(file.create_group("casing"), case.casing, case.quantity)
        _fill_series(file.create_group("rotor"), case.rotor, case.quantity)
        if case.rotor_generated is not None:
            _fill_generated(file.create_group("rotor_generated"), case.rotor_generated)
        recordings = file.create_group("recording")
        for name, recording in case.recordings.items():
            group = recordings.create_group(name)
            fill_recording(group, recording)
            if name in case.placements:
                _fill_placement(group, case.placements[name])
    return Path(path)


def _fill_series(group: Any, series: Series, quantity: str) -> None:
    table = layout.SERIES if series.window is None else layout.WINDOWED
    write_table(group, table, {f.name: getattr(series, f.name) for f in table.fields})
    group.attrs["sigma_source"] = series.sigma_source
    if quantity == "omega":
        group["angle"].attrs["comment"] = "integral of the measured angular velocity; its start is arbitrary"


def _fill_generated(group: Any, curve: GeneratedCurve) -> None:
    write_table(group, layout.GENERATED, {"time": curve.time, "omega": curve.omega})
    group.attrs["method"] = curve.method


def _fill_placement(group: Any, placement: Placement) -> None:
    write_attributes(group, {name: getattr(placement, name) for name in _PLACED})
    group.attrs["sync_ambiguous"] = int(placement.ambiguous)
    group.attrs["sync_method"] = placement.method


def load_case(file: Any) -> Case:
    """Read a case from its root group; see `reading.read_case` for whole files."""
    recordings = dict(members(file, "recording"))
    placements = {n: _load_placement(g, n) for n, g in recordings.items() if "clock_offset" in g.attrs}
    return Case(
        I_rotor=attribute(file, "I_rotor", float),
        I_casing=attribute(file, "I_casing", float),
        label=attribute(file, "label", str),
        surface=attribute(file, "surface", str),
        casing=_load_series(child_group(file, "casing"), layout.SERIES),
        rotor=_load_series(child_group(file, "rotor"), layout.WINDOWED),
        recordings={n: load_recording(g) for n, g in recordings.items()},
        placements=placements,
        rotor_generated=_load_generated(file),
        quantity=attribute(file, "quantity", str, "angle"),
        bodies=attribute(file, "bodies", str, "two"),
        warnings=tuple(load_json(file, "warnings", [])),
        extra=dict(load_json(file, "extra", {})),
    )


def _load_series(group: Any, table: layout.Table) -> Series:
    return Series(**read_table(group, table), sigma_source=attribute(group, "sigma_source", str, "measured"))


def _load_generated(file: Any) -> GeneratedCurve | None:
    if "rotor_generated" not in file.keys():  # noqa: SIM118 - `in file` follows links
        return None
    group = child_group(file, "rotor_generated")
    return GeneratedCurve(**read_table(group, layout.GENERATED), method=attribute(group, "method", str))


def _load_placement(group: Any, name: str) -> Placement:
    return Placement(
        id=name,
        **{key: attribute(group, key, float) for key in _PLACED},
        ambiguous=bool(attribute(group, "sync_ambiguous", int)),
        method=attribute(group, "sync_method", str),
    )
