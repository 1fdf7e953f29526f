"""Makes what goes onto a board's flash: the firmware of a cell, compiled for the board."""

from mdms_image.compiler import ImageError
from mdms_image.crash_log import Crash, Decoder, decoder_for, read_log
from mdms_image.image import BOARDS, Image, build_image

__all__ = [
    "BOARDS",
    "Crash",
    "Decoder",
    "Image",
    "ImageError",
    "build_image",
    "decoder_for",
    "read_log",
]
