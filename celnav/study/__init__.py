"""Studies: runs that are simulated, filtered and judged."""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)
