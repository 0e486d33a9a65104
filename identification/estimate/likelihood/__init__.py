"""Maximum likelihood (M22 to M24, M33 to M36, M44, M45): searches, fits, acceptance, bias,
profiles, bootstrap.
"""
