"""Other packages for a log with signs, by their own interfaces: figaroh and mujoco.sysid (extra `bench`).

Both get the robot as a file written by bayesid, with a typical link in every body, and the same filtered motion,
efforts and rows as all methods. Their parameters are converted to bayesid's.
"""

from __future__ import annotations

import contextlib
import io
import logging
import tempfile
import warnings
from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from bayesid.arrays import Array
from bayesid.effects.coefficients import BaseCoefficients, base_coefficients
from bayesid.effects.model import Model
from bayesid.errors import SolverError
from bayesid.export import mjcf, urdf
from bayesid.regression.knowledge import LinkPrior
from bayesid.robot.inertia import change_of_frame
from bayesid.studies.benchmarks.peer_methods import Answer, Method, Recording, timed

_TO_OURS = np.array([4, 5, 7, 6, 8, 9, 1, 2, 3, 0])
"""Indices of Jxx, Jxy, Jxz, Jyy, Jyz, Jzz, mcx, mcy, mcz, m in Pinocchio's m, mc, Ixx, Ixy, Iyy, Ixz, Iyz, Izz."""
_INERTIAL = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
_JOINT = {"fv": "Fv", "fs": "Fc", "Ia": "Ia", "off": "offset"}
"""figaroh's names of joint parameters to ours."""
_BY_SYSID = 200
"""Largest number of time steps that mujoco.sysid fits, evenly spread: a step takes one pass per parameter."""
_OF_SYSID = ("mujoco", "absl", "colorama", "imageio", "jinja2", "plotly", "tabulate", "yaml")
"""Modules of mujoco[sysid]."""
_STEPS = 25
"""Of its optimiser."""
_WIDE = np.array([0.01, 100.0])
"""Bounds of a mass and of a body's stretch, relative to the typical link's."""
_FAR = 1.0
"""Bound of a centre of mass, m, and of a shear."""
_OF_JOINT = (0.1, 3.0)
"""Start and bound of friction and armature, relative to the value that alone explains the joint's effort."""


def installed(package: str) -> str:
    """Version of a package; empty if it, or a requirement of mujoco.sysid, is not installed."""
    needed = _OF_SYSID if package == "mujoco.sysid" else (package,)
    return version(package.partition(".")[0]) if all(map(find_spec, needed)) else ""


def _typical_links(model: Model) -> Array:
    """(P,) parameters of a typical link in every body; others are zero."""
    theta = np.zeros(model.cone.size)
    for body in model.cone.bodies:
        theta[body] = LinkPrior().centre
    return theta


def _answer(model: Model, coefficients: BaseCoefficients, theta: Array) -> Answer:
    """The result of parameters (P,), without intervals."""
    beta = coefficients.project(theta)
    none = np.full((2, len(beta)), np.nan)
    return Answer(model, coefficients, beta, none, lambda motion: model.columns(motion) @ theta, theta, 0.0)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Suppresses output, logs and warnings of the packages."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        try:
            yield
        finally:
            logging.disable(before)


# ---------------------------------------------------------------------------------------------------------------
# figaroh
# ---------------------------------------------------------------------------------------------------------------
_CONFIG = """
robot:
  name: arm
  properties:
    joints:
      active_joints: [{joints}]
tasks:
  identification:
    enabled: true
    problem:
      model_components: {{friction: true, joint_offset: true, actuator_inertia: true}}
    coupling: {{has_coupled_wrist: false}}
    signal_processing: {{sampling_frequency: {rate}, cutoff_frequency: {cutoff}}}
    select_stage: physical_fit
    physical_fit: {{enabled: true}}
"""


def _figaroh(recording: Recording, place: Path) -> Any:
    """A solved `BaseIdentification`: its regressor, weighted least squares and physical fit, on our rows.

    figaroh is used by a subclass for every robot. This one converts rows to coupled motors, as figaroh's example for
    the TX40 does, and sets unused rows to zero: its weights need equal numbers of rows of all joints.
    """
    base = import_module("figaroh.identification").BaseIdentification
    model, motion, used = recording.model, recording.motion, recording.used
    arm, width = model.robot, len(str(model.robot.n_joints))
    names = [f"joint{j:0{width}d}" for j in range(1, arm.n_joints + 1)]
    (place / "arm.urdf").write_text(urdf(model, _typical_links(model)), encoding="utf-8")
    rate, cutoff = recording.signals.rate, recording.signals.cutoff
    (place / "arm.yaml").write_text(_CONFIG.format(joints=", ".join(names), rate=rate, cutoff=cutoff), encoding="utf-8")
    robot = import_module("figaroh.tools.robot").create_robot(str(place / "arm.urdf"), str(place))
    robot.model.gravity.linear = np.array(arm.gravity)
    size, n = len(motion), arm.n_joints

    class Identification(base):  # type: ignore[misc, valid-type]
        dynamic_regressor: Any

        def load_trajectory_data(self, data_source: str | None = None) -> dict[str, Array]:
            """The filtered motion and unfiltered efforts."""
            kinematics = {"positions": motion.q, "velocities": motion.dq, "accelerations": motion.ddq}
            return {"timestamps": motion.t, **kinematics, "torques": recording.signals.raw_effort * used}

        def process_kinematics_data(self, filter_config: object = None) -> None:
            """Does nothing: the motion is filtered."""
            self.processed_data = dict(self.raw_data)

        def calculate_full_regressor(self) -> None:
            """Rows of motors, which may be coupled."""
            super().calculate_full_regressor()
            full = np.array(self.dynamic_regressor).reshape(n, size, -1)
            full[:, :, : 10 * n] = np.einsum("ji,jsp->isp", np.linalg.inv(arm.coupling), full[:, :, : 10 * n])
            motors = arm.actuators(motion)
            for j in range(n):
                dq, ddq = motors.dq[:, j], motors.ddq[:, j]
                full[j][:, 10 * n + j :: n] = np.stack([dq, np.sign(dq), ddq, np.ones(size)], axis=1)
            self.dynamic_regressor = (full * used.T[:, :, None]).reshape(n * size, -1)

    identification = Identification(robot, str(place / "arm.yaml"))
    identification.identif_config |= {"act_idxq": list(range(n)), "act_idxv": list(range(n))}
    identification.initialize()
    identification.solve(decimate=False, plotting=False, wls=True)
    return identification


def _of_figaroh(recording: Recording, identification: Any, values: Array) -> Answer:
    """The result of its standard parameters."""
    model = recording.model
    named = dict(zip(identification.standard_parameter, values, strict=True))
    theta = np.zeros(model.cone.size)
    ours = {parameter.name: k for k, parameter in enumerate(model.parameters)}
    for j, (joint, name) in enumerate(zip(model.robot.joints, identification.model.names[1:], strict=True), start=1):
        in_joint = np.array([named[f"{key}_{name}"] for key in _INERTIAL])[_TO_OURS]
        to_joint = change_of_frame(joint.link_frame[:3, :3], joint.link_frame[:3, 3])
        theta[model.cone.bodies[j - 1]] = np.linalg.solve(to_joint, in_joint)
        for theirs, key in _JOINT.items():
            theta[ours[f"{key}{j}"]] = named[f"{theirs}_{name}"]
    return _answer(model, base_coefficients(model), theta)


@timed
def figaroh_feasible(recording: Recording) -> Answer:
    """Its `physical_fit`: weighted least squares with feasible links, without other constraints."""
    with _quiet(), tempfile.TemporaryDirectory() as place:
        identification = _figaroh(recording, Path(place))
        selected = identification.selected
    if selected.values is None:
        raise SolverError("figaroh's physical_fit", selected.reason)
    return _of_figaroh(recording, identification, np.asarray(selected.values))


@timed
def figaroh_weighted(recording: Recording) -> Answer:
    """Its base parameters by weighted least squares; parameters of eliminated columns are zero."""
    with _quiet(), tempfile.TemporaryDirectory() as place:
        identification = _figaroh(recording, Path(place))
    size = len(identification.standard_parameter)
    values, dropped = np.zeros(size), set(identification._idx_eliminated)
    kept = np.array([k for k in range(size) if k not in dropped])
    values[kept[np.asarray(identification._base_indices)]] = identification.phi_base
    return replace(_of_figaroh(recording, identification, values), theta=None)


# ---------------------------------------------------------------------------------------------------------------
# mujoco.sysid
# ---------------------------------------------------------------------------------------------------------------
@timed
def mujoco_sysid(recording: Recording) -> Answer:
    """Its optimiser over links (log-Cholesky), damping, dry friction, armature and offsets, on inverse dynamics.

    Its own residual simulates the motion from controls, which diverges within a second without the controller. MuJoCo's
    inverse dynamics replace this simulation.
    """
    with _quiet():
        sysid, mujoco = import_module("mujoco.sysid"), import_module("mujoco")
        fit = _Sysid(sysid, mujoco, recording)
        found, _ = sysid.optimize(fit.parameters(), fit.residual, "mujoco", max_iters=_STEPS)
        return _answer(recording.model, base_coefficients(recording.model), fit.theta(found))


class _Sysid:
    """Parameters and residuals for `mujoco.sysid.optimize`.

    Args:
        sysid: the package.
        mujoco: the package.
        recording: to be fitted.
    """

    def __init__(self, sysid: Any, mujoco: Any, recording: Recording) -> None:
        self._sysid, self._mujoco, self._model = sysid, mujoco, recording.model
        self._text = mjcf(self._model, _typical_links(self._model))
        motion, used = recording.motion, recording.used
        rows = np.unique(np.linspace(0, len(motion) - 1, _BY_SYSID).astype(int))
        self._motion, self._used, self._effort = motion[rows], used[rows], recording.signals.raw_effort[rows]
        self._sigma = np.sqrt((recording.signals.raw_effort**2 * used).sum(axis=0) / used.sum(axis=0))
        self._names = [f"{j:0{len(str(motion.n_joints))}d}" for j in range(1, motion.n_joints + 1)]
        self._on_joint = np.count_nonzero(self._model.robot.coupling, axis=1) == 1

    def _spec(self) -> Any:
        """The robot with typical links; MuJoCo may correct a flat body that is infeasible by rounding."""
        spec = self._mujoco.MjSpec.from_string(self._text)
        spec.compiler.balanceinertia = True
        return spec

    def parameters(self) -> Any:
        """Links, and joint parameters scaled by the joint's effort."""
        sysid, spec = self._sysid, self._spec()
        compiled, parameters = spec.compile(), sysid.ParameterDict()
        bounds = {"mass_bound_mult": _WIDE, "stretch_bound_mult": _WIDE}
        far, motors, most_offset = np.array([-_FAR, _FAR]), self._model.robot.actuators(self._motion), _OF_JOINT[1]
        for name in self._names:
            parameters.add(
                sysid.body_inertia_param(
                    spec,
                    compiled,
                    f"link{name}",
                    sysid.InertiaType.Pseudo,
                    ipos_bound_off=far,
                    shear_bound_off=far,
                    modifier=_body_modifier(sysid, f"link{name}"),
                    **bounds,
                )
            )
        for j, name in enumerate(self._names):
            size = float(self._sigma[j])
            for key, unit in {
                "damping": motors.dq,
                "frictionloss": np.ones_like(motors.q),
                "armature": motors.ddq,
            }.items():
                start, most = np.array(_OF_JOINT) * size / float(np.sqrt(np.mean(unit[:, j] ** 2)))
                parameters.add(sysid.Parameter(f"{key}{name}", start, 0.0, most, modifier=self._modifier(j, key)))
            parameters.add(sysid.Parameter(f"offset{name}", 0.0, -most_offset * size, most_offset * size))
        return parameters

    def _modifier(self, j: int, key: str) -> Any:
        """Function that sets a number of the motor's joint, or of its tendon if it moves several joints."""
        name, on_joint = self._names[j], bool(self._on_joint[j])

        def modify(spec: Any, parameter: Any) -> None:
            element = spec.joint(f"joint{name}") if on_joint else spec.tendon(f"motor{name}")
            old = getattr(element, key)
            if np.ndim(old):
                old[0] = parameter.value[0]
            else:
                setattr(element, key, float(parameter.value[0]))

        return modify

    def residual(self, x: Array, parameters: Any) -> tuple[list[Array], list[Array], list[Array]]:
        """Residuals relative to each joint's RMS effort, of one vector of parameters or of several in columns."""
        columns = []
        for vector in np.atleast_2d(x.T):
            parameters.update_from_vector(vector)
            predicted = self._inverse_dynamics(parameters)
            columns.append(((predicted - self._effort) / self._sigma)[self._used])
        of_all = np.array(columns).T
        return [of_all[:, 0] if x.ndim == 1 else of_all], [], []

    def _inverse_dynamics(self, parameters: Any) -> Array:
        """(N, n) efforts of the motors."""
        model = self._sysid.apply_param_modifiers(parameters, self._spec())
        data, motion = self._mujoco.MjData(model), self._motion
        order = [model.joint(f"joint{name}").qposadr[0] for name in self._names]
        torque = np.empty(motion.q.shape)
        for k in range(len(motion)):
            data.qpos[order], data.qvel[order], data.qacc[order] = motion.q[k], motion.dq[k], motion.ddq[k]
            self._mujoco.mj_inverse(model, data)
            torque[k] = data.qfrc_inverse[order]
        offset = np.array([parameters[f"offset{name}"].value[0] for name in self._names])
        return torque @ np.linalg.inv(self._model.robot.coupling) + offset

    def theta(self, parameters: Any) -> Array:
        """(P,) parameters in our order."""
        model = self._model
        compiled = self._sysid.apply_param_modifiers(parameters, self._spec())
        places = {parameter.name: k for k, parameter in enumerate(model.parameters)}
        theta = np.zeros(model.cone.size)
        ours = {"damping": "Fv", "frictionloss": "Fc", "armature": "Ia", "offset": "offset"}
        for j, (joint, name) in enumerate(zip(model.robot.joints, self._names, strict=True)):
            to_joint = change_of_frame(joint.link_frame[:3, :3], joint.link_frame[:3, 3])
            theta[model.cone.bodies[j]] = np.linalg.solve(to_joint, _ten(compiled.body(f"link{name}")))
            for theirs, key in ours.items():
                theta[places[f"{key}{j + 1}"]] = parameters[f"{theirs}{name}"].value[0]
        return theta


def _body_modifier(sysid: Any, name: str) -> Any:
    """Modifier of sysid with an identity orientation of the inertia, which MuJoCo 4.0 requires."""

    def modify(spec: Any, parameter: Any) -> None:  # a function, since deepcopy does not copy functions
        sysid.apply_body_inertia(spec, name, parameter)
        spec.body(name).iquat[:] = (1.0, 0.0, 0.0, 0.0)

    return modify


def _ten(body: Any) -> Array:
    """(10,) parameters of a compiled body about its frame."""
    mass, centre = float(body.mass[0]), np.asarray(body.ipos)
    axes = Rotation.from_quat(np.roll(body.iquat, -1)).as_matrix()
    inertia = axes * np.asarray(body.inertia) @ axes.T + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return np.concatenate([inertia[np.triu_indices(3)], mass * centre, [mass]])


def packages() -> dict[str, Method]:
    """The methods of the packages that are installed."""
    found: dict[str, Method] = {}
    if installed("figaroh"):
        found |= {"figaroh, weighted": figaroh_weighted, "figaroh, physical fit": figaroh_feasible}
    if installed("mujoco.sysid"):
        found["mujoco.sysid"] = mujoco_sysid
    return found
