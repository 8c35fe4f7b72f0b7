"""From the columns of a table to samples: choices, units, spikes and repairs, on either side of each limit."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from gyrotrack import DatasetError, UsageError
from gyrotrack.io.readers import _motion_table as module
from gyrotrack.io.readers._motion_table import ReadOptions, interpret, read_names
from gyrotrack.io.readers._raw_table import RawTable, table_of

PATH = Path("a.csv")
TURN = 2 * math.pi


def table(units=None, **columns):
    names = [n.replace("__", " ") for n in columns]
    raw = table_of(PATH, names, list(columns.values()))
    return raw if units is None else RawTable(PATH, raw.names, tuple(units), raw.columns, raw.line)


def named(*pairs):
    return table_of(PATH, [n for n, _ in pairs], [v for _, v in pairs])


K = np.arange(40.0)
SWING = np.sin(0.3 * K) + 0.01 * K


class TestSpikes:
    def spiky(self, first, second, count=40):
        """One sample is moved so that the changes before and after it have the given sizes; others are 1."""
        value = np.cumsum(np.where(np.arange(count) % 4 < 2, 1.0, -1.0))
        return np.concatenate(
            [value, value[-1] + np.array([first, first - second]), value[-1] + first - second + value]
        )

    @pytest.mark.parametrize(
        ("first", "second", "found"),
        [
            (20.5, 20.5, True),
            (19.5, 20.5, False),
            (20.5, 19.5, False),
            (-20.5, -20.5, True),
            (20.5, -20.5, False),
        ],
    )
    def test_a_spike_is_twenty_times_the_usual_change_to_and_from_it(self, first, second, found):
        value, notes = self.spiky(first, second), []
        made = module.without_spikes(value, "x", notes, np.arange(100, 100 + len(value)))
        lost = np.flatnonzero(np.isnan(made)).tolist()
        assert lost == ([40] if found else [])
        assert np.array_equal(made[~np.isnan(made)], value[~np.isnan(made)])
        assert len(notes) == found
        assert not found or ("1 values of 'x'" in notes[0] and "line 140" in notes[0])

    def test_missing_values_beside_a_spike_do_not_hide_it(self):
        value = self.spiky(50.0, 50.0)
        value[[39, 41]] = np.nan
        assert np.isnan(module.without_spikes(value, "x", [])).sum() == 3

    @pytest.mark.parametrize(("spikes", "found"), [(1, 1), (3, 0)])
    def test_many_spikes_are_the_motion(self, spikes, found):
        """Of few changes, the largest 4 are not usual; each spike has two."""
        value = np.tile([0.0, 1.0], 40)
        value[[11, 31, 51, 71][:spikes]] += 90.0
        assert np.isnan(module.without_spikes(value, "x", [])).sum() == found

    def test_the_step_of_a_resting_body_is_its_resolution(self):
        for size, found in ((10.5, [550]), (9.5, [])):
            value = np.repeat(0.5 * np.arange(6.0), 200)
            value[550] += size
            assert np.flatnonzero(np.isnan(module.without_spikes(value, "x", []))).tolist() == found

    def test_few_values_are_kept(self):
        value = np.array([0.0, 1.0, 900.0, 0.0, 1.0, 0.0, 1.0])
        assert module.without_spikes(value, "x", []) is value


class TestResolution:
    @pytest.mark.parametrize("step", [0.25, 1e-3, 7.0])
    @pytest.mark.parametrize("offset", [0.0, 100.0])
    def test_the_step_of_whole_multiples(self, step, offset):
        value = offset + step * np.array([0, 0, 1, 3, 2, 5, 5, 9, 8, 8, 1, 0, 2, 3])
        assert module.resolution(value) == pytest.approx(step)
        assert module.resolution(np.append(value, np.nan)) == pytest.approx(step)

    def test_values_without_a_step_have_none(self):
        assert module.resolution(np.random.default_rng(0).normal(size=200)) == 0.0
        assert module.resolution(np.array([1.0, 2.0, 1.0])) == 0.0
        assert module.resolution(0.1 * np.arange(50)) == 0.0  # even samples of a steady motion
        assert module.resolution(np.tile(0.1 * np.arange(10), 5)) == pytest.approx(0.1)
        assert module.resolution(np.full(9, np.nan)) == 0.0
        assert module.resolution(np.tile([1.0, 2.0], 9)) == 0.0
        assert module.resolution(np.tile([1.0, 2.0, 3.0], 9)) == pytest.approx(1.0)

    def test_the_step_is_the_smallest_difference(self):
        assert module.resolution(np.repeat([0.0, 1, 3, 5, 7, 9, 11, 13, 15], 3)) == pytest.approx(1.0)

    @pytest.mark.parametrize(("odd", "known"), [(1, True), (3, False)])
    def test_nineteen_values_of_twenty_are_multiples(self, odd, known):
        value = np.arange(40.0)
        value[[11, 21, 31][:odd]] += 0.15
        found = module.resolution(np.repeat(value, 3))
        assert found == (pytest.approx(1.0) if known else 0.0)


class TestColumns:
    @pytest.mark.parametrize(
        ("value", "unit"),
        [
            (9e10, ""),
            (1.1e11, "ms"),
            (9.9e13, "ms"),
            (1.1e14, "us"),
            (9.9e16, "us"),
            (1.1e17, "ns"),
            (-1.1e17, "ns"),
        ],
    )
    def test_times_since_1970_have_the_unit_of_their_size(self, value, unit):
        raw = table(t=[value, value, np.nan, 0.0, value])
        assert module._unit_since_1970(raw, 0) == unit

    def test_times_are_converted_and_displaced(self):
        raw = table(t=[0.0, 500.0, 1000.0], frame=[0.0, 2.0, 4.0])
        options = ReadOptions(start=3.0, fps=50.0)
        assert module.times_of(raw, {"t": 0}, {"t": "ms"}, options) == pytest.approx([3.0, 3.5, 4.0])
        assert module.times_of(raw, {"frame": 1}, {}, options) == pytest.approx([3.0, 3.04, 3.08])
        assert module.times_of(raw, {}, {}, options) == pytest.approx([3.0, 3.02, 3.04])
        with pytest.raises(DatasetError, match="no column for the time"):
            module.times_of(raw, {}, {}, ReadOptions())
        for fps in (None, 0.0, -5.0):
            with pytest.raises(UsageError):
                module.frame_rate(PATH, ReadOptions(fps=fps))

    def test_units_are_factors(self):
        raw = table(t=[0.0])
        assert module.scale_of(raw, "angle", "") == 1.0
        assert module.scale_of(raw, "angle", "deg") == pytest.approx(math.pi / 180)
        with pytest.raises(DatasetError, match="unknown unit 'a\\*\\*b"):
            module.scale_of(raw, "angle", "a**b**c")

    def test_one_of_several_columns_of_a_quantity(self):
        angle = named(("t", K), ("angle casing", SWING), ("angle rotor", 2 * SWING))
        for body, place in (("casing", 1), ("ROTOR", 2)):
            assert module.find_columns(angle, ReadOptions(body=body)).place["angle"] == place
        with pytest.raises(DatasetError, match="2 columns for 'angle'"):
            module.find_columns(angle, ReadOptions())
        copies = named(("t", K), ("angle", SWING), ("angle", SWING))
        assert module.find_columns(copies, ReadOptions()).place["angle"] == 1
        times = named(("timestamp", K), ("time", K), ("angle", SWING))
        assert module.find_columns(times, ReadOptions()).place["t"] == 1
        times = named(("timestamp", K), ("clock", K), ("angle", SWING))
        assert module.find_columns(times, ReadOptions()).place["t"] == 0
        errors = named(("t", K), ("angle", SWING), ("angle_err", K), ("sigma", K))
        assert module.find_columns(errors, ReadOptions()).place["sigma"] == 3

    def test_the_axis_of_a_sensor_with_the_largest_speed_is_taken(self):
        raw = named(
            ("t", K),
            ("gyro x", 0.1 * SWING),
            ("gyro y", -3.0 * SWING),
            ("gyro z", SWING),
            ("gyro abs", 9 + SWING),
        )
        found = module.find_columns(raw, ReadOptions())
        assert found.place["omega"] == 2
        assert found.axes == [1, 2, 3]
        spiky = SWING.copy()
        spiky[20] = 1e6
        raw = named(("t", K), ("wx", 2.0 * SWING), ("wy", spiky), ("wz", 0 * SWING))
        assert module.find_columns(raw, ReadOptions()).place["omega"] == 1

    @pytest.mark.parametrize(("mean", "varies"), [(0.0, True), (9.9, True), (10.1, False)])
    def test_a_speed_is_along_the_direction_of_its_variation(self, mean, varies):
        """A nearly constant speed, with a squared mean of 100 variances, is along its mean."""
        change = np.tile([1.0, -1.0], 200) * math.sqrt(399 / 400)  # of variance 1
        along, beside = np.array([0.6, 0.0, -0.8]), np.array([0.8, 0.0, 0.6])
        values = change[:, None] * along + mean * beside
        values[5] = np.nan
        found, direction = module._along_rotation(values)
        wanted = -along if varies else beside  # the largest component is positive
        assert direction == pytest.approx(wanted, abs=0.11)
        assert found[[0, 1]] == pytest.approx(values[[0, 1]] @ direction)
        assert direction @ wanted > 0.99
        assert np.isnan(found[5])

    def test_a_speed_of_three_axes_is_their_projection(self):
        speed = 5.0 + 3.0 * SWING
        raw = named(
            ("t", 0.01 * K),
            ("gyro x [rad/s]", 0.6 * speed),
            ("gyro y [rad/s]", -0.8 * speed),
            ("gyro z [rad/s]", 0.0 * speed),
        )
        made = interpret(raw, ReadOptions())
        assert made.value == pytest.approx(-speed)
        assert "(-0.600, 0.800, 0.000)" in made.notes[0] or "(-0.600, 0.800, -0.000)" in made.notes[0]
        assert made.reading.left_out == ()

    @pytest.mark.parametrize(
        ("header", "role", "unit"),
        [
            ("position [deg]", "angle", "deg"),
            ("value [rpm]", "omega", "rpm"),
            ("speed [deg]", "angle", "deg"),
            ("angle [px]", None, None),
            ("angle [V]", None, None),
            ("angle [mV]", "angle", "mV"),
            ("speed [a^b^c]", None, None),
            ("turns", "angle", "turns"),
        ],
    )
    def test_the_unit_decides_the_quantity(self, header, role, unit):
        found = module.find_columns(named(("t", K), (header, SWING)), ReadOptions())
        assert {r: (p, found.unit[r]) for r, p in found.place.items() if r != "t"} == (
            {role: (1, unit)} if role else {}
        )
        if role:
            named_so = header.startswith(("angle", "speed")) and not header.startswith("speed [deg]")
            assert found.why[role] == ("by its name" if named_so else "by its unit")

    def test_whole_turns_are_counts(self):
        found = module.find_columns(named(("t", K), ("turns", np.floor(K / 3))), ReadOptions())
        assert (found.place.get("revolutions"), found.unit["revolutions"]) == (1, "")

    def test_a_unit_below_the_header_agrees_with_it(self):
        raw = table(units=("s", "deg"), t=K, angle=SWING)
        assert module.find_columns(raw, ReadOptions()).unit == {"t": "s", "angle": "deg"}
        raw = RawTable(PATH, ("t", "angle [rad]"), ("s", "deg"), raw.columns, raw.line)
        with pytest.raises(DatasetError, match="the unit of 'angle \\[rad\\]' is 'deg'"):
            module.find_columns(raw, ReadOptions())

    def test_columns_that_drive_the_motion_are_listed(self):
        raw = named(("t", 0.01 * K), ("angle [rad]", SWING), ("voltage [V]", 2 * K), ("note", K))
        assert module.find_columns(raw, ReadOptions()).drivers == [2]
        made = interpret(raw, ReadOptions())
        assert [(d.name, d.unit, d.value[3]) for d in made.drivers] == [("voltage", "V", 6.0)]
        assert made.reading.left_out == ("'note'",)

    @pytest.mark.parametrize(
        ("count", "tail"), [(8, "'c7'."), (9, "'c7' and 1 more."), (11, "'c7' and 3 more.")]
    )
    def test_a_table_without_a_motion_lists_eight_columns(self, count, tail):
        with pytest.raises(DatasetError) as caught:
            interpret(named(*((f"c{i}", K) for i in range(count))), ReadOptions(fps=10.0))
        assert caught.value.message.endswith(tail)
        assert caught.value.message.count("'c") == 8

    @pytest.mark.parametrize(
        ("given", "body", "names"),
        [
            (["t=Zeit"], "casing", {"zeit": ("t", "")}),
            (["angle=Phi [deg]"], "casing", {"phi [deg]": ("angle", ""), "phi": ("angle", "deg")}),
            (["casing.x=2", "rotor.y=3"], "casing", {"2": ("x", "")}),
            (["casing.x=2", "rotor.y=3"], "rotor", {"3": ("y", "")}),
            (["t = 1 [u s]"], "rotor", {"1 [u s]": ("t", ""), "1": ("t", "us")}),
        ],
    )
    def test_columns_are_given_by_name_or_number(self, given, body, names):
        assert read_names(given, body) == names

    @pytest.mark.parametrize("option", ["t", "speed=3", "t=", "other.t=1"])
    def test_columns_of_unknown_quantities_are_refused(self, option):
        with pytest.raises(UsageError):
            read_names([option])

    def test_columns_without_a_header_are_given_by_number(self):
        raw = table_of(PATH, ["", ""], [0.01 * K, 10.0 * SWING])
        found = module.find_columns(raw, ReadOptions(names=read_names(["angle=2 [deg]"])))
        assert found.place == {"angle": 1, "t": 0}
        assert found.unit == {"angle": "deg", "t": ""}
        assert found.why["t"] == "the first column"
        with_rate = module.find_columns(raw, ReadOptions(names=read_names(["angle=2 [deg]"]), fps=50.0))
        assert with_rate.place == {"angle": 1}
        made = interpret(raw, ReadOptions(names=read_names(["angle=2 [deg]"])))
        assert made.value == pytest.approx(10.0 * SWING * math.pi / 180)

    @pytest.mark.parametrize(
        ("marker", "found"), [(None, None), ("red", "Red left"), ("e", None), ("x", None)]
    )
    def test_one_of_several_names_is_chosen(self, marker, found):
        names = ["Red left", "blue"]
        if found is None:
            with pytest.raises(DatasetError, match="contains 2 points"):
                module.only_one(PATH, names, "points", ReadOptions(marker=marker))
        else:
            assert module.only_one(PATH, names, "points", ReadOptions(marker=marker)) == found
        assert module.only_one(PATH, ["a"], "points", ReadOptions(marker=marker)) == "a"


def test_columns_without_a_header_are_proposed_by_number():
    for columns, words in (
        ([0.1 * K], ["only column"]),
        ([0.1 * K, SWING], ["t=1", "angle=2 [deg]"]),
        ([K, 0.1 * K, SWING], ["casing-fps", "angle=2 [deg]"]),
        ([0.1 * K, K, SWING], ["t=1", "angle=3 [deg]"]),
    ):
        error = module._without_header(table_of(PATH, [""] * len(columns), columns))
        text = f"{error} {error.hint}"
        assert all(w in text for w in words)


class TestUnits:
    @pytest.mark.parametrize(
        ("columns", "refused"),
        [
            ((("time [s]", 0.01 * K), ("heading", SWING)), True),
            ((("time [s]", 0.01 * K), ("psi", SWING)), False),
            ((("time", 0.01 * K), ("psi", SWING)), False),  # no whole milliseconds
            ((("time", 10.0 * K), ("psi", SWING)), True),
            ((("t", 10.0 * K), ("psi", SWING)), False),
            ((("t", K), ("psi", SWING)), True),  # numbers of rows
            ((("time [s]", 0.01 * K), ("heading [rad]", SWING)), False),
        ],
    )
    def test_a_unit_is_requested_unless_the_symbol_implies_it(self, columns, refused):
        raw = named(*columns)
        found = module.find_columns(raw, ReadOptions())
        if refused:
            with pytest.raises(DatasetError):
                module._ask_for_units(raw, found, "angle", ReadOptions())
        else:
            module._ask_for_units(raw, found, "angle", ReadOptions())

    @pytest.mark.parametrize(
        ("unit", "refused"), [("", False), ("deg", False), ("rad", True), ("gon", True), ("degrees", False)]
    )
    def test_a_unit_that_contradicts_the_wrapping_is_refused(self, unit, refused):
        value = (47.0 * np.arange(200.0)) % 360.0
        raw = named(("t", np.arange(200.0)), ("heading", value))
        if refused:
            with pytest.raises(DatasetError, match="wraps at a whole turn in deg"):
                module._unit_of_angle(raw, 1, unit, "why", value)
        else:
            found, why = module._unit_of_angle(raw, 1, unit, "why", value)
            assert found == "deg"
            assert why.startswith("why; it wraps")
        assert module._unit_of_angle(raw, 1, unit, "why", SWING) == (unit, "why")

    def test_an_uncertainty_has_its_unit_or_that_of_the_value(self):
        pair = (("t", 0.01 * K), ("angle [deg]", 40.0 * SWING))
        made = interpret(named(*pair, ("sigma", 0.5 + 0 * K)), ReadOptions())
        assert made.sigma == pytest.approx(np.full(40, 0.5 * math.pi / 180))
        made = interpret(named(*pair, ("sigma [mrad]", 0.5 + 0 * K)), ReadOptions())
        assert made.sigma == pytest.approx(np.full(40, 5e-4))
        assert made.value == pytest.approx(40.0 * SWING * math.pi / 180)

    def test_the_least_uncertainty_is_a_step_by_the_root_of_twelve(self):
        whole = np.rint(90.0 * SWING / 4.0) * 4.0
        made = interpret(named(("t", 0.01 * K), ("angle [deg]", whole)), ReadOptions())
        assert made.least_sigma == pytest.approx(4.0 * math.pi / 180 / math.sqrt(12.0))

    def test_a_signal_is_taken_as_the_quantity(self):
        made = interpret(named(("t", 0.01 * K), ("angle [mV]", SWING)), ReadOptions())
        assert made.value == pytest.approx(SWING)
        assert any("1 mV is taken as 1 rad," in n for n in made.notes)


class TestChecks:
    def made(self, time=None, value=None, sigma=None, notes=None):
        count = len(time) if time is not None else len(value)
        time = 0.1 * np.arange(count) if time is None else np.asarray(time, dtype=float)
        value = SWING[:count] if value is None else np.asarray(value, dtype=float)
        raw = named(("t", time), ("angle", value))
        given = None if sigma is None else np.asarray(sigma, dtype=float)
        return module.checked(
            raw, "angle", time, value, given, [] if notes is None else notes, least_sigma=0.1
        )

    def test_rows_without_time_value_or_weight_are_excluded(self):
        time, value, sigma = 0.1 * K, SWING.copy(), np.full(40, 0.2)
        time[3] = np.nan
        value[[5, 6]] = np.nan
        sigma[9] = np.inf
        sigma[5] = np.nan
        made = self.made(time, value, sigma)
        kept = np.setdiff1d(np.arange(40), [3, 5, 6, 9])
        assert made.line.tolist() == (kept + 1).tolist()
        assert made.value == pytest.approx(SWING[kept])
        assert made.least_sigma == 0.1
        texts = " ".join(made.notes)
        assert "1 rows without a time were excluded (first: line 4)" in texts
        assert "1 rows with an infinite sigma" in texts
        assert "(first: line 10)" in texts
        assert "2 rows without a value were excluded (first: line 6)" in texts

    @pytest.mark.parametrize(
        ("wrong", "words"),
        [
            (np.nan, "line 8: the sigma is missing"),
            (0.0, "line 8: the sigma is not positive"),
            (-1.0, "not positive"),
        ],
    )
    def test_an_uncertainty_is_positive(self, wrong, words):
        sigma = np.full(40, 0.2)
        sigma[7] = wrong
        with pytest.raises(DatasetError, match=words):
            self.made(value=SWING, sigma=sigma)

    @pytest.mark.parametrize(
        ("count", "refused"), [(module.MIN_SAMPLES, False), (module.MIN_SAMPLES - 1, True)]
    )
    def test_a_record_has_a_least_number_of_samples(self, count, refused):
        if refused:
            with pytest.raises(DatasetError, match=f"has {count} samples"):
                self.made(value=SWING[:count])
        else:
            assert len(self.made(value=SWING[:count]).time) == count

    def test_a_constant_record_is_refused(self):
        with pytest.raises(DatasetError, match="all 40 angles are 2 rad"):
            self.made(value=np.full(40, 2.0))

    def test_repeated_times_are_averaged(self):
        time = np.repeat(0.1 * np.arange(20), 2)
        value = np.repeat(SWING[:20], 2) + np.tile([0.1, -0.1], 20)
        made = self.made(time, value, np.tile([0.3, 0.4], 20))
        assert made.time == pytest.approx(0.1 * np.arange(20))
        assert made.value == pytest.approx(SWING[:20])
        assert made.sigma == pytest.approx(np.full(20, 0.25))
        assert made.line.tolist() == list(range(1, 41, 2))
        assert any("20 repeated times (first: line 2)" in n for n in made.notes)

    @pytest.mark.parametrize(("repeats", "refused"), [(28, False), (29, True)])
    def test_seven_rows_in_ten_may_repeat_a_time(self, repeats, refused):
        time = np.concatenate([np.arange(40.0 - repeats), np.full(repeats, 39.0 - repeats)])
        if refused:
            with pytest.raises(DatasetError, match="29 of 40 rows repeat a time"):
                self.made(time, SWING)
        else:
            assert len(self.made(time, SWING).time) == 12

    @pytest.mark.parametrize(
        ("size", "step", "wrapped"),
        [(1.04, 0.6, True), (1.06, 0.6, False), (1.0, 0.49, False), (1.0, 0.51, True)],
    )
    def test_angles_are_wrapped_within_a_turn_with_steps_of_half_a_turn(self, size, step, wrapped):
        value = np.concatenate([np.linspace(0.0, size, 20), [size, size - step]]) * TURN
        assert module.is_wrapped(value) == wrapped


class TestScatter:
    @pytest.mark.parametrize(("order", "degree"), [(3, 3), (7, 7)])
    def test_residuals_of_white_noise_are_those_of_the_lowest_sufficient_degree(self, order, degree):
        rng = np.random.default_rng(0)
        time = np.arange(3000) / 100
        x = (np.arange(3000) % 15 - 7.0) / 7.0
        noise = rng.normal(0.0, 0.01, 3000)
        found = module.scatter(time, noise + 3.0 * x**order)
        # the running median of 41 blocks has a standard error of 8 %
        assert np.median(found) == pytest.approx(0.01, rel=0.1)
        by_degree = []
        for block in noise.reshape(-1, 15):
            fit = np.polynomial.Polynomial.fit(x[:15], block, degree)
            by_degree.append(np.sum((block - fit(x[:15])) ** 2) / (14 - degree))
        free = 14 - degree
        expected = math.sqrt(np.median(by_degree) / (1 - 2 / (9 * free)) ** 3)
        assert np.median(found) == pytest.approx(expected, rel=0.04)

    @pytest.mark.parametrize("samples_per_period", [3.3, 5.0, 7.0, 11.2, 14.0, 20.0])
    def test_a_fast_oscillation_is_not_noise(self, samples_per_period):
        rng, time = np.random.default_rng(3), np.arange(300) / 12
        swing = 0.6 * np.exp(-time / 60) * np.sin(TURN * 12 / samples_per_period * time + 1.0)
        found = module.scatter(time, 7.0 + swing + rng.normal(0.0, 0.01, 300))
        assert np.median(found) == pytest.approx(0.01, rel=0.25)

    def test_the_frequency_of_a_fast_oscillation_may_change_by_7_percent(self):
        rng, time = np.random.default_rng(4), np.arange(300) / 12
        phase = TURN * 1.5 * (time + 0.07 * time**2 / (2 * time[-1]))
        found = module.scatter(time, 0.6 * np.sin(phase) + rng.normal(0.0, 0.01, 300))
        assert np.median(found) == pytest.approx(0.01, rel=0.4)

    def test_smoothed_noise_does_not_oscillate(self):
        noise = gaussian_filter1d(np.random.default_rng(5).normal(0.0, 1.0, 3000), 1.0)
        cubics = noise.reshape(-1, 15)
        cubics = cubics - np.array(
            [np.polynomial.Polynomial.fit(range(15), c, 3)(np.arange(15)) for c in cubics]
        )
        assert np.median(module.scatter(np.arange(3000.0), noise)) == pytest.approx(
            math.sqrt(np.median((cubics**2).sum(axis=1)) / 11), rel=0.1
        )

    def test_a_change_of_the_noise_is_followed(self):
        noise = np.random.default_rng(1).normal(0.0, 1.0, 6000) * np.where(np.arange(6000) < 3000, 0.01, 0.03)
        found = module.scatter(np.arange(6000) / 100, noise)
        assert np.median(found[:2500]) == pytest.approx(0.01, rel=0.1)
        assert np.median(found[3500:]) == pytest.approx(0.03, rel=0.1)

    def test_a_body_at_rest_has_the_noise_of_its_motion(self):
        noise = np.random.default_rng(2).normal(0.0, 0.01, 3000)
        noise[:1500] = 0.0
        found = module.scatter(np.arange(3000) / 100, noise)
        assert found[:1000] == pytest.approx(np.full(1000, np.median(found[2000:])), rel=0.15)
        assert module.scatter(np.arange(90) / 100, np.zeros(90)) == pytest.approx(np.full(90, 1e-6))
        assert module.scatter(np.arange(90) / 100, np.zeros(90), 0.2) == pytest.approx(np.full(90, 0.2))

    def test_eight_samples_have_a_scatter(self):
        found = module.scatter(np.arange(8.0), np.array([1.0, -1, 1, -1, 1, -1, 1, -1]))
        assert 0.5 < found[0] < 4.0
        assert found == pytest.approx(np.full(8, found[0]))


@pytest.mark.parametrize("few", [1, 2, 5])
def test_a_gap_near_the_end_of_a_record_is_found(few):
    """A window of eleven intervals about a gap at the end must not consist of copies of this gap."""
    time = np.concatenate([0.01 * np.arange(60), 10.0 + 0.01 * np.arange(few)])
    assert module.pieces(time) == [slice(0, 60), slice(60, 60 + few)]
    assert module.pieces(-time[::-1]) == [slice(0, few), slice(few, 60 + few)]


def test_pieces_end_at_gaps_of_twenty_intervals():
    for gap, expected in ((19.0, [(0, 60)]), (21.0, [(0, 30), (30, 60)])):
        step = np.ones(59)
        step[29] = gap
        found = module.pieces(np.concatenate([[0.0], np.cumsum(step)]))
        assert [(p.start, p.stop) for p in found] == expected
    assert module.pieces(np.zeros(1)) == [slice(0, 1)]
