"""Pulses by hand: which edges, doubles, gaps and counts are taken, on either side of each threshold."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrotrack import DatasetError, UsageError
from gyrotrack.io.readers import _pulses as module
from gyrotrack.io.readers._motion_table import ReadOptions, read_names
from gyrotrack.io.readers._pulses import (
    clock_scale,
    counters_of,
    from_counts,
    from_events,
    is_regular,
    is_sampled,
    mark_errors,
    passages_of,
    read_counter,
    read_pulses,
    rising_edges,
    sampled_counts,
    signal_columns,
    varies_both_ways,
)
from gyrotrack.io.readers._raw_table import RawTable
from gyrotrack.io.readers._registry import _from_table

TURN = 2 * math.pi
PATH = Path("pulses.csv")


def table(*columns, names=None):
    names = tuple(names or [""] * len(columns))
    columns = tuple(np.asarray(c, dtype=float) for c in columns)
    return RawTable(PATH, names, ("",) * len(names), columns, np.arange(len(columns[0])) + 2)


def slowing(count=80, first=0.1, growth=1.01):
    """Times of pulses whose intervals grow by a constant factor."""
    return np.concatenate([[0.0], np.cumsum(first * growth ** np.arange(count - 1))])


class TestSampled:
    @pytest.mark.parametrize(
        ("deviation", "share", "sampled"),
        [(0.009, 0.45, True), (0.011, 0.45, False), (0.5, 0.08, True), (0.5, 0.12, False)],
    )
    def test_nine_in_ten_intervals_of_a_sampler_are_equal_within_a_hundredth(self, deviation, share, sampled):
        step = np.full(1000, 0.1)
        few = int(1000 * share)
        step[:few] *= 1 + deviation * np.where(np.arange(few) % 2, 1, -1)
        assert is_sampled(np.cumsum(step)) is sampled

    def test_repeated_times_are_not_clock(self):
        assert not is_sampled(np.zeros(20))
        assert not is_sampled(np.zeros(1))

    def test_a_signal_has_eight_values(self):
        levels = np.tile(np.arange(7.0), 5)
        assert signal_columns(table(np.arange(35.0), levels, levels + np.eye(35)[3] * 9), 0) == [2]

    @pytest.mark.parametrize(
        ("marker", "columns"), [(None, [1, 2]), ("LIGHT", [1]), ("otor", [2]), ("x", [])]
    )
    def test_a_signal_is_selected_by_a_part_of_its_name_in_upper_or_lower_case(self, marker, columns):
        values = np.arange(20.0)
        raw = table(values, values, values, names=["t", "Light", "motor"])
        assert module._signals(raw, 0, ReadOptions(marker=marker)) == columns

    @pytest.mark.parametrize(("change", "regular"), [(1.34, True), (1.36, False)])
    def test_intervals_of_a_rotation_change_by_less_than_three_tenths(self, change, regular):
        """exp(0.3) = 1.35."""
        step = np.where(np.arange(50) % 2, 1.0, change)
        assert is_regular(np.cumsum(step)) is regular
        assert not is_regular(np.array([0.0, 1.0, 2.0]))


def triangle(t, period=1.0):
    """A triangle wave between -1 and 1 that rises through zero at whole periods."""
    return 2 / np.pi * np.arcsin(np.sin(2 * np.pi * t / period))


class TestEdges:
    def test_pulses_are_where_the_signal_rises_through_its_middle(self):
        t = np.arange(0.0, 20.0, 0.013)
        edges, after = rising_edges(t, triangle(t), "v", [])
        assert edges == pytest.approx(np.round(edges), abs=2e-3)
        assert np.diff(edges) == pytest.approx(np.ones(len(edges) - 1), abs=4e-3)
        assert len(edges) >= 19
        assert (t[after] >= edges).all()
        assert (t[after - 1] < edges).all()
        falling, _ = rising_edges(t, -triangle(t), "v", [])
        assert falling % 1.0 == pytest.approx(np.full(len(falling), 0.5), abs=4e-3)

    @pytest.mark.parametrize(
        ("probe", "more"),
        [
            ([0.0, 0.66, 0.0], 0),
            ([0.0, 0.68, 0.0], 1),
            ([1.0, 0.34, 1.0], 0),
            ([1.0, 0.32, 1.0], 1),
            ([0.0, 0.45, 0.55, 0.45, 0.55, 0.0], 0),
        ],
    )
    def test_the_trigger_is_armed_below_a_third_and_fires_above_two_thirds(self, probe, more):
        """Beside forty pulses between 0 and 1."""
        square = [0.0, 0.0, 1.0, 1.0] * 20
        signal = np.array([*square, *([0.0] if probe[0] == 0 else []), *probe, *square])
        edges, after = module._edges(np.arange(float(len(signal))), signal, len(signal))
        assert len(edges) == 40 + more
        assert edges[:3] == pytest.approx([1.5, 5.5, 9.5])
        assert after[:3].tolist() == [2, 6, 10]

    def test_a_weak_part_of_the_signal_is_not_a_pulse(self):
        """Below a quarter of the typical height the body is at rest."""
        t = np.arange(0.0, 40.0, 0.01)
        for height, most in ((0.22, 21), (0.28, 41)):
            size = np.where(t < 30.0, 1.0, height)
            edges, _ = module._edges(t, size * triangle(t), 200)
            assert (edges > 32.0).any() == (most == 41)

    def test_slow_levels_are_followed(self):
        t = np.arange(0.0, 60.0, 0.02)
        edges, _ = rising_edges(t, triangle(t) + 0.8 * np.sin(2 * np.pi * t / 60.0), "v", [])
        assert len(edges) >= 57
        assert np.abs(edges - np.round(edges)).max() < 0.15

    @pytest.mark.parametrize(
        ("drift", "tolerance"),
        [
            (lambda t: 0.0 * t, 0.001),
            (lambda t: 10.0 * t / 20.0, 0.02),
            (lambda t: 3.0 * np.exp(-t / 5.0), 0.02),
            (lambda t: 3.0 * np.sin(2 * np.pi * t / 15.0), 0.02),
        ],
    )
    def test_a_drift_larger_than_the_amplitude_hides_no_pulse(self, drift, tolerance):
        """A sine of amplitude 0.5 with two periods a second rises through its middle at 0.5 s, 1 s ..."""
        t = np.arange(0.0, 20.0, 0.01)
        edges, _ = rising_edges(t, drift(t) + 0.5 * np.sin(4 * np.pi * t), "pulses", notes := [])
        expected = 0.5 * np.round(2 * edges)
        assert len(edges) >= 37
        assert np.unique(expected).size == len(edges)
        assert np.abs(edges - expected).max() < tolerance
        assert not notes

    @pytest.mark.parametrize(
        "drift",
        [lambda t: 3.0 * np.maximum(t - 9.0, 0.0), lambda t: 3.0 * np.clip(t - 5.0, 0.0, 9.0)],
        ids=["in the second half", "in the middle"],
    )
    def test_a_drift_in_a_part_of_the_record_hides_no_pulse(self, drift):
        """Elsewhere the pulses are regular as they are."""
        t = np.arange(0.0, 20.0, 0.01)
        edges, _ = rising_edges(t, drift(t) + 0.5 * np.sin(4 * np.pi * t), "pulses", [])
        expected = 0.5 * np.round(2 * edges)
        assert len(edges) >= 34
        assert np.unique(expected).size == len(edges)
        assert np.abs(edges - expected).max() < 0.05

    @pytest.mark.parametrize(
        ("span", "gap", "sought"),
        [(1620, 110, False), (1580, 10, True), (1620, 130, True), (1620, 10, False)],
    )
    def test_no_drift_is_sought_where_pulses_are_regular_throughout(self, monkeypatch, span, gap, sought):
        """In four fifths of 2000 samples, without a time of twelve periods of 10 samples in which there is none."""
        t = np.arange(0.0, 20.0, 0.01)
        signal = np.sin(20 * np.pi * t)
        after = np.arange(0, span + 1, 10)
        with_gap = after[(after <= 800) | (after >= 800 + gap)]

        def edges(time, values):
            found = with_gap if values is signal else np.arange(0, 3000, 10)
            return 0.01 * found, found

        monkeypatch.setattr(module, "_local_edges", edges)
        assert (module._without_drift(t, signal) is not signal) is sought

    @pytest.mark.parametrize(("revealed", "removed"), [(49, False), (51, True)])
    def test_a_drift_is_removed_if_a_quarter_more_pulses_appear(self, monkeypatch, revealed, removed):
        """Forty pulses with it in half of the record."""
        t = np.arange(0.0, 20.0, 0.01)
        signal = 0.5 * np.sin(4 * np.pi * t)

        def edges(time, values):
            count = 40 if values is signal else revealed
            return 0.25 * np.arange(count), 10 * np.arange(count)

        monkeypatch.setattr(module, "_local_edges", edges)
        assert (module._without_drift(t, signal) is not signal) is removed

    def test_noise_without_pulses_stays_without_regular_edges(self):
        random = np.random.default_rng(0)
        for _ in range(5):
            edges, _ = rising_edges(np.arange(2000) * 0.01, random.standard_normal(2000), "pulses", [])
            assert not is_regular(edges)

    @pytest.mark.parametrize(("samples", "enough"), [(4.4, True), (3.4, False)])
    def test_a_pulse_needs_four_samples(self, samples, enough):
        t = np.arange(0.0, 100.0, 1 / samples)
        if enough:
            edges, _ = rising_edges(t, np.sin(2 * np.pi * t), "v", [])
            assert len(edges) > 80
        else:
            with pytest.raises(DatasetError, match="samples per pulse"):
                rising_edges(t, np.sin(2 * np.pi * t), "v", [])

    def test_the_longest_stretch_with_enough_samples_is_used(self):
        t = np.arange(0.0, 60.0, 0.05)
        turns = np.where(t < 20.0, 9.0 * t, 180.0 + 0.5 * (t - 20.0))
        notes = []
        edges, _ = rising_edges(t, np.sin(2 * np.pi * turns), "v", notes)
        assert edges[0] > 19.0
        assert "fewer than 4 samples per pulse" in notes[0]


class TestIntervals:
    def test_typical_intervals_are_of_the_neighbours_on_both_sides(self):
        step = np.array([1.0, 1.0, 1.0, 50.0, 4.0, 4.0, 4.0])
        found = module._typical_interval(step)
        assert found[3] == pytest.approx(2.0)  # the geometric mean of 1 and 4, without itself
        assert module._typical_interval(np.array([3.0, 5.0])) == pytest.approx([4.0, 4.0])
        assert len(module._typical_interval(np.zeros(0))) == 0

    def test_at_the_end_the_speed_is_continued(self):
        """Of a body that slows down at a constant rate the last intervals are as expected."""
        speed, rate = 10.0, 0.4
        k = np.arange(60)
        time = (speed - np.sqrt(speed**2 - 2 * rate * k)) / rate
        step = np.diff(time)
        ratio = module._ratios_at_end(step)
        assert ratio == pytest.approx(np.ones(59), abs=2e-3)
        missed = np.diff(np.delete(time, -2))
        assert module._ratios_at_end(missed)[-1] == pytest.approx(2.0, abs=0.02)

    def test_a_body_that_comes_to_rest_has_no_expected_interval(self):
        step = np.append(np.full(20, 0.1), [0.2, 0.5, 3.0])
        ratio = module._ratios_at_end(step)
        assert ratio[-1] == 1.0 or ratio[-1] > 1.5
        assert module._ratios_at_end(np.full(3, 0.1)).tolist() == [1.0] * 3

    def test_an_interval_after_a_missed_pulse_is_one_interval(self):
        """The last but one pulse but two is missing."""
        k = np.arange(60)
        time = (10.0 - np.sqrt(100.0 - 0.8 * k)) / 0.4
        ratio = module._ratios_at_end(np.diff(np.delete(time, -3)))
        assert ratio[-2:] == pytest.approx([2.0, 1.0], abs=0.02)

    @pytest.mark.parametrize("last", [0.03, 0.1, 0.2, 0.5])
    @pytest.mark.parametrize("sense", [1, -1], ids=["comes to rest", "starts"])
    def test_no_pulse_is_missing_where_a_body_comes_to_rest(self, last, sense):
        """At a constant acceleration, `last` turns from its rest."""
        left = last + np.arange(40.0)
        time = sense * np.sqrt(left)
        found, notes = read(np.sort(time))
        assert found.value[-1] - found.value[0] == pytest.approx(TURN * 39)
        assert not any("missed" in n for n in (*found.notes, *notes))

    def test_missed_pulses_of_a_counter_are_as_large_as_its_steps(self):
        step = np.full(60, 0.1)
        step[30] = 0.3
        time, count = np.concatenate([[0.0], np.cumsum(step)]), 2.0 * np.arange(61)
        found = module._with_missed_pulses(table(time), time, count, np.arange(61), [])
        # 0.05 s for a count, and 0.3 s for two counts and four that were missed
        assert found == pytest.approx(count + 4.0 * (np.arange(61) > 30))

    def test_a_rest_is_not_made_of_missed_pulses(self):
        """28 and 22 intervals between different speeds: at most 20 pulses are missed."""
        step = np.where(np.arange(60) > 30, 0.1 * math.exp(0.5), 0.1)
        step[30] = 0.1 * 28.0
        time, count = np.concatenate([[0.0], np.cumsum(step)]), np.arange(61.0)
        assert module._with_missed_pulses(table(time), time, count, np.arange(61), []) is count

    @pytest.mark.parametrize(("counted", "refused"), [(1.0, True), (2.0, False)])
    def test_a_gap_in_which_a_counter_counts_is_not_refused(self, counted, refused):
        step, ratio, steps = np.full(40, 0.1), np.ones(40), np.ones(40)
        step[20], ratio[20], steps[20] = 2.5, 25.0, counted
        if refused:
            with pytest.raises(DatasetError, match="line 21"):
                module._refuse_gap(table(np.arange(41.0)), step, ratio, steps, np.arange(41))
        else:
            module._refuse_gap(table(np.arange(41.0)), step, ratio, steps, np.arange(41))


def read(time, per_turn=1.0, **options):
    notes = []
    time = np.asarray(time, dtype=float)
    found = from_events(table(time), time, np.arange(len(time)) + 2, per_turn, notes)
    return found, notes


class TestEvents:
    @pytest.mark.parametrize("lost", [1, 2, 5])
    def test_missed_pulses_are_counted(self, lost):
        time = slowing()
        kept = np.delete(time, np.arange(40, 40 + lost))
        found, notes = read(kept)
        assert found.value[-1] - found.value[0] == pytest.approx(TURN * 79, abs=0.05)
        assert f"{lost} missed pulses were added" in " ".join(found.notes + tuple(notes))
        assert f"before line {40 + 2}" in " ".join(found.notes)

    @pytest.mark.parametrize(
        ("lost", "doubled"), [((120,), ()), ((120, 260), ()), ((120,), (300,)), ((), (300,))]
    )
    def test_counts_of_times_that_scatter_are_continued_over_missed_pulses(self, lost, doubled):
        """Intervals scatter by 20 %: each pulse after a missed one is a turn later."""
        true = np.cumsum(np.full(400, 0.1) * 1.001 ** np.arange(400))
        time = true + np.random.default_rng(3).normal(0, 0.012, 400)
        kept = np.delete(time, lost)
        extra = time[list(doubled)] + 0.02
        found, notes = read(np.sort(np.concatenate([kept, extra])))
        said = " ".join(notes)
        assert (f"{len(lost)} missed pulses were added" in said) == bool(lost)
        assert (f"{len(doubled)} double pulses were excluded" in said) == bool(doubled)
        expected = TURN * np.interp(found.time, true, np.arange(400.0))
        off = found.value - expected
        assert np.abs(off - np.median(off)).max() < 0.5 * TURN

    @pytest.mark.parametrize(("stretch", "added"), [(2.23, 1), (2.25, 0), (1.77, 1), (1.75, 0), (1.3, 0)])
    def test_an_interval_of_a_whole_multiple_is_a_missed_pulse(self, stretch, added):
        """Within 12 %."""
        step = np.full(60, 0.1)
        step[30] *= stretch
        found, _ = read(np.concatenate([[0.0], np.cumsum(step)]))
        assert found.value[-1] - found.value[0] == pytest.approx(TURN * (60 + added), abs=0.01)

    @pytest.mark.parametrize("where", [20, 50])
    def test_double_pulses_are_left_out(self, where):
        time = slowing()
        double = np.insert(time, where + 1, time[where] + 0.1 * (time[where + 1] - time[where]))
        found, notes = read(double)
        assert len(found.time) == 80
        assert time[where] in found.time
        assert found.value[-1] - found.value[0] == pytest.approx(TURN * 79, abs=0.01)
        assert any("1 double pulses were excluded" in n for n in notes)

    @pytest.mark.parametrize(("share", "double"), [(0.34, True), (0.36, False)])
    def test_a_pulse_closer_than_0_35_intervals_is_double(self, share, double):
        time = np.arange(60.0)
        assert module._not_double(np.insert(time, 31, 30.0 + share)).all() is np.bool_(not double)

    @pytest.mark.parametrize("early", [0.3, 0.64, 0.66, 0.7, 0.75, 0.9, -0.64, -0.66, -0.7, -0.75])
    def test_a_displaced_pulse_is_still_one_turn(self, early):
        """Beyond 0.65 of an interval it counts as a double pulse, and its place as a missed one."""
        time = slowing()
        moved = time.copy()
        moved[40] -= early * (time[40] - time[39] if early > 0 else time[41] - time[40])
        found, _ = read(moved)
        assert found.value[-1] - found.value[0] == pytest.approx(TURN * 79, abs=0.05)
        said = " ".join(found.notes)
        assert ("1 double pulses were excluded" in said) == ("1 missed pulses were added" in said)
        assert ("1 missed pulses were added" in said) == (abs(early) > 0.65)
        assert (moved[40] in found.time) == (abs(early) < 0.65)

    def test_the_more_regular_one_of_two_is_kept(self):
        time = np.arange(60.0)
        early, late = np.insert(time, 31, 30.2), np.insert(time, 30, 29.8)
        assert np.flatnonzero(~module._not_double(early)).tolist() == [31]
        assert np.flatnonzero(~module._not_double(late)).tolist() == [30]

    def test_of_two_double_pulses_in_succession_the_later_ones_are_left_out(self):
        """The second one is judged by intervals without the first one."""
        time = np.insert(np.arange(60.0), [31, 32], [30.1, 31.1])
        assert time[~module._not_double(time)].tolist() == [30.1, 31.1]

    @pytest.mark.parametrize(("longer", "double"), [(1.31, False), (1.29, True)])
    def test_two_pulses_that_approach_each_other_are_not_double(self, longer, double):
        """An interval of 0.3 between two longer ones: with either of them it is more than 1.6."""
        step = np.ones(59)
        step[28:31] = longer, 0.3, longer
        time = np.concatenate([[0.0], np.cumsum(step)])
        assert module._not_double(time).all() == (not double)

    def test_a_gap_at_constant_speed_is_refused(self):
        step = np.full(60, 0.1)
        for gap, refused in ((19.0, False), (22.0, True)):
            step[30] = 0.1 * gap
            if refused:
                with pytest.raises(DatasetError, match="without a pulse"):
                    read(np.concatenate([[0.0], np.cumsum(step)]))
            else:
                read(np.concatenate([[0.0], np.cumsum(step)]))
        slower = np.where(np.arange(60) > 30, 0.1 * math.exp(0.31), 0.1)
        slower[30] = 2.3
        read(np.concatenate([[0.0], np.cumsum(slower)]))  # it rested, and turned on at another speed

    @pytest.mark.parametrize(("count", "enough"), [(8, True), (7, False)])
    def test_eight_pulses_are_needed(self, count, enough):
        if enough:
            assert len(read(np.arange(float(count)))[0].time) == 8
        else:
            with pytest.raises(DatasetError, match="at least 8"):
                read(np.arange(float(count)))

    @pytest.mark.parametrize(("repeated", "refused"), [(19, False), (21, True)])
    def test_half_of_the_times_may_be_repeated(self, repeated, refused):
        time = np.sort(
            np.concatenate(
                [np.arange(20.0), np.arange(20.0)[: min(repeated, 20)], np.zeros(max(repeated - 20, 0))]
            )
        )
        if refused:
            with pytest.raises(DatasetError, match="are repeated"):
                read(time)
        else:
            assert len(read(time)[0].time) == 20

    @pytest.mark.parametrize(
        ("swing", "waves", "driven"), [(0.25, 3, True), (0.15, 3, False), (0.25, 0.9, False)]
    )
    def test_a_speed_that_rises_and_falls_is_driven(self, swing, waves, driven):
        """Twice by a fifth or more between turning points."""
        k = np.arange(400)
        step = 0.1 * np.exp(0.5 * swing * np.cos(2 * np.pi * waves * k / 400))
        time = np.cumsum(step)
        assert varies_both_ways(time) is driven
        if driven:
            assert any("missed and double pulses are not looked for" in n for n in read(time)[1])
        assert not varies_both_ways(time[:15])

    @pytest.mark.parametrize(
        ("ratio", "steps"),
        [
            (0.59, [-1]),  # a short interval: a double pulse, and never more than one
            (0.61, [0]),  # neither short nor long
            (1.39, [0]),
            (1.41, [1]),  # round(0.41 + 2 * 0.2) = 1 missed pulse at most
            (2.3, [2]),  # round(1.3 + 0.4) = 2
            (1.95, [1]),
        ],
    )
    def test_steps_that_an_interval_allows(self, ratio, steps):
        """All later counts are wrong by three, in the sense of the interval; its length limits the step."""
        time, ratios = np.arange(200.0), np.ones(199)
        ratios[99] = ratio
        shift = 3.0 if ratio > 1 else -3.0
        moved = time + shift * (np.arange(200) >= 100)
        found = module._steps_of_part(moved, ratios, 0.2)
        assert found[99] == steps[0]
        assert np.count_nonzero(found) == (steps != [0])

    @pytest.mark.parametrize(("shift", "made"), [(0.45, False), (0.55, True), (-0.45, False), (-0.55, True)])
    def test_a_step_is_of_more_than_half_a_count(self, shift, made):
        ratios = np.ones(199)
        ratios[99] = 1.5 if shift > 0 else 0.5
        moved = np.arange(200.0) + shift * (np.arange(200) >= 100)
        found = module._steps_of_part(moved, ratios, 0.01 if shift < 0 else 0.26)
        assert found[99] == (np.sign(shift) if made else 0)

    @pytest.mark.parametrize(("jitter", "regular"), [(0.086, True), (0.089, False)])
    def test_single_intervals_show_missed_pulses_up_to_a_scatter_of_13_percent(
        self, monkeypatch, jitter, regular
    ):
        """Intervals of 1 +- a: a normal scatter of a / 0.6745."""
        monkeypatch.setattr(module, "_typical_interval", np.ones_like)
        monkeypatch.setattr(module, "_steps_of_part", lambda time, ratio, spread: np.zeros(len(ratio)))
        time = np.cumsum(1.0 + jitter * np.where(np.arange(201) % 2, 1.0, -1.0))
        assert (module._steps_of_jittering_counts(time) is None) is regular

    def test_steps_of_parts_are_those_of_their_pulses(self, monkeypatch):
        """7000 pulses in parts of 3000: each is given its own time as a step."""
        monkeypatch.setattr(module, "_typical_interval", lambda step: np.full(len(step), 1.0))
        monkeypatch.setattr(module, "_steps_of_part", lambda time, ratio, spread: np.rint(time[1:]))
        time = np.arange(7001.0) + 0.3 * (np.arange(7001) % 2)
        assert module._steps_of_jittering_counts(time)[1:].tolist() == np.rint(time[1:]).tolist()

    def test_jitter_is_not_a_drive(self):
        """Jitter of 5 %, which a median of five intervals hides up to 0.3, beside a swing of 0.4 and beside none."""
        rng = np.random.default_rng(4)
        for swing, driven in ((0.2, True), (0.0, False)):
            interval = 0.03 * np.exp(swing * np.sin(np.arange(5000) / 40))
            time = np.cumsum(interval) + 0.05 * interval * rng.standard_normal(5000)
            assert varies_both_ways(np.sort(time)) is driven

    def test_a_step_against_the_sense_of_its_interval_is_not_made(self):
        for ratio, shift in ((0.5, 3.0), (1.5, -3.0)):
            ratios = np.ones(199)
            ratios[99] = ratio
            moved = np.arange(200.0) + shift * (np.arange(200) >= 100)
            assert not module._steps_of_part(moved, ratios, 0.2).any()

    def test_jittering_counts_are_described_together(self):
        """A fifth of an interval of jitter: single intervals show nothing, a spline through the counts does."""
        rng = np.random.default_rng(2)
        time = np.arange(400.0) + 0.14 * rng.standard_normal(400)
        kept = np.delete(np.sort(time), [150])
        steps = module._steps_of_jittering_counts(kept)
        assert steps.sum() == 1
        assert abs(int(np.flatnonzero(steps)[0]) - 150) <= 3
        double = np.insert(np.sort(time), 201, np.sort(time)[200] + 0.2)
        steps = module._steps_of_jittering_counts(double)
        assert steps.sum() == -1
        assert module._steps_of_jittering_counts(np.arange(400.0)) is None
        assert module._steps_of_jittering_counts(kept[:60]) is None
        assert module._steps_of_jittering_counts(kept[:61]) is not None


class TestCounts:
    def test_angles_and_their_uncertainty(self):
        """10 turns a second, three pulses a turn, times rounded to 1 ms: omega / sqrt(12) ms."""
        time = np.round(np.arange(300) / 30.0, 3)
        notes = []
        found = from_counts(table(time), time, np.arange(300.0), np.arange(300), 3.0, notes)
        assert found.value == pytest.approx(TURN * np.arange(300) / 3.0, abs=0.03)
        assert np.median(found.sigma) == pytest.approx(TURN * 10.0 * 1e-3 / math.sqrt(12), rel=0.15)
        assert "resolution of the clock 1e+03 us" in notes[-1]

    @pytest.mark.parametrize(
        ("unit", "step", "expected"), [(1e-3, 5, 5e-3), (1e-6, 4, 4e-6), (1e-3, 1, 1e-3), (1.7e-7, 1, 0.0)]
    )
    def test_the_resolution_of_a_clock_is_the_common_divisor(self, unit, step, expected):
        ticks = step * np.cumsum(np.array([7, 4, 9, 11, 6, 5, 8, 13]))
        assert module._clock_resolution(unit * ticks) == pytest.approx(expected)

    @pytest.mark.parametrize("error", [0.05, -0.05])
    def test_errors_of_marks_are_removed(self, error):
        """One of four marks is displaced; the mean error is zero."""
        k = np.arange(400)
        time = (k + error * (k % 4 == 2)) / 4.0
        notes = []
        found, (mode,) = mark_errors(time, k.astype(float), 4.0, table(time), notes)
        displaced = np.where(k % 4 == 2, 0.75 * -error, 0.25 * error)
        assert found == pytest.approx(displaced, abs=1e-3)
        # an error of the same size remains possible in each turn, with mean zero
        u = np.sqrt(np.sum((mode.basis @ mode.covariance) * mode.basis, axis=1))
        assert u == pytest.approx(np.full(400, u[0]))
        assert u[0] == pytest.approx(TURN / 4 * np.sqrt(np.mean(displaced**2)), rel=0.3)
        assert np.abs(mode.basis[:4].sum(axis=0)).max() < 1e-12
        made = from_counts(table(time), time, k.astype(float), k, 4.0, [])
        assert made.modes[0].name == "marks"
        assert made.value - TURN * time == pytest.approx(
            np.full(400, (made.value - TURN * time).mean()), abs=1e-3
        )

    @pytest.mark.parametrize(("per_turn", "count"), [(1.0, 400), (2.5, 400), (513.0, 5200), (50.0, 400)])
    def test_marks_without_enough_turns_have_no_known_errors(self, per_turn, count):
        k = np.arange(count)
        time = (k + 0.2 * (k % 2)) / per_turn
        errors, modes = mark_errors(time, k.astype(float), per_turn, table(time), [])
        assert not errors.any()
        assert modes == ()

    @pytest.mark.parametrize(("size", "least", "most"), [(0.006, 0.0, 0.25), (0.016, 0.9, 1.0)])
    def test_insignificant_errors_stay(self, size, least, most):
        """Of one of four marks in a hundred turns whose times scatter by 0.02 of an interval.

        chi2 / dof = 1 + (3 / 16) (size / u)^2 with u = 0.02 sqrt(3 pi / 800), 5 for a size of 0.01; 5.3 is significant.
        """
        k = np.arange(400)
        found = 0
        for seed in range(40):
            jitter = 0.02 * np.random.default_rng(seed).standard_normal(400)
            time = (k + np.where(k % 4 == 2, size, 0.0) + jitter) / 4.0
            errors, modes = mark_errors(time, k.astype(float), 4.0, table(time), [])
            assert errors.any() == bool(modes)
            found += len(modes)
        assert least * 40 <= found <= most * 40

    @pytest.mark.parametrize(
        ("marks", "turns", "lost"),
        [
            *((2, 60, 0.0), (2, 60, 0.02), (4, 40, 0.0), (4, 40, 0.02), (20, 40, 0.02), (60, 40, 0.0)),
            *(pytest.param(*p, marks=pytest.mark.slow) for p in ((20, 40, 0.0), (60, 40, 0.02))),
            *(pytest.param(60, 100, lost, marks=pytest.mark.slow) for lost in (0.0, 0.02)),
        ],
    )
    def test_equal_marks_are_not_corrected(self, marks, turns, lost):
        """Times that scatter by 0.02 of an interval, also of mark 0: 0.1 % are significant by chance."""
        found = 0
        for seed in range(60):
            rng = np.random.default_rng(seed)
            k = np.flatnonzero(rng.random(marks * turns) >= lost)
            time = (k + 0.02 * rng.standard_normal(len(k))) / marks
            found += len(mark_errors(time, k.astype(float), float(marks), table(time), [])[1])
        assert found <= 1

    @pytest.mark.parametrize(("ratio", "significant"), [(0.562, False), (0.577, True)])
    def test_two_marks_differ_by_three_standard_deviations_of_the_cube_root(self, ratio, significant):
        """54 turns; mark 1 is displaced by d and by +-s from turn to turn, of which half is that of the turn.

        t^2 = (2 / pi) (d / s)^2 (54 - 3) for both marks; (1 - 2 / 9 + 3 sqrt(2 / 9))^3 = 10.53, for d / s = 0.5695.
        """
        k = np.arange(109)
        displaced = np.where(k % 2, 0.02 * (ratio + np.where(k // 2 % 2, 1.0, -1.0)), 0.0)
        errors, modes = mark_errors((k + displaced) / 2.0, k.astype(float), 2.0, table(k), [])
        assert bool(modes) is significant
        assert errors.any() == significant

    def test_the_mode_of_marks_has_the_variances_of_their_harmonics(self):
        """Eight marks: of one harmonic of an amplitude of 1, 1 / 2 at it and an eighth of the mean square elsewhere."""
        k = np.arange(8)
        mode = module._mark_mode(np.cos(TURN * k / 8), k)
        assert np.diag(mode.covariance) == pytest.approx([1 / 2, 1 / 8, 1 / 8, 1 / 16, 1 / 2, 1 / 8, 1 / 8])
        assert mode.basis[1] == pytest.approx(
            [*np.cos(TURN / 8 * np.arange(1, 5)), *np.sin(TURN / 8 * np.arange(1, 4))]
        )
        alternating = module._mark_mode(np.where(k % 2, -1.0, 1.0), k)
        assert np.diag(alternating.covariance) == pytest.approx(
            [1 / 4, 1 / 4, 1 / 4, 1.0, 1 / 4, 1 / 4, 1 / 4]
        )

    def test_the_resolution_of_a_clock_with_more_digits_is_not_known(self):
        ticks = np.cumsum(np.array([7, 4, 9, 11, 6, 5, 8, 13])) + 0.05 * (np.arange(8) % 2)
        assert module._clock_resolution(1e-6 * ticks) == 0.0

    @pytest.mark.parametrize("sense", [1, -1])
    def test_a_slow_body_with_a_fine_clock_is_known_to_microradians(self, sense):
        """0.5 turns a second, times rounded to 3 us: pi 3 us / sqrt(12) at least."""
        time = 3e-6 * np.round(
            np.arange(100.0) * 2.0 / 3e-6 + np.random.default_rng(0).uniform(-0.5, 0.5, 100)
        )
        found = from_counts(table(time), time, sense * np.arange(100.0), np.arange(100), 1.0, [])
        least = math.pi * 3e-6 / math.sqrt(12)
        assert 0.99 * least < np.median(found.sigma) < 2 * least

    @pytest.mark.parametrize(
        ("scattered", "expected"), [(1e-4, 1e-3 / math.sqrt(12)), (1e-3, 1e-3)], ids=["resolution", "scatter"]
    )
    def test_the_larger_one_of_scatter_and_resolution_counts(self, monkeypatch, scattered, expected):
        """Times in whole milliseconds at 10 turns a second."""
        monkeypatch.setattr(module, "scatter", lambda count, time, floor: np.full(len(time), scattered))
        time = 0.1 * np.arange(50.0) + 1e-3 * (np.arange(50) % 2)
        found = from_counts(table(time), time, np.arange(50.0), np.arange(50), 1.0, [])
        assert found.sigma[1:-1] == pytest.approx(np.full(48, TURN * 10.0 * expected), rel=1e-3)

    @pytest.mark.parametrize("marks", [5, 6, 64, 100])
    def test_the_mode_of_marks_holds_their_variance(self, marks):
        """White errors of the marks have their variance in all harmonics, up to 32 of them."""
        errors = np.random.default_rng(3).standard_normal(marks)
        mode = module._mark_mode(errors - errors.mean(), np.arange(marks))
        share = min(1.0, 64 / (marks - 1))
        variance = np.sum((mode.basis @ mode.covariance) * mode.basis, axis=1).mean()
        assert share * errors.var() * 0.99 <= variance < 2.2 * share * errors.var()
        assert mode.basis.shape == (marks, min(marks - 1, 64))


class TestSampledCounts:
    """A counter that is sampled at equal intervals, 10 counts in a turn."""

    STEP = TURN / 10

    def found(self, angle, dt=0.01):
        time = dt * np.arange(len(angle))
        count = np.floor(angle / self.STEP)
        assert module.counts_coarsely(time, count)
        return module.from_changes(table(time), time, count, np.arange(len(time)), 10.0, [])

    @pytest.mark.parametrize("sense", [1, -1])
    def test_a_slow_body_passes_the_boundaries_of_the_counts(self, sense):
        """0.0707 counts in a row: angles at the changes, right within half a row."""
        turned = sense * 0.0707 * self.STEP * np.arange(3000)
        made = self.found(turned)
        off = made.value - np.interp(made.time, 0.01 * np.arange(3000), turned)
        assert len(made.time) == pytest.approx(212, abs=2)
        assert np.abs(off).max() < 0.51 * 0.0707 * self.STEP
        assert np.sqrt(np.mean(off**2)) == pytest.approx(np.median(made.sigma), rel=0.15)

    def test_a_body_that_slows_down_has_both(self):
        """From 1.9 counts in a row to 0.1: rows at first, changes later; the errors are those that are stated."""
        k = np.arange(4000)
        angle = self.STEP * (1.9 * k - 1.8 * k**2 / 8000)
        made = self.found(angle)
        z = (made.value - np.interp(made.time, 0.01 * k, angle)) / made.sigma
        assert np.abs(z).max() < 2.2
        for part in np.array_split(z, 6):
            assert np.sqrt(np.mean(part**2)) == pytest.approx(1.0, abs=0.2)
            assert abs(part.mean()) < 0.2

    def test_a_body_that_reverses_is_in_the_middle_of_its_count(self):
        k = np.arange(4000)
        angle = 60.95 * self.STEP * np.sin(TURN * k / 2000)
        made = self.found(angle)
        off = made.value - np.interp(made.time, 0.01 * k, angle)
        assert np.abs(off / made.sigma).max() < 3.0
        assert made.value.max() == pytest.approx(60.5 * self.STEP)
        assert made.value.min() == pytest.approx(-60.5 * self.STEP)

    @pytest.mark.parametrize(("rate", "coarse"), [(0.94, True), (0.96, False)])
    def test_rows_with_the_count_of_the_one_before(self, rate, coarse):
        count = np.floor(rate * np.arange(2000))
        assert module.counts_coarsely(0.01 * np.arange(2000), count) == coarse
        irregular = 0.01 * np.cumsum(np.random.default_rng(1).uniform(0.5, 1.5, 2000))
        assert not module.counts_coarsely(irregular, count)

    @pytest.mark.parametrize(("rate", "coarse"), [(0.07, True), (0.94, True), (0.96, False), (10.0, False)])
    @pytest.mark.parametrize("rest", [(0, 0), (0, 700), (1000, 1700), (1300, 2000)])
    def test_rows_at_rest_do_not_show_the_resolution(self, rest, rate, coarse):
        k = np.arange(2000)
        turned = np.clip(k, 0, rest[0]) + np.maximum(k - rest[1], 0)
        assert module.counts_coarsely(0.01 * k, np.floor(rate * turned)) == coarse

    def test_a_counter_without_a_step_is_not_coarse(self):
        assert not module.counts_coarsely(0.01 * np.arange(100), np.zeros(100))
        assert not module.counts_coarsely(0.01 * np.arange(100), np.repeat([0.0, 1.0], 50))

    def test_a_fine_encoder_keeps_its_rows_and_its_rest(self):
        """From 14 counts in a row to rest within 3000 rows of 4000."""
        k = np.arange(4000)
        left = np.maximum(3000 - k, 0)
        made = self.read(0.005 * k, np.floor(1e4 - 14 * left**2 / 6000), 2000.0)
        assert len(made.time) == 4000
        made = self.read(0.005 * k, np.floor(1e3 - 0.6 * left**2 / 6000), 60.0)
        assert len(made.time) < 1000

    def test_noise_of_the_encoder_beyond_the_quantisation(self):
        k, rng = np.arange(4000), np.random.default_rng(5)
        quiet = self.found(0.3 * self.STEP * k)
        noisy = self.found(0.3 * self.STEP * k + 0.4 * self.STEP * rng.standard_normal(4000))
        assert np.median(noisy.sigma) > 1.5 * np.median(quiet.sigma)
        off = noisy.value - np.interp(noisy.time, 0.01 * k, 0.3 * self.STEP * k)
        assert np.sqrt(np.mean(off**2)) == pytest.approx(np.median(noisy.sigma), rel=0.4)

    @pytest.mark.parametrize("phase", [0.0, 0.2, 0.5, 0.77])
    @pytest.mark.parametrize("rate", [0.0707, 0.3, 0.8])
    def test_the_uncertainty_beside_a_rest_is_that_of_the_motion(self, rate, phase):
        """Counts in a row at a constant speed, with a rest from row 1500 to 2500."""
        k = np.arange(4000)
        angle = self.STEP * (phase + rate * np.clip(k, 0, 1500) + rate * np.maximum(k - 2500, 0))
        made = self.found(angle)
        z = (made.value - np.interp(made.time, 0.01 * k, angle)) / made.sigma
        assert np.abs(z).max() < 2.5

    @pytest.mark.parametrize("rate", [0.1, 0.3, 0.6])
    @pytest.mark.parametrize(("gaps", "rows"), [(40, 12), (100, 8), (400, 1)])
    def test_an_interval_with_missing_rows_has_its_own_uncertainty(self, gaps, rows, rate):
        """Of counts in a row at a constant speed, at most 12 rows in succession are missing."""
        k, rng = np.arange(4000), np.random.default_rng(0)
        keep = np.ones(4000, dtype=bool)
        for first in rng.integers(50, 3900, gaps):
            keep[first : first + rows] = False
        angle = self.STEP * (0.013 + 1.0001 * rate * k)
        time, count = 0.01 * k[keep], np.floor(angle[keep] / self.STEP)
        made = module.from_changes(table(time), time, count, k[keep], 10.0, [])
        z = (made.value - np.interp(made.time, 0.01 * k, angle)) / made.sigma
        assert np.abs(z).max() < 2.5
        assert np.sqrt(np.mean(z**2)) < 1.3

    @pytest.mark.parametrize("sense", [1, -1])
    def test_an_encoder_may_restart_at_each_turn(self, sense):
        """0.9 to 0.3 of 60 counts a row: the same angles as those of a count that continues."""
        k = np.arange(4000)
        total = np.floor(sense * (0.9 * k - 0.6 * k**2 / 8000))
        whole, wrapped = (self.read(0.005 * k, count, 60.0) for count in (total, total % 60))
        assert len(wrapped.time) > 2000
        assert wrapped.time == pytest.approx(whole.time)
        turns = (wrapped.value - whole.value) / TURN
        assert turns == pytest.approx(np.full(len(turns), round(turns[0])))
        assert wrapped.sigma == pytest.approx(whole.sigma)

    @pytest.mark.parametrize(("gap", "known"), [(78, True), (82, False)])
    def test_turns_within_a_gap_are_not_lost(self, gap, known):
        """0.3 of 60 counts a row: 0.4 turns in 80 rows."""
        k = np.arange(4000)
        keep = (k < 1000) | (k >= 1000 + gap)
        time, count = 0.005 * k[keep], np.floor(0.3 * k[keep])
        assert module._turns_are_known(time, count, 60.0) == known
        raw = table(time, count % 60 * TURN / 60, names=("t", "angle"))
        raw = replace(raw, units=("s", "rad"))
        assert (module._of_changes(raw, ReadOptions(pulses_per_turn=60.0)) is not None) == known

    @pytest.mark.parametrize("later", [0.005, 0.0])
    def test_times_that_do_not_increase_are_not_those_of_counts(self, later):
        k = np.arange(4000)
        time = 0.005 * k
        time[700] = time[699] + later
        raw = replace(
            table(time, np.floor(0.3 * k) % 60 * TURN / 60, names=("t", "angle")), units=("s", "rad")
        )
        assert (module._of_changes(raw, ReadOptions(pulses_per_turn=60.0)) is not None) == (later > 0)

    def read(self, time, count, per_turn):
        return module.read_sampled_counts(
            table(time, count, names=("t", "counts")),
            module.Columns({"t": 0, "revolutions": 1}, {"t": "s"}, {}, [], []),
            1,
            ReadOptions(pulses_per_turn=per_turn),
        )

    @pytest.mark.parametrize(
        ("after", "idle", "ends"), [(-1, 15, 0), (-1, 16, 2), (1, 16, 0), (1, 100, 0), (1, 101, 2)]
    )
    def test_the_ends_of_a_long_time_without_counts_are_samples(self, after, idle, ends):
        """A count in five rows, then none for `idle` rows, then counts in the same or in the opposite sense."""
        at = np.cumsum([5] * 40 + [idle] + [5] * 40)
        count = np.zeros(at[-1] + 5)
        np.add.at(count, at, [1.0] * 40 + [after] * 41)
        time = 0.01 * np.arange(len(count))
        made = module.from_changes(table(time), time, np.cumsum(count), np.arange(len(time)), 10.0, [])
        assert len(made.time) == 81 + ends
        if ends:
            first, last = 200, 200 + idle - 1
            value = dict(zip(np.round(made.time / 0.005).astype(int).tolist(), made.value, strict=True))
            assert value[2 * first] == value[2 * last] == pytest.approx(40.5 * self.STEP)

    @pytest.mark.parametrize(("longer", "beside_a_rest"), [(21, False), (23, True)])
    def test_a_rest_is_on_one_side_of_a_change(self, longer, beside_a_rest):
        """Changes 10 rows apart, then `longer` ones: the speed before over that of both sides is 1.6 at 22."""
        at = np.cumsum([10] * 5 + [longer] * 4)
        count = np.zeros(at[-1] + 1)
        count[at] = 1.0
        found = module._turned_within(np.arange(len(count)), np.cumsum(count), at)[4]
        assert found == pytest.approx(0.1 if beside_a_rest else 2 / (10 + longer))

    @pytest.mark.parametrize(("idle", "coarse"), [(20, True), (21, False)])
    def test_a_rest_is_longer_than_twenty_times_between_counts(self, idle, coarse):
        """Of 320 rows 19 or 20 are idle, in succession."""
        count = np.cumsum(np.concatenate([np.ones(150), np.zeros(idle - 1), np.ones(150)]))
        assert module.counts_coarsely(0.01 * np.arange(len(count)), count) == coarse

    @pytest.mark.parametrize(("ratio", "noisy"), [(1.29, False), (1.31, True)])
    def test_scatter_beyond_the_quantisation_is_the_uncertainty(self, ratio, noisy, monkeypatch):
        """A count in four rows: a quarter of a step over sqrt(12)."""
        quantised = 0.25 * self.STEP / math.sqrt(12)
        monkeypatch.setattr(module, "scatter", lambda time, *_: np.full(len(time), ratio * quantised))
        made = self.found(self.STEP * (0.1 + 0.25 * np.arange(2000)))
        assert made.sigma[5:-5] == pytest.approx(
            np.full(len(made.sigma) - 10, (ratio if noisy else 1) * quantised)
        )


class TestClock:
    @pytest.mark.parametrize(
        ("step", "scale"),
        [
            (1, 1.0),
            (10, 1.0),
            (11, 1e-3),
            (399, 1e-3),
            (400, None),
            (999, None),
            (1000, 1e-6),
            (4_900_000, 1e-6),
            (5_100_000, None),
        ],
    )
    def test_whole_numbers_are_ticks_by_the_size_of_their_steps(self, step, scale):
        ticks = step * np.arange(20.0)
        if scale is None:
            with pytest.raises(DatasetError, match="their unit is not stated"):
                clock_scale(table(ticks), ticks)
        else:
            assert clock_scale(table(ticks), ticks) == scale
            assert clock_scale(table(ticks), ticks + 0.5) == 1.0
            assert clock_scale(table(ticks), ticks[::-1]) == scale
        assert clock_scale(table(ticks), np.array([math.nan])) == 1.0


class TestReading:
    def options(self, **more):
        return ReadOptions(pulses_per_turn=1.0, **more)

    @pytest.mark.parametrize("per_turn", [0.0, -1.0, None])
    def test_the_number_of_pulses_is_positive(self, per_turn):
        with pytest.raises(UsageError, match="not positive"):
            read_pulses(table(np.arange(20.0)), ReadOptions(pulses_per_turn=per_turn))

    def test_rising_states_of_a_gate_are_pulses(self):
        """Changes from 1 to 0 are none."""
        t = np.arange(60) * 0.37 + 0.01 * np.arange(60) ** 2 / 60
        state = np.arange(60) % 2
        found = read_pulses(table(t, state, names=("t", "gate")), self.options())
        assert found.time == pytest.approx(t[1::2])
        assert any("changes of" in n for n in found.notes)
        start = read_pulses(table(t, state, names=("t", "gate")), self.options(start=100.0))
        assert start.time == pytest.approx(100.0 + t[1::2])

    def test_rows_without_a_time_or_a_state_are_left_out(self):
        """An unknown state (20), or a state at an unknown time (51), is left out; its neighbours are alike."""
        t = np.arange(120) * 0.37 + 0.01 * np.arange(120) ** 2 / 120
        state = np.arange(120) % 2 + 0.0
        known, lost = t.copy(), state.copy()
        known[51], lost[20] = np.nan, np.nan
        found = read_pulses(table(known, lost, names=("t", "gate")), self.options())
        kept = np.delete(np.arange(120), [20, 51])
        rising = [i for i, j in zip(kept[1:], kept[:-1], strict=True) if state[i] > state[j]]
        assert found.time == pytest.approx(t[rising])
        assert found.line.tolist() == [i + 2 for i in rising]

    def test_times_that_do_not_increase_are_sorted_and_the_first_is_named(self):
        t = np.arange(60) * 0.37 + 0.01 * np.arange(60) ** 2 / 60
        mixed = t.copy()
        mixed[[20, 21, 40, 41]] = t[[21, 20, 41, 40]]
        found = read_pulses(table(mixed, names=("t",)), self.options())
        assert found.time == pytest.approx(t)
        assert sum("not increasing (line 23)" in n for n in found.notes) == 1

    def test_intervals_are_summed(self):
        step = 0.2 + 0.02 * np.sin(np.arange(60.0))
        found = read_pulses(table(step), self.options())
        assert found.time == pytest.approx(np.cumsum(step))
        assert found.value[-1] - found.value[0] == pytest.approx(59 * TURN, rel=1e-2)
        step[20] = 0.0
        named = table(step, names=("interval",))
        with pytest.raises(DatasetError, match="line 22"):
            read_pulses(named, self.options())

    def test_rows_out_of_order_are_sorted(self):
        t = slowing(60)
        t[[20, 21]] = t[[21, 20]]
        found = read_pulses(table(t, np.arange(60.0) % 7, names=("t", "x")), self.options())
        assert (np.diff(found.time) > 0).all()

    def test_the_numbers_of_the_rows_are_not_times(self):
        with pytest.raises(DatasetError, match="numbers the rows"):
            read_pulses(table(np.arange(40.0), np.full(40, 0.3)), self.options())


class TestCounter:
    def counted(self, time, count, **options):
        return read_counter(table(time, count, names=("t", "n")), 1, ReadOptions(**options))

    def test_steps_are_pulses_at_their_rows(self):
        t = np.arange(400) * 0.05
        count = np.floor(t / 0.31 + 1e-9)
        found = self.counted(t, count)
        assert len(found.time) == int(count[-1])
        assert found.value[-1] - found.value[0] == pytest.approx(TURN * (count[-1] - 1))

    def test_a_counter_restarts_and_continues(self):
        t = slowing(60)
        count = np.arange(60.0)
        count[30:] -= 30
        found = self.counted(t, count)
        assert found.value[-1] - found.value[0] == pytest.approx(TURN * 58, abs=0.05)
        assert any("restarts at line 32" in n for n in found.notes)

    @pytest.mark.parametrize(("restarts", "refused"), [(3, False), (4, True)])
    def test_a_counter_restarts_at_most_three_times(self, restarts, refused):
        t, count = slowing(400, 0.1, 1.001), np.arange(400.0)
        for k in range(restarts):
            count[80 * (k + 1) :] -= 80
        if refused:
            with pytest.raises(DatasetError, match="does not count up"):
                self.counted(t, count)
        else:
            self.counted(t, count)

    @pytest.mark.parametrize(
        ("step", "share", "refused"), [(20, 0.05, False), (21, 0.05, True), (21, 0.015, False)]
    )
    def test_large_steps_are_rare(self, step, share, refused):
        increments = np.ones(400)
        every = int(1 / share)
        increments[every // 2 :: every] = step
        t = np.cumsum(0.1 * increments)
        if refused:
            with pytest.raises(DatasetError, match="does not count up"):
                self.counted(t, np.cumsum(increments))
        else:
            self.counted(t, np.cumsum(increments))

    @pytest.mark.parametrize(("repeated", "refused"), [(19, False), (21, True)])
    def test_one_in_five_rows_may_be_repeated(self, repeated, refused):
        """Of a hundred."""
        t = np.sort(np.append(slowing(100 - repeated), slowing(100 - repeated)[:repeated]))
        count = np.searchsorted(slowing(100 - repeated), t)
        if refused:
            with pytest.raises(DatasetError, match="does not count up"):
                self.counted(t, count)
        else:
            assert any(f"{repeated} repeated rows" in n for n in self.counted(t, count).notes)

    @pytest.mark.parametrize(("ratio", "late"), [(0.71, False), (0.69, True)])
    def test_a_count_is_late_if_the_intervals_are_more_regular_by_three_tenths(
        self, monkeypatch, ratio, late
    ):
        found = iter([1.0, ratio])
        monkeypatch.setattr(module, "_roughness", lambda *_: next(found))
        t = np.cumsum(np.random.default_rng(0).uniform(0.1, 0.11, 60))
        made = self.counted(t, np.arange(60.0))
        assert made.time[0] == t[1 - late]
        assert any("one row late" in n for n in made.notes) is late

    def test_a_count_of_pulses_is_divided(self):
        t = slowing(80)
        found = self.counted(t, np.arange(80.0), pulses_per_turn=4.0)
        assert found.value[-1] - found.value[0] == pytest.approx(TURN * 78 / 4.0, abs=0.01)

    def test_a_false_pulse_is_not_a_turn(self):
        t = np.insert(np.arange(60.0), 31, 30.1)
        found = self.counted(t, np.arange(61.0))
        assert len(found.time) == 59
        assert found.value[-1] - found.value[0] == pytest.approx(TURN * 58, abs=0.01)
        assert any("1 false pulses were excluded" in n for n in found.notes)

    def test_a_false_pulse_that_was_counted_twice_is_not_a_turn(self):
        t = np.insert(np.arange(60.0), 31, 30.1)
        step = np.ones(61)
        step[31] = 2.0
        found = self.counted(t, np.cumsum(step))
        assert np.diff(found.value) == pytest.approx(np.full(58, TURN), abs=0.01)

    @pytest.mark.parametrize("offset", [0, 1])
    def test_the_more_regular_rows_are_used(self, offset):
        """A logger that writes each event twice, the count with it or one row late."""
        events = slowing(60)
        t = np.sort(
            np.concatenate(
                [
                    events,
                    events[:-1] + 0.31 * np.diff(events) * np.random.default_rng(1).uniform(0.2, 1.8, 59),
                ]
            )
        )
        at = np.searchsorted(t, events)
        count = np.zeros(len(t))
        rows = at + offset
        count[rows[rows < len(t)]] = 1.0
        found = self.counted(t, np.cumsum(count))
        assert np.isin(np.round(found.time, 9), np.round(events, 9)).mean() > 0.95
        assert any("one row late" in n for n in found.notes) == (offset == 1)

    def test_roughness_is_the_mean_change_of_the_speed(self):
        time, count = np.array([0.0, 1.0, 3.0, 4.0]), np.array([0.0, 1.0, 2.0, 4.0])
        assert module._roughness(time, count) == pytest.approx((math.log(2.0) + 1.0) / 2)


class TestEncoders:
    @pytest.mark.parametrize(
        ("count", "column"),
        [
            (np.cumsum(np.full(50, 7.0)), 1),
            (np.cumsum(np.tile([5.0, -3.0], 25)), 1),
            (np.arange(50.0), None),  # steps of one: events
            (np.arange(50.0) + 0.5, None),
            (np.arange(50.0) % 2, None),  # states
            (np.arange(7.0) * 9, None),
        ],
    )
    def test_sampled_counts_are_whole_numbers_in_larger_steps(self, count, column):
        raw = table(0.01 * np.arange(len(count)), count)
        assert sampled_counts(raw, {"t": 0}) == column
        assert sampled_counts(raw, {"t": 0, "revolutions": 1}) == column
        assert sampled_counts(raw, {"t": 0, "angle": 1}) is None

    @pytest.mark.parametrize(
        ("values", "unit", "counts"),
        [
            (7.0, "", True),
            (7.0, "counts", True),
            (7.0, "deg", False),
            (7.5, "", False),
        ],
    )
    def test_whole_numbers_that_the_user_names_as_the_angle_are_counts(self, values, unit, counts):
        """Each row must not be taken for a pulse, which would ignore the column that the user names."""
        raw = table(0.01 * np.arange(50) ** 1.1, np.cumsum(np.full(50, values)))
        named = read_names(["t=1", f"angle=2 [{unit}]" if unit else "angle=2"])
        options = ReadOptions(pulses_per_turn=100.0, names=named)
        if counts:
            assert np.ptp(_from_table(raw, options).value) == pytest.approx(
                TURN * 49 * values / 100, rel=1e-6
            )
        else:
            with pytest.raises(UsageError, match="each row would be a pulse"):
                _from_table(raw, options)

    @pytest.mark.parametrize(("share", "column"), [(0.05, None), (0.15, 1)])
    def test_rare_double_steps_are_those_of_events(self, share, column):
        """Up to a tenth."""
        step = np.ones(200)
        step[: int(200 * share)] = 2.0
        assert sampled_counts(table(0.01 * np.arange(200), np.cumsum(step)), {"t": 0}) == column

    @pytest.mark.parametrize(("steps", "found"), [(7, []), (8, [1])])
    def test_a_counter_has_eight_steps(self, steps, found):
        count = np.minimum(np.arange(100) // 10, steps).astype(float)
        assert counters_of(table(0.1 * np.arange(100), count)) == found

    @pytest.mark.parametrize(("per_turn", "continued"), [(60.0, True), (1000.0, False)])
    def test_a_counter_that_overflows_within_a_turn_restarts_at_each_turn(self, per_turn, continued):
        """Nine counts a row, of eight bits; 256 counts are less than a turn of a thousand."""
        raw = table(0.01 * np.arange(400), 9.0 * np.arange(400) % 256)
        angles = module._counted_angles(raw, 1, 0, "s", ReadOptions(pulses_per_turn=per_turn))
        turned = 9.0 * np.arange(400)
        assert angles.columns[1] * per_turn / TURN == pytest.approx(turned if continued else turned % 256)
        assert any("8-bit" in n for n in angles.notes) is continued

    @pytest.mark.parametrize(("different", "refused"), [(99, True), (101, False)])
    def test_half_of_the_times_of_sampled_counts_are_different(self, different, refused):
        """Of 200."""
        time = np.concatenate([np.zeros(200 - different), 0.01 * np.arange(different)])
        raw = table(time, 7.0 * np.arange(200), names=("t", "counts"))
        columns = module.Columns({"t": 0, "revolutions": 1}, {"t": "s"}, {}, [], [])
        options = ReadOptions(pulses_per_turn=60.0)
        if refused:
            with pytest.raises(DatasetError, match="most times in 't' are repeated"):
                module.read_sampled_counts(raw, columns, 1, options)
        else:
            assert len(module.read_sampled_counts(raw, columns, 1, options).time) >= different

    def test_sampled_counts_begin_at_the_stated_time(self):
        raw = table(0.005 * np.arange(2000), np.floor(0.07 * np.arange(2000)), names=("t", "counts"))
        columns = module.Columns({"t": 0, "revolutions": 1}, {"t": "s"}, {}, [], [])
        plain, later = (
            module.read_sampled_counts(raw, columns, 1, ReadOptions(pulses_per_turn=60.0, start=start))
            for start in (0.0, 100.0)
        )
        assert later.time == pytest.approx(plain.time + 100.0)
        assert len(plain.time) < 200

    def test_steps_of_less_than_half_of_the_range_are_not_overflows(self):
        count = np.tile([0.0, 100.0], 10)
        same, bits = module._continued_count(count)
        assert (same.tolist(), bits) == (count.tolist(), 0)
        assert module._continued_count(np.tile([0.0, 130.0], 10))[1] == 8

    @pytest.mark.parametrize("bits", [8, 16])
    def test_overflows_are_continued(self, bits):
        size = 2**bits
        true = np.arange(0.0, 5 * size, size / 7)
        for wrapped in (true % size, (true + size / 2) % size - size / 2):
            found, known = module._continued_count(np.floor(wrapped))
            assert known == bits
            assert np.diff(found) == pytest.approx(np.diff(true), abs=1.0)
        for beyond in (
            [-1.0, 128.0, -1.0],
            [-129.0, 0.0, -129.0],
            [0.0, 256.0, 0.0],
        ):  # of a counter of 8 bits
            same, none = module._continued_count(np.array(beyond))
            assert (same.tolist(), none) == (beyond, 0)
        for within in ([-2.0, 127.0, -2.0], [-128.0, 1.0, -128.0], [0.0, 255.0, 0.0]):
            assert module._continued_count(np.array(within))[1] == 8
        same, none = module._continued_count(np.array([0.0, 100.0, 50.0]))
        assert (same.tolist(), none) == ([0.0, 100.0, 50.0], 0)

    def test_counters_without_header(self):
        t = slowing(60, 0.03)
        often = np.floor(np.arange(60) / 2.0)
        assert counters_of(table(np.arange(60) * 0.1, often)) == [1]
        assert counters_of(table(np.arange(60) * 0.1, np.arange(60.0))) == []  # the numbers of the rows
        assert counters_of(table(t, np.arange(60.0))) == [1]  # at the times of pulses
        assert counters_of(table(np.arange(60) * 0.1, often + 0.5)) == []
        assert counters_of(table(np.arange(60) * 0.1, often * 2)) == []
        falling = often.copy()
        falling[30:] -= 20
        assert counters_of(table(np.arange(60) * 0.1, falling)) == []


class TestPassages:
    """Two gates that a pendulum passes back and forth, or a wheel in one sense."""

    def states(self, *, back=True, order=True):
        t, a, b = [-0.5], [0], [0]
        for k in range(40):
            first = (k % 2 == 0) or not back
            for gate, state, dt in ((0, 1, 0.0), (0, 0, 0.02), (1, 1, 0.03), (1, 0, 0.05)):
                own = gate if first else 1 - gate
                t.append(k + dt)
                a.append(state if own == 0 else 0)
                b.append(state if own == 1 else 0)
        return table(t, a, b, names=("t", "A", "B"))

    def test_gates_in_alternating_order_are_a_pendulum(self):
        found = passages_of(self.states(), ReadOptions())
        assert len(found.time) == 40
        assert found.time == pytest.approx(np.arange(40) + 0.025)
        assert found.duration == pytest.approx(np.full(40, 0.04))
        with pytest.raises(UsageError, match="pendulum"):
            read_pulses(self.states(), ReadOptions(pulses_per_turn=1.0))

    def test_one_gate_of_a_pendulum_that_decays(self):
        """Passages last longer and longer, in proportion to exp(t / 40)."""
        t, state = [-0.5], [0]
        for k in range(40):
            t += [k, k + 0.02 * math.exp(k / 40)]
            state += [1, 0]
        found = passages_of(table(t, state, names=("t", "A")), ReadOptions())
        width = 0.02 * np.exp(np.arange(40) / 40)
        assert found.duration == pytest.approx(width)
        assert found.time == pytest.approx(np.arange(40) + width / 2)

    def test_gates_in_one_order_are_a_rotation(self):
        assert passages_of(self.states(back=False), ReadOptions()) is None
        assert passages_of(table([0.0, 1.0], [0.0, 1.0]), ReadOptions()) is None

    @pytest.mark.parametrize(("growth", "pendulum"), [(0.14, True), (0.06, False)])
    def test_passages_that_take_longer_and_longer_are_a_pendulum(self, growth, pendulum):
        """ln (duration / time between) rises by three quarters of the growth from first to last quarter: above 0.1."""
        begin = np.arange(80.0)
        width = 0.05 * np.exp(growth * np.arange(80) / 79)
        blocked = np.column_stack([begin, begin + width])
        assert module._slows_down(blocked) is pendulum
        assert not module._slows_down(blocked[:9])

    @pytest.mark.parametrize(
        ("interval", "duration", "pendulum"), [(-0.2, 0.0, True), (0.2, 0.2, False), (0.0, -0.2, False)]
    )
    def test_durations_count_relative_to_the_time_between_passages(self, interval, duration, pendulum):
        """Both change by exp(rate) throughout; those of a wheel that slows down change alike."""
        k = np.arange(80) / 79
        begin = np.cumsum(np.exp(interval * k))
        width = 0.05 * np.exp(duration * k)
        assert module._slows_down(np.column_stack([begin, begin + width])) is pendulum

    def passing(self, first, widths=(0.02, 0.02), apart=0.03, period=1.0):
        """Passages of two gates, `apart` seconds, that begin with gate `first[k]` (0 or 1) at k periods."""
        t, states = [-0.5], [[0, 0]]
        for k, gate in enumerate(first):
            for place, own in enumerate((gate, 1 - gate)):
                width = widths[own] if np.isscalar(widths[own]) else widths[own][k]
                for state, dt in ((1, 0.0), (0, width)):
                    t.append(k * period + place * apart + dt)
                    states.append([state if own == 0 else 0, state if own == 1 else 0])
        return table(t, *np.array(states).T, names=("t", "A", "B"))

    @pytest.mark.parametrize(("same", "pendulum"), [(3, True), (5, False)])
    def test_nine_in_ten_passages_of_a_pendulum_alternate(self, same, pendulum):
        """39 pairs of passages, of which `same` have the same order of the gates."""
        change = np.ones(39, dtype=int)
        change[5 : 5 + 6 * same : 6] = 0
        first = np.concatenate([[0], np.cumsum(change)]) % 2
        assert (passages_of(self.passing(first), ReadOptions()) is not None) is pendulum

    @pytest.mark.parametrize(
        ("first", "second", "pendulum"), [(0.4, 0.4, True), (0.4, 0.0, False), (0.0, 0.4, False)]
    )
    def test_two_gates_in_one_order_must_both_be_passed_more_and_more_slowly(self, first, second, pendulum):
        widths = [0.02 * np.exp(growth * np.arange(40) / 39) for growth in (first, second)]
        found = passages_of(self.passing([0] * 40, widths, apart=0.04), ReadOptions())
        assert (found is not None) is pendulum

    @pytest.mark.parametrize("apart", [0.3, 0.4, 0.45])
    def test_a_wheel_with_gates_far_apart_is_not_a_pendulum(self, apart):
        assert passages_of(self.passing([0] * 40, apart=apart), ReadOptions()) is None

    @pytest.mark.parametrize(
        ("gap", "length", "count"),
        [(0.009, 0.1, 20), (0.011, 0.1, 21), (0.5, 0.009, 20), (0.5, 0.011, 21)],
    )
    def test_flickers_are_shorter_than_a_tenth_of_a_passage(self, gap, length, count):
        """A second interruption of `length`, after a gap, behind one of twenty of 0.1 s."""
        t, state = [-0.5], [0]
        for k in range(20):
            more = (0.1 + gap, 0.1 + gap + length) if k == 7 else ()
            t += [k + dt for dt in (0.0, 0.1, *more)]
            state += [1, 0] * (1 + (k == 7))
        found = module._blocked(np.array(t), np.array(state, dtype=float), table(t), [])
        assert len(found) == count

    @pytest.mark.parametrize(("errors", "gate"), [(7, True), (9, False)])
    def test_a_gate_has_rare_errors_of_its_state(self, errors, gate):
        """Of 400 rows, less than 2 %."""
        state = np.arange(400.0) % 2
        state[:errors] = 7.0
        assert module._gates(table(np.arange(400.0), state), 0) == ([1] if gate else [])

    def test_scattering_durations_show_nothing(self):
        rng = np.random.default_rng(1)
        begin = np.arange(80.0)
        width = 0.05 * np.exp(0.2 * np.arange(80) / 79 + 0.5 * rng.standard_normal(80))
        assert not module._slows_down(np.column_stack([begin, begin + width]))

    def test_flickers_are_removed(self):
        t, state = [-0.5], [0]
        for k in range(20):
            for dt, s in (
                ((0.0, 1), (0.1, 0))
                if k != 7
                else ((0.0, 1), (0.05, 0), (0.055, 1), (0.1, 0), (0.4, 1), (0.405, 0))
            ):
                t.append(k + dt)
                state.append(s)
        notes = []
        found = module._blocked(np.array(t), np.array(state, dtype=float), table(t), notes)
        assert found == pytest.approx(np.column_stack([np.arange(20.0), np.arange(20) + 0.1]))
        assert "2 flickers" in notes[0]

    @pytest.mark.parametrize(("lost", "refused"), [(5, False), (14, True)])
    def test_lost_passages_are_refused(self, lost, refused):
        time = np.delete(np.arange(60.0), np.arange(4, 4 + 4 * lost, 4)[:lost])
        if refused:
            with pytest.raises(DatasetError, match="passages are missing"):
                module._refuse_lost_passages(table(time), time)
        else:
            module._refuse_lost_passages(table(time), time)


def counted(name, *, count=None, others=(), jitter=0.0, **options):
    """A motor that slows down, sampled at equal intervals by an encoder of 700 counts per turn."""
    time = 0.01 * np.arange(1200) + jitter * np.sin(7.0 * np.arange(1200))
    if count is None:
        count = np.floor(700 / TURN * 60 * (1 - np.exp(-time / 4)))
    names = ("Time", name, *(n for n, _ in others))
    return _from_table(
        table(time, count, *(c for _, c in others), names=names), ReadOptions(pulses_per_turn=700, **options)
    )


class TestNamedCounter:
    @pytest.mark.parametrize("jitter", [0.0, 2e-3])
    @pytest.mark.parametrize("name", ["EncoderPosition", "Encoder Ticks", "left_enc", "pos", "motorCount"])
    def test_the_name_of_a_counter_shows_that_rows_are_samples(self, name, jitter):
        found = counted(name, jitter=jitter)
        assert np.ptp(found.value) == pytest.approx(60 * (1 - math.exp(-3)), abs=0.05)
        assert found.reading.taken[1].column == f"'{name}'"

    def test_the_rows_are_samples_even_if_only_the_unit_of_the_time_is_given(self):
        assert np.ptp(counted("encoder", names=read_names(["t=Time [s]"])).value) > 50

    def test_a_counter_that_restarts_at_each_turn_accumulates(self):
        count = np.floor(700 / TURN * 0.2 * np.arange(1200)) % 700
        assert np.ptp(np.unwrap(counted("encoder", count=count).value)) == pytest.approx(0.2 * 1199, abs=0.05)

    def test_whole_numbers_that_never_reverse_are_not_ignored(self):
        with pytest.raises(DatasetError, match="'foo' contains whole numbers that never reverse") as error:
            counted("foo")
        assert "--column 'revolutions=foo'" in error.value.hint
        assert np.ptp(counted("foo", names=read_names(["t=Time"])).value) == pytest.approx(TURN * 1199 / 700)

    def test_two_counters_need_a_choice(self):
        other = ("encoder right", np.arange(1200) * 5 // 2)
        with pytest.raises(DatasetError, match="2 columns contain counts"):
            counted("encoder left", others=[other])
        assert np.ptp(counted("encoder left", others=[other], marker="right").value) == pytest.approx(
            TURN * (1199 * 5 // 2) / 700, abs=0.02
        )

    @pytest.mark.parametrize(
        ("name", "values"),
        [
            ("millis", 10 * np.arange(1200)),  # a second clock
            ("row", np.arange(1200)),
            ("light", np.round(500 + 400 * np.sin(np.arange(1200) ** 1.1))),  # a signal reverses
            ("level", np.linspace(0, 5, 1200)),
        ],
    )
    def test_other_columns_beside_pulses_are_not_counters(self, name, values):
        time = np.cumsum(0.01 * 1.001 ** np.arange(1200))
        raw = table(time, values, names=("Time", name))
        found = _from_table(raw, ReadOptions(pulses_per_turn=700))
        assert np.ptp(found.value) == pytest.approx(TURN * 1199 / 700, rel=0.01)
