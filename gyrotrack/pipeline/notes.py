"""What a pass through a film has measured so far: kept in memory, or in a journal from which a run can go on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np
import numpy.typing as npt

from gyrotrack.dataset.columns import new_columns, set_down
from gyrotrack.dataset.journal import Journal
from gyrotrack.pipeline.memento import Memento, put_back, take
from gyrotrack.video import Frame, Mark, Reader

Rows = dict[str, npt.NDArray[Any]]

BATCHES = 2
"""Batches in a record of the journal: a kill costs at most the work on these."""
_STATE, _STAMPS = "state:", "stamps"


def frames_kept(journal: Journal) -> int:
    """Return how many frames an unfinished run has done, as its journal says."""
    last = 0
    for record in journal.records():
        last = int(record.facts["mark"]["decoded"])
    return last


class Notes:
    """Rows of a pass, batch by batch, and with a journal the state of the tracker now and then.

    Parameters
    ----------
    journal : Journal, optional
        Where to keep them; without it they are kept in memory.
    """

    def __init__(self, journal: Journal | None = None) -> None:
        self._journal = journal
        self._waiting: list[Rows] = []
        self._start = Memento({}, {})
        self._saved = 0

    def take_up(self, work: Any, reader: Reader) -> Iterator[Frame]:
        """Bring a new tracker to where the journal ends, and return the frames that follow.

        A journal whose last frame the film does not show any more is started anew.
        """
        if self._journal is None:
            return iter(reader)
        self._start = take(work)
        stamps, last = [], None
        for last in self._journal.records():
            stamps += last.arrays[_STAMPS].tolist()
        if last is None:
            return iter(reader)
        mark = Mark(**last.facts["mark"])
        frames = reader.after(mark, stamps)
        if frames is None:
            self._journal.restart()
            reader.rewind()
            return iter(reader)
        state = {n.removeprefix(_STATE): a for n, a in last.arrays.items() if n.startswith(_STATE)}
        put_back(work, Memento(last.facts["values"], state))
        self._saved = mark.decoded
        return frames

    def add(self, rows: Rows, work: Any, reader: Reader, last: Frame, *, end: bool = False) -> None:
        """Keep the rows of a batch, which ends with the frame `last`; at the `end` of the film all at once."""
        self._waiting.append(rows)
        if self._journal is None or (len(self._waiting) < BATCHES and not end):
            return
        now = take(work).since(self._start)
        arrays = {name: np.concatenate([batch[name] for batch in self._waiting]) for name in rows}
        arrays |= {_STATE + name: value for name, value in now.arrays.items()}
        arrays[_STAMPS] = reader.stamps[self._saved :]
        self._journal.append({"mark": asdict(reader.mark(last)), "values": now.values}, arrays)
        self._waiting, self._saved = [], reader.decoded

    def rows(self, count: int) -> Rows:
        """Return all `count` rows of every quantity, as long columns that are out of the way."""
        out: Rows = {}
        place = 0
        for part in self._parts():
            if not out:
                out = new_columns(count, {name: (v.shape[1:], v.dtype) for name, v in part.items()})
            size = len(next(iter(part.values())))
            for name, values in part.items():
                out[name][place : place + size] = values
            place += size
            set_down()
        return out

    def _parts(self) -> Iterator[Rows]:
        if self._journal is not None:
            for record in self._journal.records():
                arrays = record.arrays
                yield {n: a for n, a in arrays.items() if n != _STAMPS and not n.startswith(_STATE)}
        yield from self._waiting
