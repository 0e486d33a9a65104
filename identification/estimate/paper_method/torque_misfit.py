"""Computes the norm of the torque error of eq. 15/16 for a whole population of candidates at once.

At a given Stribeck speed the model is linear in all other parameters. The squared norm over all
samples is therefore a combination of sums that do not depend on the candidate, and of five sums
that contain exp(-|omega/omega_s|^alpha). Only this exponential is evaluated for each candidate and
sample; all other operations are one matrix product.
"""

from __future__ import annotations

import numpy as np

from identification.numerics.arrays import Array

_CHUNK = 2048  # samples per block, so that a population's block fits into the processor's cache
_LOG_NEGLIGIBLE = -80.0  # exp(-80) is negligible against 1; below -708 it would be a denormal


class TorqueMisfit:
    """sqrt(sum e^2) with e = torque - load (sgn(w) (c + (s - c) exp(-|w/w_s|^alpha)) + v w) - J dw.

    Args:
        torque: Drive torque less known torques, N m, shape (n,).
        velocity: w, rad/s, shape (n,); samples at rest must be omitted, because at rest friction is
            not a function of speed.
        acceleration: dw, rad/s^2, shape (n,).
        load: Factor on the friction terms, shape (n,): 1 for the system load (eq. 9), F_P L1 in N m
            for the working load (eq. 13).
        alpha: Stribeck exponent.
    """

    def __init__(
        self, torque: Array, velocity: Array, acceleration: Array, load: Array, alpha: float
    ) -> None:
        dry = load * np.sign(velocity)
        features = np.stack([torque, dry, load * velocity, acceleration], axis=1)
        self.samples = len(torque)
        self._speed = np.abs(velocity) ** alpha
        self._alpha = alpha
        self._gram = features.T @ features
        self._products = dry[:, None] * features
        self._square = dry * dry

    def norms(self, c: Array, s: Array, w_s: Array, v: Array, inertia: Array) -> Array:
        """Return the norm for every candidate; all arguments have shape (p,).

        Cancellation between the sums limits the accuracy of the result to about 1e-8 of the norm of
        the torque.

        Args:
            c: Coulomb level (Mc or mu_c).
            s: Static level (Ms or mu_s).
            w_s: Stribeck speed, rad/s, above 0.
            v: Viscous coefficient (sigma_2 or mu_2).
            inertia: J, kg m^2.
        """
        rates = -(w_s**-self._alpha)
        linear = np.zeros((len(c), 4))
        square = np.zeros(len(c))
        for start in range(0, self.samples, _CHUNK):
            block = slice(start, start + _CHUNK)
            decay = np.multiply.outer(rates, self._speed[block])
            np.exp(np.maximum(decay, _LOG_NEGLIGIBLE, out=decay), out=decay)
            linear += decay @ self._products[block]
            square += np.multiply(decay, decay, out=decay) @ self._square[block]
        weights = np.stack([np.ones_like(c), -c, -v, -inertia], axis=1)
        constant = np.einsum("pi,ij,pj->p", weights, self._gram, weights)
        excess = s - c
        total = (
            constant - 2.0 * excess * np.einsum("pi,pi->p", weights, linear) + excess**2 * square
        )
        return np.asarray(np.sqrt(np.maximum(total, 0.0)))
