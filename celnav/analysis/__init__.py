"""What can be computed about a filter without running it, and how its results are evaluated:
bounds, metrics, observability, tuning.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)
