"""Identification that goes on while the robot runs: moments add, so every chunk of a stream costs one update."""

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
    """A running identification: chunks of a stream go in, coefficients with their uncertainty come out at any time.

    The model's terms, its noise and the autocorrelation of that are taken from an identification; rows are weighted and
    samples counted as its least squares do. A sign need not be certain: its expectation takes its place, and a row then
    tells less. How the stream is cut into chunks changes nothing. Memory and the work of a chunk stay the same however
    long the stream is. It can be pickled, and goes on to the digit.

    Args:
        model: an `IdentifiedModel`, as of `bayesid.load`, or an `Identification`.
        forget: time constant, s, by which what has come counts less and less, exp(-dt / forget), and with it the number
            of samples: the sd is that of the samples which count, as if nothing had changed while they do. Nothing is
            forgotten by default.
        earlier: whether what the model's own log has shown of its coefficients counts too, as if it had come before the
            first chunk. Without it, coefficients of which the stream shows nothing keep the model's values, with an
            infinite sd.
        signed: (n,) joints whose efforts have signs; none by default.
        most_individual: stretches of constant sign that are kept by themselves in each joint, those whose signs are
            most in doubt, some 10 kB each; `check_signs` can turn each of them, the others of a joint only together.

    Raises:
        InputError: the model, `forget`, `signed` or `most_individual` cannot be used.

    Example:
        >>> running = bayesid.RecursiveEstimator(result.identified, forget=60.0)
        >>> sure = result.probability  # or what a tracker says, chunk by chunk
        >>> for part in (slice(0, 100), slice(100, 301)):
        ...     running.add(result.signals.motion[part], result.signals.raw_effort[part], sure[part])
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
            raise InputError(f"{most_individual} stretches", "most_individual", "give 0 or a whole number above")
        self._identified, self._earlier = identified, earlier
        self._running = StreamMoments(
            model=identified.model,
            coefficients=base_coefficients(identified.model),
            sigma=identified.noise.sigma,
            forget=np.inf if forget is None else float(forget),
            signed=signed_joints(signed, identified.model.robot.n_joints),
            most_individual=most_individual,
        )

    def __repr__(self) -> str:
        robot, running = self._identified.model.robot, self._running
        came = f"{running.time - running.began:.6g} s" if np.isfinite(running.time) else "nothing yet"
        count = ", ".join(f"{count:.0f}" for count in self.effective_samples)
        return f"RecursiveEstimator of {robot.name}: {came}; effective samples of each joint {count}"

    def add(self, motion: Motion, effort: Array, probability: Array, moving: Mask | None = None) -> None:
        """Takes one more chunk of the stream; where it cannot be used, nothing has changed.

        What a tracker says goes in by `add_tracked`; other chunks come with a motion as `Signals.motion`.

        Of a model whose effects remember (`delay`, `hysteresis`) the last 16 samples wait for the next chunk, and every
        chunk makes the columns of the 4096 samples before it again: give it long ones.

        Args:
            motion: N samples of n joints, later than all before, s, rad, rad/s, rad/s^2.
            effort: (N, n) |effort|, N m, read by the model's gains; with its sign in joints that have one.
            probability: (N, n) P(sign = +); not looked at in joints that have signs. A sign in doubt though |effort| is
                far from zero, as before a tracker has found its way, draws coefficients towards zero: leave it out.
            moving: (N, n) samples that count. By default those of actuators faster than a hundredth of their highest
                speed so far: where a stream begins at a standstill, say so. Of a tracker, where its state is "moving".

        Raises:
            InputError: joints, shapes or values do not suit, or time does not go on.
        """
        running = self._running
        self._check_motion(motion)
        values, of_plus = (
            _checked(given, motion.q.shape, name) for given, name in ((effort, "effort"), (probability, "probability"))
        )
        if np.any((of_plus < 0.0) | (of_plus > 1.0)):
            raise InputError("holds values outside of 0 to 1", "probability", "give P(sign = +)")
        if len(motion) == 0:
            return
        speed = running.model.robot.actuators(motion).dq
        top = np.maximum.accumulate(np.vstack([running.top_speed, np.abs(speed)]))[1:]
        fast = np.abs(speed) > STANDSTILL * np.maximum(top, SLOWEST)
        used = fast if moving is None else _checked(moving, motion.q.shape, "moving") > 0.0
        magnitude, readable = running.model.invert_sensor(np.abs(values))
        sign = np.where(running.signed, np.where(values >= 0.0, 1.0, -1.0), 2.0 * of_plus - 1.0)
        own = {"speed": speed, "magnitude": magnitude, "sign": sign, "used": used & readable}
        of_motion = {name: getattr(motion, name) for name in ("t", "q", "dq", "ddq", "payload")}
        running.add(of_motion | own, motion.origin)
        running.top_speed = top[-1]

    def add_tracked(self, records: Iterable[TrackedSample], payload: str = "") -> None:
        """Takes what a tracker has said, record by record: its motion and signs, where its joints are "moving".

        Records that brought nothing new or know nothing yet are left out, and efforts that were not read.

        Args:
            records: of a `SignTracker`, in their order, each once; long chunks are faster than many.
            payload: label of what the flange carries, as the tracker was given it.

        Raises:
            InputError: joints do not suit, time does not go on, as after a clock was set back, or the model knows no
                payload of this label.
        """
        known = [one for one in records if one.known]
        if not known:
            return
        t, q, dq, ddq, effort, probability = (
            np.array([getattr(one, name) for one in known]) for name in ("t", "q", "dq", "ddq", "effort", "probability")
        )
        moving = (np.array([one.state for one in known]) == MOVING) & np.isfinite(effort)
        motion = Motion(t, q, dq, ddq, payload=np.array(payload))
        self.add(motion, np.nan_to_num(effort), probability, moving)

    def coefficients(self) -> Records[Coefficient]:
        """The base coefficients from all that came, one record each: to iterate over, or `.to_dataframe()`.

        By weighted least squares without the cone; `model()` has the parameters in it. `sd` counts effective samples,
        less for signs in doubt, and what the model may lack or its gains leave open. With `earlier`, `prior_sd` is the
        sd by the model's own log alone, which counts the same, and `decided_by` is "earlier log" where that log has
        more than a tenth of the information; "prior" where nothing shows a coefficient.
        """
        known, (normal, lost) = self._running.coefficients, self._normal()
        beta = _least_squares(normal, known.project(self._identified.theta))
        now, before = (np.diag(covariance_of(one)[0]) for one in (normal.hessian - lost, self._shown_before()))
        of_data, of_earlier = now <= POSTERIOR_TUNING.of_prior * before, np.isfinite(before)
        decided = np.select([~np.isfinite(now), of_data, of_earlier], [_BY_PRIOR, _BY_DATA, _BY_EARLIER], _BY_PRIOR)
        more = np.diag(self._identified.beyond_precision)
        sd, told = np.sqrt(now + more), np.sqrt(np.where(of_earlier, before + more, np.nan))
        numbers = np.stack([beta, sd, beta - NORMAL_95 * sd, beta + NORMAL_95 * sd]).tolist()
        stated = [np.nan] * len(known)
        columns = known.names, known.expressions, known.units, *numbers, decided.tolist(), told.tolist(), stated
        return Records(Coefficient, (Coefficient(*row) for row in zip(*columns, strict=True)))

    def coefficient(self, name: str) -> Coefficient:
        """A base coefficient by its name; InputError with near names where there is none."""
        return named(self.coefficients(), name, "coefficient")

    @property
    def covariance(self) -> Array:
        """(r, r) of the coefficients; inf on the diagonal where nothing shows one."""
        normal, lost = self._normal()
        return covariance_of(normal.hessian - lost)[0] + self._identified.beyond_precision

    @property
    def effective_samples(self) -> Array:
        """(n,) samples in motion of each joint that count: less those forgotten, over their autocorrelation time."""
        return self._running.weight / self._noise.autocorrelation

    def model(self) -> IdentifiedModel:
        """The model with the best parameters in the cone for all that came: to predict, to validate, or to track on.

        Its noise is still that of the model before.

        Raises:
            InputError: nothing has come yet.
            SolverError: Clarabel failed.
        """
        self._check_begun()
        before, (normal, lost) = self._identified, self._normal()
        cone, coefficients = before.model.cone, self._running.coefficients
        theta = solve_precisely(cone, coefficients, normal.hessian, normal.gradient, normal.energy).theta
        known = normal.hessian - lost
        return replace(before, theta=theta, noise=self._noise, precision=known, draws=None, listed=())

    def check_signs(self, search: Search = Certified()) -> SignCheck:
        """Searches the signs of all that came but for the model's own log, and says which of those taken differ.

        Raises:
            InputError: nothing has come yet.
            SolverError: an optimisation failed.
        """
        self._check_begun()
        return check_signs(self._running, self._weights, search)

    @property
    def _noise(self) -> Noise:
        """The model's, its autocorrelation time in samples of the stream."""
        running, noise = self._running, self._identified.noise
        return noise.with_time_of_model(running.steps / running.span) if running.steps else noise

    @property
    def _weights(self) -> Array:
        """(n,) sd of the noise, N m, as if only every effective sample counted."""
        return np.asarray(self._noise.sigma * np.sqrt(self._noise.autocorrelation))

    def _normal(self) -> tuple[InformationMatrix, Array]:
        """The normal equations of all that came and of what was known before, rows in units of their noise.

        And (r, r) what their Hessian says too much as long as signs are not certain: |effort| tells at least E[(E s)^2]
        of what the effort would, whatever that is in units of its noise (tests/monitor).
        """
        before, weights, running = self._shown_before(), self._weights, self._running
        centre = running.coefficients.project(self._identified.theta)
        hessian, gradient, energy = before.copy(), before @ centre, float(centre @ before @ centre)
        for (joint, _), stretch in running.stretches.items():
            weight = weights[joint] ** -2.0
            hessian += weight * stretch.hessian
            gradient += weight * stretch.gradient
            energy += float(weight * stretch.energy)
        return InformationMatrix(hessian, gradient, energy), np.tensordot(weights**-2.0, running.lost, 1)

    def _shown_before(self) -> Array:
        """(r, r) what the model's own log has shown, if that is to count, as far as it is not forgotten."""
        precision, running = self._identified.precision, self._running
        if not self._earlier:
            return np.zeros_like(precision)
        return running.fade(running.time - running.began if np.isfinite(running.time) else 0.0) * precision

    def _check_begun(self) -> None:
        if not self._running.weight.any():
            raise InputError("no sample in motion has come yet", "RecursiveEstimator", "add chunks of the stream first")

    def _check_motion(self, motion: Motion) -> None:
        """A chunk's motion is of this robot and goes on where the one before has ended."""
        robot, last = self._running.model.robot, self._running.last
        if motion.n_joints != robot.n_joints:
            counts = f"{motion.n_joints} joints, but the model's robot {robot.name} has {robot.n_joints}"
            raise InputError(counts, "motion", "give the motion of the same robot")
        if len(motion) and not motion.t[0] > last:
            said = f"begins at {motion.t[0]:.6g} s, not after the chunk before, which ends at {last:.6g} s"
            raise InputError(said, "motion", "give chunks in the order of time, each sample once")
        for k in np.flatnonzero(np.diff(motion.t) <= 0.0)[:1]:
            said = f"time goes from {motion.t[k]:.6g} to {motion.t[k + 1]:.6g} s"
            raise InputError(said, f"motion, sample {k + 1}", "give samples in the order of time, each once")
        check_payloads(self._running.model, motion)


def _checked(values: object, shape: tuple[int, ...], name: str) -> Array:
    remedy = f"give {shape[0]} samples of {shape[1]} joints, as the motion has"
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError("holds something else than numbers", name, remedy) from None
    if array.shape != shape:
        raise InputError(f"values of shape {array.shape}", name, remedy)
    bad = np.argwhere(~np.isfinite(array))
    if bad.size:
        where = f"{name}, sample {bad[0, 0]}, joint {bad[0, 1] + 1}"
        raise InputError("holds values that are not finite", where, "leave these samples out")
    return array


def _least_squares(normal: InformationMatrix, start: Array) -> Array:
    """(r,) the coefficients that solve H beta = g and are nearest to a start (r,), in columns of unit length.

    Where H shows nothing they stay as they were.
    """
    lengths = np.sqrt(np.diag(normal.hessian))
    scale = np.divide(1.0, lengths, out=np.zeros_like(lengths), where=lengths > 0.0)
    scaled, slope = scale[:, None] * normal.hessian * scale, scale * (normal.gradient - normal.hessian @ start)
    step: Array = scale * np.linalg.lstsq(scaled, slope, rcond=1e-12)[0]
    return start + step
