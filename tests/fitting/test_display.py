"""Curves, bars and tables of the display in a notebook: bands, shares and limits of known size."""

import numpy as np
import pytest

from fitting import EstimationError
from fitting import _display as module

T = np.linspace(0.0, 4.0, 5)


@pytest.fixture
def ax():
    return module.figure(4, 3).subplots()


@pytest.fixture
def bands(monkeypatch):
    """Lower and upper limits of the drawn bands."""
    from matplotlib.axes import Axes

    found = []
    monkeypatch.setattr(Axes, "fill_between", lambda self, x, low, high, **_: found.append((low, high)))
    return found


class TestCurves:
    def test_speeds_have_a_band_of_two_sigma(self, ax, bands):
        module.draw_speed(ax, [(T, T), (T, 2 * T)], [(T, 3 * T, np.full(5, 0.5))])
        assert [line.get_ydata()[-1] for line in ax.lines] == [4.0, 8.0, 12.0]
        assert [line.get_label().startswith("_") for line in ax.lines] == [False, True, False]
        ((low, high),) = bands
        assert (low[-1], high[-1]) == (11.0, 13.0)

    def test_residuals_are_over_the_noise(self, ax, bands):
        class Curve:
            time, value, sigma = T, T - 2.0, np.full(5, 0.5)

        module.draw_speed_residual(ax, [Curve(), Curve()])
        assert [(low[0], high[0]) for low, high in bands] == [(-1.0, 1.0)] * 2
        assert ax.lines[0].get_ydata().tolist() == (T - 2.0).tolist()

    @pytest.mark.parametrize("count", [1, 2, 3])
    def test_the_torque_on_each_body_is_drawn(self, ax, bands, count):
        curves = [(f"body {i}", T, T + i, np.full(5, 0.5)) for i in range(count)]
        module.draw_torque(ax, curves, [(1.0, 2.0)], "N m")
        assert [line.get_label() for line in ax.lines[:-1]] == [
            f"on the body {i} ± 2 σ" for i in range(count)
        ]
        assert [line.get_ydata()[0] for line in ax.lines[:-1]] == list(range(count))
        assert len({line.get_color() for line in ax.lines[:-1]}) == count
        assert [(low[0], high[0]) for low, high in bands] == [(i - 1.0, i + 1.0) for i in range(count)]
        assert [(p.get_x(), p.get_width()) for p in ax.patches] == [(1.0, 1.0)]
        assert ax.get_ylabel() == "torque [N m]"

    def test_an_undetermined_torque_is_not_drawn(self, ax, bands):
        sigma = np.array([0.5, 1.0, 1.49, 1.51, 0.6])
        module.draw_torque(ax, [("body", T, T, sigma)])
        assert np.isnan(ax.lines[0].get_ydata()).tolist() == [False, False, False, True, False]


class TestBars:
    def test_candidates_have_the_root_of_their_scores(self, ax):
        from matplotlib.colors import to_hex

        module.draw_candidates(
            ax,
            ["a", "b", "c"],
            [9.0, 4.0, 1.0],
            significant=[True, True, False],
            physical=[True, False, True],
        )
        assert [p.get_width() for p in ax.patches] == [3.0, 2.0, 1.0]
        assert [to_hex(p.get_facecolor()).upper() for p in ax.patches] == [
            module.BLUE,
            module.BLUE,
            module.GREY,
        ]
        assert [p.get_hatch() for p in ax.patches] == ["", "////", ""]
        assert ax.yaxis_inverted()

    def test_answers_are_shares_of_the_recordings(self, ax):
        groups = [("with a", {"x": 3, "y": 1}), ("without", {"y": 5}), ("none", {})]
        module.draw_answers(ax, groups, {"x": "right", "y": "wrong"})
        assert [(p.get_x(), p.get_width()) for p in ax.patches] == [(0.0, 75.0), (75.0, 25.0), (0.0, 100.0)]
        assert ax.patches[1].get_facecolor() == ax.patches[2].get_facecolor() != ax.patches[0].get_facecolor()
        assert [t.get_text() for t in ax.get_legend().get_texts()] == ["right", "wrong"]

    def test_more_answers_than_colours_have_a_colour(self, ax):
        words = {str(i): str(i) for i in range(9)}
        module.draw_answers(ax, [("a", dict.fromkeys(words, 1))], words)
        assert len(ax.patches) == 9

    @pytest.mark.parametrize(
        ("values", "limit", "end"),
        [([4.0, 1.0], None, 5.0), ([4.0, 1.0], 2.0, 5.0), ([0.4, 0.1], 2.0, 2.5), ([3.0], None, 3.75)],
    )
    def test_a_history_shows_its_bars_and_its_limit(self, ax, values, limit, end):
        module.draw_history(ax, ["start", "+a"][: len(values)], values, "error", limit)
        assert [p.get_width() for p in ax.patches] == values
        assert ax.get_xlim() == pytest.approx((0.0, end))
        assert [line.get_xdata()[0] for line in ax.lines] == ([] if limit is None else [limit])
        assert [t.get_text() for t in ax.texts] == [f"{v:.3g}" for v in values]


class TestTexts:
    def test_a_verdict_has_its_symbol(self):
        assert module.headline("adequate", "a < b") == "<p><b>✓ consistent with noise</b><br>a &lt; b</p>"
        assert module.headline("new", "x").startswith("<p><b> new</b>")

    def test_cells_are_escaped_unless_they_are_markup(self):
        assert '<td style="text-align:left">&lt;b&gt;</td>' in module.table("t", ["h"], [["<b>"]])
        assert '<td style="text-align:left"><b></td>' in module.markup_table("<t>", ["h"], [["<b>"]])
        assert "&lt;t&gt;</caption>" in module.markup_table("<t>", ["h"], [["<b>"]])
        assert module.block("a", "b") == "<div>ab</div>"

    @pytest.mark.parametrize(
        ("text", "shown"),
        [("a$b", r"a\$b"), ("\N{MINUS SIGN}1", "\N{MINUS SIGN}1"), ("ω⁺\x07", "ω??"), ("é", "é")],
    )
    def test_names_have_letters_of_the_font(self, text, shown):
        assert module.printable(text) == shown

    def test_axes_belong_to_a_figure(self, ax):
        assert module.figure_of(ax) is ax.figure
        ax.remove()
        with pytest.raises(EstimationError, match="do not belong"):
            module.figure_of(ax)
