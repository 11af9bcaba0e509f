"""Scenes in Drake: an ellipsoid between two half-spaces, by discrete contact with the SAP solver and point contact.

A palm is a half-space on a revolute and a prismatic joint along itself, heavy, whose positions and velocities are set
before each step, so that its vibration is a motion of the half-space. Drake's friction is regularised near zero slip over a
speed that shrinks with the step; that is no vibration, and small against one at the steps taken here.
"""

from __future__ import annotations

import math

import numpy as np
from pydrake.geometry import Ellipsoid, HalfSpace, ProximityProperties, AddContactMaterial
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction, DiscreteContactApproximation
from pydrake.multibody.tree import PrismaticJoint, RevoluteJoint, SpatialInertia, UnitInertia
from pydrake.systems.framework import DiagramBuilder
