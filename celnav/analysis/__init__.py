"""What can be known of a filter without flying it, and how its numbers are judged: bounds, metrics,
observability, tuning.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)
