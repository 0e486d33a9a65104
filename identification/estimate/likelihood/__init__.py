"""Maximum-likelihood estimation of the parameters from one-step prediction errors (M22-M24).

Parts: searches, fits, acceptance tests, bias correction (M33 to M36), long recordings (M44),
profiles (M45) and bootstrap.
"""
