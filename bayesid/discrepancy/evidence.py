"""How well a log is explained by a model with some effects added: a marginal likelihood, linear algebra throughout.

With signs settled, the efforts of joint j are  e_j = Y_j beta + Z_j alpha + d_j + error  (:eq:`effects`), the error as
in `bayesid.discrepancy.error_model`, whitened by W_j. The earlier log says what beta is (`bayesid.knowledge`), alpha is
normal about zero with the sd of its effect (on one side of zero where its sign is known); with A the matrix of both,
:eq:`evidence`::

    log p(e) = sum_j log p(W_j (e_j - d_j - A_j x)) - (x - x0)' L (x - x0) / 2 + log det(D) / 2 - log det(H) / 2 + c

at the best x, H = L + sum_j A_j' W_j' W_j A_j (MacKay 2003, chapter 28; exact for normal errors of given covariance).
The error's own parameters are those of the highest likelihood; where they exceed the noise floor, each joint pays
log N.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import log_ndtr

from bayesid.discrepancy.error_model import ErrorModel, fit_error
from bayesid.knowledge import Information
from bayesid.motion import Array, Mask

LN10 = float(np.log(10.0))


@dataclass(frozen=True, eq=False)
class Columns:
    """What a hypothesis adds to the efforts: columns with free amplitudes, and a change without.

    Attributes:
        rows: joint (0-based) to (N, p) columns.
        shift: joint to (N,) change, N m.
        sd: (p,) prior standard deviations of the amplitudes.
        positive: (p,) which of them cannot be negative.
    """

    rows: dict[int, Array]
    shift: dict[int, Array]
    sd: Array
    positive: Mask

    @property
    def joints(self) -> set[int]:
        """Joints in which it acts."""
        return set(self.rows) | set(self.shift)


@dataclass(frozen=True)
class Data:
    """What all hypotheses are judged by.

    Attributes:
        columns: (N, n, r) of the model, zero where a sample is not used.
        effort: (N, n) with their expected signs, zero where not used, N m.
        used: (N, n) samples that count.
        information: of the r coefficients, from earlier logs.
        floor: (n,) RMS of the noise, N m.
        sharp: (n,) whether the floor holds all of the noise (see `bayesid.discrepancy.compare.Floor`).
        limits: (n, 2) largest white and coloured part of the error that is nothing but noise, N m.
        rate: Hz.
    """

    columns: Array
    effort: Array
    used: Mask
    information: Information
    floor: Array
    sharp: Mask
    limits: Array
    rate: float

    def mean_square(self, residual: Array) -> Array:
        """(n,) of residuals (N, n), zero where not used, in units of the floor's."""
        return (residual**2).sum(axis=0) / np.maximum(self.used.sum(axis=0), 1) / self.floor**2


@dataclass(frozen=True)
class Explanation:
    """A log explained by the model and some effects.

    Attributes:
        beta: (r,) coefficients.
        amplitudes: of each effect, (p,) each.
        sd: of the amplitudes.
        residual: (N, n) N m, zero where not used.
        errors: of each joint.
        log_evidence: up to a constant common to all explanations of the same data.
        noise: (n,) log evidence of each joint's residual if it is nothing but noise.
        anything: (n,) the same if it may be anything.
        root: R with R'R = H^-1, in the order of coefficients and amplitudes.
    """

    beta: Array
    amplitudes: tuple[Array, ...]
    sd: tuple[Array, ...]
    residual: Array
    errors: tuple[ErrorModel, ...]
    log_evidence: float
    noise: Array
    anything: Array
    root: Array = field(repr=False)

    @property
    def of_nothing(self) -> float:
        """Log evidence if what is left is nothing but noise."""
        return self.log_evidence - float(np.sum(np.maximum(self.noise, self.anything) - self.noise))


class Bench:
    """Prices explanations by a model, some effects that are added already, and one more.

    Args:
        data: what is to be explained.
        effects: added already.
    """

    def __init__(self, data: Data, effects: Sequence[Columns] = ()) -> None:
        self.data, self.effects = data, tuple(effects)
        self._whitened: dict[tuple[int, ErrorModel], tuple[Array, Array]] = {}

    @cached_property
    def _systems(self) -> list[tuple[Array, Array]]:
        """(N, r + p) columns and (N,) effort of each joint."""
        systems = []
        for j in range(self.data.effort.shape[1]):
            used = self.data.used[:, j]
            parts, effort = [self.data.columns[:, j]], self.data.effort[:, j]
            for one in self.effects:
                parts.append(one.rows.get(j, np.zeros((len(used), len(one.sd)))) * used[:, None])
                effort = effort - one.shift.get(j, 0.0) * used
            systems.append((np.concatenate(parts, axis=1), effort))
        return systems

    def whitened(self, joint: int, error: ErrorModel) -> tuple[Array, Array]:
        """(N, m + 1) whitened columns and effort of a joint, and their (m + 1, m + 1) products."""
        key = joint, error
        if key not in self._whitened:
            columns, effort = self._systems[joint]
            white = error.whiten(np.column_stack([columns, effort])) * self.data.used[:, joint, None]
            self._whitened[key] = white, white.T @ white
        return self._whitened[key]

    def explain(
        self, errors: Sequence[ErrorModel], extra: Columns | None = None, known: Explanation | None = None
    ) -> Explanation:
        """The best explanation by these effects, and one more.

        Args:
            errors: of each joint, to weigh its samples by; what is left is judged by error models of its own.
            extra: one more effect.
            known: another explanation of the same data, whose error models are kept where `extra` does not act.
        """
        effects = self.effects if extra is None else (*self.effects, extra)
        information, r = self.data.information, self.data.columns.shape[2]
        precision = np.concatenate([np.zeros(r), *(1.0 / one.sd**2 for one in effects)])
        best, root, volume = _solve(*self._normal_equations(errors, precision, extra))
        residual = self._residual(best, extra)
        judged, noise, anything = _judge(self.data, residual, None if extra is None else extra.joints, known)
        beta, rest, spread = best[:r], best[r:], np.sqrt(np.sum(root**2, axis=0))[r:]
        misfit = information.misfit(beta) + float(rest @ (precision[r:] * rest))
        positive = np.concatenate([np.empty(0, dtype=bool), *(one.positive for one in effects)]).astype(bool)
        sides = float(np.sum(np.log(2.0) + log_ndtr(rest[positive] / spread[positive])))
        prior = 0.5 * float(np.log(precision[r:]).sum()) - 0.5 * misfit + sides
        cuts = [slice(a, b) for a, b in pairwise(np.cumsum([0, *(len(one.sd) for one in effects)]).tolist())]
        return Explanation(
            beta=beta,
            amplitudes=tuple(rest[cut] for cut in cuts),
            sd=tuple(spread[cut] for cut in cuts),
            residual=residual,
            errors=judged,
            log_evidence=float(np.maximum(noise, anything).sum()) + prior - volume,
            noise=noise,
            anything=anything,
            root=root,
        )

    def _normal_equations(
        self, errors: Sequence[ErrorModel], precision: Array, extra: Columns | None
    ) -> tuple[Array, Array]:
        """H and g of coefficients and amplitudes, from prior, earlier log and all joints."""
        information, r = self.data.information, self.data.columns.shape[2]
        hessian, gradient = np.diag(precision), np.zeros(len(precision))
        hessian[:r, :r] += information.hessian
        gradient[:r] += information.gradient
        m = len(precision) - (0 if extra is None else len(extra.sd))
        for j, error in enumerate(errors):
            white, products = self.whitened(j, error)
            hessian[:m, :m] += products[:-1, :-1]
            gradient[:m] += products[:-1, -1]
            if extra is None or j not in extra.joints:
                continue
            used, effort = self.data.used[:, j], white[:, -1]
            if j in extra.shift:
                shift = error.whiten(extra.shift[j] * used) * used
                gradient[:m] -= white[:, :-1].T @ shift
                effort = effort - shift
            if j in extra.rows:
                more = error.whiten(extra.rows[j] * used[:, None]) * used[:, None]
                cross = white[:, :-1].T @ more
                hessian[:m, m:] += cross
                hessian[m:, :m] += cross.T
                hessian[m:, m:] += more.T @ more
                gradient[m:] += more.T @ effort
        return hessian, gradient

    def settle(self, start: Explanation, extra: Columns | None = None) -> Explanation:
        """`explain` once more with the error models that it has found."""
        first = self.explain(start.errors, extra, start)
        return self.explain(first.errors, extra, first if extra is not None else None)

    def _residual(self, best: Array, extra: Columns | None) -> Array:
        """(N, n) what the best coefficients and amplitudes leave, N m."""
        m = self._systems[0][0].shape[1]
        residual = np.stack([effort - columns @ best[:m] for columns, effort in self._systems], axis=1)
        if extra is not None:
            for j in extra.joints:
                residual[:, j] -= extra.shift.get(j, 0.0)
                if j in extra.rows:
                    residual[:, j] -= extra.rows[j] @ best[m:]
        return residual * self.data.used


def _solve(hessian: Array, gradient: Array) -> tuple[Array, Array, float]:
    """H^-1 g, R with R'R = H^-1, and log det(H) / 2."""
    lengths = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    factor = np.linalg.cholesky(hessian / np.outer(lengths, lengths) + 1e-12 * np.eye(len(lengths)))
    root = solve_triangular(factor, np.diag(1.0 / lengths), lower=True)
    volume = float(np.log(np.diag(factor)).sum() + np.log(lengths).sum())
    return root.T @ (root @ gradient), root, volume


def _judge(
    data: Data, residual: Array, changed: set[int] | None, known: Explanation | None
) -> tuple[tuple[ErrorModel, ...], Array, Array]:
    """Error models, and log evidences of what is left in each joint: as noise, and as anything."""
    n = residual.shape[1]
    errors: list[ErrorModel] = []
    noise, anything = np.empty(n), np.empty(n)
    for j in range(n):
        if known is not None and changed is not None and j not in changed:
            errors.append(known.errors[j])
            kept = known.residual[:, j], residual[:, j]
            moved = [known.errors[j].log_likelihood(one, data.used[:, j]) for one in kept]
            noise[j], anything[j] = (values[j] + moved[1] - moved[0] for values in (known.noise, known.anything))
            continue
        used = data.used[:, j]
        free, value = fit_error(residual[:, j], used, data.rate)
        bounded = free.white <= data.limits[j, 0] and free.coloured <= data.limits[j, 1]
        errors.append(free)
        noise[j] = value if bounded else fit_error(residual[:, j], used, data.rate, tuple(data.limits[j]))[1]
        anything[j] = value - np.log(max(int(used.sum()), 2))
    return tuple(errors), noise, anything


# ---------------------------------------------------------------------------------------------------------------
# Many hypotheses at once
# ---------------------------------------------------------------------------------------------------------------
class Screen:
    """Prices many single effects on top of an explanation, errors as they are: what is worth a closer look.

    Args:
        bench: with the effects that are added already.
        errors: of each joint.
    """

    def __init__(self, bench: Bench, errors: Sequence[ErrorModel]) -> None:
        self._data, self._errors = bench.data, errors
        now = bench.explain(errors)
        self._root = now.root
        self._white = [bench.whitened(j, error)[0][:, :-1] for j, error in enumerate(errors)]
        self._residual = [error.whiten(now.residual[:, j]) for j, error in enumerate(errors)]

    def gain(self, effects: Sequence[Columns]) -> tuple[Array, Array]:
        """Gains in log evidence of k effects with p amplitudes each, in the same joints.

        Args:
            effects: k of them.

        Returns:
            (k,) gains, and (k,) gains to be expected of amplitudes of one prior standard deviation.
        """
        k, p = len(effects), len(effects[0].sd)
        joints = sorted(set().union(*(one.joints for one in effects)))
        m = self._root.shape[1]
        cross, cross_shift = np.zeros((m, k * p)), np.zeros((m, k))
        gram, slope, pushed, base = np.zeros((k, p, p)), np.zeros((k, p)), np.zeros((k, p)), np.zeros(k)
        for j in joints:
            used = self._data.used[:, j, None]
            shifts = np.stack([one.shift.get(j, np.zeros(len(used))) for one in effects], axis=1)
            shifts = self._errors[j].whiten(shifts * used) * used if np.any(shifts) else shifts
            base += shifts.T @ self._residual[j] - 0.5 * np.sum(shifts**2, axis=0)
            cross_shift += self._white[j].T @ shifts
            if p:
                white = np.concatenate([one.rows.get(j, np.zeros((len(used), p))) for one in effects], axis=1)
                white = self._errors[j].whiten(white * used) * used
                cross += self._white[j].T @ white
                blocks = white.reshape(len(used), k, p)
                gram += np.einsum("nkp,nkq->kpq", blocks, blocks, optimize=True)
                slope += np.einsum("nkp,n->kp", blocks, self._residual[j])
                pushed += np.einsum("nkp,nk->kp", blocks, shifts)
        seen_shift = self._root @ cross_shift
        base += 0.5 * np.sum(seen_shift**2, axis=0)
        if not p:
            return base, np.abs(base)
        seen = (self._root @ cross).reshape(m, k, p)
        gram -= np.einsum("rkp,rkq->kpq", seen, seen, optimize=True)
        slope -= pushed - np.einsum("rkp,rk->kp", seen, seen_shift)
        sd = np.stack([one.sd for one in effects])
        scaled = gram * sd[:, :, None] * sd[:, None, :] + np.eye(p)
        best = np.linalg.solve(scaled, (slope * sd)[:, :, None])[:, :, 0]
        log_det = np.linalg.slogdet(scaled)[1]
        spread = np.sqrt(np.maximum(np.diagonal(np.linalg.inv(scaled), axis1=1, axis2=2), 1e-300))
        positive = np.stack([one.positive for one in effects])
        sides = np.sum(np.where(positive, np.log(2.0) + log_ndtr(best / spread), 0.0), axis=1)
        gain = base + 0.5 * np.sum(best * slope * sd, axis=1) - 0.5 * log_det + sides
        return gain, 0.5 * (np.trace(scaled, axis1=1, axis2=2) - p) - 0.5 * log_det
