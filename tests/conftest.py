"""Strict numerics, a persistent compilation cache, and the runs that many tests share."""

import gc
import os
import pathlib
import tempfile

import jax
import pytest
import threadpoolctl

import jaxroll as jxr

CACHE = os.environ.get("JAXROLL_TEST_CACHE", os.path.join(tempfile.gettempdir(), "jaxroll-tests"))

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_compilation_cache_dir", str(pathlib.Path(CACHE)))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


_raises = pytest.raises


def raises(expected, *args, **options):
    """`pytest.raises`, which also wants a `ValueError` to be one sentence, whatever its words."""
    if expected is ValueError and not args:
        options.setdefault("check", is_one_sentence)
    return _raises(expected, *args, **options)


def is_one_sentence(error):
    """One line that begins with the argument's name and is no longer than anyone reads."""
    text = str(error)
    return text.startswith("argument") and "\n" not in text and len(text) <= 300


pytest.raises = raises


@pytest.fixture(scope="module", autouse=True)
def _forgotten():
    """Forget a file's programs when it is done: some thousands of them exhaust the maps of a process."""
    yield
    jax.clear_caches()
    gc.collect()


# Compilation is most of the time that tests take. The default ones are compiled with fewer optimisations,
# which takes 1143 s of processor time instead of 2077. With `--slow` everything is compiled as for users.
QUICKLY = "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false"


def pytest_addoption(parser):
    parser.addoption("--slow", action="store_true", help="run the slow tests too, all fully optimised")


def pytest_configure(config):
    """Choose how programs are compiled, before anything makes XLA read it."""
    # Two test processes share the cores: threads of BLAS would only wait for each other.
    threadpoolctl.threadpool_limits(limits=1, user_api="blas")
    if not config.getoption("--slow") and "XLA_FLAGS" not in os.environ:
        os.environ["XLA_FLAGS"] = QUICKLY


def pytest_collection_finish(session):
    """Let Python look for dead cycles seldom: a twentieth of the time that tracing and compilation take."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 20, 20)


def pytest_collection_modifyitems(config, items):
    if config.getoption("--slow"):
        return
    skip = pytest.mark.skip(reason="slow: run with --slow")
    for item in items:
        if "slow" in item.keywords:
            item.add_marker(skip)


@pytest.fixture(scope="session")
def scene():
    """The pivoted scene: grasp and closed state."""
    return jxr.scenes.pivoted()


@pytest.fixture(scope="session")
def run(scene):
    """The pivoted scene at default settings, with everything recorded."""
    return jxr.simulate(*scene, t1=3.0, record=("multipliers", "energy"))
