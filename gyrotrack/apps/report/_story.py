"""The answer of a study in one picture (``gyrotrack demo``)."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyrotrack._errors import OutputError
from gyrotrack.io._atomic import new_file, refuse_existing
from gyrotrack.plotting._case_charts import residual_chart, speed_chart
from gyrotrack.plotting._charts import draw
from gyrotrack.plotting._discovery import figures_of_merit
from gyrotrack.plotting._study_data import StudyView, gather
from gyrotrack.plotting._style import canvas, plain, style

if TYPE_CHECKING:
    from fitting.discovery._select import Step
    from fitting.discovery._verdict import Diagnosis


_DPI = 150


def story_picture(
    history: Sequence[Step],
    diagnosis: Diagnosis | None,
    path: Path,
    *,
    frame: NDArray[np.uint8] | None = None,
    force: bool = False,
) -> Path:
    """Draw the first case: speed, residual before and after, and the figure of merit that fell most.

    Parameters
    ----------
    history, diagnosis
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
        The suffix is another, the file exists and `force` is not set, or it cannot be written.
    """
    path = Path(path)
    kind = path.suffix.lower().removeprefix(".")
    if kind not in {"png", "svg"}:
        raise OutputError(f"Unknown picture format: {path}.", "Use a name that ends in .png or .svg.")
    refuse_existing(path, force=force)
    view = gather(history, diagnosis)
    case = view.cases[0]
    with style():
        figure = canvas(15.0, 4.4)
        left, middle, right = figure.subplots(1, 3, width_ratios=[1, 1.15, 0.85])
        draw(left, speed_chart(case, "casing"))
        left.legend(loc="lower right" if frame is not None else "best")
        left.set_title("1  measured and modelled")
        if frame is not None:
            inset = left.inset_axes((0.19, 0.12, 0.42, 0.48))
            inset.imshow(frame)
            inset.set_xticks([])
            inset.set_yticks([])
            inset.grid(visible=False)
        draw(middle, residual_chart(case, "casing"), [i for i in case.intervals if i.body == "casing"])
        middle.legend(loc="best")
        middle.set_title("2  residual")
        _merit(right, view)
        stream = io.BytesIO()
        metadata: dict[str, Any] = {"Date": None, "Creator": None} if kind == "svg" else {"Software": None}
        figure.savefig(stream, format=kind, dpi=_DPI, metadata=metadata)
    with new_file(path, force=force) as out:
        out.write(stream.getvalue())
    return path


def _merit(ax: Any, view: StudyView) -> None:
    """Draw the figure of merit that fell by the largest factor."""
    steps = view.steps
    kinds = {
        "cross-validation error [noise]": (np.array([s.held_out for s in steps]), 1.0),
        f"rms error of the {view.body} [rad/s]": (np.array([s.rmse for s in steps]), view.rmse_floor),
    }
    title = max(kinds, key=lambda k: kinds[k][0][0] / max(kinds[k][0][-1], 1e-300))
    values, limit = kinds[title]
    figures_of_merit(ax, values, limit, [""] * len(steps))
    ax.invert_yaxis()
    ax.set_yticks(range(len(steps)), [plain(s.change, 60).replace(".", ".\n", 1) for s in steps])
    ax.set_xlabel(title)
    ax.set_title("3  figure of merit (dashed: noise limit)")
