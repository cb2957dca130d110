"""Recursive least squares: identification while the robot runs, one update per chunk of a stream."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.effects.coefficients import base_coefficients
from bayesid.errors import InputError
from bayesid.identification.identification import Identification, identified_of
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.identification.prediction import NORMAL_95, check_payloads
from bayesid.identification.records import Coefficient, Records, named
from bayesid.monitor.stream_moments import SignCheck, StreamMoments, check_signs
from bayesid.monitor.tracker import MOVING, TrackedSample, signed_joints
from bayesid.motion import SLOWEST, STANDSTILL, Motion
from bayesid.posterior.tuning import TUNING as POSTERIOR_TUNING
from bayesid.regression.knowledge import InformationMatrix
from bayesid.regression.least_squares import covariance_of
from bayesid.regression.noise import Noise
from bayesid.regression.solver import solve_precisely
from bayesid.signs.search.certified import Certified
from bayesid.signs.search.protocol import Search

_BY_DATA, _BY_EARLIER, _BY_PRIOR = "data", "earlier log", "prior"


class RecursiveEstimator:
    """Recursive least squares on a stream: coefficients and their uncertainty after every chunk.

    Terms, noise and its autocorrelation are those of an identified model. Rows are weighted, and effective samples
    counted, as in its least squares. An uncertain sign enters by its expectation, and its row has less information. The
    result does not depend on how the stream is cut into chunks. Memory and time per chunk do not grow with the stream.
    Pickling keeps the state exactly.

    Args:
        model: an `IdentifiedModel`, as of `bayesid.load`, or an `Identification`.
        forget: time constant, s: a sample of age dt has the weight exp(-dt / forget), also in the number of samples.
            The sd is valid if the robot does not change meanwhile. By default nothing is forgotten.
        earlier: whether the information of the model's own log counts too, as if it came before the first chunk.
            Without it, coefficients that the stream does not show keep the model's values, with an infinite sd.
        signed: (n,) joints whose efforts have signs; none by default.
        most_individual: segments per joint that are kept separately, those with the most uncertain signs; some 10 kB
            each. `check_signs` can flip each of them, but the other segments of a joint only together.

    Raises:
        InputError: the model, `forget`, `signed` or `most_individual` is invalid.

    Example:
        >>> running = bayesid.RecursiveEstimator(result.identified, forget=60.0)
        >>> probability = result.probability  # or a tracker's, chunk by chunk
        >>> for part in (slice(0, 100), slice(100, 301)):
        ...     running.add(result.signals.motion[part], result.signals.raw_effort[part], probability[part])
        >>> running.coefficient("Fc2").unit, running.coefficient("Fc2").sd < 0.2
        ('N m', True)
    """

    def __init__(
        self,
        model: IdentifiedModel | Identification,
        forget: float | None = None,
        *,
        earlier: bool = False,
        signed: Mask | None = None,
        most_individual: int = 200,
    ) -> None:
        identified = identified_of(model, "model")
        if forget is not None and not 0.0 < forget < np.inf:
            raise InputError(f"a time constant of {forget!r} s", "forget", "give seconds, or None to forget nothing")
        if most_individual < 0:
            raise InputError(f"{most_individual} segments", "most_individual", "give 0 or a positive whole number")
        self._identified, self._earlier = identified, earlier
        self._moments = StreamMoments(
            model=identified.model,
            coefficients=base_coefficients(identified.model),
            sigma=identified.noise.sigma,
            forget=np.inf if forget is None else float(forget),
            signed=signed_joints(signed, identified.model.robot.n_joints),
            most_individual=most_individual,
        )

    def __repr__(self) -> str:
        robot, moments = self._identified.model.robot, self._moments
        duration = f"{moments.time - moments.began:.6g} s" if np.isfinite(moments.time) else "no samples yet"
        count = ", ".join(f"{count:.0f}" for count in self.effective_samples)
        return f"RecursiveEstimator of {robot.name}: {duration}; effective samples per joint {count}"

    def add(self, motion: Motion, effort: Array, probability: Array, moving: Mask | None = None) -> None:
        """Adds the next chunk of the stream; an invalid chunk changes nothing.

        Records of a tracker are added by `add_tracked`; the motion of a log is `Signals.motion`.

        If effects of the model have a memory (`delay`, `hysteresis`), the last 16 samples wait for the next chunk, and
        each chunk computes the columns of up to 4096 earlier samples again: give long chunks.

        Args:
            motion: N samples of n joints, later than all before, s, rad, rad/s, rad/s^2.
            effort: (N, n) |effort|, N m, computed with the model's gains; with its sign in signed joints.
            probability: (N, n) P(sign = +); ignored in signed joints. Leave out samples with an uncertain sign and a
                large |effort|, as at a tracker's start: they bias coefficients towards zero.
            moving: (N, n) samples that count; of a tracker those whose state is "moving". By default those of actuators
                above 1 % of their highest speed so far: give it if the stream begins at a standstill.

        Raises:
            InputError: joints, shapes, values or times are invalid.
        """
        moments = self._moments
        self._check_motion(motion)
        efforts, plus = (
            _checked(given, motion.q.shape, name) for given, name in ((effort, "effort"), (probability, "probability"))
        )
        if np.any((plus < 0.0) | (plus > 1.0)):
            raise InputError("holds values outside 0 to 1", "probability", "give P(sign = +)")
        if len(motion) == 0:
            return
        speed = moments.model.robot.actuators(motion).dq
        top = np.maximum.accumulate(np.vstack([moments.top_speed, np.abs(speed)]))[1:]
        fast = np.abs(speed) > STANDSTILL * np.maximum(top, SLOWEST)
        used = fast if moving is None else _checked(moving, motion.q.shape, "moving") > 0.0
        magnitude, readable = moments.model.invert_sensor(np.abs(efforts))
        sign = np.where(moments.signed, np.where(efforts >= 0.0, 1.0, -1.0), 2.0 * plus - 1.0)
        of_effort = {"speed": speed, "magnitude": magnitude, "sign": sign, "used": used & readable}
        of_motion = {name: getattr(motion, name) for name in ("t", "q", "dq", "ddq", "payload")}
        moments.add(of_motion | of_effort, motion.origin)
        moments.top_speed = top[-1]

    def add_tracked(self, records: Iterable[TrackedSample], payload: str = "") -> None:
        """Adds records of a tracker: motion and signs, in joints whose state is "moving".

        Records that are not `known`, and missing efforts, are left out.

        Args:
            records: of a `SignTracker`, in their order, each once; a few long chunks are faster than many short ones.
            payload: label of the payload on the flange, as given to the tracker.

        Raises:
            InputError: joints do not match, time does not increase, as after a clock reset, or the model has no payload
                of this label.
        """
        known = [record for record in records if record.known]
        if not known:
            return
        t, q, dq, ddq, effort, probability = (
            np.array([getattr(record, name) for record in known])
            for name in ("t", "q", "dq", "ddq", "effort", "probability")
        )
        moving = (np.array([record.state for record in known]) == MOVING) & np.isfinite(effort)
        motion = Motion(t, q, dq, ddq, payload=np.array(payload))
        self.add(motion, np.nan_to_num(effort), probability, moving)

    def coefficients(self) -> Records[Coefficient]:
        """The base coefficients, one record each: iterate over them, or use `.to_dataframe()`.

        By weighted least squares without the cone; the parameters of `model()` are in it. `sd` includes effective
        samples, uncertain signs, possibly missing effects and uncertain gains. With `earlier`, `prior_sd` is the sd
        from the model's own log alone. `decided_by` is "earlier log" if that log has more than a tenth of the
        information, and "prior" if nothing shows the coefficient.
        """
        coefficients, (normal, lost) = self._moments.coefficients, self._normal_equations()
        beta = _least_squares(normal, coefficients.project(self._identified.theta))
        precisions = normal.hessian - lost, self._earlier_information()
        variance, earlier = (np.diag(covariance_of(precision)[0]) for precision in precisions)
        of_data, of_earlier = variance <= POSTERIOR_TUNING.of_prior * earlier, np.isfinite(earlier)
        decided = np.select(
            [~np.isfinite(variance), of_data, of_earlier], [_BY_PRIOR, _BY_DATA, _BY_EARLIER], _BY_PRIOR
        )
        beyond = np.diag(self._identified.beyond_precision)
        sd, prior_sd = np.sqrt(variance + beyond), np.sqrt(np.where(of_earlier, earlier + beyond, np.nan))
        numbers = np.stack([beta, sd, beta - NORMAL_95 * sd, beta + NORMAL_95 * sd]).tolist()
        names, stated = (coefficients.names, coefficients.expressions, coefficients.units), [np.nan] * len(coefficients)
        columns = *names, *numbers, decided.tolist(), prior_sd.tolist(), stated
        return Records(Coefficient, (Coefficient(*row) for row in zip(*columns, strict=True)))

    def coefficient(self, name: str) -> Coefficient:
        """A base coefficient by its name; InputError with similar names if there is none."""
        return named(self.coefficients(), name, "coefficient")

    @property
    def covariance(self) -> Array:
        """(r, r) of the coefficients; inf on the diagonal where nothing shows one."""
        normal, lost = self._normal_equations()
        return covariance_of(normal.hessian - lost)[0] + self._identified.beyond_precision

    @property
    def effective_samples(self) -> Array:
        """(n,) sum of the weights of each joint's samples in motion, over their autocorrelation time."""
        return self._moments.weight / self._noise.autocorrelation

    def model(self) -> IdentifiedModel:
        """The model with the best parameters in the cone: to predict, to validate, or to track on.

        Its noise remains that of the given model.

        Raises:
            InputError: there are no samples in motion yet.
            SolverError: Clarabel failed.
        """
        self._check_not_empty()
        given, (normal, lost) = self._identified, self._normal_equations()
        cone, coefficients = given.model.cone, self._moments.coefficients
        theta = solve_precisely(cone, coefficients, normal.hessian, normal.gradient, normal.energy).theta
        precision = normal.hessian - lost
        return replace(given, theta=theta, noise=self._noise, precision=precision, draws=None, listed=())

    def check_signs(self, search: Search = Certified()) -> SignCheck:
        """Searches the signs of the stream again, and lists segments whose sign differs from the one used.

        The model's own log does not count.

        Raises:
            InputError: there are no samples in motion yet.
            SolverError: an optimisation failed.
        """
        self._check_not_empty()
        return check_signs(self._moments, self._weights, search)

    @property
    def _noise(self) -> Noise:
        """The model's, its autocorrelation time in samples of the stream."""
        moments, noise = self._moments, self._identified.noise
        return noise.with_time_of_model(moments.steps / moments.span) if moments.steps else noise

    @property
    def _weights(self) -> Array:
        """(n,) sd of the noise, N m, inflated so that only effective samples count."""
        return np.asarray(self._noise.sigma * np.sqrt(self._noise.autocorrelation))

    def _normal_equations(self) -> tuple[InformationMatrix, Array]:
        """Normal equations of stream and earlier log, rows in units of their noise, and information to subtract.

        The latter (r, r) is lost to uncertain signs: |effort| has at least a share E[(E s)^2] of the information of the
        effort, whatever its size in units of the noise (tests/monitor).
        """
        earlier, weights, moments = self._earlier_information(), self._weights, self._moments
        centre = moments.coefficients.project(self._identified.theta)
        hessian, gradient, energy = earlier.copy(), earlier @ centre, float(centre @ earlier @ centre)
        for (joint, _), segment in moments.segments.items():
            weight = weights[joint] ** -2.0
            hessian += weight * segment.hessian
            gradient += weight * segment.gradient
            energy += float(weight * segment.energy)
        return InformationMatrix(hessian, gradient, energy), np.tensordot(weights**-2.0, moments.lost, 1)

    def _earlier_information(self) -> Array:
        """(r, r) of the model's own log, with the weight that is left of it; zero if it does not count."""
        precision, moments = self._identified.precision, self._moments
        if not self._earlier:
            return np.zeros_like(precision)
        return moments.fade(moments.time - moments.began if np.isfinite(moments.time) else 0.0) * precision

    def _check_not_empty(self) -> None:
        if not self._moments.weight.any():
            raise InputError("no sample in motion yet", "RecursiveEstimator", "add chunks of the stream first")

    def _check_motion(self, motion: Motion) -> None:
        robot, last = self._moments.model.robot, self._moments.last
        if motion.n_joints != robot.n_joints:
            counts = f"{motion.n_joints} joints, but the model's robot {robot.name} has {robot.n_joints}"
            raise InputError(counts, "motion", "give the motion of the same robot")
        if len(motion) and not motion.t[0] > last:
            problem = f"begins at {motion.t[0]:.6g} s, but the previous chunk ends at {last:.6g} s"
            raise InputError(problem, "motion", "give chunks in the order of time, each sample once")
        for k in np.flatnonzero(np.diff(motion.t) <= 0.0)[:1]:
            problem = f"time goes from {motion.t[k]:.6g} to {motion.t[k + 1]:.6g} s"
            raise InputError(problem, f"motion, sample {k + 1}", "give samples in the order of time, each once")
        check_payloads(self._moments.model, motion)


def _checked(values: object, shape: tuple[int, ...], name: str) -> Array:
    remedy = f"give {shape[0]} samples of {shape[1]} joints, as in the motion"
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError("holds values that are not numbers", name, remedy) from None
    if array.shape != shape:
        raise InputError(f"values of shape {array.shape}", name, remedy)
    bad = np.argwhere(~np.isfinite(array))
    if bad.size:
        where = f"{name}, sample {bad[0, 0]}, joint {bad[0, 1] + 1}"
        raise InputError("holds values that are not finite", where, "leave these samples out")
    return array


def _least_squares(normal: InformationMatrix, start: Array) -> Array:
    """(r,) the solution of H beta = g that is nearest to a start (r,), in columns of unit length."""
    lengths = np.sqrt(np.diag(normal.hessian))
    scale = np.divide(1.0, lengths, out=np.zeros_like(lengths), where=lengths > 0.0)
    scaled, slope = scale[:, None] * normal.hessian * scale, scale * (normal.gradient - normal.hessian @ start)
    step: Array = scale * np.linalg.lstsq(scaled, slope, rcond=1e-12)[0]
    return start + step
