"""The process that looks for what is missing: `python -m gyrotrack.view.search CASE.h5`.

It reads one JSON document a line (a model with its parameters, as a ledger keeps them), answers one line, and ends
when its input ends.
"""

from __future__ import annotations

import json
import os
import sys
import warnings
from pathlib import Path
from typing import Any

from fitting.plain import plain


def _answer(line: str, case: Path) -> dict[str, Any]:
    from fitting.case_data import CaseData
    from fitting.case_file import read_record
    from fitting.discovery import diagnose
    from fitting.errors import FittingError
    from fitting.ledger import Entry
    from fitting.summary import diagnosis_document

    try:
        fit = Entry(json.loads(line)).refit([CaseData.of(read_record(case))])
        return {"diagnosis": diagnosis_document(diagnose(fit), "")}
    except FittingError as error:
        return {"error": {"code": error.code, "message": error.message, "hint": error.hint}}


def main() -> None:
    """Answer until the input ends."""
    warnings.simplefilter("ignore")
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    case = Path(sys.argv[1])
    for line in sys.stdin:
        sys.stdout.write(json.dumps(plain(_answer(line, case))) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
