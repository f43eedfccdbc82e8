"""The roller between two plates in Drake."""

from typing import Any

import numpy as np

from benchmarks._roller_problem import (
    CARRIAGE,
    Case,
    CIRCLE,
    FORCE,
    MASS,
    PERIOD,
    PLATE,
    POINTS,
    prism,
    RADIUS,
    SAMPLES,
    SPRING,
    TRAVEL,
)


def cases() -> list[Case]:
    """Default settings, then the best of a search over solvers, steps, stiffness and stiction."""
    best: dict[str, Any] = {"solver": "kTamsi", "slip": 1e-8, "stiffness": 1e10}
    mesh: dict[str, Any] = {"solver": "kTamsi", "slip": 1e-6}
    smooth: dict[str, Any] = {"accuracy": 1e-6, "slip": 1e-4, "stiffness": 1e6}
    return [
        _case("sphere", "default, 1 ms"),
        _case("sphere", "1 ms, SAP", solver="kSap", slip=1e-6, stiffness=1e8, slow=True),
        _case("sphere", "TAMSI, stiction 1e-8 m/s, 1e10 N/m, 10 ms", step=1e-2, **best),
        _case("sphere", "TAMSI, stiction 1e-8 m/s, 1e10 N/m, 1 ms", **best),
        _case("sphere", "continuous, CENIC to 1e-6", step=0.0, **smooth),
        _case("128-gon", "default, 1 ms"),
        _case("128-gon", "TAMSI, stiction 1e-6 m/s, 1e7 N/m, 1 ms", stiffness=1e7, **mesh),
        _case(
            "128-gon",
            "TAMSI, stiction 1e-6 m/s, 1e8 N/m, 0.1 ms",
            step=1e-4,
            stiffness=1e8,
            slow=True,
            **mesh,
        ),
        _case("128-gon", "continuous, CENIC to 1e-6", step=0.0, slow=True, **smooth),
    ]


def _case(shape: str, setting: str, *, step: float = 1e-3, slow: bool = False, **tuning: Any) -> Case:
    simulator, plant, joints = _scene(shape, step, **tuning)
    context = simulator.get_mutable_context()
    inside = plant.GetMyMutableContextFromRoot(context)
    plant.get_actuation_input_port().FixValue(inside, [-FORCE])
    at = [joints[0].position_start() + i for i in range(3)] + [joints[1].position_start()]
    scale = np.array([1.0, 1.0, -RADIUS, 1.0])  # the joint's axis points to -y

    def run() -> np.ndarray:
        context.SetTime(0.0)
        plant.SetPositionsAndVelocities(inside, np.zeros(plant.num_multibody_states()))
        simulator.Initialize()
        path = np.zeros((SAMPLES + 1, 4))
        for i in range(SAMPLES):
            simulator.AdvanceTo((i + 1) * PERIOD / SAMPLES)
            path[i + 1] = plant.GetPositions(inside)[at]
        return path * scale

    count = lambda _: round(PERIOD / step) if step else simulator.get_num_steps_taken()  # noqa: E731
    given = POINTS if shape == "128-gon" else CIRCLE
    return Case("Drake", given, shape, setting, run, count=count, slow=slow)


def _scene(
    shape: str,
    step: float,
    *,
    solver: str | None = None,
    slip: float | None = None,
    stiffness: float | None = None,
    accuracy: float | None = None,
) -> tuple[Any, Any, tuple[Any, Any]]:
    import pydrake.all as drake

    builder = drake.DiagramBuilder()
    plant, _ = drake.AddMultibodyPlantSceneGraph(builder, time_step=step)
    plant.set_contact_model(drake.ContactModel.kPoint)
    plant.gravity_field().set_gravity_vector(np.zeros(3))
    if solver is not None:
        plant.set_discrete_contact_approximation(getattr(drake.DiscreteContactApproximation, solver))
    if slip is not None:
        plant.set_stiction_tolerance(slip)
    contact = drake.ProximityProperties()
    friction = drake.CoulombFriction(1.0, 1.0)
    drake.AddContactMaterial(friction=friction, point_stiffness=stiffness, properties=contact)
    joints = _bodies(drake, plant, shape, contact)
    plant.Finalize()
    simulator = drake.Simulator(builder.Build())
    if accuracy is not None:
        config = drake.SimulatorConfig(integration_scheme="cenic", max_step_size=0.1, accuracy=accuracy)
        drake.ApplySimulatorConfig(config, simulator)
    return simulator, plant, joints


def _bodies(drake: Any, plant: Any, shape: str, contact: Any) -> tuple[Any, Any]:
    """Roller on a planar joint, plate on a carriage on a spring; the joints of roller and carriage."""
    ball = drake.UnitInertia(*[0.5 * RADIUS**2] * 3)
    roller = plant.AddRigidBody("roller", drake.SpatialInertia(MASS, np.zeros(3), ball))
    carriage, plate = (
        plant.AddRigidBody(name, drake.SpatialInertia(mass, np.zeros(3), drake.UnitInertia(1.0, 1.0, 1.0)))
        for name, mass in (("carriage", CARRIAGE), ("plate", PLATE))
    )
    solid = drake.Sphere(RADIUS) if shape == "sphere" else drake.Convex(points=prism().T, label="roller")
    slab = drake.Box(0.4, 0.1, 0.02)
    world, shift = plant.world_body(), RADIUS + 0.01
    plant.RegisterCollisionGeometry(roller, drake.RigidTransform(), solid, "roller", contact)
    plant.RegisterCollisionGeometry(world, drake.RigidTransform([0.0, 0.0, -shift]), slab, "lower", contact)
    plant.RegisterCollisionGeometry(plate, drake.RigidTransform([0.0, 0.0, shift]), slab, "upper", contact)
    turn = drake.RigidTransform(drake.RotationMatrix.MakeXRotation(0.5 * np.pi), np.zeros(3))
    ends = [
        plant.AddFrame(drake.FixedOffsetFrame(name, frame, turn))
        for name, frame in (("plane", plant.world_frame()), ("disc", roller.body_frame()))
    ]
    planar = plant.AddJoint(drake.PlanarJoint("planar", *ends))
    along, up = [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]
    slide = plant.AddJoint(drake.PrismaticJoint("u", plant.world_frame(), carriage.body_frame(), along))
    press = plant.AddJoint(drake.PrismaticJoint("z", carriage.body_frame(), plate.body_frame(), up))
    plant.AddForceElement(drake.PrismaticSpring(slide, TRAVEL / 2, SPRING))
    plant.AddJointActuator("press", press)
    return planar, slide
