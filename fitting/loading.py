"""Cases for a notebook: from files to records, as they were measured or as the paper takes them."""

from __future__ import annotations

from pathlib import Path

from fitting.case_file import read_record
from fitting.record import Record


def load(path: str | Path, *, data: str | None = None, rotor: str = "windows") -> Record:
    """Read a case.

    Parameters
    ----------
    path : str or Path
        An HDF5 file made by ``gyrotrack sync`` or ``gyrotrack import``.
    data : {"angle", "velocity"}, optional
        What is to be fitted; what was measured, if not given.
    rotor : {"windows", "generated"}
        The rotor's windows as measured, or the paper's curve through them.

    Returns
    -------
    Record
        Arrays of time, value and sigma of both bodies; `fitting.make_record` makes one from arrays.

    Raises
    ------
    RecordError
        If the file is missing or not sound, or holds no angles where angles are asked for.
    """
    record = read_record(path)
    if data is None and rotor == "windows":
        return record
    from fitting.paper_data import prepared

    return prepared(record, data, rotor)
