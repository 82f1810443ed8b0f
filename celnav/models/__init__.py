"""Physical models of motions, measurements and noise.

Satellites: `orbit`, `sightings`, `pulsar`, `ephemeris`, `gyro`, `gravity` · satellite navigation:
`gnss`, `pseudorange` · inertial navigation: `inertial`, `misalignment`, `earth` · vehicles and
targets: `motion` · `noise`.
"""

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)
