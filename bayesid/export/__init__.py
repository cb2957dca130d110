"""Exports: an identified model as URDF or MJCF, robot files, and motions as programs of controllers.

Both model formats hold kinematics and link inertias. A URDF also holds viscous and Coulomb friction; an MJCF, MuJoCo's
own format, also gravity, rotor inertia, joint springs, and motors that move several joints. A comment at the head of
the file states what the format cannot hold.
"""

from bayesid.export.model_text import mjcf, urdf

__all__ = ["mjcf", "urdf"]
