"""Names and suffixes of the formats of films: for the decoder, its messages and the manual."""

# the usual suffixes of each; a format is recognised by content, except for a Photron header
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
    "a folder of numbered pictures": (),
}
ALL = tuple(FILMS)
SUFFIXES = tuple(suffix for suffixes in FILMS.values() for suffix in suffixes)
