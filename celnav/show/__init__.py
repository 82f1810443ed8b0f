"""Output for people: figures, recordings, pages, pictures, progress."""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__, "draw")
