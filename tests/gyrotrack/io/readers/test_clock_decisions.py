"""The clock of a table: what is sorted, continued, moved or refused, on both sides of each threshold."""

import math
from pathlib import Path

import numpy as np
import pytest

from gyrotrack import DatasetError
from gyrotrack.io.readers import _clock as module
from gyrotrack.io.readers._clock import continued_clock, ordered, refuse_slow_clock

PATH, N, DT = Path("a.csv"), 400, 0.01
K = np.arange(N)
TIME = DT * K


def motion(t):
    return 20.0 * t - 1.5 * t**2


def in_order(time, value=None):
    notes = []
    found = ordered(PATH, np.asarray(time, dtype=float), np.arange(len(time)) + 2, value, notes)
    return found, " ".join(notes)


def irregular(n=N, seed=2):
    return np.cumsum(np.random.default_rng(seed).uniform(0.005, 0.015, n))


def displaced(time, count, by=1):
    """Exchange `count` rows with the one that follows `by` rows later."""
    order = np.arange(len(time))
    for k in np.linspace(10, len(time) - 20, count).astype(int):
        order[[k, k + by]] = order[[k + by, k]]
    return time[order], order


class TestOrder:
    def test_only_a_file_that_runs_backwards_throughout_is_reversed(self):
        back = TIME[::-1].copy()
        back[200] = back[199]
        found, said = in_order(back)
        assert found.order.tolist() == K[::-1].tolist()
        assert "reversed" in said
        found, said = in_order(displaced(TIME, 1)[0])
        assert "1 rows were out of order" in said
        assert (np.diff(found.time[found.order]) > 0).all()

    @pytest.mark.parametrize("count", [4, 40])
    def test_rows_of_a_sampler_are_sorted_however_many_are_displaced(self, count):
        time, order = displaced(TIME, count)
        found, said = in_order(time)
        assert found.order.tolist() == np.argsort(order).tolist()
        assert f"{count} rows were out of order and were sorted" in said

    @pytest.mark.parametrize(
        ("rows", "count", "refused"), [(400, 4, False), (400, 5, True), (60, 1, False), (60, 2, True)]
    )
    def test_of_irregular_times_one_in_a_hundred_is_sorted_and_one_at_least(self, rows, count, refused):
        time, order = displaced(irregular(rows), count)
        if refused:
            with pytest.raises(DatasetError, match=f"{count} of {rows} rows are out of order"):
                in_order(time)
        else:
            assert in_order(time)[0].order.tolist() == np.argsort(order).tolist()

    @pytest.mark.parametrize(("share", "refused"), [(0.08, False), (0.12, True)])
    def test_nine_in_ten_intervals_of_a_sampler_are_equal(self, share, refused):
        step = np.full(N, DT)
        step[: int(share * N)] *= 1.5
        time, order = displaced(np.cumsum(step), 20)
        if refused:
            with pytest.raises(DatasetError, match="20 of 400 rows"):
                in_order(time)
        else:
            assert in_order(time)[0].order.tolist() == np.argsort(order).tolist()

    @pytest.mark.parametrize(
        ("values", "length"),
        [([1, 2, 2, 5, 2, 3], 5), ([3, 2, 1], 1), ([1, 3, 2, 4], 3), ([2, 2, 2], 3), ([5, 1, 2, 3, 4], 4)],
    )
    def test_the_longest_sequence_that_does_not_decrease(self, values, length):
        assert module._longest_increasing(np.array(values, dtype=float)) == length


class TestSetBack:
    """A clock that is set back while the record runs."""

    def back(self, intervals, jitter=0.0):
        time = TIME + DT * jitter * (K % 5 == 0)
        return np.where(K < 200, time, time - intervals * DT)

    @pytest.mark.parametrize("intervals", [5.3, 12.0])
    def test_later_times_continue_at_the_usual_interval(self, intervals):
        found, said = in_order(self.back(intervals))
        assert found.order.tolist() == K.tolist()
        assert found.time == pytest.approx(TIME)
        assert f"line 202: the clock steps by {-intervals * DT:+.4g} s" in said
        assert f"moved by {intervals * DT:.6g} +-" in said

    @pytest.mark.parametrize(("jitter", "continued"), [(0.018, True), (0.022, False)])
    def test_equal_intervals_are_equal_within_a_fiftieth(self, jitter, continued):
        """Two of five intervals are 1 +- jitter."""
        if continued:
            found, _ = in_order(self.back(5.3, jitter))
            assert (np.diff(found.time) > 0).all()
        else:
            with pytest.raises(DatasetError, match="out of order"):
                in_order(self.back(5.3, jitter))

    def test_one_row_with_a_wrong_time_is_sorted(self):
        time = TIME.copy()
        time[200] -= 5.3 * DT
        found, said = in_order(time)
        assert "1 rows were out of order" in said
        assert np.delete(found.time[found.order], 195) == pytest.approx(np.delete(TIME, 200))

    def test_irregular_times_are_not_continued(self):
        """The intervals beside the step are equal to the usual one."""
        step = np.diff(irregular())
        step[196:203] = np.median(step)
        time = np.concatenate([[0.0], np.cumsum(step)])
        with pytest.raises(DatasetError, match="rows are out of order"):
            in_order(np.where(K < 200, time, time - 0.083))

    @pytest.mark.parametrize(("rows", "refused"), [(-6, True), (0, False), (6, True)])
    def test_rows_that_are_missing_or_repeated_there_contradict(self, rows, refused):
        """The motion goes on by six rows more or less than the times; noise of a tenth of a row."""
        value = motion(TIME + DT * rows * (K >= 200)) + 0.02 * np.random.default_rng(1).standard_normal(N)
        if refused:
            with pytest.raises(DatasetError, match="rows are missing between"):
                in_order(self.back(5.3), value)
        else:
            _, said = in_order(self.back(5.3), value)
            assert "the values confirm it" in said

    @pytest.mark.parametrize(
        ("delay", "refused"), [(3.9e-3, False), (4.1e-3, True), (-3.9e-3, False), (-4.1e-3, True)]
    )
    def test_the_values_contradict_by_four_standard_errors(self, monkeypatch, delay, refused):
        monkeypatch.setattr(module, "_delay", lambda *_: (delay, 1e-3))
        if refused:
            with pytest.raises(DatasetError, match="rows are missing between"):
                in_order(self.back(5.3))
        else:
            assert in_order(self.back(5.3))[0].time == pytest.approx(TIME)


class TestDelay:
    """Time that passes between two rows, by the values on both sides."""

    def found(self, delay, noise, seed, k=199, slope=20.0):
        rng = np.random.default_rng(seed)
        t = TIME + delay * (k < K)
        return module._delay(TIME, slope * t + noise * rng.standard_normal(N), k)

    @pytest.mark.parametrize("delay", [0.0, 0.01, -0.01])
    def test_its_error_is_the_stated_one(self, delay):
        found = np.array([self.found(delay, 2e-3, seed) for seed in range(200)])
        assert found[:, 0].mean() == pytest.approx(delay, abs=2e-5)
        assert found[:, 0].std() == pytest.approx(np.sqrt(np.mean(found[:, 1] ** 2)), rel=0.2)

    @pytest.mark.parametrize(("slope", "known"), [(0.5, False), (1.2, True), (-1.0, True), (-0.4, False)])
    def test_a_slope_must_exceed_its_error_fourfold(self, slope, known):
        """Its error is that of least squares: parabolas with a step through 30 rows with a noise of 0.05."""
        noise = 0.05 * np.random.default_rng(3).standard_normal(N)
        value = slope * TIME + noise
        x = (TIME[185:215] - 0.5 * (TIME[199] + TIME[200])) / (14.5 * DT)
        design = np.column_stack([np.ones(30), x, x**2, x > 0])
        fitted, rest, *_ = np.linalg.lstsq(design, value[185:215], rcond=None)
        error = math.sqrt(float(rest[0]) / 26 * np.linalg.inv(design.T @ design)[1, 1])
        assert (abs(fitted[1]) > 4 * error) == known
        assert 0.2 < abs(fitted[1]) / error / 4 < 5.0
        assert (module._delay(TIME, value, 199) is not None) is known

    @pytest.mark.parametrize(
        ("k", "known"),
        [(1, False), (2, True), (N - 4, True), (N - 3, False)],
        ids=["2", "3", "3 left", "2 left"],
    )
    def test_three_rows_on_each_side_are_needed(self, k, known):
        assert (module._delay(TIME, motion(TIME), k) is not None) is known

    def test_without_values_nothing_is_known(self):
        value = motion(TIME)
        assert module._delay(TIME, None, 199) is None
        assert module._delay(TIME[:7], value[:7], 3) is None
        value[190] = np.nan
        assert module._delay(TIME, value, 199) is None


class TestSetAhead:
    """A gap in the times of a sampler."""

    def ahead(self, gaps=1, rows=4.0, lost=0.0, noise=1e-3, time=TIME):
        """Return times with `gaps` gaps of `rows` intervals more, in each of which the motion goes on by `lost`."""
        at = np.linspace(50, 350, gaps).astype(int)
        passed = (at[None, :] < K[:, None]).sum(axis=1)
        value = motion(time + DT * lost * passed) + noise * np.random.default_rng(1).standard_normal(N)
        return time + DT * rows * passed, value

    @pytest.mark.parametrize(("gaps", "moved"), [(1, True), (5, True), (6, False)])
    def test_up_to_five_gaps_in_which_the_values_stand_still_are_steps_of_the_clock(self, gaps, moved):
        stated, value = self.ahead(gaps)
        found, said = in_order(stated, value)
        assert found.time == pytest.approx(TIME if moved else stated)
        assert said.count("the clock steps by +0.04 s") == (gaps if moved else 0)

    @pytest.mark.parametrize(
        ("rows", "lost", "noise"),
        [(4.0, 4.0, 1e-3), (8.0, 4.0, 1e-3), (1.0, 0.0, 0.3)],
        ids=["rows are missing", "some rows are missing", "noise hides it"],
    )
    def test_other_gaps_stay(self, rows, lost, noise):
        stated, value = self.ahead(1, rows, lost, noise)
        found, said = in_order(stated, value)
        assert found.time.tolist() == stated.tolist()
        assert not said

    @pytest.mark.parametrize(
        ("gap", "rest", "moved"),
        [(4.1, 1.9, True), (3.9, 1.9, False), (4.1, 2.1, False), (-4.1, -1.9, True), (-4.1, -2.1, False)],
    )
    def test_the_gap_contradicts_the_values_and_the_usual_interval_does_not(
        self, monkeypatch, gap, rest, moved
    ):
        """By four and two standard errors."""
        stated, value = self.ahead(1)
        found = iter([(gap, 1.0), (rest, 1.0)])
        monkeypatch.setattr(module, "_delay", lambda *_: next(found))
        assert in_order(stated, value)[0].time == pytest.approx(TIME if moved else stated)

    def test_a_gap_of_irregular_times_stays(self):
        step = np.random.default_rng(2).uniform(0.006, 0.013, N - 1)
        step[30:70] = np.median(step)
        time = np.concatenate([[0.0], np.cumsum(step)])
        stated, value = self.ahead(1, time=time)
        assert in_order(stated, value)[0].time.tolist() == stated.tolist()

    def test_without_values_a_gap_stays(self):
        stated, _ = self.ahead(1)
        assert in_order(stated)[0].time.tolist() == stated.tolist()


class TestRestarts:
    def continued(self, time):
        notes = []
        return continued_clock(PATH, np.asarray(time, dtype=float), np.arange(len(time)) + 2, notes), notes

    @pytest.mark.parametrize(
        ("period", "word"),
        [
            (2**32 * 1e-6, "32-bit clock"),
            (2**32 * 1e-3, "32-bit clock"),
            (2.0**32, "32-bit clock"),
            (86400.0, "day"),
        ],
    )
    def test_a_counter_that_overflows_continues(self, period, word):
        true = np.linspace(0.9, 1.1, 50) * period
        found, notes = self.continued(true % period)
        assert found == pytest.approx(true)
        assert word in notes[0]
        assert "line 27" in notes[0]

    @pytest.mark.parametrize(
        ("tick", "later", "overflow"),
        [
            (1e-3, 0.0, True),
            (1e-6, 0.0, True),
            (1e-3, 0.0016, True),
            (1e-3, 0.0018, False),
            (1e-3, 1.0, False),
        ],
    )
    def test_a_16_bit_clock_continues_at_the_usual_interval(self, tick, later, overflow):
        usual = 10 * tick
        true = usual * np.arange(60) + 2**16 * tick - 30.3 * usual
        time = true % (2**16 * tick) + np.where(true >= 2**16 * tick, later, 0.0)
        if overflow:
            found, notes = self.continued(time)
            assert found - true == pytest.approx(np.where(true >= 2**16 * tick, later, 0.0), abs=1e-9)
            assert "16-bit clock restarts at line 33" in notes[0]
        else:
            with pytest.raises(DatasetError, match="the clock restarts"):
                self.continued(time)

    @pytest.mark.parametrize(("size", "overflow"), [(0.985, True), (0.97, False), (1.03, False)])
    def test_an_overflow_is_a_step_of_the_period_within_a_fiftieth(self, size, overflow):
        step = np.full(49, 0.1)
        step[24] = -size * 2**32 * 1e-6
        time = 4200.0 + np.concatenate([[0.0], np.cumsum(step)])
        if overflow:
            assert (np.diff(self.continued(time)[0]) > 0).all()
        else:
            with pytest.raises(DatasetError, match="the clock restarts"):
                self.continued(time)

    def test_a_time_of_day_is_at_most_a_day(self):
        step = np.full(49, 0.1)
        step[24] = -86400.0
        time = 86410.0 + np.concatenate([[0.0], np.cumsum(step)])
        with pytest.raises(DatasetError, match="the clock restarts"):
            self.continued(time)

    @pytest.mark.parametrize(
        ("pieces", "refused"),
        [
            ([(0.0, 30), (8.9, 30)], True),  # back by 20.1 intervals
            ([(0.0, 30), (9.1, 30)], False),  # by 19.9 intervals
            ([(0.0, 50), (20.0, 7)], False),  # too few rows for a recording
            ([(0.0, 50), (20.0, 8)], True),
            ([(0.0, 25)] + [(3.0, 25)] * 5, True),
            ([(0.0, 25)] + [(3.0, 25)] * 6, True),  # within five intervals of the first time
            ([(0.0, 25)] + [(4.9, 26)] * 6, True),
            ([(0.0, 30)] + [(6.0, 30)] * 6, False),
            ([(0.0, 30)] + [(2.0, 30)] * 5 + [(7.0, 30)], False),
            ([(0.0, 7), (-30.0, 8)], False),  # fewer than 16 rows
            ([(0.0, 8), (-30.0, 8)], True),
        ],
    )
    def test_restarts_of_the_clock_are_several_recordings(self, pieces, refused):
        """Rows at intervals of 1 s, from each first time on; a restart is a step back by more than 20 intervals."""
        time = np.concatenate([first + np.arange(count) for first, count in pieces])
        if refused:
            with pytest.raises(DatasetError, match="the clock restarts"):
                self.continued(time)
        else:
            assert self.continued(time)[0].tolist() == time.tolist()


@pytest.mark.parametrize(("step", "asked"), [(0.39, False), (0.41, True), (-0.41, True)])
def test_samples_far_apart_need_the_unit_of_their_times(step, asked):
    time = np.append(step * np.arange(30.0), math.nan)
    if asked:
        with pytest.raises(DatasetError, match="the unit of the time in 't' is not stated"):
            refuse_slow_clock("a.csv", "t", time)
    else:
        refuse_slow_clock("a.csv", "t", time)
    refuse_slow_clock("a.csv", "t", np.zeros(1))


class TestSeveralRecordings:
    """Records at 100 rows per second that begin again at 3 s."""

    def refused(self, *runs):
        time = np.concatenate([begin + DT * np.arange(n) for begin, n in runs])
        try:
            module._refuse_restarts(PATH, time, np.arange(len(time)) + 2)
        except DatasetError as error:
            return error
        return None

    @pytest.mark.parametrize(
        ("runs", "refused"),
        [
            ([(3.0, 60)], False),
            ([(3.0, 60), (3.0, 60)], True),
            ([(3.0, 60), (0.0, 60)], True),  # at another time, but few and long
            ([(3.0, 60), (0.0, 7)], False),  # a short piece
            ([(3.0, 60), (3.0, 7)], True),
            ([(3.0, 60), (3.41, 60)], False),  # 18 intervals back
            ([(3.0, 60)] * 6, True),
            ([(3.0, 60)] * 9, True),  # all of them begin again at the first time
            ([(3.0, 60), *[(3.2, 60)] * 8], False),  # many, none at the first time
            ([(3.0, 60), *[(3.04, 60)] * 8], True),  # within five intervals
            ([(3.0, 60), *[(3.06, 60)] * 8], False),
            ([(3.0, 5)] * 2, False),  # too short for a decision
        ],
    )
    def test_a_clock_that_begins_again_is_several_recordings(self, runs, refused):
        error = self.refused(*runs)
        assert (error is not None) is refused
        if refused:
            assert f"line {runs[0][1] + 2})" in error.message
            assert f"contains {len(runs)} recordings" in error.hint
