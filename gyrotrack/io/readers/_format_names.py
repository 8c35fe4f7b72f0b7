"""Names and suffixes of the formats of films and imported files, for readers, help, manual, workbench and messages."""

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

# suffixes of films; the decoder recognises films by content, except for the header file of a Photron camera
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
