"""Names of the formats of imported files, for the registry of the readers and for the help of the commands."""

HDF5 = "HDF5 and netCDF (SLEAP, DeepLabCut, movement, gyrotrack)"
TRACKER = "Tracker project (.trk)"
ARCHIVE = "zip (Excel, Tracker .trz, tables of text such as those of phyphox)"
EXCEL_97 = "Excel 97"
MATLAB_7_3 = "MATLAB 7.3"
MATLAB = "MATLAB (also captures of dSPACE)"
PARQUET = "Parquet"
WAV = "WAV (signal of a pickup)"
JSON = "JSON (also SysId of WPILib)"
TEXT = "text (CSV, loggers, Tracker, DeepLabCut, SLEAP, trackpy)"

ALL = (TEXT, ARCHIVE, EXCEL_97, MATLAB, MATLAB_7_3, PARQUET, JSON, HDF5, TRACKER, WAV)
