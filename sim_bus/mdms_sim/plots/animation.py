"""A run as an animation: a GIF, or an MP4 by ffmpeg.

ffmpeg is the system's, or that of `imageio-ffmpeg`.
"""

import shutil
import subprocess
from collections.abc import Iterable, Iterator
from importlib import import_module
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np
from PIL import Image

from mdms_model.arrays import Ints
from mdms_model.run.record import Record
from mdms_model.scenario.scenario import Scenario
from mdms_sim.plots.canvas import MARK, shown_until_s
from mdms_sim.plots.moving_view import MovingView


class EncoderMissingError(RuntimeError):
    """There is no ffmpeg, or it cannot write this; the message says what helps."""


def _encode(path: Path, size_px: tuple[int, int], frames: Iterable[bytes]) -> None:
    """Write frames of red, green and blue bytes, `size_px` wide and high, both even.

    H.264 in the colours that all players take. One thread and no dates: the same bytes for the same
    frames. Raises EncoderMissingError and OSError.
    """
    width, height = size_px
    command = [
        *(find_encoder(), "-y", "-loglevel", "error"),
        *("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"),
        *("-r", str(VIDEO_RATE_HZ)),
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


GIF, MP4 = "gif", "mp4"
FORMS = (GIF, MP4)
#: Frames in a second of the run. So many are drawn at most, and at least: a longer run is shown
#: faster, a shorter one slower.
RATE_HZ = 10
MOST_FRAMES, LEAST_FRAMES = 200, 60
FRAME_MS = 1000 // RATE_HZ
#: A video is smooth, and may last longer.
VIDEO_RATE_HZ, MOST_VIDEO_FRAMES, LEAST_VIDEO_FRAMES = 25, 1500, 150
#: The end stays for so long.
LAST_MS = 2000
COLOURS = 64
MOST_BYTES = 2_000_000


def write_gif(path: Path, scenario: Scenario, record: Record) -> None:
    """Write a GIF of at most `MOST_BYTES`: the same bytes for the same run. Raises OSError."""
    instants, times = _instants(record, RATE_HZ, LEAST_FRAMES, MOST_FRAMES)
    view = MovingView(scenario, record, times)
    frames = _in_palette([Image.fromarray(view.pixels(instant)) for instant in instants])
    frame_ms = FRAME_MS
    while len(data := _encoded(frames, frame_ms)) > MOST_BYTES and len(frames) > 1:
        # Coarser in time, never in the content of a frame; the end stays.
        frames, frame_ms = frames[::-2][::-1], 2 * frame_ms
    path.write_bytes(data)


def write_mp4(path: Path, scenario: Scenario, record: Record) -> None:
    """Write an MP4. Raises OSError and `EncoderMissingError`."""
    instants, times = _instants(record, VIDEO_RATE_HZ, LEAST_VIDEO_FRAMES, MOST_VIDEO_FRAMES)
    view = MovingView(scenario, record, times)
    still = LAST_MS * VIDEO_RATE_HZ // 1000

    def frames() -> Iterator[bytes]:
        for instant in instants:
            data = view.pixels(instant).tobytes()
            yield data
        for _ in range(still):
            yield data

    _encode(path, view.size_px, frames())


def _instants(record: Record, rate_hz: float, least: int, most: int) -> tuple[list[int], float]:
    """The samples that are shown, and how many times as fast as they were.

    They end when all parcels have come to rest.
    """
    start_s, end_s = float(record.time_s[0]), shown_until_s(record)
    duration_s = end_s - start_s
    samples = int(np.searchsorted(record.time_s, end_s, side="right"))
    count = min(max(round(duration_s * rate_hz) + 1, min(least, samples), 2), most)
    instants_s = np.linspace(start_s, end_s, count)
    instants: Ints = np.searchsorted(record.time_s, instants_s - 1e-9)
    shown: list[int] = instants.clip(0, len(record.time_s) - 1).tolist()
    return shown, duration_s * rate_hz / (count - 1)


def _in_palette(pictures: list[Image.Image]) -> list[Image.Image]:
    """The pictures in one palette, so that standing parts are the same in each."""
    width, height = pictures[0].size
    chosen = [pictures[0], pictures[len(pictures) // 2], pictures[-1]]
    together = Image.new("RGB", (width, height * len(chosen)))
    for place, picture in enumerate(chosen):
        together.paste(picture, (0, place * height))
    palette = together.quantize(COLOURS, dither=Image.Dither.NONE)
    return [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]


def _encoded(frames: list[Image.Image], frame_ms: int) -> bytes:
    file = BytesIO()
    frames[0].save(
        file,
        format="GIF",
        save_all=True,
        append_images=frames[1:],
        duration=[*[frame_ms] * (len(frames) - 1), LAST_MS],
        loop=0,
        comment=MARK.encode(),
    )
    return file.getvalue()
