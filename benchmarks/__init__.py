"""Speed of celnav against its peers; see README.md. Not part of the package nor of its tests."""
