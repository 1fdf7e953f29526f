"""The version of everything here: package, firmware, object 0x100A."""

VERSION = "0.1.0"
