"""A drawing surface on pygame: smooth shapes, clear text, pixels as an array, a window.

Shapes are drawn twice as large and scaled down, text is set at its own size on top of them. Pictures need no
video device; a window does (or SDL's dummy driver).
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from gymnasium.error import DependencyNotInstalled

from sayd_env.config.palette import plain_matplotlib
from sayd_env.config.units import Array

Picture = npt.NDArray[np.uint8]
Colour = tuple[int, int, int]
Align = Literal["left", "middle", "right"]

FINENESS = 2
"""How many times as large shapes are drawn."""
NEEDED = "pictures of the vehicle need pygame: pip install 'sayd-env[render]'"


def load_pygame() -> Any:
    """The module pygame.

    Raises
    ------
    gymnasium.error.DependencyNotInstalled
        It is not installed.
    """
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        import pygame  # noqa: PLC0415 - an extra, and slow to load
    except ImportError:
        raise DependencyNotInstalled(NEEDED) from None
    return pygame


class Canvas:
    """A picture being drawn.

    Parameters
    ----------
    width, height : int
        Pixels.

    Raises
    ------
    gymnasium.error.DependencyNotInstalled
        Without pygame.
    """

    def __init__(self, width: int, height: int) -> None:
        self.pygame = load_pygame()
        self.pygame.font.init()
        self.size = (width, height)
        self._fine = self.pygame.Surface((FINENESS * width, FINENESS * height), 0, 32)
        self._base = self._fine.copy()
        self._final = self.pygame.Surface(self.size, 0, 32)
        self._fonts: dict[tuple[int, bool], Any] = {}
        self._words: list[tuple[Any, tuple[float, float]]] = []
        self._base_words: list[tuple[Any, tuple[float, float]]] = []

    def keep_as_base(self) -> None:
        """Keep what has been drawn as the background of every picture."""
        self._base.blit(self._fine, (0, 0))
        self._base_words = list(self._words)

    def begin(self) -> None:
        """Begin a picture."""
        self._fine.blit(self._base, (0, 0))
        self._words = list(self._base_words)

    def fill(self, colour: Colour) -> None:
        """Paint everything."""
        self._fine.fill(colour)

    def clip(self, box: tuple[float, float, float, float] | None) -> None:
        """Clip shapes to a box (left, top, width, height); None for no clipping."""
        area = None if box is None else self.pygame.Rect([round(FINENESS * value) for value in box])
        self._fine.set_clip(area)

    def box(
        self,
        place: tuple[float, float, float, float],
        colour: Colour,
        *,
        radius: float = 0.0,
        border: float = 0.0,
    ) -> None:
        """Draw a box (left, top, width, height), filled, or only its border where that has a width."""
        area = self.pygame.Rect([round(FINENESS * value) for value in place])
        width = max(1, round(FINENESS * border)) if border > 0.0 else 0
        self.pygame.draw.rect(self._fine, colour, area, width, border_radius=round(FINENESS * radius))

    def polygon(self, points: Array, colour: Colour, edge: Colour | None = None, width: float = 1.0) -> None:
        """Draw a filled polygon of points (k, 2), with an edge if that has a colour."""
        fine = (FINENESS * points).tolist()
        self.pygame.draw.polygon(self._fine, colour, fine)
        if edge is not None:
            self.pygame.draw.lines(self._fine, edge, True, fine, max(1, round(FINENESS * width)))

    def line(self, points: Array, colour: Colour, width: float = 1.0) -> None:
        """Draw a line through points (k, 2)."""
        if len(points) > 1:
            thick = max(1, round(FINENESS * width))
            self.pygame.draw.lines(self._fine, colour, False, (FINENESS * points).tolist(), thick)

    def disc(self, centre: tuple[float, float], radius: float, colour: Colour) -> None:
        """Draw a filled circle."""
        place = (FINENESS * centre[0], FINENESS * centre[1])
        self.pygame.draw.circle(self._fine, colour, place, FINENESS * radius)

    def text(
        self,
        words: str,
        place: tuple[float, float],
        size: int,
        colour: Colour,
        *,
        align: Align = "left",
        bold: bool = False,
    ) -> float:
        """Set a line of text whose middle height is at a place; return its width in pixels."""
        image = self._text(words, size, colour, bold)
        width, height = image.get_size()
        left = place[0] - {"left": 0.0, "middle": 0.5 * width, "right": float(width)}[align]
        self._words.append((image, (round(left), round(place[1] - 0.5 * height))))
        return float(width)

    def image(self, pixels: Picture, place: tuple[float, float]) -> None:
        """Put an image (height, width, 4) on top of all shapes, with its upper left corner at a place."""
        height, width, _ = pixels.shape
        picture = self.pygame.image.frombuffer(pixels, (width, height), "RGBA")
        self._words.append((picture, place))

    def _text(self, words: str, size: int, colour: Colour, bold: bool) -> Any:
        font = self._fonts.get((size, bold))
        if font is None:
            # Matplotlib brings this typeface along, so that pictures look alike everywhere.
            name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
            with plain_matplotlib():
                import matplotlib as mpl  # noqa: PLC0415 - see there

            path = Path(mpl.get_data_path()) / "fonts" / "ttf" / name
            font = self._fonts[size, bold] = self.pygame.font.Font(str(path), size)
        return font.render(words, True, colour)

    def surface(self) -> Any:
        """The finished picture as a pygame surface."""
        self.pygame.transform.smoothscale(self._fine, self.size, self._final)
        self._final.blits(self._words, False)
        return self._final

    def pixels(self) -> Picture:
        """The finished picture, a new array of shape (height, width, 3)."""
        seen = self.pygame.surfarray.pixels3d(self.surface())
        return np.ascontiguousarray(seen.transpose(1, 0, 2))


class Window:
    """A window that shows pictures at the pace of the simulated time.

    Parameters
    ----------
    size : tuple of int
        Width and height in pixels.
    title : str

    Raises
    ------
    gymnasium.error.DependencyNotInstalled
        There is no screen.
    """

    LONGEST_GAP = 0.04
    """A picture is shown at least this often, s, however late the simulation is."""

    def __init__(self, size: tuple[int, int], title: str) -> None:
        self.pygame = load_pygame()
        try:
            self.pygame.display.init()
            self._refuse_nowhere()
            self._screen = self.pygame.display.set_mode(size)
        except self.pygame.error as error:
            raise DependencyNotInstalled(
                f"a window needs a screen ({error}); render_mode 'rgb_array' and 'sayd render' do without"
            ) from None
        self.pygame.display.set_caption(title)
        self.pygame.key.set_repeat(400, 50)  # ms: a key that is held down goes on
        self.open = True
        self._pressed: list[str] = []
        self._begun: tuple[float, float] | None = None
        self._shown = -np.inf

    def _refuse_nowhere(self) -> None:
        """Refuse what SDL falls back to without a screen, unless it was asked for: nobody would see it."""
        if self.pygame.display.get_driver() == "offscreen" and "SDL_VIDEODRIVER" not in os.environ:
            self.pygame.display.quit()
            raise self.pygame.error("no display was found")

    def due(self, now: float) -> bool:
        """Wait for a simulated time (s); return whether there is time to draw it.

        A picture is left out where the simulation is late and one has been shown just before. Time that runs
        backwards, as it does when an episode begins, starts the clock anew.
        """
        self._listen()
        if not self.open:
            return False
        clock = time.monotonic()
        if self._begun is None or now <= self._begun[1]:
            self._begun = (clock, now)
        ahead = self._begun[0] + (now - self._begun[1]) - clock
        if ahead > 0.0:
            time.sleep(min(ahead, 1.0))
            return True
        if ahead < -self.LONGEST_GAP:  # late: the time that was lost is not made up for
            self._begun = (clock - self.LONGEST_GAP, now)
        return clock - self._shown >= self.LONGEST_GAP

    def pressed(self) -> list[str]:
        """Keys that were pressed since this was asked before, by pygame's names: "up", "space", "q"."""
        self._listen()
        found, self._pressed = self._pressed, []
        return found

    def pause(self) -> None:
        """Let a moment go by in which the simulated time stands still."""
        time.sleep(0.5 * self.LONGEST_GAP)

    def _listen(self) -> None:
        for event in self.pygame.event.get() if self.open else ():
            if event.type == self.pygame.QUIT:
                self.close()
            elif event.type == self.pygame.KEYDOWN:
                self._pressed.append(self.pygame.key.name(event.key))

    def show(self, surface: Any) -> None:
        """Show a picture."""
        self._screen.blit(surface, (0, 0))
        self.pygame.display.flip()
        self._shown = time.monotonic()

    def close(self) -> None:
        """Close the window; closing it again has no effect."""
        if self.open:
            self.open = False
            self.pygame.display.quit()
