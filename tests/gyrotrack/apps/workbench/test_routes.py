"""Ways from sources to a case."""

from types import SimpleNamespace

import pytest

from gyrotrack.apps.workbench import _routes


@pytest.mark.parametrize(("kind", "separate"), [("film", False), ("table", True)])
def test_the_film_of_a_body_is_its_case_and_a_table_is_imported(kind, separate):
    source = SimpleNamespace(kind=kind, result={"tracked": 1})
    state = SimpleNamespace(sources=[source], match={"matched": 1})
    assert _routes._OfBody().makes_case(state) is separate
    assert _routes._OfBody().result(state) == (state.match if separate else source.result)


def test_the_films_of_a_gyroscope_are_put_on_one_clock():
    state = SimpleNamespace(sources=[SimpleNamespace(kind="film")], match={"matched": 1})
    assert _routes._OfGyroscope().makes_case(state)
    assert _routes._OfGyroscope().result(state) == state.match
