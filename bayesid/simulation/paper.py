"""The robot of Gaz and De Luca, "Identification of Robot Dynamics from Motor Currents/Torques with Unknown Signs".

Table I, the Denavit-Hartenberg table of a KUKA KR5 Sixx R650, is the built-in robot `kr5`. Table II lists 27 dynamic
coefficients of it, with the values simulated and those estimated without signs. Its wrapped lines are put right
here: each of the 27 lies in the row space of the robot's regressor.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources

import numpy as np

from bayesid.arrays import Array, frozen
from bayesid.effects import RigidBody
from bayesid.effects.model import Model
from bayesid.robot import load_robot
from bayesid.robot.inertia import NAMES

_N_LINKS = 6
_A1, _A2, _A3, _D4, _D6 = 0.075, 0.27, 0.09, -0.295, -0.08
"""The lengths of Table I that Table II needs, m; the same numbers as in robots/kr5.toml."""


@dataclass(frozen=True)
class TableRow:
    """One line of Table II.

    Attributes:
        number: its number in the table.
        expression: the coefficient as printed, squares written ^2, M_i = m_i + ... + m_6.
        weights: weight of each parameter in it, named as in `RigidBody` or M1 ... M6 for a sum of masses.
        nominal: the value simulated, SI units.
        published: the paper's estimate without signs, SI units.
    """

    number: int
    expression: str
    weights: Mapping[str, float]
    nominal: float
    published: float

    @property
    def row(self) -> Array:
        """(60,) weights of the standard parameters, in the order of `paper_model().parameters`."""
        row = np.zeros((_N_LINKS, len(NAMES)))
        for name, weight in self.weights.items():
            stem, link, axes = _parts(name)
            if stem == "M":
                row[link - 1 :, NAMES.index("m")] += weight
            else:
                row[link - 1, NAMES.index(stem + axes)] += weight
        return row.ravel()


def _parts(name: str) -> tuple[str, int, str]:
    """J2xx is ("J", 2, "xx"), m3 is ("m", 3, "")."""
    stem = name.rstrip("xyz")
    return stem[:-1], int(stem[-1]), name[len(stem) :]


TABLE_II: tuple[TableRow, ...] = (
    TableRow(
        1,
        "J1yy + J2yy + J3zz + a1^2 m1 + (a1^2 - a2^2) m2 + (a1^2 - a2^2 - a3^2) M3 + 2 a1 mc1x",
        {"J1yy": 1, "J2yy": 1, "J3zz": 1, "M1": _A1**2, "M2": -(_A2**2), "M3": -(_A3**2), "mc1x": 2 * _A1},
        1.7961,
        1.8352,
    ),
    TableRow(2, "J2xx - J2yy + a2^2 M2", {"J2xx": 1, "J2yy": -1, "M2": _A2**2}, 1.0935, 0.8926),
    TableRow(
        3,
        "J3xx - J3zz + J4zz + a3^2 m3 + (d4^2 + a3^2) M4 - 2 d4 mc4y",
        {"J3xx": 1, "J3zz": -1, "J4zz": 1, "M3": _A3**2, "M4": _D4**2, "mc4y": -2 * _D4},
        1.2425,
        1.1083,
    ),
    TableRow(4, "J3xz", {"J3xz": 1}, 0.2000, 0.2820),
    TableRow(
        5,
        "J3yy + J4zz - a3^2 m3 + (d4^2 - a3^2) M4 - 2 d4 mc4y",
        {"J3yy": 1, "J4zz": 1, "M3": -(_A3**2), "M4": _D4**2, "mc4y": -2 * _D4},
        2.0967,
        1.8308,
    ),
    TableRow(6, "J3yz", {"J3yz": 1}, 0.2000, 0.2154),
    TableRow(7, "J4xx - J4zz + J5zz", {"J4xx": 1, "J4zz": -1, "J5zz": 1}, 0.5000, 0.7674),
    TableRow(8, "J4yy + J5zz", {"J4yy": 1, "J5zz": 1}, 1.5000, 1.5438),
    TableRow(
        9,
        "J5xx + J6yy - J5zz + d6^2 m6 - 2 d6 mc6z",
        {"J5xx": 1, "J6yy": 1, "J5zz": -1, "m6": _D6**2, "mc6z": -2 * _D6},
        0.2040,
        0.1709,
    ),
    TableRow(10, "J5xy", {"J5xy": 1}, 0.1000, 0.1125),
    TableRow(11, "J5xz", {"J5xz": 1}, 0.1000, 0.0591),
    TableRow(
        12, "J5yy + J6yy + d6^2 m6 - 2 d6 mc6z", {"J5yy": 1, "J6yy": 1, "m6": _D6**2, "mc6z": -2 * _D6}, 0.7040, 0.7745
    ),
    TableRow(13, "J5yz", {"J5yz": 1}, 0.1000, 0.1003),
    TableRow(14, "J6xx - J6yy", {"J6xx": 1, "J6yy": -1}, 0.0000, 0.0497),
    TableRow(15, "J6xy", {"J6xy": 1}, 0.0500, 0.0614),
    TableRow(16, "J6xz", {"J6xz": 1}, 0.0500, 0.0596),
    TableRow(17, "J6yz", {"J6yz": 1}, 0.0500, 0.0361),
    TableRow(18, "J6zz", {"J6zz": 1}, 0.2000, 0.2298),
    TableRow(19, "a2 M2 + mc2x", {"M2": _A2, "mc2x": 1}, 3.1500, 3.1504),
    TableRow(20, "mc2y", {"mc2y": 1}, 0.1200, 0.1172),
    TableRow(21, "a3 M3 + mc3x", {"M3": _A3, "mc3x": 1}, 0.4100, 0.3966),
    TableRow(22, "d4 M4 - mc4y + mc3z", {"M4": _D4, "mc4y": -1, "mc3z": 1}, -1.1050, -1.1138),
    TableRow(23, "mc4x", {"mc4x": 1}, 0.0900, 0.1028),
    TableRow(24, "mc5y + mc4z", {"mc5y": 1, "mc4z": 1}, 0.0900, 0.0506),
    TableRow(25, "d6 m6 + mc5z - mc6z", {"m6": _D6, "mc5z": 1, "mc6z": -1}, -0.1200, -0.1160),
    TableRow(26, "mc6x", {"mc6x": 1}, 0.0100, 0.0248),
    TableRow(27, "mc6y", {"mc6y": 1}, -0.0100, -0.0178),
)


def paper_model() -> Model:
    """The paper's model: the KR5's rigid bodies, without friction; 60 parameters, 36 coefficients."""
    return Model(load_robot("kr5"), (RigidBody(),))


def nominal_parameters() -> Array:
    """(60,) physical link parameters of the KR5 with the nominal values of Table II, ordered as in `paper_model()`.

    The table does not hold all parameters; what it leaves open was chosen once, in round numbers, so that every
    pseudo-inertia stays well inside the cone (kr5_nominal.toml says how).
    """
    text = (resources.files("bayesid.simulation") / "kr5_nominal.toml").read_text(encoding="utf-8")
    return frozen(tomllib.loads(text)["links"], (_N_LINKS, len(NAMES)), "links").flatten()
