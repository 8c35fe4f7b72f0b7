"""Sound files: the signal of a pickup, a microphone or a photodiode at the line input of a computer."""

from __future__ import annotations

import io
import warnings
from pathlib import Path

import numpy as np
from scipy.io import wavfile

from gyrotrack._errors import DatasetError
from gyrotrack.io.readers._raw_table import RawTable, refuse_size, table_of


def read_wav(path: Path, content: bytes, _options: object) -> RawTable:
    """Return the times and the channels of a WAV file."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", wavfile.WavFileWarning)  # SciPy warns about unknown chunks
            rate, signal = wavfile.read(io.BytesIO(content))
    except Exception as error:
        what = f"{path} is not a readable WAV file: {str(error)[:100]}."
        raise DatasetError(what, "Save it as PCM.") from error
    channels = np.atleast_2d(signal.T)
    refuse_size(path, channels.shape[1], len(channels))
    names = [f"channel {k + 1}" for k in range(len(channels))]
    return table_of(path, ["t", *names], [np.arange(channels.shape[1]) / rate, *channels])
