"""The scene of a film, found before tracking: sample frames, centre, markers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from threading import Lock

import numpy as np
import numpy.typing as npt

from gyrotrack._arrays import Integers, Singles
from gyrotrack._column_store import new_columns, release_pages
from gyrotrack._errors import VideoError
from gyrotrack.tracking._film import reduced
from gyrotrack.tracking._polar import Ring, unroll
from gyrotrack.video._container import Frame, read_packets
from gyrotrack.video._decoder import Reader, frames_at


@dataclass(frozen=True)
class Disc:
    """The coloured disc at the centre: (x, y) and radius in px, and its chroma relative to the surroundings."""

    centre: tuple[float, float]
    radius: float
    chroma: tuple[float, float]


@dataclass(frozen=True)
class Marker:
    """Geometry and contrast of one marker in a clip."""

    name: str  # from the profile
    body: str
    colour: str
    inner: float  # inner and outer radius [px]
    outer: float
    half_width: float  # half width at half maximum, with motion blur, as an angle at the centre [rad]
    # difference from the background: (U, V) for a colour, (Y, 0) for white, in grey levels
    contrast: tuple[float, float]
    foot: float  # half width at a tenth of the maximum [rad]
    mount: float = 0.0  # angle relative to the zero of the body, as seen (counter-clockwise) [rad]
    dwell: float = 0.0  # largest share of the samples with the marker at one angle: near 1 for a body at rest

    @property
    def radius(self) -> float:
        """Radius of the middle in px."""
        return 0.5 * (self.inner + self.outer)


@dataclass(frozen=True)
class Scene:
    """The scene of a clip: centre of rotation, disc and markers."""

    centre: tuple[float, float]  # centre of rotation (x, y) [px] at the time of acquisition
    disc: Disc | None  # the disc at the centre; None where the centre is taken from the orbit
    markers: tuple[Marker, ...]
    missing: tuple[str, ...] = ()  # names of markers that were not found
    warnings: tuple[str, ...] = ()  # for the user
    # offset of the centre of each body's orbits from `centre`, (x, y) in px, y downwards, if it is significant: in the
    # image of a tilted camera, a body below the plane of the hub moves about another point
    offsets: dict[str, tuple[float, float]] = field(default_factory=dict)
    # the body of each marker of the profile, also of those that were not found
    body_of: dict[str, str] = field(default_factory=dict)
    doubts: tuple[str, ...] = ()  # reasons to inspect the result

    def axis(self, body: str) -> tuple[float, float]:
        """Return the centre of a body's orbits at the time of acquisition, (x, y) in px."""
        x, y = self.offsets.get(body, (0.0, 0.0))
        return self.centre[0] + x, self.centre[1] + y

    def of(self, body: str) -> tuple[Marker, ...]:
        """Return the markers of one body."""
        return tuple(marker for marker in self.markers if marker.body == body)

    @property
    def bodies(self) -> tuple[str, ...]:
        """Bodies of which at least one marker was found."""
        return tuple(body for body in ("casing", "rotor") if self.of(body))


HEAD = 48
"""Number of consecutive frames at the start of a film [frames]. Derived: at 0.2 rad per frame they cover 9.6 rad, more
than a turn."""
KEYS = 20
"""The rest of a film is sampled by key frames alone if it has at least this number of key frames [frames]. Chosen: key
frames are decoded fastest; a smaller number gives a poor background."""
LATER = 32
"""Number of samples from the rest of a film with fewer key frames [frames]. Chosen: a larger number costs time, a
smaller one gives a poor background."""
DECODED = 240
"""Largest number of frames of 1280 x 720 px that are decoded for the later samples; the number is inversely
proportional to the size of a frame [frames]. Chosen: a larger number costs time, a smaller one samples the film less
evenly."""
FEWEST = 8
"""Smallest number of frames of a film [frames]. Chosen: a smaller number does not show a motion, a larger one refuses
excerpts."""
_BLOB_WIDTH = 400
"""Smallest width of the chroma plane for which blobs are searched for at half size [px]. Chosen: a larger value costs
time, a smaller one loses small markers."""


_BLOCK = 8
"""Number of frames in a temporary file [frames]. Chosen: a larger number occupies more memory, a smaller one opens more
files."""


class FrameStore:
    """Copies frames into temporary files, so that whole pictures do not occupy memory."""

    def __init__(self) -> None:
        self._planes: dict[str, npt.NDArray[np.uint8]] = {}
        self._used = _BLOCK

    def __call__(self, frame: Frame) -> Frame:
        """Return a copy of a frame that is independent of the decoder."""
        planes = {"y": frame.y, "u": frame.u, "v": frame.v}
        if self._used == _BLOCK or self._planes["y"].shape[1:] != frame.y.shape:
            kinds = {name: (plane.shape, np.uint8) for name, plane in planes.items()}
            self._planes, self._used = new_columns(_BLOCK, kinds), 0
        for name, plane in planes.items():
            self._planes[name][self._used] = plane
        kept = {name: stored[self._used] for name, stored in self._planes.items()}
        self._used += 1
        release_pages()
        return replace(frame, **kept)


def in_turn(frames: Sequence[Frame]) -> Iterator[Frame]:
    """Yield stored frames, and release the memory of frames already read at intervals."""
    for count, frame in enumerate(frames, start=1):
        yield frame
        if count % _BLOCK == 0 or count == len(frames):
            release_pages()


@dataclass(frozen=True)
class Samples:
    """Sample frames; the first `head` of them are the first frames of the clip."""

    frames: tuple[Frame, ...]
    head: int

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the picture in px."""
        height, width = self.frames[0].y.shape
        return width, height

    @cached_property
    def scale(self) -> int:
        """Luma px per px of `chroma`: 2, or 4 for large pictures."""
        return 4 if self.frames[0].u.shape[1] > _BLOB_WIDTH else 2

    @cached_property
    def chroma(self) -> npt.NDArray[np.uint8]:
        """Chroma of the frames `spread`, shape (2, n, height, width), at a reduced resolution."""
        chosen = [self.frames[i] for i in self.spread]
        kept = np.ascontiguousarray if self.scale == 2 else partial(reduced, factor=2)
        return np.stack([(kept(f.u), kept(f.v)) for f in in_turn(chosen)], axis=1)

    @cached_property
    def still(self) -> Singles:
        """Median of `chroma` over the frames, shape (2, height, width)."""
        return np.asarray(np.median(self.chroma, axis=1), dtype=np.float32)

    @cached_property
    def spread(self) -> tuple[int, ...]:
        """Indices of the frames from which the scene is determined: all later frames, and a dozen of the head.

        An object that is visible only at first, for example the hand that starts the rotor, is then in few frames.
        """
        keys = range(self.head, len(self.frames))
        most = max(12, 48 - len(keys)) if len(keys) < 12 else 12
        head = np.unique(np.linspace(0, self.head - 1, min(self.head, most)).astype(int)).tolist()
        return (*head, *keys)

    def to_luma(self, x: float, y: float) -> tuple[float, float]:
        """Convert px of `chroma` to luma px."""
        shift = (self.scale - 1) / 2.0
        return self.scale * x + shift, self.scale * y + shift

    def strips(self, ring: Ring, frames: Sequence[int]) -> npt.NDArray[np.uint8]:
        """Unroll the chroma of some frames, shape (2, n, rows, columns)."""
        maps = ring.maps(chroma=True)
        some = [self.frames[k] for k in frames]
        return np.stack([(unroll(f.u, maps), unroll(f.v, maps)) for f in in_turn(some)], axis=1)

    def luma_strips(self, ring: Ring, frames: Sequence[int]) -> npt.NDArray[np.uint8]:
        """Unroll the luma of some frames, shape (n, rows, columns)."""
        maps = ring.maps(chroma=False)
        some = [self.frames[k] for k in frames]
        return np.stack([unroll(f.y, maps) for f in in_turn(some)])


def take_samples(path: Path, threads: int = 1) -> Samples:
    """Decode the samples of a film with `threads` threads; a VideoError if no frame can be decoded."""
    head: list[Frame] = []
    keep = FrameStore()
    with Reader(path) as reader:
        for frame in reader:
            head.append(keep(frame))
            if len(head) == HEAD:
                break
    if not head:
        raise VideoError(f"No frame of {path} can be decoded.", "Copy the film from the camera again.")
    if len(head) < FEWEST:
        what = f"{path} contains only {len(head)} frames; at least {FEWEST} are required to detect a motion."
        raise VideoError(what, "Give a longer film.")
    later = [
        frame
        for frame in _later(path, len(head), head[0].y.size, threads)
        if frame.y.shape == head[0].y.shape
    ]
    return Samples((*head, *later), len(head))


def _later(path: Path, head: int, pixels: int, threads: int) -> list[Frame]:
    """Decode frames spread over the film after the head: key frames, or frames between them if key frames are few.

    A frame is decoded from the previous key frame. If this takes too long, frames closer to the key frames are used.
    """
    packets = read_packets(path)
    count = len(packets.stamps)
    if count <= head or not packets.key.any():
        return []
    keys = np.flatnonzero(packets.key)
    if int(packets.key[head:].sum()) >= KEYS:
        wanted = keys[np.linspace(0, len(keys) - 1, KEYS).astype(np.int64)]
    else:
        wanted = np.unique(np.linspace(head, count - 1, LATER).astype(np.int64))
    start = keys[np.maximum(np.searchsorted(keys, wanted, side="right") - 1, 0)]
    cost = sum(int((wanted - start)[start == key].max()) for key in np.unique(start))
    share = min(DECODED * 1280 * 720 / pixels / max(cost, 1), 1.0)
    nearer = start + ((wanted - start) * share).astype(np.int64)
    store, lock = FrameStore(), Lock()

    def keep(frame: Frame) -> Frame:
        with lock:
            return store(frame)

    def decode(keys: Integers) -> dict[int, Frame]:
        return frames_at(path, packets.stamps[nearer[np.isin(start, keys)]].tolist(), keep)

    used = np.unique(start)
    parts = np.array_split(used, min(threads, len(used)))
    with ThreadPoolExecutor(len(parts)) as pool:
        found = {stamp: frame for part in pool.map(decode, parts) for stamp, frame in part.items()}
    return [found[stamp] for stamp in sorted(found)]
