"""Physics without filters: orbits, sightings, noise, aircraft and inertial systems, gyros, rigid bodies."""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)
