"""How long the programs are that XLA is given: their compilation is what a first call waits for."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import pytest

import jaxroll as jxr
from tests.recorded import runs

# Lines of the lowered programs with jax 0.10: a change that makes one more than 2 % longer is to say why, and
# to write down the new number. Fewer lines are to be written down too.
LINES = {
    ("pivoted", "run"): 2290,
    ("pivoted", "gradient"): 6115,
    ("pinch", "run"): 3888,
    ("pinch", "gradient"): 11968,
    ("pinch3d", "run"): 11276,
}
_ALLOWED = 1.02


def lines(scene: str, what: str) -> int:
    """Lines of a run over 0.2 s, or of its gradient in the controller's damping."""
    grasp, state = runs.scene(scene)

    def end(damping: jax.Array) -> jax.Array:
        return jxr.simulate(grasp.with_(damping=damping), state, 0.2, ts=1).last.q[0]

    function = end if what == "run" else jax.value_and_grad(end)
    return len(jax.jit(function).lower(grasp.controller.damping).as_text().splitlines())


@pytest.mark.skipif(not jax.__version__.startswith("0.10."), reason="other versions write other lines")
@pytest.mark.parametrize(("scene", "what"), LINES)
def test_programs_have_not_grown(scene: str, what: str) -> None:
    assert lines(scene, what) <= _ALLOWED * LINES[scene, what]


@pytest.mark.parametrize(
    "scene",
    [
        lambda r: jxr.scenes.pinch(tips=jxr.Circle(r)),
        lambda r: jxr.scenes.ring(2, tip=jxr.Circle(r)),
        lambda r: jxr.scenes.pinch3d(tips=jxr.Sphere(r)),
        lambda r: jxr.scenes.tripod(tips=jxr.Sphere(r)),
    ],
    ids=["pinch", "ring", "pinch3d", "tripod"],
)
def test_a_traced_scene_is_known_to_be_at_rest(scene: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    # Otherwise its closing also projects velocities: a quarter of the program of a gradient in the tips.
    known = []

    def closing(grasp: Any, guess: jxr.State, *_: Any, resting: bool, **__: Any) -> Any:
        known.append(resting)
        return guess, jnp.zeros(1)

    monkeypatch.setattr("jaxroll._closing._close._close", closing)
    jax.eval_shape(scene, jnp.asarray(0.011))
    assert known and all(known)
