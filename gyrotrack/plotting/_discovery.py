"""Figures of candidate effects, history of fits and parameter correlations, and the summary figure of a study."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fitting._numbers import POWERS, scaled, short
from fitting.discovery._select import equivalence_classes
from fitting.effects._expression import latex, sym
from gyrotrack._errors import OutputError
from gyrotrack.io._atomic import new_file, refuse_existing
from gyrotrack.plotting._case_charts import residual_chart, speed_chart
from gyrotrack.plotting._charts import (
    AFTER,
    BEFORE,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PALE,
    PURPLE,
    SKY,
    WIDTH,
    Picture,
    as_rows,
    beside,
    canvas,
    draw,
    in_lines,
    markup,
    picture_file,
    plain,
    style,
)
from gyrotrack.plotting._study_data import StudyView, gather

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from fitting.discovery._select import Candidate, Step
    from fitting.discovery._verdict import Diagnosis


_MAX_CANDIDATES = 12
_CLASSES = (GREEN, ORANGE, PURPLE, SKY)
# smallest ratio of a figure of merit to its noise limit for a logarithmic axis
_LOGARITHMIC = 20.0
_CLEAR_CHANGE = 0.05  # smallest relative change of a figure of merit that is stated


def candidates_picture(view: StudyView) -> Picture | None:
    """Draw the scores of candidate effects; None if no score is positive."""
    shown = [c for c in view.candidates if c.score > 0][:_MAX_CANDIDATES]
    if not shown:
        return None
    letters = equivalence_classes(shown)
    best = {shown[0].effect.name, *shown[0].indistinguishable_from}
    colours = []
    for c in shown:
        letter = letters.get(c.effect.name)
        if not c.significant:
            colours.append(PALE)
        elif c.effect.name in best:
            colours.append(BLUE)
        else:
            colours.append(_CLASSES[(ord(letter) - ord("A")) % len(_CLASSES)] if letter else "#777777")
    with style():
        figure = canvas(WIDTH, 1.0 + 0.42 * len(shown))
        ax = figure.subplots()
        roots = np.sqrt([c.score for c in shown])
        hatches = ["" if c.physical else "////" for c in shown]
        ax.barh(np.arange(len(shown)), roots, color=colours, hatch=hatches, edgecolor="#ffffff", height=0.66)
        ax.set_xlim(0, 1.42 * float(roots.max()))
        for i, c in enumerate(shown):
            text = rf"$\chi^2$ −{short(c.score)}"
            text += rf"   $\Delta$BIC {short(c.delta_bic)}" if np.isfinite(c.delta_bic) else "   not refitted"
            text += "" if c.significant else "   not significant"
            beside(ax, text, (roots[i], i), fontsize=9)
        as_rows(ax, [in_lines(view.name(c.effect).words) for c in shown])
        ax.set_xlabel(r"$\sqrt{\mathrm{improvement\ of\ }\chi^2}$ [σ]")
        _brackets(ax, shown, letters)
        caption = (
            "Improvement of χ²: decrease of the deviance of the base model by the candidate (after a refit if ΔBIC is "
            "given, otherwise predicted); its square root is about the significance in σ. Pale: not significant."
        )
        if letters:
            caption += " Bracket and common colour: equivalence class, indistinguishable with these data."
        if any(not c.physical for c in shown):
            caption += " Hatched: measurement effect."
        finding = _candidates_finding(view, shown)
        return Picture("candidates", markup(figure, "candidates", finding), caption, finding)


def _brackets(ax: Axes, shown: list[Candidate], letters: dict[str, str]) -> None:
    names = [c.effect.name for c in shown]
    for depth, letter in enumerate(sorted(set(letters.values()))):
        rows = [i for i, n in enumerate(names) if letters.get(n) == letter]
        if len(rows) < 2:
            continue
        x, first, last = 0.985 - 0.03 * depth, rows[0] - 0.3, rows[-1] + 0.3
        transform = ax.get_yaxis_transform()
        xs, ys = [x - 0.012, x, x, x - 0.012], [first, first, last, last]
        ax.plot(xs, ys, color="#000000", linewidth=1.2, transform=transform, clip_on=False)
        bold: dict[str, Any] = {"va": "center", "fontweight": "bold", "fontsize": 10}
        ax.text(x + 0.006, 0.5 * (first + last), letter, transform=transform, **bold)


def _candidates_finding(view: StudyView, shown: list[Candidate]) -> str:
    best = shown[0]
    if not best.significant:
        return "No candidate effect is significant."
    text = f"Largest improvement of χ²: {view.name(best.effect).words}, {short(best.score)}"
    if best.indistinguishable_from:
        alike = "; ".join(view.name(n).words for n in best.indistinguishable_from)
        text += f" (indistinguishable from {alike})"
    rest = [c for c in shown[1:] if c.effect.name not in best.indistinguishable_from]
    return text + (f"; next: {view.name(rest[0].effect).words}, {short(rest[0].score)}." if rest else ".")


# for each figure of merit: title, unit, attribute of a step, whether the unit gets an SI prefix
_KINDS = (
    ("rms error, {body}", "rad/s", "rmse", True),
    ("misfit", "noise", "misfit", False),
    ("cross-validation error", "noise", "held_out", False),
    ("unmodelled torque, rms", "{torque}", "torque_left", True),
    ("energy balance error", "", "energy_drift", True),
    ("change of BIC", "", "delta_bic", False),
)
_PHRASES = (
    ("rmse", "rms error of the {body}", " rad/s"),
    ("misfit", "misfit", " times the noise"),
    ("held_out", "cross-validation error", " times the noise"),
    ("torque_left", "unmodelled torque", " {torque} rms"),
)


def history_picture(view: StudyView) -> Picture:
    """Draw the figures of merit of all steps of the history of fits."""
    steps = view.steps
    noise = max(s.torque_pure for s in steps)
    limits = {"rmse": view.rmse_floor, "misfit": 1.0, "held_out": 1.0}
    if noise > 0:
        limits["torque_left"] = noise
    with style():
        figure = canvas(WIDTH, 1.5 + 2 * (0.55 + 0.36 * len(steps)))
        axes = figure.subplots(2, 3, sharey=True)
        for ax, (title, unit, name, takes_prefix) in zip(axes.flat, _KINDS, strict=True):
            values = np.array([getattr(s, name) for s in steps], dtype=float)
            texts = ["not resolved" if name == "torque_left" and v == 0 else "" for v in values]
            if name == "delta_bic":
                texts[0] = "start"
            size = float(np.abs(values[np.isfinite(values)]).max(initial=0.0))
            factor, prefix = scaled(size) if takes_prefix else (1.0, "")
            limit = limits.get(name)
            figures_of_merit(ax, factor * values, None if limit is None else factor * limit, texts)
            measure = f"{prefix}{unit}".replace("{torque}", view.torque_unit) if unit else POWERS[prefix]
            heading = title.replace("{body}", view.body)
            ax.set_title(f"{heading} [{measure}]" if measure else heading, fontweight="normal")
        for ax in axes[:, 0]:
            ax.set_yticks(range(len(steps)), [in_lines(s.words, 24) for s in steps])
        axes[0, 0].invert_yaxis()
        finding = history_finding(view)
        caption = (
            "One bar per fit. Dashed line: noise limit. Bars start at zero, or on a logarithmic axis at the noise "
            "limit."
        )
        if noise > 0:
            caption += (
                f" Process noise of the recordings {short(noise, 2)} {view.torque_unit} rms, estimated without a "
                "model and used for χ² and cross-validation error of all fits."
            )
        return Picture("history", markup(figure, "history", finding), caption, finding)


def figures_of_merit(
    ax: Axes, values: np.ndarray[tuple[int], np.dtype[np.float64]], limit: float | None, texts: list[str]
) -> None:
    """Draw one bar per fit, with `texts` or numbers; it starts at zero, on a logarithmic axis at the noise limit."""
    from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

    sizes = np.where(np.isfinite(values), np.abs(values), 0.0)
    top = max(float(sizes.max()), limit or 0.0) or 1.0
    logarithmic = limit is not None and limit > 0 and top > _LOGARITHMIC * limit
    colours = [BEFORE, *[SKY] * (len(values) - 2), AFTER] if len(values) > 1 else [BEFORE]
    if logarithmic and limit is not None:
        ax.set_xscale("log")
        decades = np.log10(top / limit)
        # a value below the limit is drawn as a thin line at the limit
        ends = np.maximum(sizes, limit * 10 ** (0.012 * decades))
        ax.barh(np.arange(len(values)), ends - limit, left=limit, color=colours, height=0.62)
        ax.set_xlim(limit * 10 ** (-0.06 * decades), top * 10 ** (0.6 * decades))
        ax.xaxis.set_major_locator(LogLocator(numticks=4))
        ax.xaxis.set_minor_locator(NullLocator())
    else:
        ends = sizes
        ax.barh(np.arange(len(values)), sizes, color=colours, height=0.62)
        ax.set_xlim(0, 1.5 * top)
        ax.xaxis.set_major_locator(MaxNLocator(4) if sizes.any() else NullLocator())
    if limit is not None:
        ax.axvline(limit, color="#000000", linewidth=1, linestyle=(0, (4, 2)))
    for i, value in enumerate(values):
        beside(ax, texts[i] or short(float(value)), (float(ends[i]), i), fontsize=9.5)
    ax.grid(visible=False, axis="y")
    ax.tick_params(axis="y", length=0)
    ax.spines["left"].set_color(GREY)


def history_finding(view: StudyView) -> str:
    """Return the figures of merit with clear changes, as a sentence."""
    steps = view.steps
    first, last = steps[0], steps[-1]
    if len(steps) == 1:
        return (
            f"One fit: rms error of the {view.body} {short(first.rmse)} rad/s, misfit {short(first.misfit)} and "
            f"cross-validation error {short(first.held_out)} times the noise."
        )
    parts = []
    for name, words, measure in _PHRASES:
        unit = measure.replace("{torque}", view.torque_unit)
        before, after = getattr(first, name), getattr(last, name)
        if abs(before - after) > _CLEAR_CHANGE * abs(before):
            end = "not resolved" if after == 0 else f"{short(after)}{unit}"
            parts.append(f"{words.replace('{body}', view.body)} {short(before)}{unit} → {end}")
    changes = "; ".join(parts) or "no figure of merit changes by more than 5 %"
    return f"With {_change_phrase(view)}: {changes}."


def _change_phrase(view: StudyView) -> str:
    """Return the changes after the first step as a phrase."""
    parts = [step.words.removeprefix("+ ").replace(" − ", " without ") for step in view.steps[1:]]
    return " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)


def story_picture(
    history: Sequence[Step],
    diagnosis: Diagnosis | None,
    path: Path,
    *,
    frame: NDArray[np.uint8] | None = None,
    force: bool = False,
) -> Path:
    """Draw a summary of the first case (.png, .svg): speed and a `frame` (RGB), residuals, figure of merit."""
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
        draw(left, speed_chart(case, case.main))
        left.legend(loc="lower right" if frame is not None else "best")
        left.set_title("1  measured and modelled")
        if frame is not None:
            inset = left.inset_axes((0.19, 0.12, 0.42, 0.48))
            inset.imshow(frame)
            inset.set_xticks([])
            inset.set_yticks([])
            inset.grid(visible=False)
        draw(middle, residual_chart(case, case.main), [i for i in case.intervals if i.body == case.main])
        middle.legend(loc="best")
        middle.set_title("2  residual")
        _merit(right, view)
        content = picture_file(figure, kind)
    with new_file(path, force=force) as out:
        out.write(content)
    return path


def _merit(ax: Any, view: StudyView) -> None:
    """Draw the figure of merit that decreased by the largest factor."""
    steps = view.steps
    kinds = {
        "cross-validation error [noise]": (np.array([s.held_out for s in steps]), 1.0),
        f"rms error of the {view.body} [rad/s]": (np.array([s.rmse for s in steps]), view.rmse_floor),
    }
    title = max(kinds, key=lambda k: kinds[k][0][0] / max(kinds[k][0][-1], 1e-300))
    values, limit = kinds[title]
    figures_of_merit(ax, values, limit, [""] * len(steps))
    ax.invert_yaxis()
    ax.set_yticks(range(len(steps)), [in_lines(s.words) for s in steps])
    ax.set_xlabel(title)
    ax.set_title("3  figure of merit (dashed: noise limit)")


Array = NDArray[np.float64]
_STRONG = 0.95
_MAX_NUMBERED = 14
_FUNCTION = re.compile(r"([\w})|]) ?(\\(?:operatorname|exp|log|sqrt|sin|cos|tan|tanh|arctan|left\())")


def formula(latex: str, name: str, *, size: float = 15.0, colour: str = "black") -> str:
    """Return a formula (LaTeX without $) as ``svg`` with ids that begin with `name`; empty if it cannot be typeset."""
    changes = {"figure.constrained_layout.use": False, "figure.facecolor": "none", "mathtext.fontset": "stix"}
    # mathtext omits the space before functions and draws \left| too small
    text = _FUNCTION.sub(r"\1\\,\2", latex.replace(r"\left|", "|").replace(r"\right|", "|"))
    with style(changes):
        figure = canvas(1, 0.3)
        figure.text(0, 0, f"${text}$", fontsize=size, color=colour)
        try:
            return markup(figure, name, latex, tight=True)
        except ValueError:  # not supported by mathtext
            return ""


def symbol(name: str, labels: Sequence[str]) -> str:
    """Return the symbol of a parameter in mathtext, with (A), (B) ... for its case."""
    key, at, label = name.partition("@")
    text = latex(sym(key.rpartition(".")[2]))
    if key.startswith("initial."):
        text = rf"\omega_{{{key[-1]}0}}"
    case = f" ({chr(ord('A') + labels.index(label))})" if at and len(labels) > 1 and label in labels else ""
    return f"${text}${case}"


def correlations(view: StudyView) -> tuple[list[str], Array]:
    """Return the parameters of the final model that have a finite standard error, and their correlation matrix."""
    fit = view.final
    variance = np.diag(fit.covariance)
    keep = np.flatnonzero(np.isfinite(variance) & (variance > 0))
    root = np.sqrt(variance[keep])
    matrix = fit.covariance[np.ix_(keep, keep)] / np.outer(root, root)
    return [fit.problem.layout.names[i] for i in keep], np.clip(matrix, -1, 1)


def correlation_picture(view: StudyView) -> Picture | None:
    """Draw the correlation matrix of the parameters of the final model; None for fewer than two."""
    from matplotlib.colors import LinearSegmentedColormap

    names, matrix = correlations(view)
    if len(names) < 2:
        return None
    cases = [v.label for v in view.cases]
    symbols = [symbol(n, cases) for n in names]
    keys = [n.partition("@")[0].rpartition(".")[0] for n in names]
    effects = [plain(view.name(k).key.rpartition(".")[2] or k, 12) for k in keys]
    # parameters with the same symbol also show the name of their effect
    labels = [f"{s} {e}" if symbols.count(s) > 1 else s for s, e in zip(symbols, effects, strict=True)]
    with style({"axes.grid": False}):
        size = min(7.5, 1.6 + 0.5 * len(names))
        figure = canvas(size + 0.9, size)
        ax = figure.subplots()
        colours = LinearSegmentedColormap.from_list("blue-white-vermillion", [AFTER, "#fefefe", BEFORE], N=41)
        image = ax.pcolormesh(matrix, cmap=colours, vmin=-1, vmax=1)
        ax.set_aspect("equal")
        ax.invert_yaxis()
        turned = 45 if any(" " in text for text in labels) else 0
        ax.set_xticks(np.arange(len(names)) + 0.5, labels, rotation=turned)
        ax.set_yticks(np.arange(len(names)) + 0.5, labels)
        ax.tick_params(length=0, labelsize=12 if len(names) < _MAX_NUMBERED else 8)
        ax.spines[:].set_visible(False)
        if len(names) <= _MAX_NUMBERED:
            for i, j in np.ndindex(*matrix.shape):
                if i != j:
                    colour = "#fefefe" if abs(matrix[i, j]) > 0.75 else "#010101"
                    text = f"{round(float(matrix[i, j]), 2) + 0.0:.2f}".replace("-", "−")
                    ax.text(j + 0.5, i + 0.5, text, ha="center", va="center", color=colour, fontsize=8.5)
        bar = figure.colorbar(image, ax=ax, shrink=0.8)
        bar.set_label("correlation [1]")
        if bar.solids is not None:
            bar.solids.set_rasterized(False)
        bar.outline.set_visible(False)
        off = np.abs(matrix - np.eye(len(names)))
        i, j = np.unravel_index(int(np.argmax(off)), off.shape)
        strong = int((np.triu(off, 1) > _STRONG).sum())
        finding = (
            f"Strongest correlation {matrix[i, j]:.4f}".replace("-", "−")
            + f", between {view.name(names[i]).words} and {view.name(names[j]).words}; {strong} pairs exceed {_STRONG}."
        )
        letters = ", ".join(f"({chr(ord('A') + i)}) {label}" for i, label in enumerate(cases))
        caption = (
            "Correlation of the parameters of the final model. Pairs near ±1 are degenerate: only a combination of "
            "them is determined. Parameters at a bound are omitted."
            + (f" Cases: {letters}." if len(cases) > 1 else "")
        )
        return Picture("correlation", markup(figure, "correlation", finding), caption, finding)
