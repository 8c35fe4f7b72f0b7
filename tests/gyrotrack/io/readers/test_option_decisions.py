"""Options, workbooks, sounds, chains and points: what is taken from each, by small hand-made inputs."""

import io
import math
import zipfile
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from scipy.io import wavfile

from gyrotrack import DatasetError, UsageError, import_chain
from gyrotrack.io._records import Inertia
from gyrotrack.io.readers import _outliers as outliers
from gyrotrack.io.readers import _spreadsheets as sheets
from gyrotrack.io.readers._import_chain import read_bodies, read_inertias, read_joints
from gyrotrack.io.readers._inputs import InputOption, read_input_options
from gyrotrack.io.readers._motion_table import MotionTable, ReadOptions
from gyrotrack.io.readers._points import Points, angle_of, circle_centre
from gyrotrack.io.readers._raw_table import RawTable, table_of
from gyrotrack.io.readers._reading import Reading, Taken, reading_of, units_of_file
from gyrotrack.io.readers._sound import read_wav

PATH = Path("a.csv")
TURN = 2 * math.pi


class TestInputs:
    @pytest.mark.parametrize(
        ("unit", "si", "value"),
        [
            ("mA", "A", 4e-3), ("kV", "V", 4e3), ("uN", "N", 4e-6), ("µs", "s", 4e-6), ("mNm", "N m", 4e-3),
            ("N m", "N m", 4.0), ("kPa", "kg m-1 s-2", 4e3), ("%", "1", 0.04), ("percent", "1", 0.04),
            ("Ncm", "N m", 0.04),
            ("degC", "K", 277.15), ("°C", "K", 277.15), ("C", "K", 277.15), ("K", "K", 4.0), ("mrad", "rad", 4e-3),
            ("rpm", "s-1", 4 * TURN / 60), ("rad/s", "s-1", 4.0), ("counts", "1", 4.0), ("volts", "V", 4.0),
            ("", "1", 4.0),
        ],
    )  # fmt: skip
    def test_values_are_in_si_units(self, unit, si, value):
        option = InputOption("x", "c", unit, 0.5)
        made = option.made(table_of(PATH, ["c"], [[4.0, 5.0]]), 0, np.array([0.0, 1.0]))
        assert made.unit == si
        assert made.value[0] == pytest.approx(value)
        slope = made.value[1] - made.value[0]
        assert made.u == pytest.approx(np.full(2, 0.5 * slope))

    def test_a_unit_of_the_header_may_be_unknown(self):
        raw = table_of(PATH, ["c [furlong]"], [[4.0, 5.0]])
        assert InputOption("x", "c").made(raw, 0, np.arange(2.0)).unit == "1"
        with pytest.raises(UsageError, match="unknown unit"):
            InputOption("x", "c", "furlong").made(raw, 0, np.arange(2.0))
        raw = table_of(PATH, ["c [mA]"], [[4.0, 5.0]])
        assert InputOption("x", "c").made(raw, 0, np.arange(2.0)).value[0] == pytest.approx(4e-3)
        below = RawTable(PATH, ("c",), ("mV",), raw.columns, raw.line)
        assert InputOption("x", "c").made(below, 0, np.arange(2.0)).unit == "V"

    @pytest.mark.parametrize(
        ("values", "given", "kind"),
        [
            ([1, 1, 1, 2, 2], "", "hold"),
            ([1, 1, 2, 2, 3], "", "linear"),  # half of the neighbours are equal
            ([1, 1, 1, 1, 2], "linear", "linear"),
            ([1, 2, 3, 4, 5], "hold", "hold"),
        ],
    )
    def test_a_command_holds_if_most_neighbours_are_equal(self, values, given, kind):
        option = InputOption("x", "c", interpolation=given)
        assert option.made(table_of(PATH, ["c"], [values]), 0, np.arange(5.0)).interpolation == kind

    def test_missing_values_and_repeated_times_are_omitted(self):
        raw = table_of(PATH, ["c"], [[1.0, np.nan, 3.0, 4.0, 5.0]])
        made = InputOption("x", "c").made(raw, 0, np.array([3.0, 1.0, 0.0, np.nan, 3.0]))
        assert made.time.tolist() == [0.0, 3.0]
        assert made.value.tolist() == [3.0, 1.0]
        single = table_of(PATH, ["c"], [[np.nan, 2.0]])
        assert InputOption("x", "c").made(single, 0, np.arange(2.0)).interpolation == "hold"
        with pytest.raises(DatasetError, match="has no value"):
            InputOption("x", "c").made(table_of(PATH, ["c"], [[np.nan]]), 0, np.zeros(1))

    @pytest.mark.parametrize(
        ("column", "place"),
        [("1", 0), ("2", 1), ("3", None), ("0", None), ("Torque", 1), ("torque [n m]", 1), ("speed", None)],
    )
    def test_a_column_is_named_or_numbered(self, column, place):
        raw = table_of(PATH, ["t", "torque [N m]"], [[1.0], [2.0]])
        assert InputOption("x", column).place(raw) == place

    @pytest.mark.parametrize(
        ("text", "expected"),
        [
            ("a=3", ("a", "3", None, None, "", 0.0, None)),
            ("a=Torque [N m] +- 0.5, hold, delay=0.02", ("a", "Torque", "N m", 0.5, "hold", 0.02, None)),
            ("a=c ± 1e-3, linear", ("a", "c", None, 1e-3, "linear", 0.0, None)),
            ("a=c, delay=-.5 s, file=b.csv", ("a", "c", None, None, "", -0.5, Path("b.csv"))),
            ("a=c, delay=2 [s]", ("a", "c", None, None, "", 2.0, None)),
        ],
    )
    def test_options_are_read(self, text, expected):
        (found,) = read_input_options([text])
        u = None if math.isnan(found.u) else found.u
        assert (
            found.name,
            found.column,
            found.unit,
            u,
            found.interpolation,
            found.delay,
            found.file,
        ) == expected

    @pytest.mark.parametrize(
        "text",
        ["a", "a=", "omega_c=3", "2a=3", "a=c, later", "a=c, delay=x", "a=c, file=", "a=c, delay=1e999"],
    )
    def test_options_that_are_not_understood_are_refused(self, text):
        with pytest.raises(UsageError):
            read_input_options([text])

    def test_an_input_is_given_once(self):
        with pytest.raises(UsageError, match="given twice"):
            read_input_options(["a=1", "a=2"])
        assert len(read_input_options(["a=1", "b=2"])) == 2


class TestWorkbooks:
    def test_the_first_sheet_with_numbers_is_read(self):
        day = datetime(2020, 1, 1, tzinfo=UTC)

        def first_sheet(*tables):
            named = {str(i): rows for i, rows in enumerate(tables)}
            return sheets._sheet_of_samples(PATH, named, ReadOptions())

        found = first_sheet(
            [["notes", None], ["only text", "here"]],
            [["title"], ["t", "angle", None], [1, 2.5], [None, None], [3, 4.5, "x"]],
            [[1, 2]],
        )
        assert found.names == ("t", "angle", "")
        assert [list(c) for c in found.columns] == [["1", "3"], ["2.5", "4.5"], ["", "x"]]
        assert found.line.tolist() == [3, 5]
        assert found.header_line == 2
        assert first_sheet([[1, 2], [3, 4]]).names == ("", "")
        assert first_sheet([[1, 2], [3, 4]]).header_line == 1
        half = first_sheet([["a", "b"], ["x", 5, day, 6]])
        assert half.line.tolist() == [2]
        with pytest.raises(DatasetError, match="no sheet with numbers"):
            first_sheet([["x", 5, "y"], [None]])

    @pytest.mark.parametrize(
        ("name", "count", "refused"),
        [
            ("xl/worksheets/sheet1.xml", 50, False),
            ("xl/worksheets/sheet1.xml", 51, True),
            ("xl/sharedStrings.xml", 51, True),
            ("xl/styles.xml", 1, False),
            ("xl/styles.xml", 2, True),
        ],
    )
    def test_the_elements_of_a_workbook_are_limited(self, monkeypatch, name, count, refused):
        monkeypatch.setattr(sheets, "_MOST_CELLS", 10)
        content = io.BytesIO()
        with zipfile.ZipFile(content, "w") as archive:
            archive.writestr(name, "<" * count)
        if refused:
            with pytest.raises(DatasetError, match="more than 10 cells"):
                sheets._refuse_markup(PATH, content.getvalue())
        else:
            sheets._refuse_markup(PATH, content.getvalue())


def test_the_channels_of_a_sound_have_the_times_of_its_rate():
    for channels in (1, 2):
        signal = np.arange(10 * channels, dtype=np.int16).reshape(10, channels)
        content = io.BytesIO()
        wavfile.write(content, 500, signal if channels > 1 else signal.ravel())
        raw = read_wav(PATH, content.getvalue(), None)
        assert raw.names == ("t", *(f"channel {k + 1}" for k in range(channels)))
        assert raw.numbers(0) == pytest.approx(np.arange(10) / 500)
        for k in range(channels):
            assert raw.numbers(k + 1).tolist() == signal[:, k].tolist()
    with pytest.raises(DatasetError, match="not a readable WAV"):
        read_wav(PATH, b"RIFF", None)


class TestChains:
    def test_bodies_have_files(self, tmp_path):
        assert read_bodies(["a.csv"]) == {"": [Path("a.csv")]}
        assert read_bodies(["wheel = a.csv"]) == {"wheel": [Path("a.csv")]}
        assert read_bodies(["w=a", "d=b", "w=c"]) == {"w": [Path("a"), Path("c")], "d": [Path("b")]}
        odd = tmp_path / "x=y.csv"
        odd.write_text("")
        assert read_bodies([str(odd)]) == {"": [odd]}
        for given in (["a", "b"], ["w=a", "b"], ["w=a", "w=b"]):
            with pytest.raises(UsageError):
                read_bodies(given)

    def test_joints_have_two_bodies(self):
        assert read_joints(["belt = motor , drum", "b=drum,wheel"]) == {
            "belt": ("motor", "drum"),
            "b": ("drum", "wheel"),
        }
        for given in (["belt=motor"], ["belt=a,b,c"], ["belt=a,"], ["b=a,c", "b=c,d"]):
            with pytest.raises(UsageError):
                read_joints(given)

    def test_inertias_are_those_of_bodies(self):
        assert read_inertias(["5e-5"], ["wheel"])["wheel"].value == 5e-5
        found = read_inertias(["wheel=5e-5 +- 1e-6", "drum = 2e-4"], ["drum", "wheel"])
        assert (found["wheel"].value, found["wheel"].u, found["drum"].value) == (5e-5, 1e-6, 2e-4)
        for given in (["5e-5"], ["belt=5e-5"], ["wheel=1e-5", "wheel=2e-5"]):
            with pytest.raises(UsageError):
                read_inertias(given, ["drum", "wheel"])

    def write(self, folder, name, start, rate, count=80):
        time = start + np.arange(count) / 50
        path = folder / f"{name}.csv"
        np.savetxt(
            path,
            np.column_stack([time, rate * time + 1e-3 * np.sin(77.0 * time**2)]),
            delimiter=",",
            header="t,psi",
            comments="",
        )
        return path

    @pytest.mark.parametrize(("rates", "sense"), [((3.0, -2.0), 1), ((-3.0, -2.0), -1), ((-3.0, 2.0), 1)])
    def test_signs_are_reversed_if_all_bodies_turn_negatively(self, tmp_path, rates, sense):
        first, later = self.write(tmp_path, "a", 0.0, rates[0], 300), self.write(tmp_path, "c", 4.0, rates[1])
        early = self.write(tmp_path, "b", 1.0, rates[1])
        case = import_chain(
            {"wheel": [first], "drum": [later, early]},
            {"belt": ("wheel", "drum")},
            {"wheel": 5e-5, "drum": Inertia(2e-4, 1e-5)},
            label="x",
        )
        assert (case.body_name, case.I_casing, case.bodies) == ("wheel", 5e-5, "chain")
        assert math.isnan(case.I_casing_u)
        (drum,) = case.further
        assert (drum.name, drum.inertia, drum.inertia_u) == ("drum", 2e-4, 1e-5)
        assert case.extra["sense"] == sense
        assert np.median(np.diff(case.casing.angle)) == pytest.approx(sense * rates[0] / 50, rel=0.01)
        assert np.median(np.diff(drum.series.angle[:80])) == pytest.approx(sense * rates[1] / 50, rel=0.01)
        assert drum.series.window.tolist() == [0] * 80 + [1] * 80
        assert (np.diff(drum.series.time) > 0).all()
        assert case.casing.window is None
        assert any("sense -1" in w for w in case.warnings) == (sense == -1)
        assert case.joints == {"belt": ("wheel", "drum")}


class TestReadings:
    @pytest.mark.parametrize(
        ("columns", "expected"),
        [
            (
                [("angle", "deg")],
                {
                    "angle": ("deg", TURN / 360),
                    "omega": ("deg/s", TURN / 360),
                    "alpha": ("deg/s2", TURN / 360),
                },
            ),
            (
                [("time", "ms"), ("omega", "rpm")],
                {"omega": ("rpm", TURN / 60), "alpha": ("rpm/s", TURN / 60)},
            ),
            ([("angle", "rad")], {}),
            ([("angle", "")], {}),
            (
                [("angle", "rad"), ("omega", "rpm")],
                {"omega": ("rpm", TURN / 60), "alpha": ("rpm/s", TURN / 60)},
            ),
        ],
    )
    def test_units_of_a_file_that_are_not_si(self, columns, expected):
        document = {"columns": [{"quantity": q, "unit": u} for q, u in columns]}
        found = units_of_file(document)
        assert found.keys() == expected.keys()
        for key, (unit, scale) in expected.items():
            assert found[key] == (unit, pytest.approx(scale))

    @pytest.mark.parametrize(
        ("count", "end"), [(0, "none."), (12, "n11."), (13, "n11, 1 more."), (15, "n11, 3 more.")]
    )
    def test_twelve_unused_columns_are_named(self, count, end):
        taken = (Taken("'t'", "time", "ms", "why"), Taken("'a'", "angle", "", "why"))
        made = Reading("f", "CSV", 7, taken, tuple(f"n{k}" for k in range(count)))
        first, second = made.lines()
        assert "time from 't' [ms] (why); angle from 'a' (why)" in first
        assert second.endswith(end)
        assert reading_of(made.document()) == made


class TestOutliers:
    TIME = np.cumsum(np.r_[0.0, np.tile([0.1, 0.15], 15)])

    @pytest.mark.parametrize(("size", "found"), [(1.02, True), (0.98, False), (-1.02, True)])
    def test_a_sample_deviates_by_ten_standard_errors_of_the_worse_prediction(self, size, found):
        """Lagrange's weights of three places, for either side."""
        k, sigma = 15, np.full(31, 0.01)
        errors = []
        for near in ([14, 13, 12], [16, 17, 18]):
            t = self.TIME[near]
            weights = [
                np.prod([(self.TIME[k] - t[b]) / (t[a] - t[b]) for b in range(3) if b != a]) for a in range(3)
            ]
            errors.append(0.01 * math.sqrt(1.0 + np.sum(np.square(weights))))
        value = 3.0 * self.TIME**2 - self.TIME
        value[k] += size * 10.0 * max(errors)
        assert outliers.outliers(self.TIME, value, sigma).tolist() == ([k] if found else [])

    @pytest.mark.parametrize(("share", "found"), [(0.6, False), (0.7, True)])
    def test_both_deviations_are_alike(self, share, found):
        """A step of the motion changes one of the two predictions."""
        value = np.zeros(31)
        value[15] = 10.0
        value[16:] = 10.0 * (1.0 - share)  # the other deviation is this share of the first
        assert (15 in outliers.outliers(np.arange(31.0), value, np.full(31, 0.01)).tolist()) == found

    @pytest.mark.parametrize(
        ("count", "size", "left"), [(1, 60, 59), (2, 60, 60), (2, 100, 98), (3, 100, 100)]
    )
    def test_two_percent_or_one_sample_are_outliers(self, count, size, left):
        value = np.zeros(size)
        value[10 * np.arange(1, count + 1)] = 5.0
        made = MotionTable(
            PATH, "", "angle", np.arange(float(size)), value, np.full(size, 0.01), np.arange(size) + 2, ()
        )
        notes = []
        table, kept = outliers.without_outliers(made, value, notes)
        assert (len(table.time), len(kept)) == (left, left)
        assert len(notes) == (left < size)
        assert not notes or "line 12" in notes[0]
        assert outliers.without_outliers(made, value, [], keep_all=True)[1] is value


class TestPoints:
    def circle(self, *, y_down=False, counted=False, radius=50.0, **options):
        k = np.arange(40.0)
        angle = 0.2 * k
        sign = -1.0 if y_down else 1.0
        place = np.stack([300.0 + radius * np.cos(angle), 200.0 + sign * radius * np.sin(angle)], axis=1)
        found = Points(
            PATH, k if counted else 0.1 * k, {"dot": place, "Hub": np.tile([300.0, 200.0], (40, 1))}, {"dot": 0.02 * k},
            y_down, counted,
            errors={"dot": np.full(40, 0.5)},
        )  # fmt: skip
        return angle_of(found, ReadOptions(likelihood=0.0, **options)), angle

    @pytest.mark.parametrize("y_down", [True, False])
    @pytest.mark.parametrize("centre", [None, "300,200", "orbit", "Hub"])
    def test_an_angle_is_counter_clockwise_about_the_centre(self, y_down, centre):
        found, angle = self.circle(y_down=y_down, centre=centre)
        assert np.unwrap(found.angle) == pytest.approx(angle)
        assert found.sigma == pytest.approx(np.full(40, 0.01))
        assert found.used == ({"dot", "Hub"} if centre in {None, "Hub"} else {"dot"})
        assert found.doubts == ()

    def test_frames_and_likelihood(self):
        found, _ = self.circle(counted=True, fps=20.0, start=3.0)
        assert found.time[:3] == pytest.approx([3.0, 3.05, 3.1])
        k = np.arange(40.0)
        place = np.stack([50.0 * np.cos(k), 50.0 * np.sin(k)], axis=1)
        some = Points(PATH, k, {"dot": place}, {"dot": 0.02 * k}, False, False)
        made = angle_of(some, ReadOptions(likelihood=0.4, centre="0,0"))
        assert np.flatnonzero(np.isfinite(made.angle)).tolist() == list(range(20, 40))

    @pytest.mark.parametrize(("near", "refused"), [(9.0, True), (11.0, False)])
    def test_a_point_near_the_centre_has_no_angle(self, near, refused):
        k = np.arange(40.0)
        radius = np.where(k == 7, near, 50.0)
        place = np.stack([radius * np.cos(k), radius * np.sin(k)], axis=1)
        some = Points(PATH, k, {"dot": place}, {}, False, False)
        if refused:
            with pytest.raises(DatasetError, match="too close to"):
                angle_of(some, ReadOptions(centre="0,0"))
        else:
            assert len(angle_of(some, ReadOptions(centre="0,0")).angle) == 40

    @pytest.mark.parametrize(("offset", "doubted"), [(2.4, False), (2.6, True)])
    def test_a_centre_beside_that_of_the_path_is_doubted_from_a_twentieth_of_the_radius(
        self, offset, doubted
    ):
        k = np.arange(200.0)
        place = np.stack([50.0 * np.cos(0.1 * k) + offset, 50.0 * np.sin(0.1 * k)], axis=1)
        some = Points(PATH, k, {"dot": place}, {}, False, False)
        assert len(angle_of(some, ReadOptions(centre="0,0")).doubts) == doubted

    def test_the_doubt_states_the_uncertainty_of_the_fitted_centre(self):
        """Of a circle about (8, 0) seen over a turn: radial noise, and a frame with half of a position."""
        k = np.arange(120)
        angle = 0.15 * k
        noise = np.random.default_rng(0).normal(0.0, 0.3, 120)
        place = np.stack([8.0 + (50.0 + noise) * np.cos(angle), (50.0 + noise) * np.sin(angle)], axis=1)
        place[30, 0] = np.nan
        some = Points(PATH, k.astype(float), {"dot": place}, {}, False, False)
        (text,) = angle_of(some, ReadOptions(centre="0,0")).doubts
        known = np.delete(place, 30, axis=0)
        centre = circle_centre(known)
        radius = np.hypot(*(known - centre).T)
        rest = radius - radius.mean()
        ray = (known - centre) / radius[:, None]
        ray -= ray.mean(axis=0)
        q = np.clip(np.corrcoef(rest[1:], rest[:-1])[0, 1], 0.0, 0.99)
        u = math.sqrt((1 + q) / (1 - q) * np.mean(rest**2) * np.trace(np.linalg.inv(ray.T @ ray)))
        assert f"{np.hypot(*centre):.2g} +- {u:.2g} away" in text
        length = np.hypot(*known.T)
        assert f"varies from {length.min():.3g} to {length.max():.3g}" in text
        own, fitted = (np.ptp(np.unwrap(np.arctan2(v[:, 1], v[:, 0]))) for v in (known, known - centre))
        assert f"over {own:.3g} rad about (0, 0) and {fitted:.3g} rad" in text
