"""Type aliases of NumPy arrays."""

from typing import Any

import numpy as np
import numpy.typing as npt

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Floats = npt.NDArray[np.floating]
Int64 = npt.NDArray[np.int64]
Ints = npt.NDArray[np.integer]
Labels = npt.NDArray[Any]  # whole numbers or text
Bools = npt.NDArray[np.bool_]
