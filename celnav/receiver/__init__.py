"""A BeiDou receiver's own log: RINEX files, positions, fixes without a prior (`least_squares`), and
what is said of them.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)
