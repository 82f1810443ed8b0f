"""Logs of a satellite receiver: RINEX files, filtered positions, fixes without a prior
(`least_squares`), and reports.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)
