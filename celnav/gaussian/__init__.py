"""Gaussians: small matrices, spaces, beliefs and their forms, rules."""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)
