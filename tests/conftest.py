"""Strict numerics, a persistent compilation cache, and the runs that many tests share."""

import collections
import contextlib
import ctypes
import functools
import gc
import importlib
import os
import pathlib
import tempfile
import time

import jax
import numpy as np
import pytest
import threadpoolctl

import jaxroll as jxr

CACHE = os.environ.get("JAXROLL_TEST_CACHE", os.path.join(tempfile.gettempdir(), "jaxroll-tests"))

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_compilation_cache_dir", str(pathlib.Path(CACHE)))
# To write a program down takes a tenth of a second: those that take less than some to compile are not kept.
jax.config.update("jax_persistent_cache_min_compile_time_secs", 1.0)
# The command line, which some tests call in this process, sets both for itself: each test begins with these.
_KEPT = {
    name: getattr(jax.config, name)
    for name in ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
}
# Nobody reads which line an operation of a program came from: a fortieth of the time.
jax.config.update("jax_traceback_in_locations_limit", 0)


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


_assert_allclose = np.testing.assert_allclose


def assert_allclose(actual, desired, *args, equal_nan=False, **options):
    """NumPy's, but where both sides lost their numbers nothing is as it should be, unless a test says so."""
    return _assert_allclose(actual, desired, *args, equal_nan=equal_nan, **options)


np.testing.assert_allclose = assert_allclose


# Each program takes some of the maps of memory that Linux lets a process have, 65 530 unless it is told, and
# half a megabyte of memory: what a process may gather of both before it forgets its programs. Two processes
# together keep to a third of the memory that there is; the default tests gather 4 GB in each.
_MOST_MAPS, _MOST_BYTES, _MOST_SHARE = 50_000, 4 * 10**9, 1 / 6
_PROCESS = pathlib.Path("/proc/self")
# How much memory a container may have, which is less than its machine's: in Linux's second and first way.
_CONTAINER = [f"/sys/fs/cgroup/{name}" for name in ("memory.max", "memory/memory.limit_in_bytes")]
_bytes_before = 0


@pytest.fixture(scope="module", autouse=True)
def _forgotten():
    """Forget programs after a file that brings a process near its limits, or after every file elsewhere.

    Files use many of the same programs: to keep them as long as that goes saves a seventh of the time.
    """
    global _bytes_before
    yield
    _forget_what_was_compiled()
    full = not _PROCESS.exists() or _PROCESS.joinpath("maps").read_bytes().count(b"\n") > _MOST_MAPS
    full = full or _bytes_in_memory() - _bytes_before > _most_bytes()
    if full:
        jax.clear_caches()
        _programs.clear()
        gc.unfreeze()
    gc.collect()
    if full:
        give_back()
        _bytes_before = _bytes_in_memory()
    gc.freeze()  # what is kept is not looked through again


def _forget_what_was_compiled():
    """Drop the modules that programs were compiled from, not the programs, where JAX has such caches.

    With a thousand of them alive another program takes half as long again to compile: of each context that
    MLIR makes it looks through those that are there. To forget them all takes long, too.
    """
    for place, name in (("pjit", "_pjit_lower"), ("interpreters.pxla", "_cached_lowering_to_hlo")):
        with contextlib.suppress(ImportError, AttributeError):
            getattr(importlib.import_module(f"jax._src.{place}"), name).cache_clear()


def share_context():
    """Let all programs be written down in one context of MLIR, where JAX has such a function to replace.

    JAX makes a context with all its dialects for every program: 4 ms, and a third of the memory that tests
    take. A program that is lowered within the lowering of another one needs its own: in a context that is at
    work, new modules end up inside of the other one.
    """
    with contextlib.suppress(ImportError, AttributeError):
        lowering = importlib.import_module("jax._src.interpreters.mlir")
        at_work = importlib.import_module("jaxlib.mlir.ir").Context
        new, shared = lowering.make_ir_context, functools.cache(lowering.make_ir_context)
        lowering.make_ir_context = lambda: shared() if at_work.current is None else new()


# Programs that this process compiled, by the key under which JAX would find them on disk.
_programs = {}


def share_programs():
    """Let a program whose text was compiled before be the one that is there, where JAX has these functions.

    JAX compiles a program for each function object, and for each kind of argument: one in four of those that
    tests compile was there, letter for letter. Its key is computed anyway, for the files of the cache.
    """
    with contextlib.suppress(ImportError, AttributeError):
        compiler = importlib.import_module("jax._src.compiler")
        read, compile_and_write = compiler._cache_read, compiler._compile_and_write_cache

        def found(name, key, *rest):
            return (_programs[key], 0) if key in _programs else read(name, key, *rest)

        def compiled(*given):
            key = given[-1]
            _programs[key] = compile_and_write(*given)
            return _programs[key]

        compiler._cache_read, compiler._compile_and_write_cache = found, compiled


def _bytes_in_memory():
    """Memory of this process, where Linux tells it; not all that was forgotten is given back."""
    told = _PROCESS / "statm"
    return int(told.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") if told.exists() else 0


@functools.cache
def _most_bytes():
    """Memory that a process may gather, where Linux tells how much there is."""
    there_is = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    for path in map(pathlib.Path, _CONTAINER):
        told = path.read_text().strip() if path.exists() else ""
        there_is = min(there_is, int(told)) if told.isdigit() else there_is
    return min(_MOST_BYTES, _MOST_SHARE * there_is)


# Compilation is most of the time that tests take. The default ones are compiled with fewer optimisations,
# which took 1143 s of processor time instead of 2077 when it was introduced. With `--slow` everything is
# compiled as for users. With `--slow --quickly` slow tests are compiled like the default ones, but for those
# marked `optimised`, which are left out: what is shown to users, long runs, and of every kind of program a
# run and a derivative.
# Machine code in one piece for each program instead of 32 is a twentieth less to compile, XLA's own choice of
# passes for compiling fast another twenty-fifth.
QUICKLY = (
    "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false"
    " --xla_cpu_parallel_codegen_split_count=1 --xla_cpu_opt_preset=fast_compile"
)


# The C library gives freed memory back to Linux at once, and takes it again for the next program that is
# compiled: to keep it is a tenth of the time. By name, with its number for `mallopt`; in bytes.
KEPT = {
    "MALLOC_TRIM_THRESHOLD_": (-1, 2**30),
    "MALLOC_TOP_PAD_": (-2, 2**26),
    "MALLOC_MMAP_THRESHOLD_": (-3, 2**25),
}


def of_c_library(name):
    """A function of the C library; None where it has none of this name."""
    return getattr(ctypes.CDLL(None), name, None) if os.name == "posix" else None


def keep_memory():
    """Let this process and those that it starts keep what they free, where the C library has such limits."""
    mallopt = of_c_library("mallopt")
    for name, (number, size) in KEPT.items():
        if mallopt is not None and name not in os.environ:
            mallopt(number, size)
            os.environ[name] = str(size)


def give_back():
    """Give the memory of forgotten programs back to Linux, where the C library can."""
    trim = of_c_library("malloc_trim")
    if trim is not None:
        trim(0)


def pytest_addoption(parser):
    parser.addoption("--slow", action="store_true", help="run the slow tests too, all fully optimised")
    quickly = "with --slow: compile with few optimisations, and leave out the tests marked optimised"
    parser.addoption("--quickly", action="store_true", help=quickly)
    within = "with --slow: begin no slow test later than this [s since 1970], and say how many were left out"
    parser.addoption("--until", type=float, default=float("inf"), help=within)


def compiled_quickly(config):
    return config.getoption("--quickly") or not config.getoption("--slow")


def pytest_configure(config):
    """Choose how programs are compiled, before anything makes XLA read it."""
    keep_memory()
    share_context()
    share_programs()
    # Two test processes share the cores: threads of BLAS would only wait for each other. JAX calls SciPy's,
    # which gets no limit before it is loaded.
    importlib.import_module("scipy.linalg")
    threadpoolctl.threadpool_limits(limits=1, user_api="blas")
    if compiled_quickly(config) and "XLA_FLAGS" not in os.environ:
        os.environ["XLA_FLAGS"] = QUICKLY


def pytest_runtest_setup(item):
    if "slow" in item.keywords and time.time() > item.config.getoption("--until"):
        pytest.skip("NOT RUN: the time for slow tests was over")
    for name, value in _KEPT.items():
        if getattr(jax.config, name) != value:
            jax.config.update(name, value)


def pytest_ignore_collect(collection_path, config):
    """Leave out files without a test that is marked so, where those marked `optimised` are asked for alone.

    To read all files, with their assertions written anew, takes each process as long as one of these tests.
    """
    asked = config.getoption("markexpr") == "optimised" and collection_path.suffix == ".py"
    return True if asked and "optimised" not in collection_path.read_text() else None


def pytest_collection_finish(session):
    """Let Python look for dead cycles seldom: a twentieth of the time that tracing and compilation take."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 20, 20)


@pytest.hookimpl(trylast=True)  # when others have taken out what is not asked for
def pytest_collection_modifyitems(config, items):
    skipped = {}
    if not config.getoption("--slow"):
        skipped["slow"] = "slow: run with --slow"
    if compiled_quickly(config):
        skipped["optimised"] = "compiled as for users: run with --slow, without --quickly"
    slow, every = collections.Counter(), collections.Counter()
    for item in items:
        reasons = [skipped[mark] for mark in skipped if mark in item.keywords]
        if reasons:
            item.add_marker(pytest.mark.skip(reason=reasons[0]))
        else:
            slow[item.path] += "slow" in item.keywords
            every[item.path] += 1
    # Files are given to the processes in this order: none of those that take long may be the last to begin.
    items.sort(key=lambda item: (-slow[item.path], -every[item.path]))


@pytest.fixture(scope="session")
def scene():
    """The pivoted scene: grasp and closed state."""
    return jxr.scenes.pivoted()


@pytest.fixture(scope="session")
def run(scene):
    """The pivoted scene at default settings, with everything recorded."""
    return jxr.simulate(*scene, t1=3.0, record=("multipliers", "energy"))
