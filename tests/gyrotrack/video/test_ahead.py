"""Decoding in a thread of its own: the same items, errors where they belong, an end when it is closed."""

import threading
import time

import pytest

from gyrotrack.video._decoder import CHUNK, WAITING, read_ahead


def decoders():
    return [t for t in threading.enumerate() if t.name.startswith("decoding")]


@pytest.mark.parametrize("count", [0, 1, CHUNK - 1, CHUNK, CHUNK + 1, 100])
def test_all_items_come_in_order(count):
    assert list(read_ahead(iter(range(count)))) == list(range(count))


def test_it_works_ahead_but_not_far():
    made = []

    def source():
        for k in range(1000):
            made.append(k)
            yield k

    ahead = read_ahead(source())
    next(ahead)
    limit = time.monotonic() + 10
    while len(made) < CHUNK * (WAITING + 1) and time.monotonic() < limit:
        time.sleep(0.01)
    time.sleep(0.2)
    assert len(made) == CHUNK * (WAITING + 1)
    ahead.close()
    assert len(made) <= CHUNK * (2 * WAITING + 2)


def test_an_error_comes_after_the_items_before_it():
    def source():
        yield from range(CHUNK + 2)
        raise ValueError("broken")

    items = read_ahead(source())
    assert [next(items) for _ in range(CHUNK + 2)] == list(range(CHUNK + 2))
    with pytest.raises(ValueError, match="broken"):
        next(items)


def test_closing_ends_the_thread_wherever_it_is():
    for taken in (0, 1, 20):
        ahead = read_ahead(iter(range(10**9)))
        for _ in range(taken):
            next(ahead)
        ahead.close()
        assert not decoders()
