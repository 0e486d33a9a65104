"""Diagnosis of the gas generator from pressure and valve angle: the balance of its gas (eq. 4) is
the one equation.
"""
