"""Making a case from tables that another program wrote: `import_case`."""

from __future__ import annotations

from gyrotrack.importing.assembly import I_CASING, I_ROTOR, import_body, import_case
from gyrotrack.importing.header import read_names
from gyrotrack.importing.points import Wanted
from gyrotrack.importing.summary import summary

__all__ = ["I_CASING", "I_ROTOR", "Wanted", "import_body", "import_case", "read_names", "summary"]
