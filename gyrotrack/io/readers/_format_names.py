"""Names and suffixes of the formats of imported files: for the readers, the help of the commands and the workbench."""

HDF5 = "HDF5 and netCDF (SLEAP, DeepLabCut, movement, gyrotrack)"
TRACKER = "Tracker project"
ARCHIVE = "zip (Excel, Tracker .trz, tables of text such as those of phyphox)"
EXCEL_97 = "Excel 97"
MATLAB_7_3 = "MATLAB 7.3"
MATLAB = "MATLAB (also captures of dSPACE)"
PARQUET = "Parquet"
WAV = "WAV (signal of a pickup)"
JSON = "JSON (also SysId of WPILib)"
TEXT = "text (CSV, loggers, Tracker, DeepLabCut, SLEAP, trackpy)"

# the usual suffixes of each; a format is recognised by content
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
