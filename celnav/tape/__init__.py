"""Arithmetic that is recorded once and compiled: numbers that remember the operations that made
them, and the compilers.

This room does not depend on filters.
"""
