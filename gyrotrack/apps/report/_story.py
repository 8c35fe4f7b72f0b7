"""The story of a study in one picture."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fitting._numbers import scaled, short
from gyrotrack._errors import OutputError
from gyrotrack.io._atomic import new_file, refuse_existing
from gyrotrack.plotting._motion import both_panel, casing_panel
from gyrotrack.plotting._study_data import Content, gather
from gyrotrack.plotting._style import AFTER, BEFORE, SKY, canvas, look, panel, plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from fitting.discovery._select import Step
    from fitting.discovery._verdict import Diagnosis


_DPI = 150
_WIDE = 8.0


def story_picture(
    rungs: Sequence[Step],
    diagnosis: Diagnosis | None,
    path: Path,
    *,
    frame: NDArray[np.uint8] | None = None,
    force: bool = False,
) -> Path:
    """Draw the story of the first case: the motion, the misfit before and after, the ladder.

    Parameters
    ----------
    rungs, diagnosis
        As for `write_report`.
    path : Path
        A ``.png`` or ``.svg`` file.
    frame : ndarray of uint8, shape (height, width, 3), optional
        A frame of the film (red, green, blue), shown in a corner of the first panel.
    force : bool
        Replace an existing file.

    Raises
    ------
    OutputError
        The name ends otherwise, the file exists and `force` is not set, or it cannot be written.
    """
    path = Path(path)
    kind = path.suffix.lower().removeprefix(".")
    if kind not in {"png", "svg"}:
        raise OutputError(f"{path} is no name of a picture.", "Let it end in .png or .svg.")
    refuse_existing(path, force=force)
    image = _draw(gather(rungs, diagnosis), frame, kind)
    with new_file(path, force=force) as stream:
        stream.write(image)
    return path


def _draw(content: Content, frame: NDArray[np.uint8] | None, kind: str) -> bytes:
    view = content.cases[0]
    with look():
        figure = canvas(15.0, 4.4)
        left, middle, right = figure.subplots(1, 3, width_ratios=[1, 1.15, 0.85])
        casing_panel(left, view)
        left.legend(loc="lower right" if frame is not None else "best")
        panel(left, "1", "measured and fitted")
        if frame is not None:
            _inset(left, frame)
        both_panel(middle, view)
        middle.set_xlabel("time [s]")
        middle.legend(loc="best")
        panel(middle, "2", "what the model leaves")
        _fall(right, content)
        stream = io.BytesIO()
        nothing: dict[str, Any] = {"Date": None, "Creator": None} if kind == "svg" else {"Software": None}
        figure.savefig(stream, format=kind, dpi=_DPI, metadata=nothing)
        return stream.getvalue()


def _inset(ax: Axes, frame: NDArray[np.uint8]) -> None:
    inset = ax.inset_axes((0.19, 0.12, 0.42, 0.48))
    inset.imshow(frame)
    inset.set_xticks([])
    inset.set_yticks([])
    inset.grid(visible=False)


def _fall(ax: Axes, content: Content) -> None:
    """Draw the error that fell most, with the name of what was added."""
    steps = content.steps
    kinds = {
        "held-out error [noise]": (np.array([s.held_out for s in steps]), 1.0),
        f"rms error of the {content.body} [rad/s]": (np.array([s.rmse for s in steps]), content.rmse_floor),
    }
    if steps[-1].torque_left > 0:
        kinds["torque that remains [N m]"] = (np.array([s.torque_left for s in steps]), steps[-1].torque_pure)
    title = max(kinds, key=lambda k: kinds[k][0][0] / max(kinds[k][0][-1], 1e-300))
    values, best = kinds[title]
    factor, prefix = (1.0, "") if "[noise]" in title else scaled(float(values.max()))
    values, best, title = factor * values, factor * best, title.replace("[", f"[{prefix}")
    colours = [BEFORE, *[SKY] * (len(steps) - 2), AFTER] if len(steps) > 1 else [BEFORE]
    ax.bar(np.arange(len(steps)), values, color=colours, width=0.6)
    if values.max() > _WIDE * min(best, float(values.min())):
        ax.set_yscale("log")
        ax.set_ylim(0.5 * best, 4 * float(values.max()))
    else:
        ax.set_ylim(0, 1.3 * float(values.max()))
    ax.axhline(best, color="black", linewidth=1, linestyle=(0, (4, 2)), label="noise alone")
    for i, value in enumerate(values):
        ax.annotate(
            short(float(value), 2),
            (i, value),
            xytext=(0, 4),
            textcoords="offset points",
            ha="center",
            fontweight="bold",
        )
    names = [plain(s.change, 60).replace("+", "+ ").replace(".", ".\n", 1) for s in steps]
    ax.set_xticks(range(len(steps)), names, fontsize=10)
    ax.set_xlim(-0.6, len(steps) - 0.4)
    ax.grid(visible=False, axis="x")
    ax.set_ylabel(title)
    ax.legend(loc="best")
    panel(ax, "3", "the error falls" if len(steps) > 1 else "the error")
