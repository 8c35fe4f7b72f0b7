"""Figures and tables of the paper from stubs of known speeds: curves, styles, frames and files."""

from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import GyrotrackError, OutputError
from gyrotrack.apps.report import _paper as module
from gyrotrack.apps.report._paper import (
    CaseFit,
    PaperCase,
    clear_frame,
    paper_cases,
    paper_figures,
    write_figures,
)
from gyrotrack.io._schema import STATUS

T = np.linspace(0.0, 10.0, 101)


def series(value, time=T):
    value = np.broadcast_to(np.asarray(value, dtype=float), time.shape)
    return SimpleNamespace(time=time, value=value, omega_sigma=np.full(time.shape, 0.5), omega=value)


class Samples(SimpleNamespace):
    def __len__(self):
        return len(self.time)


def case(label="run", *, is_angle=False, known=True, generated=None, windows=2, value=3.0):
    record = SimpleNamespace(
        label=label, quantity="angle" if is_angle else "omega",
        casing=Samples(time=T, value=np.broadcast_to(np.asarray(value, float), T.shape)),
        rotor=[series(300.0 + i, T[:11] + 20.0 * i) for i in range(windows)],
    )  # fmt: skip
    stored = SimpleNamespace(
        label=label, casing=series(3.0), rotor=series(300.0), rotor_generated=generated, recordings={}
    )
    mesh = SimpleNamespace(edges=np.array([0.0, 10.0]))
    fits = []
    for i, name in enumerate(("RM", "GM")):
        fit = SimpleNamespace(predictions=[SimpleNamespace(path=SimpleNamespace(mesh=mesh))], size=i + 1.0)
        fits.append(CaseFit(name, fit, 0))
    return PaperCase(
        label, SimpleNamespace(record=record, is_angle=is_angle), stored if known else None, tuple(fits)
    )


@pytest.fixture(autouse=True)
def physics(monkeypatch):
    """Speeds, residuals and energies of known size."""
    monkeypatch.setattr(
        "fitting.inference._record.speeds", lambda w, quantity, *rest: (w.time, np.asarray(w.value))
    )
    monkeypatch.setattr(
        "fitting.inference._speed_residuals.modelled_speed",
        lambda fit, index, body, time: (np.full(len(time), fit.size + 10.0 * body), np.full(len(time), 0.1)),
    )
    monkeypatch.setattr(
        "fitting.inference._speed_residuals.speed_residuals",
        lambda fit, index: (
            SimpleNamespace(time=T, value=np.full(101, 0.2 * fit.size), sigma=np.where(T < 5.05, 0.1, 0.0)), None
        ),
    )  # fmt: skip


class TestCases:
    def test_separate_fits_are_before_joint_fits(self):
        models = [
            SimpleNamespace(name=n, separate=[f"{n} {i}" for i in range(2)], joint=f"{n} joint")
            for n in ("reduced", "general")
        ]
        data = [SimpleNamespace(record=SimpleNamespace(label=x)) for x in "ab"]
        found = paper_cases(SimpleNamespace(models=models), data, [SimpleNamespace(label="b")])
        assert [[(f.name, f.fit, f.index) for f in c.fits] for c in found] == [
            [("RM", f"reduced {i}", 0), ("GM", f"general {i}", 0), ("RM-JF", "reduced joint", i),
             ("GM-JF", "general joint", i)] for i in range(2)
        ]  # fmt: skip
        assert [c.case is None for c in found] == [True, False]
        assert found[0].reduced.fit == "reduced 0"
        for m in models:
            m.joint = None
        assert [f.name for f in paper_cases(SimpleNamespace(models=models), data[:1], [])[0].fits] == [
            "RM",
            "GM",
        ]


class TestFrame:
    def found(self, monkeypatch, *recordings, wrong=()):
        shown = []

        class Film:
            def __init__(self, path, r):
                self.r = r

            def __enter__(self):
                return self

            def __exit__(self, *_):
                pass

            def picture(self, index):
                if self.r.name in wrong:
                    raise GyrotrackError("no film", "")
                shown.append((self.r.name, index))
                return None if self.r.name == "empty" else np.array([[[1, 2, 3]]], np.uint8)

        import gyrotrack.plotting._frames as frames

        monkeypatch.setattr(frames, "Film", Film)
        monkeypatch.setattr(frames, "find_film", lambda r, folders: r.name if r.name != "lost" else None)
        c = SimpleNamespace(case=SimpleNamespace(recordings={r.name: r for r in recordings}))
        found = clear_frame([SimpleNamespace(case=None), c], [])
        return shown, None if found is None else found.ravel().tolist()

    def recording(self, name, rate, marked=True):
        ok, other = STATUS["ok"], max(STATUS.values())
        statuses = ([ok, ok, other], [other, ok, ok])
        return SimpleNamespace(
            name=name, capture_fps=rate,
            markers={str(i): SimpleNamespace(status=np.array(s)) for i, s in enumerate(statuses)} if marked else {},
        )  # fmt: skip

    def test_the_film_of_the_higher_rate_shows_its_clearest_frame(self, monkeypatch):
        shown, colours = self.found(
            monkeypatch, self.recording("slow", 260.0), self.recording("fast", 1000.0)
        )
        assert shown == [("fast", 1)]
        assert colours == [3, 2, 1]  # blue, green, red of the film

    def test_films_that_cannot_be_shown_are_passed_over(self, monkeypatch):
        films = [self.recording(n, 9.0 - i) for i, n in enumerate(("lost", "wrong", "empty", "right"))]
        films.insert(0, self.recording("bare", 10.0, marked=False))
        shown, colours = self.found(monkeypatch, *films, wrong=("wrong",))
        assert shown == [("empty", 1), ("right", 1)]
        assert colours == [3, 2, 1]
        assert self.found(monkeypatch, self.recording("lost", 1.0)) == ([], None)


class TestCharts:
    def test_the_angle_is_the_integral_of_the_speed(self):
        (trace,) = module._angles(case(value=2.0 * T)).traces
        assert trace.value == pytest.approx(T**2, abs=1e-9)
        (trace,) = module._angles(case(is_angle=True, value=np.where(np.arange(101) == 50, 99.0, 3.0))).traces
        assert trace.value == pytest.approx(np.full(101, 3.0))

    def test_windows_of_the_rotor_are_beside_its_curve(self):
        curve, *windows = module._rotor_data(case(windows=5)).traces
        assert (curve.label, curve.value[0], len(curve.x)) == ("reduced model", 1.0, 900)
        assert [w.label for w in windows] == ["window 1", "window 2", "window 3", "_more", "_more"]
        assert [w.value[0] for w in windows] == [300.0 + i for i in range(5)]
        assert windows[0].sigma[0] == 0.5
        assert len({w.colour for w in windows}) == 4
        assert windows[0].colour == windows[4].colour
        assert module._rotor_data(case(known=False)).traces[1].sigma is None
        curve, *_ = module._rotor_data(case(generated=series(77.0))).traces
        assert (curve.label, curve.value[0]) == ("generated", 77.0)

    def test_fits_of_each_body_are_over_the_measured_speed(self):
        measured, reduced, general = module._rotor_fits(case()).traces
        assert (np.nanmin(measured.value), np.nanmax(measured.value)) == (300.0, 301.0)
        assert [reduced.label, general.label] == ["RM", "GM"]
        assert (reduced.value[0], general.value[0]) == (1.0, 2.0)
        measured, reduced, general = module._casing_fits(case()).traces
        assert (measured.value[0], measured.sigma[0]) == (3.0, 0.5)
        assert (reduced.value[0], general.value[0]) == (11.0, 12.0)
        assert (reduced.x[0], reduced.x[-1]) == (0.0, 10.0)
        assert module._casing_fits(case(known=False)).traces[0].sigma is None

    def test_residuals_are_fit_minus_measured_in_standard_uncertainties(self):
        band, reduced, general = module._residuals(case()).traces
        assert (band.kind, band.sigma[0], band.x[-1]) == ("band", 1.0, 5.0)  # where the noise is known
        assert reduced.value == pytest.approx(np.full(51, -2.0))
        assert general.value == pytest.approx(np.full(51, -4.0))

    def test_the_energy_is_a_change_in_percent(self, monkeypatch):
        monkeypatch.setattr(
            "fitting.inference._metrics.energy_balance",
            lambda case, theta, path: SimpleNamespace(time=T, energy=4.0 * (1.0 + 0.01 * theta * T)),
        )
        c = case()
        for f in c.fits:
            f.fit.problem, f.fit.theta = SimpleNamespace(cases=[None]), f.fit.size
        assert [t.value[-1] for t in module._energy(c).traces] == pytest.approx([10.0, 20.0])

    @pytest.mark.parametrize(("count", "shape"), [(1, (1, 1)), (2, (1, 2)), (3, (2, 2))])
    def test_panels_have_two_columns_and_letters(self, monkeypatch, count, shape):
        figure = module._panels([case(f"r{i}") for i in range(count)], module._residuals)
        visible = [a for a in figure.axes if a.get_visible()]
        assert len(visible) == count
        assert len(figure.axes) == shape[0] * shape[1]
        titles = [a.get_title() + a.get_title(loc="left") for a in visible]
        assert titles == ([""] if count == 1 else [f"({'abc'[i]})  r{i}" for i in range(count)])
        assert figure.get_size_inches().tolist() == pytest.approx([4.8 * shape[1], 3.4 * shape[0]])

    @pytest.mark.parametrize("frame", [True, False])
    def test_the_gyroscope_needs_a_frame(self, monkeypatch, frame):
        monkeypatch.setattr(module, "_panels", lambda cases, chart: chart.__name__)
        found = paper_figures([case()], np.zeros((3, 4, 3), np.uint8) if frame else None)
        assert [f.name for f in found] == [
            *(["gyroscope"] if frame else []), "angular-positions", "rotor-data", "rotor-fits", "casing-fits",
            "residuals", "energy",
        ]  # fmt: skip
        assert found[-1].caption.endswith("JF: fitted to all cases jointly.")
        assert [f.figure for f in found[-6:]] == [
            "_angles", "_rotor_data", "_rotor_fits", "_casing_fits", "_residuals", "_energy"
        ]  # fmt: skip


class TestFiles:
    TEXT = "% head\n" + "".join(
        f"\\begin{{table}}\nt{i}\n\\label{{tab:{name}}}\n\\end{{table}}\n"
        for i, name in enumerate(("scan air", "é"))
    )

    def test_each_table_has_its_own_file_with_the_head(self, monkeypatch):
        monkeypatch.setattr("fitting.paper._tables.scan_latex", lambda scan: self.TEXT)
        found = module._tables(None)
        assert list(found) == ["tables.tex", "table-1-scan-air.tex", "table-2-table.tex"]
        assert found["tables.tex"] == self.TEXT
        assert found["table-2-table.tex"] == "% head\n\\begin{table}\nt1\n\\label{tab:é}\n\\end{table}\n"

    def write(self, monkeypatch, folder, **options):
        figures = [SimpleNamespace(name=n, figure=n, caption=f"of {n}") for n in ("one", "two")]
        monkeypatch.setattr(module, "paper_cases", lambda *_: [])
        monkeypatch.setattr(module, "clear_frame", lambda *_: None)
        monkeypatch.setattr(module, "paper_figures", lambda *_: figures)
        monkeypatch.setattr(
            module,
            "picture_file",
            lambda figure, kind, *, dpi, title: f"{figure} {kind} {dpi} {title}".encode(),
        )
        monkeypatch.setattr(module, "_tables", lambda scan: {"tables.tex": "all µ", "table-1-a.tex": "a"})
        return write_figures(folder, None, [], [], **options)

    def test_figures_are_written_in_each_format(self, monkeypatch, tmp_path):
        files = self.write(monkeypatch, tmp_path / "new", formats=["pdf", "png"])
        assert [f.name for f in files] == [
            "tables.tex", "table-1-a.tex", "one.pdf", "one.png", "two.pdf", "two.png", "figures.tex",
        ]  # fmt: skip
        assert (tmp_path / "new" / "two.png").read_bytes() == b"two png 300 two"
        assert (tmp_path / "new" / "tables.tex").read_bytes() == "all µ".encode()
        text = (tmp_path / "new" / "figures.tex").read_text()
        assert text.count("\\includegraphics[width=\\textwidth]{one}") == 1
        assert "\\caption{of two}" in text
        assert "\\label{fig:two}" in text

    def test_figures_are_not_replaced_without_force(self, monkeypatch, tmp_path):
        self.write(monkeypatch, tmp_path)
        with pytest.raises(OutputError):
            self.write(monkeypatch, tmp_path)
        self.write(monkeypatch, tmp_path, force=True)

    def test_a_folder_with_the_name_of_a_file_cannot_be_created(self, monkeypatch, tmp_path):
        (tmp_path / "a").touch()
        with pytest.raises(OutputError, match="Cannot create the folder"):
            self.write(monkeypatch, tmp_path / "a")
