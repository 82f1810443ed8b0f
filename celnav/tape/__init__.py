"""Arithmetic that is recorded once and made into machine code: numbers that remember how they came
about, and their compilers.

Nothing here knows of filters.
"""
