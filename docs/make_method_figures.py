"""Draw the figures of docs/explanation/method.md from the sample films: `python docs/make_method_figures.py`.

It also prints the numbers of the worked examples on that page.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

import gyrotrack
from fitting import Case, Diagnosis, Fit, diagnose, fit, improve

ROOT = Path(__file__).resolve().parents[1]
FILMS = ROOT / "sample_clips"
TARGET = ROOT / "docs" / "explanation"


def case_of_films(file: Path) -> Case:
    """Track the sample films, synchronise them into a file, and load it."""
    casing = gyrotrack.extract(FILMS / "casing.mp4", capture_fps=260)
    rotors = [gyrotrack.extract(film, capture_fps=1000) for film in sorted(FILMS.glob("rotor_*.mp4"))]
    gyrotrack.sync(casing, rotors, file, inertia_rotor=4.2e-6, inertia_casing=1.6e-6, label="sample films")
    return Case.load(file)


def draw_residuals(base: Fit, final: Fit, diagnosis: Diagnosis) -> Figure:
    """Draw the residual of the casing's speed with the intervals of significant lack of fit, before and after."""
    drawn = Figure(figsize=(9.0, 3.0), layout="constrained")
    for ax, shown, title in zip(
        drawn.subplots(1, 2), (base, final), ("reduced model", "with quadratic air drag"), strict=True
    ):
        shown.plot(ax, residual=True)
        ax.set_title(title, loc="left")
    for failure in diagnosis.failures:
        if failure.body == "casing":
            drawn.axes[0].axvspan(failure.t_start, failure.t_stop, color="#F0E442", alpha=0.25, linewidth=0)
    return drawn


def main() -> None:
    """Analyse the films, draw both figures, and print the numbers of the page."""
    mpl.use("agg")
    with tempfile.TemporaryDirectory() as place:
        file = Path(place) / "sample.h5"
        case = case_of_films(file)
        synchronised = gyrotrack.read_case(file)
        for name, recording in synchronised.recordings.items():
            sigma = {b: f"{1e3 * np.median(track.sigma):.2f} mrad" for b, track in recording.bodies.items()}
            print(synchronised.placements[name], sigma)
    base = fit("reduced", case)
    diagnosis = diagnose(base)
    final = improve(base, first=diagnosis.candidates)[-1].fit
    draw_residuals(base, final, diagnosis).savefig(TARGET / "residual.png", dpi=100)
    diagnosis.plot().savefig(TARGET / "candidates.png", dpi=100)
    for name, shown in (("base", base), ("final", final)):
        print(f"{name}: {shown.cases[0]}")
    print(final.fit_report(), final.noise, diagnose(final).sentence, sep="\n")
    print(diagnosis.sentence)
    for candidate in diagnosis.candidates[:6]:
        words = base.name(candidate.effect).words
        print(f"{words}: score {candidate.score:.4g}, dBIC {candidate.delta_bic}, p {candidate.p_value:.2g}")


if __name__ == "__main__":
    main()
