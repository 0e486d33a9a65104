"""Diagnosis of the gas generator from pressure and valve angle: the only equation is the balance of
its gas (eq. 4).
"""
