"""Charts of one case: curves, scales, bands and sentences from speeds and torques of known size."""

from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack.plotting import _case_charts as module
from gyrotrack.plotting._case_charts import (
    case_dashboard,
    difference_chart,
    energy_chart,
    normalised_chart,
    residual_chart,
    speed_chart,
    torque_angle_charts,
    torque_chart,
    torque_speed_chart,
    tracking_charts,
)
from gyrotrack.plotting._study_data import AddedTorque, CaseModel, CaseView, Curve, Energy

T = np.linspace(0.0, 10.0, 11)


def curve(value, sigma=0.0, time=T):
    return Curve(
        time, np.broadcast_to(np.asarray(value, dtype=float), time.shape), np.full(time.shape, sigma)
    )


def residual(value, sigma=0.01, time=T, width=0.5):
    found = curve(value, sigma, time)
    return SimpleNamespace(time=time, value=found.value, sigma=found.sigma, width=np.full(time.shape, width))


def torque(value, sigma=1e-9, speed=None):
    value = np.broadcast_to(np.asarray(value, dtype=float), T.shape)
    speed = np.linspace(30.0, 20.0, 11) if speed is None else speed
    return SimpleNamespace(
        time=T, torque=value, sigma=np.broadcast_to(np.asarray(sigma, dtype=float), T.shape), omega_c=speed
    )


def model(speed=20.0, band=0.1, left=0.02, torques=2e-6, sigma=1e-9, noise=0.01):
    later = T + 20.0
    return CaseModel(
        {"casing": (curve(speed, band),), "rotor": (curve(300.0, 0.2), curve(280.0, 0.3, later))},
        {"casing": (residual(left, noise),), "rotor": (residual(-2.0), residual(1.0, time=later))},
        {"casing": torque(torques, sigma), "rotor": torque(0.5 * np.asarray(torques), sigma)},
    )


def view(*models, **more):
    later = T + 20.0
    parts = {
        "label": "run", "surface": "", "quantity": "angle", "bodies": {"casing": "platter", "rotor": "wheel"},
        "torque_unit": "N m",
        "speeds": {"casing": (curve(-25.0),), "rotor": (curve(310.0), curve(290.0, time=later))},
        "smoothing_width": 7, "models": models or (model(), model(21.0, 0.05, 0.004)), "added": None,
        "alternatives": (), "energy": (Energy(curve(0.01), 0.02), Energy(curve(0.001), 0.004)), "failures": (),
    }  # fmt: skip
    return CaseView(**(parts | more))


def added(name="law", casing=1e-6, rotor=0.0, speed=None):
    return AddedTorque(
        name, T, np.linspace(30.0, 20.0, 11) if speed is None else speed,
        {"casing": np.full(11, casing), "rotor": np.full(11, rotor)},
    )  # fmt: skip


class TestSpeed:
    def test_measured_and_modelled_speeds_are_drawn(self):
        chart = speed_chart(view(), "casing")
        assert (chart.name, chart.title, chart.unit, chart.body) == (
            "speed", "Speed of the platter", "rad/s", "casing",
        )  # fmt: skip
        assert [t.label for t in chart.traces] == ["measured", "base model", "final model"]
        assert [t.value[0] for t in chart.traces] == [-25.0, 20.0, 21.0]
        assert [t.scale for t in chart.traces] == ["reference", "normal", "normal"]
        assert chart.finding == "The speed of the platter reaches 25.0 rad/s (239 rpm)."
        assert "median over 7 points" in chart.caption
        assert "at most 0.20 rad/s" in chart.caption  # twice the largest uncertainty of both models

    def test_windows_of_another_body_are_one_trace(self):
        chart = speed_chart(view(), "rotor")
        assert chart.name == "rotor"
        assert "at most" not in chart.caption
        assert chart.finding.startswith("The speed of the wheel reaches 310 rad/s")
        measured = chart.traces[0]
        assert np.isnan(measured.value).sum() == 1  # a gap between the windows
        assert np.nanmax(measured.x) == 30.0


class TestResidual:
    @pytest.mark.parametrize(
        ("left", "unit", "factor"), [(0.02, "mrad/s", 1e3), (2.0, "rad/s", 1.0), (-2e-5, "µrad/s", 1e6)]
    )
    def test_curves_and_noise_have_one_prefix(self, left, unit, factor):
        chart = residual_chart(view(model(left=left), model(left=0.1 * left)), "casing")
        assert chart.unit == unit
        band, first, last = chart.traces
        assert (band.kind, band.value[0]) == ("band", 0.0)
        assert band.sigma[0] == pytest.approx(0.01 * factor)
        assert (first.value[0], last.value[0]) == pytest.approx((left * factor, 0.1 * left * factor))
        assert "mean over 0.50 s" in chart.caption

    def test_sizes_of_both_models_are_stated(self):
        chart = residual_chart(view(), "casing")
        assert (
            chart.finding
            == "Residual of the platter with the base model: up to 0.0200 rad/s; with the final model: up to "
            "0.00400 rad/s."
        )
        assert (
            residual_chart(view(model()), "rotor").finding
            == "Residual of the wheel with the base model: up to 2.00 rad/s."
        )

    def test_the_noise_is_that_of_the_last_model(self):
        chart = residual_chart(view(model(noise=0.5), model(noise=0.02)), "casing")
        assert chart.traces[0].sigma[0] == pytest.approx(20.0)

    @pytest.mark.parametrize(("left", "within"), [(0.19, 0.0), (0.21, 3.0), (-0.21, 3.0)])
    def test_beyond_twenty_sigma_the_scale_is_logarithmic(self, left, within):
        chart = normalised_chart(view(model(left=left), model(left=0.01)))
        assert chart.linear_within == within
        band, first, last = chart.traces
        assert (band.sigma[0], first.value[0], last.value[0]) == pytest.approx((1.0, left / 0.01, 1.0))

    def test_where_no_noise_is_known_nothing_is_drawn(self):
        noise = np.full(11, 0.01)
        noise[3] = 0.0
        parts = model()
        parts.residuals["casing"][0].sigma[:] = noise
        for trace in normalised_chart(view(parts)).traces:
            assert np.isnan(trace.value).tolist() == [i == 3 for i in range(11)]


class TestDifference:
    def test_it_is_the_last_minus_the_first_model(self):
        (chart,) = difference_chart(view(model(20.0), model(20.25)), ("old", "new"))
        assert chart.unit == "mrad/s"
        assert chart.traces[0].value == pytest.approx(np.full(11, 250.0))
        assert chart.traces[0].label == "new minus old"
        assert "differ by at most 0.250 rad/s" in chart.finding

    def test_one_model_has_none(self):
        assert difference_chart(view(model())) == []


class TestTorque:
    def test_curves_and_bands_have_the_prefix_of_the_largest_torque(self):
        chart = torque_chart(
            view(model(torques=2e-6, sigma=3e-7), model(torques=-5e-7, sigma=1e-7)), "casing"
        )
        assert (chart.name, chart.title, chart.unit) == (
            "torque-casing", "Unmodelled torque, platter", "µN m",
        )  # fmt: skip
        assert [t.value[0] for t in chart.traces] == pytest.approx([2.0, -0.5])
        assert [t.sigma[0] for t in chart.traces] == pytest.approx([0.3, 0.1])

    def test_each_body_has_its_own_scale(self):
        chart = torque_chart(view(model(torques=8e-7, sigma=3e-7)), "rotor")
        assert chart.unit == "nN m"
        assert chart.traces[0].value[0] == pytest.approx(400.0)
        assert chart.traces[0].sigma[0] == pytest.approx(300.0)

    def test_it_is_not_drawn_where_its_uncertainty_exceeds_three_times_the_least(self):
        sigma = np.full(11, 1e-7)
        sigma[[2, 5]] = 2.9e-7, 3.1e-7
        (trace,) = torque_chart(view(model(sigma=sigma)), "casing").traces
        assert np.isnan(trace.value).tolist() == [i == 5 for i in range(11)]
        assert np.isnan(trace.sigma).tolist() == [i == 5 for i in range(11)]

    def test_laws_on_the_body_are_drawn(self):
        v = view(model(), added=added(casing=1e-6), alternatives=(added("a", 3e-6), added("b", 0.0, 1e-6)))
        chart = torque_chart(v, "casing")
        assert [(t.label, t.value[0], t.scale) for t in chart.traces[1:]] == [
            ("difference", pytest.approx(1.0), "none"),
            ("a", pytest.approx(3.0), "none"),
        ]
        assert [t.label for t in torque_chart(v, "rotor").traces[1:]] == ["b"]

    @pytest.mark.parametrize(
        ("torques", "words"),
        [
            (np.zeros(11), "No unmodelled torque is resolved with the base model."),
            (
                np.r_[-5e-6, np.full(10, 1.9e-9)],
                (
                    "Unmodelled torque on the platter with the base model: up to 5.00 µN m, outside ±2 σ for 9 % of "
                    "the time."
                ),
            ),
        ],
    )
    def test_the_share_of_time_outside_of_the_band_is_stated(self, torques, words):
        assert torque_chart(view(model(torques=torques)), "casing").finding == words


class TestTorqueAgainstSpeed:
    RISE = np.concatenate([np.linspace(10.0, 30.0, 5), np.linspace(28.0, 4.0, 6)])

    def test_acceleration_and_deceleration_are_two_curves(self):
        parts = model(torques=np.arange(11.0) * 1e-6, sigma=1e-6)
        parts.torques["casing"].omega_c = self.RISE
        chart = torque_speed_chart(view(parts, added=added(speed=self.RISE)))
        assert [t.label for t in chart.traces] == [
            "base model, accelerating", "base model", "difference, accelerating", "difference",
        ]  # fmt: skip
        rising, falling = chart.traces[:2]
        assert rising.x.tolist() == [10.0, 15.0, 20.0, 25.0, 30.0]
        assert rising.value == pytest.approx(np.arange(5.0))
        assert falling.x.tolist() == pytest.approx([4.0, 8.8, 13.6, 18.4, 23.2, 28.0, 30.0])
        assert falling.value == pytest.approx(np.arange(10.0, 3.0, -1.0))
        assert falling.sigma == pytest.approx(np.ones(7))
        assert (rising.dash, falling.dash) == ((4.0, 2.0), ())
        assert chart.x_label == "speed of the platter [rad/s]"

    @pytest.mark.parametrize(
        ("alternatives", "names"), [(True, ["difference", "a"]), (False, ["difference"])]
    )
    def test_laws_are_drawn_unless_they_are_zero(self, alternatives, names):
        v = view(model(), added=added(), alternatives=(added("a", 3e-6), added("b", 0.0, 1e-6)))
        chart = torque_speed_chart(v, alternatives=alternatives)
        assert [t.label for t in chart.traces[1:]] == names
        assert [t.value[0] for t in chart.traces[1:]] == pytest.approx([1.0, 3.0][: len(names)])  # in µN m
        assert [t.width for t in chart.traces[1:]] == [1.8, 1.2][: len(names)]

    @pytest.mark.parametrize(
        ("speed", "branches"),
        [
            ([1.0, 2.0, 3.0, 2.0, 1.0], [[0, 1, 2], [4, 3, 2]]),
            ([2.0, 3.0, 2.5, 1.0], [[3, 2, 1]]),  # a rise of two points
            ([1.0, 2.0, 2.5, 3.0, 2.8], [[0, 1, 2, 3]]),
            ([-1.0, -2.0, -3.0, -2.0, -1.0], [[2, 1, 0], [2, 3, 4]]),
            ([1.0, 1.0, 3.0, 2.0, 1.0], [[0, 2], [4, 3, 2]]),  # equal speeds once
        ],
    )
    def test_branches_end_at_the_peak_and_are_ordered_by_speed(self, speed, branches):
        assert [b.tolist() for b in module._branches(np.array(speed))] == branches


class TestMeans:
    def test_intervals_have_means_and_standard_errors(self):
        x = np.repeat(np.arange(24.0) + 0.5, 4) + np.tile([-0.1, 0.1, -0.1, 0.1], 24)
        y = 2.0 * np.repeat(np.arange(24.0), 4) + np.tile([-1.0, 1.0, 1.0, -1.0], 24)
        at, mean, error = module._means(x, y)
        assert at == pytest.approx(np.arange(24.0) + 0.5)
        assert mean == pytest.approx(2.0 * np.arange(24.0))
        assert error == pytest.approx(np.full(24, np.sqrt(4 / 3) / 2))

    def test_three_points_are_too_few(self):
        x = np.array([0.0, 0.0, 0.0, 0.0, 24.0, 24.0, 24.0])
        assert module._means(x, x)[0].tolist() == [0.0]
        assert [len(p) for p in module._means(np.zeros(0), np.zeros(0))] == [0, 0, 0]


class TestAngle:
    def of(self, size):
        return SimpleNamespace(
            torque=size * np.cos(T), sigma=np.full(11, 0.1 * size), angle=T, size=lambda n: (0.0, 10.0 * n)
        )

    def test_the_first_case_of_each_fit_is_drawn(self):
        (chart,) = torque_angle_charts(
            [[self.of(2e-6), self.of(1.0)], [self.of(1e-6)]], ("old", "new"), "platter", "N m"
        )
        assert chart.unit == "µN m"
        assert [t.value[0] for t in chart.traces] == pytest.approx([2.0, 1.0])
        assert [t.sigma[0] for t in chart.traces] == pytest.approx([0.2, 0.1])
        assert "platter, old: 10.0 and 20.0 σ, new: 10.0 and 20.0 σ." in chart.finding

    def test_without_harmonics_there_is_none(self):
        assert torque_angle_charts([[], []], ("old", "new"), "platter", "N m") == []
        (chart,) = torque_angle_charts([[], [self.of(1e-6)]], ("old", "new"), "platter", "N m")
        assert [t.label for t in chart.traces] == ["new"]


class TestEnergy:
    def test_the_drift_of_the_first_and_last_step_is_stated(self):
        energy = tuple(Energy(curve(v), d) for v, d in ((0.01, 0.02), (0.005, 0.03), (0.001, 0.004)))
        chart = energy_chart(view(energy=energy), ("start", "+ a", "+ b"))
        assert chart.unit == "10⁻³"
        assert [t.value[0] for t in chart.traces] == pytest.approx([10.0, 5.0, 1.0])
        assert [t.label for t in chart.traces] == ["start", "+ a", "+ b"]
        assert len({t.colour for t in chart.traces}) == 3
        assert (chart.traces[0].colour, chart.traces[-1].colour) == (module.BEFORE, module.AFTER)
        assert chart.finding == "Largest relative drift of the energy balance: 0.0200 → 0.00400."

    def test_one_step_has_one_drift(self):
        chart = energy_chart(view(energy=(Energy(curve(0.5), 0.7),)), ("start",))
        assert chart.unit == "1"
        assert chart.finding == "Largest relative drift of the energy balance: 0.700."


class TestTracks:
    def test_curves_of_clips_that_do_not_overlap_are_one_trace(self):
        first, second, beside = (("a", T), ("b", T + 10.5), ("c", T + 5.0))
        curves = [(n, t, np.full(11, i + 1.0)) for i, (n, t) in enumerate((second, first, beside))]
        traces = module._combined_traces("rotor", curves, 2)
        assert [t.label for t in traces] == ["rotor, a …", "rotor, c"]
        assert [t.colour for t in traces] == list(module._CLIPS[2:4])
        assert np.nanmax(traces[0].x) == 20.5
        assert traces[0].value[0] == 2.0

    def test_clips_that_touch_are_two_traces(self):
        curves = [("a", T, T), ("b", T + 10.0, T)]
        assert len(module._combined_traces("x", curves, 0)) == 2

    def test_uncertainties_are_in_mrad_and_places_in_pixels(self):
        tracks = SimpleNamespace(
            sigmas=[
                SimpleNamespace(body=b, clip="a", time=T, value=np.full(11, v), median=v)
                for b, v in (("rotor", 2e-3), ("casing", 1e-3))
            ],
            centres=[SimpleNamespace(clip="a", time=T, place=np.column_stack([T, 2.0 * T]), rms=1.0)],
        )
        sigma, centre = tracking_charts(tracks)
        assert [(t.label, t.value[0]) for t in sigma.traces] == [
            ("casing, a", pytest.approx(1.0)), ("rotor, a", pytest.approx(2.0)),
        ]  # fmt: skip
        assert [(t.label, t.value[-1]) for t in centre.traces] == [("x, a", 10.0), ("y, a", 20.0)]
        assert (sigma.unit, centre.unit) == ("mrad", "px")


@pytest.mark.parametrize("tracked", [True, False])
def test_a_dashboard_begins_with_the_main_body(monkeypatch, tracked):
    extra = speed_chart(view(), "rotor")
    monkeypatch.setattr(module, "tracking_charts", lambda tracks: [extra])
    board = case_dashboard(view(), SimpleNamespace() if tracked else None, ("start", "+ a"))
    assert [c.name for c in board.charts] == [
        "speed", "residual-casing", "torque-speed", "torque-casing", "torque-rotor", "rotor", "residual-rotor",
        "normalised", "energy", *(["rotor"] if tracked else []),
    ]  # fmt: skip
    assert {c.name: c.body for c in board.charts}["normalised"] == "casing"
    assert {c.name: c.body for c in board.charts}["rotor"] == "rotor"
    assert board.title == "run"
