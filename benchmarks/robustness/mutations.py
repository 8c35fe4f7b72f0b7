"""Bytes flipped, cut out, overwritten and spliced, and HDF5 files torn or rebuilt to mislead, reproducibly by seed."""

import hashlib
import random

import h5py
import numpy as np

KINDS = ("flip", "cut", "zero", "splice", "swap")
MARK = b"\ngyrotrack sha256 "
SEAL = len(MARK) + 65


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


def unsealed(content):
    """Return a file without the hash behind its end: as another program leaves it that has changed it."""
    return content[:-SEAL]


def resealed(content):
    """Return an unsealed file with a hash that is true, so that only what is inside can give it away."""
    return content + MARK + hashlib.sha256(content).hexdigest().encode() + b"\n"


def torn(path, seed):
    """Tear one chunk of a file, as a write that stopped half-way does; return which dataset it belonged to."""
    chance = random.Random(seed)  # noqa: S311
    chunks = []
    with h5py.File(path, "r") as file:

        def note(name, item):
            if isinstance(item, h5py.Dataset) and item.chunks:
                infos = (item.id.get_chunk_info(i) for i in range(item.id.get_num_chunks()))
                chunks.extend((name, i.byte_offset, i.size) for i in infos)

        file.visititems(note)
    name, offset, size = chance.choice(chunks)
    data = bytearray(path.read_bytes())
    start = offset + chance.randrange(size)
    old = data[start : offset + size]
    while data[start : offset + size] == old:
        data[start : offset + size] = chance.choice((bytes(len(old)), chance.randbytes(len(old))))
    path.write_bytes(data)
    return name


def _virtual(file, name):
    layout = h5py.VirtualLayout(shape=(400,), dtype="f8")
    layout[:] = h5py.VirtualSource("elsewhere.h5", "x", shape=(400,))
    file.create_virtual_dataset(name, layout)


TRICKS = {
    "external link": lambda f, n: f.__setitem__(n, h5py.ExternalLink("elsewhere.h5", "/x")),
    "external group": lambda f, n: f.__setitem__(n, h5py.ExternalLink("elsewhere.h5", "/")),
    "soft link": lambda f, n: f.__setitem__(n, h5py.SoftLink("/" + n + "/x")),
    "external storage": lambda f, n: f.create_dataset(n, (400,), "f8", external=[("elsewhere.h5", 0, 3200)]),
    "virtual dataset": _virtual,
    "unknown filter": lambda f, n: f.create_dataset(n, data=np.zeros(400), compression="lzf"),
    "bomb of 8 TB": lambda f, n: f.create_dataset(n, (2**40,), "f8", chunks=(2**20,), compression="gzip"),
    "huge chunk": lambda f, n: f.create_dataset(n, (400,), "f8", chunks=(2**28,), maxshape=(None,)),
}


def mislead(path, seed):
    """Put a trick in the place of a random member, or beside it; return the name of the trick."""
    chance = random.Random(seed)  # noqa: S311
    with h5py.File(path, "r+") as file:
        names = []
        file.visit(names.append)
        place = chance.choice(names)
        if chance.random() < 0.3:
            place = place + "_more"
        else:
            del file[place]
        trick = chance.choice(sorted(TRICKS))
        TRICKS[trick](file, place)
    return trick
