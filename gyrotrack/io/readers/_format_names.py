"""Names and suffixes of the formats of films and imported files, for readers, help, manual, workbench and messages."""

from typing import NamedTuple

HDF5 = "HDF5 and netCDF (SLEAP, DeepLabCut, movement, gyrotrack)"
TRACKER = "Tracker project"
ARCHIVE = "zip (Excel, Tracker .trz, tables of text like those of phyphox)"
EXCEL_97 = "Excel 97"
MATLAB_7_3 = "MATLAB 7.3"
MATLAB = "MATLAB (also captures of dSPACE)"
PARQUET = "Parquet"
WAV = "WAV (signal of a pickup)"
JSON = "JSON (also SysId of WPILib)"
TEXT = "text (CSV, loggers, Tracker, DeepLabCut, SLEAP, trackpy)"

# usual suffixes of each format; formats are recognised by content
SUFFIXES = {
    TEXT: (".csv", ".tsv", ".txt", ".dat"),
    ARCHIVE: (".zip", ".xlsx", ".trz"),
    EXCEL_97: (".xls",),
    MATLAB: (".mat",),
    MATLAB_7_3: (".mat",),
    PARQUET: (".parquet",),
    JSON: (".json",),
    HDF5: (".h5", ".nc"),
    TRACKER: (".trk",),
    WAV: (".wav",),
}
ALL = tuple(SUFFIXES)

# suffixes of films; the decoder recognises films by content, except for a header of a Photron camera
FILMS = {
    "MP4": (".mp4", ".m4v", ".3gp"),
    "MOV": (".mov",),
    "MKV": (".mkv",),
    "WebM": (".webm",),
    "AVI": (".avi",),
    "MPEG": (".mpg", ".mpeg", ".m2v", ".vob", ".ts", ".mts", ".m2ts"),
    "WMV": (".wmv", ".asf"),
    "Ogg": (".ogv",),
    "FLV": (".flv",),
    "GIF": (".gif",),
    "H.264 and H.265": (".h264", ".264", ".h265", ".265", ".hevc"),
    "MJPEG": (".mjpeg", ".mjpg"),
    "Photron (.cih beside .mraw)": (".cih",),
    "TIFF (a stack of pictures)": (".tif", ".tiff"),
    "a folder of numbered pictures": (),
}


class Use(NamedTuple):
    """A kind of data, and the options that `gyrotrack import` needs for it; one row of the table in the manual."""

    what: str
    how: str
    formats: tuple[str, ...]  # formats of such data


USES = (
    Use(
        "a table with a header, any units",
        '`gyrotrack import --body run.csv --inertia "3.1e-3 +- 0.1e-3" -o run.h5`',
        (TEXT,),
    ),
    Use(
        "a table with columns like `rpm`, `turns` or `dps`",
        "no option: a column named by its unit has this unit",
        (TEXT,),
    ),
    Use(
        "a table with dates, or seconds to nanoseconds since 1970",
        "no option: times are counted from the first second of the record",
        (TEXT,),
    ),
    Use(
        "counts of an encoder, also of a counter of 8 to 32 bits that overflows",
        "add `--pulses-per-turn 360`",
        (TEXT,),
    ),
    Use(
        "an inertial unit: rates and accelerations about x, y, z",
        "no option if the rates are named `gyro`; columns named only `x`, `y`, `z` need `--column omega=z`",
        (TEXT,),
    ),
    Use(
        "a table without a header",
        "add `--column 't=1 [us]' --column 'angle=2 [deg]'`",
        (TEXT,),
    ),
    Use(
        "an encoder, wrapped, in degrees",
        "no option: angles that wrap at 360 are degrees; the quantisation step / sqrt(12) is in sigma",
        (TEXT,),
    ),
    Use(
        "times of pulses, one per line, or the intervals between them",
        "add `--pulses-per-turn 1`; intervals are recognised where they do not increase, else `--column interval=1`",
        (TEXT,),
    ),
    Use(
        "a counter of turns of one or several sensors",
        "add `--column revolutions=3`",
        (TEXT,),
    ),
    Use(
        "a photodiode, Hall sensor or oscilloscope (sampled voltage), or the brightness of a window of a film",
        "add `--pulses-per-turn N`: pulses are the rising edges; of several columns `--marker NAME` selects one",
        (TEXT,),
    ),
    Use(
        "a light gate with states 0 and 1",
        "of a rotation: add `--pulses-per-turn N`; of a pendulum: `gyrotrack spindown "
        "FILE` measures period and decay, there are no angles to import",
        (TEXT,),
    ),
    Use(
        "phyphox (CSV, `.xls` or zipped)",
        "no option: the axis of the gyroscope with the largest signal; another with `--column "
        "'omega=Gyroscope z (rad/s)'`; the error of its scale (1 to 3 % in phones, see the data sheet) "
        "enters by `gyrotrack budget --speed-scale 0.02`",
        (TEXT, ARCHIVE, EXCEL_97),
    ),
    Use(
        "a signal in V that is proportional to the deflection",
        "add `--column 'angle=Voltage ( V )'`; only times and ratios are meaningful",
        (TEXT,),
    ),
    Use(
        "a sound file of a pickup (`.wav`)",
        "add `--pulses-per-turn N`",
        (WAV,),
    ),
    Use(
        "a motor with its voltage, current or PWM",
        "add `--input 'voltage=3 [V]'`, so that laws may depend on it; `gyrotrack spindown` takes the same option and "
        "fits the first-order response",
        (TEXT,),
    ),
    Use(
        "tests of SysId (WPILib)",
        'add `--marker "fast-forward left"`',
        (JSON,),
    ),
    Use(
        "particles of trackpy or TrackMate",
        "add `--marker 3 --casing-fps 120`; the column `ep` is the uncertainty of x and y",
        (TEXT,),
    ),
    Use(
        "a project (`.trk`, `.trz`) or a table of OSP Tracker",
        'add `--marker "mass A"`; the centre is the origin of the axes, or `--centre orbit`',
        (TRACKER, ARCHIVE, TEXT),
    ),
    Use(
        "points of DeepLabCut, SLEAP, movement",
        "add `--casing-fps 240` if the file contains frame numbers",
        (TEXT, HDF5),
    ),
    Use(
        "a capture of dSPACE (struct with `X` and `Y`)",
        "add `--column 'omega=Sum3 [rpm]'`; without it the signals are listed",
        (MATLAB, MATLAB_7_3),
    ),
    Use(
        'MATLAB (7.3 too), Excel (`.xls` needs `pip install "gyrotrack[tables]"`), Parquet, JSON',
        "no option if the variables are named `t` and `angle` or `omega`",
        (MATLAB, MATLAB_7_3, ARCHIVE, EXCEL_97, PARQUET, JSON),
    ),
)
