"""What motors and tendons of a model that MuJoCo compiled do to its joints, and what of that is left out."""

from collections.abc import Collection
from typing import Any

import numpy as np

from .._results import shown

# What a model may say of a tendon (MuJoCo's `tendon_...`), and how it is called in `left_out`.
_OF_TENDONS = {
    "stiffness": "stiffness",
    "damping": "damping",
    "frictionloss": "friction",
    "armature": "rotor",
    "limited": "range",
}


def bounds(interval: np.ndarray, limited: bool) -> tuple[float, float]:
    """Both ends of an interval, infinite where it is no limit."""
    return (float(interval[0]), float(interval[1])) if limited else (-np.inf, np.inf)


def joint_torques(mujoco: Any, model: Any, joint: int) -> tuple[float, float]:
    """Smallest and largest torque at a joint: its own limit, and that of the motors that drive no other."""
    low, high = bounds(model.jnt_actfrcrange[joint], model.jnt_actfrclimited[joint])
    pulls = [
        np.sort(gear * np.array(_force(mujoco, model, i)))
        for i in _motors(mujoco, model, joint)
        if (gear := model.actuator_gear[i][0])
    ]
    if pulls:
        low, high = max(low, float(sum(e[0] for e in pulls))), min(high, float(sum(e[1] for e in pulls)))
    return low, high


def _motors(mujoco: Any, model: Any, joint: int) -> list[int]:
    """The motors that drive a joint."""
    kinds = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    return [
        i
        for i, kind in enumerate(model.actuator_trntype)
        if mujoco.mjtTrn(kind) in kinds and model.actuator_trnid[i][0] == joint
    ]


def _force(mujoco: Any, model: Any, motor: int) -> tuple[float, float]:
    """Smallest and largest force of a motor, by its signal's range too where that is all it depends on."""
    low, high = bounds(model.actuator_forcerange[motor], model.actuator_forcelimited[motor])
    plain = (
        model.actuator_gaintype[motor] == mujoco.mjtGain.mjGAIN_FIXED
        and model.actuator_biastype[motor] == mujoco.mjtBias.mjBIAS_NONE
        and model.actuator_dyntype[motor] == mujoco.mjtDyn.mjDYN_NONE
    )
    # Since MuJoCo 4 a motor may have several signals, or none.
    signal = getattr(model, "actuator_ctrladr", range(model.nu))[motor]
    if plain and signal >= 0 and model.actuator_ctrllimited[signal]:
        signals = np.sort(model.actuator_gainprm[motor][0] * model.actuator_ctrlrange[signal])
        low, high = max(low, float(signals[0])), min(high, float(signals[1]))
    return low, high


def rotors(mujoco: Any, model: Any, joint: int) -> tuple[float, float]:
    """Inertia and damping that the motors of a joint add to it; files have them since MuJoCo 4."""
    inertia = damping = 0.0
    for i in _motors(mujoco, model, joint):
        square = float(model.actuator_gear[i][0]) ** 2
        inertia += square * _each(model, "actuator_armature", i)
        damping += square * _each(model, "actuator_damping", i)
    return inertia, damping


def _each(model: Any, name: str, i: int) -> float:
    """The first number of what a model says of a part; zero in versions of MuJoCo that say nothing of it."""
    found = getattr(model, name, None)
    return 0.0 if found is None else float(np.ravel(found[i])[0])


def left_out(mujoco: Any, model: Any, moving: Collection[int]) -> tuple[str, ...]:
    """What a file says of the motion of joints, and neither links nor joints of a `Robot` have."""
    said = [
        f"gravity compensation of link {shown(model.body(i).name)}"
        for i in range(model.nbody)
        if model.body_gravcomp[i]
    ]
    if model.opt.density or model.opt.viscosity:
        said.append("drag of a medium with density or viscosity")
    for i in moving:
        joint, motors = shown(model.joint(i).name), _motors(mujoco, model, i)
        if _bends(model, "jnt_stiffness", i):
            said.append(f"stiffness of joint {joint} that depends on its angle")
        at = [("dof_damping", model.jnt_dofadr[i]), *(("actuator_damping", motor) for motor in motors)]
        if any(_bends(model, name, j) for name, j in at):
            said.append(f"damping of joint {joint} that depends on its speed")
    for i in range(model.ntendon):
        if found := [word for name, word in _OF_TENDONS.items() if _each(model, f"tendon_{name}", i)]:
            said.append(f"{' and '.join(found)} of tendon {shown(model.tendon(i).name)}")
    of_joints = {motor for i in range(model.njnt) for motor in _motors(mujoco, model, i)}
    others = [i for i in range(len(model.actuator_trntype)) if i not in of_joints]
    return (*said, *(f"motor {shown(model.actuator(i).name)}, which drives no joint alone" for i in others))


def _bends(model: Any, name: str, i: int) -> bool:
    """Whether a polynomial of a model has more than its first coefficient."""
    more = (*np.ravel(getattr(model, name)[i])[1:],) if hasattr(model, name) else ()
    return any((*more, *np.ravel(getattr(model, f"{name}poly", {i: ()})[i])))
