"""The data as the paper takes them: smoothed angular velocities, and one rotor curve through all windows.

The default is neither: angles are fitted as measured, and the rotor in its windows only.
"""

from __future__ import annotations

from fitting.errors import RecordError
from fitting.record import Record
from fitting.rotor_curve import with_generated_rotor
from fitting.velocities import as_velocities


def prepared(record: Record, data: str | None = None, rotor: str = "windows") -> Record:
    """Return a record as it is to be fitted.

    Parameters
    ----------
    record : Record
        What was measured.
    data : {"angle", "velocity"}, optional
        What is fitted; what was measured, if not given.
    rotor : {"windows", "generated"}
        The rotor's windows as measured, or a generated curve, which is one of velocities.

    Raises
    ------
    RecordError
        If angles are asked for and velocities were measured, or a generated curve beside angles.
    """
    if data not in (None, "angle", "velocity") or rotor not in ("windows", "generated"):
        raise RecordError(
            f"data {data!r} or rotor {rotor!r} is not known", "angle or velocity; windows or generated"
        )
    if data == "angle" and record.quantity == "omega":
        raise RecordError(f"{record.label} holds velocities, no angles", "leave out --data angle")
    if rotor == "generated" and data == "angle":
        raise RecordError(
            "a generated rotor curve is one of velocities", "take --data velocity with --rotor generated"
        )
    if rotor == "generated" and record.single:
        raise RecordError(f"{record.label} has no rotor", "leave out --rotor generated")
    if data == "velocity" or rotor == "generated":
        record = as_velocities(record)
    return with_generated_rotor(record) if rotor == "generated" else record
