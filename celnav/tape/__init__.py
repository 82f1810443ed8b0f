"""Arithmetic that is recorded once and compiled: numbers that remember the operations that made
them, and the compilers.

CasADi [Andersson2019] records expressions and writes C, and Archimedes records numpy code through
CasADi. This tape is smaller: it has vector code over runs, no sparse derivatives and no solvers.

This room does not depend on filters.
"""
