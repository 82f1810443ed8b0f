"""Physics without filters: orbits, sightings, noise."""
