"""A refused film: a picture of its best candidate hub, and the error message that names the picture."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import cv2
import numpy as np

from gyrotrack._errors import GyrotrackError
from gyrotrack.plotting._frames import write_tiles
from gyrotrack.tracking._diagnosis import RefusedFilmError

_HUB = (0, 0, 255)


@contextmanager
def pictured_refusal(target: Path) -> Iterator[None]:
    """If the film is refused in this context, write a picture next to `target`, and name it in the hint of the error.

    TARGET.refused.png shows frames of the film and the best hub. An earlier picture is replaced.
    """
    try:
        yield
    except RefusedFilmError as error:
        with suppress(OSError, GyrotrackError):
            write_refusal(target.with_suffix(".refused.png"), error)
        raise


def write_refusal(path: Path, error: RefusedFilmError) -> None:
    """Write a PNG of frames that show why a film is refused, with a cross at the best hub; the hint names the PNG.

    An `error` without pictures is not changed.
    """
    if not error.frames:
        return
    tiles = []
    for frame in error.frames:
        tile = np.asarray(cv2.cvtColor(np.asarray(frame), cv2.COLOR_GRAY2BGR), dtype=np.uint8)
        if error.hub is not None:
            x, y = np.clip(np.round(error.hub), -30000, 30000).astype(int).tolist()
            cv2.drawMarker(tile, (x, y), _HUB, cv2.MARKER_CROSS, 16, 2)
        tiles.append(tile)
    where = "" if error.hub is None else f"; best hub ({error.hub[0]:.0f}, {error.hub[1]:.0f}) px"
    write_tiles(path, tiles, f"refused: {error.kind}{where}.", force=True)
    error.add_hint(f"The picture is {path}.")
