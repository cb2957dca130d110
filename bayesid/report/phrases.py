"""How to speak of the effects of the catalogue."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Form:
    """How to speak of one form of an effect.

    Attributes:
        sentence: says that it is there; {who} is the joint, {whose} its genitive, other braces hold parameters, without
            the joint in their names.
        noun: with its article; a form without one has that of the effect's main form.
        size: the number whose sign decides between the sentence and the opposite, or whose change is told alone.
        opposite: for a negative size, which is then told without its sign.
    """

    sentence: str
    noun: str = ""
    size: str = ""
    opposite: str = ""


FORMS: Mapping[str, Form] = {
    "viscous_friction": Form("{who} needs viscous friction of {Fv}.", "viscous friction"),
    "coulomb_friction": Form("{who} needs Coulomb friction of {Fc}.", "Coulomb friction"),
    "asymmetric_coulomb": Form(
        "{who} needs dry friction that depends on the direction: {Fp} forwards and {Fm} backwards.",
        "asymmetric Coulomb friction",
    ),
    "stribeck_friction": Form(
        "{who} needs dry friction that falls with speed: {Fk}, and near standstill {Fs} more, fading over {speed}.",
        "Stribeck friction",
    ),
    "load_dependent_friction": Form(
        "{who} needs dry friction that grows with the load, by {Fl} of it.", "load-dependent friction"
    ),
    "torque_offset": Form("{who} needs a torque offset of {offset}.", "a torque offset"),
    "rotor_inertia": Form("{who} needs a rotor inertia of {Ia}.", "rotor inertia"),
    "joint_spring": Form("{who} needs a spring of {k}, with {k0} at position zero.", "a joint spring"),
    "gravity_spring": Form(
        "{who} needs a balancing spring: {ks} times the sine of its position and {kc} times the cosine.",
        "a balancing spring",
    ),
    "gravity_spring.free_length": Form(
        "{who} needs a balancing spring with a free length: {ks1} and {kc1} times the sine and cosine of its position, "
        "{ks2} and {kc2} times those of twice the position."
    ),
    "torque_ripple": Form(
        "{who} needs torque ripple of {harmonic} waves a turn: {rs} in the sine and {rc} in the cosine.",
        "torque ripple",
    ),
    "hysteresis": Form("{who} needs presliding friction of {Fh} that builds up over {width}.", "presliding hysteresis"),
    "hysteresis.smooth": Form("{who} needs presliding friction of {Fhs} that builds up gradually over {width}."),
    "hysteresis.elastic": Form("{who} needs presliding friction of {Fhe} with an elastic return, over {width}."),
    "hysteresis.layers": Form(
        "{who} needs presliding friction of {Fha}, {Fhb} and {Fhc}, built up over a quarter, half and all of {width}."
    ),
    "payload": Form("The robot carries a payload of {mp} that the model lacks.", "a payload", "mp"),
    "base_tilt": Form(
        "The base is tilted by {tilt1} and {tilt2}, about two axes across gravity as the model has it.", "a base tilt"
    ),
    "gain_error": Form(
        "{whose} efforts read {gain} too large.", "a gain error", "gain", "{whose} efforts read {gain} too small."
    ),
    "delay": Form(
        "{whose} efforts lag {lag} behind the motion.",
        "a delay",
        "lag",
        "{whose} efforts come {lag} ahead of the motion.",
    ),
    "cable_drag": Form(
        "{who} needs a cable that pulls with {kd} beyond {start}.",
        "cable drag",
        "side",
        "{who} needs a cable that pulls with {kd} below {start}.",
    ),
    "cable_drag.friction": Form("{who} needs a dress pack that rubs with {Fd} of bending, straight at {start}."),
    "cable_drag.stiffening": Form("{who} needs a cable that stiffens when bent, {kd1} and {kd3}, relaxed at {start}."),
    "thermal_drift": Form(
        "{who} needs dry friction of {Fcold} that changes by {Fwarm} as it warms up, over {time}.", "thermal drift"
    ),
    "thermal_drift.viscous": Form(
        "{who} needs viscous friction of {fcold} that changes by {fwarm} as it warms up, over {time}."
    ),
    "thermal_drift.both": Form(
        "{who} needs friction that changes as it warms up, over {time}: dry friction of {Fcold2} by {Fwarm2}, and "
        "viscous friction of {fcold2} by {fwarm2}."
    ),
    "thermal_drift.offset": Form(
        "{who} needs a zero error of {ocold} that drifts by {owarm} as it warms up, over {time}."
    ),
    "tool_wrench": Form(
        "A force of {wbx}, {wby} and {wbz} along the base's axes acts on the tool.", "a force on the tool"
    ),
    "tool_wrench.couple": Form(
        "A force of {wcx}, {wcy} and {wcz} and a couple of {wcrx}, {wcry} and {wcrz} along the base's axes act on the "
        "tool."
    ),
    "tool_wrench.following": Form("A force of {wtx}, {wty} and {wtz} acts on the tool and turns with it."),
    "tool_wrench.following_couple": Form(
        "A force of {wfx}, {wfy} and {wfz} and a couple of {wfrx}, {wfry} and {wfrz} act on the tool and turn with it."
    ),
    "clipping": Form("{whose} efforts are cut off at {limit}.", "clipping"),
    "dead_zone": Form("{whose} efforts below {width} read as zero.", "a dead zone"),
    "dead_zone.shrinking": Form("{whose} efforts read {width} too small, the smallest as zero."),
}
"""Name in the catalogue to its phrases."""

PEOPLE: Mapping[tuple[str, str], tuple[float, float, str]] = {
    ("base_tilt", "tilt1"): (0.0, 180.0 / math.pi, "degrees"),
    ("base_tilt", "tilt2"): (0.0, 180.0 / math.pi, "degrees"),
    ("delay", "lag"): (0.0, 1e3, "ms"),
    ("gain_error", "gain"): (1.0, 100.0, "%"),
    ("load_dependent_friction", "Fl"): (0.0, 100.0, "%"),
    ("torque_ripple", "harmonic"): (0.0, 1.0, ""),
}
"""What is taken off an effect's parameter, its factor and its unit, where people speak of it otherwise."""
