"""Where the links of a robot are, for many positions of its joints at once, and the distances between lines on them."""

from __future__ import annotations

import numpy as np

from bayesid.arrays import TINY, Array
from bayesid.robot import Robot

_PARALLEL = 1e-12
"""Squared sine of an angle below which two lines count as parallel. The nearest of their ends are then off by the angle
times a length, a micrometre a metre; of lines at a larger angle, rounding leaves the crossing good to a part in 10^4,
which enters the distance squared."""


class LinkFrames:
    """Frames of a robot's links in the base's; that of the joint, not of a Denavit-Hartenberg table.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: Robot) -> None:
        n = robot.n_joints
        self._parents = [joint.parent for joint in robot.joints]
        self._fixed, self._linear, self._cosine = np.zeros((3, n, 4, 4))
        for k, joint in enumerate(robot.joints):
            x, y, z = joint.axis
            cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            self._fixed[k] = joint.placement
            if joint.prismatic:
                self._linear[k, :3, 3] = joint.placement[:3, :3] @ joint.axis
            else:  # Rodrigues: 1 + sin q K + (1 - cos q) K^2
                self._fixed[k, :3, :3] = joint.placement[:3, :3] @ (np.eye(3) + cross @ cross)
                self._linear[k, :3, :3] = joint.placement[:3, :3] @ cross
                self._cosine[k, :3, :3] = -joint.placement[:3, :3] @ cross @ cross
        self._slides = np.array([joint.prismatic for joint in robot.joints])

    def __call__(self, q: Array) -> Array:
        """(N, n + 1, 4, 4) of the links, that of the base last, so that its index is -1.

        Args:
            q: (N, n) positions of the joints, rad or m.
        """
        linear = np.where(self._slides, q, np.sin(q))[:, :, None, None]
        steps = self._fixed + linear * self._linear + np.cos(q)[:, :, None, None] * self._cosine
        frames = np.empty((len(q), q.shape[1] + 1, 4, 4))
        frames[:, -1] = np.eye(4)
        for k, parent in enumerate(self._parents):
            np.matmul(frames[:, parent], steps[:, k], out=frames[:, k])
        return frames


def line_distances(starts: Array, ends: Array, one: Array, other: Array) -> Array:
    """(N, P) distances between pairs of lines, m.

    The least squared distance of two lines s and t from 0 to 1 is that where they cross, or one at an end of one of
    them (Ericson, Real-Time Collision Detection, 2005, section 5.1.9).

    Args:
        starts: (N, S, 3) of lines.
        ends: (N, S, 3) of lines.
        one: (P,) indices of lines.
        other: (P,) indices of lines.
    """
    way = ends - starts
    u, v, w = way[:, one], way[:, other], starts[:, one] - starts[:, other]
    squares = np.einsum("nsi,nsi->ns", way, way)
    uu, vv = squares[:, one], squares[:, other]
    uv, uw, vw, ww = (np.einsum("npi,npi->np", a, b) for a, b in ((u, v), (u, w), (v, w), (w, w)))
    over_u, over_v = 1.0 / np.maximum(uu, TINY), 1.0 / np.maximum(vv, TINY)

    def squared(s: Array, t: Array) -> Array:
        return ww + s * (s * uu + 2.0 * uw) + t * (t * vv - 2.0 * vw) - 2.0 * s * t * uv

    s0, s1 = np.clip(-uw * over_u, 0.0, 1.0), np.clip((uv - uw) * over_u, 0.0, 1.0)
    t0, t1 = np.clip(vw * over_v, 0.0, 1.0), np.clip((uv + vw) * over_v, 0.0, 1.0)
    least = ww + s0 * (s0 * uu + 2.0 * uw)
    np.minimum(least, squared(s1, np.ones_like(s1)), out=least)
    np.minimum(least, ww + t0 * (t0 * vv - 2.0 * vw), out=least)
    np.minimum(least, squared(np.ones_like(t1), t1), out=least)
    cross = uu * vv - uv**2
    crosses = cross > _PARALLEL * uu * vv
    over = 1.0 / np.where(crosses, cross, 1.0)
    s, t = (uv * vw - uw * vv) * over, (uu * vw - uv * uw) * over
    crosses &= (s > 0.0) & (s < 1.0) & (t > 0.0) & (t < 1.0)
    np.minimum(least, np.where(crosses, squared(s, t), least), out=least)
    return np.sqrt(np.maximum(least, 0.0))
