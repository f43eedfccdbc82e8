"""The rolling wheel with a thin rim in Exudyn: its ideal rolling-disc joint and its implicit integrators."""

import dataclasses
import sys
from typing import Any

import numpy as np

from benchmarks._common import Contender, Run
from benchmarks.contenders.disc_numba import ABOUT, ACROSS, GRAVITY, MASS, RADIUS

# The linear solver (Exudyn's own, dense) and how often to take a Jacobian were chosen by trial. The tolerance
# is Newton's; at Exudyn's 1e-8 the error stops falling at some ten thousand steps.
NEWTON = 1e-10
DAMPING = 0.9  # spectral radius of the generalised-alpha method


@dataclasses.dataclass(frozen=True)
class Start:
    """Of the wheel in the world: axes h, u, e as columns (3, 3), centre, its velocity, spin, each (3,)."""

    axes: np.ndarray
    centre: np.ndarray
    velocity: np.ndarray
    spin: np.ndarray


def installed() -> bool:
    """Whether Exudyn can be imported; the build without range checks is asked for."""
    sys.exudynFast = True  # pyright: ignore[reportAttributeAccessIssue]
    try:
        import exudyn  # noqa: F401
    except ImportError:
        return False
    return True


def system_of(start: Start, node: str) -> tuple[Any, int]:
    """The wheel on the ground, ready to run, and the number of a sensor of its centre."""
    import exudyn
    from exudyn import utilities as parts

    mbs = exudyn.SystemContainer().AddSystem()
    # The joint is made for discs about their x axis.
    inertia = parts.RigidBodyInertia(mass=MASS, inertiaTensor=np.diag([ABOUT, ACROSS, ACROSS]))
    wheel = mbs.CreateRigidBody(
        inertia=inertia,
        nodeType=getattr(exudyn.NodeType, node),
        referencePosition=list(start.centre),
        referenceRotationMatrix=np.roll(start.axes, 1, axis=1),
        initialVelocity=list(start.velocity),
        initialAngularVelocity=list(start.spin),
        gravity=[0.0, 0.0, -GRAVITY],
        returnDict=True,
    )
    bodies = (mbs.CreateGround(), wheel["bodyNumber"])
    marks = [mbs.AddMarker(parts.MarkerBodyRigid(bodyNumber=n, localPosition=[0, 0, 0])) for n in bodies]
    joint = parts.ObjectJointRollingDisc(
        markerNumbers=marks, discRadius=RADIUS, discAxis=[1, 0, 0], planeNormal=[0, 0, 1]
    )
    mbs.AddObject(joint)
    position = exudyn.OutputVariableType.Position
    sensor = mbs.AddSensor(
        parts.SensorNode(nodeNumber=wheel["nodeNumber"], outputVariableType=position, storeInternal=True)
    )
    mbs.Assemble()
    return mbs, sensor


def settings_of(steps: int, end: float, period: float, simplified: bool) -> Any:
    """No files, no messages; one Jacobian a step, quicker here than one a run or one an iteration."""
    import exudyn

    chosen = exudyn.SimulationSettings()
    chosen.solution.file.write = False
    chosen.solution.sensors.writePeriod = period
    march = chosen.timeIntegration
    march.numberOfSteps, march.endTime, march.verboseMode = steps, end, 0
    march.newton.useModifiedNewton = march.newton.modifiedNewtonJacUpdatePerStep = True
    march.newton.relativeTolerance = NEWTON
    march.generalizedAlpha.spectralRadius = DAMPING
    march.generalizedAlpha.lieGroupSimplifiedKinematicRelations = simplified
    return chosen


@dataclasses.dataclass(frozen=True)
class Way:
    """One of Exudyn's `DynamicSolverType` with one of its `NodeType`."""

    name: str
    solver: str
    node: str = "RotationRotationVector"
    simplified: bool = False


BEST = Way("trapezoidal, index 2, simplified", "TrapezoidalIndex2", simplified=True)
OTHERS = (
    Way("trapezoidal, index 2, quaternion", "TrapezoidalIndex2", "RotationEulerParameters"),
    Way("generalised alpha, index 3", "GeneralizedAlpha"),
)


def exudyn_contender(name: str, start: Start, way: Way) -> Contender:
    """The "tolerance" is the step [s]."""
    import exudyn

    kind = getattr(exudyn.DynamicSolverType, way.solver)

    def make(step: float, times: np.ndarray) -> Run:
        steps, period = round(times[-1] / step), times[0]
        mbs, sensor = system_of(start, way.node)
        settings = settings_of(steps, times[-1], period, way.simplified)

        def call() -> None:
            if not mbs.SolveDynamic(settings, solverType=kind):
                raise RuntimeError("Exudyn's Newton iteration failed")

        def read(_: None) -> np.ndarray:
            stored = mbs.GetSensorStoredData(sensor)[1:]
            if stored.shape[0] != times.size or np.abs(stored[:, 0] - times).max() > 1e-9:
                raise RuntimeError("Exudyn did not store the states that were asked for")
            return stored[:, 1:]

        def count() -> tuple[int, int]:
            return steps, int(mbs.sys["dynamicSolver"].it.newtonStepsCount)

        return Run(call, read, count)

    return Contender("Exudyn", name, way.name, make)
