"""Ledgers: several processes add fits at the same time; stored effects that the library does not have."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from fitting._errors import LedgerError
from fitting._schema import effects_of

ROOT = Path(__file__).parents[3]

WRITER = """
import sys
from pathlib import Path
import numpy as np
from fitting.study._history import Ledger
import fitting.study._history as module

class Found:
    covariance = np.zeros((0, 0))
    class problem:
        class data:
            class record:
                quantity, generated, digest, source = "angle", False, "0" * 64, ""
        class layout: choices, names = ((), ()), ()
    class model: effects = ()

Found.problem.data = (Found.problem.data,)
module.fit_document = lambda found, fit_id: {"fit_id": fit_id, "model": [], "parameters": {}, "verdict": "x"}
module.step_document = module.stored_fit = lambda *a: None
module.as_json = lambda document: None
ledger = Ledger(Path(sys.argv[1]))
for _ in range(15):
    ledger.add(Found(), added=sys.argv[2])
"""


@pytest.mark.slow
def test_concurrent_writers_lose_no_fit(tmp_path):
    path = tmp_path / "x.fits.json"
    writers = [
        subprocess.Popen([sys.executable, "-c", WRITER, str(path), name], cwd=ROOT)
        for name in ("a", "b", "c")
    ]
    assert [w.wait() for w in writers] == [0, 0, 0]
    fits = json.loads(path.read_text())["fits"]
    assert [f["fit_id"] for f in fits] == [f"f{i + 1}" for i in range(45)]
    assert sorted(f["added"] for f in fits) == sorted("abc" * 15)
    assert [p.name for p in tmp_path.iterdir()] == ["x.fits.json"]


def test_a_stored_fit_with_an_unknown_effect_is_refused():
    with pytest.raises(LedgerError, match=r"'casing\.air\.septic', which is not in the library"):
        effects_of(["casing.air.linear", "casing.air.septic"], ())
