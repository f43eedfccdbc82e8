"""The roller between two plates in MuJoCo."""

import importlib
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
    SAMPLES,
    SPRING,
    TRAVEL,
)

_SHAPES = {
    "sphere": f'type="sphere" size="{RADIUS}"',
    "capsule": f'type="capsule" size="{RADIUS} 0.01" euler="90 0 0"',
    "cylinder": f'type="cylinder" size="{RADIUS} 0.01" euler="90 0 0"',
    "128-gon": 'type="mesh" mesh="roller"',
}
# No tolerance of the solver in the way.
_EXACT = 'tolerance="1e-15" iterations="200" ls_iterations="100" ls_tolerance="1e-4"'
_NOSLIP = 'noslip_iterations="50" noslip_tolerance="1e-14"'
_HARD, _SOFT = "0.999 0.9999 0.0001 0.5 2", "0.9 0.95 0.001 0.5 2"


def cases() -> list[Case]:
    """Default settings, then the best of a search over some hundreds."""
    hard = f'cone="pyramidal" impratio="1e6" {_EXACT}'
    elliptic = f'cone="elliptic" integrator="implicitfast" impratio="1e3" {_EXACT} {_NOSLIP}'
    named = "pyramidal cone, impratio 1e6, hard contact,"
    return [
        _case("sphere", "default, 2 ms"),
        _case("sphere", f"{named} 0.2 ms", step=2e-4, option=hard, solimp=_SOFT, slow=True),
        _case("capsule", "default, 2 ms"),
        _case("capsule", f"{named} 10 ms", step=1e-2, option=hard, solimp=_HARD),
        _case("capsule", f"{named} 2 ms", option=hard, solimp=_HARD),
        _case("cylinder", "default, 2 ms"),
        _case("cylinder", "elliptic cone, noslip, 1 ms", step=1e-3, option=elliptic, solimp=_HARD),
        _case("128-gon", "default, 2 ms"),
        _case("128-gon", "elliptic cone, noslip, 1 ms", step=1e-3, option=elliptic, solimp=_HARD),
        _case("128-gon", "elliptic cone, noslip, 0.5 ms", step=5e-4, option=elliptic, solimp=_HARD),
        _case(
            "128-gon", "elliptic cone, noslip, 0.1 ms", step=1e-4, option=elliptic, solimp=_HARD, slow=True
        ),
    ]


def _case(
    shape: str, setting: str, *, step: float = 2e-3, option: str = "", solimp: str = "", slow: bool = False
) -> Case:
    mujoco: Any = importlib.import_module("mujoco")

    # The stiffest contact that is advised: a time constant of two steps.
    geom = f'solref="{2 * step} 1" solimp="{solimp}"' if solimp else ""
    model = mujoco.MjModel.from_xml_string(_scene(shape, step, option, geom))
    each = round(PERIOD / SAMPLES / step)

    def run() -> np.ndarray:
        data = mujoco.MjData(model)
        data.qfrc_applied[4] = -FORCE
        path = np.zeros((SAMPLES + 1, 4))
        for i in range(SAMPLES):
            mujoco.mj_step(model, data, each)
            path[i + 1] = data.qpos[:4]
        return path * np.array([1.0, 1.0, RADIUS, 1.0])

    given = POINTS if shape == "128-gon" else CIRCLE
    return Case("MuJoCo", given, shape, setting, run, count=lambda _: SAMPLES * each, slow=slow)


def _scene(shape: str, step: float, option: str, geom: str) -> str:
    corners = " ".join(f"{x:.17g}" for x in prism().ravel())
    mesh = f'<asset><mesh name="roller" vertex="{corners}"/></asset>' if shape == "128-gon" else ""
    return f"""
<mujoco>
  <option gravity="0 0 0" timestep="{step}" {option}/>
  <default><geom friction="1 0.005 0.0001" {geom}/></default>
  {mesh}
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body pos="0 0 {RADIUS}">
      <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint type="hinge" axis="0 1 0"/>
      <inertial pos="0 0 0" mass="{MASS}" diaginertia="{INERTIA} {INERTIA} {INERTIA}"/>
      <geom {_SHAPES[shape]}/>
    </body>
    <body pos="0 0 {2 * RADIUS + 0.01}">
      <joint type="slide" axis="1 0 0" stiffness="{SPRING}" springref="{TRAVEL / 2}"/>
      <inertial pos="0 0 0" mass="{CARRIAGE}" diaginertia="1 1 1"/>
      <body>
        <joint type="slide" axis="0 0 1"/>
        <inertial pos="0 0 0" mass="{PLATE}" diaginertia="1 1 1"/>
        <geom type="box" size="0.2 0.05 0.01"/>
      </body>
    </body>
  </worldbody>
</mujoco>"""
