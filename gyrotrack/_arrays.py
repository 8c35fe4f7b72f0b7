"""Types of arrays."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Bools = npt.NDArray[np.bool_]
Complexes = npt.NDArray[np.complex128]
Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Singles = npt.NDArray[np.float32]
Plane = npt.NDArray[np.uint8]
"""A picture, (height, width) [grey levels]."""
Picture = Singles
"""A picture with fractions of grey levels, (height, width)."""
