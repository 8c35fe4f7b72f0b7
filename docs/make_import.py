"""Write the tables of docs/how-to/import-data.md from the registry of formats: `python docs/make_import.py`."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from gyrotrack.io.readers import _format_names as names

TARGET = Path(__file__).parent / "how-to" / "import-data.md"
BEGIN, END = "<!-- made by docs/make_import.py: begin -->\n", "<!-- made by docs/make_import.py: end -->\n"


class Use(NamedTuple):
    """A kind of data, and the options that `gyrotrack import` needs for it; one row of the table in the manual."""

    what: str
    how: str
    formats: tuple[str, ...]  # formats of such data


USES = (
    Use(
        "a table with a header, any units",
        '`gyrotrack import --body run.csv --inertia "3.1e-3 +- 0.1e-3" -o run.h5`',
        (names.TEXT,),
    ),
    Use(
        "a table with columns like `rpm`, `turns` or `dps`",
        "no option: a column named by its unit has this unit",
        (names.TEXT,),
    ),
    Use(
        "a table with dates, or seconds to nanoseconds since 1970",
        "no option: times are counted from the first second of the record",
        (names.TEXT,),
    ),
    Use(
        "counts of an encoder, also of a counter of 8 to 32 bits that overflows",
        "add `--pulses-per-turn 360`",
        (names.TEXT,),
    ),
    Use(
        "an inertial unit: rates and accelerations about x, y, z",
        "no option if the rates are named `gyro`; columns named only `x`, `y`, `z` need `--column omega=z`",
        (names.TEXT,),
    ),
    Use(
        "a table without a header",
        "add `--column 't=1 [us]' --column 'angle=2 [deg]'`",
        (names.TEXT,),
    ),
    Use(
        "an encoder, wrapped, in degrees",
        "no option: angles that wrap at 360 are degrees; sigma includes the quantisation step / sqrt(12)",
        (names.TEXT,),
    ),
    Use(
        "times of pulses, one per line, or the intervals between them",
        "add `--pulses-per-turn 1`; intervals are recognised if they do not always increase, otherwise add "
        "`--column interval=1`",
        (names.TEXT,),
    ),
    Use(
        "a counter of turns of one or several sensors",
        "add `--column revolutions=3`",
        (names.TEXT,),
    ),
    Use(
        "a photodiode, Hall sensor or oscilloscope (sampled voltage), or the brightness of a window of a film",
        "add `--pulses-per-turn N`: pulses are the rising edges; `--marker NAME` selects one of several "
        "columns",
        (names.TEXT,),
    ),
    Use(
        "a light gate with states 0 and 1",
        "rotation: add `--pulses-per-turn N`; pendulum: a light gate gives no angles to import, but "
        "`gyrotrack spindown FILE` measures period and decay",
        (names.TEXT,),
    ),
    Use(
        "phyphox (CSV, `.xls` or zipped)",
        "no option: the axis of the gyroscope with the largest signal is used; `--column 'omega=Gyroscope z "
        "(rad/s)'` selects another axis; `gyrotrack budget --speed-scale 0.02` includes the error of the "
        "scale of the gyroscope (1 to 3 % in phones, see the data sheet)",
        (names.TEXT, names.ARCHIVE, names.EXCEL_97),
    ),
    Use(
        "a signal in V that is proportional to the deflection",
        "add `--column 'angle=Voltage ( V )'`; only times and ratios are meaningful",
        (names.TEXT,),
    ),
    Use(
        "a sound file of a pickup (`.wav`)",
        "add `--pulses-per-turn N`",
        (names.WAV,),
    ),
    Use(
        "a motor with its voltage, current or PWM",
        "add `--input 'voltage=3 [V]'`, so that laws may depend on this input; with the same option, "
        "`gyrotrack spindown` fits the first-order response",
        (names.TEXT,),
    ),
    Use(
        "tests of SysId (WPILib)",
        'add `--marker "fast-forward left"`',
        (names.JSON,),
    ),
    Use(
        "particles of trackpy or TrackMate",
        "add `--marker 3 --casing-fps 120`; the column `ep` is the uncertainty of x and y",
        (names.TEXT,),
    ),
    Use(
        "a project (`.trk`, `.trz`) or a table of OSP Tracker",
        'add `--marker "mass A"`; the centre is the origin of the axes, or `--centre orbit`',
        (names.TRACKER, names.ARCHIVE, names.TEXT),
    ),
    Use(
        "points of DeepLabCut, SLEAP, movement",
        "add `--casing-fps 240` if the file contains frame numbers",
        (names.TEXT, names.HDF5),
    ),
    Use(
        "a capture of dSPACE (struct with `X` and `Y`)",
        "add `--column 'omega=Sum3 [rpm]'`; without this option the signals are listed",
        (names.MATLAB, names.MATLAB_7_3),
    ),
    Use(
        'MATLAB (7.3 too), Excel (`.xls` needs `pip install "gyrotrack[tables]"`), Parquet, JSON',
        "no option if the variables are named `t` and `angle` or `omega`",
        (names.MATLAB, names.MATLAB_7_3, names.ARCHIVE, names.EXCEL_97, names.PARQUET, names.JSON),
    ),
)


def tables() -> str:
    """Return the tables of the page: the command for each kind of data, and the formats with their usual suffixes."""
    parts = ["| you have | command |", "|---|---|", *(f"| {u.what} | {u.how} |" for u in USES)]
    parts += ["", "| format | usual suffixes |", "|---|---|", *_suffixes(names.SUFFIXES)]
    parts += [
        "",
        "`profile`, `extract` and `spindown` read films. The header of a Photron camera states the capture rate; the",
        "frames of this camera are shown in grey, even if its sensor is a Bayer sensor. A TIFF stack states its rate",
        "if ImageJ or an OME program wrote it; its grey values are scaled by the darkest and the brightest value.",
        "`spindown` reads interlaced film as two fields.",
        "",
        *("| film | usual suffixes |", "|---|---|", *_suffixes(names.FILMS)),
    ]
    return "\n".join([*parts, ""])


def _suffixes(formats: dict[str, tuple[str, ...]]) -> list[str]:
    return [
        f"| {name} | {', '.join(f'`{s}`' for s in suffixes) or '-'} |" for name, suffixes in formats.items()
    ]


def page() -> str:
    """Return the page: its text, and the tables between the two marks."""
    head, rest = TARGET.read_text(encoding="utf-8").split(BEGIN)
    return head + BEGIN + tables() + END + rest.split(END)[1]


if __name__ == "__main__":
    TARGET.write_text(page(), encoding="utf-8")
