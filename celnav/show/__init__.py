"""Output for people: figures, recordings, pages, pictures, progress."""

from typing import TYPE_CHECKING

from celnav.lazy import modules

if TYPE_CHECKING:
    from celnav.show.reading import read as read
    from celnav.show.streaming import live as live

_LATE = {"read": "celnav.show.reading", "live": "celnav.show.streaming"}
__getattr__, __dir__ = modules(__name__, "draw", **_LATE)
