"""Pictures of candidates, figures of merit and correlations: bars, limits and sentences of known steps."""

from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import OutputError
from gyrotrack.plotting import _discovery as module
from gyrotrack.plotting._charts import AFTER, BEFORE, SKY
from gyrotrack.plotting._discovery import (
    candidates_picture,
    correlation_picture,
    correlations,
    figures_of_merit,
    history_finding,
    history_picture,
    story_picture,
    symbol,
)


@pytest.fixture(autouse=True)
def without_markup(monkeypatch):
    """Axes are made, but not rendered, which takes half a second."""
    monkeypatch.setattr(module, "markup", lambda *_: "")


class Axes:
    """Axes that note what is drawn."""

    def __init__(self):
        self.bars, self.line, self.limits, self.scale = None, None, None, "linear"
        self.xaxis = SimpleNamespace(set_major_locator=self.note, set_minor_locator=self.note)
        self.spines = {"left": SimpleNamespace(set_color=self.note)}
        self.locators = []

    def note(self, thing):
        self.locators.append(type(thing).__name__)

    def barh(self, place, width, left=0.0, color=None, height=None):
        self.bars = np.asarray(width), left, color

    def axvline(self, limit, **_):
        self.line = limit

    def set_xlim(self, low, high):
        self.limits = low, high

    def set_xscale(self, scale):
        self.scale = scale

    def grid(self, **_):
        pass

    tick_params = grid


def merits(monkeypatch, values, limit, texts=None):
    ax, beside = Axes(), []
    monkeypatch.setattr(module, "beside", lambda ax, text, place, **_: beside.append((text, *place)))
    figures_of_merit(ax, np.array(values), limit, texts or [""] * len(values))
    return ax, beside


class TestFiguresOfMerit:
    def test_bars_begin_at_zero(self, monkeypatch):
        ax, beside = merits(monkeypatch, [4.0, -2.0, 1.0], None)
        assert (ax.scale, ax.line) == ("linear", None)
        assert (ax.bars[0].tolist(), ax.bars[1]) == ([4.0, 2.0, 1.0], 0.0)
        assert ax.limits == (0, 6.0)
        assert [x[:2] for x in beside] == [("4.00", 4.0), ("−2.00", 2.0), ("1.00", 1.0)]

    def test_a_limit_beyond_the_bars_is_in_view(self, monkeypatch):
        ax, _ = merits(monkeypatch, [0.2, 0.1], 1.0)
        assert (ax.line, ax.limits) == (1.0, (0, 1.5))

    @pytest.mark.parametrize(("largest", "scale"), [(19.9, "linear"), (20.1, "log")])
    def test_beyond_twenty_limits_the_axis_is_logarithmic(self, monkeypatch, largest, scale):
        assert merits(monkeypatch, [largest, 0.5], 1.0)[0].scale == scale
        assert merits(monkeypatch, [2 * largest, 0.5], 2.0)[0].scale == scale
        assert merits(monkeypatch, [largest, 0.5], None)[0].scale == "linear"
        assert merits(monkeypatch, [largest, 0.5], 0.0)[0].scale == "linear"

    def test_logarithmic_bars_begin_at_the_limit(self, monkeypatch):
        ax, beside = merits(monkeypatch, [200.0, 20.0, 0.5], 2.0)
        thin = 2.0 * 10 ** (0.012 * 2)  # below the limit
        assert ax.bars[0] == pytest.approx([198.0, 18.0, thin - 2.0])
        assert ax.bars[1] == 2.0
        assert ax.limits == pytest.approx((2.0 * 10**-0.12, 200.0 * 10**1.2))
        assert [x[1] for x in beside] == pytest.approx([200.0, 20.0, thin])

    @pytest.mark.parametrize(
        ("count", "colours"),
        [(1, [BEFORE]), (2, [BEFORE, AFTER]), (4, [BEFORE, SKY, SKY, AFTER])],
    )
    def test_the_first_and_the_last_fit_have_their_colours(self, monkeypatch, count, colours):
        assert merits(monkeypatch, [1.0] * count, None)[0].bars[2] == colours

    def test_values_that_are_not_finite_have_no_bar(self, monkeypatch):
        ax, beside = merits(monkeypatch, [np.nan, np.inf, 2.0], None, ["", "not resolved", ""])
        assert ax.bars[0].tolist() == [0.0, 0.0, 2.0]
        assert [x[0] for x in beside] == ["–", "not resolved", "2.00"]

    def test_without_bars_there_are_no_ticks(self, monkeypatch):
        ax, _ = merits(monkeypatch, [0.0, 0.0], None)
        assert ax.limits == (0, 1.5)
        assert "NullLocator" in ax.locators
        assert "NullLocator" not in merits(monkeypatch, [0.0, 1.0], None)[0].locators


def step(words="start", **more):
    parts = {"rmse": 0.02, "misfit": 3.0, "held_out": 2.0, "delta_bic": 0.0, "energy_drift": 0.01}
    parts |= {"torque_left": 3e-6, "torque_pure": 0.0, "words": words}
    return SimpleNamespace(**(parts | more))


def view(*steps, **more):
    parts = {
        "steps": steps or (step(), step("+ drag", rmse=0.004, misfit=1.0, held_out=1.0, torque_left=0.0)),
        "rmse_floor": 0.003, "body": "platter", "torque_unit": "N m", "candidates": (),
        "name": lambda e: SimpleNamespace(words=f"<{getattr(e, 'name', e)}>", key=getattr(e, "name", e)),
    }  # fmt: skip
    return SimpleNamespace(**(parts | more))


class TestHistory:
    def drawn(self, monkeypatch, shown):
        calls = []
        monkeypatch.setattr(
            module, "figures_of_merit",
            lambda ax, values, limit, texts: calls.append((values, limit, texts, ax)),
        )  # fmt: skip
        return history_picture(shown), calls

    def test_each_figure_has_its_noise_limit_and_prefix(self, monkeypatch):
        _, calls = self.drawn(monkeypatch, view())
        assert [c[3].get_title(loc="left") for c in calls] == [
            "rms error, platter [mrad/s]", "misfit [noise]", "cross-validation error [noise]",
            "unmodelled torque, rms [µN m]", "energy balance error [$10^{-3}$]", "change of BIC",
        ]  # fmt: skip
        assert np.array([c[0] for c in calls]) == pytest.approx(
            np.array([[20.0, 4.0], [3.0, 1.0], [2.0, 1.0], [3.0, 0.0], [10.0, 10.0], [0.0, 0.0]])
        )
        assert [c[1] for c in calls] == [pytest.approx(3.0), 1.0, 1.0, None, None, None]
        assert calls[3][2] == ["", "not resolved"]
        assert calls[5][2] == ["start", ""]
        assert calls[1][2] == ["", ""]

    def test_the_limit_of_the_torque_is_the_largest_process_noise(self, monkeypatch):
        steps = step(torque_pure=1e-7), step(torque_pure=4e-7), step(torque_pure=2e-7)
        picture, calls = self.drawn(monkeypatch, view(*steps))
        assert calls[3][1] == pytest.approx(0.4)
        assert "Process noise of the recordings 4 × 10⁻⁷ N m rms" in picture.caption
        assert "Process noise" not in self.drawn(monkeypatch, view())[0].caption

    @pytest.mark.parametrize(
        ("after", "words"),
        [
            ({"rmse": 0.0189}, "With drag: rms error of the platter 0.0200 rad/s → 0.0189 rad/s."),
            ({"rmse": 0.0191}, "With drag: no figure of merit changes by more than 5 %."),
            ({"misfit": 3.2}, "With drag: misfit 3.00 times the noise → 3.20 times the noise."),
            ({"torque_left": 0.0}, "With drag: unmodelled torque 3.00 × 10⁻⁶ N m rms → not resolved."),
        ],
    )
    def test_changes_of_a_twentieth_are_stated(self, after, words):
        found = history_finding(view(step(), step("+ drag", **after)))
        assert found.replace("3.0 × 10⁻⁶", "3.00 × 10⁻⁶") == words

    def test_one_fit_has_no_changes(self):
        assert history_finding(view(step())) == (
            "One fit: rms error of the platter 0.0200 rad/s, misfit 3.00 and cross-validation error 2.00 times the "
            "noise."
        )

    @pytest.mark.parametrize(
        ("words", "phrase"),
        [
            (["+ a"], "a"),
            (["+ a", "+ b − c"], "a and b without c"),
            (["+ a", "+ b", "c per recording"], "a, b and c per recording"),
        ],
    )
    def test_changes_are_a_phrase(self, words, phrase):
        assert module._change_phrase(view(step(), *map(step, words))) == phrase


class TestStory:
    @pytest.mark.parametrize(
        ("before", "after", "title"),
        [
            # the rms error falls to a fifth, the cross-validation error to a half
            ((0.02, 2.0), (0.004, 1.0), "rms error of the platter [rad/s]"),
            ((0.02, 9.0), (0.004, 1.0), "cross-validation error [noise]"),
        ],
    )
    def test_the_figure_of_merit_that_falls_most_is_drawn(self, monkeypatch, before, after, title):
        calls, labels = [], []
        monkeypatch.setattr(
            module, "figures_of_merit", lambda ax, values, limit, texts: calls.append((values, limit))
        )
        ax = SimpleNamespace(
            invert_yaxis=lambda: None, set_yticks=lambda *_: None, set_title=lambda _: None,
            set_xlabel=labels.append,
        )  # fmt: skip
        steps = (step(rmse=r, held_out=h) for r, h in (before, after))
        module._merit(ax, view(*steps))
        assert labels == [title]
        ((values, limit),) = calls
        which = title.startswith("cross")
        assert values.tolist() == [before[which], after[which]]
        assert limit == (1.0 if which else 0.003)

    def test_only_png_and_svg_are_drawn(self, tmp_path):
        with pytest.raises(OutputError, match="Unknown picture format"):
            story_picture([], None, tmp_path / "a.pdf")


def candidate(name, score, *, significant=True, physical=True, alike=()):
    return SimpleNamespace(
        effect=SimpleNamespace(name=name), score=score, significant=significant, physical=physical,
        indistinguishable_from=tuple(alike), delta_bic=-score, p_value=1e-3,
    )  # fmt: skip


class TestCandidates:
    def test_without_a_positive_score_there_is_no_picture(self):
        assert candidates_picture(view(candidates=(candidate("a", 0.0), candidate("b", -1.0)))) is None

    @pytest.mark.parametrize(
        ("shown", "words"),
        [
            ([candidate("a", 9.0, significant=False)], "No candidate effect is significant."),
            ([candidate("a", 9.0)], "Largest improvement of χ²: <a>, 9.00."),
            (
                [candidate("a", 9.0, alike=["b"]), candidate("b", 8.0, alike=["a"]), candidate("c", 7.0)],
                "Largest improvement of χ²: <a>, 9.00 (indistinguishable from <b>); next: <c>, 7.00.",
            ),
        ],
    )
    def test_the_best_and_the_next_are_stated(self, shown, words):
        assert module._candidates_finding(view(), shown) == words

    def test_brackets_join_the_members_of_a_class(self):
        drawn, texts = [], []
        ax = SimpleNamespace(
            get_yaxis_transform=lambda: None, plot=lambda xs, ys, **_: drawn.append((xs[1], ys)),
            text=lambda x, y, letter, **_: texts.append((y, letter)),
        )  # fmt: skip
        shown = [candidate(n, 1.0) for n in "abcd"]
        module._brackets(ax, shown, {"a": "A", "c": "A", "b": "B", "d": "C"})
        assert drawn == [(0.985, [-0.3, -0.3, 2.3, 2.3])]
        assert texts == [(pytest.approx(1.0), "A")]


class TestCorrelations:
    COVARIANCE = np.array(
        [[4.0, 5.4, 0.0, 0.1], [5.4, 9.0, 0.0, 0.2], [0.0, 0.0, 0.0, 0.0], [0.1, 0.2, 0.0, np.inf]]
    )

    def view(self, names, covariance, labels=("run",)):
        fit = SimpleNamespace(
            covariance=np.asarray(covariance),
            problem=SimpleNamespace(layout=SimpleNamespace(names=list(names))),
        )
        return view(final=fit, cases=tuple(SimpleNamespace(label=x) for x in labels))

    def test_parameters_without_an_error_are_omitted(self):
        names, matrix = correlations(self.view("abcd", self.COVARIANCE))
        assert names == ["a", "b"]
        assert matrix == pytest.approx(np.array([[1.0, 0.9], [0.9, 1.0]]))

    def test_rounding_errors_are_cut(self):
        matrix = correlations(self.view("ab", [[1.0, -1.0000001], [-1.0000001, 1.0]]))[1]
        assert matrix.tolist() == [[1.0, -1.0], [-1.0, 1.0]]

    @pytest.mark.parametrize(("value", "count"), [(0.951, 1), (-0.951, 1), (0.949, 0)])
    def test_the_strongest_pair_is_stated(self, value, count):
        names = ["casing.air.linear.b2", "touchpoint.constant.b1", "bearing.linear.d"]
        c = np.array([[1.0, 0.3, 0.2], [0.3, 1.0, value], [0.2, value, 1.0]])
        picture = correlation_picture(self.view(names, c))
        text = f"{value:.4f}".replace("-", "−")
        assert picture.finding == (
            f"Strongest correlation {text}, between <{names[1]}> and <{names[2]}>; {count} pairs exceed 0.95."
        )

    @pytest.mark.parametrize(("count", "numbered"), [(14, True), (15, False)])
    def test_matrices_of_up_to_fourteen_parameters_have_numbers(self, monkeypatch, count, numbered):
        texts = []
        monkeypatch.setattr(module, "markup", lambda figure, *_: texts.extend(figure.axes[0].texts) or "")
        matrix = np.full((count, count), 0.25) + 0.75 * np.eye(count)
        correlation_picture(self.view([f"a.k{i}" for i in range(count)], matrix))
        assert len(texts) == (count * (count - 1) if numbered else 0)
        assert {t.get_text() for t in texts} <= {"0.25"}

    def test_one_parameter_has_no_picture(self):
        assert correlation_picture(self.view("a", [[1.0]])) is None

    def test_cases_have_letters(self):
        labels = ("run", "other")
        assert symbol("bearing.linear.d@other", labels) == "$d$ (B)"
        assert symbol("bearing.linear.d@run", labels) == "$d$ (A)"
        assert symbol("bearing.linear.d@run", ("run",)) == "$d$"
        assert symbol("bearing.linear.d@third", labels) == "$d$"
        assert symbol("initial.omega_c@run", labels) == r"$\omega_{c0}$ (A)"
        names = ["bearing.linear.d@run", "bearing.linear.d@other"]
        picture = correlation_picture(self.view(names, [[1.0, 0.3], [0.3, 1.0]], labels))
        assert "Cases: (A) run, (B) other." in picture.caption
