"""Arithmetic that is recorded once and compiled: numbers that record the operations on them, and
the compilers.

CasADi [Andersson2019] records expressions and writes C, and Archimedes records numpy code through
CasADi. This tape is smaller: it has vector code over runs, but no sparse derivatives and no
solvers.

This package does not depend on filters.
"""
