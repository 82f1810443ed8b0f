"""Studies: runs that are drawn, flown and judged."""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)
