"""Exceptions of the package `gyrotrack`, all derived from `GyrotrackError`.

::

    GyrotrackError                 code, message, hint; exit code 1
    ├── VideoError                 "video":   a film that cannot be read as requested
    ├── ProfileError               "profile": a profile that is not valid
    ├── ConfigurationError         "configuration": a manifest, study or settings file that is not valid
    ├── TrackingError              "tracking": no markers, no centre, no angle
    ├── DatasetError               "dataset": a data file of another program, damaged or incomplete
    ├── SyncError                  "sync":    clips that do not belong to one run
    ├── OutputError                "output":  a result that cannot be written
    └── UsageError                 "usage":   options that contradict each other; exit code 2

A poor result raises no exception; its verdict states that it is poor.
"""

from __future__ import annotations


class GyrotrackError(Exception):
    """An error of the input or of the environment; ``str(error)`` is the message and the hint.

    Parameters
    ----------
    message : str
        Description of the error, with the name of the file and the location in the file.
    hint : str
        Recommended action; may be empty.
    """

    code = "error"
    exit_code = 1

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(f"{message} {hint}".rstrip())
        self.message = message
        self.hint = hint


class VideoError(GyrotrackError):
    """A film that cannot be read as requested."""

    code = "video"


class ProfileError(GyrotrackError):
    """A marker profile that is not valid."""

    code = "profile"


class ConfigurationError(GyrotrackError):
    """A manifest, a study or a file of settings that is not valid."""

    code = "configuration"


class TrackingError(GyrotrackError):
    """A readable film in which no marker, centre or angle is found."""

    code = "tracking"


class DatasetError(GyrotrackError):
    """A data file that belongs to another program, is damaged, or is incomplete."""

    code = "dataset"


class SyncError(GyrotrackError):
    """Clips that do not belong to one run, or cannot be synchronised."""

    code = "sync"


class OutputError(GyrotrackError):
    """A result that cannot be written."""

    code = "output"


class UsageError(GyrotrackError):
    """Options that contradict each other or are not understood."""

    code = "usage"
    exit_code = 2
