"""Derivatives stored beside JAX's compiled programs: read instead of traced, and never another one's."""

import contextlib
import importlib
import os
import pkgutil
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll import _fingerprint
from jaxroll._motion import _equations
from jaxroll._xla import _stored, unstored
from jaxroll._xla._primitives import linear_map

CALLS = []


def doubled(at, x):
    CALLS.append("doubled")
    return at["factor"] * at["matrix"] @ x


def taken_back(at, bar):
    CALLS.append("taken_back")
    return at["factor"] * at["matrix"].T @ bar


def solved(at, x):
    CALLS.append("solved")
    return jnp.linalg.solve(at["matrix"], x)


def told(at, x):
    jax.debug.callback(lambda x: CALLS.append("told"), x[0])
    return doubled(at, x)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder for programs, with the functions of this file taken for a library's."""
    libraries = _stored.LIBRARIES | {__name__.split(".")[0]}
    for module in (_stored, _fingerprint):
        monkeypatch.setattr(module, "LIBRARIES", libraries)
    CALLS.clear()
    path = tmp_path / "programs"
    with setting("jax_compilation_cache_dir", str(path)):
        yield path


def files(folder):
    return sorted(folder.glob("jaxroll-*")) if folder.exists() else []


def mapped(matrix, x, factor=2.0, function=doubled):
    """Compiled anew in every call."""
    at = {"matrix": jnp.asarray(matrix), "factor": factor}
    return jax.jit(lambda at, x: linear_map(function, taken_back, {**at, "factor": factor}, x, like=x))(at, x)


MATRIX, X = np.array([[2.0, 1.0], [0.5, 3.0]]), jnp.asarray([1.0, -2.0])


def test_a_map_is_traced_once_whatever_its_numbers_are(folder):
    for matrix in (MATRIX, -MATRIX):
        np.testing.assert_allclose(mapped(matrix, X), 2.0 * matrix @ np.asarray(X), rtol=1e-15)
    assert CALLS == ["doubled"] and len(files(folder)) == 1


def test_lanes_cotangents_and_routines_of_lapack_are_stored_too(folder):
    at = {"matrix": jnp.asarray(MATRIX), "factor": 1.5}
    many = jnp.stack([X, 3.0 * X, -X])
    for turn in range(2):
        one = lambda x: linear_map(doubled, taken_back, at, x, like=x)  # noqa: E731
        # Twice the same, each by a function of its own.
        lanes = jax.jit(jax.vmap(one))(many)
        np.testing.assert_allclose(lanes, 1.5 * np.asarray(many) @ MATRIX.T, rtol=1e-15)
        bars = jax.jit(jax.vmap(jax.grad(lambda x, one=one: one(x) @ X)))(many)
        np.testing.assert_allclose(bars, np.tile(1.5 * MATRIX.T @ X, (3, 1)), rtol=1e-15)
        np.testing.assert_allclose(mapped(MATRIX, X, function=solved), np.linalg.solve(MATRIX, X), rtol=1e-14)
        if turn == 0:
            made = len(CALLS)
    assert len(CALLS) == made


def test_other_constants_shapes_kinds_and_settings_are_other_maps(folder):
    given = [(MATRIX, X, 2.0), (MATRIX, X, 3.0), (MATRIX, X, 2), (np.eye(3), jnp.ones(3), 2.0)]
    given.append((MATRIX.astype(np.float32), X.astype(jnp.float32), 2.0))
    for matrix, x, factor in given:
        found = mapped(matrix, x, factor)
        np.testing.assert_allclose(found, factor * matrix @ np.asarray(x), rtol=1e-6)
        assert found.dtype == x.dtype
    assert len(files(folder)) == len(CALLS) == len(given)
    with jax.default_matmul_precision("highest"):
        mapped(MATRIX, X)
    assert len(files(folder)) == len(given) + 1


@pytest.mark.parametrize("damage", [b"", b"garbage", None])
def test_a_damaged_file_is_made_anew(folder, damage):
    first = mapped(MATRIX, X)
    (path,) = files(folder)
    whole = path.read_bytes()
    path.write_bytes(whole[:-7] if damage is None else damage)
    np.testing.assert_array_equal(mapped(MATRIX, X), first)
    assert CALLS == ["doubled"] * 2
    mapped(MATRIX, X)
    assert CALLS == ["doubled"] * 2 and files(folder) == [path]


def test_where_nothing_can_be_stored_all_is_as_without(folder):
    folder.write_text("no folder")
    np.testing.assert_allclose(mapped(MATRIX, X), 2.0 * MATRIX @ np.asarray(X), rtol=1e-15)
    assert folder.read_text() == "no folder"


@contextlib.contextmanager
def setting(name, value):
    before = getattr(jax.config, name)
    jax.config.update(name, value)
    try:
        yield
    finally:
        jax.config.update(name, before)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("jax_enable_compilation_cache", False),
        ("jax_compilation_cache_max_size", 10**9),
        ("jax_compilation_cache_dir", None),
        ("jax_compilation_cache_dir", "gs://bucket/programs"),
    ],
)
def test_there_is_no_folder_where_jax_stores_nothing_or_little(folder, name, value):
    assert _stored._folder() == folder
    with setting(name, value):
        assert _stored._folder() is None


def test_without_a_folder_nothing_is_stored(folder):
    with unstored():
        mapped(MATRIX, X)
    assert CALLS == ["doubled"] and not files(folder)


def test_what_calls_python_is_not_stored(folder):
    for turn in range(2):
        np.testing.assert_allclose(mapped(MATRIX, X, function=told), 2.0 * MATRIX @ np.asarray(X), rtol=1e-15)
        jax.effects_barrier()
        assert CALLS.count("told") == turn + 1
    assert not files(folder)


class OwnPress(jxr.control.Press):
    """A controller of a caller's own."""


def test_what_a_caller_wrote_is_not_stored(folder, monkeypatch):
    # As a caller's own, which the fixture has them taken for otherwise.
    monkeypatch.setattr(_stored, "LIBRARIES", _stored.LIBRARIES - {__name__.split(".")[0]})
    grasp, _ = jxr.scenes.pivoted()
    press = grasp.controller
    numbers = dict(force=press.force, damping=press.damping, radius=press.radius, target=press.target)
    reads = lambda value: _stored._Strict().read(value)  # noqa: E731
    assert reads(grasp)
    own = [
        grasp.with_(controller=lambda t, angles, rates, tips: angles),
        grasp.with_(controller=OwnPress(**numbers)),
        [test_what_a_caller_wrote_is_not_stored],
        jax.make_jaxpr(jnp.sin)(1.0),
        sys.modules[__name__],
    ]
    for value in own:
        with pytest.raises(_stored._OwnError):
            reads(value)
    # A library's class with a method of a caller's.
    monkeypatch.setattr(jxr.control.Press, "torques", lambda self, t, seen: [])
    with pytest.raises(_stored._OwnError):
        reads(grasp)
    mapped(MATRIX, X)
    assert not files(folder)


def test_nothing_is_stored_while_a_function_of_the_package_is_another_one(folder, monkeypatch):
    monkeypatch.setattr(_stored, "LIBRARIES", _stored.LIBRARIES - {__name__.split(".")[0]})
    # Whatever a caller has imported.
    for module in pkgutil.walk_packages(jxr.__path__, "jaxroll."):
        if module.name != "jaxroll.__main__":
            importlib.import_module(module.name)
    assert _stored._as_installed()
    monkeypatch.setattr(_equations, "net_force", lambda inertia, drive: drive)
    assert not _stored._as_installed()
    mapped(MATRIX, X)
    assert not files(folder)


GRADIENT = """
import jax, jaxroll as jxr
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_compilation_cache_dir", "programs")
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
if {second}:
    import jaxroll._integration._derivative as derivative
    derivative.pulled_back = None  # so that nothing can be traced
grasp, state = jxr.scenes.pivoted()
turned = lambda damping: jxr.simulate(grasp.with_(damping=damping), state, 0.1, ts=1).last.q[0]
print(repr(jax.jit(jax.grad(turned))(grasp.controller.damping).item()))
"""


@pytest.mark.slow
def test_another_process_has_the_same_gradient_without_tracing_it(tmp_path):
    environment = {**os.environ, "XLA_FLAGS": ""}

    def printed(second):
        command = [sys.executable, "-c", GRADIENT.format(second=second)]
        return subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
        ).stdout

    first = printed(False)
    assert len(files(tmp_path / "programs")) == 1
    count = len(list((tmp_path / "programs").iterdir()))
    assert printed(True) == first and float(first) != 0.0
    assert len(list((tmp_path / "programs").iterdir())) == count  # nor is it compiled


def test_what_is_stored_lies_in_folders_that_are_made_where_they_are_not_there(tmp_path):
    for name in ("one", "two"):
        path = tmp_path / "new" / "folder" / name
        assert _stored._written(path, bytearray(b"data")) == b"data"
        assert path.read_bytes()[32:] == b"data" and _stored._read(path.with_name("none")) is None
    assert {path.name for path in path.parent.iterdir()} == {"one", "two"}
