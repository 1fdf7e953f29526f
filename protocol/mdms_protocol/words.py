"""How viper code reads a signed number from a buffer of 32-bit integers.

On a 64-bit machine viper loads a negative one as a large positive number; shifting it up and down
again by `WIDEN` bits repairs that, and by 0 bits does nothing where it is not needed.
"""

import sys

WIDEN = 32 if sys.maxsize >> 32 and sys.implementation.name == "micropython" else 0
