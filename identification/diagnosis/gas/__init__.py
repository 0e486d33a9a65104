"""Diagnosis of the gas generator from pressure and valve angle; the only equation is the mass
balance of the gas (eq. 4).
"""
