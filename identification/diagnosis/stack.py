"""Stacks and whitens all equations, projects the nominal tangent out, and scores candidates against
the remaining mismatch.

Scores are computed for each block of time, so that correlation within blocks is taken into account
(wild cluster bootstrap: Cameron, Gelbach and Miller, Review of Economics and Statistics 90 (2008)
414).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property

import numpy as np
from scipy import sparse, special

from identification.diagnosis.rows import Equation, gather_of, in_blocks, numbered
from identification.diagnosis.rules import RULES
from identification.effects.effect import Columns, Effect, Shape
from identification.recording import Array
from identification.views.nominal import Nominal
from identification.views.view import View, delayed_view

# An effect at trial parameters, with its score on the remaining mismatch.

FEW_REGRESSORS = 4
"""Greatest number of regressors for which the statistic comes from the residual of their fit."""
NO_WEIGHTS = np.zeros((0, 0, 0))


@dataclass(frozen=True)
class Candidate:
    """One effect at one set of nonlinear parameters, with its score on the residual of a stack."""

    name: str  # name of the effect, or of a generic family
    shape: Shape
    coefficients: Array  # least-squares coefficients, in the units of the term, shape (k,)
    gain: float  # sum of whitened squares that the effect explains
    # Expected sum of whitened squares that the effect explains by chance (Takeuchi); computed from
    # single rows if the effect is active in too few blocks.
    penalty: float
    # Squared score over its variance by blocks after the fit; about chi-square with k degrees of
    # freedom if nothing is missing.
    statistic: float
    blocks: Array  # score by block, shape (b, k)
    # Inner products of the orthonormal regressors by block, shape (b, k, k); empty for many
    # regressors.
    weights: Array
    # Power of the effect's contribution over the noise power, in the rows of its equations.
    share: float
    least_share: float = RULES.least_share  # share up to which the contribution is negligible

    @property
    def relevant(self) -> bool:
        """Whether the contribution is more than negligible."""
        return self.share > self.least_share

    @property
    def score(self) -> float:
        """Sum of whitened squares that the effect explains beyond those expected by chance."""
        return self.gain - 2.0 * self.penalty

    @property
    def tested(self) -> bool:
        """Whether the effect is active in enough blocks to be tested by flipping their signs."""
        return not len(self.weights) or active_blocks(self.weights) >= RULES.least_active

    @property
    def surprise(self) -> float:
        """-log of the probability of at least this statistic."""
        return log_surprise(self.statistic, len(self.coefficients))

    @property
    def preference(self) -> float:
        """Preference of the data for the model with the effect over the model without it, in
        standard errors of the gain by blocks; infinite without weights.
        """
        if not len(self.weights):
            return math.inf
        score = np.sum(self.blocks, axis=0)
        gain = 2.0 * self.blocks @ score - np.einsum("j,bjk,k->b", score, self.weights, score)
        spread = float(np.std(gain, ddof=1)) * math.sqrt(len(gain))
        return float(np.sum(gain)) / spread if spread > 0.0 else 0.0


def active_blocks(weights: Array) -> float:
    """Return the number of blocks in which regressors are active, from their inner products by
    block, shape (b, k, k): the inverse participation.
    """
    energy = np.einsum("bkk->b", weights) / weights.shape[1]
    return 1.0 / float(energy @ energy)


def log_surprise(statistic: Array | float, degrees: int) -> float:
    """Return -log of the probability that a chi-square exceeds ``statistic``."""
    with np.errstate(divide="ignore"):
        return -np.log(special.chdtrc(degrees, statistic))  # type: ignore[no-any-return]


def wald_statistic(score: Array, sums: Array) -> float:
    """Return the squared score over its variance by blocks."""
    variance = sums.T @ sums
    return float(score @ np.linalg.lstsq(variance, score, rcond=1e-10)[0])


ROUNDING = 1e-9  # norm below which a part of an orthonormal column counts as rounding error
NOMINAL_IN = ("torque", "breakaway")
"""Equations in which regressors may depend on the nominal values."""


@dataclass(frozen=True)
class Stack:
    """Whitened rows of all equations, without nominal tangent and effect basis (projected out)."""

    equations: tuple[Equation, ...]
    nominal: Nominal
    basis: tuple[Array, ...]
    effect_basis: Array  # orthonormal columns of the selected effects, shape (n, g)
    residual: Array  # whitened residual after projection, shape (n,)
    block: np.ndarray  # block of each row, shape (n,)
    blocks: int
    # Sums over blocks, one sparse matrix for each equation, shape (b, n_e).
    gather: tuple[sparse.csr_matrix, ...] = field(repr=False)
    # Regressors that do not depend on the nominal values, by term and nonlinear parameters; all
    # stacks of the same recordings use this cache.
    cache: dict[tuple[str, Shape], dict[str, Array]] = field(repr=False, default_factory=dict)
    # Regressors that depend on the nominal values; only this stack uses this cache.
    own: dict[tuple[str, Shape], dict[str, Array]] = field(repr=False, default_factory=dict)

    def part(self, name: str) -> slice:
        """Return the rows of one equation."""
        start = 0
        for equation in self.equations:
            if equation.name == name:
                return slice(start, start + len(equation.residual))
            start += len(equation.residual)
        return slice(0, 0)

    @property
    def measured(self) -> Array:
        """Whitened rows less the nominal model, not projected, shape (n,)."""
        return np.concatenate([e.residual / e.sigma for e in self.equations])

    def only(self, names: Collection[str]) -> Stack:
        """Return the part of the stack with the rows in which regressors of the equations ``names``
        can be nonzero after projection.

        Projection of an effect basis may make a regressor nonzero in other equations, in which a
        column of the basis is nonzero too; all other rows are omitted.
        """
        wanted = connected(names, self._effect_basis_equations)
        key = frozenset(e.name for e in self.equations if e.name in wanted)
        if len(key) == len(self.equations):
            return self
        if key not in self._parts:
            self._parts[key] = self._restricted(key)
        return self._parts[key]

    @cached_property
    def _parts(self) -> dict[frozenset[str], Stack]:
        return {}

    @cached_property
    def _effect_basis_equations(self) -> list[set[str]]:
        """Equations in which each column of the effect basis is nonzero."""
        shown = {
            e.name: np.linalg.norm(self.effect_basis[self.part(e.name)], axis=0) > ROUNDING
            for e in self.equations
        }
        return [
            {name for name, some in shown.items() if some[k]}
            for k in range(self.effect_basis.shape[1])
        ]

    def _restricted(self, names: Collection[str]) -> Stack:
        kept = [k for k, e in enumerate(self.equations) if e.name in names]
        rows = np.concatenate(
            [np.arange(len(self.residual))[self.part(self.equations[k].name)] for k in kept]
        )
        return replace(
            self,
            equations=tuple(self.equations[k] for k in kept),
            basis=tuple(self.basis[k] for k in kept),
            effect_basis=self.effect_basis[rows],
            residual=self.residual[rows],
            block=self.block[rows],
            gather=tuple(self.gather[k] for k in kept),
        )

    def columns(self, term: Effect, shape: Shape) -> dict[str, Array]:
        """Return the rows of an effect's regressors, by equation, shape (n_e, k)."""
        key = (term.name, shape)
        late = term.at_angle and self.nominal.late_s != 0.0
        kept = (
            self.own.get(key, {}) if late else {**self.cache.get(key, {}), **self.own.get(key, {})}
        )
        # The columns of the torque and of the breakaway equation are the same, and are computed
        # once.
        once = cache(_computed)
        found = {
            equation.name: kept[equation.name]
            if equation.name in kept
            else equation.rows(view_regressors(term, equation.name, self.nominal, shape, once))
            for equation in self.equations
            if equation.name in term.columns
        }
        for name, columns in found.items():
            varies = late or (term.follows and name in NOMINAL_IN) or name in term.varies
            store = self.own if varies else self.cache
            store.setdefault(key, {})[name] = columns
        return found

    def whitened(self, columns: Mapping[str, Array]) -> Array:
        """Return regressors as whitened rows of the whole stack, not projected, shape (n, k)."""
        width = max(c.shape[1] for c in columns.values())
        out = np.zeros((len(self.residual), width))
        for equation in self.equations:
            if equation.name in columns:
                out[self.part(equation.name)] = columns[equation.name] / equation.sigma
        return out

    def projected(self, whitened: Array) -> Array:
        """Return whitened columns with the nominal tangent and the effect basis projected out."""
        out = whitened.copy()
        for equation, basis in zip(self.equations, self.basis, strict=True):
            rows = self.part(equation.name)
            out[rows] -= basis @ (basis.T @ out[rows])
        if self.effect_basis.shape[1]:
            out -= self.effect_basis @ (self.effect_basis.T @ out)
        return out

    def without(self, names: Collection[str]) -> Stack:
        """Return the stack without the parameters ``names`` in the torque equation's tangent."""
        basis = [
            _orthonormal(e.tangent[:, [k for k, name in enumerate(e.names) if name not in names]])
            if e.name == "torque" and set(e.names) & set(names)
            else q
            for e, q in zip(self.equations, self.basis, strict=True)
        ]
        return replace(self, basis=tuple(basis))

    def sums(self, values: Array) -> Array:
        """Return sums over blocks, shape (b, k)."""
        return np.asarray(
            sum(
                g @ values[self.part(e.name)]
                for e, g in zip(self.equations, self.gather, strict=True)
            )
        )

    def candidate(
        self,
        name: str,
        shape: Shape,
        columns: Mapping[str, Array],
        positive: Sequence[int] = (),
        one_recording: bool = False,
    ) -> Candidate | None:
        """Return the score of regressors, or None if the regressors are collinear with the nominal
        model, active in too few blocks (unless of ``one_recording``), or have a coefficient of
        unphysical sign.
        """
        if not columns:
            return None
        here = self.only(columns.keys())
        return here._scored(name, shape, columns, positive, one_recording)

    def _scored(
        self,
        name: str,
        shape: Shape,
        columns: Mapping[str, Array],
        positive: Sequence[int],
        one_recording: bool = False,
    ) -> Candidate | None:
        full = self.whitened(columns)
        # Columns that belong to one recording are zero if this recording does not show the effect.
        shown = _lengths(full) > 0.0
        before = _lengths(full)[shown]
        rest = self.projected(full[:, shown])
        if not len(before) or np.any(_lengths(rest) < RULES.collinear_below * before):
            return None
        q, r = np.linalg.qr(rest)
        diagonal = np.abs(np.diag(r))
        if np.any(diagonal < RULES.collinear_below * before):
            return None
        sums, weights = in_blocks(q, self.residual, self.block, self.blocks)
        enough = active_blocks(weights) >= RULES.least_active
        if not (enough or one_recording):
            return None
        score = q.T @ self.residual
        coefficients = np.zeros(len(shown))
        coefficients[shown] = np.linalg.solve(r, score)
        if any(coefficients[k] <= 0.0 for k in positive):
            return None
        rest_sums = sums - weights @ score
        few = q.shape[1] <= FEW_REGRESSORS
        penalty = float(np.sum(rest_sums**2))
        if not enough:
            # The fit takes up the whole score of a single block, whose remainder states no chance.
            rest = self.residual - q @ score
            penalty = max(penalty, float(np.sum((q * rest[:, None]) ** 2)), float(q.shape[1]))
        return Candidate(
            name=name,
            shape=shape,
            coefficients=coefficients,
            gain=float(score @ score),
            penalty=penalty,
            statistic=wald_statistic(score, rest_sums if few else sums),
            blocks=sums,
            weights=weights if few else NO_WEIGHTS,
            share=float(score @ score) / sum(len(c) for c in columns.values()),
            least_share=_least_share([e for e in self.equations if e.name in columns]),
        )

    def independent(self, name: str, equation: str, columns: Array) -> Candidate | None:
        """Return the score of those linear combinations of one equation's regressors that are not
        collinear with the nominal tangent and the effect basis.
        """
        number = next(k for k, e in enumerate(self.equations) if e.name == equation)
        rows, basis, sigma = self.part(equation), self.basis[number], self.equations[number].sigma
        effect_basis = self.effect_basis[rows]
        rest = columns - basis @ (basis.T @ columns)
        if effect_basis.shape[1]:
            rest = rest - effect_basis @ np.linalg.lstsq(effect_basis, rest, rcond=1e-10)[0]
        values, vectors = np.linalg.eigh(rest.T @ rest)
        keep = values > RULES.collinear_below * float(
            np.max(np.sum(columns**2, axis=0), initial=0.0)
        )
        if not np.any(keep):
            return None
        q = rest @ (vectors[:, keep] / np.sqrt(values[keep]))
        score = q.T @ self.residual[rows]
        products = q * self.residual[rows][:, None]
        sums = np.asarray(self.gather[number] @ products)
        gain = float(score @ score)
        share, chance = gain / len(columns), float(len(score))
        return Candidate(
            name,
            (),
            score * sigma,
            gain,
            chance,
            wald_statistic(score, sums),
            sums,
            NO_WEIGHTS,
            share,
            _least_share([self.equations[number]]),
        )

    def term(self, term: Effect, shape: Shape) -> Candidate | None:
        """Return an effect's score at given nonlinear parameters, or None (:meth:`candidate`)."""
        # An effect that occurs in one recording only is active in few blocks.
        alone = term.place is not None
        return self.candidate(term.name, shape, self.columns(term, shape), term.positive, alone)


def _least_share(equations: Iterable[Equation]) -> float:
    white = all(e.white for e in equations)
    return RULES.least_share_white if white else RULES.least_share


def connected(names: Collection[str], ties: Iterable[Collection[str]]) -> set[str]:
    """Return these equations and all that the groups ``ties`` connect with them."""
    found, left = set(names), [set(t) for t in ties]
    while joined := [t for t in left if t & found]:
        found = found.union(*joined)
        left = [t for t in left if t not in joined]
    return found


def _computed(make: Columns, view: View, nominal: Nominal, shape: Shape) -> Array:
    return make(view, nominal, shape)


def view_regressors(
    term: Effect,
    equation: str,
    nominal: Nominal,
    shape: Shape,
    made: Callable[..., Array] = _computed,
) -> Callable[[View], Array]:
    """Return a function of a view for the regressors of one equation; ``made`` may be cached."""
    make = term.columns[equation]
    if term.at_angle and equation == "torque" and nominal.late_s:
        return lambda view: made(make, delayed_view(view, nominal.late_s), nominal, shape)
    return lambda view: made(make, view, nominal, shape)


def stack_of(equations: Sequence[Equation], nominal: Nominal, like: Stack | None = None) -> Stack:
    """Stack equations at the nominal values; ``like`` lends its blocks, its cache, and the bases of
    the tangents that are the same.
    """
    basis = []
    residuals = []
    known = {}
    if like is not None:
        bases = zip(like.equations, like.basis, strict=True)
        known = {id(e.tangent): q for e, q in bases}
    for equation in equations:
        q = known.get(id(equation.tangent))
        if q is None:
            q = _orthonormal(equation.tangent)
        basis.append(q)
        residuals.append((equation.residual - q @ (q.T @ equation.residual)) / equation.sigma)
    residual = np.concatenate(residuals)
    block, blocks = numbered(equations, residuals) if like is None else (like.block, like.blocks)
    gather = gather_of(equations, block, blocks) if like is None else like.gather
    cache = {} if like is None else like.cache
    nothing = np.zeros((len(residual), 0))
    return Stack(
        tuple(equations), nominal, tuple(basis), nothing, residual, block, blocks, gather, cache
    )


def _lengths(columns: Array) -> Array:
    """Return the norm of each column, in one pass; numpy's function needs several passes."""
    return np.asarray(np.sqrt(np.einsum("ij,ij->j", columns, columns)))


def _orthonormal(tangent: Array) -> Array:
    scale = np.linalg.norm(tangent, axis=0)
    q, r = np.linalg.qr(tangent / np.where(scale > 0.0, scale, 1.0))
    return np.asarray(q[:, np.abs(np.diag(r)) > 1e-9])


def with_effect_basis(stack: Stack, regressors: Array) -> Stack:
    """Return the stack with whitened regressors, shape (n, g), as its effect basis."""
    columns = stack.projected(regressors)
    q, r = np.linalg.qr(columns)
    diagonal = np.abs(np.diag(r))
    q = q[:, diagonal > 1e-9 * max(float(np.max(diagonal, initial=0.0)), 1e-300)]
    return replace(stack, effect_basis=q, residual=stack.residual - q @ (q.T @ stack.residual))
