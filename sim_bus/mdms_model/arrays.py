"""Arrays by the type of their numbers."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]
Bools: TypeAlias = NDArray[np.bool_]
Bits: TypeAlias = NDArray[np.uint8]
#: Arrays of a record type; compiled functions read the fields by name.
Records: TypeAlias = Any
