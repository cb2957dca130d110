"""An identified model as a file for simulators, planners and controllers.

Both formats hold the kinematics and the links' inertias. A URDF holds viscous and Coulomb friction besides; an MJCF,
MuJoCo's own format, also gravity, rotor inertia, springs across joints, and motors that move several joints. What a
format has no place for is written into a comment at the file's head.
"""

from bayesid.export.model_text import mjcf, urdf

__all__ = ["mjcf", "urdf"]
