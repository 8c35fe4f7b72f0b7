"""What the tests of all applications share."""

import pytest

from fitting.discovery import _select


@pytest.fixture
def unsearched(monkeypatch):
    """Let `spindown` fit its first model and search no further laws: how many steps it would have allowed."""
    improve, rank, allowed = _select.improve, _select.rank, []

    def first_fit(base, *_, **given):
        allowed.append(given["max_steps"])
        return improve(base, **given | {"max_steps": 0, "first": rank(base, refitting=False)})

    monkeypatch.setattr(_select, "improve", first_fit)
    return allowed
