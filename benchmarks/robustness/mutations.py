"""Bytes flipped, cut out, overwritten and spliced, reproducibly by seed."""

import random

KINDS = ("flip", "cut", "zero", "splice", "swap")


def mutate(content, seed):
    """Return (kind, mutated bytes); a fifth of the seeds touches only the first 4 kB, where headers stand."""
    chance = random.Random(seed)  # noqa: S311 - not for secrets
    kind = KINDS[seed % len(KINDS)]
    data = bytearray(content)
    top = min(len(data), 4096) if chance.random() < 0.2 else len(data)
    a, b = sorted(chance.randrange(top) for _ in range(2))
    if kind == "flip":
        for _ in range(chance.choice((1, 1, 3, 10, 40))):
            data[chance.randrange(top)] ^= chance.randrange(1, 256)
    elif kind == "cut":
        del data[chance.randrange(1, len(data)) :]
    elif kind == "zero":
        b = min(b, a + chance.choice((1, 8, 512, 8192)))
        data[a:b] = bytes(b - a)
    elif kind == "splice":
        size = chance.choice((4, 64, 2048, 16384))
        place = chance.randrange(len(data))
        data[a : a + size] = data[place : place + size]
    else:
        del data[a : min(b, a + chance.choice((1, 7, 100, 5000)))]
    return kind, bytes(data)
