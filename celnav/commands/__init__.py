"""The commands of `celnav.cli`, one module each: ``run(options) -> exit status``."""
