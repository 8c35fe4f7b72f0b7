"""Commands that are killed at random moments: a fixed number of the kills that the benchmark of robustness makes."""

import os
import sys
from pathlib import Path

import pytest

ROBUSTNESS = Path(__file__).parents[4] / "benchmarks" / "robustness"
if not ROBUSTNESS.is_dir():
    pytest.skip("the benchmark is not part of a source package", allow_module_level=True)
sys.path.insert(0, str(ROBUSTNESS))

import kill  # noqa: E402


@pytest.mark.release
@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="needs SIGKILL")
@pytest.mark.parametrize("name", [*kill.QUICK, "view"])
def test_after_kills_at_random_moments_nothing_is_lost(tmp_path_factory, name):
    outcome = kill.kills(tmp_path_factory.getbasetemp() / "kill", [name], 2, 7)[name]
    assert outcome.killed == 2
    assert outcome.wrong == []
