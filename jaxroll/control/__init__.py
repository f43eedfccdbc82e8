r"""Joint torques from joint data and finger kinematics alone ("blind" control).

A controller sees the time, its own fingers' joint angles and rates, and the tip frames they imply; it
never sees the object. Built-in controllers work on scalars and know their potential energy; any other
callable pytree `f(t, angles, rates, tips)` works too (see `Grasp`).

The chapter's are `Press` (75) and `Opposition` (16)-(17). `Carry` moves what the tips hold as commands say.
`Integral` adds an integral term to any law, `Sampled` asks any law at samples only and holds its torques
between them; both have a memory, which is a part of the state. `_sensing` is what a law gets, `_user` adapts
a caller's function and has `Passive`, for a grasp without a controller. `_motion/_equations` asks for torques
in every evaluation, `_motion/_sampling` takes the samples.
"""

from .._mechanics import AbstractController as AbstractController
from ._carry import Carry as Carry
from ._integral import Integral as Integral
from ._opposition import Opposition as Opposition
from ._press import Press as Press
from ._sampled import Sampled as Sampled
from ._sensing import (
    joint_angles as joint_angles,
    orientations as orientations,
    sense as sense,
    Sensed as Sensed,
    Tip as Tip,
)
from ._user import (
    as_controller as as_controller,
    law_of as law_of,
    laws_of as laws_of,
    Passive as Passive,
    UserController as UserController,
)
