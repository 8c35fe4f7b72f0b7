"""Making a case from tables that another program wrote: `import_case`."""

from __future__ import annotations

from gyrotrack.importing.assembly import I_CASING, I_ROTOR, import_case, summary

__all__ = ["I_CASING", "I_ROTOR", "import_case", "summary"]
