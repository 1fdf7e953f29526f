"""Frames as an MP4, by ffmpeg: the system's, or that which comes with `imageio-ffmpeg`."""

import shutil
import subprocess
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryFile

from mdms_sim.plots.canvas import MARK


class EncoderMissingError(RuntimeError):
    """There is no ffmpeg, or it cannot write this; the message says what helps."""


def write_video(
    path: Path, size_px: tuple[int, int], rate_hz: int, frames: Iterable[bytes]
) -> None:
    """Write frames of red, green and blue bytes, `size_px` wide and high, both even.

    H.264 in the colours that all players take. One thread and no dates: the same bytes for the same
    frames. Raises EncoderMissingError and OSError.
    """
    width, height = size_px
    command = [
        *(find_encoder(), "-y", "-loglevel", "error"),
        *("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(rate_hz)),
        *("-i", "-", "-an", "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20"),
        *("-threads", "1", "-fflags", "+bitexact", "-flags:v", "+bitexact"),
        *("-metadata", f"comment={MARK}", "-movflags", "+faststart", "-f", "mp4", str(path)),
    ]
    with TemporaryFile() as told:
        with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=told) as encoder:
            if encoder.stdin is None:
                raise EncoderMissingError("ffmpeg takes no frames")
            try:
                for frame in frames:
                    encoder.stdin.write(frame)
                encoder.stdin.close()
            except BrokenPipeError:
                # It has ended, and has said why.
                pass
        if encoder.returncode:
            told.seek(0)
            lines = told.read().decode(errors="replace").strip().splitlines()
            why = lines[-1] if lines else f"exit code {encoder.returncode}"
            raise EncoderMissingError(
                f"ffmpeg wrote no MP4: {why}; a name that ends in .gif needs none"
            )


def find_encoder() -> str:
    """The ffmpeg to use. Raises EncoderMissingError where there is none."""
    try:
        found: str | None = import_module("imageio_ffmpeg").get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        found = shutil.which("ffmpeg")
    if found is None:
        raise EncoderMissingError(
            "an MP4 needs ffmpeg, which is not installed: install it (apt install ffmpeg), or "
            "pip install imageio-ffmpeg; a name that ends in .gif needs neither"
        )
    return found
