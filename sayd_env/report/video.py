"""Files of pictures: PNG, GIF and MP4, complete or not at all."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Iterable
from itertools import chain
from pathlib import Path
from types import MappingProxyType

import numpy as np
from PIL import Image  # comes with Matplotlib, which writes its own pictures with it

from sayd_env.config import ConfigError, StudyError
from sayd_env.config.storage import replacing, try_to_write
from sayd_env.envs.canvas import Picture

HUNDREDTHS = 100
"""A GIF counts the time of its pictures in hundredths of a second; below two, browsers slow it down."""
MOST_OF_A_GIF = 1500
"""Pictures in a GIF: all of them are in memory when it is written, a megabyte each."""
COLOURS = 255
"""Of a GIF; one more means that nothing has changed."""


def _write_png(path: Path, pictures: Iterable[Picture], fps: float, colours: Picture) -> None:
    """Write the last picture."""
    del fps, colours
    last = None
    for last in pictures:  # noqa: B007 - all of them are made on the way to the last
        pass
    if last is None:
        raise StudyError("there is no picture to write")
    Image.fromarray(last).save(path, format="PNG", optimize=True)


def _write_gif(path: Path, pictures: Iterable[Picture], fps: float, colours: Picture) -> None:
    """Write pictures that repeat endlessly, with one palette for all, so that no colour flickers."""
    waiting = iter(pictures)
    first = next(waiting)
    rows = np.resize(colours, (8, first.shape[1], 3))
    palette = Image.fromarray(np.vstack([first, rows])).quantize(COLOURS, Image.Quantize.MEDIANCUT, kmeans=1)
    frames = (
        Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE)
        for picture in chain([first], waiting)
    )
    start = next(frames)
    duration = round(1000.0 / fps)
    with path.open("wb") as stream:  # ours to close where a picture fails
        start.save(stream, "GIF", save_all=True, append_images=frames, duration=duration, loop=0)


def _write_mp4(path: Path, pictures: Iterable[Picture], fps: float, colours: Picture) -> None:
    """Write a video (H.264) that browsers and slides play."""
    del colours
    waiting = iter(pictures)
    first = next(waiting)
    height, width, _ = first.shape
    ffmpeg = importlib.import_module("imageio_ffmpeg")
    video = ffmpeg.write_frames(
        str(path), (width, height), fps=fps, quality=8, output_params=["-movflags", "+faststart", "-f", "mp4"]
    )
    video.send(None)
    count = 0
    try:
        for picture in chain([first], waiting):
            video.send(np.ascontiguousarray(picture))
            count += 1
    except OSError as error:
        raise StudyError(f"the video could not be written ({' '.join(str(error).split())[:200]})") from None
    finally:
        video.close()
    # The encoder does not tell how it ended.
    written, _ = ffmpeg.count_frames_and_secs(str(path))
    if written != count:
        raise StudyError(f"the video broke off: it holds {written} of {count} pictures")


Writer = Callable[[Path, Iterable[Picture], float, Picture], None]
WRITERS: MappingProxyType[str, Writer] = MappingProxyType(
    {".gif": _write_gif, ".mp4": _write_mp4, ".png": _write_png}
)
"""Writers of pictures by the suffix of the file's name."""


def checked_video(path: Path, fps: float, count: int) -> None:
    """Refuse a file that could not be written, before any picture has been made.

    Parameters
    ----------
    path : Path
        The file to be; its folder is made.
    fps : float
        Pictures per second.
    count : int
        Number of pictures.

    Raises
    ------
    ConfigError
        An unknown kind of file, a folder that cannot be written to, a video without what makes videos, a rate
        or a length that a GIF cannot have.
    """
    suffix = path.suffix.lower()
    if suffix not in WRITERS:
        raise ConfigError(f"-o {path}: expected a file name that ends in {', '.join(WRITERS)}")
    if path.is_dir():
        raise ConfigError(f"-o {path}: a folder is in the way, expected a file")
    try:
        try_to_write(path.parent)
    except OSError as error:
        raise ConfigError(f"-o {path}: cannot be written ({error.strerror or error})") from None
    if suffix == ".gif":
        hundredths = HUNDREDTHS / fps
        if hundredths < 2 or not math.isclose(hundredths, round(hundredths), rel_tol=1e-6):
            raise ConfigError(
                f"--fps {fps:g}: a GIF shows a picture for two or more whole hundredths of a second: 50, 25, "
                "20, 12.5, 10 or 5; an .mp4 can have any rate"
            )
        if count > MOST_OF_A_GIF:
            raise ConfigError(
                f"-o {path}: {count} pictures are too many for a GIF, at most {MOST_OF_A_GIF}; "
                "lower --fps or --seconds, or write an .mp4"
            )
    if suffix == ".mp4":
        try:
            importlib.import_module("imageio_ffmpeg")
        except ImportError:
            raise ConfigError(
                f"-o {path}: videos need imageio-ffmpeg: pip install 'sayd-env[video]'; "
                "a .gif or .png does without"
            ) from None


def write_video(path: Path, pictures: Iterable[Picture], fps: float, colours: Picture) -> None:
    """Write pictures into a file that appears when it is complete.

    Parameters
    ----------
    path : Path
        A name that `checked_video` has passed.
    pictures : iterable of ndarray, each of shape (height, width, 3)
    fps : float
        Pictures per second.
    colours : ndarray, shape (..., 3)
        Colours that a palette must have room for beside those of the first picture.

    Raises
    ------
    StudyError
        The file cannot be written.
    """
    with replacing(path) as temporary:
        WRITERS[path.suffix.lower()](temporary, pictures, fps, colours)
