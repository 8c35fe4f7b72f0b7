import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from fitting import REDUCED, Experiment, Model, diagnose, fit, improve, simulate
from fitting.discovery._select import History
from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR
from fitting.inference._case_data import CaseData
from fitting.inference._simulation import simulate_path
from fitting.inference._speed_residuals import CASING, ROTOR, modelled_speed

pytestmark = pytest.mark.slow

HOSTILE = "<script>alert(1)</script> $x_ & \"q\" 'q'"
NUMBERS = {
    "rotor.air.quadratic.a2": 9.97e-11,
    "touchpoint.constant.b1": 2.88e-6,
    "casing.air.linear.b2": 8.28e-7,
    "bearing.linear.d": 1.57e-7,
    "bearing.power.f": 1.26e-8,
    "bearing.power.g": 1.32,
    "casing.air.quadratic.k": 3e-10,
}
SHORT = Experiment(duration=60.0, casing_fps=60.0, rotor_fps=250.0, windows=(3.0, 25.0, 52.0), sigma=5e-4)


@pytest.fixture(scope="module")
def story():
    truth = Model.of([*REDUCED, "casing.air.quadratic"])
    record = simulate(
        truth, NUMBERS, SHORT, inertia_rotor=5.54e-5, inertia_casing=2.06e-5, seed=1, label=HOSTILE
    )
    base = fit(Model.of(REDUCED), [CaseData.of(record)])
    diagnosis = diagnose(base)
    path = simulate_path(truth, NUMBERS | {INERTIA_ROTOR: 5.54e-5, INERTIA_CASING: 2.06e-5}, SHORT)[1]
    return base, diagnosis, improve(base, first=diagnosis.candidates, max_steps=1), path


class _Seen(HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.tags, self.text = set(), ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)

    def handle_data(self, data):
        self.text += data + " "


@pytest.mark.release
def test_notebooks_show_tables_with_names_as_text(story):
    base, diagnosis, ladder, _ = story
    assert isinstance(ladder, History)
    for thing, words in (
        (base, ("significant lack of fit", "bearing.power.g", HOSTILE, "N\u00a0m\u00a0s²", "±")),
        (diagnosis, ("an effect is missing", "casing.air.quadratic", HOSTILE, "significant lack of fit")),
        (ladder, ("+ quadratic air drag of the casing", "ΔBIC", "base")),
    ):
        seen = _Seen(thing._repr_html_())
        assert seen.tags <= {"div", "p", "b", "br", "table", "caption", "thead", "tbody", "tr", "th", "td"}
        assert all(w in seen.text for w in words)


def test_figures_have_units_and_bands(story):
    base, diagnosis, ladder, _ = story
    axes = base.plot().axes
    assert [a.get_ylabel().count("[rad/s]") for a in axes] == [1, 1, 1, 1]
    assert all(a.get_xlabel() == "time [s]" for a in axes)
    assert all(len(a.collections) >= 1 for a in axes)
    torque, bars = diagnosis.plot().axes
    assert torque.get_ylabel() == "torque [N m]"
    assert len(torque.collections) == 2
    assert bars.get_yticklabels()[0].get_text() == "quadratic air drag of the casing"
    left, right = ladder.plot().axes
    assert "[rad/s]" in left.get_xlabel()
    assert [t.get_text() for t in left.get_yticklabels()] == ["base", "+ quadratic air drag of the casing"]
    assert "casing.air.quadratic" not in ladder._repr_html_()
    assert "[noise]" in right.get_xlabel()
    for figure in (base.plot(), diagnosis.plot(), ladder.plot()):
        figure.canvas.draw()


def test_one_chart_is_drawn_into_given_axes(story):
    from matplotlib.figure import Figure

    base, diagnosis, ladder, _ = story
    sheet = Figure()
    axes = sheet.subplots(2, 2).ravel()
    assert base.plot(axes[0]) is sheet
    assert base.plot(axes[1], residual=True) is sheet
    assert diagnosis.plot(axes[2]) is sheet
    assert ladder.plot(axes[3]) is sheet
    assert [a.get_ylabel() or a.get_xlabel() for a in axes] == [
        r"$\omega_c$ [rad/s]",
        r"$\omega_c$: residual [rad/s]",
        "torque [N m]",
        "rms residual of the casing [rad/s]",
    ]
    sheet.canvas.draw()


def test_modelled_speed_agrees_with_the_true_speed_within_its_uncertainty(story):
    from fitting.dynamics._collocation import Sampler

    *_, ladder, path = story
    found = ladder[-1].fit
    time = np.linspace(1, 59, 300)
    for body in (ROTOR, CASING):
        value, sigma = modelled_speed(found, 0, body, time)
        true = Sampler(path.mesh, time).value(path.y[..., body])
        # some ten parameters make one curve: five deviations are never reached by chance
        assert (np.abs(value - true) < 5 * sigma + 1e-9).all()
        assert (sigma < 0.01).all()


def test_error_of_the_modelled_speed_follows_the_parameters(story):
    found = story[2][-1].fit
    value, sigma = modelled_speed(found, 0, CASING, np.array([30.0]))
    doubled = replace(found, covariance=4 * found.covariance)
    assert modelled_speed(doubled, 0, CASING, np.array([30.0]))[1] == pytest.approx(2 * sigma)
    assert np.isfinite(value).all()


def test_matplotlib_is_not_imported_before_something_is_drawn():
    code = "import sys, fitting.discovery, fitting._display; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
