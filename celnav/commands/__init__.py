"""The commands of `celnav.cli`, one module each, with ``run(options) -> exit status``."""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)
