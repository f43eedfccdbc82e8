"""The roller between two plates in PyBullet."""

import tempfile
from typing import Any

import numpy as np

from benchmarks._roller_problem import (
    CARRIAGE,
    Case,
    CIRCLE,
    FORCE,
    INERTIA,
    MASS,
    PERIOD,
    PLATE,
    POINTS,
    prism,
    RADIUS,
    RATE,
    SAMPLES,
    TRAVEL,
)

_UNIT = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
_FREE = '<limit lower="-1" upper="1" effort="1e9" velocity="1e3"/>'
_PLATE = f"""<robot name="plate">
<link name="world"/>
<link name="carriage"><inertial><mass value="{CARRIAGE}"/>{_UNIT}</inertial></link>
<link name="plate">
  <inertial><mass value="{PLATE}"/>{_UNIT}</inertial>
  <collision><origin xyz="0 0 0.01"/><geometry><box size="0.4 0.1 0.02"/></geometry></collision>
</link>
<joint name="u" type="prismatic">
  <parent link="world"/><child link="carriage"/><axis xyz="1 0 0"/>{_FREE}
</joint>
<joint name="z" type="prismatic">
  <parent link="carriage"/><child link="plate"/><axis xyz="0 0 1"/>{_FREE}
</joint>
</robot>"""
_PATCHED: dict[str, Any] = {
    "contactSlop": 0.0,
    "solverResidualThreshold": 0.0,
    "contactBreakingThreshold": 1e-5,
}


def cases() -> list[Case]:
    """Default settings, then the best of a search over some hundreds: by centre, and by angle."""
    bare = {"collisionMargin": 0.0, "lateralFriction": 1.0}
    flat: dict[str, Any] = {"contact": bare, "enableConeFriction": 0}
    return [
        _case("sphere", "default, 240 Hz"),
        _case("sphere", "10 ms", step=1e-2, contact={"lateralFriction": 1.0}),
        _case("capsule", "default, 240 Hz"),
        _case("128-gon", "default, 240 Hz"),
        _case("128-gon", "no margin or slop, 50 iterations, 1 ms", step=1e-3, erp=0.2, **flat, **_PATCHED),
        _case("128-gon", "no margin, 200 iterations, 0.5 ms", step=5e-4, erp=0.8, numSolverIterations=200,
              slow=True, **flat),
    ]  # fmt: skip


def _case(
    shape: str,
    setting: str,
    *,
    step: float = 1.0 / 240.0,
    contact: dict[str, float] | None = None,
    erp: float | None = None,
    slow: bool = False,
    **engine: Any,
) -> Case:
    import pybullet
    from pybullet_utils.bullet_client import BulletClient

    world: Any = BulletClient(pybullet.DIRECT)
    if erp is not None:
        engine |= {"erp": erp, "contactERP": erp, "frictionERP": erp}
    # This threshold is global: without it here, the last world would set it for all.
    engine = {"contactBreakingThreshold": 0.02, "fixedTimeStep": step, "numSubSteps": 0} | engine
    world.setPhysicsEngineParameter(**engine)
    roller, plate = _bodies(world, shape, contact or {})
    steps = round(PERIOD / step)
    every = max(1, steps // SAMPLES)
    speeds = 0.5 * TRAVEL * RATE * np.sin(RATE * step * (np.arange(steps) + 0.5))

    def run() -> np.ndarray:
        world.setPhysicsEngineParameter(**engine)
        world.resetBasePositionAndOrientation(roller, [0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0])
        world.resetBaseVelocity(roller, [0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
        for joint in (0, 1):
            world.resetJointState(plate, joint, 0.0, 0.0)
        path = [(0.0, 0.0, 0.0, 0.0)]
        for i, speed in enumerate(speeds):
            world.setJointMotorControl2(plate, 0, world.VELOCITY_CONTROL, targetVelocity=speed, force=1e6)
            world.setJointMotorControl2(plate, 1, world.TORQUE_CONTROL, force=-FORCE)
            world.stepSimulation()
            if (i + 1) % every == 0:
                (x, _, z), turn = world.getBasePositionAndOrientation(roller)
                angle = 2.0 * np.arctan2(turn[1], turn[3])
                path.append((x, z, RADIUS * angle, world.getJointState(plate, 0)[0]))
        return np.array(path)

    given = POINTS if shape == "128-gon" else CIRCLE
    return Case("PyBullet", given, shape, setting, run, count=lambda _: steps, slow=slow)


def _bodies(world: Any, shape: str, contact: dict[str, float]) -> tuple[int, int]:
    """Roller, and plate on two sliders; the lower plate is part of the world."""
    across = world.getQuaternionFromEuler([0.5 * np.pi, 0.0, 0.0])
    shapes = {
        "sphere": {"shapeType": world.GEOM_SPHERE, "radius": RADIUS},
        "capsule": {
            "shapeType": world.GEOM_CAPSULE, "radius": RADIUS, "height": 0.02,
            "collisionFrameOrientation": across,
        },
        "128-gon": {"shapeType": world.GEOM_MESH, "vertices": prism().tolist()},
    }  # fmt: skip
    slab = world.createCollisionShape(world.GEOM_BOX, halfExtents=[0.2, 0.05, 0.01])
    lower = world.createMultiBody(0.0, slab, basePosition=[0.0, 0.0, -0.01 - RADIUS])
    roller = world.createMultiBody(MASS, world.createCollisionShape(**shapes[shape]))
    with tempfile.NamedTemporaryFile("w", suffix=".urdf") as file:
        file.write(_PLATE)
        file.flush()
        plate = world.loadURDF(file.name, [0.0, 0.0, RADIUS], useFixedBase=1)
    free = {"linearDamping": 0.0, "angularDamping": 0.0, "rollingFriction": 0.0, "spinningFriction": 0.0}
    for body, link in ((lower, -1), (roller, -1), (plate, -1), (plate, 0), (plate, 1)):
        world.changeDynamics(body, link, **free, **contact)
    for link in (0, 1):  # each joint is born with a motor that brakes it
        world.changeDynamics(plate, link, jointDamping=0.0)
        world.setJointMotorControl2(plate, link, world.VELOCITY_CONTROL, force=0.0)
    world.changeDynamics(roller, -1, localInertiaDiagonal=[INERTIA] * 3)
    world.changeDynamics(roller, -1, activationState=world.ACTIVATION_STATE_DISABLE_SLEEPING)
    return roller, plate
