"""Score the tracker on films whose true angles are known: path-traced films, or any film beside a truth table.

    python -m benchmarks.tracking.pathtraced FILM.mp4 ... [--fps 260]

Each film FILM.mp4 needs FILM.csv beside it with the columns frame, time_s, psi_casing_rad, psi_rotor_rad (truth at
mid-exposure). For each body the table gives: the root mean square of the error less its mean; the same after the
harmonics that a fit takes as nuisance parameters (first = camera centre, second = tilt, of the body's own angle); the
median uncertainty; the share of frames that have an angle; the frames wrong by more than 0.2 rad (slips);
z = rms(error / sigma) of both errors; and the frames that were taken for repeated ones.
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gyrotrack._errors import GyrotrackError
from gyrotrack.io._records import Recording
from gyrotrack.tracking._extract import extract

Floats = npt.NDArray[np.float64]

SLIP = 0.2
"""Error in rad from which a frame counts as slipped."""
HEADER = f"{'film':24s} {'body':7s}  rms/mrad  harm.  sigma   kept slips      z z har. rep."


@dataclass(frozen=True)
class Score:
    """The tracker's errors on one body of one film; see the module docstring."""

    body: str
    rms: float
    rms_less_harmonics: float
    sigma: float
    kept: float
    slips: int
    z: float
    z_less_harmonics: float
    repeated: int

    def row(self, film: str) -> str:
        """Return a row of the table."""
        return (
            f"{film:24s} {self.body:7s} {1e3 * self.rms:9.2f} {1e3 * self.rms_less_harmonics:6.2f} "
            f"{1e3 * self.sigma:6.2f} {self.kept:6.1%} {self.slips:5d} {self.z:6.2f} {self.z_less_harmonics:6.2f} "
            f"{self.repeated:4d}"
        )


def score(recording: Recording, truth: dict[str, Floats]) -> list[Score]:
    """Compare a recording with the true angles `psi_<body>_rad` of its frames."""
    repeated = int(recording.extra.get("repeated_frames", 0))
    found = []
    for body in ("casing", "rotor"):
        if body not in recording.bodies:
            found.append(Score(body, np.nan, np.nan, np.nan, 0.0, 0, np.nan, np.nan, repeated))
            continue
        track, psi = recording.bodies[body], truth[f"psi_{body}_rad"]
        frame = np.rint(track.time * recording.capture_fps).astype(int)
        own = psi[frame]
        # The zero of the angle is free; a sense that is wrong shows as slips.
        error = track.angle - own
        error -= 2.0 * np.pi * np.round(np.median(error) / (2.0 * np.pi))
        error -= np.median(error)
        good = np.abs(error) < SLIP
        error -= np.mean(error[good])
        rest = error
        design = np.stack(
            [np.ones_like(own), *(f(k * own) for k in (1, 2) for f in (np.cos, np.sin))], axis=1
        )
        if good.sum() > 12:
            rest = error - design @ np.linalg.lstsq(design[good], error[good], rcond=None)[0]
        found.append(
            Score(
                body,
                _rms(error[good]),
                _rms(rest[good]),
                float(np.median(track.sigma)),
                len(frame) / len(psi),
                int((~good).sum()),
                _rms(error[good] / track.sigma[good]),
                _rms(rest[good] / track.sigma[good]),
                repeated,
            )
        )
    return found


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def read_truth(path: Path) -> dict[str, Floats]:
    """Read a truth table by columns."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def main() -> None:
    """Score films and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("films", nargs="*", type=Path)
    parser.add_argument("--fps", type=float, help="capture rate; from the truth's times, if not given")
    chosen = parser.parse_args()
    films = chosen.films or sorted((Path(__file__).parents[2] / "../shared/real/pathtraced").glob("*.mp4"))
    print(HEADER)
    for film in films:
        truth = read_truth(film.with_suffix(".csv"))
        fps = chosen.fps or 1.0 / float(np.median(np.diff(truth["time_s"])))
        try:
            recording = extract(film, capture_fps=fps)
        except GyrotrackError as error:
            print(f"{film.stem:24s} {error}")
            continue
        for one in score(recording, truth):
            print(one.row(film.stem))
        for warning in recording.warnings:
            print(f"    {warning}")


if __name__ == "__main__":
    main()
