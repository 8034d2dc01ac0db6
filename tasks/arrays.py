"""Type aliases of NumPy arrays, and how dataclasses of arrays are shown."""

from dataclasses import fields
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


class ArrayData:
    """Base of dataclasses of arrays, which are shown by name and shape: their numbers would fill the screen."""

    def __repr__(self) -> str:
        names: dict[tuple[int, ...], list[str]] = {}
        for field in fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            if value is not None and not isinstance(value, str) and 0 not in np.shape(value)[1:]:
                names.setdefault(np.shape(value), []).append(field.name)
        shown = "; ".join(f"{', '.join(of_shape)} {shape}" for shape, of_shape in names.items())
        return f"{type(self).__name__}({shown})"
