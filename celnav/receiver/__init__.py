"""A BeiDou receiver's own log: RINEX files, positions, and what is said of them."""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)
