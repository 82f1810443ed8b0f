"""Physics without filters: orbits, sightings, noise, aircraft and inertial systems, gyros, rigid bodies."""
