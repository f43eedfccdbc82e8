"""Every figure of `jaxroll.plotting` on small runs, in words: by name a function that draws and describes it.

`taken` has the figures that a call makes and does not return; `shots` what an animation writes.
"""

import contextlib
import functools
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

import jaxroll as jxr
from jaxroll import geometry, plotting
from jaxroll.plotting import _loci_figure, _meshes, _page, _poses3, _rays, _style, _tags, _tubes
from jaxroll.plotting._animate3 import animate3
from jaxroll.plotting._forces3 import Pushes
from jaxroll.plotting._scene3 import scene3
from tests.recorded import artists, fits, runs
from tests.recorded.compare import described

SCENES = (
    "pivoted", "pinch", "pinch_ellipse", "ball_plate", "ring", "roller",
    "pinch3d", "incline", "rattleback", "tube", "turntable", "wheel",
)  # fmt: skip
# Of the others, those that move are drawn, or `solids` has them.
POSED = ("pivoted", "pinch", "ring", "roller", "pinch3d", "rattleback", "wheel")
VIEW = plotting.View(14.0, -72.0, 30.0, links=False)


def drawn(figure: Figure) -> dict[str, Any]:
    """A figure with all that is on it."""
    return artists.figure(figure)


@contextlib.contextmanager
def taken() -> Iterator[list[Any]]:
    """The figures that are made meanwhile."""
    made: list[Any] = []
    start = _style.Picture.__init__

    def noted(self: Any, *sizes: Any) -> None:
        start(self, *sizes)
        made.append(self)

    with mock.patch.object(_style.Picture, "__init__", noted):
        yield made


def shots(path: Path) -> dict[str, Any]:
    """An animation: its size and times, the colours that its palette keeps, and roughly what it shows."""
    found: dict[str, Any] = {}
    with Image.open(path) as image:
        found["size ±2"] = list(image.size)
        found["frames"] = image.n_frames
        found["loop"] = image.info.get("loop")
        found["kept colours"] = described(np.reshape(image.getpalette()[:24], (-1, 3)))  # pyright: ignore
        for k in range(image.n_frames):
            image.seek(k)
            whole = Image.fromarray(np.asarray(image.convert("RGB")))
            rough = np.asarray(whole.resize((5, 4), Image.Resampling.BOX), float).mean(axis=-1)
            found[f"frame {k}"] = {
                "milliseconds": image.info["duration"],
                "brightness ±4": [round(x, 1) for x in rough.ravel().tolist()],
            }
    return found


def animated(draw: Callable[[Path], Any]) -> dict[str, Any]:
    """An animation: the file, and the figure as it was when the last frame was drawn."""
    told: list[tuple[int, int]] = []
    with tempfile.TemporaryDirectory() as folder, taken() as made:
        path = draw(Path(folder) / "new" / "motion.gif")
        found = {"file": shots(path)}
    for k, figure in enumerate(made):
        found[f"figure {k}"] = drawn(figure)
    return found | {"told": described(told)}


def written(draw: Callable[[str], Figure]) -> dict[str, Any]:
    """A figure that is written to a folder too."""
    told: dict[str, Any] = {}

    def note(figure: Any, path: Path, **options: Any) -> None:
        told["file"] = {"name": path.name, "folder": path.parent.is_dir(), **options}

    with tempfile.TemporaryDirectory() as folder, mock.patch.object(Figure, "savefig", note):
        return drawn(draw(f"{folder}/new")) | told


def _of_run(draw: Callable[..., Figure], name: str, **options: Any) -> Callable[[], dict[str, Any]]:
    return lambda: drawn(draw(runs.scene(name)[0], runs.run(name), **options))


def _broken(name: str) -> Any:
    return runs.run(name, ended="slipping")


def _stretched() -> dict[str, Any]:
    """A run in which all rolling happens at once: later times are drawn on a logarithmic axis."""
    grasp, run = runs.scene("pivoted")[0], runs.run("pivoted")
    early = np.asarray(run.states.s)[np.minimum(np.arange(len(run.ts)), 1)]
    return drawn(plotting.responses(grasp, eqx.tree_at(lambda r: r.states.s, run, early)))


def _before_the_first_state() -> dict[str, Any]:
    """A run that ended before a state was saved: its end is drawn."""
    grasp, _ = runs.scene("pivoted")
    run = runs.run("pivoted", times=4, ended="slipping")
    gone = runs.without(
        run, states=jxr.State(*(np.nan * x for x in (run.states.q, run.states.v, run.states.s)))
    )
    return drawn(plotting.poses(grasp, gone))


def _on_given_axes() -> dict[str, Any]:
    whole = _style.Picture(5.0, 8.0)
    above, below = whole.subplots(2, 1)
    assert plotting.pose(*runs.scene("pivoted"), ax=above) is whole
    plotting.contact_geometry(*runs.scene("pinch"), contact=1, ax=below)
    return artists.figure(whole, placed=False)


def _contact(name: str, contact: int, *, bent: float = 0.0) -> Callable[[], dict[str, Any]]:
    def draw() -> dict[str, Any]:
        grasp, state = runs.scene(name)
        moved = jxr.State(state.q + bent * np.cos(np.arange(len(state.q))), state.v, state.s + 0.01 * bent)
        figure = plotting.contact_geometry(grasp, moved, contact=contact)
        return artists.figure(figure, placed=False)

    return draw


def _loci(contacts: int, **options: float) -> Callable[[], dict[str, Any]]:
    name = "turntable" if contacts == 1 else "pinch3d"

    def draw() -> dict[str, Any]:
        made = runs.loci(contacts, **options)
        run = runs.run(name, times=41)
        with mock.patch.object(_loci_figure, "loci_of", lambda grasp, trajectory: made):
            return drawn(plotting.loci(runs.scene(name)[0], run))

    return draw


def _stand_in(**options: Any) -> Callable[[], dict[str, Any]]:
    def draw() -> dict[str, Any]:
        grasp, motion, _ = runs.stand_in()
        return drawn(_poses3.snapshots3(grasp, motion, **options))

    return draw


def _pushes() -> Pushes:
    return Pushes(runs.swinging(13, (2, 3), 2.0, 1.0).swapaxes(0, 1))


def _stand_in_animated() -> dict[str, Any]:
    grasp, motion, ts = runs.stand_in()
    wanted = {"fps": 4.0, "speed": 2.0, "forces": _pushes(), "size": 3.0, "view": VIEW}
    return animated(lambda path: animate3(grasp, motion, ts, path, **wanted))


def _long_animated() -> dict[str, Any]:
    """A run in space that is slowed down to what can be drawn."""
    grasp, _ = runs.scene("turntable")
    run = runs.run("turntable", times=9, t1=2.0, ended="slipping")
    return animated(
        lambda path: plotting.animate(grasp, run, path, fps=3.0, size=2.5, forces=False, until=1.1)
    )


def _animated(name: str, **options: Any) -> Callable[[], dict[str, Any]]:
    grasp_and_run = lambda: (runs.scene(name)[0], runs.run(name, times=9))  # noqa: E731
    return lambda: animated(lambda path: plotting.animate(*grasp_and_run(), path, **options))


def page_of(draw: Callable[[str], Any]) -> dict[str, Any]:
    """A page as plotly has it, and what it is told about writing."""
    import plotly.graph_objects as plotly

    kept: dict[str, Any] = {}

    def note(figure: Any, path: Any, **options: Any) -> None:
        whole = figure.to_plotly_json()
        whole["layout"].pop("template", None)  # plotly's own
        kept.update(options=options, name=Path(path).name, layout=whole["layout"])
        kept.update({f"trace {k}": trace for k, trace in enumerate(whole["data"])})
        for k, frame in enumerate(whole["frames"]):
            moved = {f"trace {i}": trace for i, trace in enumerate(frame.pop("data"))}
            kept[f"frame {k}"] = frame | moved

    with tempfile.TemporaryDirectory() as folder, mock.patch.object(plotly.Figure, "write_html", note):
        draw(f"{folder}/new/grasp.html")
    return described(kept)


def _page_of_run(name: str, **options: Any) -> Callable[[], dict[str, Any]]:
    return lambda: page_of(lambda path: plotting.page(runs.scene(name)[0], runs.run(name), path, **options))


def _page_of_stand_in() -> dict[str, Any]:
    grasp, motion, ts = runs.stand_in()
    return page_of(lambda path: _page.write_page(grasp, motion, ts, path, frames=3, view=VIEW))


SURFACES = {
    "sphere": lambda: geometry.Sphere(0.02),
    "ellipsoid": lambda: geometry.Ellipsoid(0.03, 0.02, 0.01),
    "superellipsoid": lambda: geometry.Superellipsoid(0.03, 0.02, 0.01, exponent=4),
    "torus": lambda: geometry.Torus(0.03, 0.01),
    "moved": lambda: geometry.Torus(0.03, 0.01).moved((0.1, 0.0, 0.0), (0.8, 0.2, -0.4, 0.4)),
    "hollow": lambda: geometry.Hollow(geometry.Sphere(0.02)),
    "cylinder": lambda: geometry.Cylinder(0.01),
    "plane": lambda: geometry.Plane().moved((0.0, 0.0, 0.1), (0.8, 0.2, -0.4, 0.4)),
}


def meshes() -> dict[str, Any]:
    """Triangles of every kind of surface, and the parts of a finger."""
    found: dict[str, Any] = {}
    for name, make in SURFACES.items():
        found[name] = of_mesh(
            _meshes.mesh(make(), rows=7, columns=10, extent=0.02, about=np.array([0.02, 0.01, 0.03]))
        )
    found["default"] = of_mesh(_meshes.mesh(geometry.Sphere(0.02)))
    found["box"] = of_mesh(_meshes.box_mesh(np.array([0.06, 0.04, 0.02])))
    for length in (0.0, 3.0, 12.5):
        found[f"tube {length}"] = described(
            _tubes.tube_mesh(np.ones(3), np.array([1.0, 1.0 + length, 2.0]), 0.7)
        )
    found["ball"] = described(_tubes.ball(np.ones(3), 2.0))
    found["cameras"] = described([_tubes.camera(*at) for at in ((22.0, -58.0), (-40.0, 130.0))])
    found["steps"] = [_poses3.tick_step(np.array([x])) for x in (0.3, 7.0, 60.0, 90.0, 150.0, 210.0, 400.0)]
    return found


def of_mesh(found: Any) -> dict[str, Any]:
    """A mesh: corners, triangles, pattern."""
    parts = {name: np.asarray(getattr(found, name)) for name in ("vertices", "faces", "areas")}
    checks = "".join(str(int(x)) for x in found.checks)
    return described(parts) | {"closed": bool(found.closed), "pattern": checks}


def rays() -> dict[str, Any]:
    """Where rays leave an implicit body, and where they begin."""
    bean = geometry.Implicit(lambda x, y, z: x**2 / 9e-4 + (y - 8.0 * x**2) ** 2 / 4e-4 + z**2 / 1e-4 - 1.0)
    directions = np.eye(3)
    centre = _rays.inside(bean)
    found = {"inside": centre, "radii": _rays.radii(bean, centre, directions)}
    # A field of splines is asked on its grid.
    fitted = fits.made("surface").surface
    return described(found | {"inside a fit": _rays.inside(fitted)})


def _loaded(name: str) -> dict[str, Any]:
    """Forces on an object that a load pulls as well."""
    grasp, _ = runs.scene(name)
    given = {"controller": grasp.controller, "gravity": grasp.gravity}
    force, torque = (0.5, 0.2, -0.3), (0.002, -0.004, 0.001)
    load = lambda t, pose, twist: (jnp.asarray(force) * (1.0 + t), jnp.asarray(torque))  # noqa: E731
    pulled = jxr.Grasp(grasp.object, grasp.fingers, grasp.contacts, load=load, **given)
    return drawn(plotting.poses(pulled, runs.run(name), times=(0.0, 0.4), forces=True))


def _map(codes: bool) -> dict[str, Any]:
    """A grid of codes in cells, or samples with a value as dots."""
    if codes:
        grid = jxr.Parameters.grid(damping=np.geomspace(0.002, 0.02, 4), beta=[10.0, 20.0, 30.0])
        return drawn(plotting.parameter_map(grid, grid.damping * grid.beta > 0.1, label="well"))
    t = np.arange(1.0, 7.0)
    some = jxr.Parameters(damping=t, beta=t**2)
    return drawn(plotting.parameter_map(some, np.where(t == 3.0, np.nan, 0.1 * t), label="height [m]"))


def labels() -> dict[str, Any]:
    """Where a label of 20 by 10 points goes, among lines and other labels."""
    line = np.array([[0.0, 50.0], [100.0, 50.0], [100.0, 80.0]])
    dots, half = _tags._dotted(line), np.array([10.0, 5.0])
    window, boxes = np.array([[0.0, 0.0], [120.0, 100.0]]), [np.array([[40.0, 51.0], [60.0, 70.0]])]
    places = ((50.0, 50.0), (3.0, 50.0), (100.0, 60.0), (60.0, 61.0), (115.0, 97.0), (70.0, 20.0))
    found = {str(at): _tags._best(np.array(at), half, window, dots, boxes) for at in places}
    return described({"dots": dots, **found})


def solids() -> dict[str, Any]:
    """What there is of each scene in space."""
    found = {}
    for name in SCENES[6:]:
        grasp, state = runs.scene(name)
        made = scene3(grasp, plotting._views3.scene_motion(grasp, state), rows=6, columns=8)
        found[name] = {
            "thickness": described(float(made.thickness)),
            "corners": described(made.corners),
            "name": made.tip_name,
            **{f"solid {k}": of_mesh(solid.mesh) for k, solid in enumerate(made.solids)},
        }
    return found


PICTURES: dict[str, Callable[[], dict[str, Any]]] = {
    **{
        f"pose_{name}": functools.partial(lambda name: drawn(plotting.pose(*runs.scene(name))), name)
        for name in POSED
    },
    **{
        f"contours_{name}": functools.partial(
            lambda name: drawn(plotting.contours(runs.scene(name)[0])), name
        )
        for name in ("pivoted", "pinch", "pinch_ellipse", "roller")
    },
    "pose_on_given_axes": _on_given_axes,
    "pose_seen_from": lambda: drawn(plotting.pose(*runs.scene("pinch3d"), view=VIEW)),
    "poses_pivoted": _of_run(plotting.poses, "pivoted"),
    "poses_pinch": _of_run(plotting.poses, "pinch", times=(0.0, 0.31, 0.6), forces=True),
    "poses_roller": _of_run(plotting.poses, "roller", times=(0.2,), forces=True),
    "poses_pinch3d": _of_run(plotting.poses, "pinch3d", times=(0.0, 0.4), forces=True),
    "poses_turntable": _of_run(plotting.poses, "turntable"),
    "poses_ended": lambda: drawn(plotting.poses(runs.scene("pivoted")[0], _broken("pivoted"))),
    "poses_without_states": _before_the_first_state,
    "responses_pivoted": lambda: written(
        lambda folder: plotting.responses(runs.scene("pivoted")[0], runs.run("pivoted"), folder)
    ),
    "responses_stretched": _stretched,
    "responses_pinch": _of_run(plotting.responses, "pinch"),
    "responses_roller": _of_run(plotting.responses, "roller"),
    "responses_ring": _of_run(plotting.responses, "ring"),
    "responses_pinch3d": _of_run(plotting.responses, "pinch3d"),
    "responses_turntable": _of_run(plotting.responses, "turntable"),
    "responses_ended": lambda: drawn(plotting.responses(runs.scene("pivoted")[0], _broken("pivoted"))),
    "responses_ended_pinch3d": lambda: drawn(
        plotting.responses(runs.scene("pinch3d")[0], _broken("pinch3d"))
    ),
    "phase": lambda: drawn(
        plotting.phase(runs.scene("pinch")[0], runs.run("pinch"), rest=runs.scene("pinch")[1])
    ),
    "contact_pivoted": _contact("pivoted", 0),
    "contact_open": _contact("pivoted", 0, bent=0.1),
    "design": lambda: written(lambda folder: plotting.design(runs.designed(), folder)),
    "comparison": lambda: written(
        lambda folder: plotting.comparison([runs.run("pinch"), _broken("pinch")], folder=folder)
    ),
    "comparison_in_space": lambda: drawn(
        plotting.comparison([runs.run("pinch3d"), _broken("pinch3d"), runs.run("pinch3d")], ["a", "b", "c"])
    ),
    "fit_closed": lambda: drawn(plotting.fit(runs.fitted())),
    "fit_open": lambda: drawn(plotting.fit(runs.fitted(closed=False))),
    "fit_surface": lambda: drawn(plotting.fit(fits.made("surface"))),
    "poses_loaded": lambda: _loaded("turntable"),
    "loci_turntable": _loci(1),
    "loci_pinch3d": _loci(2, whole=3e-5),
    "loci_at_rest": _loci(1, whole=0.0),
    "stand_in": _stand_in(picks=(0, 5, -1), titles=("first", "", "last"), forces=_pushes()),
    "stand_in_from_above": _stand_in(view=plotting.View(70.0, 120.0), size=9.0),
    "stand_in_animated": _stand_in_animated,
    "animated_pivoted": _animated("pivoted", fps=7.0, speed=0.5, until=0.35, size=3.0),
    "animated_pinch": _animated("pinch", fps=4.0, size=3.5),
    "animated_turntable": _long_animated,
    "page_pinch3d": _page_of_run("pinch3d", frames=4, title="In space"),
    "page_pivoted": _page_of_run("pivoted", frames=3),
    "page_turntable": _page_of_run("turntable", view=plotting.View(30.0, 20.0)),
    "page_stand_in": _page_of_stand_in,
    "map_of_codes": lambda: _map(True),
    "map_of_samples": lambda: _map(False),
    "meshes": meshes,
    "rays": rays,
    "labels": labels,
    "solids": solids,
}
PAGES = tuple(name for name in PICTURES if name.startswith("page"))
