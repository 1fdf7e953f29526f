"""Freezes the cell into MicroPython: `make BOARD=PYBV11 FROZEN_MANIFEST=.../manifest.py`.

The modules then run from flash and leave the heap to their data.
"""

# ruff: noqa: F821 - the build defines these names

include("$(PORT_DIR)/boards/manifest.py")
package("mdms_cell", base_path="$(MANIFEST_DIR)", opt=0)
package("boards", base_path="$(MANIFEST_DIR)", opt=0)
package("mdms_protocol", base_path="$(MANIFEST_DIR)/../protocol", opt=0)
module("main.py", base_path="$(MANIFEST_DIR)", opt=0)
