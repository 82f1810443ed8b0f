"""Physical models, which do not depend on filters.

`orbit` and `sightings` of a satellite · `pulsar` and `ephemeris` for its X-ray timing · `gnss` and
`pseudorange` for a receiver · `inertial` for an IMU and what corrects it · `earth` and
`misalignment` for an aircraft · `gyro` for attitudes · `motion` of vehicles and targets · `noise`.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)
