"""How a film is divided, and how its parts are put together again: small cases on either side of each rule."""

from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import nullcontext
from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest

from fitting._workers import WorkerPool
from gyrotrack import VideoError
from gyrotrack.tracking import _film_parts as module
from gyrotrack.tracking._film_parts import (
    LEARNT,
    PartRows,
    PartWorkers,
    split,
    turns_between,
    zero_between,
)
from gyrotrack.tracking._live_angles import angles_sent_to
from gyrotrack.tracking._marker_tracker import MarkerObservations
from gyrotrack.video._container import Packets
from gyrotrack.video._decoder import Part
from gyrotrack.video._time_base import Timing

TURN = 2 * np.pi


def packets(count, keys, **options):
    flags = np.zeros(count, dtype=bool)
    flags[list(keys)] = True
    return Packets(100 + 10 * np.arange(count), np.full(count, 900), flags, **({"complete": True} | options))


class TestSplit:
    @pytest.mark.parametrize(
        ("count", "parts"),
        [(799, 1), (800, 2), (5000, 2), (5001, 4), (10000, 4)],
    )
    def test_the_number_of_parts_is_even_and_each_is_at_most_2500_frames(self, count, parts):
        found = split(packets(count, range(count)))
        assert len(found) == parts
        assert max(np.diff([p.first for p in found] + [count])) <= 2500

    @pytest.mark.parametrize(("key", "parts"), [(399, 1), (400, 2), (600, 2), (601, 1)])
    def test_a_part_has_400_frames_at_least(self, key, parts):
        """Of 1000 frames with one key frame beside the first."""
        assert len(split(packets(1000, [key]))) == parts

    def test_parts_overlap_by_64_frames(self):
        first, second = split(packets(1000, [0, 480, 530]))
        assert (first.first, first.start, first.stop) == (0, None, 100 + 10 * (480 + 64))
        assert (second.first, second.start, second.stop) == (480, 100 + 10 * 480, None)

    @pytest.mark.parametrize(("second", "starts"), [(2399, [0, 2000, 3751]), (2400, [0, 2000, 2400, 3751])])
    def test_each_part_begins_400_frames_after_the_previous_one(self, second, starts):
        found = split(packets(5001, [0, 2000, second, 3751]))
        assert [p.first for p in found] == starts
        assert [p.start for p in found[1:]] == [100 + 10 * k for k in starts[1:]]
        assert [p.stop for p in found[:-1]] == [100 + 10 * (k + 64) for k in starts[1:]]

    def test_the_key_frame_nearest_to_the_division_is_taken(self):
        assert [p.first for p in split(packets(1000, [0, 440, 530]))] == [0, 530]

    def test_without_reliable_stamps_a_film_is_one_part(self):
        whole = packets(1000, range(0, 1000, 50))
        assert len(split(whole)) == 2
        stamps = whole.stamps.copy()
        stamps[700] = stamps[699]
        assert split(
            Packets(
                stamps,
                whole.sizes if hasattr(whole, "sizes") else np.full(1000, 900),
                whole.key,
                complete=True,
            )
        ) == (Part(),)
        assert split(packets(1000, range(0, 1000, 50), complete=False)) == (Part(),)

    @pytest.mark.parametrize(("keys", "part", "expected"), [
        ([0, 255], Part(), None),
        ([0, 256], Part(), 256),
        ([0, 256, 512, 513], Part(), 512),  # at most a batch
        ([0, 400, 700], Part(first=100, start=1100), 400),
        ([0, 355], Part(first=100, start=1100), None),
        ([0, 300], Part(stop=100 + 10 * 301), 300),
        ([0, 300], Part(stop=100 + 10 * 300), None),
    ])  # fmt: skip
    def test_the_second_start_of_a_part(self, keys, part, expected):
        assert LEARNT == 256
        assert module._second_start(packets(1000, keys), part) == expected


class TestBeginning:
    @pytest.mark.parametrize(
        ("keys", "part", "stop"),
        [([0, 300], Part(), 300), ([0], Part(), 256), ([0, 900], Part(first=900, start=9100), 999)],
    )
    def test_a_part_begins_up_to_a_key_frame_or_256_frames(self, monkeypatch, keys, part, stop):
        """At most to the last frame of the film."""
        film = packets(1000, keys)
        opened, learnt = [], []

        class Reader:
            stamps, bad_packets, corrupt = "stamps", 1, 2

            def __init__(self, path, threads, part, info):
                opened.append(part)

            def __enter__(self):
                return self

            def __exit__(self, *_):
                pass

        work = SimpleNamespace(filled=3, learn_batch=lambda: learnt.append(1))
        monkeypatch.setattr(module, "Reader", Reader)
        monkeypatch.setattr(module, "_taken", lambda *_: iter(()))
        monkeypatch.setattr(module.pickle, "loads", lambda _: work)
        found = module._begin(
            SimpleNamespace(packets=film, tracker=b"", info=SimpleNamespace(path="")), part, 1
        )
        assert opened[0].stop == 100 + 10 * stop
        assert (opened[0].first, opened[0].start) == (part.first, part.start)
        assert (found.stamps, found.bad_packets, found.corrupt, learnt) == ("stamps", 1, 2, [1])


class TestAdvance:
    def test_steps_are_in_median_periods(self):
        """A frame that is missing doubles the step; the first frame of the film has none."""
        stamps = np.array([0, 40, 80, 160, 200, 240, 280, 320, 360, 400])
        clock = module._Advance(stamps, 1e-3, Timing("frames", 25.0))
        assert not clock.stamped
        step = [clock.step(SimpleNamespace(pts=int(s), index=i)) for i, s in enumerate(stamps)]
        assert step == [0.0, 1.0, 1.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0]

    def test_steps_of_a_varying_rate_are_those_of_the_stamps(self):
        """With a capture rate of 25 frames/s the places are 2 and 1 periods apart, the median is 1."""
        stamps = np.cumsum(np.where(np.arange(60) % 3 == 1, 80, 40))
        clock = module._Advance(stamps, 1e-3, Timing("stamps", 25.0))
        assert clock.stamped
        found = [clock.step(SimpleNamespace(pts=int(s), index=i)) for i, s in enumerate(stamps)]
        assert found == pytest.approx([0.0, *np.where(np.arange(1, 60) % 3 == 1, 2.0, 1.0)], abs=0.02)
        slow = module._Advance(2 * stamps, 1e-3, Timing("stamps", 12.5))
        assert [slow.step(SimpleNamespace(pts=int(2 * s), index=i)) for i, s in enumerate(stamps)] == found

    def test_steps_are_relative_to_the_median_step(self, monkeypatch):
        times = SimpleNamespace(place=0, places=np.array([0.0, 3.0, 6.0, 12.0, 15.0]))
        stamps = np.array([5, 7, 9, 13, 15])
        asked = []
        timing = SimpleNamespace(of=lambda seconds, tick: asked.append((seconds.tolist(), tick)) or times)
        clock = module._Advance(stamps, 0.5, timing)
        found = [clock.step(SimpleNamespace(pts=int(s), index=i)) for i, s in enumerate(stamps)]
        assert found == [0.0, 1.0, 1.0, 2.0, 1.0]
        assert asked == [([2.5, 3.5, 4.5, 6.5, 7.5], 0.5)]


class TestTurns:
    @pytest.mark.parametrize("turns", [0, 2, -3])
    @pytest.mark.parametrize("faster", [0, 1, -1])
    def test_common_frames_determine_the_turns(self, turns, faster):
        frame = np.arange(200.0)
        angle = 0.4 * frame + 0.1 * np.random.default_rng(0).standard_normal(200)
        late = frame[100:]
        other = angle[100:] - TURN * turns - TURN * faster * (late - 100)
        added = turns_between(frame[:140], angle[:140], late, other)
        assert added == pytest.approx(TURN * turns + TURN * faster * (late - 100))

    @pytest.mark.parametrize("rate", [0.4, -0.7])
    def test_without_common_frames_the_motion_is_continued(self, rate):
        """With the mean of the rates over 24 frames before and after."""
        frame = np.arange(60.0)
        late = np.arange(75.0, 130.0)
        bent = rate * frame + 2e-3 * frame**2
        after = rate * late + 2e-3 * late**2 - 4 * TURN
        assert turns_between(frame, bent, late, after) == pytest.approx(np.full(55, 4 * TURN))
        lost = np.where(frame < 5, bent, np.nan)
        assert turns_between(frame, lost, late, np.full(55, np.nan)).tolist() == [0.0] * 55
        assert turns_between(frame, np.full(60, np.nan), late, after).tolist() == [0.0] * 55

    def test_one_common_frame_is_not_enough(self):
        frame, late = np.arange(50.0), np.arange(49.0, 90.0)
        angle = 0.4 * np.arange(90.0)
        other = angle[49:] - 3 * TURN
        other[0] += 1.7  # an outlier
        assert turns_between(frame, angle[:50], late, other) == pytest.approx(np.full(41, 3 * TURN))

    def test_a_single_frame_on_either_side_has_no_rate(self):
        frame, late = np.arange(50.0), np.arange(60.0, 90.0)
        first = np.full(50, np.nan)
        first[49] = 1.0
        second = np.full(30, np.nan)
        second[0] = 1.5 - 2 * TURN
        assert turns_between(frame, first, late, second) == pytest.approx(np.full(30, 2 * TURN))

    def test_the_zero_of_a_texture_is_the_median_difference(self):
        frame, late = np.arange(10.0), np.arange(6.0, 14.0)
        angle = np.arange(10.0)
        other = np.arange(6.0, 14.0) - 0.3
        other[1] -= 5.0
        other[2] = np.nan
        assert zero_between(frame, angle, late, other) == pytest.approx(0.3)
        assert zero_between(frame, angle, late + 20, other) == 0.0


class TestRows:
    """Two parts of 20 and 18 frames, of which four are in both."""

    def made(self, *, turns=2, zero=0.4, bad=(1, 2)):
        film = packets(34, [0, 16])
        parts = (Part(stop=int(film.stamps[20])), Part(first=16, start=int(film.stamps[16])))
        angle = 0.4 * np.arange(34.0)
        scene = SimpleNamespace(bodies=("rotor",), of=lambda name: (SimpleNamespace(name="red"),))
        store = module._PartResults(parts, film, None, {})
        for index, (a, b) in enumerate(((0, 20), (16, 34))):
            own = angle[a:b] - (TURN * turns if index else 0.0)
            rows = {
                "rotor/coarse": own,
                "rotor/red/angle": own + 0.01,
                "rotor/red/corner_angle": np.stack([own - 0.1, own + 0.1], axis=1),
                "rotor/texture/angle": own - (zero if index else 0.0),
                "again": np.full(b - a, bool(index)),
            }
            store.add(index, PartRows(rows, film.stamps[a:b], bad[index], 3 * bad[index]))
        return store, scene, angle

    def test_angles_are_continued_and_common_frames_are_those_of_the_first_part(self):
        store, scene, angle = self.made()
        assert (store.frames, store.todo, store.damage) == (34, [], (3, 9))
        rows = store.rows(scene)
        assert rows["rotor/coarse"] == pytest.approx(angle)
        assert rows["rotor/red/angle"] == pytest.approx(angle + 0.01)
        assert rows["rotor/red/corner_angle"] == pytest.approx(np.stack([angle - 0.1, angle + 0.1], axis=1))
        assert rows["rotor/texture/angle"] == pytest.approx(angle)
        assert rows["again"].tolist() == [False] * 20 + [True] * 14
        assert rows[module._STAMPS].tolist() == (100 + 10 * np.arange(34)).tolist()

    @pytest.mark.parametrize(
        ("change", "belongs"),
        [
            ({}, True),
            ({"part": 2}, False),
            ({"part": 2, "frames": 18}, False),
            ({"part": 0, "frames": 18}, True),
            ({"parts": 3}, False),
            ({"frames": 13}, False),
            ({"corrupt": -1}, False),
            ({"bad_packets": None}, False),
        ],
    )
    def test_a_record_of_this_film(self, change, belongs):
        store, _, _ = self.made()
        found = store._memory[1]
        arrays = found.rows | {module._STAMPS: found.stamps}
        store._columns = {name: (a.shape[1:], a.dtype.str) for name, a in arrays.items()}
        facts = store._facts[1] | change
        assert store._belongs(SimpleNamespace(facts=facts, arrays=arrays)) is belongs
        if not change:
            strange = arrays | {module._STAMPS: found.stamps + 1}
            assert not store._belongs(SimpleNamespace(facts=facts, arrays=strange))
            short = arrays | {"again": arrays["again"][1:]}
            assert not store._belongs(SimpleNamespace(facts=facts, arrays=short))
            assert not store._belongs(SimpleNamespace(facts=facts, arrays={module._STAMPS: found.stamps}))

    def test_a_part_is_stored_in_its_journal(self):
        """A part without a frame of its own is not stored."""
        store, scene, angle = self.made(turns=0)
        records = []

        class Journal:
            def __len__(self):
                return len(records)

            def records(self):
                return iter(())

            def append(self, facts, arrays):
                records.append(SimpleNamespace(facts=facts, arrays=arrays))

            def record(self, index):
                return records[index]

        kept = module._PartResults(store._parts, store._packets, Journal(), {})
        for index in (1, 0):
            found = store._memory[index]
            kept.add(index, found)
            assert set(records[-1].arrays) == {*found.rows, module._STAMPS}
            assert records[-1].facts == {
                "part": index, "parts": 2, "frames": 14 if index else 20,
                "bad_packets": found.bad_packets, "corrupt": found.corrupt,
            }  # fmt: skip
        assert kept.rows(scene)["rotor/coarse"] == pytest.approx(angle)
        kept.add(1, PartRows({}, np.zeros(0, dtype=np.int64), 0, 0))
        assert len(records) == 2

    def test_parts_that_are_not_done(self):
        store, _, _ = self.made()
        del store._facts[0]
        assert (store.todo, store.frames) == ([0], 14)


@pytest.mark.parametrize(("frames", "done"), [([5, 7], 12), ([5, None, "x"], 5), ([], 0)])
def test_frames_of_an_unfinished_run(frames, done):
    journal = SimpleNamespace(records=lambda: [SimpleNamespace(facts={"frames": n}) for n in frames])
    assert module.frames_done(journal) == done


class TestWorkers:
    """Parts of 30 frames; a process that has done its part says so at once."""

    def workers(self, parts, *, others=None, broken=(), refused=()):
        made = PartWorkers.__new__(PartWorkers)
        made.parts, made._done, made._pool = parts, None, WorkerPool(0)
        if others is not None:
            made._done = SimpleNamespace(value=others)

            def begin(run, task, film, part):
                if part in refused:
                    return None
                future: Future[str] = Future()
                if part in broken:
                    future.set_exception(BrokenProcessPool())
                else:
                    future.set_result(f"{part} by a process")
                return future

            made._pool = SimpleNamespace(processes=2, begin=begin)
        return made

    def ran(self, workers, todo, **options):
        said = []
        task = lambda film, part, threads, count: count(30) or f"{part} by {threads}"  # noqa: E731
        found = dict(workers.run(task, "film", todo, 4, lambda *a: said.append(a), **options))
        return found, said

    def test_one_process_runs_all_parts_and_counts_their_frames(self):
        found, said = self.ran(self.workers("abc"), [0, 2], done=100, total=140)
        assert found == {0: "a by 4", 2: "c by 4"}
        assert said == [(130, 140), (140, 140)]  # at most all
        assert self.ran(self.workers("abc"), [1])[1] == [(30, None)]

    def test_processes_take_the_first_parts_and_count_theirs(self):
        found, said = self.ran(self.workers("ab", others=50), [1], done=100, total=999)
        assert found == {1: "b by 4"}  # one part needs no process
        assert said == [(180, 999)]
        found, _ = self.ran(self.workers("ab", others=50), [0, 1])
        assert found == {0: "a by a process", 1: "b by a process"}

    def test_a_part_whose_process_was_killed_is_run_again(self):
        found, said = self.ran(self.workers("ab", others=50, broken="a"), [0, 1], done=7, total=999)
        assert found[0] == "a by 1"
        assert said[-1][0] >= 87

    def test_beside_a_process_a_part_has_one_thread(self):
        found, _ = self.ran(self.workers("abc", others=0, refused="b"), [0, 1, 2])
        assert found == {0: "a by a process", 1: "b by 1", 2: "c by 1"}
        found, _ = self.ran(self.workers("abc", others=0, refused="abc"), [0, 1, 2])
        assert found[0] == "a by 4"


class TestPart:
    """A film of 1000 frames; a part of it from frame 100, whose beginning up to the key frame 400 may be stored."""

    def tracked(self, monkeypatch, *, learnt, stored=True):
        read, counted = [], []

        class Reader:
            stamps, bad_packets, corrupt = np.array([7, 8, 9]), 5, 3

            def __init__(self, path, threads, part, info):
                read.append((path, threads, part.first, part.start, part.stop))

            def __enter__(self):
                return self

            def __exit__(self, *_):
                pass

        class Map:
            common = None

            def replace(self, common):
                self.common = common

        def work_of(size):
            batches = iter([{"again": np.full(size, True)}, {"again": np.full(1, False)}])
            return SimpleNamespace(maps=[Map(), Map()], measure_batch=lambda: next(batches))

        new, begun = work_of(2), work_of(4)
        beginning = module._Beginning(begun, np.array([5, 6]), 20, 30)
        monkeypatch.setattr(module, "Reader", Reader)
        monkeypatch.setattr(module.pickle, "loads", lambda _: new)
        monkeypatch.setattr(module, "_stored", lambda *_: beginning if stored else None)
        monkeypatch.setattr(module, "_begin", lambda *_: beginning)
        monkeypatch.setattr(
            module, "_taken", lambda work, film, reader, first: iter([None] * (2 if first == 100 else 9))
        )
        film = SimpleNamespace(
            packets=packets(1000, [0, 100, 400]),
            info=SimpleNamespace(path="film"),
            tracker=b"",
            learnt=learnt,
            maps=("one", "two"),
        )
        part = Part(first=100, start=1100, stop=5100)
        found = module.track_part(film, part, 3, counted.append)
        used = begun if 100 in learnt else new
        assert [m.common for m in used.maps] == ["one", "two"]
        return found, read, counted

    @pytest.mark.parametrize("stored", [True, False])
    def test_a_part_goes_on_after_its_beginning(self, monkeypatch, stored):
        found, read, counted = self.tracked(monkeypatch, learnt=(0, 100), stored=stored)
        assert read == [("film", 3, 400, 4100, 5100)]
        assert counted == [4, 1]
        assert found.rows["again"].tolist() == [True] * 4 + [False]
        assert found.stamps.tolist() == [5, 6, 7, 8, 9]
        assert (found.bad_packets, found.corrupt) == (25, 33)

    def test_a_part_without_a_beginning_is_tracked_as_a_whole(self, monkeypatch):
        found, read, counted = self.tracked(monkeypatch, learnt=(0,))
        assert read == [("film", 3, 100, 1100, 5100)]
        assert counted == [2, 1]
        assert found.stamps.tolist() == [7, 8, 9]
        assert (found.bad_packets, found.corrupt) == (5, 3)

    def test_a_stored_beginning_is_read_once(self, tmp_path):
        film = SimpleNamespace(folder=tmp_path)
        with (tmp_path / "100").open("wb") as file:
            module.pickle.dump("begun", file)
        assert module._stored(film, Part(first=100)) == "begun"
        assert module._stored(film, Part(first=100)) is None
        (tmp_path / "7").write_bytes(b"")
        assert module._stored(film, Part(first=7)) is None

    def test_a_beginning_is_stored_under_its_first_frame(self, monkeypatch, tmp_path):
        begun = module._Beginning(SimpleNamespace(maps=["map"]), np.array([5]), 1, 2)
        monkeypatch.setattr(module, "_begin", lambda *_: begun)
        film = SimpleNamespace(folder=tmp_path)
        assert module.learn_part(film, Part(first=100), 1, None) == ["map"]
        again = module._stored(film, Part(first=100))
        assert (again.stamps.tolist(), again.bad_packets, again.corrupt) == ([5], 1, 2)
        assert module.learn_part(SimpleNamespace(folder=tmp_path / "absent"), Part(), 1, None) == ["map"]

    @pytest.mark.parametrize(("full", "filled", "held", "yields", "taken"), [
        ((2, 4), (), 1, 1, 3),  # three times of two, two and one frames; the last batch is not full
        ((2, 4), (4,), 0, 1, 2),  # a full batch, and none after it
        ((), (), 0, 0, 0),
    ])  # fmt: skip
    def test_a_tracker_takes_frames_and_stops_after_a_batch(
        self, monkeypatch, full, filled, held, yields, taken
    ):
        done = []
        work = SimpleNamespace(filled=0, full=False, held=[])

        def keep(frame, step, *, stamped):
            assert (step, stamped) == (float(frame.index > 0), False)
            work.held.append(frame)
            work.full = frame.index + 1 in full

        def take(_, part):
            done.append((part, len(work.held)))
            work.filled = module._film_tracker.BATCH if sum(n for _, n in done) in filled else 1
            work.held.clear()

        work.keep = keep
        monkeypatch.setattr(module, "_take", take)
        count = sum((max(full, default=0), held))
        reader = [SimpleNamespace(index=k, pts=100 + 10 * k) for k in range(count)]
        film = SimpleNamespace(
            packets=packets(count, [0]) if count else packets(5, [0]), timing=Timing("frames", 25.0)
        )

        class Frames(list):
            info = SimpleNamespace(time_base=1e-3)

        steps = 0
        for _ in module._taken(work, film, Frames(reader), 90):
            steps += 1
            work.filled = 0
        assert (steps, len(done)) == (yields, taken)
        assert all(part == 90 for part, _ in done)
        assert sum(n for _, n in done) == count


class TestProcesses:
    @pytest.mark.parametrize(
        ("workers", "parts", "cores", "count"),
        [(3, 4, 9, 3), (3, 2, 9, 2), (None, 8, 5, 5), (None, 4, 9, 4), (1, 4, 9, 1), (9, 1, 9, 1)],
    )
    def test_processes_are_as_many_as_wanted_and_as_parts(self, monkeypatch, workers, parts, cores, count):
        """The caller is one of them."""
        made = []
        monkeypatch.setattr(module, "read_packets", lambda path: f"packets of {path}")
        monkeypatch.setattr(module, "split", lambda found: ("part",) * parts)
        monkeypatch.setattr(module, "available_cores", lambda: cores)
        monkeypatch.setattr(
            module, "get_context", lambda way: SimpleNamespace(Value=lambda kind, at: (way, kind, at))
        )
        monkeypatch.setattr(module, "WorkerPool", lambda *given: made.append(given) or "pool")
        found = PartWorkers("film", workers)
        assert (found.count, len(found.parts), found.packets) == (count, parts, "packets of film")
        value = ("spawn", "q", 0)
        pool = [(count - 1, module._start_worker, (value, None))] if count > 1 else []
        assert made == [(0,), *pool]
        assert found._done == (value if pool else None)

    def test_without_semaphores_the_caller_alone_tracks(self, monkeypatch):
        def refuse(_):
            raise OSError

        monkeypatch.setattr(module, "read_packets", lambda _: None)
        monkeypatch.setattr(module, "split", lambda _: ("part",) * 4)
        monkeypatch.setattr(module, "get_context", refuse)
        found = PartWorkers("film", 3)
        assert (found._done, found._pool.processes) == (None, 0)

    @pytest.mark.parametrize(("processes", "begun"), [(0, 0), (1, 0), (3, 2)])
    def test_all_processes_but_the_first_are_started_at_once(self, processes, begun):
        asked = []
        made = PartWorkers.__new__(PartWorkers)

        class Pool:
            begin = staticmethod(asked.append)

            def __init__(self):
                self.processes = processes

            def __enter__(self):
                return self

        made._pool = Pool()
        assert made.__enter__() is made
        assert len(asked) == begun


def test_the_angles_of_the_frames_that_were_stored_are_reported(monkeypatch):
    """Seven frames were tracked before, three are new."""
    angles = np.arange(20.0)
    body = SimpleNamespace(coarse=lambda place, count: angles[place : place + count].tolist())
    work = SimpleNamespace(
        held=[SimpleNamespace(index=100 + k) for k in range(3)], filled=7, bodies={"casing": body}
    )
    work.take = lambda: setattr(work, "filled", 10)
    told = []
    monkeypatch.setattr(module, "report_angles", lambda *given: told.append(given))
    module._take(work, 90)
    ((name, part, frames, found),) = told
    assert (name, part, frames.tolist(), found) == ("casing", 90, [100, 101, 102], [7.0, 8.0, 9.0])


class TestFilm:
    """Ten parts of 20 frames without overlap; one marker."""

    PARTS = tuple(
        Part(first=20 * k, start=100 + 200 * k if k else None, stop=300 + 200 * k if k < 9 else None)
        for k in range(10)
    )

    def tracked(self, monkeypatch, *, parts=10, declared=0, empty=False):
        told = SimpleNamespace(added=[], runs=[], progress=[])
        film = packets(20 * parts, range(0, 20 * parts, 20))
        angle = 0.3 * np.arange(200.0)

        def rows(k):
            here = angle[20 * k : 20 * k + 20]
            found = {"rotor/coarse": here, "again": np.arange(20) == k, "disc": np.full((20, 2), float(k))}
            for f in fields(MarkerObservations):
                shape = (20, 2) if f.name in {"corner_angle", "corner_radius", "centre"} else (20,)
                found[f"rotor/red/{f.name}"] = np.full(shape, 1.0 + k)
            found["rotor/red/angle"] = here + 0.5
            return found

        def run(task, given, todo, threads, progress=None, done=0, total=None):
            told.runs.append((task, given, list(todo), threads, done, total))
            for k in reversed(todo):
                if task is module.learn_part:
                    yield k, [f"one {k}", f"two {k}"]
                elif not empty:
                    yield k, PartRows(rows(k), film.stamps[20 * k : 20 * k + 20], 1, k)
                else:
                    yield k, PartRows({}, np.zeros(0, dtype=np.int64), 0, 0)

        maps = [SimpleNamespace(add=lambda other, k=k: told.added.append((k, other))) for k in range(2)]
        work = SimpleNamespace(maps=maps, size=(64, 48), repeats=None)
        workers = SimpleNamespace(
            packets=film,
            parts=(*self.PARTS[: parts - 1], replace(self.PARTS[parts - 1], stop=None)),
            run=run,
        )
        scene = SimpleNamespace(bodies=("rotor",), of=lambda name: (SimpleNamespace(name="red"),))
        info = SimpleNamespace(frames_declared=declared, time_base=0.01)
        monkeypatch.setattr(module, "probe", lambda path: info)
        monkeypatch.setattr(module, "_columns", lambda *_: {})
        monkeypatch.setattr(module.pickle, "dumps", lambda *_, **__: b"tracker")
        monkeypatch.setattr(module, "film_warnings", lambda *given: (f"damage {given[2:]}",))
        found = module.track_film(
            workers,
            "film",
            scene,
            work,
            3,
            lambda *given: told.progress.append(given),
            Timing("frames", 10.0),
        )
        return found, told, maps

    def test_maps_are_learnt_from_eight_parts_and_added_in_their_order(self, monkeypatch):
        found, told, maps = self.tracked(monkeypatch)
        some = [0, 1, 2, 3, 5, 6, 7, 9]
        learn, track = told.runs
        assert (learn[0], learn[2], learn[3]) == (module.learn_part, some, 3)
        assert told.added == [(k, f"{word} {i}") for i in some for k, word in enumerate(("one", "two"))]
        assert (track[0], track[2:]) == (module.track_part, (list(range(10)), 3, 0, 200))
        assert track[1].learnt == tuple(20 * k for k in some)
        assert track[1].maps == tuple(maps)
        assert track[1].tracker == b"tracker"
        assert learn[1].learnt == ()
        assert told.progress == [(200, 200)]
        assert found.bodies["rotor"].coarse == pytest.approx(0.3 * np.arange(200))
        red = found.bodies["rotor"].markers["red"]
        assert red.angle == pytest.approx(0.5 + 0.3 * np.arange(200))
        assert red.gain.tolist() == np.repeat(1.0 + np.arange(10), 20).tolist()
        assert red.centre.shape == (200, 2)
        assert np.flatnonzero(found.again).tolist() == [21 * k for k in range(10)]
        assert found.pts_time == pytest.approx(0.01 * (100 + 10 * np.arange(200)))
        assert found.warnings == (f"damage {(10, 45)}",)
        assert found.size == (64, 48)
        assert found.disc[:, 0].tolist() == np.repeat(np.arange(10.0), 20).tolist()

    def test_a_film_of_one_part_learns_in_this_part(self, monkeypatch):
        _, told, _ = self.tracked(monkeypatch, parts=1, declared=25)
        ((task, film, todo, *_, total),) = told.runs
        assert (task, todo, film.learnt, film.maps, total) == (module.track_part, [0], (), (), 25)
        assert told.added == []
        assert told.progress == [(20, 25)]

    def test_a_film_without_a_frame_is_refused(self, monkeypatch):
        with pytest.raises(VideoError, match="No frame"):
            self.tracked(monkeypatch, parts=1, empty=True)


def test_angles_of_finished_parts_are_reported_with_their_frames():
    store, scene, angle = TestRows().made(turns=0)
    store.report(scene)  # without a receiver nothing happens
    said = []
    with angles_sent_to(lambda *given: said.append(given)):
        store.report(scene)
    assert [(name, part) for name, part, *_ in said] == [("rotor", 0), ("rotor", 16)]
    assert [frames.tolist() for *_, frames, _ in said] == [list(range(20)), list(range(16, 34))]
    assert said[1][3] == pytest.approx(angle[16:])


def test_frames_of_a_process_are_counted_together(monkeypatch):
    counter = SimpleNamespace(value=3, get_lock=nullcontext)
    monkeypatch.setattr(module, "_done", None)
    sinks = []
    monkeypatch.setattr(module, "set_sink", sinks.append)
    module._count(5)
    module._start_worker(counter, "sink")
    module._count(5)
    module._count(2)
    assert (counter.value, sinks) == (10, ["sink"])
