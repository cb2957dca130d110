"""Collision models: how far a robot is from itself and from the floor."""

from bayesid.robot.collision.clearance import Capsules, CollisionModel, NoShapes, collision_model

__all__ = ["Capsules", "CollisionModel", "NoShapes", "collision_model"]
