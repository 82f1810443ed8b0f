"""Physics, of which no filter knows.

`orbit` and `sightings` of a satellite · `pulsar` and `ephemeris` of its X-ray timings · `gnss` and
`pseudorange` of a receiver · `earth` and `inertial` of an aircraft · `gyro` of attitudes · `motion`
of vehicles and targets · `noise`.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)
