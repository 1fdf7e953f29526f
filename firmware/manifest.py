"""Freezes a cell's firmware into MicroPython; see FREEZING.md.

`main.py` stays a file of the board, so that whether the firmware starts is decided there.
"""

# ruff: noqa: F821 - the build defines these names

include("$(PORT_DIR)/boards/manifest.py")
package("boards")
package("mdms_boot")
package("mdms_cell")
package(
    "mdms_protocol",
    base_path="../protocol",
    files=(
        "__init__.py",
        "codecs/__init__.py",
        "codecs/bundle.py",
        "codecs/cia402.py",
        "codecs/cob.py",
        "codecs/frame.py",
        "codecs/lss.py",
        "codecs/nmt.py",
        "codecs/sdo.py",
        "codecs/update.py",
        "compat.py",
        "indices.py",
        "neighbours/__init__.py",
        "neighbours/frames.py",
        "neighbours/lost.py",
        "neighbours/precedence.py",
        "packed.py",
        "record.py",
        "signature.py",
        "version.py",
    ),
)
