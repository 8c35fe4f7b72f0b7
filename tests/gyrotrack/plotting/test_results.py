"""Figures of laws, plans and comparisons: bars, curves and limits of results of known size."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import LIBRARY, Estimate
from gyrotrack import OutputError
from gyrotrack.plotting import _results as module
from gyrotrack.plotting._charts import BLUE, GREEN, PALE, SKY, VERMILLION, canvas


@pytest.fixture
def noted(monkeypatch):
    """Texts beside bars, with their places and options."""
    found = []
    monkeypatch.setattr(
        module, "beside", lambda ax, text, place, *offset, **more: found.append((text, place, offset, more))
    )
    return found


@pytest.fixture
def ax():
    return canvas(4, 3).subplots()


def estimate(value):
    return Estimate(value, 0.1, "1", at_bound=False)


def curve(
    variable="omega_c", body="casing", *, explained=0.5, p_value=0.01, torque=2e-6, sigma=1e-7, count=5
):
    value = np.linspace(10.0, 30.0, count)
    return SimpleNamespace(
        variable=variable, body=body, explained=explained, p_value=p_value, value=value,
        torque=np.full(count, torque), sigma=np.full(count, sigma), comparable=lambda total: total - 1.0,
    )  # fmt: skip


def law(formula="law", *effects, penalised=0.0, estimates=None):
    return SimpleNamespace(formula=formula, effects=effects, penalised=penalised, estimates=estimates or {})


QUADRATIC = LIBRARY["casing.air.quadratic"]
(SYMBOL,) = [p.symbol for p in QUADRATIC.parameters]


def laws(*found, curves=(), answer=None):
    return SimpleNamespace(
        laws=list(found), answer=list(found) if answer is None else answer, depends_on=tuple(curves),
        fit=SimpleNamespace(torque_unit="N m"),
    )  # fmt: skip


class TestLaws:
    def test_the_curve_is_that_of_the_variable_of_the_best_law(self):
        curves = curve("t"), curve("omega_c", "bearing"), curve("omega_c"), curve("psi_c")
        assert module._shown(laws(law("x", QUADRATIC), curves=curves)) is curves[2]
        assert module._shown(laws(law("x", QUADRATIC), curves=curves[:2])) is curves[0]
        assert module._shown(laws(law("x", QUADRATIC), curves=curves[1:2])) is curves[1]
        assert module._shown(laws(curves=curves)) is curves[0]
        assert module._shown(laws(curves=(curve("t", count=0), curves[1]))) is curves[1]
        assert module._shown(laws()) is None

    def test_a_law_is_drawn_if_it_depends_on_that_variable_alone(self):
        values = {
            f"{QUADRATIC.name}.{SYMBOL}@one": estimate(3.0),
            f"{QUADRATIC.name}.{SYMBOL}@two": estimate(4.0),
        }
        d = curve()
        found = module._law_curve(law("x", QUADRATIC, estimates=values), d)
        unit = abs(found + 1.0) / d.value**2  # of the first case
        assert unit == pytest.approx(np.full(5, 3.0))
        assert module._law_curve(law("x", QUADRATIC, estimates=values), curve("t")) is None
        assert module._law_curve(law("x", QUADRATIC, estimates=values), curve(body="bearing")) is None

    def test_effects_of_a_law_are_added(self):
        other = LIBRARY["casing.air.linear"]
        (b,) = [p.symbol for p in other.parameters]
        values = {f"{QUADRATIC.name}.{SYMBOL}": estimate(3.0), f"{other.name}.{b}": estimate(2.0)}
        d = curve()
        both = module._law_curve(law("x", QUADRATIC, other, estimates=values), d)
        assert abs(both + 1.0) == pytest.approx(3.0 * d.value**2 + 2.0 * d.value)

    def test_curves_and_band_have_the_prefix_of_the_torque(self, ax, monkeypatch):
        bands = []
        monkeypatch.setattr(ax, "fill_between", lambda x, low, high, **_: bands.append((low[0], high[0])))
        monkeypatch.setattr(module, "legend", lambda *_, **__: None)
        monkeypatch.setattr(module, "_law_curve", lambda x, d: None if x == "b" else np.full(5, 1e-6))
        found = laws(curves=[curve()], answer=["a", "b"])
        found.answer = [law("a"), "b"]
        monkeypatch.setattr(module, "plain", lambda text, *_: text)
        module._draw_curve(ax, found, curve(sigma=1e-7))
        module._draw_curve(ax, found, curve(sigma=1e-2))
        assert bands == [pytest.approx((1.8, 2.2)), pytest.approx((-4.0, 8.0))]
        grey, own = ax.lines[:2]
        assert (grey.get_ydata()[0], own.get_ydata()[0], own.get_label()) == (
            pytest.approx(2.0), pytest.approx(1.0), "a"
        )  # fmt: skip
        assert ax.get_ylabel() == "torque on the casing [µN m]"
        assert ax.get_xlim() == (10.0, 30.0)

    def test_shares_are_in_percent(self, ax, noted):
        curves = [
            curve(explained=0.61, p_value=0.049), curve("omega_c*t", explained=0.6, p_value=0.051),
            curve("delta", "bearing", explained=0.1, p_value=0.5), *[curve()] * 6,
        ]  # fmt: skip
        module._draw_shares(ax, laws(curves=curves))
        assert [p.get_width() for p in ax.patches] == pytest.approx([61.0, 60.0, 10.0, *[50.0] * 5])
        assert [n[0] for n in noted[:3]] == ["61.0 %", "60.0 %, p = 0.051", "10.0 %, p = 0.5"]
        assert [n[3]["ha"] for n in noted[:3]] == ["right", "left", "left"]
        assert [t.get_text() for t in ax.get_yticklabels()][:3] == [
            "ω casing, on the casing", "ω casing × time, on the casing", "ω bearing, in the bearing",
        ]  # fmt: skip
        from matplotlib.colors import to_hex

        assert [to_hex(p.get_facecolor()) for p in ax.patches][:3] == [
            SKY.lower(),
            PALE.lower(),
            PALE.lower(),
        ]

    def test_the_ranking_is_logarithmic(self, ax, noted):
        found = [law(n, penalised=p) for n, p in (("a", -5.0), ("b", 4.0), ("c", 94.0))]
        module._draw_ranking(ax, laws(*found, answer=found[:2]))
        assert [p.get_width() for p in ax.patches] == pytest.approx([0.03, 1.0, 2.0])
        assert [n[0] for n in noted] == ["best: a", "+9  b", "+99  c"]
        assert ax.get_xlim() == pytest.approx((0, 2.6 * 2.0 + 0.8))
        assert ax.get_xticks() == pytest.approx([0.0, math.log10(11), math.log10(101)])
        from matplotlib.colors import to_hex

        assert [to_hex(p.get_facecolor()) for p in ax.patches] == [
            c.lower() for c in (BLUE, VERMILLION, PALE)
        ]


def limits(name="a", torque=1e-6, *, low=5e-7, high=2e-6, upper=3e-6, mechanical=True):
    return SimpleNamespace(
        effect=SimpleNamespace(name=name, mechanical=mechanical), detection_torque=torque,
        detection_range=(low, high), upper_torque=upper, stderr=2.0, torque=1e-7,
        curve=np.array([[0.0, 0.0], [1.0, 0.2], [3.0, 0.9]]),
    )  # fmt: skip


class TestPlan:
    def test_detection_limits_and_upper_limits_are_drawn(self, ax, noted):
        shown = [limits(), limits("b", 4e-6, high=math.inf, low=3e-6, upper=math.nan)]
        module._limits(ax, shown, ["a", "b"], 2e-6, "N m")
        detection, upper, size = ax.lines
        assert detection.get_xdata().tolist() == [1e-6, 4e-6]
        assert np.asarray(upper.get_xdata())[0] == 3e-6
        assert list(size.get_xdata()) == [2e-6, 2e-6]
        assert [p[:, 0].tolist() for p in ax.collections[0].get_segments()] == [[5e-7, 2e-6], [3e-6, 3e-6]]
        assert [(n[0], n[1], n[3]["color"]) for n in noted] == [("found", (4e-6, 1), GREEN)]
        assert ax.get_xscale() == "log"

    def test_power_is_against_the_torque_of_the_effect(self, ax):
        module._power(ax, [limits()], ["a"], 2e-6, "N m")
        line = ax.lines[0]
        assert line.get_xdata() == pytest.approx([2e-7, 6e-7])
        assert line.get_ydata() == pytest.approx([20.0, 90.0])
        assert list(ax.lines[1].get_ydata()) == [90, 90]
        assert list(ax.lines[2].get_xdata()) == [2e-6, 2e-6]

    @pytest.mark.parametrize(("count", "names"), [(0, []), (3, [0, 1, 2]), (11, [0, 2, 4, 6, 8, 10])])
    def test_curves_are_spread_over_the_limits(self, ax, count, names):
        shown = [limits(str(i)) for i in range(count)]
        with pytest.warns(UserWarning, match="No artists") if not count else np.errstate():
            module._power(ax, shown, [str(i) for i in range(count)], 1e-6, "N m")
        assert [line.get_label() for line in ax.lines[:-2]] == [str(i) for i in names]

    @pytest.mark.parametrize("run", [True, False])
    def test_effects_without_a_torque_are_not_drawn(self, monkeypatch, run):
        calls = []
        monkeypatch.setattr(module, "_limits", lambda ax, shown, names, *rest: calls.append((names, rest)))
        monkeypatch.setattr(module, "_power", lambda ax, shown, names, *rest: calls.append((names, rest)))
        monkeypatch.setattr(module, "_run", lambda ax, run: calls.append(run))
        found = SimpleNamespace(
            effects=[limits("a"), limits("b", math.nan), limits("c", mechanical=False), limits("d", math.inf)],
            fit=SimpleNamespace(torque_unit="N m", name=lambda e: SimpleNamespace(words=f"<{e.name}>")),
            size=2e-6, next_run="run" if run else None,
        )  # fmt: skip
        module._plan_figure(found)
        assert calls == [(["<a>"], (2e-6, "N m"))] * 2 + ["run"] * run

    @pytest.mark.parametrize(
        ("ring", "title"), [(1, ""), (2.5, ", casing with 2.5 times its moment of inertia")]
    )
    def test_windows_of_the_next_run_are_shaded(self, ax, ring, title):
        t = np.linspace(0.0, 9.0, 4)
        found = SimpleNamespace(
            times=t, omega_rotor=3 * t, omega_casing=t,
            run=SimpleNamespace(windows=(1.0, 5.0), window_length=2.0, ring=ring),
        )  # fmt: skip
        module._run(ax, found)
        assert [(p.get_x(), p.get_width()) for p in ax.patches] == [(1.0, 2.0), (5.0, 2.0)]
        assert ax.lines[0].get_ydata().tolist() == (3 * t).tolist()
        other = next(a for a in ax.figure.axes if a is not ax)
        assert other.lines[0].get_ydata().tolist() == t.tolist()
        assert ax.get_title(loc="center") + ax.get_title(loc="left") == f"Next run, predicted motion{title}"

    def test_a_run_of_one_body_has_one_curve(self, ax):
        t = np.linspace(0.0, 9.0, 4)
        found = SimpleNamespace(times=t, omega_casing=2 * t, run=SimpleNamespace(windows=(), ring=1))
        module._run(ax, found)
        assert ax.lines[0].get_ydata().tolist() == (2 * t).tolist()
        assert ax.get_ylabel() == "angular rate [rad/s]"


class TestComparison:
    def parameter(self, name="a", mean=2.0, values=(1.0, 3.0), p_value=0.01, spread=0.5):
        repeats = [SimpleNamespace(run=f"r{i}", value=v, stderr=0.1) for i, v in enumerate(values)]
        return SimpleNamespace(name=name, mean=mean, repeats=repeats, p_value=p_value, spread=spread)

    @pytest.mark.parametrize(
        ("mean", "values", "places"),
        [
            (2.0, (1.0, 3.0), [-50.0, 50.0]),
            (-2.0, (-1.0, -3.0), [50.0, -50.0]),
            (0.0, (-1.0, 1.0), [-100.0, 100.0]),
        ],
    )
    def test_values_are_percent_of_the_mean(self, mean, values, places):
        found = SimpleNamespace(population=None, parameters=[self.parameter(mean=mean, values=values)])
        (ax,) = module._comparison_figure(found).axes
        lines = [c.lines[0] for c in ax.containers]
        assert [line.get_xdata()[0] for line in lines] == pytest.approx(places)
        (bar,) = ax.containers[0].lines[2]
        ends = bar.get_segments()[0][:, 0]
        scale = abs(mean) or 1.0
        assert np.ptp(ends) == pytest.approx(2 * 20.0 / scale)  # two standard uncertainties on either side
        band = ax.collections[0].get_paths()[0].vertices[:, 0]
        assert (band.min(), band.max()) == pytest.approx((-50.0 / scale, 50.0 / scale))
        assert [line.get_ydata()[0] for line in lines] == pytest.approx([-1 / 12, 1 / 12])

    def test_fourteen_parameters_are_drawn(self):
        found = SimpleNamespace(population=None, parameters=[self.parameter(str(i)) for i in range(15)])
        (ax,) = module._comparison_figure(found).axes
        assert len(ax.get_yticks()) == 14
        assert ax.get_ylim() == (13.5, -0.5)

    @pytest.mark.parametrize("kind", ["", "drift", "step"])
    def test_runs_of_a_population_are_drawn_about_its_model(self, monkeypatch, kind):
        bands = []
        t = np.array([1.0, 2.0, 3.0, 9.0])
        change = SimpleNamespace(kind=kind, slope=1e-6, time=2.5, size=3e-6) if kind else None
        p = SimpleNamespace(name="b", unit="N m", mean=2e-6, spread=1e-7, p_adjusted=0.01, change=change)
        values = np.array([[0.0, 1e-6], [0.0, 2e-6], [0.0, 3e-6], [0.0, 90e-6]])
        found = SimpleNamespace(
            parameters=[p], runs=("r0", "r1", "r2", "r3"), outlying=(("r3", 0.001),), times=t, time_unit="h",
            values=values[:, 1:], stderr=np.full((4, 1), 2e-7),
        )  # fmt: skip
        from matplotlib.axes import Axes

        monkeypatch.setattr(Axes, "fill_between", lambda self, x, low, high, **_: bands.append((low, high)))
        (ax,) = module._population_figure(found).axes
        expected = {
            "": [2.0, 2.0, 2.0, 2.0],
            "drift": [1.0, 2.0, 3.0, 9.0],  # about the mean time of the runs that are not outlying
            "step": [1.0, 1.0, 4.0, 4.0],
        }[kind]
        assert ax.lines[0].get_ydata() == pytest.approx(expected)
        ((low, high),) = bands
        assert (low, high) == (
            pytest.approx(np.array(expected) - 0.1),
            pytest.approx(np.array(expected) + 0.1),
        )
        inside, outside = ax.containers
        assert inside.lines[0].get_xdata().tolist() == [1.0, 2.0, 3.0]
        assert outside.lines[0].get_xdata().tolist() == [9.0]
        (bar,) = inside.lines[2]
        assert np.ptp(bar.get_segments()[0][:, 1]) == pytest.approx(0.8)
        assert ax.get_ylabel() == "[µN m]"
        assert ax.get_xlabel() == "time of the run [h]"

    def test_the_most_significant_parameters_are_first(self):
        def parameter(i):
            return SimpleNamespace(
                name=f"p{i}", unit="1", mean=1.0, spread=0.1, p_adjusted=1.0 - 0.01 * i, change=None
            )

        found = SimpleNamespace(
            parameters=[parameter(i) for i in range(15)], runs=("a", "b"), outlying=(), times=np.arange(2.0),
            time_unit="run", values=np.ones((2, 15)) * np.arange(15), stderr=np.ones((2, 15)),
        )  # fmt: skip
        axes = module._comparison_figure(SimpleNamespace(population=found, parameters=[])).axes
        assert len(axes) == 14
        assert axes[0].get_title(loc="left") == "p14"
        assert axes[0].containers[0].lines[0].get_ydata().tolist() == [14.0, 14.0]
        assert axes[-1].get_xlabel() == "run"


@pytest.mark.parametrize("force", [True, False])
@pytest.mark.parametrize("kind", ["Laws", "Plan", "Comparison"])
def test_the_figure_of_each_result_is_written(monkeypatch, tmp_path, kind, force):
    found = type(kind, (), {})()
    monkeypatch.setattr(module, f"_{kind.lower()}_figure", lambda result: ("figure", result))
    monkeypatch.setattr(module, "picture_file", lambda figure, suffix: f"{figure[0]} {suffix}".encode())
    path = tmp_path / "a.PNG"
    path.write_bytes(b"old")
    if force:
        module.write_picture(found, path, force=True)
        assert path.read_bytes() == b"figure png"
        return
    with pytest.raises(OutputError):
        module.write_picture(found, path)
    assert path.read_bytes() == b"old"
